"""One self-contained page about a transfer: what succeeded, how it looks, how close the pads are, how to do it by hand."""

import base64
import html
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from cei_gym.demonstration import Demonstration

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #1c2330; max-width: 1000px; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.7rem; } h2 { font-size: 1.2rem; margin-top: 2rem; }
table { border-collapse: collapse; } th, td { padding: .3rem .8rem; border-bottom: 1px solid #d5dae3; text-align: left; }
th { background: #f2f4f8; } img, video { max-width: 100%; border-radius: 4px; }
pre { background: #f2f4f8; padding: .8rem; white-space: pre-wrap; border-radius: 4px; } .note { color: #566074; }
"""


def write_report(
    path: Path,
    replays: Sequence[dict[str, Any]],
    conversion: dict[str, Any],
    episodes: tuple[Demonstration, Demonstration],
    commands: Sequence[str],
) -> None:
    """Write the page.

    Args:
        path: HTML file to write.
        replays: results of `cei-replay`, source first; the last one's video and contact sheet are embedded.
        conversion: result of `cei-convert`.
        episodes: one episode of the source and the same of the target, whose clouds are drawn.
        commands: shell commands that do the same by hand.
    """
    source, target = conversion["source"]["embodiment"], conversion["target"]
    video = Path(replays[-1]["video"])
    parts = [
        f"<h1>{source} to {target}</h1>",
        f"<p>{conversion['episodes']} demonstrations of <b>{source}</b> became demonstrations of <b>{target}</b>. "
        "Both were then replayed in physics from the recorded starts; nothing was trained and no object was attached.</p>",
        _success_table(replays),
        "<h2>Side by side</h2>",
        f'<video controls autoplay loop muted src="{_data(video.read_bytes(), "video/mp4")}"></video>',
        _image(video.with_suffix(".png").read_bytes(), "One demonstration: above the source, below the target"),
        "<h2>How close the pads are</h2>",
        _image(_residual_plot(conversion), "Residuals over the episode"),
        _quality_table(conversion),
        "<h2>What the policy will see</h2>",
        _image(_cloud_plot(episodes), "Point clouds before and after"),
        "<p class=note>The recorded cloud loses the source robot and gains points sampled on the target's meshes "
        "(1024 points, farthest-point sampling).</p>",
        "<h2>What physics does with the robots by rule</h2>",
        _physics_table(replays),
        "<h2>The same by hand</h2>",
        f"<pre>{html.escape(chr(10).join(commands))}</pre>",
    ]
    page = f'<!doctype html><html lang="en"><meta charset="utf-8"><title>CEI-Gym: {source} to {target}</title>'
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"{page}<style>{_STYLE}</style><body>{''.join(parts)}</body></html>\n")


def _success_table(replays: Sequence[dict[str, Any]]) -> str:
    rows = []
    for r in replays:
        low, high = r["interval_95"]
        failures = ", ".join(f"{reason}: {count}" for reason, count in r["failures"].items()) or "none"
        rate = f"{r['successes']} of {r['episodes']}"
        rows.append((r["embodiment"], r["env"], rate, f"{low:.0%} to {high:.0%}", failures))
    return _table(("embodiment", "environment", "successes", "95 % interval (Wilson)", "failures"), rows)


def _quality_table(conversion: dict[str, Any]) -> str:
    names = {
        "frames": "frames",
        "pad_distance_mm_mean": "pad distance, mean (mm)",
        "normal_angle_deg_mean": "normal angle, mean (deg)",
        "iterations_mean": "iterations a frame",
        "limit_hits_max": "joints at a limit, most",
        "joint_step_max_rad": "largest joint step (rad)",
        "penetration_mm_max": "deepest penetration (mm)",
        "quality": "quality, 0 to 1",
    }
    rows = [(e["episode"], *(f"{e[key]:.3g}" for key in names)) for e in conversion["results"]]
    return _table(("episode", *names.values()), rows)


def _physics_table(replays: Sequence[dict[str, Any]]) -> str:
    rules = [
        tuple(rule[key] for key in ("part", "kind", "source", "says"))
        for r in replays
        for rule in r["physics"]["rules"]
    ]
    return _table(("of", "rule", "set by", "what"), [*dict.fromkeys(rules)])


def _residual_plot(conversion: dict[str, Any]) -> bytes:
    figure = Figure(figsize=(10, 3.2), layout="constrained")
    for axes, key, label in zip(
        figure.subplots(1, 2),
        ("pad_distance_mm", "normal_angle_deg"),
        ("mean pad distance (mm)", "mean angle between normals (deg)"),
        strict=True,
    ):
        for episode in conversion["residuals"]:
            values = np.asarray(episode[key])
            axes.plot(np.linspace(0, 1, len(values)), values, lw=1, alpha=0.8, label=f"{episode['episode']}")
        axes.set(xlabel="share of the episode", ylabel=label, xlim=(0, 1), ylim=(0, None))
        axes.grid(alpha=0.3)
    return _png(figure)


def _cloud_plot(episodes: tuple[Demonstration, Demonstration]) -> bytes:
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    for i, episode in enumerate(episodes):
        assert episode.point_cloud_world is not None  # both have depth or a cloud
        cloud = episode.point_cloud_world[len(episode) * 2 // 3]
        axes = figure.add_subplot(1, 2, i + 1, projection="3d")
        axes.scatter(*cloud.T, s=3, c=cloud[:, 2], cmap="viridis")
        axes.view_init(elev=22, azim=35)
        axes.set_box_aspect(np.ptp(episode.scene.workspace_world, axis=0))
        box = episode.scene.workspace_world
        axes.set(title=episode.embodiment, xlim=box[:, 0], ylim=box[:, 1], zlim=box[:, 2])
        axes.set(xlabel="x (m)", ylabel="y (m)", zlabel="z (m)")
    return _png(figure)


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    return buffer.getvalue()


def _image(content: bytes, caption: str) -> str:
    return f'<img alt="{html.escape(caption)}" src="{_data(content, "image/png")}">'


def _data(content: bytes, kind: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def _table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    head = "".join(f"<th>{html.escape(h)}</th>" for h in header)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(str(c))}</td>" for c in row) + "</tr>" for row in rows)
    return f"<table><tr>{head}</tr>{body}</table>"
