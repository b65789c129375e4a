"""By which rules a simulation treats its robot, for reports: one line a rule, however many joints it is about."""

from collections.abc import Iterable, Sequence

from cei_gym.arrays import Array
from cei_gym.embodiment import ArmSpec, Embodiment, EndEffectorSpec, PhysicsException
from cei_gym.embodiment.drives import Drive
from cei_gym.environment import Physics, PhysicsRule

OF_THE_BODY = ("mount", "geom_mass")
"""Kinds of `physics:` that hold in every simulation."""

_PER = {"rad": "N m", "m": "N"}
_TOUCH = {
    "none": "no link of it touches another",
    "fingers": "links of different fingers touch each other",
    "all": "links touch each other, but neighbours",
}


def of_mounted(embodiment: Embodiment, stock_physics: bool) -> Physics:
    """The exceptions from robosuite's physics that an embodiment declares."""
    return Physics(
        tuple(
            _exception(part, each, each.enabled and (each.required or not stock_physics))
            for part in _parts(embodiment)
            for each in part.physics
        )
    )


def _exception(part: ArmSpec | EndEffectorSpec, exception: PhysicsException, on: bool) -> PhysicsRule:
    return PhysicsRule(part.name, exception.kind, "physics" if on else "off", exception.reason)


def of_composed(
    embodiment: Embodiment, drives: Sequence[Drive], touching: int, T_world_base: Array, asked: bool
) -> Physics:
    """What a composed robot has by rule.

    Args:
        embodiment: the robot.
        drives: of its independent joints.
        touching: how many pairs of its shapes touch each other.
        T_world_base: (4, 4) where it stands.
        asked: whether somebody said where.
    """
    place = ", ".join(f"{x:g}" for x in T_world_base[:3, 3].round(3))
    source, where = ("T_world_base", "") if asked else ("default", ", where robosuite's Panda does")
    rules = [PhysicsRule(embodiment.name, "base", source, f"stands on a pedestal at {place} m{where}")]
    for part in _parts(embodiment):
        rules += [_exception(part, each, each.enabled) for each in part.physics if each.kind in OF_THE_BODY]
        rules += _of_part(part, [drive for drive in drives if drive.part == part.name])
        pairs = f" and overlapping ones: {touching} pairs of shapes" if part.self_contact == "all" else ""
        pairs = f": {touching} pairs of shapes" if part.self_contact == "fingers" else pairs
        rules.append(PhysicsRule(part.name, "self-contact", "self_contact", f"{_TOUCH[part.self_contact]}{pairs}"))
    if followers := [*set(range(len(embodiment.home))) - {drive.q for drive in drives}]:
        text = f"{_joints(followers)} held to what leads by equality constraints"
        rules.append(PhysicsRule(embodiment.name, "followers", "couplings", text))
    rules += [
        PhysicsRule(embodiment.name, "weight", "default", "borne, as by a controller that knows it"),
        PhysicsRule(embodiment.name, "friction", "description", "the description's, else MuJoCo's defaults"),
        PhysicsRule(embodiment.name, "integrator", "default", "MuJoCo's implicitfast, as servos are stiff"),
    ]
    return Physics(tuple(rules), tuple(drive.row() for drive in drives))


def _of_part(part: ArmSpec | EndEffectorSpec, drives: list[Drive]) -> Iterable[PhysicsRule]:
    """Servos, rotors, and largest torques by where they come from."""
    if not drives:
        return
    servo, source = part.servo, "default" if part.servo == type(part).servo else "servo"
    kp = " and ".join(
        f"{_range(d.kp for d in drives if d.unit == unit)} {_PER[unit]}/{unit}" for unit in _units(drives)
    )
    says = f"position servos on {_joints(drives)} of {servo.frequency_rad_s:g} rad/s, damping ratio {servo.damping_ratio:g}, by the inertia at home: kp {kp}"
    yield PhysicsRule(part.name, "servos", source, says)
    rotors = {"rad": f"{servo.armature_kg_m2:g} kg m^2", "m": f"{servo.armature_kg:g} kg"}
    yield PhysicsRule(part.name, "rotors", source, f"{' and '.join(rotors[unit] for unit in _units(drives))} each")
    for limit_from in dict.fromkeys(drive.limit_from for drive in drives):
        these = [drive for drive in drives if drive.limit_from == limit_from]
        most = " and ".join(
            f"{_range(d.limit for d in these if d.unit == unit)} {_PER[unit]}" for unit in _units(these)
        )
        says = "no limit" if limit_from == "none" else f"at most {most}"
        by = {"description": "description", "servo": source, "none": "default"}[limit_from]
        yield PhysicsRule(part.name, "efforts", by, f"{says} on {_joints(these)}")


def _joints(which: Sequence[object]) -> str:
    return f"{len(which)} joint{'s' * (len(which) > 1)}"


def _units(drives: Sequence[Drive]) -> list[str]:
    return list(dict.fromkeys(drive.unit for drive in drives))


def _range(values: Iterable[float]) -> str:
    found = [*values]
    low, high = f"{min(found):.3g}", f"{max(found):.3g}"
    return low if low == high else f"{low} to {high}"


def _parts(embodiment: Embodiment) -> list[ArmSpec | EndEffectorSpec]:
    return [part for part in (embodiment.arm, embodiment.end_effector) if part is not None]
