"""A plain scene of MuJoCo's: a robot, a support, and what is held as a free body."""

import mujoco
import numpy as np

from cei_gym.arrays import Array
from cei_gym.twin.options import TwinOptions
from cei_gym.twin.robot import RobotPart
from cei_gym.twin.shape import KINDS, Shape

OBJECT = "object"
"""Name of what is held."""
_TIMESTEP_S = 0.002
_ROLLING = (0.005, 0.0005)  # a body pivots and rolls on a patch, not on a point
_ABOVE_M = 0.0005
_SOLREF = (0.01, 1.0)


def build_scene(
    robot: RobotPart, T_world_base: Array, support_z_m: float, shape: Shape, options: TwinOptions
) -> mujoco.MjModel:
    """Compile a scene.

    Args:
        robot: who moves in it.
        T_world_base: (4, 4) where it stands.
        support_z_m: height of the plane that things stand on, world; what is held is raised to it, if it would be in it.
        shape: what is held, where it was at the start.
        options: its density and friction.

    Raises:
        ValueError: MuJoCo cannot have that shape, a flat one.
    """
    spec = mujoco.MjSpec()
    spec.compiler.degree = False  # or joints' references and limits would be taken for degrees
    spec.option.timestep = _TIMESTEP_S
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST  # servos are stiff
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 20.0  # what is held does not creep out of a grip, as it does with soft friction
    spec.worldbody.add_geom(
        name="support", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[2, 2, 0.1], pos=[0, 0, support_z_m], contype=1
    )
    robot.add_to(spec, T_world_base)
    _add_object(spec, shape, support_z_m, options)
    return spec.compile()


def _add_object(spec: mujoco.MjSpec, shape: Shape, support_z_m: float, options: TwinOptions) -> None:
    raised = np.array([0.0, 0.0, support_z_m + _ABOVE_M - shape.lowest_m])
    body = spec.worldbody.add_body(name=OBJECT)
    body.add_freejoint(name=OBJECT)
    for i, piece in enumerate(shape.pieces):
        given = {
            "type": KINDS[piece.kind],
            "density": options.density_kg_m3,
            "friction": [options.friction, *_ROLLING],
            "condim": 4 if piece.kind == "hull" else 6,  # what has faces does not roll
            "priority": 1,
            "solref": _SOLREF,
            "contype": 0,
            "conaffinity": 1,
        }
        if piece.kind == "hull":
            mesh = spec.add_mesh(name=f"{OBJECT}{i}", uservert=(piece.vertices_world + raised).ravel())
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
            body.add_geom(meshname=mesh.name, **given)
        else:
            quat_wxyz = np.zeros(4)
            mujoco.mju_mat2Quat(quat_wxyz, np.ascontiguousarray(piece.rotation).ravel())
            body.add_geom(size=[*piece.size_m, 0, 0][:3], pos=piece.centre_world + raised, quat=quat_wxyz, **given)
