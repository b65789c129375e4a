"""Refine a followed trajectory so that contact is carried over, not only the pads' places.

The DCD hardly changes when a hand turns about its closing direction, or when one finger of two misses the object. What is
held does: it turns with the hand, and falls. So contact points are made to oppose each other where the source's do, the palm
keeps its turn against the source's end-effector, and while something is held, hand and object move as one.
"""

from dataclasses import replace
from functools import cached_property

import numpy as np

from cei_gym.alignment.contact.pads import opposing_sides, pad_shapes
from cei_gym.alignment.grip import Grip
from cei_gym.alignment.kernels import grasp as kernels
from cei_gym.alignment.kernels.contact import Grasp, in_grip
from cei_gym.alignment.kernels.distance import distances
from cei_gym.alignment.kernels.overlap import overlaps
from cei_gym.alignment.kernels.target import make_target
from cei_gym.alignment.links import collision_constraint, no_collision_constraint, pack_obstacles
from cei_gym.alignment.options import ContactOptions, SolverOptions
from cei_gym.alignment.problem import AlignmentProblem, Motion, Surroundings, Track
from cei_gym.arrays import Array
from cei_gym.kinematics.joints import reduce_to_joints

_ITERATIONS = 20
_TOLERANCE_M = 1e-6
_CLEARANCE_FIRST = 4.0


class GraspRefiner:
    """Refines trajectories of one target.

    Args:
        problem: the target.
        options: of the solver that followed them (speeds, clearance, lambda).
        contact: weights.
    """

    def __init__(self, problem: AlignmentProblem, options: SolverOptions, contact: ContactOptions) -> None:
        self._problem, self._options, self._contact = problem, options, contact
        self._sides = opposing_sides(problem.representation, problem.tree)

    def refine(self, motion: Motion, track: Track) -> Track:
        """A track with contact carried over; as it is where there is nothing to carry (no grip, one-sided hands)."""
        if (grip := self._grip(motion)) is None:
            return track
        reference = int(np.argmax(grip.held)) if grip.held.any() else -1
        target, grasp, away, pads = self.arrays
        if self.turned_around(grip.axis[max(reference, 0)], track.u[max(reference, 0)]):
            grasp = grasp._replace(side=1 - grasp.side)
        support, around, elsewhere = self._surroundings(motion, grip, len(track.u))
        u, miss = kernels.refine(
            target,
            grasp,
            away._replace(height_m=support),
            pads,
            around,
            elsewhere,
            kernels.GripArrays(grip.axis, grip.contacts, grip.position, grip.rotation, grip.held),
            reference,
            (motion.dt_s or 0.0) * self._options.velocity_scale,
            np.ascontiguousarray(track.u, float),
        )
        return replace(track, u=u, objective=self._objective(motion, u), contact_miss_m=miss)

    def overlap(self, motion: Motion, u: Array) -> tuple[Array, list[str]]:
        """(T,) how deep links are in objects at (T, m) configurations, m, and which is deepest; pads in what is gripped do not
        count."""
        if (grip := self._grip(motion)) is None:
            return np.zeros(len(u)), [""] * len(u)
        target, _, away, pads = self.arrays
        _, around, elsewhere = self._surroundings(motion, grip, len(u))
        depth_m, which = overlaps(target, away, pads, around, elsewhere, np.ascontiguousarray(u, float))
        return depth_m, [self._problem.embodiment.link_names[body] for body in which]

    def _grip(self, motion: Motion) -> Grip | None:
        """What there is to carry over; None without weight, or where source or target have no sides that close."""
        return motion.grip if self.carries_over else None

    @property
    def carries_over(self) -> bool:
        """Whether the target has pads that close on each other, and contact any weight."""
        return self._sides is not None and self._contact.opposition_weight > 0

    @cached_property
    def arrays(self):
        """The target with all its joints, its pads, and its links: those that keep clear of all points, and pads."""
        assert self._sides is not None
        problem, c = self._problem, self._contact
        embodiment = problem.embodiment
        target = make_target(problem.representation, problem.tree, all_joints=True)
        _, attachment = reduce_to_joints(problem.tree.arrays)
        pads = pad_shapes(problem.representation, self._sides)
        vertices = [
            v @ attachment.rot[b].T + attachment.pos[b] for b, v in zip(pads.body, pads.vertices_link, strict=True)
        ]
        side = pads.side
        normals = []
        for body in pads.body:
            mean = problem.representation.normals_link[problem.representation.body == body].mean(axis=0)
            normals.append(attachment.rot[body] @ mean / np.linalg.norm(mean))
        grasp = Grasp(
            joint=attachment.joint[pads.body],
            side=side,
            share=1.0 / np.where(side == 0, (side == 0).sum(), (side == 1).sum()),
            start=np.concatenate([[0], np.cumsum([len(v) for v in vertices])]).astype(np.int64),
            vertices=np.concatenate(vertices),
            normals=np.stack(normals),
            palm=int(attachment.joint[embodiment.end_effector_root]),
            hand=np.flatnonzero(embodiment.coupled.independent >= embodiment.n_arm),
            opposition=float(c.opposition_weight),
            facing=float(c.facing_weight),
            approach=float(c.approach_weight),
            turning=float(c.turning_weight),
            carrying=float(c.carrying_weight),
            posture=float(c.posture_weight),
            iterations=_ITERATIONS,
            tolerance=_TOLERANCE_M,
        )
        if self._options.clearance.weight <= 0:
            return target, grasp, no_collision_constraint(), no_collision_constraint()
        links = collision_constraint(problem, self._options.clearance)
        # Here clearance competes with contact points, which weigh as much: what touches too early loses the object.
        links = links._replace(weight=_CLEARANCE_FIRST * links.weight)
        touches = np.isin(links.joint, grasp.joint)
        away = links._replace(idle=~touches)
        return target, grasp, away, links._replace(idle=touches, height_m=-np.inf)

    def turned_around(self, axis: Array, u: Array) -> bool:
        """Whether the target's side 0 does at `u` what the source's side 1 does, whose side 0 presses along `axis`."""
        _, normals = self._problem.place(u)
        mean = [normals[self._sides == side].mean(axis=0) for side in (0, 1)]
        return bool((mean[0] - mean[1]) @ axis < 0)

    def _surroundings(self, motion: Motion, grip: Grip, frames: int):
        """The support's height, and packed for all frames: points on objects, and those not in the source's grip."""
        around = motion.surroundings
        if around is None:
            around = Surroundings(-np.inf)
        points = around.obstacles_base
        outside = [
            p[~in_grip(p, c, self._contact.grip_radius_m)]
            for p, c in zip(points, grip.contacts, strict=len(points) > 0)
        ]
        elsewhere = pack_obstacles(Surroundings(around.support_z_base_m, outside), frames)
        return float(around.support_z_base_m), pack_obstacles(around, frames), elsewhere

    def _objective(self, motion: Motion, u: Array) -> Array:
        return distances(
            make_target(self._problem.representation, self._problem.tree),
            np.ascontiguousarray(motion.points_base, float),
            np.ascontiguousarray(motion.normals_base, float),
            float(self._options.lambda_m),
            np.ascontiguousarray(u, float),
        )
