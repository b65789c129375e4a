"""Noise of depth cameras against its definition."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from scipy.spatial.transform import Rotation

from cei_gym.demonstration import Camera
from cei_gym.errors import CEIError
from cei_gym.rendering import DepthNoise, add_noise, as_noise, look_at, miscalibrated

CAMERA = look_at("front", (0.75, 0.45, 1.45), (-0.08, 0, 0.85), 160, 120, 45)
KINECT = as_noise("kinect") or DepthNoise()
SHAPE = (120, 160)


def noisy(depth_m: np.ndarray, seed: int = 0, **noise: float) -> np.ndarray:
    result = add_noise(depth_m, CAMERA, DepthNoise(**noise), np.random.default_rng(seed))  # pyright: ignore
    assert result.dtype == np.float32
    return result


def step_image() -> np.ndarray:
    """1 m on the left half, 2 m on the right one; columns 79 and 80 are the edge."""
    depth_m = np.ones(SHAPE)
    depth_m[:, 80:] = 2.0
    return depth_m


def plane(normal_camera: np.ndarray, distance_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Depth of a plane, 0 behind the camera, and the angle between each ray and the plane's normal, deg."""
    v, u = np.indices(SHAPE)
    K = CAMERA.K
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(SHAPE)], axis=-1)
    along = rays @ normal_camera
    depth_m = np.where(along > 1e-3, distance_m / np.maximum(along, 1e-3), 0)
    return depth_m, np.rad2deg(np.arccos(along / np.linalg.norm(rays, axis=-1)))


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_no_noise_leaves_an_image_as_it_is(seed: int) -> None:
    random = np.random.default_rng(seed)
    depth_m = random.uniform(0.1, 5, SHAPE).astype(np.float32)
    depth_m[random.random(SHAPE) < 0.2] = 0
    np.testing.assert_array_equal(noisy(depth_m, seed), depth_m)


@settings(max_examples=20, deadline=None)
@given(z=st.floats(0.3, 4), offset=st.floats(0, 0.005), growth=st.floats(0, 0.005), start=st.floats(0, 0.8))
def test_axial_noise_grows_as_stated(z: float, offset: float, growth: float, start: float) -> None:
    error = noisy(np.full(SHAPE, z), axial_m=offset, axial_per_m=growth, axial_from_m=start) - z
    sigma = offset + growth * (z - start) ** 2
    assert error.std() == pytest.approx(sigma, rel=0.03, abs=1e-6)
    assert abs(error.mean()) < 5 * sigma / np.sqrt(error.size) + 1e-6
    if sigma > 1e-4:  # below, single precision shows
        assert stats.kstest(error.ravel() / sigma, "norm").pvalue > 1e-3


def test_the_kinects_figures_are_the_published_ones() -> None:
    for z, sigma in ((0.4, 0.0012), (1.0, 0.001884), (2.0, 0.006064)):
        only = replace(DepthNoise(), axial_m=KINECT.axial_m, axial_per_m=KINECT.axial_per_m, axial_from_m=0.4)
        error = add_noise(np.full(SHAPE, z), CAMERA, only, np.random.default_rng(0)) - z
        assert error.std() == pytest.approx(sigma, rel=0.03)
    assert KINECT.axial_from_m == 0.4
    assert KINECT.lateral_rad * 585 == pytest.approx(0.8)


@pytest.mark.parametrize("axis", [0, 1])
def test_lateral_noise_is_where_a_pixel_looks(axis: int) -> None:
    pixel = np.indices(SHAPE)[axis]
    depth_m = 1 + 1e-4 * pixel
    looked = np.rint((noisy(depth_m, lateral_rad=3 / CAMERA.K[0, 0]) - 1) * 1e4)
    inner = (slice(20, -20), slice(20, -20))
    offset = (looked - pixel)[inner]
    assert offset.std() == pytest.approx(np.sqrt(9 + 1 / 12), rel=0.03)  # and rounding to a pixel
    assert abs(offset.mean()) < 0.15
    assert looked.min() >= 0
    assert looked.max() < SHAPE[axis]


def test_flying_pixels_are_at_edges_and_anywhere_between_their_sides() -> None:
    depth_m = step_image()
    images = np.array([noisy(depth_m, seed, flying_share=0.3) for seed in range(20)])
    flying = images != depth_m
    assert not flying[..., :79].any()
    assert not flying[..., 81:].any()
    for column in (79, 80):
        assert flying[..., column].mean() == pytest.approx(0.3, abs=0.04)
        depths = images[..., column][flying[..., column]]
        assert stats.kstest(depths, "uniform", args=(1, 1)).pvalue > 1e-3


