"""A robosuite gripper class for a catalogued end-effector, with the physics exceptions that its YAML declares."""

from fnmatch import fnmatch
from itertools import combinations
from xml.etree.ElementTree import Element

import numpy as np
from robosuite.models.grippers import GRIPPER_MAPPING
from robosuite.models.grippers.gripper_model import GripperModel

from cei_gym.embodiment import EndEffectorSpec, PhysicsException
from cei_gym.errors import CEIError, unknown

KINDS = ("mount", "absolute_joint_control", "no_self_contact", "geom_mass")


def register_gripper(spec: EndEffectorSpec, stock_physics: bool = False) -> str:
    """Register a robosuite gripper that takes absolute joint targets, one an actuator; its name there.

    Args:
        spec: the end-effector.
        stock_physics: apply only the physics exceptions without which nothing works.
    """
    if spec.simulator_name not in GRIPPER_MAPPING:
        raise unknown(f"simulator_name of {spec.name}", spec.simulator_name, GRIPPER_MAPPING)
    stock = GRIPPER_MAPPING[spec.simulator_name]
    require_absolute_control(spec.name, spec.physics)
    exceptions = [e for e in spec.physics if e.enabled and (e.required or not stock_physics)]
    for exception in exceptions:
        if exception.kind not in KINDS:
            raise unknown(f"physics exception of {spec.name}", exception.kind, KINDS)

    class AbsoluteGripper(stock):
        def __init__(self, idn=0):
            super().__init__(idn=idn)
            for exception in exceptions:
                _apply(self, spec, exception)

        def format_action(self, action):
            return action

        @property
        def dof(self):
            return len(self.actuators)

        @property
        def init_qpos(self):
            # Only a placeholder: the environment sets the start itself.
            return np.zeros(len(self.joints))

    name = f"CEI{spec.name}{'Stock' if stock_physics else ''}"
    GRIPPER_MAPPING[name] = AbsoluteGripper
    return name


def require_absolute_control(name: str, physics: list[PhysicsException]) -> PhysicsException:
    """The exception without which nothing here can be driven.

    Raises:
        CEIError: it is missing or switched off.
    """
    for exception in physics:
        if exception.kind == "absolute_joint_control" and exception.enabled:
            return exception
    raise CEIError(f"{name}: actions are joint targets, so `absolute_joint_control` must be declared and enabled.")


def _apply(gripper: GripperModel, spec: EndEffectorSpec, exception: PhysicsException) -> None:
    bodies = {b.get("name", ""): b for b in gripper.worldbody.iter("body") if b.get("name")}
    if exception.kind == "mount":
        root = next(iter(bodies.values()))
        root.set("pos", _text(spec.mount_pos_m))
        root.set("quat", _text(spec.mount_quat_wxyz))
    elif exception.kind == "no_self_contact":
        for one, other in combinations(bodies, 2):
            gripper.contact.append(Element("exclude", body1=one, body2=other))
    elif exception.kind == "geom_mass":
        for geom in gripper.worldbody.iter("geom"):
            if fnmatch(geom.get("name", ""), exception.parameters["geoms"]):
                geom.set("mass", str(exception.parameters["mass_kg"]))


def _text(values) -> str:
    return " ".join(str(v) for v in values)
