"""A robot as a twin has it: its compiled model's links, joints and weights, its hand's shapes as hulls, a servo on each joint.

Made of the compiled model alone, without files, visual meshes or an arm's shapes, so that a scene compiles in milliseconds. Of a hand the
position servos of its description are kept, where it has them, as grip force follows from them; other joints are driven by rule
(`cei_gym.embodiment.drives`), and joints that follow others as the description couples them, else by equality constraints.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment
from cei_gym.embodiment.drives import drives
from cei_gym.embodiment.meshes import geom_vertices, outermost
from cei_gym.twin.couplings import OwnCouplings

PREFIX = "robot/"
"""Of the names of all that is the robot's."""
_EQUALITY_STIFFNESS_S = 0.004


@dataclass(frozen=True)
class RobotPart:
    """What a scene needs of a robot, made once.

    Attributes:
        embodiment: which.
        hulls: of each of the hand's shapes that is a mesh, by its geom, (V, 3) outermost vertices in the link's frame, m.
    """

    embodiment: Embodiment
    hulls: dict[int, Array]

    @classmethod
    def of(cls, embodiment: Embodiment) -> "RobotPart":
        """That of an embodiment."""
        model = embodiment.model
        meshes = [g for g in _hand_geoms(embodiment) if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_MESH]
        return cls(embodiment, {g: outermost(geom_vertices(model, g)) for g in meshes})

    def add_to(self, spec: mujoco.MjSpec, T_world_base: Array) -> None:
        """Stand the robot in a scene, its base at a (4, 4) pose; its weight is borne, and no part of it touches another."""
        model, embodiment = self.embodiment.model, self.embodiment
        quat_wxyz = np.zeros(4)
        mujoco.mju_mat2Quat(quat_wxyz, np.ascontiguousarray(T_world_base[:3, :3]).ravel())
        base = spec.worldbody.add_body(name=f"{PREFIX}base", pos=T_world_base[:3, 3], quat=quat_wxyz)
        bodies = {0: base}
        for body in range(1, model.nbody):
            bodies[body] = bodies[int(model.body_parentid[body])].add_body(
                name=f"{PREFIX}{body}",
                pos=model.body_pos[body],
                quat=model.body_quat[body],
                ipos=model.body_ipos[body],
                iquat=model.body_iquat[body],
                mass=max(float(model.body_mass[body]), 1e-6),
                inertia=np.maximum(model.body_inertia[body], 1e-9),
                explicitinertial=True,
                gravcomp=1.0,
            )
        for q in range(model.njnt):
            self._add_joint(bodies[int(model.jnt_bodyid[q])], q)
        for geom in _hand_geoms(embodiment):
            self._add_shape(spec, bodies[int(model.geom_bodyid[geom])], geom)
        self._drive(spec)

    def _add_joint(self, body: mujoco.MjsBody, q: int) -> None:
        model = self.embodiment.model
        dof = int(model.jnt_dofadr[q])
        body.add_joint(
            name=f"{PREFIX}{q}",
            type=model.jnt_type[q],
            pos=model.jnt_pos[q],
            axis=model.jnt_axis[q],
            ref=model.qpos0[q],
            springref=model.qpos_spring[q],
            stiffness=float(model.jnt_stiffness[q]),
            damping=float(model.dof_damping[dof]),
            armature=float(model.dof_armature[dof]),
            frictionloss=float(model.dof_frictionloss[dof]),
        )

    def _add_shape(self, spec: mujoco.MjSpec, body: mujoco.MjsBody, geom: int) -> None:
        model = self.embodiment.model
        given = {
            "friction": model.geom_friction[geom],
            "solref": model.geom_solref[geom],
            "solimp": model.geom_solimp[geom],
            "condim": int(model.geom_condim[geom]),
            "contype": 1,
            "conaffinity": 0,
            "mass": 0.0,
        }
        if geom in self.hulls:
            name = f"{PREFIX}hull{geom}"
            mesh = spec.add_mesh(name=name, uservert=self.hulls[geom].ravel())
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, **given)
        else:
            where = {"pos": model.geom_pos[geom], "quat": model.geom_quat[geom]}
            body.add_geom(type=model.geom_type[geom], size=model.geom_size[geom], **where, **given)

    def _drive(self, spec: mujoco.MjSpec) -> None:
        embodiment = self.embodiment
        own, coupled = _own_servos(embodiment), embodiment.coupled
        rules = {drive.q: drive for drive in drives(embodiment)}
        couplings = OwnCouplings.of(embodiment)
        couplings.add_to(spec, embodiment.model, PREFIX)
        for q in range(len(embodiment.joint_names)):
            name = f"{PREFIX}{q}"
            if q in own:
                self._add_own_servo(spec, name, q, own[q])
            elif q in rules:
                rules[q].add_to(spec, name)
            elif q not in couplings.joints:
                leader, scale, offset = coupled.leader[q], coupled.scale[q], coupled.offset[q]
                spec.add_equality(
                    type=mujoco.mjtEq.mjEQ_JOINT,
                    name1=name,
                    name2=f"{PREFIX}{coupled.independent[leader]}",
                    objtype=mujoco.mjtObj.mjOBJ_JOINT,
                    data=[offset, scale, *[0.0] * 9],
                    solref=[_EQUALITY_STIFFNESS_S, 1.0],
                )

    def _add_own_servo(self, spec: mujoco.MjSpec, name: str, q: int, a: int) -> None:
        """The servo that the description itself has for joint q, its actuator a."""
        model = self.embodiment.model
        bias, limited = model.actuator_biasprm[a].copy(), bool(model.actuator_ctrllimited[a])
        if bias[0] != 0:  # a muscle's defaults, with which MjSpec fills what a position servo leaves out
            bias[[0, 2]] = 0.0
        spec.joint(name).actfrclimited = bool(model.jnt_actfrclimited[q])
        spec.joint(name).actfrcrange = model.jnt_actfrcrange[q]
        spec.add_actuator(
            name=name,
            target=name,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            gaintype=mujoco.mjtGain.mjGAIN_FIXED,
            biastype=mujoco.mjtBias.mjBIAS_AFFINE,
            gainprm=model.actuator_gainprm[a][:10],
            biasprm=bias[:10],
            forcelimited=bool(model.actuator_forcelimited[a]),
            forcerange=model.actuator_forcerange[a],
            ctrllimited=limited,
            ctrlrange=model.actuator_ctrlrange[a] if limited else [0, 0],
        )


def _hand_geoms(embodiment: Embodiment) -> list[int]:
    """Shapes of the end-effector that can touch something."""
    model = embodiment.model
    touches = (model.geom_contype | model.geom_conaffinity) != 0
    return np.flatnonzero(touches & embodiment.of_end_effector[model.geom_bodyid]).tolist()


def _own_servos(embodiment: Embodiment) -> dict[int, int]:
    """Which joints of the hand the description itself drives to positions, and by which actuators."""
    model = embodiment.model
    found: dict[int, int] = {}
    for a in range(model.nu):
        gain, bias, gear = model.actuator_gainprm[a, 0], model.actuator_biasprm[a, 1], model.actuator_gear[a, 0]
        on_joint = model.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_JOINT
        is_affine = model.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_AFFINE
        q = int(model.actuator_trnid[a, 0])
        if on_joint and is_affine and gear == 1 and gain > 0 and bias == -gain and q >= embodiment.n_arm:
            found[q] = a
    return found
