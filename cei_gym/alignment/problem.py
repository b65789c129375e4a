"""The alignment problem of one target embodiment, and what a solver returns for a trajectory (section IV-B)."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from cei_gym.alignment.grip import Grip
from cei_gym.alignment.registry import DEFAULT_SOLVER, OWN, solver_names
from cei_gym.embodiment.embodiment import Embodiment
from cei_gym.errors import CEIError, unknown
from cei_gym.functional.distance import DEFAULT_DIRECTION_WEIGHT_M
from cei_gym.functional.representation import FunctionalRepresentation
from cei_gym.kinematics.tree import KinematicTree

AUTO = "auto"
DEVICES = ("auto", "cpu", "cuda", "mps")


@dataclass(frozen=True)
class PaperOptions:
    """The paper's own optimiser: Adam on autograd gradients (section V-A).

    Attributes:
        learning_rate: of Adam.
        steps: most steps a frame.
        patience: steps without improvement after which a frame is done.
        limit_weight: the paper's w2, of joints beyond their limits.
    """

    learning_rate: float = 1e-2
    steps: int = 300
    patience: int = 10
    limit_weight: float = 1.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0 < value < np.inf:
                raise CEIError(f"solver.paper.{name}={value} must be above 0.")


@dataclass(frozen=True)
class ClearanceOptions:
    """What a trajectory keeps clear of. Costs nothing until a trajectory comes too near.

    Attributes:
        weight: k of (k/2) h^2 for a link that lacks h metres of clearance, 1/m; 0 for none.
        arm_margin_m: between the arm and the support surface: an arm has no business near it. What it lacks counts as
            penetration.
        hand_margin_m: between links of the hand and the support surface: fingers may touch it beside what they grasp.
        idle_margin_m: between fingers that carry no pad and both the surface and objects.
    """

    weight: float = 1e3
    arm_margin_m: float = 0.02
    hand_margin_m: float = 0.0
    idle_margin_m: float = 0.005

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0 <= value < np.inf:
                raise CEIError(f"solver.clearance.{name}={value} must be at least 0.")


@dataclass(frozen=True)
class SolverOptions:
    """Options of the trajectory alignment.

    Attributes:
        backend: "numba" (second order, compiled), "torch" (the same method, many trajectories at once, any device), "paper"
            (pytorch-kinematics, autograd, Adam), one that an installed package offers (entry points `cei_gym.solvers`), or "auto" (numba).
        device: where "torch" and "paper" compute: "auto" (a GPU where there is one), "cpu", "cuda", "mps".
        lambda_m: weight of direction in the Directional Chamfer Distance, metres (points are in metres); 0 is the paper's
            ablation "without direction".
        temporal_weight: weight w of (w/2)|u_t - u_(t-1)|^2, metres per rad^2 (second order only).
        smoothness_weight: weight w of (w/2)|u_t - 2 u_(t-1) + u_(t-2)|^2, metres per rad^2 (second order only).
        velocity_scale: share of each joint's velocity limit that a trajectory may use; 0 for no limit.
        iterations: most iterations a frame (second order only).
        tolerance: fall of the objective, metres, that counts as none (second order only).
        clearance: see `ClearanceOptions` (second order only).
        paper: the reference's own options.
    """

    backend: str = "auto"
    device: str = "auto"
    lambda_m: float = DEFAULT_DIRECTION_WEIGHT_M
    temporal_weight: float = 1e-2
    smoothness_weight: float = 0.0
    velocity_scale: float = 1.0
    iterations: int = 30
    tolerance: float = 2e-6
    clearance: ClearanceOptions = field(default_factory=ClearanceOptions)
    paper: PaperOptions = field(default_factory=PaperOptions)

    def __post_init__(self) -> None:
        if self.backend not in (AUTO, *OWN) and self.backend not in (names := solver_names()):
            raise unknown("solver.backend", self.backend, (AUTO, *names))
        if self.device not in DEVICES:
            raise unknown("solver.device", self.device, DEVICES)
        if self.device not in ("auto", "cpu") and self.backend in (AUTO, DEFAULT_SOLVER):
            raise CEIError(
                f"solver.device={self.device} is where torch computes, which solver.backend={self.backend} does without; "
                "give solver.backend=torch, or leave it out."
            )
        for name in ("lambda_m", "temporal_weight", "smoothness_weight", "velocity_scale", "tolerance"):
            if not 0 <= getattr(self, name) < np.inf:
                raise CEIError(f"solver.{name}={getattr(self, name)} must be at least 0.")
        if self.iterations < 0:
            raise CEIError(f"solver.iterations={self.iterations} must be at least 0.")


@dataclass(frozen=True)
class ContactOptions:
    """How contact is carried over: a trajectory that only resembles the source's pads may drop what the source held.

    Attributes:
        opposition_weight: k of (k/2) r^2 for contact points r metres from the source's, 1/m: pads of one side in the mean
            across the closing direction, each by itself along it. 0 leaves trajectories as they were followed.
        facing_weight: what a cosine of 1 between a pad's mean normal and the closing direction is worth, m.
        approach_weight: k of (k/2) r^2 for an open hand r metres from where it will close, or has closed, against the source's
            end-effector, 1/m: fingers close on an object, the palm does not have to follow them.
        turning_weight: k of (k/2) a^2 for a palm turned by a rad against the source's end-effector since it took hold, m.
            Pads look alike when they turn about the closing direction, but what they hold turns with them.
        carrying_weight: the same while something is held; fingers then stay as they are.
        posture_weight: k of (k/2) |u - u'|^2 for joints u and those of the frame before, m/rad^2.
        squeeze_m: how far actions close each pad beyond the contact that was observed, at most, while the source's
            gripper is told to close further than it can; it carries grip force over. 0 is the paper.
        held_m: how far a gripper is told to close beyond where it rests, for it to hold something.
        grip_radius_m: what is this near to the line between the source's contacts may be touched by pads.
    """

    opposition_weight: float = 1e3
    facing_weight: float = 0.1
    approach_weight: float = 250.0
    turning_weight: float = 0.5
    carrying_weight: float = 5.0
    posture_weight: float = 0.5
    squeeze_m: float = 0.010
    held_m: float = 0.002
    grip_radius_m: float = 0.03

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0 <= value < np.inf:
                raise CEIError(f"contact.{name}={value} must be at least 0.")


@dataclass(frozen=True)
class Surroundings:
    """What stands around the target, in its base frame.

    Attributes:
        support_z_base_m: height of the support surface.
        obstacles_base: for each frame (P, 3) points on the surface of objects, m; empty for none.
    """

    support_z_base_m: float
    obstacles_base: Sequence[np.ndarray] = ()


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

    points_base: np.ndarray
    normals_base: np.ndarray
    u0: np.ndarray
    iterations: int | None = None
    dt_s: float | None = None
    surroundings: Surroundings | None = None
    grip: Grip | None = None

    def at(self, frames: np.ndarray) -> "Motion":
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

    u: np.ndarray
    objective: np.ndarray
    iterations: np.ndarray
    contact_miss_m: np.ndarray | None = None


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

    def place(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(..., m) independent joints to pad points and normals (..., N', 3) in the target's base frame."""
        return self.representation.place(self.tree.forward(self.embodiment.coupled.expand(u)))
