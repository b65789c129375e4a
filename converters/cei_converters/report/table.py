"""The table of episodes: a row each, a column for whatever is known of any of them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from cei_converters.report.episodes import PARTS, Episode
from cei_gym.twin.evidence import FAILS, HOLDS

GOOD, BAD = "good", "bad"
"""How a cell is meant."""


@dataclass(frozen=True)
class Cell:
    """One cell.

    Attributes:
        text: in it.
        share: in [0, 1], drawn as a bar; None for none.
        meant: GOOD, BAD, or neither, "".
    """

    text: str
    share: float | None = None
    meant: str = ""


@dataclass(frozen=True)
class Column:
    """One column: its name, what it is in words, and an episode's cell; None where nothing is known."""

    name: str
    words: str
    cell: Callable[[Episode], Cell | None]


def table(episodes: Sequence[Episode]) -> tuple[list[Column], list[list[Cell | None]]]:
    """Columns in which something is known, and rows of cells."""
    rows = [[column.cell(episode) for column in _COLUMNS] for episode in episodes]
    known = [any(row[i] is not None for row in rows) for i in range(len(_COLUMNS))]
    columns = [column for column, keep in zip(_COLUMNS, known, strict=True) if keep]
    return columns, [[cell for cell, keep in zip(row, known, strict=True) if keep] for row in rows]


def _share(value: float | None) -> Cell | None:
    return None if value is None else Cell(f"{value:.2f}", value, BAD if value < 0.5 else "")


def _quality(episode: Episode) -> Cell | None:
    return None if episode.quality is None else _share(episode.quality[0])


def _part(name: str) -> Callable[[Episode], Cell | None]:
    return lambda episode: _share(episode.parts.get(name))


def _figure(name: str, digits: int) -> Callable[[Episode], Cell | None]:
    def cell(episode: Episode) -> Cell | None:
        value = episode.figures.get(name)
        return None if value is None else Cell(f"{value:.{digits}f}")

    return cell


def _reach(episode: Episode) -> Cell | None:
    if not episode.figures:
        return None
    return Cell(str(episode.unreachable), meant=BAD if episode.unreachable else "")


def _kept(episode: Episode) -> Cell | None:
    if episode.plain_failure is None:
        return None
    return Cell(f"fails: {episode.plain_failure}", meant=BAD) if episode.fails else Cell(episode.how.partition(" (")[0])


def _held(episode: Episode) -> Cell | None:
    if episode.held is None:
        return None
    plain, kept = episode.held
    return Cell(f"{plain:.0%} → {kept:.0%}", kept)


def _replay(episode: Episode) -> Cell | None:
    if episode.replayed is None:
        return None
    failure = episode.replayed.failure
    return Cell(failure or "success", meant=BAD if failure else GOOD)


def _perturbed(episode: Episode) -> Cell | None:
    if episode.replayed is None or not episode.replayed.perturbed:
        return None
    held, n = sum(episode.replayed.perturbed), len(episode.replayed.perturbed)
    return Cell(f"{held} of {n}", held / n, BAD if 2 * held < n else "")


def _twin(episode: Episode) -> Cell | None:
    if (twin := episode.twin) is None:
        return None
    meant = {HOLDS: GOOD, FAILS: BAD}.get(twin.answer, "")
    return Cell(f"{twin.answer} ({twin.held})" if twin.held else twin.answer, meant=meant)


_PART_WORDS = {
    "residual": "0.5 where pads are 20 mm apart in the mean",
    "limits": "0.5 where a joint of the arm sits at a limit in half of the frames",
    "jumps": "0.5 where a joint is twice as fast as it can be",
    "clearance": "0.5 where the robot is 10 mm deep in itself, the table or objects",
    "reach": "0.5 where 5 % of the frames are out of reach",
}
_COLUMNS = [
    Column("episode", "its index in the dataset", lambda e: Cell(str(e.index))),
    Column(
        "source's",
        "the episode of the source that it was converted from",
        lambda e: None if e.source_episode is None else Cell(str(e.source_episode)),
    ),
    Column("frames", "how many it has", lambda e: Cell(str(e.frames))),
    Column("replay", "whether it succeeds when replayed (--replay)", _replay),
    Column("otherwise", "replays slightly otherwise that succeed (cei-replay --perturb)", _perturbed),
    Column("kept", "which way of transferring it was kept (--verify, --refine)", _kept),
    Column("held", "share of replays slightly otherwise that held while it was refined: plain → as it is kept", _held),
    Column("twin", "what a scene built from its recording shows, and how many tries hold there (--evidence)", _twin),
    Column("quality", "how likely it works, from 0 to 1, by replays or by its twin, which are beside it", _quality),
    Column("fidelity", "how well it follows the source: its worst part, from 0 to 1", lambda e: _share(e.fidelity)),
    *(Column(name, f"part of the fidelity: {_PART_WORDS[name]}", _part(name)) for name in PARTS),
    Column("pads (mm)", "mean distance of the target's pads from the source's", _figure("pad_distance_mm_mean", 1)),
    Column("most (mm)", "the same in the worst frame", _figure("pad_distance_mm_max", 1)),
    Column("normals (deg)", "mean angle between normals of pads", _figure("normal_angle_deg_mean", 1)),
    Column("depth (mm)", "deepest penetration of itself, the table or objects", _figure("penetration_mm_max", 1)),
    Column("unreached", "frames out of reach", _reach),
    Column("flagged", "marked for its quality (--flag)", lambda e: Cell("flagged", meant=BAD) if e.flagged else None),
]
