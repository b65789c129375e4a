"""The folder of finished cells, one JSON each, all made from the same demonstrations."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cei_converters.benchmark.cells import SOURCE, VARIANTS, Cell, all_cells
from cei_converters.cli.outputs import Output
from cei_converters.cli.result import write_json
from cei_converters.dataset.place import check_parent
from cei_gym.errors import CEIError, one_line

UNSAID: dict[str, Any] = {"source": SOURCE, "perturb": 0}
"""Settings of finished cells that do not say them, as they were made before there was a choice."""


@dataclass(frozen=True)
class Results:
    """Finished cells.

    Attributes:
        folder: where they are.
        seeds: of the demonstrations.
        source: whose they are.
        perturb: how often each is also replayed slightly otherwise.
    """

    folder: Path
    seeds: range
    source: str = SOURCE
    perturb: int = 0

    def path(self, cell: Cell) -> Path:
        """File of a cell."""
        return self.folder / f"{cell.name}.json"

    def settings(self, cell: Cell) -> dict[str, Any]:
        """What a finished cell must have been made with to count."""
        seeds = [self.seeds[0], self.seeds[-1]]
        names = {"task": cell.task, "source": self.source, "target": cell.target, "variant": cell.variant}
        return {"seeds": seeds, **names, "options": VARIANTS[cell.variant], "perturb": self.perturb}

    def read(self, cell: Cell) -> dict[str, Any] | None:
        """A finished cell; None if it is not.

        Raises:
            CEIError: it was made with other settings, or cannot be read.
        """
        return read_cell(self.path(cell), self.settings(cell))

    def read_all(self) -> dict[Cell, dict[str, Any]]:
        """All finished cells.

        Raises:
            CEIError: as for `read`.
        """
        found = {cell: self.read(cell) for cell in all_cells()}
        return {cell: result for cell, result in found.items() if result is not None}

    def write(self, cell: Cell, result: dict[str, Any]) -> None:
        """Keep a cell, in one go."""
        write_json(Output(self.path(cell)), self.settings(cell) | result)


def read_cell(path: Path, settings: Mapping[str, Any]) -> dict[str, Any] | None:
    """A finished cell's file; None if there is none.

    Raises:
        CEIError: it was made with other settings, or cannot be read.
    """
    found = load_cell(path)
    if found is None:
        return None
    for key, ours in settings.items():
        theirs = found.get(key, UNSAID.get(key))
        if theirs != ours:
            raise CEIError(
                f"{path} was made with other settings ({key}: {theirs}, here {ours}); "
                "remove it or choose another folder with --results."
            )
    return found


def fidelity_mean(cell: Mapping[str, Any] | None) -> float | None:
    """How well pads follow in a cell's conversions, from 0 to 1, a mean over episodes; None where nothing was converted. Cells of before called
    it quality."""
    entries: list[dict[str, Any]] = [] if cell is None else cell.get("alignment", [])
    found = [float(entry["fidelity"] if "fidelity" in entry else entry["quality"]) for entry in entries]
    return sum(found) / len(found) if found else None


def source_of(found: Mapping[str, Any]) -> str:
    """Whose demonstrations a finished cell's are."""
    return str(found.get("source", UNSAID["source"]))


def load_cell(path: Path) -> dict[str, Any] | None:
    """A cell's file, whatever it was made with; None if there is none.

    Raises:
        CEIError: it cannot be read.
    """
    try:
        found = json.loads(path.read_text())
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise CEIError(f"{path} cannot be read ({one_line(error)}); remove it.") from error
    return found if isinstance(found, dict) else {}


def check_folders(results: Path, work: Path) -> None:
    """Check that files can be made in both.

    Raises:
        CEIError: one can be no folder, or must not be written to.
    """
    for option, folder in (("--results", results), ("--work", work)):
        check_parent(folder / "x", f"{option}={folder}")


def check_derived(folder: Path, derived: Iterable[str], finished: bool) -> None:
    """Check that what is made of cells replaces nothing else.

    Args:
        folder: for results.
        derived: names of files that are made of all cells, each time anew.
        finished: whether there are finished cells in it.

    Raises:
        CEIError: there are such files but no cell.
    """
    for name in derived:
        if not finished and (folder / name).exists():
            raise CEIError(
                f"{folder / name} is there, but no finished cell, so it may be somebody's; choose other --results."
            )
