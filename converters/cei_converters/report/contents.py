"""What is on the page, by the names that its template knows."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from statistics import mean, median
from typing import Any

from cei_converters.dataset.essentials import Remains
from cei_converters.dataset.metadata import Metadata
from cei_converters.dataset.provenance import git_commit
from cei_converters.report.about import about, sources
from cei_converters.report.page import PNG, Medium
from cei_converters.report.plots import plot_residuals
from cei_converters.report.replays import Replay
from cei_converters.report.shown import Shown
from cei_converters.report.summary import Summary
from cei_converters.report.table import table
from cei_converters.sources.reader import DatasetReader
from cei_converters.sources.source import Source


@dataclass(frozen=True)
class Found:
    """All that a report knows.

    Attributes:
        reader: of the dataset.
        source: of what it was converted from, if that is shown.
        summary: of the episodes.
        replays: of the dataset, and of its source; None where there is none.
        shown: the worst episodes, and last the best.
        clouds: point clouds of one.
        films: whether films were asked for.
        missed: what could not be shown, a line each; "" for nothing.
    """

    reader: DatasetReader
    source: Source | None
    summary: Summary
    replays: tuple[Replay | None, Replay | None]
    shown: Sequence[Shown]
    clouds: Medium | None
    films: bool
    missed: Sequence[str]


def contents(found: Found, commands: Sequence[str] = ()) -> dict[str, Any]:
    """The page's contents; `commands` are what does the same by hand, if it is not what the dataset says."""
    reader, summary = found.reader, found.summary
    metadata = reader.metadata
    assert metadata is not None  # without, no embodiment would be known
    size = f"{_counted(summary.count, 'episode')}, {summary.frames} frames at {reader.fps:g} Hz"
    told = about(reader, metadata, None if found.source is None else found.source.metadata, size)
    columns, rows = table(summary.rows())
    replays = [each for each in reversed(found.replays) if each is not None]  # the source first
    series = [each.series for each in found.shown if each.series is not None]
    residuals = None
    if series:
        residuals = Medium(PNG, plot_residuals(series), "How far the target's pads are from the source's.")
    robots, films = sources(metadata), [each.film for each in found.shown if each.film is not None]
    corrections = [(e.index, _held(e.held), str(e.corrected.correction)) for e in summary.corrected if e.corrected]
    page: dict[str, Any] = {
        "title": f"{' and '.join(robots)} to {metadata.embodiment}"
        if robots
        else f"{metadata.embodiment}, as recorded",
        "lead": _lead(found, metadata, robots),
        "tiles": _tiles(found),
        "replays": [_replay_row(each) for each in replays],
        "films": films,
        "columns": columns,
        "rows": rows,
        "cut": summary.count if summary.count > len(rows) else 0,
        "shown": found.shown,
        "shown_title": "The worst episodes, and the best" if len(found.shown) > 1 else "An episode",
        "residuals": residuals,
        "clouds": found.clouds,
        "common": told.common,
        "corrections": corrections,
        "assumed": told.assumed,
        "rules": list(dict.fromkeys(rule for each in replays for rule in each.rules)),
        "dropped": [*told.dropped, *_not_converted(found)],
        "unknown": _unknown(found, metadata),
        "commands": list(commands) or told.commands,
        "facts": told.facts,
        "options": told.options,
        "version": version("cei-gym"),
        "commit": f", commit {commit}" if (commit := git_commit()) else "",
        "date": datetime.now(UTC).strftime("%d %B %Y"),
    }
    page["parts"] = [(id_, name) for id_, name, there in _parts(page) if there]
    return page


def _parts(page: dict[str, Any]) -> list[tuple[str, str, bool]]:
    return [
        ("replays", "Replays", bool(page["replays"])),
        ("films", "Films", bool(page["films"])),
        ("episodes", "Episodes", True),
        ("worst", page["shown_title"], True),
        ("clouds", "Clouds", page["clouds"] is not None),
        ("corrections", "Corrections", bool(page["common"] or page["corrections"])),
        ("assumed", "Assumed", True),
        ("dropped", "Left out", True),
        ("unknown", "Not known", True),
        ("made", "How it was made", True),
    ]


