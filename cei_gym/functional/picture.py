"""A picture of an end-effector with its functional representation: where the pads are, which way they face."""

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from scipy.spatial.transform import Rotation

from cei_gym.arrays import Array
from cei_gym.demonstration import Camera
from cei_gym.embodiment import Embodiment
from cei_gym.embodiment.meshes import geom_vertices, outermost, visual_geoms
from cei_gym.functional.representation import FunctionalRepresentation
from cei_gym.kinematics import KinematicTree
from cei_gym.rendering import Portrait, look_at

WIDTH, HEIGHT = 480, 420
_SUPERSAMPLE = 2
_NORMAL_M = 0.012
_HIDDEN_M = 0.004
_AXIS_M, _SMALL_AXIS_M = 0.03, 0.012
_AXIS_COLOURS = [(200, 30, 30), (20, 140, 40), (30, 60, 200)]
_TURNS_DEG, _FOV_DEG = (-60.0, 30.0, 120.0), 38.0
_FLANGE = "flange"
_MARGIN = 0.94  # of the picture
_COLOURS = [(230, 60, 50), (40, 120, 230), (30, 160, 80), (240, 150, 30), (150, 70, 200)]


def pad_colour(index: int) -> tuple[int, int, int]:
    """RGB in [0, 255] of a pad by its number."""
    return _COLOURS[index % len(_COLOURS)]


def draw_representation(representation: FunctionalRepresentation, qpos: Array, frames: bool = False) -> Array:
    """Views of the whole end-effector from three sides, pads' points as dots and normals as lines, one colour a pad.

    Args:
        representation: of an embodiment with an end-effector.
        qpos: (n,) joint positions, rad or m.
        frames: draw those of its mount, with names, and of pads' links, too.

    Returns:
        (420, 1440, 3) uint8 RGB.
    """
    embodiment = representation.embodiment
    portrait = Portrait(embodiment)
    T_links = KinematicTree(embodiment).forward(qpos)
    points, normals = representation.place(T_links)
    axes = _axes(representation, T_links) if frames else []
    ends = [_ends(T, length_m) for _, T, length_m in axes]
    inside = np.concatenate([_surface(embodiment, T_links), points + _NORMAL_M * normals, *ends])
    views: list[Array] = []
    for camera in _cameras(embodiment, T_links[:, :3, 3], points, inside):
        picture, depth_m = portrait(T_links, camera)
        image = Image.fromarray(picture)
        _draw(ImageDraw.Draw(image), depth_m, representation, points, normals, camera)
        _draw_axes(ImageDraw.Draw(image), axes, camera)
        views.append(np.asarray(image.resize((WIDTH, HEIGHT), Image.Resampling.LANCZOS)))
    return np.concatenate(views, axis=1)


def _surface(embodiment: Embodiment, T_links: Array) -> Array:
    """(V, 3) vertices of what is seen of the end-effector."""
    body, mine = embodiment.model.geom_bodyid, embodiment.of_end_effector
    geoms = np.flatnonzero(visual_geoms(embodiment.model) & mine[body])
    parts = [
        outermost(geom_vertices(embodiment.model, int(geom))) @ T_links[body[geom], :3, :3].T
        + T_links[body[geom], :3, 3]
        for geom in geoms
    ]
    return np.concatenate([T_links[mine, :3, 3], *parts])


