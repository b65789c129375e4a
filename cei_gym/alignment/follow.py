"""Follow motions: freely, with clearance terms where a trajectory comes too near, then with contact carried over."""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cached_property

import numpy as np

from cei_gym.alignment.contact.refine import GraspRefiner
from cei_gym.alignment.judge.clearance import OBJECT, Clearance, Penetration
from cei_gym.alignment.kernels.collision import shortfall
from cei_gym.alignment.kernels.target import make_target
from cei_gym.alignment.links import collision_constraint, pack_obstacles
from cei_gym.alignment.options import ContactOptions, SolverOptions
from cei_gym.alignment.problem import AlignmentProblem, Motion, Track
from cei_gym.alignment.solvers.make import make_solver
from cei_gym.alignment.solvers.solver import Solver
from cei_gym.arrays import Array

_TOLERATED_M = 1e-3
_FIRST_FRAME_ITERATIONS = 200


class Follower:
    """A solver that follows each motion freely first, again with clearance terms if it came too near anything, and then
    refines its grasps (terms that are not needed stay off the hot path)."""

    def __init__(
        self, problem: AlignmentProblem, options: SolverOptions, contact: ContactOptions | None = None
    ) -> None:
        self.problem, self.options = problem, options
        self._grasp = GraspRefiner(problem, options, contact or ContactOptions())
        self.solver: Solver = make_solver(problem, options)

    @cached_property
    def clearance(self) -> Clearance:
        """Judges configurations by MuJoCo's collisions, which the terms above only approximate."""
        return Clearance(self.problem.embodiment, self.options.clearance)

    @cached_property
    def _links(self):
        target = make_target(self.problem.representation, self.problem.tree, all_joints=True)
        return target, collision_constraint(self.problem, self.options.clearance)

    def started(self, motion: Motion, u0: Array) -> Motion:
        """A motion from where its own first frame is solved, the solution of another motion's given: they start alike, not at the same place."""
        points, normals = motion.points_base[:1], motion.normals_base[:1]
        return replace(motion, u0=self.solver.track(points, normals, u0, _FIRST_FRAME_ITERATIONS).u[0])

    def follow(self, motion: Motion, free: Track | None = None) -> Track:
        """See `follow_all`; `free` is the motion followed freely, if it has been."""
        return self._careful([motion], [free] if free else self._freely([motion]))[0]

    def follow_all(self, motions: Sequence[Motion], refine: bool = True) -> list[Track]:
        """The tracks of motions; those without `surroundings` are only followed freely, those without `grip` not refined."""
        return self._careful(motions, self._freely(motions), refine)

    def _freely(self, motions: Sequence[Motion]) -> list[Track]:
        return self.solver.track_all([replace(m, surroundings=None) for m in motions])

    def _careful(self, motions: Sequence[Motion], free: Sequence[Track], refine: bool = True) -> list[Track]:
        tracks = list(free)
        near = [i for i, m in enumerate(motions) if self._too_near(m, tracks[i])]
        again = self.solver.track_all([motions[i] for i in near])
        for i, track in zip(near, again, strict=True):
            tracks[i] = track
        if not refine:
            return tracks
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            return list(pool.map(self._grasp.refine, motions, tracks))

    def overlap_m(self, motion: Motion, u: Array) -> Array:
        """(T,) how deep links are in objects; see `GraspRefiner.overlap`."""
        return self._grasp.overlap(motion, u)[0]

    def penetration(self, motion: Motion, u: Array) -> Penetration:
        """How deep the target is in itself, its stand, the support surface or objects at (T, m) configurations."""
        support_z = motion.surroundings.support_z_base_m if motion.surroundings else -np.inf
        found = self.clearance.penetration(self.problem.embodiment.coupled.expand(u), support_z)
        overlap_m, links = self._grasp.overlap(motion, u)
        return found.deeper(Penetration(overlap_m, tuple((link, OBJECT) for link in links)))

    def shortfall_m(self, motion: Motion, u: Array) -> Array:
        """(T,) how much clearance the worst link lacks at each of (T, m) configurations, m; 0 where none does."""
        assert motion.surroundings is not None
        target, collision = self._links
        collision = collision._replace(height_m=float(motion.surroundings.support_z_base_m))
        obstacles = pack_obstacles(motion.surroundings, len(u))
        return shortfall(target, collision, obstacles, np.ascontiguousarray(u, float))

    def _too_near(self, motion: Motion, track: Track) -> bool:
        if motion.surroundings is None or self.options.clearance.weight <= 0:
            return False
        return bool(self.shortfall_m(motion, track.u).max() > _TOLERATED_M)
