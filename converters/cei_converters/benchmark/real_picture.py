"""The real-world table as bars: ours, the sources' own, the paper's."""

from pathlib import Path

from matplotlib.figure import Figure

from cei_converters.benchmark.real_found import Found, of_paper
from cei_converters.benchmark.real_tasks import TASKS

BARS = (
    ("policy on the target", "#1f77b4", ""),
    ("the paper's", "#aec7e8", "//"),
    ("source's own on the source", "#7f7f7f", ""),
    ("the paper's source's own", "#c7c7c7", "//"),
)
"""What each of a task's bars is called, its colour and its hatch."""
WIDTH, PITCH = 0.19, 0.21  # of a bar, and from one to the next; tasks are 1 apart


def draw(found: Found, path: Path) -> None:
    """Draw all tasks that the paper has or that were run; a black line is what was replayed on the target."""
    finished = found.tasks
    tasks = [task for task in TASKS.values() if task.figures is not None or task in finished]
    figure = Figure(figsize=(2 + 1.5 * len(tasks), 4.2), layout="constrained")
    axes = figure.subplots()
    labelled: set[str] = set()
    of_bars = [label for label, _, _ in BARS]

    def once(label: str) -> str | None:
        new = label not in labelled
        labelled.add(label)
        return label if new else None

    for i, task in enumerate(tasks):
        (ours, own), (theirs, their_own) = found.learnt(task), of_paper(task)
        for j, (rate, (label, colour, hatch)) in enumerate(zip((ours, theirs, own, their_own), BARS, strict=True)):
            if rate is not None:
                x = i + (j - 1.5) * PITCH
                axes.bar(x, 100 * rate.share, WIDTH, color=colour, hatch=hatch, edgecolor="white", label=once(label))
                axes.text(x, 100 * rate.share + 1, f"{100 * rate.share:.0f}", ha="center", fontsize=7)
        if (replayed := found.replayed(task)[0]) is not None:
            ends = [i - 2 * PITCH, i + 2 * PITCH]
            axes.plot(ends, [100 * replayed.share] * 2, color="black", lw=1.5, label=once("replayed on the target"))
    axes.set_xticks(range(len(tasks)), [f"{task.name}\n{task.direction}" for task in tasks], fontsize=9)
    axes.set(ylabel="succeed, %", ylim=(0, 112))
    axes.spines[["top", "right"]].set_visible(False)
    handles = sorted(zip(*axes.get_legend_handles_labels(), strict=True), key=lambda each: each[1] not in of_bars)
    figure.legend(*zip(*handles, strict=True), fontsize=8, frameon=False, ncols=5, loc="outside lower center")
    figure.savefig(path, dpi=120)
