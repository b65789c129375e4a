"""A correction of how a hand takes hold: a dozen numbers that bend a followed trajectory around its holds, and leave it elsewhere.

Geometry cannot know what slips: a ball, a flat plate. Physics can, and searches among these numbers (`--refine`).
"""

from dataclasses import dataclass, fields
from typing import Self

import numpy as np
from scipy.spatial.transform import Rotation

from cei_gym.alignment.contact.squeeze import squeeze
from cei_gym.alignment.grip import Grip
from cei_gym.alignment.problem import AlignmentProblem, Motion
from cei_gym.arrays import Array
from cei_gym.errors import CEIError

_FADE_IN_S, _FADE_OUT_S = 0.5, 0.4  # before a hold, and after it
_SAME_HOLD_S = 0.5  # a grip that lets go for less has not
_ITERATIONS, _DAMPING = 8, 1e-4


@dataclass(frozen=True)
class Correction:
    """What is other than followed. Axes are the grip's, frame by frame: the closing axis of the source's pads, the approach from the target's
    first link to what is held, square to it, and across, square to both.

    Attributes:
        across_m, closing_m, approach_m: how far the hand is moved.
        about_across_rad, about_closing_rad, about_approach_rad: how it is turned about the middle of what is held.
        squeeze: factor on how far actions squeeze.
        asymmetry: from -1 to 1, by how much more of it the target's pads do that are on the side of its first, and the others less.
        later_s: how much later the hand closes.
        wider_m: how much wider each pad is open before it closes.
        dwell_s: how long all wait once it has closed.

    Raises:
        CEIError: a figure is not finite, or beyond what it can be.
    """

    across_m: float = 0.0
    closing_m: float = 0.0
    approach_m: float = 0.0
    about_across_rad: float = 0.0
    about_closing_rad: float = 0.0
    about_approach_rad: float = 0.0
    squeeze: float = 1.0
    asymmetry: float = 0.0
    later_s: float = 0.0
    wider_m: float = 0.0
    dwell_s: float = 0.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not np.isfinite(value):
                raise CEIError(f"correction.{name}={value} must be finite.")
        for name in ("squeeze", "dwell_s"):
            if getattr(self, name) < 0:
                raise CEIError(f"correction.{name}={getattr(self, name)} must be at least 0.")
        if abs(self.asymmetry) > 1:
            raise CEIError(f"correction.asymmetry={self.asymmetry} must be from -1 to 1.")

    def __str__(self) -> str:
        """The figures that matter: those that are not what they would be without."""
        units = {"m": (1e3, "mm"), "rad": (np.degrees(1), "deg"), "s": (1.0, "s")}
        shown = []
        for field in fields(self):
            value = getattr(self, field.name)
            name, _, unit = field.name.rpartition("_")
            scale, symbol = units.get(unit, (1.0, ""))
            if (text := f"{scale * value:.2g}") != f"{field.default:.2g}":
                shown.append(f"{(name if symbol else field.name).replace('_', ' ')} {text} {symbol}".rstrip())
        return ", ".join(shown) or "none"

    @classmethod
    def names(cls) -> list[str]:
        """Of its figures, in order."""
        return [field.name for field in fields(cls)]


@dataclass(frozen=True)
class Holds:
    """The stretches in which something is held, (H,) each: from frame `first` to frame `last`."""

    first: Array
    last: Array

    @classmethod
    def of(cls, grip: Grip | None, dt_s: float) -> Self:
        """Those of a source's grip, dt_s between frames; short gaps are none."""
        held = np.zeros(0, bool) if grip is None else grip.held
        first = np.flatnonzero(held & ~np.append(False, held[:-1]))
        last = np.flatnonzero(held & ~np.append(held[1:], False))
        new = np.append(True, (first[1:] - last[:-1]) * dt_s > _SAME_HOLD_S)[: len(first)]
        ends = np.append(new[1:], True)[: len(last)]
        return cls(first[new], last[ends])

    def __len__(self) -> int:
        return len(self.first)


def corrected(problem: AlignmentProblem, motion: Motion, u: Array, correction: Correction) -> Array:
    """A trajectory with the hand moved, turned, opened and closed otherwise around each hold; it is what it was far from them.

    Args:
        problem: the target.
        motion: that was followed, with the source's grip and the time between frames.
        u: (T, m) independent joints that follow it, rad or m.
        correction: what is to be other; its `squeeze`, `asymmetry` and `dwell_s` are not this function's.

    Returns:
        (T, m) independent joints, within limits, and no faster than joints can be where they were not before.
    """
    dt_s = motion.dt_s or 0.0
    holds = Holds.of(motion.grip, dt_s)
    if not len(holds) or dt_s <= 0:
        return u
    assert motion.grip is not None
    embodiment = problem.embodiment
    hand = np.flatnonzero(embodiment.coupled.independent >= embodiment.n_arm)
    arm = np.flatnonzero(embodiment.coupled.independent < embodiment.n_arm)
    out = u.copy()
    if len(hand):
        out[:, hand] = _later(out[:, hand], holds, correction.later_s / dt_s)
        out = squeeze(problem, out, -correction.wider_m * _open(out[:, hand], holds, dt_s))
    if len(arm):
        out[:, arm] = _moved(problem, motion.grip, out, arm, correction, _weight(holds, len(u), dt_s))
    return _no_faster(u, out, embodiment.independent_max_velocity * dt_s)


