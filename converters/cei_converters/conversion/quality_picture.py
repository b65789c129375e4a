"""How good a whole conversion is, in one picture: fidelity, where it is known quality, and where the worst episodes are worst."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from cei_converters.conversion.converter import Converter
from cei_converters.conversion.episode import Outcome, Worst
from cei_converters.conversion.gate import DROPPED, FLAGGED, KEPT, Gate
from cei_converters.view.episode import Side, View, make_side
from cei_converters.view.sheet import draw_moments
from cei_gym.arrays import Array
from cei_gym.demonstration import Demonstration
from cei_gym.embodiment import Embodiment

_WORST = 5
_COLOURS = {KEPT: "#4878b0", FLAGGED: "#e8a33d", DROPPED: "#c44e52"}
_BINS = [i / 20 for i in range(21)]
_DPI = 100


def write_summary(path: Path, outcomes: Iterable[Outcome], gate: Gate, converter: Converter) -> None:
    """Draw scores and parts of all converted episodes, dropped ones included, and the worst ones where they are worst.

    Args:
        path: PNG to write.
        outcomes: of the episodes.
        gate: what became of which.
        converter: that converted them.
    """
    measured, decisions, likely = [], [], []
    worst: list[tuple[float, int, Outcome]] = []  # score, position, outcome
    for position, outcome in enumerate(outcomes):
        fidelity = outcome.record["fidelity"]
        measured.append((fidelity["score"], *fidelity["parts"].values()))
        decisions.append(_decision(outcome, gate))
        likely.append(outcome.entry["quality"])
        worst = sorted([*worst, (fidelity["score"], position, outcome)], key=lambda each: each[:2])[:_WORST]
    names, values = list(worst[0][2].record["fidelity"]["parts"]), np.array(measured)
    pictures = _portraits([outcome.worst for _, _, outcome in worst], converter)
    with mpl.rc_context(mpl.rcParamsDefault):  # whatever the user's own style is
        figure = Figure(figsize=(15, 8.7), dpi=_DPI, layout="constrained")
        above, below = figure.subfigures(2, 1, height_ratios=(1, 1.9), squeeze=False)[:, 0]
        known = [each for each in likely if each is not None]
        histogram, parts, *beside = above.subplots(1, 3 if known else 2)
        _draw_scores(histogram, values[:, 0], decisions)
        _draw_parts(parts, names, values[:, 1:], decisions)
        for axes in beside:
            _draw_qualities(axes, known, len(likely), gate)
        below.suptitle(
            "The worst episodes (numbered as in the source), each where it is worst; red its pads, blue the source's",
            fontsize=12,
        )
        columns = below.subplots(1, _WORST)
        for axes, (_, position, outcome), picture in zip(columns, worst, pictures, strict=False):
            _draw_worst(axes, outcome, decisions[position], picture)
        for axes in columns[len(worst) :]:
            axes.set_axis_off()
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, metadata={"Software": None})


def _decision(outcome: Outcome, gate: Gate) -> str:
    return DROPPED if outcome.left_out else gate.decision(outcome.entry["quality"])


def _draw_scores(axes: Axes, scores: Array, decisions: Sequence[str]) -> None:
    shown = [decision for decision in _COLOURS if decision in decisions]
    axes.hist(
        [scores[np.array(decisions) == decision] for decision in shown],
        _BINS,
        stacked=True,
        color=[_COLOURS[decision] for decision in shown],
        label=[f"{decision}: {decisions.count(decision)}" for decision in shown],
    )
    axes.set(
        title=f"{len(scores)} episodes, median {np.median(scores):.2f}",
        xlabel="fidelity: how well pads follow",
        ylabel="episodes",
    )
    axes.set_xlim(0, 1)
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    axes.margins(y=0.25)  # room for the key
    axes.legend(loc="upper center", ncols=5, fontsize=8)


def _draw_qualities(axes: Axes, known: Sequence[float], of: int, gate: Gate) -> None:
    axes.hist(known, _BINS, color=_COLOURS[KEPT])
    for style, (name, bound) in zip(("-", "--"), gate.bounds.items(), strict=False):
        axes.axvline(bound, color="0.3", ls=style, lw=1, label=f"--{name}={bound:g}")
    axes.set(title=f"Known of {len(known)} of {of}", xlabel="quality: the probability that it works", ylabel="episodes")
    axes.set_xlim(0, 1)
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    if gate.bounds:
        axes.legend(loc="upper center", ncols=2, fontsize=8)


def _draw_parts(axes: Axes, names: Sequence[str], parts: Array, decisions: Sequence[str]) -> None:
    """A dot an episode and part, (episodes, parts), spread a little in the order of the episodes."""
    spread = np.linspace(-0.3, 0.3, len(parts)) if len(parts) > 1 else np.zeros(1)
    colours = [_COLOURS[decision] for decision in decisions]
    for row in range(len(names)):
        axes.scatter(parts[:, row], row + spread, s=12, c=colours, alpha=0.7)
    axes.set(xlim=(0, 1.02), yticks=range(len(names)), yticklabels=names, ylim=(len(names) - 0.5, -0.5))
    axes.set(xlabel="each part of it; an episode's worst is its fidelity", title="What it is made of")
    axes.grid(axis="x", alpha=0.3)


def _draw_worst(axes: Axes, outcome: Outcome, decision: str, picture: Array) -> None:
    entry, frame = outcome.entry, outcome.worst.frame
    axes.imshow(picture)
    axes.set(xticks=[], yticks=[])
    title = f"episode {entry['episode']}: {entry['fidelity']:.2f}\n{entry['weakest']}, frame {frame}"
    axes.set_title(
        title if decision == KEPT else f"{title}, {decision}",
        fontsize=11,
        color="k" if decision == KEPT else _COLOURS[decision],
    )


def _portraits(worst: Sequence[Worst], converter: Converter) -> list[Array]:
    """The target at one frame of each episode, its pads and the source's: (H, W, 3) uint8 each."""
    scene, frames = converter.reader.scene, np.array([each.frame for each in worst])

    def side(role: str, embodiment: Embodiment, T_world_base: Array) -> Side:
        qpos = np.array([getattr(each, f"qpos_{role}") for each in worst])
        demonstration = Demonstration(embodiment.name, 1.0, qpos, qpos, replace(scene, T_world_base=T_world_base))
        return make_side(role, embodiment, demonstration, frames)

    source = side("source", converter.transfer.source, scene.T_world_base)
    target = side("target", converter.transfer.target, converter.T_world_target)
    return draw_moments(View((source, target), "", {}), target, range(len(worst)), supersample=1)
