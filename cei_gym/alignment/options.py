"""How to align: options of the solver, of what links keep clear of, and of contact."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from cei_gym.alignment.registry import DEFAULT_SOLVER, OWN, solver_names
from cei_gym.errors import CEIError, unknown
from cei_gym.functional.distance import DEFAULT_DIRECTION_WEIGHT_M

AUTO = "auto"
DEVICES = ("auto", "cpu", "cuda", "mps")


def _check_at_least_0(options: str, values: Mapping[str, float]) -> None:
    for name, value in values.items():
        if not 0 <= value < np.inf:
            raise CEIError(f"{options}.{name}={value} must be at least 0.")


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
        _check_at_least_0("solver.clearance", vars(self))


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
        names = ("lambda_m", "temporal_weight", "smoothness_weight", "velocity_scale", "tolerance", "iterations")
        _check_at_least_0("solver", {name: getattr(self, name) for name in names})


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
        _check_at_least_0("contact", vars(self))
