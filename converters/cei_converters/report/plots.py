"""Plots of a report, as PNGs."""

import io
from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from cei_converters.view.episode import RESIDUALS, cloud_rgb
from cei_gym.arrays import Array
from cei_gym.demonstration import Demonstration

_DPI = 110


@dataclass(frozen=True)
class Series:
    """How far pads are apart in an episode of T frames.

    Attributes:
        label: the episode.
        times_s: (T,).
        residuals: (T,) each, by the names of `RESIDUALS`.
        best: whether it is the best one.
    """

    label: str
    times_s: Array
    residuals: dict[str, Array]
    best: bool = False


def plot_residuals(series: Sequence[Series]) -> bytes:
    """Residuals of some episodes over time; the best one dashed, to compare with."""
    with mpl.rc_context(mpl.rcParamsDefault):  # whatever the user's own style is
        figure = Figure(figsize=(11, 3.4), layout="constrained")
        for axes, (key, label) in zip(figure.subplots(1, len(RESIDUALS)), RESIDUALS.items(), strict=True):
            for each in series:
                style = {"color": "0.5", "ls": "--"} if each.best else {}
                axes.plot(each.times_s, each.residuals[key], lw=1.4, label=each.label, **style)
            most = max(float(each.residuals[key].max()) for each in series)
            axes.set(xlabel="time (s)", ylabel=label, ylim=(0, 1.1 * max(most, 1.0)))
            axes.grid(alpha=0.3)
        axes.legend(fontsize=9)
        return png(figure)


def plot_clouds(shown: Sequence[Demonstration], share: float = 2 / 3) -> bytes:
    """Point clouds of some demonstrations of one episode side by side, so far into it."""
    with mpl.rc_context(mpl.rcParamsDefault):
        figure = Figure(figsize=(5.5 * len(shown), 4.4), layout="constrained")
        for i, each in enumerate(shown):
            assert each.point_cloud_world is not None
            t = int((len(each) - 1) * share)
            axes = figure.add_subplot(1, len(shown), i + 1, projection="3d")
            axes.scatter(*each.point_cloud_world[t, :, :3].T, s=3, c=cloud_rgb(each, t) / 255)
            axes.view_init(elev=22, azim=35)
            box = each.scene.workspace_world
            axes.set_box_aspect(np.ptp(box, axis=0))
            axes.set(xlim=box[:, 0], ylim=box[:, 1], zlim=box[:, 2], xlabel="x (m)", ylabel="y (m)", zlabel="z (m)")
            axes.set_title(each.embodiment, parse_math=False)
        return png(figure)


def png(figure: Figure) -> bytes:
    """A figure as it is drawn."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=_DPI, metadata={"Software": None})
    return buffer.getvalue()
