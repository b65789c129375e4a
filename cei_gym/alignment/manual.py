"""Binary Manual Specification (BMS), the paper's baseline (section VI-A, ablation study): no functional representation,
but a tool frame that the arm carries along and a hand that only opens and closes."""

import numpy as np

from cei_gym.arrays import Array
from cei_gym.embodiment.embodiment import Embodiment
from cei_gym.errors import CEIError
from cei_gym.functional.representation import FunctionalRepresentation, sample_representation
from cei_gym.kinematics.inverse import follow_link
from cei_gym.kinematics.tree import KinematicTree

_POINTS = 512  # enough for a pad's centroid to a millimetre
_CLOSINGS = np.linspace(0.0, 1.0, 257)


class ManualTool:
    """What a person specifies of an end-effector: a tool frame fixed to the flange, and what its aperture is.

    The pads form two opposing groups (thumb and fingers). The tool frame is set up in the open pose and stays there,
    wherever the pads go: origin midway between the groups' centroids; x from the group of fewer pads (the first pad's, if
    they are as many) to the other, as the pads close; z from the flange towards the pads, orthogonal to x.

    Args:
        embodiment: whose end-effector has at least two opposing pads.

    Attributes:
        flange: the link that carries the end-effector.
        T_flange_tool: (4, 4) tool frame in the flange's.

    Raises:
        CEIError: no pads, or none that oppose each other.
    """

    def __init__(self, embodiment: Embodiment) -> None:
        self.embodiment = embodiment
        self._tree = KinematicTree(embodiment)
        self._representation = sample_representation(embodiment, _POINTS)
        arm = embodiment.arm
        self.flange = 0 if arm is None else embodiment.model.body(arm.mount_body).id
        T_links = self._tree.forward(embodiment.home)
        self._first_group = _first_group(self._representation, T_links)
        first, second = self._centroids(T_links)
        T_flange, T_tool = T_links[self.flange], np.eye(4)
        T_tool[:3, 3] = (first + second) / 2
        x = _unit(second - first)
        approach = T_tool[:3, 3] - T_flange[:3, 3]
        z = _unit(approach - (approach @ x) * x)
        T_tool[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
        self.T_flange_tool = np.linalg.inv(T_flange) @ T_tool

    def pose(self, qpos: Array) -> Array:
        """(..., n) joint positions to tool frames (..., 4, 4) in the base frame."""
        return self._tree.forward(qpos)[..., self.flange, :, :] @ self.T_flange_tool

    def aperture(self, qpos: Array) -> Array:
        """(..., n) joint positions to the distance (...) between the two groups' centroids, m."""
        first, second = self._centroids(self._tree.forward(qpos))
        return np.linalg.norm(second - first, axis=-1)

    def _centroids(self, T_links: Array) -> tuple[Array, Array]:
        points, _ = self._representation.place(T_links)
        return points[..., self._first_group, :].mean(-2), points[..., ~self._first_group, :].mean(-2)


class ManualAlignment:
    """Moves trajectories by Binary Manual Specification.

    Args:
        source: embodiment of the trajectories.
        target: embodiment wanted.
        half_turn: the target takes the source's place half a turn about z further: which finger of a parallel gripper the
            thumb stands in for is a person's choice, and often only one of the two can be reached.

    Raises:
        CEIError: the target has no arm, or either has no opposing pads.
    """

    def __init__(self, source: Embodiment, target: Embodiment, half_turn: bool = False) -> None:
        if target.arm is None:
            raise CEIError(f"{target.name} has no arm, which manual specification needs to move the hand.")
        self.source, self.target = ManualTool(source), ManualTool(target)
        if half_turn:
            self.source.T_flange_tool[:3, :2] *= -1

    def track(self, qpos_source: Array, T_target_source: Array) -> Array:
        """Follow a trajectory: the arm by inverse kinematics of the tool frame, the hand by the aperture.

        Frame 0 starts from the home pose, or from one around it where the trajectory cannot be followed from there. Frames
        out of reach come near, within limits.

        Args:
            qpos_source: (T, n) the source's joint positions, rad or m.
            T_target_source: (4, 4) pose of the source's base in the target's.

        Returns:
            (T, m) independent joints of the target, rad or m, within limits.
        """
        embodiment = self.target.embodiment
        T_flange = T_target_source @ self.source.pose(qpos_source) @ np.linalg.inv(self.target.T_flange_tool)
        u = embodiment.coupled.reduce(follow_link(embodiment, self.target.flange, T_flange).qpos)
        closing = self.closing(self.source.aperture(qpos_source))[:, None]
        home, closed = (embodiment.coupled.reduce(pose) for pose in (embodiment.home, embodiment.closed))
        hand = embodiment.coupled.independent >= embodiment.n_arm
        u[:, hand] = ((1 - closing) * home + closing * closed)[:, hand]
        return np.clip(u, *embodiment.independent_limits)

    def closing(self, aperture_m: Array) -> Array:
        """How far the target's hand closes, from 0 (`home`) to 1 (`closed`), to have an aperture.

        A thumb's aperture may widen again on the way, when fingers pass it: the first crossing from the open pose counts.
        Apertures that the target cannot have are clipped to those that it can.

        Args:
            aperture_m: (T,) m.

        Returns:
            (T,) fractions.
        """
        home, closed = self.target.embodiment.home, self.target.embodiment.closed
        possible = self.target.aperture((1 - _CLOSINGS[:, None]) * home + _CLOSINGS[:, None] * closed)
        wanted = np.clip(aperture_m, possible.min(), possible[0])
        after = np.argmax(possible <= wanted[:, None], axis=1)
        before = np.maximum(after - 1, 0)
        step = np.maximum(possible[before] - possible[after], np.finfo(float).tiny)
        share = (possible[before] - wanted) / step
        return _CLOSINGS[before] + share * (_CLOSINGS[after] - _CLOSINGS[before])


def _first_group(representation: FunctionalRepresentation, T_links: Array) -> Array:
    """(N,) which points belong to the group of fewer pads, of the two that normals split the pads into."""
    _, normals = representation.place(T_links)
    pads, pad = np.unique(representation.body, return_inverse=True)
    mean = np.array([normals[pad == i].mean(axis=0) for i in range(len(pads))])
    mean -= mean.mean(axis=0)
    along = mean @ np.linalg.svd(mean)[2][0]  # the axis on which the pads' normals differ most
    if np.ptp(along) < 0.5:
        raise CEIError(f"{representation.embodiment.name} has no pads that oppose each other when it is open.")
    side = along > 0
    return min(side, ~side, key=lambda group: (group.sum(), not group[0]))[pad]


def _unit(vector: Array) -> Array:
    return vector / np.linalg.norm(vector)
