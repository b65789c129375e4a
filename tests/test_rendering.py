"""The depth camera against MuJoCo's renderer, against exact planes and boxes, and against its own inverse."""

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import cei_gym  # noqa: F401  (registers the environments)
from cei_gym.demonstration import Camera
from cei_gym.errors import CEIError
from cei_gym.rendering import DepthCamera, camera_from_mujoco, geom_colours, look_at, shade, unproject

PRIMITIVES = """
<mujoco>
  <visual><quality numslices="128" numstacks="128"/></visual>
  <asset>
    <mesh name="pyramid" vertex="-1 -1 0  1 -1 0  1 1 0  -1 1 0  0 0 1.5" scale="0.12 0.12 0.12"/>
    <texture name="half" type="2d" builtin="flat" rgb1="0.5 0 0" width="4" height="4"/>
    <material name="half" texture="half"/>
  </asset>
  <worldbody>
    <light pos="0 0 3"/>
    <camera name="above" pos="0.9 -1.2 1.1" xyaxes="0.8 0.6 0 -0.32 0.43 0.84"/>
    <camera name="low" pos="0.2 -0.6 0.12" xyaxes="1 0 0 0 0.1 1" fovy="70"/>
    <geom name="floor" type="plane" size="0 0 0.1" group="1"/>
    <geom name="tile" type="plane" size="0.1 0.2 0.1" pos="-0.5 -0.4 0.05" euler="10 20 0" group="1"/>
    <geom name="box" type="box" size="0.1 0.05 0.2" pos="-0.3 0 0.2" euler="20 30 40"
          group="1" material="half"/>
    <geom name="sphere" type="sphere" size="0.12" pos="0 0.1 0.3" group="1"/>
    <geom name="ellipsoid" type="ellipsoid" size="0.1 0.05 0.15" pos="0.3 0.1 0.2" euler="0 50 0" group="1"/>
    <geom name="cylinder" type="cylinder" size="0.07 0.15" pos="0.3 -0.3 0.2" euler="60 0 20" group="1"/>
    <geom name="capsule" type="capsule" size="0.05 0.15" pos="-0.1 -0.3 0.1" euler="80 0 20" group="1"/>
    <geom name="mesh" type="mesh" mesh="pyramid" pos="0 0.5 0.1" euler="0 30 20" group="1" rgba="0 1 0 1"/>
    <geom name="hidden" type="sphere" size="0.5" group="0"/>
    <geom name="clear" type="sphere" size="0.5" group="1" rgba="1 1 1 0"/>
  </worldbody>
</mujoco>
"""