def test_dropout_is_of_the_stated_share_beside_edges_and_elsewhere() -> None:
    images = np.array([noisy(step_image(), seed, dropout_share=0.02, edge_dropout_share=0.4) for seed in range(20)])
    lost = images == 0
    assert lost[..., 79:81].mean() == pytest.approx(0.4, abs=0.04)
    assert np.delete(lost, [79, 80], axis=-1).mean() == pytest.approx(0.02, rel=0.05)


@settings(max_examples=30, deadline=None)
@given(angle_deg=st.floats(0, 89), turn_deg=st.floats(0, 360), grazing_deg=st.floats(20, 89))
def test_a_surface_seen_at_a_grazing_angle_has_no_depth(angle_deg: float, turn_deg: float, grazing_deg: float) -> None:
    normal = Rotation.from_euler("zx", [turn_deg, angle_deg], degrees=True).apply([0, 0, 1])
    depth_m, seen_deg = plane(normal, 0.7)
    result = noisy(depth_m, grazing_deg=grazing_deg)
    sure = (depth_m > 0) & (np.abs(seen_deg - grazing_deg) > 0.01) & (seen_deg < 89)
    np.testing.assert_array_equal(result[sure] > 0, (seen_deg < grazing_deg)[sure])


@settings(max_examples=30, deadline=None)
@given(tilt_deg=st.floats(0, 20), shift_m=st.floats(0, 0.1), seed=st.integers(0, 2**31))
def test_a_calibration_is_off_by_what_was_asked_for(tilt_deg: float, shift_m: float, seed: int) -> None:
    noise = DepthNoise(tilt_deg=tilt_deg, shift_m=shift_m, seed=seed)
    camera = miscalibrated(CAMERA, noise)
    between = np.linalg.inv(CAMERA.T_world_camera) @ camera.T_world_camera
    assert np.rad2deg(Rotation.from_matrix(between[:3, :3]).magnitude()) == pytest.approx(tilt_deg, abs=1e-6)
    assert np.linalg.norm(between[:3, 3]) == pytest.approx(shift_m, abs=1e-9)
    assert replace(camera, T_world_camera=CAMERA.T_world_camera) == CAMERA


def test_every_camera_and_seed_is_off_in_its_own_direction() -> None:
    noise = DepthNoise(shift_m=1.0)

    def direction(camera: Camera, noise: DepthNoise) -> np.ndarray:
        return (miscalibrated(camera, noise).T_world_camera - camera.T_world_camera)[:3, 3]

    own = direction(CAMERA, noise)
    np.testing.assert_array_equal(direction(CAMERA, noise), own)
    assert np.linalg.norm(direction(replace(CAMERA, name="left"), noise) - own) > 0.1
    assert np.linalg.norm(direction(CAMERA, replace(noise, seed=1)) - own) > 0.1


def test_one_seed_gives_one_image_and_draws_as_often_whatever_is_seen() -> None:
    empty, full = np.zeros(SHAPE), step_image()
    randoms = [np.random.default_rng(5) for _ in range(3)]
    images = [add_noise(d, CAMERA, KINECT, r) for d, r in zip((full, full, empty), randoms, strict=True)]
    np.testing.assert_array_equal(images[0], images[1])
    np.testing.assert_array_equal(images[2], empty)
    assert randoms[0].bit_generator.state == randoms[2].bit_generator.state
    assert not np.array_equal(images[0], add_noise(full, CAMERA, KINECT, randoms[0]))


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_any_image_gives_depths_or_zeros(seed: int) -> None:
    random = np.random.default_rng(seed)
    depth_m = random.uniform(0, 3, SHAPE)
    unknown = random.choice([0.0, np.nan, np.inf, -np.inf, -1.0], SHAPE)
    depth_m = np.where(random.random(SHAPE) < 0.5, unknown, depth_m)
    result = add_noise(depth_m, CAMERA, replace(KINECT, lateral_rad=0.0), random)
    assert np.isfinite(result).all()
    assert (result >= 0).all()
    assert (result[~(np.isfinite(depth_m) & (depth_m > 0))] == 0).all()


@pytest.mark.parametrize(
    ("noise", "message"),
    [
        ("kinct", "unknown depth noise 'kinct'. Did you mean 'kinect'?"),
        ({"axial": 1.0}, "unknown field of depth noise 'axial'. Did you mean 'axial_m'?"),
        ({"dropout_share": 1.5}, "dropout_share=1.5 should be a number, at least 0 and at most 1"),
        ({"axial_m": -0.1}, "axial_m=-0.1 should be a number, at least 0."),
        ({"tilt_deg": float("nan")}, "tilt_deg=nan should be a number"),
        ({"tilt_deg": "much"}, "tilt_deg='much' should be a number"),
    ],
)
def test_noise_that_cannot_be_is_named(noise: str | dict, message: str) -> None:
    with pytest.raises(CEIError) as error:
        as_noise(noise)
    assert message in str(error.value)
    assert "\n" not in str(error.value)
