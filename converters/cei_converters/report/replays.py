"""Results of `cei-replay --json`, which may be a stranger's: checked, and whose they are."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cei_converters.replay import held_of, wilson
from cei_converters.sources.source import Source
from cei_gym.errors import CEIError, one_line
from cei_gym.untrusted import load_json


@dataclass(frozen=True)
class Replayed:
    """What replaying one episode showed.

    Attributes:
        failure: why it fails; empty if it succeeds.
        perturbed: of replays slightly otherwise, whether each succeeds.
        frames: of the episode; None if it does not say.
    """

    failure: str
    perturbed: tuple[bool, ...] = ()
    frames: int | None = None


@dataclass(frozen=True)
class Replay:
    """A replay of a dataset.

    Attributes:
        embodiment, env, repo_id: of what was replayed, and in what.
        episodes: what was shown, by episode; not empty.
        rules: what the simulation does with the robot by rule: of which part, of which kind, set by what, and in words.
    """

    embodiment: str
    env: str
    repo_id: str
    episodes: Mapping[int, Replayed]
    rules: tuple[tuple[str, str, str, str], ...] = ()

    @property
    def successes(self) -> int:
        """How many episodes succeed."""
        return sum(not each.failure for each in self.episodes.values())

    @property
    def interval(self) -> tuple[float, float]:
        """Between which shares the rate of success lies with 95 % confidence (Wilson)."""
        return wilson(self.successes, len(self.episodes))

    @property
    def held(self) -> dict[str, Any] | None:
        """Which share succeeds slightly otherwise (`cei_converters.replay.held_of`); None if that was not tried."""
        entries = [{"perturbed": each.perturbed} for each in self.episodes.values() if each.perturbed]
        return held_of(entries) if entries else None

    @property
    def failures(self) -> str:
        """Reasons and how often, in words."""
        counted = Counter(each.failure for each in self.episodes.values() if each.failure)
        return ", ".join(f"{reason}: {count}" for reason, count in counted.items()) or "none"


def load_replay(path: Path) -> Replay:
    """Read one.

    Raises:
        CEIError: it cannot be read, or is no result of `cei-replay`.
    """
    where = f"--replay={path}"
    try:
        found = load_json(path.read_text())
    except (OSError, ValueError) as error:
        raise CEIError(f"{where} cannot be read: {one_line(error)}.") from error
    try:
        episodes = {_index(entry["episode"]): _replayed(entry) for entry in found["results"]}
        embodiment, env, repo_id = (_text(found[name]) for name in ("embodiment", "env", "repo_id"))
        rules = [_rule(rule) for rule in (found.get("physics") or {}).get("rules") or []]
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise CEIError(
            f"{where} is no result of cei-replay --json ({type(error).__name__}: {one_line(error)})."
        ) from error
    if not episodes:
        raise CEIError(f"{where} has no episode.")
    return Replay(embodiment, env, repo_id, episodes, tuple(rules))


def sort_replays(
    replays: Sequence[Replay], reader: Source, source: Source | None
) -> tuple[Replay | None, Replay | None]:
    """That of a dataset, and that of its source; None where there is none.

    Args:
        replays: in any order.
        reader: of the dataset.
        source: of what it was converted from, if that is known.

    Raises:
        CEIError: one is of neither, or of episodes that it does not have, or two are of one.
    """
    sides = [side for side in (reader, source) if side is not None]
    names = [(side.repo_id, side.embodiment.name) for side in sides]
    found: dict[int, Replay] = {}
    for replay in replays:
        if (name := (replay.repo_id, replay.embodiment)) not in names:
            known = " nor ".join(f"{repo_id} ({embodiment})" for repo_id, embodiment in names)
            more = (
                ""
                if source is not None
                else "; if it is of what that was converted from, name it with --source.repo_id"
            )
            raise CEIError(f"a --replay is of {replay.repo_id} ({replay.embodiment}), not of {known}{more}.")
        place = names.index(name)
        if place in found:
            raise CEIError(f"two --replay are of {replay.repo_id}; give one.")
        _check_same(replay, sides[place])
        found[place] = replay
    return found.get(0), found.get(1)


def _check_same(replay: Replay, reader: Source) -> None:
    """Check that a replay is of a dataset as it is, not as it was before it was made anew."""
    for index, replayed in replay.episodes.items():
        if index >= len(reader):
            what = f"is of episode {index} of {reader.repo_id}, which has 0 to {len(reader) - 1}"
        elif replayed.frames not in (None, reader.frames(index)):
            what = (
                f"has {replayed.frames} frames of episode {index} of {reader.repo_id}, which has {reader.frames(index)}"
            )
        else:
            continue
        raise CEIError(f"a --replay {what}; replay it again.")


def _replayed(entry: Mapping[str, Any]) -> Replayed:
    success, perturbed = entry["success"], entry.get("perturbed") or []
    if not all(isinstance(each, bool) for each in (success, *perturbed)):
        raise TypeError("success should be true or false")
    frames = _index(entry["frames"]) if "frames" in entry else None
    return Replayed("" if success else _text(entry["failure"]) or "unknown", tuple(perturbed), frames)


def _index(value: object) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise TypeError(f"{one_line(value, 40)} should be a number from 0")
    return value


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{one_line(value, 40)} should be text")
    return one_line(value, 300)


def _rule(rule: Mapping[str, Any]) -> tuple[str, str, str, str]:
    return _text(rule["part"]), _text(rule["kind"]), _text(rule["source"]), _text(rule["says"])
