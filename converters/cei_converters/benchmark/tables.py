"""Tables of finished cells with the paper's figures: CSV for machines, Markdown for people."""

import csv
from collections.abc import Iterable, Mapping
from math import floor
from pathlib import Path
from typing import Any

from cei_converters.benchmark.cells import END_EFFECTORS, SOURCE, TABLES, TASKS, Cell, Entry, main_entries
from cei_converters.benchmark.marks import mark_of
from cei_gym.embodiment import ARMS

type Found = Mapping[Cell, Mapping[str, Any]]
"""Finished cells: the contents of their JSONs."""

COLUMNS = {
    "main": ["task", "end_effector", "arm", "successes", "episodes", "wilson_low", "wilson_high", "stock_successes"],
    "ablation": ["task", "method", "end_effector", "arm", "successes", "episodes", "wilson_low", "wilson_high"],
    "sensitivity": [
        "representation",
        "task",
        "end_effector",
        "arm",
        "successes",
        "episodes",
        "wilson_low",
        "wilson_high",
    ],
}
FILES = {"main": "replay.csv", "ablation": "ablation.csv", "sensitivity": "sensitivity.csv"}


def percent(replay: Mapping[str, Any]) -> float:
    """Success of a replay's result."""
    return 100 * replay["successes"] / replay["episodes"]


def mean(values: Iterable[float]) -> float | None:
    """The mean of some numbers; None of none."""
    values = list(values)
    return sum(values) / len(values) if values else None


def shown(value: float | None) -> str:
    """A percentage to the nearest whole, halves up as in the paper; `-` where there is none."""
    return "-" if value is None else f"{floor(value + 0.5)}"


def tasks_of(found: Found) -> list[str]:
    """The paper's tasks, and after them those of packages that have a finished cell."""
    return [*TASKS, *sorted({cell.task for cell in found} - {*TASKS})]


def targets_of(task: str) -> list[Entry]:
    """A task's entries of the main table, without the source."""
    return [entry for entry in main_entries(task) if entry.cell.target != SOURCE]


def write_csv(found: Found, folder: Path) -> None:
    """One file a table, one row a finished cell."""
    own = tuple(entry for task in tasks_of(found)[len(TASKS) :] for entry in main_entries(task))
    for table, entries in (TABLES | {"main": (*TABLES["main"], *own)}).items():
        with (folder / FILES[table]).open("w", newline="") as file:
            columns = [*COLUMNS[table], "paper_percent", "failures"]
            writer = csv.DictWriter(file, columns, lineterminator="\n", extrasaction="ignore")
            writer.writeheader()
            writer.writerows(_row(entry, found[entry.cell]) for entry in entries if entry.cell in found)


def _row(entry: Entry, result: Mapping[str, Any]) -> dict[str, Any]:
    replay, stock = result["replay"], result.get("stock_replay")
    low, high = (round(bound, 3) for bound in replay["interval_95"])
    return {
        "task": entry.cell.task,
        "end_effector": entry.cell.end_effector,
        "arm": entry.cell.arm,
        "method": entry.label,
        "representation": entry.label,
        "successes": replay["successes"],
        "episodes": replay["episodes"],
        "wilson_low": low,
        "wilson_high": high,
        "stock_successes": "" if stock is None else stock["successes"],
        "paper_percent": "" if entry.paper is None else entry.paper,
        "failures": "; ".join(f"{reason}: {count}" for reason, count in replay["failures"].items()),
    }


def averages(found: Found, task: str) -> tuple[float | None, float | None, float | None]:
    """A task's ours, stock and paper, percent, over the targets whose cells are finished."""
    entries = [e for e in targets_of(task) if e.cell in found]
    ours = mean(percent(found[e.cell]["replay"]) for e in entries)
    stock = mean(percent(found[e.cell]["stock_replay"]) for e in entries)
    return ours, stock, mean(e.paper for e in entries if e.paper is not None)