def _cameras(embodiment: Embodiment, links: Array, points: Array, inside: Array) -> list[Camera]:
    """Cameras around the axis from the palm to the pads, as far from it as all of them need to have points (N, 3) in the picture."""
    palm, pads = links[embodiment.end_effector_root], points.mean(axis=0)
    axis = (pads - palm) / np.linalg.norm(pads - palm)
    side = np.cross(axis, [0.0, 0.0, 1.0] if abs(axis[2]) < 0.9 else [1.0, 0.0, 0.0])
    cameras: list[Camera] = []
    apart_m = 0.0
    for turn_deg in _TURNS_DEG:
        towards = Rotation.from_rotvec(np.radians(turn_deg) * axis).apply(side / np.linalg.norm(side)) + 0.2 * axis
        towards /= np.linalg.norm(towards)
        camera = look_at("view", towards, np.zeros(3), _SUPERSAMPLE * WIDTH, _SUPERSAMPLE * HEIGHT, _FOV_DEG, up=-axis)
        R = camera.T_world_camera[:3, :3]
        seen = inside @ R
        middle = (seen.min(axis=0) + seen.max(axis=0)) / 2
        tangents = np.array([camera.width, camera.height]) / 2 / np.diag(camera.K)[:2] * _MARGIN
        apart_m = max(apart_m, float((np.abs(seen - middle)[:, :2] / tangents + (middle - seen)[:, 2:]).max()))
        camera.T_world_camera[:3, 3] = R @ middle
        cameras.append(camera)
    for camera in cameras:
        camera.T_world_camera[:3, 3] -= apart_m * camera.T_world_camera[:3, 2]
    return cameras


def _draw(
    draw: ImageDraw.ImageDraw,
    depth_m: Array,
    representation: FunctionalRepresentation,
    points: Array,
    normals: Array,
    camera: Camera,
) -> None:
    bodies = np.unique(representation.body)
    heads, _ = _project(points + _NORMAL_M * normals, camera)
    dots, z = _project(points, camera)
    for i in np.argsort(-z):
        u, v = dots[i]
        if not (0 <= u < camera.width and 0 <= v < camera.height):
            continue
        seen = depth_m[int(v), int(u)]
        if 0 < seen < z[i] - _HIDDEN_M:
            continue
        colour = pad_colour(int(np.searchsorted(bodies, representation.body[i])))
        draw.line([tuple(dots[i]), tuple(heads[i])], fill=colour, width=2)
        draw.ellipse([u - 4, v - 4, u + 4, v + 4], fill=colour, outline=(255, 255, 255))


def _axes(representation: FunctionalRepresentation, T_links: Array) -> list[tuple[str, Array, float]]:
    """Frames to draw: name, pose (4, 4), length of axes in m."""
    embodiment = representation.embodiment
    root = embodiment.end_effector_root
    flange = T_links[embodiment.model.body_parentid[root]]
    drawn = [("", T_links[body], _SMALL_AXIS_M) for body in np.unique(representation.body)]
    drawn.append((embodiment.link_names[root], T_links[root], _AXIS_M))
    if embodiment.arm is None:  # else the flange may lie turned in the arm's last link
        drawn.append((_FLANGE, flange, 1.5 * _AXIS_M))
    return drawn


def _draw_axes(draw: ImageDraw.ImageDraw, axes: list[tuple[str, Array, float]], camera: Camera) -> None:
    font = ImageFont.load_default(13 * _SUPERSAMPLE)
    for name, T, length_m in axes:
        ends, _ = _project(_ends(T, length_m), camera)
        for letter, end, colour in zip("xyz", ends[1:], _AXIS_COLOURS, strict=True):
            draw.line([tuple(ends[0]), tuple(end)], fill=colour, width=3 if name else 2)
            if name:
                draw.text(tuple(end), letter, fill=colour, font=font, anchor="mm", stroke_width=3, stroke_fill="white")
        if name:
            beside = 12 if name == _FLANGE else -12  # for where both are at one place
            place, anchor = (ends[0][0] + beside, ends[0][1]), "lm" if beside > 0 else "rm"
            draw.text(place, name, fill=(40, 40, 40), font=font, anchor=anchor, stroke_width=3, stroke_fill="white")


def _ends(T: Array, length_m: float) -> Array:
    """(4, 3) origin and ends of a frame's axes."""
    return T[:3, 3] + np.vstack([np.zeros(3), length_m * T[:3, :3].T])


def _project(points: Array, camera: Camera) -> tuple[Array, Array]:
    """Pixels (N, 2) and depths (N,) of points (N, 3)."""
    R, p = camera.T_world_camera[:3, :3], camera.T_world_camera[:3, 3]
    inside = (points - p) @ R @ camera.K.T
    return inside[:, :2] / inside[:, 2:], inside[:, 2]