def dwelling(motion: Motion, frames: int, correction: Correction) -> Array:
    """(T',) which of a motion's frames are shown where all wait as each hold begins."""
    dt_s = motion.dt_s or 0.0
    holds, more = Holds.of(motion.grip, dt_s), round(correction.dwell_s / dt_s) if dt_s > 0 else 0
    times = np.ones(frames, int)
    times[holds.first] += more
    return np.repeat(np.arange(frames), times)


def _smooth(share: Array) -> Array:
    """From 0 to 1, level at both ends."""
    s = np.clip(share, 0.0, 1.0)
    return s * s * (3 - 2 * s)


def _weight(holds: Holds, frames: int, dt_s: float) -> Array:
    """(T,) 1 while something is held, fading in before and out after."""
    t = dt_s * np.arange(frames)
    weight = np.zeros(frames)
    for first, last in zip(holds.first, holds.last, strict=True):
        into, out_of = 1 - (dt_s * first - t) / _FADE_IN_S, 1 - (t - dt_s * last) / _FADE_OUT_S
        weight = np.maximum(weight, np.minimum(_smooth(into), _smooth(out_of)))
    return weight


def _later(hand: Array, holds: Holds, by: float) -> Array:
    """(T, h) a hand's joints, so many frames later until a hold is half over, and as they were before it ends."""
    t = np.arange(len(hand), dtype=float)
    shift, since = np.zeros(len(hand)), 0
    for first, last in zip(holds.first, holds.last, strict=True):
        middle = (first + last) / 2
        back = 1 - _smooth((t - middle) / max(1.0, last - middle))
        shift[since : last + 1] = by * back[since : last + 1]
        since = last + 1
    at = np.clip(t - shift, 0, len(hand) - 1)
    return np.stack([np.interp(at, t, joint) for joint in hand.T], axis=1)


def _open(hand: Array, holds: Holds, dt_s: float) -> Array:
    """(T,) how open a hand is, from 1 to 0, on its way to each hold; 0 far from one."""
    t, share = dt_s * np.arange(len(hand)), np.zeros(len(hand))
    for first in holds.first:
        away = np.abs(hand[: first + 1] - hand[first]).max(axis=1)
        begins = np.maximum(0, first - int(2 * _FADE_IN_S / dt_s))
        widest = away[begins:].max(initial=0.0)
        if widest > 0:
            into = _smooth(1 - (t[first] - t[: first + 1] - _FADE_IN_S) / _FADE_IN_S)
            share[: first + 1] = np.maximum(share[: first + 1], into * np.clip(away / widest, 0.0, 1.0))
    return share


def _moved(problem: AlignmentProblem, grip: Grip, u: Array, arm: Array, correction: Correction, weight: Array) -> Array:
    """(T, n) the arm's joints that have the hand where it is wanted, as near as they can; damped least squares on all frames at once."""
    offset = np.array([correction.across_m, correction.closing_m, correction.approach_m])
    turn = np.array([correction.about_across_rad, correction.about_closing_rad, correction.about_approach_rad])
    when = np.flatnonzero(weight > 0)
    if not len(when) or not (offset.any() or turn.any()):
        return u[:, arm]
    embodiment, tree = problem.embodiment, problem.tree
    root, coupled = embodiment.end_effector_root, embodiment.coupled
    lower, upper = (limits[arm] for limits in embodiment.independent_limits)
    q = u[when].copy()
    hands = tree.forward(coupled.expand(q))[:, root]
    middle = grip.contacts[when].mean(axis=1)
    axes = _axes(grip.axis[when], middle - hands[:, :3, 3])  # (T, 3, 3), in columns
    share = weight[when, None]
    R = Rotation.from_rotvec(np.einsum("tij,tj->ti", axes, share * turn)).as_matrix()
    wanted = middle + np.einsum("tij,tj->ti", R, hands[:, :3, 3] - middle)
    wanted += np.einsum("tij,tj->ti", axes, share * offset)
    turned = R @ hands[:, :3, :3]
    for _ in range(_ITERATIONS):
        qpos = coupled.expand(q)
        now = tree.forward(qpos)[:, root]
        J = tree.jacobian(qpos, root, np.zeros(3)) @ coupled.A[:, arm]
        error = np.concatenate(
            [
                wanted - now[:, :3, 3],
                Rotation.from_matrix(turned @ now[:, :3, :3].transpose(0, 2, 1)).as_rotvec(),
            ],
            axis=1,
        )
        step = np.linalg.solve(J @ J.transpose(0, 2, 1) + _DAMPING * np.eye(6), error[..., None])
        q[:, arm] = np.clip(q[:, arm] + (J.transpose(0, 2, 1) @ step)[..., 0], lower, upper)
    out = u[:, arm].copy()
    out[when] = q[:, arm]
    return out


def _axes(closing: Array, approach: Array) -> Array:
    """(T, 3, 3) across, closing and approach in columns, of (T, 3) unit closing axes and directions to what is held."""
    approach = approach - np.einsum("ti,ti->t", approach, closing)[:, None] * closing
    norm = np.linalg.norm(approach, axis=1, keepdims=True)
    approach = approach / np.maximum(norm, 1e-9)
    return np.stack([np.cross(closing, approach), closing, approach], axis=2)


def _no_faster(before: Array, after: Array, most: Array) -> Array:
    """A trajectory whose joints move no more a frame than they can, or than they did where that was more already."""
    out = after.copy()
    allowed = np.maximum(most, np.abs(np.diff(before, axis=0)))
    for t in range(1, len(out)):
        out[t] = np.clip(out[t], out[t - 1] - allowed[t - 1], out[t - 1] + allowed[t - 1])
    return out