def markdown(found: Found) -> str:
    """All tables, percent of demonstrations that succeed."""
    commits = sorted({str(result["commit"]) for result in found.values()})
    episodes = sorted({result["replay"]["episodes"] for result in found.values()})
    return "\n\n".join(
        [
            "# Replay of transferred demonstrations",
            f"Percent of {' or '.join(map(str, episodes))} demonstrations that succeed: ours with the declared physics "
            "exceptions / ours with the hands' stock physics / the paper's. Averages are over the cells that are finished.",
            _summary(found),
            *(part for task in tasks_of(found) for part in (f"## {task}", _grid(found, task))),
            *_perturbed(found),
            "## Ablation: ours / the paper's",
            _ablation(found),
            "## Sensitivity to the representation: ours / the paper's",
            _sensitivity(found),
            f"Measured at {mark_of(FILES['main'], commits)}.",
        ]
    )


def _summary(found: Found) -> str:
    rows = []
    for task in tasks_of(found):
        finished = sum(entry.cell in found for entry in targets_of(task))
        source = found.get(Cell(task, SOURCE))
        sources = "-" if source is None else f"{source['replay']['successes']} of {source['replay']['episodes']}"
        rows.append([task, *map(shown, averages(found, task)), f"{finished} of 16", sources])
    return _table(["average", "ours", "stock", "paper", "cells", "the source itself"], rows)


def _grid(found: Found, task: str) -> str:
    figures = {entry.cell: entry.paper for entry in targets_of(task)}
    rows = []
    for end_effector in END_EFFECTORS:
        cells = [Cell(task, f"{arm}-{end_effector}") for arm in ARMS]
        rows.append([end_effector, *(_three(found.get(cell), figures[cell]) for cell in cells)])
    return _table(["", *ARMS], rows)


def _perturbed(found: Found) -> list[str]:
    """Which share of perturbed replays succeeds, where they were asked for."""
    held = {cell: result["replay"]["perturbed"] for cell, result in found.items() if result["replay"].get("perturbed")}
    if not held:
        return []
    rows = []
    for task in dict.fromkeys(cell.task for cell in held):
        cells = [entry.cell for entry in targets_of(task) if entry.cell in held]
        share = mean(100 * held[cell]["share"] for cell in cells)
        rows.append(
            [
                task,
                f"{len(cells)} of 16",
                shown(share),
                shown(min((100 * held[cell]["share"] for cell in cells), default=None)),
            ]
        )
    count = next(iter(held.values()))["replays"]
    return [
        "## Slightly otherwise",
        f"Percent of {count} replays of each demonstration that succeed with objects, friction and joints a little otherwise (`cei-replay --perturb`).",
        _table(["", "cells", "average", "least"], rows),
    ]


def _three(result: Mapping[str, Any] | None, paper: float | None) -> str:
    ours, stock = (None if result is None else percent(result[key]) for key in ("replay", "stock_replay"))
    return " / ".join(map(shown, (ours, stock, paper)))


def _two(found: Found, entries: list[Entry]) -> str:
    """Average over entries, where all are finished, and the paper's."""
    finished = all(entry.cell in found for entry in entries)
    ours = mean(percent(found[entry.cell]["replay"]) for entry in entries) if finished else None
    return f"{shown(ours)} / {shown(mean(e.paper for e in entries if e.paper is not None))}"


def _ablation(found: Found) -> str:
    entries = TABLES["ablation"]
    targets, labels = (list(dict.fromkeys(x)) for x in ((e.cell.target for e in entries), (e.label for e in entries)))
    rows = []
    for task in TASKS:
        for label in labels:
            row = [e for e in entries if (e.cell.task, e.label) == (task, label)]
            rows.append([task, label, *(_two(found, [entry]) for entry in row), _two(found, row)])
    return _table(["task", "method", *targets, "average"], rows)


def _sensitivity(found: Found) -> str:
    entries = TABLES["sensitivity"]
    cell = entries[0].cell
    row = [f"{cell.task}, {cell.target}", *(_two(found, [entry]) for entry in entries)]
    return _table(["", *(entry.label for entry in entries)], [row])


def _table(header: list[str], rows: list[list[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
