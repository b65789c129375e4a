"""Ways that an end-effector may close: how squarely finger surfaces face each other on the way, how far they part, whether they meet."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment
from cei_gym.kinematics import KinematicTree
from cei_gym.onboarding.fingers import Finger

POSES = 9
"""From open to closed, at which ways to close are looked at."""

_STEP = 1e-3  # of the way, for the direction in which surfaces set out
_LEAST_COSINE, _GOOD_COSINE = 0.6, 0.9  # between a normal and that direction, of what is palm side
_GRASP_M, _SPREAD_M = 0.04, 0.02  # the widths of objects that surfaces should face each other at
_WIDE_M, WIDER_M, SHUT_M = 0.08, 0.12, -0.002
_SAME_FINGER_M = 0.008
_BESIDE_M = 0.01  # of the way that a surface faces
_FOREMOST_M = 0.006
_ROOM = 0.6  # of the most room between jaws, of what holds an object


@dataclass(frozen=True)
class Closing:
    """A way to close.

    Attributes:
        sides: the fingers on either side.
        home, closed: (m,) independent joints, rad or m.
        cost: how bad it is: 0 faces squarely, opens by 8 cm and shuts.
        gap_m: (T,) between the sides on the way from home to closed; negative where they have passed each other.
        axis_base: (3,) unit, from one side to the other at the width of a small object.
        middle_base: (3,) between the sides there, m.
        share: where on the way that is, 0 home and 1 closed.
        weights: for each finger (P,), how much each point is palm side.
    """

    sides: tuple[tuple[Finger, ...], tuple[Finger, ...]]
    home: Array
    closed: Array
    cost: float
    gap_m: Array
    axis_base: Array
    middle_base: Array
    share: float
    weights: tuple[Array, ...]

    @property
    def fingers(self) -> tuple[Finger, ...]:
        """Those of both sides."""
        return self.sides[0] + self.sides[1]


class Judge:
    """Costs of ways to close between two sides.

    Args:
        embodiment: an end-effector.
        tree: its kinematics.
        sides: fingers on either side.
        palm: (V, 3) what else of the hand there is, m, in the base frame, that should not stand in front of its fingertips.
        middle: (3,) where the fingers begin, m, in the base frame.
    """

    def __init__(
        self,
        embodiment: Embodiment,
        tree: KinematicTree,
        sides: tuple[Sequence[Finger], Sequence[Finger]],
        palm: Array,
        middle: Array,
    ) -> None:
        self._embodiment, self._tree = embodiment, tree
        self._sides = (tuple(sides[0]), tuple(sides[1]))
        self._fingers = self._sides[0] + self._sides[1]
        self._side = np.array([0] * len(sides[0]) + [1] * len(sides[1]))
        self._still = np.array([not finger.joints for finger in self._fingers])
        self._palm, self._palm_middle = palm, middle
        self._together = len(self._fingers) == 2 and self._fingers[0].joints == self._fingers[1].joints
        lower, upper = embodiment.independent_limits
        self._range = np.maximum(upper - lower, 1e-9)

    def __call__(self, home: Array, closed: Array) -> Array:
        """(B,) costs of (B, m) ways."""
        return self._judge(home, closed)[0]

    def closing(self, home: Array, closed: Array) -> Closing:
        """One way, (m,), with what is to know of it."""
        cost, gap, axis, middle, weights, at = self._judge(home[None], closed[None])
        t = int(at[0])
        return Closing(
            self._sides, home, closed, float(cost[0]), gap[0], axis[0, t], middle[0, t], t / (POSES - 1),
            tuple(weight[0] for weight in weights),
        )  # fmt: skip

    def _judge(self, home: Array, closed: Array):
        share = np.append(np.linspace(0, 1, POSES), _STEP)[None, :, None]
        u = (1 - share) * home[:, None] + share * closed[:, None]
        T_links = self._tree.forward(self._embodiment.coupled.expand(u.reshape(-1, u.shape[-1])))
        T_links = T_links.reshape(len(home), POSES + 1, *T_links.shape[1:])
        placed = [_place(T_links[:, :, finger.body], finger) for finger in self._fingers]
        weights = self._palm_sides(placed)
        centre = np.stack([_mean(w, p[:, :-1]) for (p, _), w in zip(placed, weights, strict=True)], axis=2)
        normal = np.stack([_unit(_mean(w, n[:, :-1])) for (_, n), w in zip(placed, weights, strict=True)], axis=2)
        one, two = self._side == 0, self._side == 1
        c1, c2 = centre[:, :, one].mean(axis=2), centre[:, :, two].mean(axis=2)
        n1, n2 = _unit(normal[:, :, one].mean(axis=2)), _unit(normal[:, :, two].mean(axis=2))
        across, between = _unit(n1 - n2), _unit(c2 - c1)
        # How far the surfaces are from each other along the way they face, finger by finger.
        ends = np.stack(
            [
                _extreme(w, np.einsum("btpi,bti->btp", p[:, :-1], across), lowest=bool(side))
                for (p, _), w, side in zip(placed, weights, self._side, strict=True)
            ],
            axis=2,
        )
        gap = ends[:, :, two].min(axis=2) - ends[:, :, one].max(axis=2)
        near = np.exp(-np.square((gap - _GRASP_M) / _SPREAD_M)) + 1e-6
        facing = (np.einsum("bti,bti->bt", n1, between) - np.einsum("bti,bti->bt", n2, between)) / 2
        facing = np.where(gap < -0.01, -np.abs(facing), facing)
        lengthwise = np.stack(
            [
                np.square(
                    np.einsum("bti,bti->bt", normal[:, :, i], T_links[:, :-1, f.body, :3, :3] @ f.axis_link)
                ).mean(axis=1)
                for i, f in enumerate(self._fingers)
                if f.joints
            ]
        ).mean(axis=0)
        parallel = np.einsum("btfi,bti->btf", normal, across) * np.where(one, 1.0, -1.0)
        uneven = np.square((ends - np.where(one, ends[:, :, one].mean(axis=2, keepdims=True), ends[:, :, two].mean(axis=2, keepdims=True))) / _SAME_FINGER_M).mean(axis=2)  # fmt: skip
        weight = near / near.sum(axis=1, keepdims=True)
        lacking = np.maximum(0, np.stack([0.12 - w.mean(axis=1) for w in weights])).sum(axis=0) / 0.12
        cost = (
            4 * (weight * (1 - facing)).sum(axis=1)
            + 2 * (weight * (1 - parallel).mean(axis=2)).sum(axis=1)
            + 0.5 * (weight * np.minimum(uneven, 10)).sum(axis=1)
            + np.minimum(np.square((gap[:, -1] - SHUT_M) / 0.01), 9)
            + np.minimum(np.square(np.maximum(0, _WIDE_M - gap[:, 0]) / 0.03), 9)
            + np.minimum(np.square(np.maximum(0, gap[:, 0] - WIDER_M) / 0.05), 4)
            + 2 * lacking
            + 2 * lengthwise
            + 0.05 * np.square((closed - home) / self._range).sum(axis=1)
        )
        at = near.argmax(axis=1)
        rows = np.arange(len(home))
        middle = (c1 + c2) / 2
        cost += self._in_front(middle[rows, at], across[rows, at], placed, weights, at)
        return cost, gap, across, middle, weights, at

    def _palm_sides(self, placed: list[tuple[Array, Array]]) -> list[Array]:
        """For each finger (B, P): how much of each point's normal goes where its surface sets out to."""
        starts = [p[:, -1] - p[:, 0] for p, _ in placed]
        if self._together:
            # Linkages swing their fingers along as well as towards each other; what counts is the second.
            mean = [start.mean(axis=1, keepdims=True) for start in starts]
            starts = [s - mean[1 - i] for i, s in enumerate(starts)]
        starts = [_unit(start) for start in starts]
        # What stands still is met by what arrives.
        last = [p[:, POSES - 1] - p[:, POSES - 2] for p, _ in placed]
        moving = [
            _unit(way.mean(axis=1, keepdims=True)) for way, still in zip(last, self._still, strict=True) if not still
        ]
        weights = []
        for (_, normals), start, still in zip(placed, starts, self._still, strict=True):
            towards = -_unit(np.mean(moving, axis=0)) if still else start
            cosine = np.einsum("bpi,bpi->bp", normals[:, 0], np.broadcast_to(towards, normals[:, 0].shape))
            weights.append(np.clip((cosine - _LEAST_COSINE) / (_GOOD_COSINE - _LEAST_COSINE), 0, 1))
        if self._together:
            # Of a gripper's finger, what is foremost: not the carriage behind it.
            for i, ((points, _), start) in enumerate(zip(placed, starts, strict=True)):
                depth = np.einsum("bpi,bi->bp", points[:, 0], _unit(start.mean(axis=1)))
                front = np.where(weights[i] > 0.3, depth, -np.inf).max(axis=1, keepdims=True)
                weights[i] = weights[i] * (depth > front - _FOREMOST_M)
        if self._still.any():
            weights = self._opposing(placed, weights)
        return weights

    def _opposing(self, placed: list[tuple[Array, Array]], weights: list[Array]) -> list[Array]:
        """Of a palm, and of a jaw that swings towards it, what has room for an object between them where they are about as wide open as it
        is: their tips rather than where the jaw hangs."""
        room = []
        for i, j in ((0, 1), (1, 0)):
            (points, normals), (there, _) = placed[i], placed[j]
            away = there[:, :-1, None] - points[:, :-1, :, None]  # (B, T, P, Q, 3)
            along = np.einsum("btpqi,btpi->btpq", away, normals[:, :-1])
            beside = np.sqrt(np.maximum(np.square(away).sum(axis=-1) - np.square(along), 0))
            counts = (beside < _BESIDE_M) & (weights[j][:, None, None] > 0)
            room.append(np.where(counts, along, np.inf).min(axis=-1))  # (B, T, P)
        most = [
            np.where(np.isfinite(r) & (w[:, None] > 0.3), r, -np.inf).max(axis=-1)
            for r, w in zip(room, weights, strict=True)
        ]
        at = np.abs(np.minimum(*most) - _GRASP_M).argmin(axis=1)
        rows = np.arange(len(at))
        kept = []
        for r, m, w in zip(room, most, weights, strict=True):
            there, largest = r[rows, at], m[rows, at][:, None]
            kept.append(w * (np.isfinite(there) & (there > _ROOM * largest) & (largest > 0)))
        return kept

    def _in_front(self, middle, across, placed, weights, at) -> Array:
        """(B,) what stands in front of the fingertips, seen from the palm, in units of 2 cm."""
        ahead = middle - self._palm_middle
        ahead = _unit(ahead - np.einsum("bi,bi->b", ahead, across)[:, None] * across)
        rows = np.arange(len(middle))
        tips = np.stack(
            [
                _extreme(w[:, None], np.einsum("bpi,bi->bp", p[rows, at], ahead)[:, None], lowest=False)[:, 0]
                for (p, _), w in zip(placed, weights, strict=True)
            ],
            axis=1,
        ).min(axis=1)
        palm = (self._palm @ ahead.T).max(axis=0)
        return np.minimum(np.square(np.maximum(0, palm - tips + 0.01) / 0.02), 9)


def _place(T: Array, finger: Finger) -> tuple[Array, Array]:
    """Points and normals (B, T, P, 3) of a finger whose link is at T (B, T, 4, 4)."""
    R = T[..., :3, :3]
    return finger.points_link @ np.swapaxes(R, -1, -2) + T[..., None, :3, 3], finger.normals_link @ np.swapaxes(
        R, -1, -2
    )


def _mean(weights: Array, values: Array) -> Array:
    """(B, T, 3) of (B, T, P, 3), weighted by (B, P)."""
    return np.einsum("bp,btpi->bti", weights, values) / np.maximum(weights.sum(axis=1), 1e-6)[:, None, None]


def _extreme(weights: Array, heights: Array, lowest: bool) -> Array:
    """(B, T) the outermost of (B, T, P) heights, of the points that count."""
    sign = -1.0 if lowest else 1.0
    counts = weights[:, None] > 0.3 if weights.ndim == 2 else weights > 0.3
    none = ~counts.any(axis=-1)
    found = sign * np.where(counts, sign * heights, -np.inf).max(axis=-1)
    return np.where(none, heights.mean(axis=-1), found)


def _unit(vectors: Array) -> Array:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
