"""Whether clouds show the robot where its joints say: clouds made by a renderer that shares nothing with the check."""

from functools import cache

import mujoco
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from cei_gym.embodiment import load_embodiment
from cei_gym.pointcloud.agreement import cloud_agreement

ROBOT, FRAMES = "Panda-PandaGripper", 6
BASE = np.eye(4)
BASE[:3, 3] = -0.56, 0.0, 0.912


@cache
def recorded(noise_m: float = 0.0) -> tuple[list[np.ndarray], np.ndarray]:
    """Clouds of a Panda above a table with a box on it, 1024 points each, by MuJoCo's kinematics and trimesh's sampling."""
    body = load_embodiment(ROBOT)
    rng = np.random.default_rng(0)
    smooth = np.linspace(0, 1, FRAMES)[:, None]
    qpos = body.home + smooth * np.array([0.5, 0.3, 0, -0.3, 0, 0.2, 0, 0, 0])
    table = np.column_stack([rng.uniform(-0.4, 0.4, (700, 2)), np.full(700, 0.8)])
    box = trimesh.creation.box((0.05, 0.05, 0.05)).sample(60, seed=0) + [0.1, 0.2, 0.83]
    meshes = [
        trimesh.Trimesh(body.model.mesh_vert[a : a + n], body.model.mesh_face[f : f + m], process=False)
        for a, n, f, m in zip(
            body.model.mesh_vertadr,
            body.model.mesh_vertnum,
            body.model.mesh_faceadr,
            body.model.mesh_facenum,
            strict=True,
        )
    ]
    data, clouds = mujoco.MjData(body.model), []
    for q in qpos:
        data.qpos[:] = q
        mujoco.mj_kinematics(body.model, data)
        points = []
        for geom in np.flatnonzero(body.model.geom_type == mujoco.mjtGeom.mjGEOM_MESH):
            on = meshes[body.model.geom_dataid[geom]].sample(40, seed=int(geom))
            points.append(on @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom])
        robot = np.concatenate(points) @ BASE[:3, :3].T + BASE[:3, 3]
        cloud = np.concatenate([table, box, robot[rng.permutation(len(robot))[:264]]])
        clouds.append(cloud + noise_m * rng.standard_normal(cloud.shape))
    return clouds, qpos


def shifted(x: float, y: float, z: float, yaw: float = 0.0) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("z", yaw).as_matrix()
    T[:3, 3] = x, y, z
    return T


@pytest.mark.parametrize("noise_m", [0.0, 0.004])
def test_a_robot_that_is_where_it_should_be_is_found_there(noise_m: float) -> None:
    clouds, qpos = recorded(noise_m)
    found = cloud_agreement(load_embodiment(ROBOT), clouds, qpos, BASE)
    assert found.known and not found.elsewhere and not found.nowhere
    assert found.share > 0.9
    assert found.offset_m < 0.01


@pytest.mark.parametrize(
    "wrong",
    [
        shifted(0.56, 0, -0.912),
        shifted(0.0, 0.3, 0.0),
        shifted(0.5, -0.2, -0.9, np.pi / 2),
        shifted(0.06, 0, 0),
        shifted(0, 0, 0, np.pi),
    ],
    ids=["no base pose", "30 cm aside", "elsewhere and turned", "6 cm", "turned round"],
)
def test_another_base_pose_is_noticed_and_the_right_one_found(wrong: np.ndarray) -> None:
    clouds, qpos = recorded(0.004)
    found = cloud_agreement(load_embodiment(ROBOT), clouds, qpos, wrong @ BASE)
    assert found.elsewhere
    np.testing.assert_allclose(found.T_world_base[:3, 3], BASE[:3, 3], atol=0.03)
    np.testing.assert_allclose(found.T_world_base[:3, :3], np.eye(3), atol=0.05)
    assert found.share_there > 0.9


def test_joints_that_are_wrong_are_noticed() -> None:
    """Another sign of two joints bends the arm otherwise: no pose of the base explains that."""
    clouds, qpos = recorded()
    mirrored = qpos * np.array([-1, -1, 1, 1, 1, 1, 1, 1, 1])
    found = cloud_agreement(load_embodiment(ROBOT), clouds, mirrored, BASE)
    assert found.elsewhere or found.nowhere or found.share < 0.5


def test_clouds_in_which_nothing_moves_say_nothing() -> None:
    clouds, qpos = recorded()
    still = [clouds[0]] * FRAMES
    assert not cloud_agreement(load_embodiment(ROBOT), still, qpos, BASE).known
    empty = [np.zeros((0, 3))] * FRAMES
    assert not cloud_agreement(load_embodiment(ROBOT), empty, qpos, BASE).known
    unknown = [np.full((5, 3), np.nan)] * FRAMES
    assert not cloud_agreement(load_embodiment(ROBOT), unknown, qpos, BASE).known
