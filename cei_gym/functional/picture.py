"""A picture of an end-effector with its functional representation: where the pads are, which way they face."""

import numpy as np
from PIL import Image, ImageDraw
from scipy.spatial.transform import Rotation

from cei_gym.arrays import Array
from cei_gym.demonstration import Camera
from cei_gym.embodiment import Embodiment
from cei_gym.functional.representation import FunctionalRepresentation
from cei_gym.kinematics import KinematicTree
from cei_gym.rendering import Portrait, look_at

WIDTH, HEIGHT = 480, 420
_SUPERSAMPLE = 2
_NORMAL_M = 0.012
_HIDDEN_M = 0.004
_COLOURS = [(230, 60, 50), (40, 120, 230), (30, 160, 80), (240, 150, 30), (150, 70, 200)]


def pad_colour(index: int) -> tuple[int, int, int]:
    """RGB in [0, 255] of a pad by its number."""
    return _COLOURS[index % len(_COLOURS)]


def draw_representation(representation: FunctionalRepresentation, qpos: Array) -> Array:
    """Views of the end-effector from three sides, pads' points as dots and normals as lines, one colour a pad.

    Args:
        representation: of an embodiment with an end-effector.
        qpos: (n,) joint positions, rad or m.

    Returns:
        (420, 1440, 3) uint8 RGB.
    """
    embodiment = representation.embodiment
    portrait = Portrait(embodiment)
    T_links = KinematicTree(embodiment).forward(qpos)
    points, normals = representation.place(T_links)
    views = []
    for turn in (-60.0, 30.0, 120.0):
        camera = _view(embodiment, T_links[:, :3, 3], points, turn)
        views.append(_draw(*portrait(T_links, camera), representation, points, normals, camera))
    return np.concatenate(views, axis=1)


def _view(embodiment: Embodiment, links: Array, points: Array, turn_deg: float) -> Camera:
    """A camera that circles the axis from the palm to the pads."""
    palm, pads = links[embodiment.end_effector_root], points.mean(axis=0)
    axis = (pads - palm) / np.linalg.norm(pads - palm)
    side = np.cross(axis, [0.0, 0.0, 1.0] if abs(axis[2]) < 0.9 else [1.0, 0.0, 0.0])
    side = Rotation.from_rotvec(np.radians(turn_deg) * axis).apply(side / np.linalg.norm(side))
    reach = max(0.12, float(np.linalg.norm(links[embodiment.of_end_effector] - palm, axis=1).max()))
    middle = palm + 0.55 * (pads - palm)
    eye = middle + 2.5 * reach * side + 0.5 * reach * axis
    return look_at("view", eye, middle, _SUPERSAMPLE * WIDTH, _SUPERSAMPLE * HEIGHT, 38.0, up=-axis)


def _draw(picture, depth, representation, points, normals, camera: Camera) -> Array:
    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    bodies = np.unique(representation.body)
    heads, _ = _project(points + _NORMAL_M * normals, camera)
    dots, z = _project(points, camera)
    for i in np.argsort(-z):
        u, v = dots[i]
        if not (0 <= u < camera.width and 0 <= v < camera.height):
            continue
        seen = depth[int(v), int(u)]
        if 0 < seen < z[i] - _HIDDEN_M:
            continue
        colour = _COLOURS[int(np.searchsorted(bodies, representation.body[i])) % len(_COLOURS)]
        draw.line([tuple(dots[i]), tuple(heads[i])], fill=colour, width=2)
        draw.ellipse([u - 4, v - 4, u + 4, v + 4], fill=colour, outline=(255, 255, 255))
    return np.asarray(image.resize((WIDTH, HEIGHT), Image.Resampling.LANCZOS))


def _project(points: Array, camera: Camera) -> tuple[Array, Array]:
    """Pixels (N, 2) and depths (N,) of points (N, 3)."""
    R, p = camera.T_world_camera[:3, :3], camera.T_world_camera[:3, 3]
    inside = (points - p) @ R @ camera.K.T
    return inside[:, :2] / inside[:, 2:], inside[:, 2]
