"""Retargeting live: one configuration of the source in, one of the target out."""

from collections.abc import Callable

from cei_gym.alignment.stream import Stream
from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment

type Place = Callable[[Array, Array], tuple[Array, Array]]
"""Joint positions (n,) of the source and the pose (4, 4) of its base to its points and normals (N, 3)."""


class LiveTransfer:
    """One configuration of the source in, one of the target out; see `Transfer.stream`.

    Args:
        target: embodiment wanted.
        place: see `Place`.
        stream: follows the source's pads.
        T_target_source: (4, 4) pose of the source's base in the target's base frame.
    """

    def __init__(self, target: Embodiment, place: Place, stream: Stream, T_target_source: Array) -> None:
        self._target, self._place, self._stream, self._T_target_source = target, place, stream, T_target_source

    def __call__(self, qpos: Array) -> Array:
        """(n,) joint positions of the source to (n',) of the target, rad or m."""
        return self._target.coupled.expand(self._stream(*self._place(qpos, self._T_target_source)))

    def reset(self) -> None:
        """Start anew: the next configuration is a first frame."""
        self._stream.reset()
