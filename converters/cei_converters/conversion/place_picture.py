"""The places that `--target_pose=auto` looked at, from above: how good each is, the source's, and the one that is chosen."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cei_gym.transfer.placing import Placement, Standing

_DPI = 100
_AXIS_M = 0.15  # length of a base's x and y axis


def write_place_picture(path: Path, placement: Placement) -> None:
    """Draw it as a PNG."""
    x_m, y_m, cost_m = placement.scored.T
    with mpl.rc_context(mpl.rcParamsDefault):  # whatever the user's own style is
        figure = Figure(figsize=(8, 7), dpi=_DPI, layout="constrained")
        axes = figure.subplots()
        # those that are not worth following are all alike
        most = float(np.quantile(cost_m, 0.8))
        order = np.argsort(-cost_m, kind="stable")
        dots = axes.scatter(x_m[order], y_m[order], c=np.minimum(cost_m, most)[order], cmap="viridis_r", s=28)
        figure.colorbar(dots, label="cost (m): lower is better")
        axes.plot(*placement.pads_world.T, ".", color="0.55", ms=3, label="the source's pads")
        _draw_base(axes, placement.source, "0.2", "the source's base")
        if not placement.kept:
            _draw_base(axes, placement.chosen, "#c44e52", "the target's base")
        axes.set(xlabel="x (world, m)", ylabel="y (world, m)", aspect="equal")
        axes.set_title("where the target's base could stand, from above")
        axes.legend(loc="upper right", fontsize=8)
        figure.savefig(path, metadata={"Software": None})


def _draw_base(axes: Axes, standing: Standing, colour: str, label: str) -> None:
    T = standing.T_world_base
    axes.plot(*T[:2, 3], "o", color=colour, ms=9, mec="w", label=label)
    for axis in (0, 1):
        tip = T[:2, 3] + _AXIS_M * T[:2, axis]
        axes.plot(*np.stack([T[:2, 3], tip]).T, color=colour, lw=2 if axis == 0 else 1)
