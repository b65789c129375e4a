"""Whether recorded actions can be what they are said to be, judged by where the robot then was."""

from dataclasses import dataclass

import numpy as np

from cei_converters.sources.actions import BoundActions
from cei_converters.sources.binding import independent_joints, n_arm
from cei_converters.sources.joint_map import ABSOLUTE, DELTA, OPEN_CLOSE, VELOCITY
from cei_gym.arrays import Array
from cei_gym.errors import CEIError

_LEAST_FRAMES = 8
_FAR = 0.1  # rad or m, between a target and where an arm's joints are a frame later, in the mean over joints: never seen of targets
_ANOTHER_ZERO = 0.3  # rad or m
_MOVES = 0.2  # rad or m, over an episode: enough to see what goes with what
_TIMES_BETTER = 4.0  # the explanation that is said must be this many times worse than another to be refused
_SURE, _LOOSE = 0.95, 0.5  # squares of correlations
# correlations: of differences and what follows 0.8 and more, of anything else under 0.2, where frames are many
_RELATED, _UNRELATED = 0.6, 0.3
_WHILE = 5  # frames: a robot is some behind its targets
_RESTS = 1e-4  # rad a frame
_LEAST_FPS = 6.0  # below, a change a frame and one a second are too much alike
_AWAY = 0.7  # of a finger's motion, away from where it is told to be
_NULL = "action: null takes the next frame's state instead."
_SEE_MAP = f"A joint map says what they are under action (see cei-convert --help); {_NULL}"


@dataclass(frozen=True)
class _Fit:
    """`y = slope * x + shift`, and how much of y that explains, from 0 to 1."""

    slope: float
    shift: float
    share: float


def check_actions(actions: BoundActions, values: Array, qpos: Array, fps: float, where: str) -> None:
    """Refuse actions that are of another kind, unit, sign or column than they are said to be.

    Only what contradicts is refused: data that say nothing (too short, at rest) pass.

    Args:
        actions: what they are said to be.
        values: (T, k) columns.
        qpos: (T, n) the state, rad or m.
        fps: frames a second.
        where: the episode, for messages.

    Raises:
        CEIError: with the numbers that show it, and what a joint map would say.
    """
    if len(qpos) < _LEAST_FRAMES:
        return
    u = actions.embodiment.coupled.reduce(qpos)
    is_arm = np.arange(u.shape[1]) < n_arm(actions.embodiment)
    where = f"{where}: {actions.feature}"
    absolute = actions.of_kind(ABSOLUTE)
    lost = _check_each(actions, actions.absolute(values), u, absolute, is_arm, where) if absolute.any() else ""
    for kind in (ABSOLUTE, DELTA, VELOCITY):
        joints = np.flatnonzero(actions.of_kind(kind) & is_arm)
        if len(joints):
            _check_kind(kind, actions, actions.relative(values), actions.absolute(values), u, joints, fps, where)
    if lost:
        raise CEIError(lost)
    _check_fingers(actions, values, u, np.flatnonzero(~is_arm), where)


def _check_kind(
    kind: str,
    actions: BoundActions,
    r: Array,
    a: Array,
    u: Array,
    joints: Array,
    fps: float,
    where: str,
) -> None:
    """Say for an arm how far each explanation leaves its joints, in the mean, from where they are a frame later.

    r and a are what is stored, relative and absolute.
    """
    u, r, a = u[:, joints], r[:, joints], a[:, joints]
    now, then, change = u[:-1], u[1:], np.diff(u, axis=0)
    off = {
        ABSOLUTE: _typical(a[:-1] - then),
        DELTA: _typical(now + r[:-1] - then),
        VELOCITY: _typical(now + r[:-1] / fps - then),
    }
    goes_with, times = _goes_with(r, u), _times(r[:-1], change)
    numbers = (
        f"as targets they are {off[ABSOLUTE]:.3g} rad from where the arm is a frame later, added to the state {off[DELTA]:.3g}, as speeds "
        f"{off[VELOCITY]:.3g}, in the mean over its joints"
    )
    numbers += "" if times is None else f", and they are {times:.2g} times its change a frame"
    # a change a frame and one a second differ by their size alone
    a_second = times is not None and fps >= _LEAST_FPS and fps / 3 < times < 3 * fps
    other = None
    if kind == ABSOLUTE:
        # that a speed moves little in a frame says nothing, as any number does when it is divided
        better = min(off[DELTA], off[VELOCITY]) if goes_with is not None else off[DELTA]
        if off[kind] > _FAR and better * _TIMES_BETTER < off[kind] and (goes_with is None or goes_with > _RELATED):
            other = VELOCITY if a_second else DELTA
    elif off[ABSOLUTE] * _TIMES_BETTER < np.abs(r).mean() and np.abs(r).mean() > _FAR:
        other = ABSOLUTE
    elif goes_with is not None and goes_with < _UNRELATED:
        raise CEIError(
            f"{where} is said to be {kind}, but does not go with how the arm moves (correlation {goes_with:.2f}); {numbers}. "
            f"{_SEE_MAP}"
        )
    elif (
        times is not None
        and fps >= _LEAST_FPS
        and ((kind == DELTA and a_second) or (kind == VELOCITY and 0.3 < times < 3))
    ):
        other = VELOCITY if kind == DELTA else DELTA
    if other is not None:
        raise CEIError(
            f"{where} is said to be {kind}, but is {other}: {numbers}. Say so in a joint map, by "
            f"action: {{feature: {actions.feature}, kind: {other}}}; {_NULL}"
        )


