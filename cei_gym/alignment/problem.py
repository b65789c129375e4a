"""The alignment problem of one target embodiment, and what a solver returns for a trajectory (section IV-B)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from cei_gym.alignment.grip import Grip
from cei_gym.arrays import Array
from cei_gym.embodiment.embodiment import Embodiment
from cei_gym.functional.representation import FunctionalRepresentation
from cei_gym.kinematics.tree import KinematicTree


@dataclass(frozen=True)
class Surroundings:
    """What stands around the target, in its base frame.

    Attributes:
        support_z_base_m: height of the support surface.
        obstacles_base: for each frame (P, 3) points on the surface of objects, m; empty for none.
        tool_points: how many points a frame, in the mean, were taken for what the source's hand has with it, and for no obstacle.
    """

    support_z_base_m: float
    obstacles_base: Sequence[Array] = ()
    tool_points: float = 0.0


@dataclass(frozen=True)
class Motion:
    """A trajectory to follow.

    Attributes:
        points_base, normals_base: (T, N, 3) source representation in the target's base frame, m and unit.
        u0: (m,) independent joints where frame 0 starts, rad or m.
        iterations: another budget a frame than that of the options.
        dt_s: time between frames; with it, joints keep their velocity limits.
        surroundings: what links keep clear of.
        grip: what the source's end-effector does.
    """

    points_base: Array
    normals_base: Array
    u0: Array
    iterations: int | None = None
    dt_s: float | None = None
    surroundings: Surroundings | None = None
    grip: Grip | None = None

    def at(self, frames: Array) -> "Motion":
        """The motion with its frames at these indices."""
        around, grip = self.surroundings, self.grip
        if around is not None and len(around.obstacles_base):
            around = replace(around, obstacles_base=[around.obstacles_base[t] for t in frames])
        return replace(
            self,
            points_base=self.points_base[frames],
            normals_base=self.normals_base[frames],
            surroundings=around,
            grip=None if grip is None else grip.at(frames),
        )


@dataclass(frozen=True)
class Track:
    """A solved trajectory.

    Attributes:
        u: (T, m) independent joints, rad or m, within limits.
        objective: (T,) DCD of each frame, metres.
        iterations: (T,) iterations (Newton) or steps (Adam) spent.
        contact_miss_m: (T,) how far contact points are from the source's, m; None where contact was not carried over.
    """

    u: Array
    objective: Array
    iterations: Array
    contact_miss_m: Array | None = None

    def at(self, frames: Array) -> "Track":
        """The track with its frames at these indices."""
        miss = self.contact_miss_m
        miss = None if miss is None else miss[frames]
        return Track(self.u[frames], self.objective[frames], self.iterations[frames], miss)


@dataclass(frozen=True)
class AlignmentProblem:
    """What a solver needs to know of the target.

    Attributes:
        representation: the target's functional representation.
        tree: its kinematics.
    """

    representation: FunctionalRepresentation
    tree: KinematicTree

    @property
    def embodiment(self) -> Embodiment:
        """The target."""
        return self.representation.embodiment

    def place(self, u: Array) -> tuple[Array, Array]:
        """(..., m) independent joints to pad points and normals (..., N', 3) in the target's base frame."""
        return self.representation.place(self.tree.forward(self.embodiment.coupled.expand(u)))
