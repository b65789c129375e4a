"""The table from above: the robot, the anchors by how many of their trials succeed, where buttons stood in training, and where it failed."""

from pathlib import Path

from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from cei_converters.benchmark.anchors_report import Found, every_anchor, total
from cei_converters.benchmark.anchors_stages import Anchor
from cei_gym.augmentation import grid_offsets

TABLE_M = (0.8, 1.2)
"""Along x, away from the robot, and along y, to its left."""


def draw(found: Found, path: Path) -> None:
    """Draw what was replayed and what the policy does, a panel each; x is up, y to the left, as the robot sees it."""
    panels = [("replayed", found.replay is not None), ("policy", bool(found.policies))]
    shown = [name for name, there in panels if there]
    figure = Figure(figsize=(1 + 5.6 * len(shown), 5.2), layout="constrained")
    for axes, name in zip(figure.subplots(1, len(shown), squeeze=False)[0], shown, strict=True):
        _panel(axes, found, name)
    figure.savefig(path, dpi=110)


def _panel(axes: Axes, found: Found, name: str) -> None:
    first = found.any
    assert first is not None
    depth, width = TABLE_M
    axes.add_patch(Rectangle((-width / 2, -depth / 2), width, depth, fc="#f3eee6", ec="#8a7f6d", zorder=0))
    base_x, base_y = first["base_m"]
    axes.plot([base_y], [base_x], "s", ms=16, color="#555", zorder=2)
    axes.annotate("robot", (base_y, base_x), (14, 0), textcoords="offset points", va="center", fontsize=9)
    trained = [tuple(middle) for middle in first["anchors"]]
    extent_m = (first["range_m"], first["range_m"])
    offsets = grid_offsets((first["grid"], first["grid"]), extent_m)
    for x, y in trained:
        axes.plot([y + o.y_m for o in offsets], [x + o.x_m for o in offsets], ".", ms=2, color="#9a9a9a", zorder=1)
    rates = {
        anchor: found.replayed(anchor) if name == "replayed" else found.learnt(anchor) for anchor in every_anchor()
    }
    for anchor, rate in rates.items():
        if rate is None:
            continue
        x, y = anchor.middle_m
        colour = colormaps["RdYlGn"](rate.share)
        axes.plot([y], [x], "o", ms=26, mfc=colour, mec="#333", mew=0.8, alpha=0.9, zorder=3)
        axes.annotate(f"{rate.successes}/{rate.of}", (y, x), ha="center", va="center", fontsize=9, zorder=4)
        failed = _failed(found, anchor, name)
        axes.plot([p[1] for p in failed], [p[0] for p in failed], "x", ms=8, mew=2, color="black", zorder=5)
    said = total([*rates.values()])
    axes.set_title(f"{name}: {said}; crosses failed", fontsize=10)
    axes.set(xlim=(width / 2 + 0.03, -width / 2 - 0.03), ylim=(base_x - 0.08, depth / 2 + 0.03), aspect="equal")
    axes.set(xlabel="y, m", ylabel="x, m")


def _failed(found: Found, anchor: Anchor, name: str) -> list[tuple[float, float]]:
    """Where the button stood where it was not pressed, x and y in m."""
    if name == "replayed":
        assert found.replay is not None
        own = [each for each in found.replay["episodes"] if each["anchor"] == anchor.number]
        return [(each["x_m"], each["y_m"]) for each in own if not each["success"]]
    policy = found.policies[anchor]
    return [(p[0], p[1]) for p, ok in zip(policy["places"], policy["successes"], strict=True) if not ok]
