"""What an end-effector does to objects over time."""

from dataclasses import dataclass

import numpy as np

from cei_gym.arrays import Array


@dataclass(frozen=True)
class Grip:
    """An end-effector over T frames.

    Attributes:
        axis: (T, 3) unit direction in which side 0 presses; side 1 presses against it.
        contacts: (T, 2, 3) where each side meets what is between them, m.
        position, rotation: (T, 3), (T, 3, 3) of the end-effector's root: a held object moves with it.
        held: (T,) whether something is held.
    """

    axis: Array
    contacts: Array
    position: Array
    rotation: Array
    held: Array

    def at(self, frames: Array) -> "Grip":
        """The grip with its frames at these indices."""
        return Grip(*(value[frames] for value in vars(self).values()))

    @property
    def carried_m(self) -> Array:
        """(T,) how far the end-effector has moved since it took hold, m; 0 where it holds nothing."""
        carried, since = np.zeros(len(self.held)), None
        for t, held in enumerate(self.held):
            since = (t if since is None else since) if held else None
            if since is not None:
                carried[t] = np.linalg.norm(self.contacts[t].mean(axis=0) - self.contacts[since].mean(axis=0))
        return carried
