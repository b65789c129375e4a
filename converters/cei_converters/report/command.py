"""`cei-report`: one self-contained page about a conversion, for anybody's dataset."""

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cei_converters.cli import DatasetConfig, run
from cei_converters.cli.options import check_range
from cei_converters.view.command import MappedSourceConfig
from cei_gym.errors import CEIError

if TYPE_CHECKING:
    from cei_converters.report.episodes import Episode
    from cei_converters.report.shown import Shown
    from cei_converters.sources.source import Source

EXAMPLE = """example:
  cei-report --dataset.repo_id=me/pick_iiwa --dataset.root=data/pick_iiwa --output=report.html
  cei-replay --dataset.repo_id=me/pick_iiwa --dataset.root=data/pick_iiwa --json=replay.json
  cei-report --dataset.repo_id=me/pick_iiwa --dataset.root=data/pick_iiwa \\
      --source.repo_id=me/pick_panda --source.root=data/pick_panda \\
      --replay=replay.json --films --output=report.html"""


@dataclass
class ReportConfig:
    """One page about a conversion: its episodes and why they are what they are, films, residuals, corrections, what was assumed and left out."""

    dataset: DatasetConfig
    output: Path  # HTML file to write.
    source: MappedSourceConfig = field(default_factory=MappedSourceConfig)  # Shown beside it.
    # Results of cei-replay --json, of the dataset or its source; two are separated by a colon.
    replay: list[Path] | None = None
    films: bool = False  # Film the episodes that are shown: in their simulation, or drawn where there is none.
    worst: int = 3  # How many of the worst episodes are shown, beside the best one.
    package_path: list[Path] | None = None  # Folders to look for robots' ROS packages in, separated by colons.
    json: Path | None = None  # File for the result as JSON.
    overwrite: bool = False  # Replace files that are there already.

    def __post_init__(self) -> None:
        check_range("--worst", self.worst, 0, 50)


def report(config: ReportConfig, commands: Sequence[str] = ()) -> dict[str, Any]:
    """Write the page.

    Args:
        config: of what, and where to.
        commands: what does the same by hand; default: those that the datasets say they were made by.

    Returns:
        What is on it: episodes that are shown, and why, and what is not known.

    Raises:
        CEIError: bad options or data, results of other datasets, or a file that must not be replaced.
    """
    from cei_converters.cli.outputs import JSON, PAGE, Outputs
    from cei_converters.cli.progress import progress_bar
    from cei_converters.cli.result import write_json
    from cei_converters.report.contents import Found, contents
    from cei_converters.report.episodes import episodes
    from cei_converters.report.films import open_films
    from cei_converters.report.page import render
    from cei_converters.report.replays import load_replay, sort_replays
    from cei_converters.report.shown import clouds, show
    from cei_converters.report.summary import Summary
    from cei_converters.sources.formats import open_source
    from cei_converters.sources.reader import DatasetReader
    from cei_gym.embodiment import use_package_path

    use_package_path(config.package_path)
    outputs = Outputs(config.overwrite)
    output, json = outputs.file("--output", config.output, PAGE), outputs.file("--json", config.json, JSON)
    assert output is not None
    replays = [load_replay(path) for path in config.replay or ()]
    reader, source = DatasetReader(config.dataset.repo_id, config.dataset.root), None
    if not len(reader):
        raise CEIError(f"{reader.repo_id} has no episode to report on.")
    if config.source.repo_id is not None:
        source = open_source(config.source.repo_id, config.source.root, joint_map=config.source.joint_map)
    replay, of_source = sort_replays(replays, reader, source)
    with contextlib.ExitStack() as stack:
        progress = stack.enter_context(progress_bar("episodes"))
        task = progress.add_task("reading records", total=len(reader))

        def counted() -> "Iterator[Episode]":
            for episode in episodes(reader, replay):
                yield episode
                progress.advance(task)

        summary = Summary.of(counted())
        films, unfilmed = stack.enter_context(open_films(reader, source)) if config.films else (None, "")
        shown: list[Shown] = []
        seen, unseen = None, list[str]()
        chosen = summary.shown(config.worst)
        progress.reset(task, total=len(chosen), description="drawing and filming" if films else "drawing")
        for episode in chosen:
            best = episode is chosen[-1] and len(chosen) > 1
            try:
                made, view = show(reader, source, episode, best, films)
            except CEIError as error:
                if not _merged(reader):  # whose episodes may be of another source
                    raise
                unseen.append(str(error))
                made, view = show(reader, None, episode, best, films)
            shown.append(made)
            seen = clouds(view) if episode is chosen[-1] else seen
            progress.advance(task)
    found = Found(reader, source, summary, (replay, of_source), shown, seen, config.films, [unfilmed, *unseen])
    page = contents(found, commands)
    with output.whole() as partial:
        partial.write_text(render(page))
    result = {
        "repo_id": reader.repo_id,
        "output": str(output),
        "episodes": summary.count,
        "successes": None if replay is None else replay.successes,
        "shown": [{"episode": each.index, "fidelity": each.fidelity, "why": each.why()} for each in chosen],
        "films": sum(each.film is not None for each in shown),
        "unknown": page["unknown"],
    }
    write_json(json, result)
    print(f"Wrote {output}: {reader.repo_id}, {summary.count} episodes, {len(shown)} shown. Open it in a browser.")
    for line in page["unknown"]:
        print(f"not known: {line}")
    return result


def _merged(reader: "Source") -> bool:
    return reader.metadata is not None and bool(reader.metadata.merged)


def main(args: list[str] | None = None) -> int:
    """Entry point of `cei-report`."""
    return run(ReportConfig, report, args, prog="cei-report", example=EXAMPLE)
