"""Contact carried over live: frame by frame, knowing nothing of those to come."""

import numpy as np

from cei_gym.alignment.contact.refine import GraspRefiner
from cei_gym.alignment.grip import Grip
from cei_gym.alignment.kernels import grasp as kernels
from cei_gym.alignment.kernels.contact import Links
from cei_gym.alignment.problem import Motion, Track
from cei_gym.arrays import Array

_NOWHERE = np.zeros((0, 3))


class LiveGrasp:
    """Refines a target's joints frame by frame, as `GraspRefiner` does those of a whole trajectory.

    What a whole trajectory tells of its frames to come, an example does here: how palm and source stand to each other where the source takes hold,
    and how high the table is. Objects are not seen.

    Args:
        refiner: of the target; it has something to carry over.
        example: a motion that holds something, and a track that follows it, refined.
        dt_s: time between frames; None leaves speeds unlimited.
    """

    def __init__(self, refiner: GraspRefiner, example: tuple[Motion, Track], dt_s: float | None) -> None:
        motion, track = example
        grip = motion.grip
        assert grip is not None
        first = int(np.argmax(grip.held))
        target, grasp, away, pads = refiner.arrays
        if refiner.turned_around(grip.axis[first], track.u[first]):
            grasp = grasp._replace(side=1 - grasp.side)
        support_z_m = -np.inf if motion.surroundings is None else float(motion.surroundings.support_z_base_m)
        self._target, self._grasp, self._dt_s = target, grasp, dt_s or 0.0
        self._links = Links(away._replace(height_m=support_z_m), pads, _NOWHERE, _NOWHERE)
        self._scratch = kernels.empty_scratch(target, grasp)
        self._example = kernels.new_course(track.u.shape[1])
        u = np.ascontiguousarray(track.u[first], float)
        kernels.take_hold(target, grasp, away, pads, _frame(grip, first), u, self._scratch, self._example)
        self.reset()

    def reset(self, u: Array | None = None) -> None:
        """Forget the past, but for where the joints are, (m,) rad or m, if they are anywhere."""
        self._course = kernels.Course(*(value.copy() for value in self._example))
        if u is not None:
            self._course.last[:], self._course.begun[0] = u, True

    def __call__(self, grip: Grip, before: Array, followed: Array) -> Array:
        """One frame.

        Args:
            grip: of the source, of this frame alone.
            before, followed: (m,) where the target is followed to, in the frame before and in this one.

        Returns:
            (m,) independent joints, rad or m.
        """
        u, _ = kernels.refine_frame(
            self._target,
            self._grasp,
            self._links,
            _frame(grip, 0),
            bool(grip.held[0]),
            self._dt_s,
            before,
            followed,
            self._scratch,
            self._course,
        )
        return u


def _frame(grip: Grip, t: int) -> kernels.GripFrame:
    return kernels.GripFrame(grip.axis[t], grip.contacts[t], grip.position[t], grip.rotation[t])
