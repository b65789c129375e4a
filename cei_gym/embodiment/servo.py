"""How a simulation drives joints for which it has no controller."""

from dataclasses import dataclass

from cei_gym.embodiment.checked import Checked
from cei_gym.errors import CEIError


@dataclass(frozen=True)
class Servo(Checked):
    """How a simulation drives joints that its simulator has no controller for: position servos with gains by what they move.

    Of the inertia that a joint feels at home, rotor included, `kp = frequency_rad_s^2 inertia` and
    `kv = 2 damping_ratio frequency_rad_s inertia`.

    Attributes:
        frequency_rad_s: of the undamped loop.
        damping_ratio: 1 is critical.
        armature_kg_m2: inertia of a hinge's rotor, as the joint feels it.
        armature_kg: the same of a slide.
        torque_n_m: most of a hinge whose description gives no effort; 0 is without limit.
        force_n: the same of a slide.
    """

    frequency_rad_s: float = 60.0
    damping_ratio: float = 1.0
    armature_kg_m2: float = 0.1
    armature_kg: float = 1.0
    torque_n_m: float = 0.0
    force_n: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("frequency_rad_s", "damping_ratio"):
            if not getattr(self, name) > 0:
                raise CEIError(f"`{name}` should be above 0, not {getattr(self, name)}.")
        for name in ("armature_kg_m2", "armature_kg", "torque_n_m", "force_n"):
            if not getattr(self, name) >= 0:
                raise CEIError(f"`{name}` should be at least 0, not {getattr(self, name)}.")


OF_ARMS = Servo()
"""Of an arm that does not say."""
OF_END_EFFECTORS = Servo(frequency_rad_s=100.0, armature_kg_m2=0.001, armature_kg=0.05, torque_n_m=2.0, force_n=40.0)
"""Of an end-effector that does not say."""