def settled(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return data


@pytest.fixture
def reference(monkeypatch):
    """Depth and ids by MuJoCo's own renderer; skips where there is no graphics library."""
    try:
        from mujoco.egl import GLContext
        from mujoco.rendering.classic import gl_context

        # Whoever imported mujoco first may not have set MUJOCO_GL.
        monkeypatch.setattr(gl_context, "GLContext", GLContext, raising=False)
        GLContext(16, 16).free()
    except Exception as error:
        pytest.skip(f"MuJoCo's renderer has no EGL context here: {error}")

    def render(model: mujoco.MjModel, data: mujoco.MjData, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        option = mujoco.MjvOption()
        option.geomgroup[:] = 0
        option.geomgroup[1] = 1
        option.sitegroup[:] = 0
        with mujoco.Renderer(model, camera.height, camera.width) as renderer:
            renderer.enable_depth_rendering()
            renderer.update_scene(data, camera.name, option)
            depth_m = renderer.render().copy()
            renderer.disable_depth_rendering()
            renderer.enable_segmentation_rendering()
            renderer.update_scene(data, camera.name, option)
            ids, kinds = np.moveaxis(renderer.render(), -1, 0)
        return depth_m, np.where(kinds == mujoco.mjtObj.mjOBJ_GEOM, ids, -1)

    return render


def agreement(model, data, names, reference, size=(320, 240)) -> tuple[float, float]:
    """Shares of pixels, away from the edges in the reference, with depth within 1 mm and with the same id."""
    cameras = [camera_from_mujoco(model, data, name, *size) for name in names]
    images = DepthCamera(model, cameras).render(data)
    near, same = [], []
    for camera in cameras:
        depth_m, geom_id = images[camera.name]
        true_depth_m, true_id = reference(model, data, camera)
        inside = smooth(true_depth_m, true_id)
        assert inside.mean() > 0.6
        near.append((np.abs(depth_m - true_depth_m) < 1e-3)[inside])
        same.append((geom_id == true_id)[inside])
    return np.concatenate(near).mean(), np.concatenate(same).mean()


def smooth(depth_m: np.ndarray, geom_id: np.ndarray) -> np.ndarray:
    """(H, W) bool: drawn pixels whose eight neighbours are on the same geom, without a bend in depth."""
    inside = np.zeros(depth_m.shape, dtype=bool)
    windows = np.lib.stride_tricks.sliding_window_view(depth_m, (3, 3))
    ids = np.lib.stride_tricks.sliding_window_view(geom_id, (3, 3))
    bend = np.abs(windows[..., 0, :] - 2 * windows[..., 1, :] + windows[..., 2, :]).max(axis=-1)
    bend += np.abs(windows[..., 0] - 2 * windows[..., 1] + windows[..., 2]).max(axis=-1)
    one_geom = (ids == ids[..., 1:2, 1:2]).all(axis=(-1, -2)) & (ids[..., 1, 1] >= 0)
    inside[1:-1, 1:-1] = one_geom & (bend < 0.02 * depth_m[1:-1, 1:-1])
    return inside


def test_primitives_match_mujocos_renderer(reference):
    model = mujoco.MjModel.from_xml_string(PRIMITIVES)
    near, same = agreement(model, settled(model), ("above", "low"), reference)
    assert near >= 0.999
    assert same >= 0.999


def test_lift_matches_mujocos_renderer(reference, lift):
    near, same = agreement(*lift, ("agentview", "frontview", "sideview"), reference)
    assert near >= 0.999
    assert same >= 0.999


@pytest.mark.parametrize("task", ["OpenDrawer", "PickCube", "StackCube"])
def test_every_tasks_scene_matches_mujocos_renderer(task, reference):
    env = gym.make(f"CEI-{task}-UR5e-FourierRight", clouds=False).unwrapped
    env.reset(seed=1)
    near, same = agreement(env.model, env.simulation.data, ("agentview", "frontview", "sideview"), reference)
    env.close()
    assert near >= 0.999
    assert same >= 0.999


@pytest.fixture(scope="module")
def lift():
    robosuite = pytest.importorskip("robosuite")
    env = robosuite.make(
        "Lift",
        robots="IIWA",
        gripper_types="InspireRightHand",
        has_renderer=False,
        has_offscreen_renderer=False,
        use_camera_obs=False,
        hard_reset=False,
    )
    # private: MuJoCo's own, which robosuite wraps and gives no other name
    yield env.sim.model._model, env.sim.data._data
    env.close()


def test_clustering_moves_lift_by_less_than_its_cell(lift):
    model, data = lift
    cameras = [camera_from_mujoco(model, data, "sideview", 160, 120)]
    coarse, coarse_id = DepthCamera(model, cameras).render(data)["sideview"]
    whole, whole_id = DepthCamera(model, cameras, cluster_m=0).render(data)["sideview"]
    inside = smooth(whole, whole_id)
    assert (np.abs(coarse - whole) < 1e-3)[inside].mean() > 0.999
    assert (coarse_id == whole_id)[inside].mean() > 0.999


def test_lift_colours_come_from_textures(lift):
    model, _ = lift
    colours = geom_colours(model)
    cube, table = model.geom("cube_g0_vis").id, model.geom("table_visual").id
    assert colours[cube, 0] > 2 * colours[cube, 1]
    assert (colours[table, :3] < 1).all()


BOX = """
<mujoco><worldbody>
  <geom type="plane" size="0 0 1" group="1"/>
  <geom name="box" type="box" size="0.2 0.2 0.1" pos="0 0 0.1" group="1"/>
</worldbody></mujoco>
"""


def test_box_on_a_plane_seen_from_above_is_exact():
    model = mujoco.MjModel.from_xml_string(BOX)
    data = settled(model)
    camera = look_at("down", (0, 0, 2), (0, 0, 0), 64, 48, 45, up=(0, 1, 0))
    images = DepthCamera(model, [camera])
    depth_m, geom_id = images.render(data)["down"]
    v, u = np.indices(depth_m.shape)
    on_box = np.maximum(abs(u - 31.5), abs(v - 23.5)) * 1.8 / camera.K[0, 0] < 0.2
    np.testing.assert_array_equal(geom_id, on_box)
    np.testing.assert_allclose(depth_m, np.where(on_box, 1.8, 2.0), rtol=1e-6)

    model.geom("box").size[2] = 0.05  # sizes are read at every frame
    depth_m, geom_id = images.render(data)["down"]
    np.testing.assert_allclose(depth_m[geom_id == 1], 1.85, rtol=1e-6)


def test_tilted_plane_is_exact_up_to_the_image_border():
    model = mujoco.MjModel.from_xml_string(BOX)
    camera = look_at("tilted", (1, 2, 1.5), (1, 9, 0), 80, 60, 60)
    depth_m, geom_id = DepthCamera(model, [camera]).render(settled(model))["tilted"]
    floor = geom_id == 0
    assert floor[-1].all()
    assert floor.sum() > 1000
    points_world = unproject(np.where(floor, depth_m, 0), camera)
    assert np.abs(points_world[:, 2]).max() < 1e-5


def test_near_plane_cuts_and_open_meshes_show_their_backs():
    sheet = """
    <mujoco><asset>
      <mesh name="sheet" vertex="0 0 0 2 0 0 0 2 0 0 0 0.5" face="0 1 2 0 2 3" inertia="shell"/>
    </asset>
    <worldbody><geom type="mesh" mesh="sheet" group="1"/></worldbody></mujoco>
    """
    model = mujoco.MjModel.from_xml_string(sheet)
    data = settled(model)
    below = look_at("below", (0.5, 0.5, -1), (0.5, 0.5, 0), 32, 32, 40, up=(0, 1, 0))
    grazing = look_at("grazing", (0.5, 0.5, 0.1), (0.6, 0.5, 0.08), 32, 32, 90)
    images = DepthCamera(model, [below, grazing]).render(data)
    np.testing.assert_allclose(images["below"][0][16, 16], 1.0, rtol=1e-6)
    depth_m, geom_id = images["grazing"]
    assert (geom_id[-1] == 0).any()
    assert depth_m[geom_id == 0].min() >= 0.01


@settings(max_examples=50, deadline=None)
@given(
    eye=st.tuples(*[st.floats(-3, 3)] * 3),
    fovy_deg=st.floats(20, 100),
    seed=st.integers(0, 2**31),
)
def test_unproject_inverts_projection(eye, fovy_deg, seed):
    camera = look_at("any", eye, (4, 5, 6), 20, 15, fovy_deg)
    depth_m = np.random.default_rng(seed).uniform(0.1, 5, (15, 20))
    depth_m[3, 4], depth_m[5, 6], depth_m[7, 8] = 0, np.nan, np.inf
    points_world = unproject(depth_m, camera)
    T_camera_world = np.linalg.inv(camera.T_world_camera)
    points_camera = points_world @ T_camera_world[:3, :3].T + T_camera_world[:3, 3]
    pixels = points_camera @ camera.K.T
    known = np.isfinite(depth_m) & (depth_m > 0)
    v, u = np.nonzero(known)
    np.testing.assert_allclose(pixels[:, 2], depth_m[known], atol=1e-9)
    np.testing.assert_allclose(pixels[:, :2] / pixels[:, 2:], np.stack([u, v], axis=1), atol=1e-8)


def test_picture_has_the_geoms_colours():
    model = mujoco.MjModel.from_xml_string(PRIMITIVES)
    data = settled(model)
    camera = camera_from_mujoco(model, data, "above", 160, 120)
    depth_m, geom_id = DepthCamera(model, [camera]).render(data)["above"]
    picture = shade(depth_m, geom_id, camera, geom_colours(model))
    assert picture.shape == (120, 160, 3)
    assert picture.dtype == np.uint8
    red, green = picture[geom_id == model.geom("box").id], picture[geom_id == model.geom("mesh").id]
    assert (red[:, 0] > red[:, 1]).all()
    assert (green[:, 1] > green[:, 0]).all()
    assert set(np.unique(geom_id)) <= {-1, *range(8)}


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda model, data: DepthCamera(model, [], groups=(5,)), "nothing to draw"),
        (lambda model, data: camera_from_mujoco(model, data, "abov", 4, 4), "Did you mean 'above'"),
        (lambda model, data: look_at("a", (0, 0, 1), (0, 0, 0), 4, 4, 45), "up"),
        (lambda model, data: look_at("a", (0, 1, 1), (0, 0, 0), 4, 4, 190), "fovy"),
        (
            lambda model, data: unproject(np.ones((4, 5)), look_at("a", (0, 1, 1), (0, 0, 0), 4, 5, 45)),
            r"\(5, 4\)",
        ),
    ],
)
def test_bad_input_is_named(make, message):
    model = mujoco.MjModel.from_xml_string(PRIMITIVES)
    with pytest.raises(CEIError, match=message):
        make(model, settled(model))
