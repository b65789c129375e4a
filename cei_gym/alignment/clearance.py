"""How deep a configuration penetrates itself, the support surface or its own stand, and how hard it is to hold."""

from collections.abc import Iterator

import mujoco
import numpy as np
from numba import njit

from cei_gym.alignment.links import link_shapes
from cei_gym.embodiment.embodiment import END_EFFECTOR_PREFIX, Embodiment

_COLUMN_RADIUS_M = 0.20  # a stand is no part of a robot's description: assume one as wide as most, under the base
_ARM_MARGIN_M = 0.02  # a hand may touch the table beside what it grasps; an arm has no business near it


class Clearance:
    """Penetration and static torque of an embodiment over a flat support surface.

    Contacts within the end-effector do not count: meshes of neighbouring finger links overlap by design.

    Args:
        embodiment: the embodiment.
    """

    def __init__(self, embodiment: Embodiment) -> None:
        self._model = embodiment.model
        self._hand = np.array([name.startswith(END_EFFECTOR_PREFIX) for name in embodiment.body_names])
        shapes = link_shapes(embodiment)
        counts = [len(vertices) for vertices in shapes.vertices_link]
        self._vertices = np.concatenate([np.zeros((0, 3)), *shapes.vertices_link])
        self._bodies = np.repeat(shapes.body, counts)
        self._margins = np.repeat(np.where(shapes.hand, 0.0, _ARM_MARGIN_M), counts)
        # Torque motors with a stated range; position servos state none.
        driven = (self._model.actuator_biasprm[:, 1] == 0) & (self._model.actuator_ctrlrange[:, 1] > 0)
        self._motor_joint = self._model.actuator_trnid[driven, 0]
        self._motor_limit = self._model.actuator_ctrlrange[driven, 1] * np.abs(self._model.actuator_gear[driven, 0])

    def worst(self, qpos: np.ndarray, support_z_base_m: float) -> tuple[float, float]:
        """Deepest penetration (m) and largest share of an arm motor's limit spent on gravity.

        Args:
            qpos: (T, n) configurations, rad or m.
            support_z_base_m: height of the surface in the base frame.
        """
        depth, share = 0.0, 0.0
        for data, depth_m in self._placed(qpos, support_z_base_m):
            depth = max(depth, depth_m)
            mujoco.mj_fwdVelocity(self._model, data)
            if len(self._motor_joint):
                share = max(share, float(np.max(np.abs(data.qfrc_bias[self._motor_joint]) / self._motor_limit)))
        return depth, share

    def depth_m(self, qpos: np.ndarray, support_z_base_m: float) -> np.ndarray:
        """(T,) deepest penetration at each configuration, m; arguments as for `worst`."""
        return np.array([depth_m for _, depth_m in self._placed(qpos, support_z_base_m)])

    def _placed(self, qpos: np.ndarray, support_z_base_m: float) -> Iterator[tuple[mujoco.MjData, float]]:
        """For each configuration the simulator's data with it, and the deepest penetration, m."""
        data = mujoco.MjData(self._model)
        for q in qpos:
            data.qpos[:] = q
            mujoco.mj_fwdPosition(self._model, data)
            yield data, max(self._self_depth(data), self._surroundings_depth(data, support_z_base_m))

    def _self_depth(self, data: mujoco.MjData) -> float:
        if data.ncon == 0:
            return 0.0
        hand = self._hand[self._model.geom_bodyid[data.contact.geom]]
        depth = np.where(hand.all(axis=1), 0.0, -data.contact.dist)
        return float(max(0.0, depth.max()))

    def _surroundings_depth(self, data: mujoco.MjData, support_z_base_m: float) -> float:
        """Depth below the support surface, or into the column that the robot stands on."""
        return float(_deepest(data.xmat, data.xpos, self._bodies, self._vertices, self._margins, support_z_base_m))


@njit(cache=True, nogil=True)
def _deepest(R, p, bodies, vertices, margins, support_z):
    deepest = 0.0
    for n in range(len(bodies)):
        b = bodies[n]
        v = vertices[n]
        x = R[b, 0] * v[0] + R[b, 1] * v[1] + R[b, 2] * v[2] + p[b, 0]
        y = R[b, 3] * v[0] + R[b, 4] * v[1] + R[b, 5] * v[2] + p[b, 1]
        z = R[b, 6] * v[0] + R[b, 7] * v[1] + R[b, 8] * v[2] + p[b, 2]
        into_column = min(_COLUMN_RADIUS_M - np.hypot(x, y), -z)
        deepest = max(deepest, support_z + margins[n] - z, into_column)
    return deepest
