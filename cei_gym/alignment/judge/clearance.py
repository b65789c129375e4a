"""How deep a configuration penetrates itself, the support surface or its own stand, and how hard it is to hold."""

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from cei_gym.alignment.links import link_shapes
from cei_gym.alignment.options import ClearanceOptions
from cei_gym.arrays import Array
from cei_gym.compiled import njit
from cei_gym.embodiment.embodiment import Embodiment

SUPPORT, STAND, OBJECT = "the support surface", "its stand", "an object"
"""What links may be in, beside each other."""

_COLUMN_RADIUS_M = 0.20  # a stand is no part of a robot's description: assume one as wide as most, under the base


@dataclass(frozen=True)
class Penetration:
    """How deep a robot is in something over T configurations, and what is in what.

    Attributes:
        depth_m: (T,) the deepest of each configuration, m; 0 where nothing touches.
        between: for each, a link's name and what it is in: another link, `SUPPORT`, `STAND` or `OBJECT`; empty where nothing touches.
    """

    depth_m: Array
    between: tuple[tuple[str, ...], ...]

    def deeper(self, other: "Penetration") -> "Penetration":
        """The deeper of two at each configuration."""
        both = zip(self.depth_m, other.depth_m, self.between, other.between, strict=True)
        between = tuple(theirs if b > a else ours for a, b, ours, theirs in both)
        return Penetration(np.maximum(self.depth_m, other.depth_m), between)


class Clearance:
    """Penetration and static torque of an embodiment over a flat support surface.

    Contacts within the end-effector do not count: meshes of neighbouring finger links overlap by design.

    Args:
        embodiment: the embodiment.
        options: margins to the support surface; a link that comes nearer is in it by what it lacks.
    """

    def __init__(self, embodiment: Embodiment, options: ClearanceOptions | None = None) -> None:
        options = options or ClearanceOptions()
        self._model = embodiment.model
        self._names = embodiment.link_names
        self._hand = embodiment.of_end_effector
        shapes = link_shapes(embodiment)
        counts = [len(vertices) for vertices in shapes.vertices_link]
        self._vertices = np.concatenate([np.zeros((0, 3)), *shapes.vertices_link])
        self._bodies = np.repeat(shapes.body, counts)
        self._margins = np.repeat(np.where(shapes.hand, options.hand_margin_m, options.arm_margin_m), counts)
        # Torque motors with a stated range; position servos state none.
        driven = (self._model.actuator_biasprm[:, 1] == 0) & (self._model.actuator_ctrlrange[:, 1] > 0)
        self._motor_joint = self._model.actuator_trnid[driven, 0]
        self._motor_limit = self._model.actuator_ctrlrange[driven, 1] * np.abs(self._model.actuator_gear[driven, 0])

    def worst(self, qpos: Array, support_z_base_m: float) -> tuple[float, float]:
        """Deepest penetration (m) and largest share of an arm motor's limit spent on gravity.

        Args:
            qpos: (T, n) configurations, rad or m.
            support_z_base_m: height of the surface in the base frame.
        """
        depth, share = 0.0, 0.0
        for data, depth_m, _ in self._placed(qpos, support_z_base_m):
            depth = max(depth, depth_m)
            mujoco.mj_fwdVelocity(self._model, data)
            if len(self._motor_joint):
                share = max(share, float(np.max(np.abs(data.qfrc_bias[self._motor_joint]) / self._motor_limit)))
        return depth, share

    def penetration(self, qpos: Array, support_z_base_m: float) -> Penetration:
        """The deepest penetration at each of (T, n) configurations; arguments as for `worst`."""
        found = [(depth_m, between) for _, depth_m, between in self._placed(qpos, support_z_base_m)]
        return Penetration(np.array([depth_m for depth_m, _ in found]), tuple(between for _, between in found))

    def _placed(self, qpos: Array, support_z_base_m: float) -> Iterator[tuple[mujoco.MjData, float, tuple[str, ...]]]:
        """For each configuration the simulator's data with it, the deepest penetration, m, and what is in what."""
        data = mujoco.MjData(self._model)
        for q in qpos:
            data.qpos[:] = q
            mujoco.mj_fwdPosition(self._model, data)
            found = max(self._in_itself(data), self._in_surroundings(data, support_z_base_m), key=lambda each: each[0])
            yield data, *found

    def _in_itself(self, data: mujoco.MjData) -> tuple[float, tuple[str, ...]]:
        if data.ncon == 0:
            return 0.0, ()
        bodies = self._model.geom_bodyid[data.contact.geom]
        depth = np.where(self._hand[bodies].all(axis=1), 0.0, -data.contact.dist)
        worst = int(depth.argmax())
        if depth[worst] <= 0:
            return 0.0, ()
        return float(depth[worst]), tuple(self._names[body] for body in bodies[worst])

    def _in_surroundings(self, data: mujoco.MjData, support_z_base_m: float) -> tuple[float, tuple[str, ...]]:
        """Below the support surface, or in the column that the robot stands on."""
        arrays = self._bodies, self._vertices, self._margins, support_z_base_m
        depth, body, in_stand = _deepest(data.xmat, data.xpos, *arrays)
        if depth <= 0:
            return 0.0, ()
        return float(depth), (self._names[body], STAND if in_stand else SUPPORT)


@njit(cache=True, nogil=True)
def _deepest(R, p, bodies, vertices, margins, support_z):
    """Depth of the vertex that is deepest below the surface or in the stand, its body, and whether it is in the stand."""
    deepest, which, in_stand = 0.0, 0, False
    for n in range(len(bodies)):
        b = bodies[n]
        v = vertices[n]
        x = R[b, 0] * v[0] + R[b, 1] * v[1] + R[b, 2] * v[2] + p[b, 0]
        y = R[b, 3] * v[0] + R[b, 4] * v[1] + R[b, 5] * v[2] + p[b, 1]
        z = R[b, 6] * v[0] + R[b, 7] * v[1] + R[b, 8] * v[2] + p[b, 2]
        into_column = min(_COLUMN_RADIUS_M - np.hypot(x, y), -z)
        below = support_z + margins[n] - z
        if max(below, into_column) > deepest:
            deepest, which, in_stand = max(below, into_column), b, into_column > below
    return deepest, which, in_stand
