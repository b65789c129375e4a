"""Joints that follow others: what equalities and tendons of an MJCF say, as `q_follower = scale * q_leader + offset`."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import isclose

import mujoco

from cei_gym.embodiment.spec import Coupling
from cei_gym.errors import CEIError, unknown

_HOW = "say how they follow each other under `couplings` in the YAML"


@dataclass(frozen=True)
class _Relation:
    """`sum of weight * q = total` over joints, and what says so."""

    what: str
    weights: dict[str, float]
    total: float
    of_tendon: bool = False

    def coupling(self, follower: str, leader: str) -> Coupling:
        """The same, with one of its two joints following the other."""
        weight = self.weights[follower]
        return Coupling(leader, -self.weights[leader] / weight, self.total / weight)

    def repeats(self, follower: str, coupling: Coupling) -> bool:
        """Whether it says once more what a coupling says; a joint equality has a direction, and may go round in a circle."""
        if self.weights.keys() != {follower, coupling.joint} or not self.weights[follower]:
            return False
        if not self.of_tendon and follower != next(iter(self.weights)):
            return False
        same = self.coupling(follower, coupling.joint)
        return isclose(same.scale, coupling.scale) and isclose(same.offset, coupling.offset, abs_tol=1e-9)


def declared_couplings(
    spec: mujoco.MjSpec, names: set[str], given: Mapping[str, Coupling]
) -> tuple[dict[str, Coupling], list[str]]:
    """What a parsed MJCF says of joints that follow each other.

    Args:
        spec: the description.
        names: joints of the part of it that is used.
        given: couplings of the YAML, follower -> coupling; what they say of joints wins.

    Returns:
        Follower -> coupling, and sentences about what is not kept.

    Raises:
        CEIError: joints depend on each other in a way that is no coupling, and the YAML does not say how.
    """
    driven = {actuator.target for actuator in spec.actuators}
    couplings: dict[str, Coupling] = {}
    tied: set[str] = set()  # tendons that an equality holds
    for equality in spec.equalities:
        if not equality.active or equality.type not in _RELATIONS:
            continue
        if equality.type == mujoco.mjtEq.mjEQ_TENDON:
            tied |= {equality.name1, equality.name2}
        _check_names(spec, equality)
        joints = _joints(spec, equality)
        if not joints and not given:  # of a spatial tendon, which may run over any
            raise CEIError(
                f"{_named('tendon', equality.name or equality.name1)} holds a spatial tendon, which is no coupling of joints; {_HOW}."
            )
        free = joints - given.keys()
        if not joints & names:
            continue  # of another part
        if len(free) < 2 and joints & given.keys():
            # The YAML says it otherwise; but what is tied to a joint that follows another there follows along.
            if len(free) == 1 and len(joints) == 2 and not free & couplings.keys():
                (follower,), (leader,) = free, joints - free
                if given[leader].joint != follower:
                    relation = _RELATIONS[equality.type](spec, equality)
                    if relation.weights.keys() == joints and relation.weights[follower]:
                        couplings[follower] = relation.coupling(follower, leader)
            continue
        relation = _RELATIONS[equality.type](spec, equality)
        if any(relation.repeats(follower, coupling) for follower, coupling in couplings.items()):
            continue
        follower, leader = _roles(relation, [j for j in relation.weights if j in free], couplings, driven)
        couplings[follower] = relation.coupling(follower, leader)
    return couplings, [*_about_tendons(spec, names, tied, couplings | dict(given))]


def _check_names(spec: mujoco.MjSpec, equality: mujoco.MjsEquality) -> None:
    if equality.type == mujoco.mjtEq.mjEQ_TENDON:
        names, kind = [tendon.name for tendon in spec.tendons if tendon.name], "tendon in a tendon equality"
    else:
        names, kind = [joint.name for joint in spec.joints if joint.name], "joint in a joint equality"
    for name in (equality.name1, equality.name2):
        if name and name not in names:
            raise unknown(kind, name, names)


def _joints(spec: mujoco.MjSpec, equality: mujoco.MjsEquality) -> set[str]:
    names = [name for name in (equality.name1, equality.name2) if name]
    if equality.type == mujoco.mjtEq.mjEQ_JOINT:
        return set(names)
    return {joint for name in names for joint in _tendon_weights(spec.tendon(name))}


def _tendon_weights(tendon: mujoco.MjsTendon) -> dict[str, float]:
    """Joint -> its coefficients' sum, of a fixed tendon; empty for a spatial one."""
    weights: dict[str, float] = {}
    for part in tendon.path:
        if part.type == mujoco.mjtWrap.mjWRAP_JOINT and part.target is not None:
            weights[part.target.name] = weights.get(part.target.name, 0.0) + part.coef
    return weights


