"""Position servos for joints that no controller drives: gains by rule, from the inertia that each joint feels."""

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from cei_gym.arrays import Array
from cei_gym.embodiment.embodiment import Embodiment


@dataclass(frozen=True)
class Drive:
    """How one independent joint is driven; in units of N m and rad for a hinge, N and m for a slide.

    Attributes:
        q: index of the joint.
        joint: its name.
        part: the arm's or end-effector's.
        unit: of its position, "rad" or "m".
        inertia: what it feels at home of all that it moves, kg m^2 or kg, its rotor left out.
        armature: its rotor's.
        kp, kv: gains.
        limit: largest torque or force; 0 is none.
        limit_from: "description", "servo" (the YAML's, or its default) or "none".
    """

    q: int
    joint: str
    part: str
    unit: str
    inertia: float
    armature: float
    kp: float
    kv: float
    limit: float
    limit_from: str

    def add_to(self, spec: mujoco.MjSpec, name: str) -> None:
        """Give the joint of this name in a scene its rotor and a servo, which has the same name."""
        spec.joint(name).armature = self.armature
        spec.add_actuator(
            name=name,
            target=name,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            gaintype=mujoco.mjtGain.mjGAIN_FIXED,
            biastype=mujoco.mjtBias.mjBIAS_AFFINE,
            gainprm=[self.kp, *[0.0] * 9],
            biasprm=[0.0, -self.kp, -self.kv, *[0.0] * 7],
            forcelimited=self.limit > 0,
            forcerange=[-self.limit, self.limit],
        )

    def row(self) -> dict[str, Any]:
        """As JSON types, to six digits."""
        values = {name: value for name, value in vars(self).items() if name != "q"}
        return {name: float(f"{value:.6g}") if isinstance(value, float) else value for name, value in values.items()}


def drives(embodiment: Embodiment) -> list[Drive]:
    """One for each independent joint, in their order."""
    return [
        _drive(embodiment, int(q), float(inertia))
        for q, inertia in zip(embodiment.coupled.independent, _inertia(embodiment), strict=True)
    ]


def _inertia(embodiment: Embodiment) -> Array:
    """(m,) what each independent joint feels of all that it moves, at home, kg m^2 or kg."""
    model, data = embodiment.model, mujoco.MjData(embodiment.model)
    data.qpos[:] = embodiment.home
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, full, data.qM)
    return np.diag(embodiment.coupled.A.T @ full @ embodiment.coupled.A)


def _drive(embodiment: Embodiment, q: int, inertia: float) -> Drive:
    part = embodiment.arm if q < embodiment.n_arm else embodiment.end_effector
    assert part is not None
    servo, model, unit = part.servo, embodiment.model, embodiment.joint_units[q]
    armature, limit = (servo.armature_kg, servo.force_n) if unit == "m" else (servo.armature_kg_m2, servo.torque_n_m)
    limit_from = "servo" if limit > 0 else "none"
    if model.jnt_actfrclimited[q] and model.jnt_actfrcrange[q, 1] > 0:
        limit, limit_from = float(model.jnt_actfrcrange[q, 1]), "description"
    moved = inertia + armature
    kp, kv = moved * servo.frequency_rad_s**2, 2 * servo.damping_ratio * servo.frequency_rad_s * moved
    return Drive(q, embodiment.joint_names[q], part.name, unit, inertia, armature, kp, kv, float(limit), limit_from)
