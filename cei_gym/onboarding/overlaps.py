"""Links that are in each other: by design, in most poses, or in one."""

import mujoco
import numpy as np

from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment

_DEEP_M = 0.003
_POSES = 20

type Pair = tuple[str, str]
"""Names of two links."""


class Overlaps:
    """Which links of an embodiment are in each other.

    Args:
        embodiment: MuJoCo's own rules say which of its links may touch at all.

    Attributes:
        by_design: pairs that are over 3 mm deep in each other in most of some random poses.
    """

    def __init__(self, embodiment: Embodiment) -> None:
        self._embodiment, self._data = embodiment, mujoco.MjData(embodiment.model)
        lower, upper = embodiment.independent_limits
        u = np.random.default_rng(0).uniform(lower, np.maximum(lower, upper), size=(_POSES, len(lower)))
        found = [self.at(qpos) for qpos in embodiment.coupled.expand(u)]
        pairs = {pair for each in found for pair in each}
        self.by_design = {pair for pair in pairs if sum(pair in each for each in found) > _POSES / 2}

    def at(self, qpos: Array) -> dict[Pair, float]:
        """How deep, m, links are in each other at joint positions (n,), where it is over 3 mm."""
        model = self._embodiment.model
        self._data.qpos[:] = qpos
        mujoco.mj_fwdPosition(model, self._data)
        found: dict[Pair, float] = {}
        for contact in self._data.contact:
            one, two = sorted(int(model.geom_bodyid[geom]) for geom in contact.geom)
            pair = (self._embodiment.link_names[one], self._embodiment.link_names[two])
            found[pair] = max(found.get(pair, 0.0), -float(contact.dist))
        return {pair: depth_m for pair, depth_m in found.items() if depth_m > _DEEP_M}

    def deepest_m(self, qpos: Array) -> float:
        """The deepest of those that are not by design, m; 0 where there are none."""
        return max((depth for pair, depth in self.at(qpos).items() if pair not in self.by_design), default=0.0)
