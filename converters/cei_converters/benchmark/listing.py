"""`cei-benchmark results`: which figures are older than the code that they measure. `make results` runs it."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from cei_converters.benchmark.ages import Aged, ages, shortened
from cei_converters.benchmark.figures import Manifest
from cei_converters.benchmark.keeping import fill
from cei_converters.benchmark.marks import documents, marked
from cei_converters.cli import run
from cei_converters.cli.table import PIPE_WIDTH
from cei_gym.errors import CEIError

EXAMPLE = """example:
  cei-benchmark results
  cei-benchmark results --mark
  cei-benchmark results --strict"""
FEW = 3  # changed files of a figure that are named without --every


@dataclass
class ResultsConfig:
    """Figures of a checkout and what has changed since they were measured: code, or libraries."""

    results: Path = Path("results")  # The checkout's folder of results.
    every: bool = False  # Name every changed file, not the first few.
    strict: bool = False  # Fail if a figure is older than what it measures.
    mark: bool = False  # Bring the marks in documents up to date.
    fill: bool = False  # Take from git the code of figures that have a command and a commit, but no code.


def list_results(config: ResultsConfig) -> None:
    """Print the table.

    Raises:
        CEIError: a file belongs to no figure; or, with `strict`, a figure is older than what it measures.
    """
    root = config.results.resolve().parent
    if config.fill:
        for folder in sorted(filter(Path.is_dir, config.results.iterdir())):
            if count := fill(Manifest.read(folder), root):
                print(f"{folder}: {count} filled in.")
    found = ages(config.results)
    _print(found, config.every)
    _mark(root, found, config.mark)
    older = [each for each in found if each.is_older]
    print(f"{len(older)} of {len(found)} figures are older than what they measure.")
    if config.strict and older:
        raise CEIError(f"{len(older)} of {len(found)} figures are older than what they measure, see above.")


def _print(found: Sequence[Aged], every: bool) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title="Results")
    for name in ("figure", "command", "commit", "date", "seeds", "since then"):
        table.add_column(name, overflow="fold")
    for each in found:
        figure = each.figure
        commits = " ".join(map(shortened, each.commits))
        seeds = "" if figure.seeds is None else f"{figure.seeds[0]}-{figure.seeds[1]}"
        files = f"{each.folder.name}/{', '.join(_few(figure.files, every))}"
        since = "\n".join(_few(each.changed, every)) if each.is_older else "[green]the same[/]"
        table.add_row(files, figure.command, commits, figure.date or "", seeds, since)
    console = Console(width=None if sys.stdout.isatty() else PIPE_WIDTH)
    console.print(table)


def _few(names: Sequence[str], every: bool) -> list[str]:
    shown = names if every or len(names) <= FEW + 1 else names[:FEW]
    return [*shown, *([f"and {len(names) - len(shown)} more"] if len(names) > len(shown) else [])]


def _mark(root: Path, found: Sequence[Aged], write: bool) -> None:
    """Rewrite documents whose marks are not as they should be, or name them."""
    for document in documents(root):
        text = marked(document, found)
        if text != document.read_text():
            if write:
                document.write_text(text)
            said = "marked" if write else "marks are out of date; make results RESULTS_ARGS=--mark"
            print(f"{document.relative_to(root)}: {said}.")


def main(args: list[str] | None = None) -> int:
    """Entry point of `cei-benchmark results`."""
    return run(ResultsConfig, list_results, args, prog="cei-benchmark results", example=EXAMPLE)
