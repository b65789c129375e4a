"""Success of every cell as a picture, with the paper's figure in it."""

from pathlib import Path
from typing import Any

from matplotlib import colormaps
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from cei_converters.benchmark.cells import END_EFFECTORS
from cei_converters.benchmark.tables import Found, averages, percent, shown, targets_of, tasks_of
from cei_gym.embodiment import ARMS

SIZE = 0.94  # of a cell, whose middle is at whole numbers
EDGE, BELOW_PAPER = "#c8c8c8", "#d62728"
DARK_PERCENT = 55  # cells above it are dark and have white text


def write_heat_map(found: Found, path: Path) -> None:
    """Draw one panel a task: end-effectors by arms, coloured by our success.

    A cell below the paper's figure has a red frame, one that is not finished is hatched.
    """
    tasks = tasks_of(found)
    figure = Figure(figsize=(13 * len(tasks) / 3, 4.9), layout="constrained")
    panels = dict(zip(tasks, figure.subplots(1, len(tasks), sharey=True), strict=True))
    for task, axes in panels.items():
        ours, stock, paper = map(shown, averages(found, task))
        axes.set_title(f"{task}: {ours} (stock {stock} · paper {paper})", fontsize=11)
        axes.set(xticks=range(len(ARMS)), xticklabels=ARMS, xlim=(-0.5, len(ARMS) - 0.5))
        axes.set(yticks=range(len(END_EFFECTORS)), yticklabels=END_EFFECTORS, ylim=(len(END_EFFECTORS) - 0.5, -0.5))
        axes.tick_params(length=0)
        axes.spines[:].set_visible(False)
        axes.set_aspect("equal")
    for entry in (entry for task in tasks for entry in targets_of(task)):
        cell, result = entry.cell, found.get(entry.cell)
        x, y = ARMS.index(cell.arm), END_EFFECTORS.index(cell.end_effector)
        if result is None:
            _draw_missing(panels[cell.task], x, y, entry.paper)
        else:
            ours, stock = percent(result["replay"]), percent(result["stock_replay"])
            _draw_cell(panels[cell.task], x, y, ours, stock, entry.paper)
    figure.supxlabel(
        "percent of demonstrations that succeed when replayed (above: averages); red: below the paper", fontsize=10
    )
    figure.savefig(path, dpi=120)


def _draw_cell(axes, x: int, y: int, ours: float, stock: float, paper: float | None) -> None:
    """Figures in percent."""
    axes.add_patch(_square(x, y, facecolor=colormaps["Blues"](ours / 100), edgecolor=EDGE))
    if paper is not None and ours < paper:
        axes.add_patch(_square(x, y, facecolor="none", edgecolor=BELOW_PAPER, linewidth=2.5))
    text: dict[str, Any] = {"ha": "center", "va": "center", "color": "white" if ours > DARK_PERCENT else "#1c2330"}
    axes.text(x, y - 0.16, shown(ours), fontsize=17, **text)
    axes.text(x, y + 0.24, f"stock {shown(stock)}\npaper {shown(paper)}", fontsize=8, **text)


def _draw_missing(axes, x: int, y: int, paper: float | None) -> None:
    axes.add_patch(_square(x, y, facecolor="none", edgecolor=EDGE, hatch="//"))
    box = {"facecolor": "white", "edgecolor": "none", "pad": 2}
    axes.text(x, y + 0.24, f"paper {shown(paper)}", ha="center", va="center", fontsize=8, color="#566074", bbox=box)


def _square(x: int, y: int, linewidth: float = 0.5, **style: Any) -> Rectangle:
    return Rectangle((x - SIZE / 2, y - SIZE / 2), SIZE, SIZE, linewidth=linewidth, **style)
