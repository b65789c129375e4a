"""Targets that are not the paper's: any embodiment, of the catalogue or of one's own; their cells, and the table of them."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from cei_converters.benchmark.cells import TARGETS, TASKS, Cell, own_tasks
from cei_converters.benchmark.marks import mark_of
from cei_converters.benchmark.results import Results
from cei_gym.embodiment import check_embodiment, load_embodiment
from cei_gym.errors import unknown

type Found = Mapping[Cell, Mapping[str, Any]]
"""Finished cells: the contents of their JSONs."""

REPORT, DATA = "replay.md", "replay.json"


def beyond_the_paper(targets: str | None) -> list[str]:
    """The targets of a list such as `a,b`, if one of them is not the paper's; else none.

    Raises:
        CEIError: there is no such embodiment, or its description is refused.
    """
    names = [] if targets is None else [name.strip() for name in targets.strip("[] ").split(",")]
    if all(name in TARGETS for name in names):
        return []
    for name in names:
        check_embodiment(name, "target")
        load_embodiment(name)
    return list(dict.fromkeys(names))


def robot_cells(tasks: str | None, targets: Iterable[str], source: str) -> list[Cell]:
    """A cell for each target in each task (a list such as `a,b`; None for all of the paper's), and the source's own.

    Raises:
        CEIError: there is no such task.
    """
    valid = (*TASKS, *own_tasks())
    wanted = list(TASKS) if tasks is None else [name.strip() for name in tasks.strip("[] ").split(",")]
    for name in wanted:
        if name not in valid:
            raise unknown("task", name, valid)
    return [Cell(task, target) for task in dict.fromkeys(wanted) for target in dict.fromkeys([source, *targets])]


def finished_robots(results: Results) -> Found:
    """All finished cells in a folder.

    Raises:
        CEIError: one was made with other settings, or cannot be read.
    """
    found: dict[Cell, Mapping[str, Any]] = {}
    for path in sorted(results.folder.glob("*-*-*.json")):
        task, _, target = path.stem.partition("-")
        if target.count("-") == 1 and (result := results.read(cell := Cell(task, target))) is not None:
            found[cell] = result
    return found


def rows(found: Found, source: str) -> list[dict[str, Any]]:
    """A row for each cell, as JSON types: the source first in each task. Seconds are those of converting and replaying all episodes."""
    listed: list[dict[str, Any]] = []
    for cell in sorted(found, key=lambda cell: (cell.task, cell.target != source, cell.target)):
        replay, alignment = found[cell]["replay"], found[cell].get("alignment", [])
        qualities = [episode["quality"] for episode in alignment]
        listed.append(
            {
                "task": cell.task,
                "embodiment": cell.target,
                "successes": replay["successes"],
                "episodes": replay["episodes"],
                "interval_95": [round(bound, 3) for bound in replay["interval_95"]],
                "quality_mean": round(sum(qualities) / len(qualities), 3) if qualities else None,
                "seconds": round(sum(found[cell]["seconds"].values()), 1),
                "failures": replay["failures"],
            }
        )
    return listed


def robots_markdown(rows: Sequence[Mapping[str, Any]], source: str, commits: Iterable[str]) -> str:
    """The table, for people."""
    lines = [
        ["task", "embodiment", "success", "95 % (Wilson)", "quality", "seconds", "failures"],
        ["---"] * 7,
        *(
            [
                row["task"],
                row["embodiment"] + (" (source)" if row["embodiment"] == source else ""),
                f"{row['successes']} of {row['episodes']}",
                "{:.0%} to {:.0%}".format(*row["interval_95"]),
                "-" if row["quality_mean"] is None else f"{row['quality_mean']:.2f}",
                f"{row['seconds']:.0f}",
                ", ".join(f"{reason}: {count}" for reason, count in row["failures"].items()) or "-",
            ]
            for row in rows
        ),
    ]
    table = "\n".join("| " + " | ".join(line) + " |" for line in lines)
    return "\n\n".join(
        [
            "# Replay of transferred demonstrations",
            f"Demonstrations of {source}, converted for each robot and replayed in physics from the same starts. Quality is the conversion's, 0 to 1,"
            " a mean over episodes; seconds are those of converting and replaying all of them on one core.",
            table,
            f"Measured at {mark_of(DATA, sorted(set(commits)))}.",
        ]
    )
