"""The source's side of a transfer: where its pads and links are in the target's base frame, what it holds and how hard."""

from dataclasses import replace

import numpy as np

from cei_gym.alignment.contact.observed import onto_objects, source_grip
from cei_gym.alignment.contact.pads import opposing_sides, pad_shapes
from cei_gym.alignment.grip import Grip
from cei_gym.alignment.links import link_shapes
from cei_gym.alignment.options import ContactOptions
from cei_gym.alignment.problem import Motion, Surroundings
from cei_gym.arrays import Array
from cei_gym.demonstration import Demonstration
from cei_gym.embodiment import Embodiment
from cei_gym.functional import FunctionalRepresentation
from cei_gym.kinematics import KinematicTree

AT_REST = 0.02
"""rad/s or m/s: a finger slower than this has stopped."""


class SourceSide:
    """What a source does in its demonstrations, in the target's base frame.

    Args:
        representation: of the source.
        contact: when it holds something, and how hard.
        T_world_target: (4, 4) pose of the target's base; the source's own if None.
    """

    def __init__(
        self, representation: FunctionalRepresentation, contact: ContactOptions, T_world_target: Array | None
    ) -> None:
        self.embodiment: Embodiment = representation.embodiment
        self.representation, self._contact, self._T_world_target = representation, contact, T_world_target
        self.tree = KinematicTree(self.embodiment)
        self._shapes = link_shapes(self.embodiment)
        self._sides = opposing_sides(representation, self.tree)
        self._pads = None if self._sides is None else pad_shapes(representation, self._sides)

    def T_world_target(self, demonstration: Demonstration) -> Array:
        """(4, 4) pose of the target's base."""
        return demonstration.scene.T_world_base if self._T_world_target is None else self._T_world_target

    def T_target_source(self, demonstration: Demonstration) -> Array:
        """(4, 4) pose of the source's base in the target's, or (T, 4, 4) where the source is displaced."""
        T_world_source, moved = demonstration.scene.T_world_base, demonstration.displacement
        if moved is not None:
            T_world_source = moved.T_world_source @ T_world_source
        return np.linalg.inv(self.T_world_target(demonstration)) @ T_world_source

    def links(self, demonstration: Demonstration) -> Array:
        """(T, L, 4, 4) poses of the source's links in the target's base frame."""
        return self.T_target_source(demonstration)[..., None, :, :] @ self.tree.forward(demonstration.qpos)

    def hand(self, demonstration: Demonstration) -> Array:
        """(T, 4, 4) pose of the end-effector's root in the target's base frame."""
        return self.links(demonstration)[:, self.embodiment.end_effector_root]

    def place(self, qpos: Array, T_target_source: Array) -> tuple[Array, Array]:
        """Points and normals (..., N, 3) in the target's base frame, at (..., n) joint positions.

        T_target_source is (4, 4), or (..., 4, 4): one for each.
        """
        return self.representation.place(T_target_source[..., None, :, :] @ self.tree.forward(qpos))

    def support_z_m(self, demonstration: Demonstration) -> float:
        """Height of the support surface in the target's base frame: the scene's, or lower where the source itself went lower."""
        scene = demonstration.scene
        lowest_world = self._shapes.lowest(scene.T_world_base @ self.tree.forward(demonstration.qpos))
        # Bases stand upright, so a height in the world and one in the base frame differ by the base's own.
        return min(scene.support_z_m, lowest_world) - float(self.T_world_target(demonstration)[2, 3])

    def motion(self, demonstration: Demonstration, u0: Array) -> Motion:
        """What the source's pads do over the support surface, and its grip; it starts from (m,) joints of the target."""
        points, normals = self.place(demonstration.qpos, self.T_target_source(demonstration))
        motion = Motion(points, normals, u0, dt_s=1.0 / demonstration.fps)
        surroundings = Surroundings(self.support_z_m(demonstration))
        return replace(motion, grip=self._grip(demonstration), surroundings=surroundings)

    def among(
        self, demonstration: Demonstration, motion: Motion, obstacles_base: list[Array], tool_points: float
    ) -> Motion:
        """The motion among objects: grips are where objects are. The last two arguments are those of `Surroundings`."""
        assert motion.surroundings is not None
        grip = motion.grip
        if grip is not None and self._pads is not None and len(obstacles_base):
            pads = np.concatenate(self._pads.place(self.links(demonstration)), axis=1)
            grip = onto_objects(grip, pads, obstacles_base, self._contact.grip_radius_m)
        around = replace(motion.surroundings, obstacles_base=obstacles_base, tool_points=tool_points)
        return replace(motion, grip=grip, surroundings=around)

    def squeeze_m(self, demonstration: Demonstration) -> Array:
        """(T,) how far the pads press into what they hold, m."""
        return np.clip(self._closing_m(demonstration), 0.0, self._contact.squeeze_m)

    def grip_at(self, qpos: Array, T_target_source: Array, held: bool) -> Grip | None:
        """What it does in one frame, at (n,) joint positions; None where it has no pads that close on each other."""
        return self._grip_of(T_target_source @ self.tree.forward(qpos)[None], np.array([held]))

    def closing_m(self, qpos: Array, action: Array, T_target_source: Array) -> Array:
        """(...) how far each pad is told to go beyond where it is, in the mean, m, at (..., n) joint positions and targets; those of the arm do not count."""
        commanded = qpos.copy()
        hand = slice(self.embodiment.n_arm, None)
        commanded[..., hand] = action[..., hand]
        (is_, normals), (wanted, _) = (self.place(q, T_target_source) for q in (qpos, commanded))
        return np.einsum("...ni,...ni->...n", wanted - is_, normals).mean(axis=-1)

    def _closing_m(self, demonstration: Demonstration) -> Array:
        """(T,) the same of a demonstration."""
        return self.closing_m(demonstration.qpos, demonstration.action, self.T_target_source(demonstration))

    def _grip(self, demonstration: Demonstration) -> Grip | None:
        if self._sides is None:
            return None
        # Told to close, but at rest: something is in between.
        hand = demonstration.qpos[:, self.embodiment.n_arm :]
        moves = (np.abs(np.diff(hand, axis=0)) * demonstration.fps > AT_REST).any(axis=1)
        at_rest = ~np.append(False, moves) & ~np.append(moves, False)  # neither on its way nor about to set out
        held = (self._closing_m(demonstration) > self._contact.held_m) & at_rest
        return self._grip_of(self.links(demonstration), held)

    def _grip_of(self, T_links: Array, held: Array) -> Grip | None:
        if self._sides is None:
            return None
        root = self.embodiment.end_effector_root
        return source_grip(self.representation, self._sides, root, T_links, held, self._pads)
