"""All that can be said against episodes, and what can be learnt of their scene, before any work: their joints are read once."""

from collections.abc import Callable, Iterable

import numpy as np

from cei_converters.sources.recording import spread
from cei_converters.sources.source import Source
from cei_gym.alignment.links import link_shapes
from cei_gym.demonstration import Demonstration
from cei_gym.errors import CEIError
from cei_gym.kinematics import KinematicTree

LOWEST = "the source's lowest point"
"""Who says where the table is where nobody does."""

TABLE_EPISODES = 500
"""So many of a dataset, spread over it, say where the table is, and those that are converted: an arm has been down long before."""

FEW_EPISODES = 8
"""How many episodes are read of a source whose joints take long to read."""


def survey(source: Source, episodes: Iterable[int], done: Callable[[int], None] = lambda _: None) -> float | None:
    """Read what episodes have but for what cameras saw, and check it; of a source that takes long, of a few.

    Args:
        source: of the demonstrations.
        episodes: those to convert.
        done: called with the number of frames of each.

    Returns:
        The height of the lowest point that the robot reached, world, m, in the dataset's episodes; None where the table is known.

    Raises:
        CEIError: one cannot be read, or is not what it is said to be.
    """
    lowest = None if source.table_from else _Lowest(source)
    wanted = sorted(set(episodes))
    if not source.quick:
        wanted = [wanted[i] for i in spread(len(wanted), FEW_EPISODES)]
    for index in wanted:
        demonstration = source.read(index, clouds=False)
        if source.carried:
            source.carry(index)
        if lowest is not None:
            lowest.add(demonstration)
        done(len(demonstration))
    if lowest is None:
        return None
    most = TABLE_EPISODES if source.quick else FEW_EPISODES
    for index in sorted(set(spread(len(source), most)) - set(wanted)):
        try:
            lowest.add(source.read(index, clouds=False))
        except CEIError:  # of an episode that nobody wants
            continue
    return lowest.z_m


class _Lowest:
    """Height of the lowest point of a robot in all its demonstrations, its foot included, world, m; rounded down.

    An arm that never comes as low as it stands says nothing of the table but that: a table above its foot would be in its way.
    """

    def __init__(self, source: Source) -> None:
        self._shapes, self._tree = link_shapes(source.embodiment), KinematicTree(source.embodiment)
        self._z_m = float(source.scene.T_world_base[2, 3])

    def add(self, demonstration: Demonstration) -> None:
        T_world_links = demonstration.scene.T_world_base @ self._tree.forward(demonstration.qpos)
        self._z_m = min(self._z_m, self._shapes.lowest(T_world_links))

    @property
    def z_m(self) -> float:
        return float(np.floor(self._z_m * 1e4) / 1e4)
