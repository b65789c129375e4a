"""What a hand's description itself says of joints that follow others: equalities of joints, or of tendons over joints.

They yield, as a rigid coupling does not: a finger that is stopped at its first link goes on to close with the others.
"""

from dataclasses import dataclass

import mujoco

from cei_gym.embodiment import Embodiment


@dataclass(frozen=True)
class OwnCouplings:
    """Those of a hand that a scene can have as they are.

    Attributes:
        equalities: their numbers in the embodiment's model.
        joints: which joints they hold; all others that follow are held rigidly.
    """

    equalities: tuple[int, ...]
    joints: frozenset[int]

    @classmethod
    def of(cls, embodiment: Embodiment) -> "OwnCouplings":
        """Those of an embodiment's hand."""
        model, equalities, joints = embodiment.model, [], set()
        for e in range(model.neq):
            held = _held(model, e)
            if held and min(held) >= embodiment.n_arm:
                equalities.append(e)
                joints |= held
        return cls(tuple(equalities), frozenset(joints))

    def add_to(self, spec: mujoco.MjSpec, model: mujoco.MjModel, prefix: str) -> None:
        """Put them into a scene, whose joints are called by their numbers after a prefix, with these joints' limits."""
        for q in self.joints:
            joint = spec.joint(f"{prefix}{q}")
            joint.limited, joint.range = int(model.jnt_limited[q]), model.jnt_range[q]
            joint.solref_limit, joint.solimp_limit = model.jnt_solref[q], model.jnt_solimp[q]
        tendons: set[int] = set()
        for e in self.equalities:
            one, other = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
            of_tendons = model.eq_type[e] == mujoco.mjtEq.mjEQ_TENDON
            name = f"{prefix}tendon" if of_tendons else prefix
            if of_tendons:
                tendons |= {t for t in (one, other) if t >= 0}
            spec.add_equality(
                type=mujoco.mjtEq(int(model.eq_type[e])),
                name1=f"{name}{one}",
                name2=f"{name}{other}" if other >= 0 else "",
                objtype=mujoco.mjtObj.mjOBJ_TENDON if of_tendons else mujoco.mjtObj.mjOBJ_JOINT,
                data=model.eq_data[e],
                solref=model.eq_solref[e],
                solimp=model.eq_solimp[e],
                active=bool(model.eq_active0[e]),
            )
        for t in tendons:
            tendon = spec.add_tendon(
                name=f"{prefix}tendon{t}",
                stiffness=float(model.tendon_stiffness[t]),
                damping=float(model.tendon_damping[t]),
                frictionloss=float(model.tendon_frictionloss[t]),
            )
            for w in _wraps(model, t):
                tendon.wrap_joint(f"{prefix}{model.wrap_objid[w]}", float(model.wrap_prm[w]))


def _wraps(model: mujoco.MjModel, tendon: int) -> range:
    first = int(model.tendon_adr[tendon])
    return range(first, first + int(model.tendon_num[tendon]))


def _held(model: mujoco.MjModel, e: int) -> set[int]:
    """Joints that an equality holds; empty where a scene cannot have it."""
    given = [int(each) for each in (model.eq_obj1id[e], model.eq_obj2id[e]) if each >= 0]
    if model.eq_type[e] == mujoco.mjtEq.mjEQ_JOINT:
        return set(given)
    if model.eq_type[e] != mujoco.mjtEq.mjEQ_TENDON:
        return set()
    wraps = [w for t in given for w in _wraps(model, t)]
    if not all(model.wrap_type[w] == mujoco.mjtWrap.mjWRAP_JOINT for w in wraps):
        return set()
    return {int(model.wrap_objid[w]) for w in wraps}
