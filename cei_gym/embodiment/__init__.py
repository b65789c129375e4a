"""Embodiments: arm x end-effector, from MJCF or URDF and one small typed YAML each."""

from cei_gym.embodiment.building import build_embodiment, describe
from cei_gym.embodiment.catalogue import (
    ARMS,
    END_EFFECTORS,
    GRID,
    arm_names,
    check_embodiment,
    embodiment_names,
    end_effector_names,
    load_arm,
    load_embodiment,
    load_end_effector,
)
from cei_gym.embodiment.coupled import Coupled
from cei_gym.embodiment.embodiment import Embodiment
from cei_gym.embodiment.identity import fingerprint
from cei_gym.embodiment.resources import use_package_path
from cei_gym.embodiment.spec import ArmSpec, Coupling, EndEffectorSpec, Pad, PhysicsException, Servo, load_spec

__all__ = [
    "ARMS",
    "END_EFFECTORS",
    "GRID",
    "ArmSpec",
    "Coupled",
    "Coupling",
    "Embodiment",
    "EndEffectorSpec",
    "Pad",
    "PhysicsException",
    "Servo",
    "arm_names",
    "build_embodiment",
    "check_embodiment",
    "describe",
    "embodiment_names",
    "end_effector_names",
    "fingerprint",
    "load_arm",
    "load_embodiment",
    "load_end_effector",
    "load_spec",
    "use_package_path",
]
