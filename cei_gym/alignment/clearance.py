"""How deep a configuration penetrates itself, the support surface or its own stand, and how hard it is to hold."""

import mujoco
import numpy as np

from cei_gym.embodiment.embodiment import END_EFFECTOR_PREFIX, Embodiment
from cei_gym.embodiment.meshes import collision_geoms, link_mesh
from cei_gym.kinematics import KinematicTree

_DIRECTIONS = 128
_COLUMN_RADIUS_M = 0.20  # a stand is no part of a robot's description: assume one as wide as most, under the base
_ARM_MARGIN_M = 0.02  # a hand may touch the table beside what it grasps; an arm has no business near it


class Clearance:
    """Penetration and static torque of an embodiment over a flat support surface.

    Contacts within the end-effector do not count: meshes of neighbouring finger links overlap by design.

    Args:
        embodiment: the embodiment.
        support_z_base_m: height of the surface in the base frame.
    """

    def __init__(self, embodiment: Embodiment, support_z_base_m: float) -> None:
        self._model, self._support_z = embodiment.model, support_z_base_m
        names = embodiment.body_names
        self._hand = np.array([n.startswith(END_EFFECTOR_PREFIX) for n in names])
        moving = KinematicTree(embodiment).arrays.body_joint >= 0
        bodies, vertices, margins = [], [], []
        for body in np.flatnonzero(moving | self._hand):
            mesh = link_mesh(self._model, collision_geoms(self._model, int(body)))
            if mesh is not None:
                extremes = _extreme_points(np.asarray(mesh.vertices))
                vertices.append(extremes)
                bodies.append(np.full(len(extremes), body))
                margins.append(np.full(len(extremes), 0.0 if self._hand[body] else _ARM_MARGIN_M))
        self._vertices = np.concatenate(vertices) if vertices else np.zeros((0, 3))
        self._bodies = np.concatenate(bodies) if bodies else np.zeros(0, int)
        self._margins = np.concatenate(margins) if margins else np.zeros(0)
        # Torque motors with a stated range; position servos state none.
        driven = (self._model.actuator_biasprm[:, 1] == 0) & (self._model.actuator_ctrlrange[:, 1] > 0)
        self._motor_joint = self._model.actuator_trnid[driven, 0]
        self._motor_limit = self._model.actuator_ctrlrange[driven, 1]

    def worst(self, qpos: np.ndarray) -> tuple[float, float]:
        """Deepest penetration (m) and largest share of an arm motor's limit spent on gravity, over (T, n) qpos."""
        data = mujoco.MjData(self._model)
        depth, share = 0.0, 0.0
        for q in qpos:
            data.qpos[:] = q
            mujoco.mj_fwdPosition(self._model, data)
            depth = max(depth, self._self_depth(data), self._surroundings_depth(data))
            mujoco.mj_fwdVelocity(self._model, data)
            if len(self._motor_joint):
                share = max(share, float(np.max(np.abs(data.qfrc_bias[self._motor_joint]) / self._motor_limit)))
        return depth, share

    def _self_depth(self, data: mujoco.MjData) -> float:
        if data.ncon == 0:
            return 0.0
        hand = self._hand[self._model.geom_bodyid[data.contact.geom]]
        depth = np.where(hand.all(axis=1), 0.0, -data.contact.dist)
        return float(max(0.0, depth.max()))

    def _surroundings_depth(self, data: mujoco.MjData) -> float:
        """Depth below the support surface, or into the column that the robot stands on."""
        points = np.einsum("vij,vj->vi", data.xmat.reshape(-1, 3, 3)[self._bodies], self._vertices)
        points += data.xpos[self._bodies]
        below_surface = self._support_z + self._margins - points[:, 2]
        into_column = np.minimum(_COLUMN_RADIUS_M - np.hypot(points[:, 0], points[:, 1]), -points[:, 2])
        return float(np.max(np.maximum(below_surface, into_column), initial=0.0))


def _extreme_points(vertices: np.ndarray) -> np.ndarray:
    """The vertices (V, 3) that lie farthest out in evenly spread directions: enough to tell which touches a plane."""
    i = np.arange(_DIRECTIONS) + 0.5
    polar, turn = np.arccos(1 - 2 * i / _DIRECTIONS), np.pi * (1 + 5**0.5) * i
    directions = np.stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], axis=1)
    return vertices[np.unique((vertices @ directions.T).argmax(axis=0))]