def _goes_with(r: Array, u: Array) -> float | None:
    """Correlation of what is stored with what joints then do for a while, in the middle of those that move; None if none does."""
    if len(u) < 3 * _WHILE:
        return None
    ahead, r = u[_WHILE:] - u[:-_WHILE], r[:-_WHILE]
    moving = np.flatnonzero((np.ptp(u, axis=0) > _FAR) & (r.std(axis=0) > 0) & (ahead.std(axis=0) > 0))
    return float(np.median([np.corrcoef(r[:, j], ahead[:, j])[0, 1] for j in moving])) if len(moving) else None


def _times(r: Array, change: Array) -> float | None:
    """How many times the joints' change a frame what is stored is, in the least squares; None where they rest."""
    return float((r * change).sum() / (change**2).sum()) if np.abs(change).mean() > _RESTS else None


def _check_each(actions: BoundActions, a: Array, u: Array, absolute: Array, is_arm: Array, where: str) -> str:
    """Joint by joint: targets that follow the joint in another unit, sign or column. Returns what is to be said if most follow nothing."""
    body, names = actions.embodiment, independent_joints(actions.embodiment)
    lower, upper = body.independent_limits
    a, then = a[:-1], u[1:]
    extent = np.ptp(then, axis=0)
    moves = extent > np.where(is_arm, _MOVES, 0.3 * (upper - lower))
    lost, strays = [], []
    for j in np.flatnonzero(absolute & moves):
        if not is_arm[j] and not _beyond(a[:, j], float(lower[j]), float(upper[j])):
            continue  # what a finger holds keeps it from where it is told to be
        off = float(np.median(np.abs(a[:, j] - then[:, j])))
        if off < max(_FAR, 0.15 * extent[j]) if is_arm[j] else off < 0.5 * (upper[j] - lower[j]):
            continue
        fit = _lagged(then[:, j], a[:, j])
        unit = body.joint_units[body.coupled.independent[j]]
        differ = f"{where}: of {names[j]} it is {off:.3g} {unit} (median) from where the joint is a frame later"
        apart = abs(fit.slope * then[:, j].mean() + fit.shift - then[:, j].mean())
        shifted = apart > max(_ANOTHER_ZERO, 0.5 * extent[j])  # gravity, or how a leader was calibrated, makes less
        if fit.share > _SURE and (not 0.67 < fit.slope < 1.5 or shifted):
            raise CEIError(
                f"{differ}, and {fit.slope:.4g} times that position plus {fit.shift:.3g} ({100 * fit.share:.0f} % explained): its unit, sign or "
                f"zero differ from the state's. A joint map says so by a group under action: joints: with {_group(fit, float(lower[j]), float(upper[j]))}; "
                f"{_NULL}"
            )
        if is_arm[j] and fit.share < _LOOSE and off > 0.5 * extent[j]:
            others = [names[i] for i in np.flatnonzero(moves) if i != j and _follows(a[:, j], then[:, i])]
            strays.append((differ, others[0] if others else ""))
            if off > extent[j]:
                lost.append(differ)
    if strays and all(other for _, other in strays):
        differ, other = strays[0]
        raise CEIError(
            f"{differ}, but follows {other}: its columns are in another order than the state's. A joint map says which are which under action, "
            "with joints: of its own."
        )
    if len(lost) > 0.5 * np.count_nonzero(moves & is_arm & absolute):
        return (
            f"{lost[0]}, which moves by {extent.max():.3g} at most, and most joints are alike: these are no targets of these joints in rad or m. "
            f"Differences or speeds in a unit of their own, or an end-effector's? {_SEE_MAP}"
        )
    return ""


