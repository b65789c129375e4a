"""What there is to run: a cell is a task, a target and a variant of the method; tables are made of cells."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass

from cei_converters.benchmark import paper
from cei_gym.embodiment import ARMS
from cei_gym.errors import CEIError, unknown

SOURCE = "Panda-PandaGripper"
TASKS = tuple(paper.REPLAY)
END_EFFECTORS = tuple(paper.REPLAY[TASKS[0]])
TARGETS = tuple(f"{arm}-{end_effector}" for end_effector in END_EFFECTORS for arm in ARMS)
NO_DIRECTION, NO_CONTACT = ["--solver.lambda_m=0"], ["--contact.opposition_weight=0", "--contact.squeeze_m=0"]
VARIANTS: dict[str, list[str]] = {
    "cei": [],
    "bms": ["--transfer.method=bms"],
    "no_direction": NO_DIRECTION,
    "no_contact": NO_CONTACT,
    "no_direction_no_contact": [*NO_DIRECTION, *NO_CONTACT],
    "reduced": ["--transfer.representation=reduced"],
    "dropped": ["--transfer.representation=dropped"],
    "refined": ["--refine"],
}
"""Options of `cei-convert` that differ from the defaults."""


@dataclass(frozen=True)
class Cell:
    """Demonstrations of one task, transferred to one target by one variant."""

    task: str
    target: str
    variant: str = "cei"

    @property
    def name(self) -> str:
        """The name of its file and folder."""
        return f"{self.task}-{self.target}" + (f"-{self.variant}" if self.variant != "cei" else "")

    @property
    def arm(self) -> str:
        """The target's arm."""
        return self.target.split("-")[0]

    @property
    def end_effector(self) -> str:
        """The target's end-effector."""
        return self.target.split("-")[1]


@dataclass(frozen=True)
class Entry:
    """A cell's place in a table: under which label, beside which figure of the paper (percent, if it has one)."""

    cell: Cell
    label: str
    paper: float | None


def main_entries(task: str) -> Iterable[Entry]:
    """A task's part of the main table: the source itself, and each target."""
    yield Entry(Cell(task, SOURCE), "source", None)
    for target in TARGETS:
        cell = Cell(task, target)
        yield Entry(cell, "CEI", paper.REPLAY[task][cell.end_effector][cell.arm] if task in TASKS else None)


def _ablation() -> Iterable[Entry]:
    # The contact stage looks at normals too, so what direction is worth shows only where that is gone as well.
    methods = {
        "bms": "BMS",
        "no_direction": "without direction",
        "no_contact": "without contact",
        "no_direction_no_contact": "without direction and contact",
        "cei": "CEI",
    }
    for task in TASKS:
        for variant, label in methods.items():
            figures = paper.ABLATION[task].get(label, (None,) * len(paper.ABLATION_TARGETS))
            for target, figure in zip(paper.ABLATION_TARGETS, figures, strict=True):
                yield Entry(Cell(task, target, variant), label, figure)


def _sensitivity() -> Iterable[Entry]:
    target = f"{ARMS[0]}-{paper.SENSITIVITY_END_EFFECTOR}"
    for variant, (label, figure) in zip(("cei", "reduced", "dropped"), paper.SENSITIVITY.items(), strict=True):
        yield Entry(Cell(paper.SENSITIVITY_TASK, target, variant), label, figure)


TABLES = {
    "main": tuple(entry for task in TASKS for entry in main_entries(task)),
    "ablation": tuple(_ablation()),
    "sensitivity": tuple(_sensitivity()),
}
"""Those of the paper."""


def own_tasks() -> list[str]:
    """Tasks that the paper's tables do not have: the project's others, and those that installed packages add.

    They go into the main table, without a figure of the paper, where they are asked for beside the paper's.
    """
    from cei_converters.simulation.environment import task_names

    return [name for name in task_names() if name not in TASKS]


def all_cells() -> list[Cell]:
    """Every cell of every table, each once, and those of tasks that the paper does not have."""
    of_paper = (entry.cell for table in TABLES.values() for entry in table)
    return list(dict.fromkeys([*of_paper, *(entry.cell for task in own_tasks() for entry in main_entries(task))]))


def select(tables: str | None, tasks: str | None, targets: str | None) -> list[Cell]:
    """Cells of some tables, tasks and targets (lists such as `a,b`; None for all of the paper's); the source comes with the main table.

    Raises:
        CEIError: an unknown name (the message lists the valid ones), or nothing is left.
    """
    wanted, wanted_tasks = listed("table", tables, TABLES), listed_tasks(tasks)
    wanted_targets = [SOURCE, *listed("target", targets, TARGETS)]
    entries = [entry for name in wanted for entry in TABLES[name]]
    if "main" in wanted:
        entries += [entry for task in wanted_tasks if task not in TASKS for entry in main_entries(task)]
    cells = {e.cell: None for e in entries if e.cell.task in wanted_tasks and e.cell.target in wanted_targets}
    if not cells:
        there = (dict.fromkeys(names) for names in zip(*((e.cell.task, e.cell.target) for e in entries), strict=True))
        raise CEIError(f"--tables={tables} has none of these cells. It has: {'; '.join(map(', '.join, there))}.")
    return list(cells)


def listed(kind: str, text: str | None, valid: Collection[str]) -> list[str]:
    """The names of a list such as `a,b`, each once; all that are valid where there is none.

    Args:
        kind: what they are names of, for the message.
        text: the list.
        valid: names that there are.

    Raises:
        CEIError: a name is not valid; the message lists those that are.
    """
    names = [*valid] if text is None else split(text)
    for name in names:
        if name not in valid:
            raise unknown(kind, name, valid)
    return names


def listed_tasks(tasks: str | None) -> list[str]:
    """The tasks of a list, of whatever there are environments of; the paper's where there is none.

    Raises:
        CEIError: there is no such task.
    """
    return [*TASKS] if tasks is None else listed("task", tasks, (*TASKS, *own_tasks()))


def split(text: str) -> list[str]:
    """The names of a list such as `a,b` or `[a, b]`, each once."""
    return list(dict.fromkeys(name.strip() for name in text.strip("[] ").split(",")))