def _lead(found: Found, metadata: Metadata, robots: Sequence[str]) -> str:
    n, robot = _counted(found.summary.count, "demonstration"), metadata.embodiment
    if not robots:
        return f"{n} of {robot}, recorded, not converted."
    return f"{n} of {' and '.join(robots)} became demonstrations of {robot}, whose pads go where the source's were."


def _tiles(found: Found) -> list[tuple[str, str]]:
    summary, (replay, _) = found.summary, found.replays
    tiles = [(str(summary.count), "episodes" if summary.count != 1 else "episode")]
    if replay is not None:
        tiles.append((f"{replay.successes} of {len(replay.episodes)}", "succeed when replayed"))
        if (held := replay.held) is not None:
            tiles.append((f"{held['share']:.0%}", "of replays slightly otherwise succeed"))
    if summary.qualities:
        known = "" if len(summary.qualities) == summary.count else f", of {len(summary.qualities)} of which it is known"
        tiles.append((f"{mean(summary.qualities):.0%}", f"likely work, in the mean{known}"))
    if summary.fidelities:
        tiles.append((f"{median(summary.fidelities):.2f}", "median fidelity, 0 to 1"))
    if summary.distances_mm:
        tiles.append((f"{mean(summary.distances_mm):.1f} mm", "between pads, in the mean"))
    plain, kept, n = summary.held
    if n:
        tiles.append((f"{plain / n:.0%} → {kept / n:.0%}", "held while refined, plain → kept"))
    return tiles


def _replay_row(replay: Replay) -> list[str]:
    low, high = replay.interval
    held = replay.held
    otherwise = "not tried"
    if held is not None:
        otherwise = "{:.0%} ({:.0%} to {:.0%})".format(held["share"], *held["interval_95"])
    rate = f"{replay.successes} of {len(replay.episodes)}"
    return [replay.embodiment, replay.env, rate, f"{low:.0%} to {high:.0%}", otherwise, replay.failures]


def _not_converted(found: Found) -> list[str]:
    """Episodes of the source that are not in the dataset, where there is one source."""
    metadata = found.reader.metadata
    if found.source is None or metadata is None or metadata.merged or metadata.provenance.source is None:
        return []
    used = {found.reader.source_episode(index) for index in range(len(found.reader))}
    missing = len(found.source) - len(used)
    return (
        [f"{_counted(missing, 'episode')} of the source's {len(found.source)} are not in the dataset."]
        if missing
        else []
    )


def _unknown(found: Found, metadata: Metadata) -> list[str]:
    """What is not known, and what would tell."""
    summary, (replay, _), environment = found.summary, found.replays, metadata.environment.id
    said = []
    if isinstance(metadata, Remains):
        said.append("How it came about: it was edited by a tool that lost that; cei-restore gives it back.")
    if replay is None:
        tell = (
            "cei-replay --json=FILE, and --replay=FILE here"
            if environment
            else "it names no environment to replay it in"
        )
        said.append(f"Whether episodes succeed in simulation: {tell}.")
    elif len(replay.episodes) < summary.count:
        said.append(f"Whether those succeed that were not replayed: {summary.count - len(replay.episodes)} episodes.")
    if unlikely := summary.count - len(summary.qualities):
        said.append(
            f"How likely episodes work, of {unlikely} of {summary.count}: cei-convert with --verify or --refine, which replay them, or with --evidence, which "
            "builds their scene from the recording."
        )
    if replay is not None and replay.held is None:
        said.append("Whether successes hold or were luck: cei-replay --perturb=3.")
    if not summary.fidelities:
        said.append("How well episodes follow: their records have no fidelity, as only conversions give them one.")
    elif not summary.verified:
        said.append("Whether anything else holds better: neither --verify nor --refine was asked for.")
    if found.source is None and sources(metadata):
        said.append("What the source did, and how far pads are apart frame by frame: --source.repo_id=NAME.")
    if not found.reader.has_clouds:
        said.append("What a policy sees: it has no point clouds.")
    if not found.films:
        said.append("How it looks in motion: --films.")
    return said + [f"Not shown: {line}" for line in found.missed if line]


def _held(held: tuple[float, float] | None) -> str:
    return "" if held is None else "{:.0%} → {:.0%}".format(*held)


def _counted(n: int, what: str) -> str:
    return f"{n} {what}{'' if n == 1 else 's'}"