def _beyond(a: Array, lower: float, upper: float) -> bool:
    """Whether targets are often far beyond a joint's limits, and not just at two ends, as a command to open and close is."""
    slack = 0.5 * (upper - lower)
    outside = (a < lower - slack) | (a > upper + slack)
    return bool(outside.mean() > 0.2 and len(np.unique(a)) > 2)


def _group(fit: _Fit, lower: float, upper: float) -> str:
    """What a joint map would say."""
    for slope, text in ((180 / np.pi, "unit: deg"), (1000.0, "unit: mm"), (-1.0, "sign: -1")):
        if abs(fit.slope / slope - 1) < 0.1 and abs(fit.shift / slope) < 0.1:
            return text
    ends = ", ".join(f"{fit.slope * limit + fit.shift:.3g}" for limit in (lower, upper))
    return f"unit: normalised, range: [{ends}]"


def _check_fingers(actions: BoundActions, values: Array, u: Array, fingers: Array, where: str) -> None:
    """Fingers that move away from where they are told to be."""
    body, names = actions.embodiment, independent_joints(actions.embodiment)
    home, closed = body.coupled.reduce(body.home), body.coupled.reduce(body.closed)
    lower, upper = body.independent_limits
    a, change = actions.absolute(values)[:-1], np.diff(u, axis=0)
    for j in fingers:
        kind, extent = actions.kinds[j], float(upper[j] - lower[j])
        if kind == OPEN_CLOSE:
            toward = a[:, j] * (closed[j] - home[j])
        elif kind == ABSOLUTE:
            toward = a[:, j] - u[:-1, j]
            toward = np.where(
                np.abs(toward) < 0.1 * extent, 0.0, toward
            )  # what follows it closely may be a little behind or ahead
        else:
            continue
        moved = np.where(toward == 0, 0.0, np.abs(change[:, j]))
        if moved.sum() < 0.5 * extent:
            continue
        away = float(moved[toward * change[:, j] < 0].sum() / moved.sum())
        if away > _AWAY:
            s, o = actions.scale[j], actions.offset[j]
            stored = (
                f"[{(1 - o) / s:g}, {(-1 - o) / s:g}]" if kind == OPEN_CLOSE else "[what is stored to open, to close]"
            )
            raise CEIError(
                f"{where}: {names[j]} goes the other way than it is told to in {100 * away:.0f} % of its motion: open and close are exchanged. "
                f"A joint map says so by a group under action: joints: with kind: {OPEN_CLOSE}, range: {stored}."
            )


def _typical(off: Array) -> float:
    """The mean over joints, in the middle of all frames: an arm that has yet to find its leader, at first, is no matter."""
    return float(np.median(np.abs(off).mean(axis=1)))


def _follows(a: Array, then: Array) -> bool:
    """Whether targets are those of a joint that moves like this."""
    fit, extent = _lagged(then, a), float(np.ptp(then))
    return (
        fit.share > _SURE
        and 0.8 < fit.slope < 1.25
        and abs(fit.slope * then.mean() + fit.shift - then.mean()) < 0.2 * extent
    )


def _lagged(then: Array, a: Array) -> _Fit:
    """The best fit of targets over positions, as many frames later as it takes."""
    fits = (_fit(then[lag:], a[: len(a) - lag]) for lag in range(_WHILE))
    return max(fits, key=lambda fit: fit.share)


def _fit(x: Array, y: Array) -> _Fit:
    if x.std() == 0 or y.std() == 0:
        return _Fit(0.0, float(y.mean()), 0.0)
    slope, shift = np.polyfit(x, y, 1)
    return _Fit(float(slope), float(shift), float(np.corrcoef(x, y)[0, 1] ** 2))
