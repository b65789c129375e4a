"""Retargeting live: one configuration of the source in, one of the target out."""

from cei_gym.alignment.grip import Grip
from cei_gym.alignment.stream import Stream
from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment
from cei_gym.transfer.source_side import AT_REST, SourceSide


class LiveSource:
    """What a source does with its pads, frame by frame.

    Args:
        side: of the transfer.
        T_target_source: (4, 4) pose of the source's base in the target's base frame.
        held_m: how far a hand is told to close beyond where it rests, for it to hold something.
        dt_s: time between frames; None where it is not known, and then nothing is known to rest.
    """

    def __init__(self, side: SourceSide, T_target_source: Array, held_m: float, dt_s: float | None) -> None:
        self._side, self._T, self._held_m, self._dt_s = side, T_target_source, held_m, dt_s
        self._last: tuple[Array, bool] | None = None

    def place(self, qpos: Array) -> tuple[Array, Array]:
        """Points and normals (N, 3) in the target's base frame, m and unit, at (n,) joint positions."""
        return self._side.place(qpos, self._T)

    def closing_m(self, qpos: Array, told: Array) -> float:
        """How much farther pads are told to go than they are, m; see `SourceSide.closing_m`."""
        return float(self._side.closing_m(qpos, told, self._T))

    def grip(self, qpos: Array, closing_m: float) -> Grip | None:
        """What it does in this frame: told to close, now and a frame ago, but at rest, it holds something.

        Returns:
            None where it has no pads that close on each other.
        """
        hand, closes = qpos[self._side.embodiment.n_arm :], closing_m > self._held_m
        held = False
        if closes and self._dt_s is not None and self._last is not None:
            last, closed = self._last
            held = closed and bool((abs(hand - last) < AT_REST * self._dt_s).all())
        self._last = hand.copy(), closes
        return self._side.grip_at(qpos, self._T, held)

    def reset(self) -> None:
        """Forget the past."""
        self._last = None


class LiveTransfer:
    """One configuration of the source in, one of the target out; see `Transfer.stream`.

    Args:
        target: embodiment wanted.
        source: what is followed.
        stream: follows it.
    """

    def __init__(self, target: Embodiment, source: LiveSource, stream: Stream) -> None:
        self._target, self._source, self._stream = target, source, stream

    def __call__(self, qpos: Array, action: Array | None = None) -> Array:
        """(n,) joint positions of the source to (n',) of the target, rad or m.

        Args:
            qpos: where the source is.
            action: (n,) where it is told to go: a hand that is told to close, and does not, holds something. None: nothing is known to be held.
        """
        closing_m = 0.0 if action is None else self._source.closing_m(qpos, action)
        u = self._stream(*self._source.place(qpos), self._source.grip(qpos, closing_m))
        return self._target.coupled.expand(u)

    def reset(self) -> None:
        """Start anew: the next configuration is a first frame."""
        self._stream.reset()
        self._source.reset()
