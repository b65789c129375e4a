"""A scene of robosuite's with any embodiment in it, composed from compiled descriptions and driven by position servos.

What robosuite can mount, robosuite mounts (`mounted`). Everything else stands here where its robot stood: the base on a pedestal, a servo on
each independent joint, followers held by equality constraints, its weight borne, as a controller bears it.
"""

from collections.abc import Callable
from threading import Lock
from typing import Any

import mujoco
import numpy as np

from cei_envs.self_contact import touching_geoms
from cei_envs.simulation import pose_of
from cei_envs.stand_in import CEIStandIn
from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment, describe
from cei_gym.embodiment.drives import drives
from cei_gym.embodiment.names import END_EFFECTOR_PREFIX
from cei_gym.errors import CEIError

PREFIX = "robot/"
"""Of the names of all that is the robot's."""
FORCE, TORQUE = f"{PREFIX}force", f"{PREFIX}torque"
"""Sensors between arm and end-effector."""

_OF_THE_STAND_IN = ("robot0_", "left_eef_target", "right_eef_target")
_SAVING = Lock()
_TRIES = 10
_PEDESTAL_HALF_M = 0.1
_EQUALITY_STIFFNESS_S = 0.004


def scene_without_robot(make: Callable[..., Any]) -> tuple[mujoco.MjSpec, Array]:
    """What a task has beside its robot: arena, objects, lights; and (4, 4) where robosuite's Panda stands in it.

    Args:
        make: builds the robosuite environment from its robot arguments.
    """
    env = make(
        robots=CEIStandIn.__name__,
        use_camera_obs=False,
        has_renderer=False,
        has_offscreen_renderer=False,
        ignore_done=True,
    )
    spec = _scene(env)
    T_world_base = pose_of(env.sim.data._data, env.robots[0].robot_model.root_body)
    env.close()
    for body in [body for body in spec.worldbody.bodies if body.name.startswith(_OF_THE_STAND_IN)]:
        spec.delete(body)
    used = {geom.meshname for geom in spec.geoms}
    for mesh in [mesh for mesh in spec.meshes if mesh.name not in used]:
        spec.delete(mesh)
    return spec, T_world_base


def _scene(env: Any) -> mujoco.MjSpec:
    """The model of a robosuite environment, to be changed. MuJoCo saves what was loaded last in the process, be it by another thread: so it is loaded
    anew, and looked at."""
    xml = env.model.get_xml()
    for process in env._xml_processors:
        xml = process(xml)
    wanted = {*env.sim.model.body_names}
    for _ in range(_TRIES):
        with _SAVING:
            mujoco.MjModel.from_xml_string(xml)
            spec = mujoco.MjSpec.from_string(env.sim.model.get_xml())
        if {body.name for body in spec.bodies} == wanted:
            return spec
    raise CEIError("other threads load models all the time; make environments one after the other.")


def compose(scene: mujoco.MjSpec, embodiment: Embodiment, T_world_base: Array) -> mujoco.MjModel:
    """Put an embodiment into a scene and compile it.

    Args:
        scene: changed.
        embodiment: what stands there.
        T_world_base: (4, 4) where.
    """
    robot = describe(embodiment)
    # Its own simulation's, of which nothing holds here.
    for element in [*robot.actuators, *robot.equalities, *robot.tendons, *robot.sensors, *robot.keys, *robot.pairs]:
        robot.delete(element)
    for element in [*robot.sites, *robot.cameras, *robot.lights]:
        robot.delete(element)
    for geom in robot.geoms:
        # What is outside can touch it; no part of it touches another but by a pair.
        geom.contype, geom.conaffinity = int(bool(geom.contype or geom.conaffinity)), 0
    for body in robot.bodies:
        body.gravcomp = 1.0
    quat_wxyz = np.zeros(4)
    mujoco.mju_mat2Quat(quat_wxyz, np.ascontiguousarray(T_world_base[:3, :3]).ravel())
    frame = scene.worldbody.add_frame(pos=T_world_base[:3, 3], quat=quat_wxyz)
    assets = {**scene.assets, **robot.assets}
    scene.attach(robot, frame=frame, prefix=PREFIX)
    scene.assets = assets
    for mesh in scene.meshes:
        # MuJoCo compiles no mesh twice in a process, and knows them by their files.
        mesh.file = mesh.file.removeprefix(PREFIX)
    for one, other in touching_geoms(embodiment):
        scene.add_pair(geomname1=PREFIX + one, geomname2=PREFIX + other)
    _drive(scene, embodiment)
    _feel(scene)
    _stand(scene, T_world_base[:3, 3])
    scene.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST  # servos are stiff
    return scene.compile()


def joint_names(embodiment: Embodiment) -> list[str]:
    """Names of an embodiment's joints in a composed scene."""
    return [PREFIX + embodiment.model.joint(q).name for q in range(embodiment.model.njnt)]


def _drive(scene: mujoco.MjSpec, embodiment: Embodiment) -> None:
    names, coupled = joint_names(embodiment), embodiment.coupled
    for drive in drives(embodiment):
        drive.add_to(scene, names[drive.q])
    for q, (leader, scale, offset) in enumerate(zip(coupled.leader, coupled.scale, coupled.offset, strict=True)):
        if q in coupled.independent:
            continue
        scene.joint(names[q]).limited = False
        scene.add_equality(
            type=mujoco.mjtEq.mjEQ_JOINT,
            name1=names[q],
            name2=names[coupled.independent[leader]],
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            data=[offset, scale, *[0.0] * 9],
            solref=[_EQUALITY_STIFFNESS_S, 1.0],
        )


def _feel(scene: mujoco.MjSpec) -> None:
    """Sensors of what the end-effector's first link and the flange exert on each other."""
    first = next(body for body in scene.bodies if body.name.startswith(PREFIX + END_EFFECTOR_PREFIX))
    site = first.add_site(name=f"{PREFIX}wrist")
    for name, kind in ((FORCE, mujoco.mjtSensor.mjSENS_FORCE), (TORQUE, mujoco.mjtSensor.mjSENS_TORQUE)):
        scene.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=site.name)


def _stand(scene: mujoco.MjSpec, base_world_m: Array) -> None:
    """A pedestal under the base, from the floor."""
    half = max(base_world_m[2] / 2, 1e-3)
    scene.worldbody.add_geom(
        name=f"{PREFIX}pedestal",
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=[_PEDESTAL_HALF_M, half, 0.0],
        pos=[*base_world_m[:2], base_world_m[2] - half],
        contype=0,
        conaffinity=0,
        group=1,
        rgba=[0.4, 0.4, 0.42, 1.0],
    )