def _named(kind: str, name: str) -> str:
    return f"{kind} equality {name!r}" if name else f"a {kind} equality"


def _linear(equality: mujoco.MjsEquality, what: str) -> tuple[float, float]:
    a0, a1, *rest = (float(a) for a in equality.data[:5])
    if any(rest) and equality.name2:
        raise CEIError(
            f"{what} of {equality.name1!r} and {equality.name2!r} is not linear; only q = a u + b is; {_HOW}."
        )
    return a0, a1


def _joint_relation(spec: mujoco.MjSpec, equality: mujoco.MjsEquality) -> _Relation:
    """`y - y0 = a0 + a1 (x - x0)` with y0, x0 the joints' references."""
    what = _named("joint", equality.name)
    a0, a1 = _linear(equality, what)
    y0 = spec.joint(equality.name1).ref
    if not equality.name2:
        return _Relation(what, {equality.name1: 1.0}, float(y0 + a0))
    x0 = spec.joint(equality.name2).ref
    return _Relation(what, {equality.name1: 1.0, equality.name2: -a1}, float(y0 + a0 - a1 * x0))


def _tendon_relation(spec: mujoco.MjSpec, equality: mujoco.MjsEquality) -> _Relation:
    """`L1 - L1_0 = a0 + a1 (L2 - L2_0)` with lengths `L = sum of coef * q`, and L_0 those at the joints' references."""
    what = _named("tendon", equality.name or equality.name1)
    a0, a1 = _linear(equality, what)
    weights: dict[str, float] = {}
    for name, sign in ((equality.name1, 1.0), (equality.name2, -a1)):
        if name:
            for joint, weight in _tendon_weights(spec.tendon(name)).items():
                weights[joint] = weights.get(joint, 0.0) + sign * weight
    total = a0 + sum(weight * spec.joint(joint).ref for joint, weight in weights.items())
    return _Relation(what, {joint: weight for joint, weight in weights.items() if weight}, float(total), of_tendon=True)


_RELATIONS = {mujoco.mjtEq.mjEQ_JOINT: _joint_relation, mujoco.mjtEq.mjEQ_TENDON: _tendon_relation}


def _roles(relation: _Relation, free: list[str], couplings: dict[str, Coupling], driven: set[str]) -> tuple[str, str]:
    """Which of two joints follows which: of a joint equality, the first the second; else the one that nothing drives."""
    joints = list(relation.weights)
    if len(joints) == 1:
        value = relation.total / relation.weights[joints[0]]
        raise CEIError(
            f"{relation.what} holds joint {joints[0]!r} at {value:.4g}; make it no joint, or say under `couplings` in the YAML"
            f" {joints[0]}: {{joint: <another>, scale: 0, offset: {value:.4g}}}."
        )
    if len(joints) != 2 or len(free) != 2:
        raise CEIError(f"{relation.what} ties {len(joints)} joints ({', '.join(joints)}), not two; {_HOW}.")
    follower, leader = joints
    if relation.of_tendon and (follower in driven or leader not in driven):
        follower, leader = leader, follower
    if follower in couplings:
        follower, leader = leader, follower
    if follower in couplings or not relation.weights[follower]:
        raise CEIError(f"{relation.what} ties {follower!r} and {leader!r}, which follow others already; {_HOW}.")
    return follower, leader


def _about_tendons(
    spec: mujoco.MjSpec, names: set[str], tied: set[str], couplings: Mapping[str, Coupling]
) -> list[str]:
    notes: list[str] = []
    for tendon in spec.tendons:
        joints = list(_tendon_weights(tendon))
        if joints and not names.issuperset(joints):
            continue
        alone = [joint for joint in joints if joint not in couplings]
        if tendon.name in tied or (joints and len(alone) < 2):
            continue
        between = f" over {', '.join(joints)}" if joints else ""
        notes.append(
            f"tendon {tendon.name!r}{between} is not kept: joints move on their own unless `couplings` says otherwise."
        )
    return notes
