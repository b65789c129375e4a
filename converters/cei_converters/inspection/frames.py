"""Frames that something is wrong with: by their time, by their number, and by what comes before and after."""

from collections.abc import Iterator

import numpy as np

from cei_converters.sources.recording import Recording, Recordings
from cei_gym.arrays import Array

_TURN_RAD, _TURN_DEG = 2 * np.pi, 360.0
_LONGEST_GAP = 3  # frames of zeros
_SHUFFLED = (
    0.2  # a step in the mean, of a column's extent: of motion it is some hundredths, of frames in any order a third
)
_FEW = 3  # values of a column that is open or closed
_SHOWN = 5


def look_at_frames(recordings: Recordings) -> list[str]:
    """What is wrong, one sentence each, with episode, frame and column."""
    found = []
    for recording in recordings.episodes:
        found += [f"episode {recording.index}{text}" for text in _of_episode(recording, recordings)]
    kept = found[: _SHOWN * max(1, len(recordings.episodes))]
    return [*kept, f"and {len(found) - len(kept)} more like these."] if len(found) > len(kept) else kept


def _of_episode(recording: Recording, recordings: Recordings) -> Iterator[str]:
    ordered = list(_by_number(recording)) + list(_by_time(recording, recordings.fps))
    yield from ordered
    moving = [i for i in range(recording.state.shape[1]) if len(np.unique(recording.state[:, i])) > _FEW]
    state, names = recording.state[:, moving], [recordings.names[i] for i in moving]
    if not moving or len(state) < 5 or not np.isfinite(state).all():
        return
    if not ordered and (text := _shuffled(state)):
        yield text
        return  # everything jumps
    yield from _zeros(state, names)
    yield from _turns(state, names)
    yield from _repeated(recording.state)


def _by_number(recording: Recording) -> Iterator[str]:
    numbers = recording.numbers
    if numbers is None or len(numbers) < 2:
        return
    steps = np.diff(numbers)
    if (same := np.flatnonzero(steps == 0)).size:
        yield f", frame {same[0] + 1}: frame_index is {numbers[same[0]]:g} again ({same.size} frames are repeated)."
    if (back := np.flatnonzero(steps < 0)).size:
        yield (
            f", frame {back[0] + 1}: frame_index goes back from {numbers[back[0]]:g} to {numbers[back[0] + 1]:g}; frames are not in their order."
        )
    if (gap := np.flatnonzero(steps > 1)).size and not back.size:
        yield f", frame {gap[0] + 1}: frame_index leaps from {numbers[gap[0]]:g} to {numbers[gap[0] + 1]:g}; frames are missing."


def _by_time(recording: Recording, fps: float | None) -> Iterator[str]:
    times_s = recording.times_s
    if times_s is None or len(times_s) < 2:
        return
    steps = np.diff(times_s)
    if (back := np.flatnonzero(steps < 0)).size:
        yield f", frame {back[0] + 1}: its time stamp is {-steps[back[0]]:.4g} s before the last one's; frames are not in their order."
    elif (same := np.flatnonzero(steps == 0)).size:
        yield f", frame {same[0] + 1}: its time stamp is the last one's ({same.size} frames are repeated)."
    elif fps is not None and (wrong := np.flatnonzero(np.abs(steps * fps - 1) > 0.5)).size:
        yield (
            f", frame {wrong[0] + 1}: time stamps and fps disagree: it comes {steps[wrong[0]]:.4g} s after the last, at {fps:g} frames a second "
            f"({wrong.size} such frames)."
        )


def _shuffled(state: Array) -> str:
    steps, extents = np.abs(np.diff(state, axis=0)).mean(axis=0), np.ptp(state, axis=0)
    share = float(np.median(steps / extents))
    if len(state) < 20 or share < _SHUFFLED:
        return ""
    return (
        f": from each frame to the next columns change by {100 * share:.0f} % of all that they change by, in the mean; frames seem to be in no "
        "order, or far apart in time."
    )


def _zeros(state: Array, names: list[str]) -> Iterator[str]:
    """A few frames of exact zeros, where what is before and after is alike and far from zero."""
    usual = np.quantile(np.abs(np.diff(state, axis=0)), 0.9, axis=0)
    gone = state == 0
    every = gone.all(axis=1)
    for start, end in _runs(every):
        if (
            start > 0
            and end < len(state)
            and end - start <= _LONGEST_GAP
            and (np.abs(state[start - 1]) > 3 * usual).any()
        ):
            yield f", frame {start}: all columns that move are 0 there{_long(start, end)}, {_before(state[start - 1], state[end], 0, names)}."
    for i, name in enumerate(names):
        for start, end in _runs(gone[:, i] & ~every):
            if start == 0 or end == len(state) or end - start > _LONGEST_GAP:
                continue
            before, after = state[start - 1, i], state[end, i]
            far = min(abs(before), abs(after)) > max(5 * usual[i], 1e-3)
            if far and abs(before - after) < 0.5 * min(abs(before), abs(after)):
                yield f", frame {start}: {name} is 0 there{_long(start, end)}, {_before(state[start - 1], state[end], i, names)}."


def _before(before: Array, after: Array, i: int, names: list[str]) -> str:
    return f"with {names[i]} at {before[i]:.4g} before and {after[i]:.4g} after"


def _long(start: int, end: int) -> str:
    return f" and in the next {end - start - 1}" if end - start > 1 else ""


def _runs(flags: Array) -> list[tuple[int, int]]:
    """Start and end (not with) of each run of true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _turns(state: Array, names: list[str]) -> Iterator[str]:
    """Steps of a whole turn: an angle that was taken modulo one."""
    steps = np.diff(state, axis=0)
    for i, name in enumerate(names):
        turn = _TURN_DEG if np.abs(state[:, i]).max() > 2 * _TURN_RAD else _TURN_RAD
        usual = np.quantile(np.abs(steps[:, i]), 0.5)
        jumps = np.flatnonzero(np.abs(np.abs(steps[:, i]) - turn) < 0.1 * turn)
        if jumps.size and usual < 0.05 * turn:
            yield (
                f", frame {jumps[0] + 1}: {name} jumps by {steps[jumps[0], i]:.4g}, a whole turn ({jumps.size} such frames): it was kept within one; "
                "unwrap it, such as with numpy.unwrap."
            )


def _repeated(state: Array) -> Iterator[str]:
    """A frame that is the last one over again, in the middle of motion."""
    moved = np.abs(np.diff(state, axis=0)).sum(axis=1)
    usual = np.median(moved)
    if usual == 0:  # it rests half of the time
        return
    still = np.flatnonzero((moved[1:-1] == 0) & (moved[:-2] > 0.5 * usual) & (moved[2:] > 1.5 * usual)) + 1
    if still.size:
        yield f", frame {still[0] + 1}: it is frame {still[0]} over again, while the robot moves ({still.size} such frames)."
