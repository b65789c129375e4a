"""Targets, sources and tasks that the paper does not have: any embodiment, of the catalogue or of one's own; their cells, and the table of them."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from cei_converters.benchmark.cells import SOURCE, TARGETS, TASKS, Cell, listed_tasks, split
from cei_converters.benchmark.marks import mark_of
from cei_converters.benchmark.results import Results, fidelity_mean, load_cell, source_of
from cei_gym.embodiment import check_embodiment, load_embodiment

type Found = Mapping[Cell, Mapping[str, Any]]
"""Finished cells: the contents of their JSONs."""

REPORT, DATA = "replay.md", "replay.json"
REFINED = "refined"


def beyond_the_paper(targets: str | None, tasks: str | None, source: str, refine: bool = False) -> list[str]:
    """The targets of a list such as `a,b` (default: the paper's sixteen), if the paper's tables have no place for them; else none.

    Args:
        targets: the list.
        tasks: a list of tasks; the paper's tables have a place for others only beside one of their own.
        source: whose demonstrations they are.
        refine: whether they are refined, too, which the paper does not.

    Raises:
        CEIError: there is no such embodiment, or its description is refused.
    """
    names = [*TARGETS] if targets is None else split(targets)
    of_paper = tasks is None or any(task in TASKS for task in listed_tasks(tasks))
    if of_paper and not refine and source == SOURCE and all(name in TARGETS for name in names):
        return []
    for name in names:
        if name not in TARGETS:
            check_embodiment(name, "target")
            load_embodiment(name)
    return names


def robot_cells(tasks: str | None, targets: Iterable[str], source: str, refine: bool = False) -> list[Cell]:
    """A cell for each target in each task (a list such as `a,b`; None for all of the paper's), and the source's own; if `refine` each target's
    refined, too.

    Raises:
        CEIError: there is no such task.
    """
    names, targets = listed_tasks(tasks), [*dict.fromkeys([source, *targets])]
    refined = [Cell(task, target, REFINED) for task in names for target in targets if refine and target != source]
    return [Cell(task, target) for task in names for target in targets] + refined


def finished_robots(results: Results) -> Found:
    """All finished cells in a folder, of whatever source.

    Raises:
        CEIError: one was made with other settings, or cannot be read.
    """
    found: dict[Cell, Mapping[str, Any]] = {}
    for path in sorted(results.folder.glob("*-*-*.json")):
        loaded = load_cell(path) or {}
        cell = Cell(str(loaded.get("task")), str(loaded.get("target")), str(loaded.get("variant")))
        if path.stem != cell.name or cell.variant not in ("cei", REFINED):  # another variant, or another benchmark's
            continue
        if (result := replace(results, source=source_of(loaded)).read(cell)) is not None:
            found[cell] = result
    return found


def rows(found: Found) -> list[dict[str, Any]]:
    """A row for each cell, as JSON types: the source first in each task. Seconds are those of converting and replaying all episodes."""
    listed: list[dict[str, Any]] = []
    order = {
        cell: (cell.task, cell.target != source_of(result), cell.target, cell.variant) for cell, result in found.items()
    }
    for cell in sorted(found, key=lambda cell: order[cell]):
        replay, fidelity = found[cell]["replay"], fidelity_mean(found[cell])
        listed.append(
            {
                "task": cell.task,
                "source": source_of(found[cell]),
                "embodiment": cell.target,
                "refined": cell.variant == REFINED,
                "successes": replay["successes"],
                "episodes": replay["episodes"],
                "interval_95": [round(bound, 3) for bound in replay["interval_95"]],
                "perturbed": replay.get("perturbed"),
                "fidelity_mean": None if fidelity is None else round(fidelity, 3),
                "seconds": round(sum(found[cell]["seconds"].values()), 1),
                "failures": replay["failures"],
            }
        )
    return listed


def robots_markdown(rows: Sequence[Mapping[str, Any]], commits: Iterable[str]) -> str:
    """The table, for people, below one of tasks by robots where there are several."""
    columns: dict[str, Callable[[Mapping[str, Any]], str]] = {
        "task": lambda row: row["task"],
        "embodiment": lambda row: row["embodiment"] + (" (source)" if row["embodiment"] == row["source"] else ""),
        "conversion": lambda row: "refined" if row["refined"] else "plain",
        "success": lambda row: f"{row['successes']} of {row['episodes']}",
        "95 % (Wilson)": lambda row: "{:.0%} to {:.0%}".format(*row["interval_95"]),
        "perturbed": lambda row: "-" if row["perturbed"] is None else _held(row["perturbed"]),
        "fidelity": lambda row: "-" if row["fidelity_mean"] is None else f"{row['fidelity_mean']:.2f}",
        "seconds": lambda row: f"{row['seconds']:.0f}",
        "failures": lambda row: ", ".join(f"{reason}: {count}" for reason, count in row["failures"].items()) or "-",
    }
    refined, perturbed = any(row["refined"] for row in rows), [row["perturbed"] for row in rows if row["perturbed"]]
    if not refined:
        del columns["conversion"]
    if not perturbed:
        del columns["perturbed"]
    lines = [[*columns], ["---"] * len(columns), *([text(row) for text in columns.values()] for row in rows)]
    about = (
        f"Demonstrations of {_sources(rows)}, converted for each robot and replayed in physics from the same starts. Fidelity is how well pads follow, 0 to 1,"
        " a mean over episodes; seconds are those of converting and replaying all of them on one core."
    )
    if refined:
        about += " Refined ones were searched a correction by rollouts (`--refine`) where they fail or are fragile."
    if perturbed:
        about += (
            f" Perturbed is the share of {perturbed[0]['replays']} replays each that succeed with objects, friction and joints a little otherwise "
            "(`cei-replay --perturb`), none of which anything was chosen by."
        )
    return "\n\n".join(
        [
            "# Replay of transferred demonstrations",
            about,
            *_overview(rows),
            _table(lines),
            f"Measured at {mark_of(DATA, sorted(set(commits)))}.",
        ]
    )


def _held(perturbed: Mapping[str, Any]) -> str:
    return "{:.0%} ({:.0%} to {:.0%})".format(perturbed["share"], *perturbed["interval_95"])


def _sources(rows: Sequence[Mapping[str, Any]]) -> str:
    """Whose demonstrations they are, and in which tasks if not in all."""
    tasks = {
        source: [*dict.fromkeys(row["task"] for row in rows if row["source"] == source)] for source in sources(rows)
    }
    return " and ".join(f"{each} ({', '.join(tasks[each])})" if len(tasks) > 1 else each for each in tasks)


def sources(rows: Iterable[Mapping[str, Any]]) -> list[str]:
    """The sources of rows, each once."""
    return [*dict.fromkeys(row["source"] for row in rows)]


def _overview(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Successes of robots by tasks, as Markdown; nothing of one task."""
    tasks = [*dict.fromkeys(row["task"] for row in rows)]
    if len(tasks) == 1:
        return []
    found = {(row["embodiment"], row["task"], row["refined"]): row for row in rows}

    def cell(robot: str, task: str) -> str:
        plain, refined = (found.get((robot, task, refined)) for refined in (False, True))
        figures = [f"{row['successes']}/{row['episodes']}" for row in (plain, refined) if row is not None]
        return ", ".join(figures) + (" *" if plain is not None and robot == plain["source"] else "")

    lines = [[robot, *(cell(robot, task) for task in tasks)] for robot in dict.fromkeys(robot for robot, _, _ in found)]
    refined = " The second of two figures is of refined conversions." if any(row["refined"] for row in rows) else ""
    return [_table([["", *tasks], ["---"] * (1 + len(tasks)), *lines]), f"`*`: the source itself.{refined}"]


def _table(lines: Iterable[Iterable[str]]) -> str:
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
