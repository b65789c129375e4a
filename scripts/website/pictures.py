"""The pictures of the documents that are made by hand or from the product: docs/pads.png and docs/pipeline.svg.

Usage: python scripts/website/pictures.py   (a minute; needs what the product needs)
"""

from pathlib import Path
from xml.sax.saxutils import escape

DOCS = Path(__file__).resolve().parents[2] / "docs"
_FONT = 'font-family="Helvetica, Arial, sans-serif"'


def pads(path: Path) -> None:
    """Two end-effectors with their functional representations, as `cei-pads` draws them."""
    import numpy as np
    from PIL import Image, ImageDraw, ImageFont

    from cei_gym.embodiment import build_embodiment, load_end_effector
    from cei_gym.functional import sample_representation
    from cei_gym.functional.picture import draw_representation

    rows = []
    for name in ("PandaGripper", "Inspire"):
        embodiment = build_embodiment(None, load_end_effector(name))
        picture = draw_representation(
            sample_representation(embodiment, 128, 0), (embodiment.home + embodiment.closed) / 2
        )
        image = Image.fromarray(picture)
        ImageDraw.Draw(image).text((16, 12), name, fill=(40, 40, 40), font=ImageFont.load_default(28))
        rows.append(np.asarray(image))
    Image.fromarray(np.concatenate(rows)).save(path, optimize=True)


def pipeline() -> str:
    """The data's way from dataset to dataset, and from there to a policy that acts, as SVG."""
    drawn = [
        _box(20, 60, 150, 92, "source", ["a robot's dataset:", "LeRobot, HDF5, zarr"], "#e3f2fd"),
        _box(840, 60, 150, 92, "target", ["another robot's dataset:", "LeRobot v3.0"], "#e8f5e9"),
        _arrow(170, 106, 198),
        _arrow(812, 106, 838),
        f'<rect x="200" y="20" width="612" height="172" rx="8" fill="none" stroke="#5c6bc0" stroke-dasharray="5 4"/>'
        f'<text x="212" y="40" {_FONT} font-size="13" fill="#3949ab">cei-convert, episode by episode</text>',
    ]
    steps = [
        ("read", ["joints, actions,", "depth, clouds"]),
        ("augment", ["objects, and the", "source, elsewhere"]),
        ("retarget", ["pads follow pads,", "robots swap in clouds"]),
        ("judge", ["fidelity, reach,", "replay in physics"]),
        ("encode", ["features, statistics,", "provenance"]),
    ]
    for i, (name, lines) in enumerate(steps):
        drawn.append(_box(214 + 120 * i, 60, 104, 92, name, lines, "#ede7f6"))
        if i:
            drawn.append(_arrow(198 + 120 * i, 106, 212 + 120 * i))
    drawn += [
        f'<text x="506" y="176" {_FONT} font-size="12" fill="#444" text-anchor="middle">pictures and what does not depend on the robot are carried over as they are</text>',
        '<path d="M915 152 V236 H760" fill="none" stroke="#555" stroke-width="1.6" marker-end="url(#head)"/>',
        _box(590, 212, 168, 66, "lerobot-train", ["--policy.type=dp3, ..."], "#fff8e1"),
        '<path d="M590 245 H552" fill="none" stroke="#555" stroke-width="1.6" marker-end="url(#head)"/>',
        _box(382, 212, 168, 66, "policy", ["of the target robot"], "#fff8e1"),
        '<path d="M382 245 H344" fill="none" stroke="#555" stroke-width="1.6" marker-end="url(#head)"/>',
        _box(124, 212, 218, 66, "CrossEmbodimentWrapper", ["the same clouds, live: lerobot-eval"], "#fff8e1"),
    ]
    head = (
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 1010 300" role="img" '
        "aria-label=\"From one robot's dataset by reading, augmenting, retargeting, judging and encoding to another's, and to a policy\">"
        '<defs><marker id="head" markerWidth="9" markerHeight="8" refX="8" refY="4" orient="auto">'
        '<path d="M0 0 L9 4 L0 8 z" fill="#555"/></marker></defs><rect width="1010" height="300" fill="white"/>'
    )
    return "\n".join([head, *drawn, "</svg>", ""])


def _box(x: int, y: int, width: int, height: int, title: str, lines: list[str], fill: str) -> str:
    middle, top = x + width / 2, y + height / 2 - 9 * len(lines)
    text = [
        f'<text x="{middle:g}" y="{top + 3:g}" {_FONT} font-size="14" font-weight="bold" text-anchor="middle">{escape(title)}</text>'
    ]
    text += [
        f'<text x="{middle:g}" y="{top + 22 + 15 * i:g}" {_FONT} font-size="10.5" fill="#333" text-anchor="middle">{escape(line)}</text>'
        for i, line in enumerate(lines)
    ]
    return "\n".join(
        [f'<rect x="{x}" y="{y}" width="{width}" height="{height}" rx="6" fill="{fill}" stroke="#78909c"/>', *text]
    )


def _arrow(x: int, y: int, to: int) -> str:
    return f'<path d="M{x} {y} H{to}" fill="none" stroke="#555" stroke-width="1.6" marker-end="url(#head)"/>'


def main() -> None:
    """Make them anew."""
    (DOCS / "pipeline.svg").write_text(pipeline())
    pads(DOCS / "pads.png")


if __name__ == "__main__":
    main()
