"""A view as one picture, drawn without GL: rows are robots, columns are moments, below how far the pads are apart."""

import textwrap
from collections.abc import Iterable, Sequence
from itertools import combinations
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase
from matplotlib.lines import Line2D
from PIL import Image

from cei_converters.cli.outputs import whole
from cei_converters.view.episode import NORMAL_M, RESIDUALS, Side, View, cloud_rgb
from cei_gym.arrays import Array
from cei_gym.demonstration import Camera, Demonstration
from cei_gym.rendering import Portrait, look_at, splat

_MOMENTS = 5
_WIDTH, _HEIGHT, _CLOSE_UP_HEIGHT, _PLOT_HEIGHT = 480, 420, 300, 260  # px
_HEAD_HEIGHT, _KEY_HEIGHT, _TITLE_HEIGHT = 90, 30, 40  # px; of the key a line more
_LEAST_COLUMNS = 3  # room for the title and its key
_DPI = 100
_SUPERSAMPLE = 2
_FOVY_DEG = 36.0
_CLOSE_UP_DIRECTION = 1.0, -0.5, 0.25  # in the base frame: from the front, where pads that oppose each other both show
_CLOSE_UP_M, _CLOSE_UP_FOVY_DEG = 0.3, 30.0
_CORRECTION_HEIGHT, _LETTERS = 110, 150  # px beside the pictures, and how long its lines are
_CORRECTION_DIRECTIONS = _CLOSE_UP_DIRECTION, (0.15, 1.0, 0.25)  # and from the side
_CORRECTION_M = 0.24
_LINE_DOTS = 40
_PALE = 0.6
_GREY = (150, 150, 150)


def write_sheet(view: View, path: Path) -> None:
    """Write a PNG."""
    figure = draw_sheet(view)
    with whole(path) as partial:
        figure.savefig(partial, format="png", dpi=_DPI)


def draw_sheet(view: View) -> Figure:
    """Robots in rows, moments in columns; below what was corrected, and how far the pads are apart."""
    moments = np.unique(np.linspace(0, len(view) - 1, _MOMENTS).round().astype(int))
    row_px = _HEIGHT + _CLOSE_UP_HEIGHT + _TITLE_HEIGHT
    heights = [_HEAD_HEIGHT + _KEY_HEIGHT * (view.uncorrected is not None), *[row_px] * len(view.sides)]
    heights += [_CLOSE_UP_HEIGHT + _CORRECTION_HEIGHT] * (view.uncorrected is not None)
    strips = picture_strips(view, moments)
    heights += [_TITLE_HEIGHT + round(_WIDTH * shown[0].shape[0] / shown[0].shape[1]) for _, shown in strips]
    heights += [_PLOT_HEIGHT] * bool(view.residuals)
    width = max(_LEAST_COLUMNS, len(moments)) * (_WIDTH + 10) + 40
    figure = Figure(figsize=(width / _DPI, sum(heights) / _DPI), layout="constrained")
    head, *rows = figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
    head.suptitle(view.title, fontsize=20, parse_math=False)
    head.legend(handles=_key(view), loc="lower center", ncols=4, fontsize=14, frameon=False)
    for row, side in zip(rows, view.sides, strict=False):
        row.supylabel(side.label, fontsize=18)
        columns = row.subplots(1, len(moments), squeeze=False)[0]
        for axes, t, picture in zip(columns, moments, draw_moments(view, side, moments), strict=True):
            axes.imshow(picture)
            axes.set_title(f"frame {side.frames[t]}, {view.times_s[t]:.2f} s", fontsize=15)
            axes.set(xticks=[], yticks=[])
    if view.uncorrected is not None:
        draw_correction(rows[len(view.sides)], view)
    for row, (label, shown) in zip(rows[len(view.sides) + (view.uncorrected is not None) :], strips, strict=False):
        row.supylabel(label, fontsize=15)
        for axes, picture in zip(row.subplots(1, len(moments), squeeze=False)[0], shown, strict=True):
            axes.imshow(picture)
            axes.set(xticks=[], yticks=[])
    if view.residuals:
        for axes, key in zip(rows[-1].subplots(1, len(view.residuals)), view.residuals, strict=True):
            _plot(axes, view, key, moments)
    return figure


def picture_strips(view: View, moments: Array) -> list[tuple[str, Array]]:
    """What RGB cameras saw, a strip (M, H, W, 3) uint8 of a camera and a side, and how two sides differ: with their labels."""
    strips: list[tuple[str, Array]] = []
    for key in dict.fromkeys(key for side in view.sides for key in side.pictures):
        camera = key.rpartition(".")[2]
        shown = [(side, side.pictures[key][moments]) for side in view.sides if key in side.pictures]
        strips += [(f"{camera}\n{side.label}", pictures) for side, pictures in shown]
        if len(shown) == 2 and shown[0][1].shape == shown[1][1].shape:
            first, second = (pictures.astype(np.int16) for _, pictures in shown)
            strips.append((f"{camera}\ndifference", np.abs(first - second).astype(np.uint8)))
    return strips


def draw_correction(figure: FigureBase, view: View) -> None:
    """Without the correction and with it, from two sides, in the frame in which the dataset says where the robot would be without."""
    assert view.uncorrected is not None
    kept, frame = view.sides[-1], int(view.uncorrected.frames[0])
    source = [(side, frame) for side in view.sides[:-1]]
    without = [*source, (view.uncorrected, 0)]
    pictures, middle = [], kept.points_world[frame].mean(axis=0)
    for direction in _CORRECTION_DIRECTIONS:
        eye = middle + _CORRECTION_M * kept.towards_eye(direction)
        camera = _camera(eye, middle, _CLOSE_UP_HEIGHT, _CLOSE_UP_FOVY_DEG, _SUPERSAMPLE)
        for sides in (without, [*without, (kept, frame)]):
            picture = _draw(sides, camera, 2.0 * _SUPERSAMPLE, kept.demonstration, frame)
            pictures.append(np.asarray(Image.fromarray(picture).reduce(_SUPERSAMPLE)))
    said = textwrap.fill(f"Frame {frame}, {view.times_s[frame]:.2f} s, {view.correction}", _LETTERS)
    figure.suptitle(said, fontsize=15, parse_math=False)
    titles = ("without it (amber)", "with it (red)") * len(_CORRECTION_DIRECTIONS)
    for axes, title, picture in zip(figure.subplots(1, len(pictures)), titles, pictures, strict=True):
        axes.imshow(picture)
        axes.set_title(title, fontsize=13)
        axes.set(xticks=[], yticks=[])


def _key(view: View) -> list[Line2D]:
    of_pads = "pads and outward normals (pale: hidden)"
    shown = [*view.sides, *([] if view.uncorrected is None else [view.uncorrected])]
    pads = [
        Line2D([], [], color=_hex(side.pads_rgb), marker="o", ms=6, label=f"{side.whose} {of_pads}") for side in shown
    ]
    has_cloud = any(side.demonstration.point_cloud_world is not None for side in view.sides)
    cloud = Line2D([], [], ls="", marker="o", ms=6, color="tab:green", label="point cloud")
    return [*pads, *[cloud] * has_cloud, Line2D([], [], color=_hex(_GREY), label="workspace")]


def _hex(rgb: tuple[int, int, int]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*rgb)


def _plot(axes: Axes, view: View, key: str, moments: Array) -> None:
    times, values = view.times_s, view.residuals[key]
    axes.plot(times, values, lw=1.5, color="0.25")
    axes.plot(times[moments], values[moments], "o", color="0.25")
    axes.set(title=RESIDUALS[key], xlabel="time (s); dots: the moments above", ylim=(0, 1.15 * max(1, values.max())))
    axes.grid(alpha=0.3)


def draw_moments(view: View, side: Side, moments: Iterable[int], supersample: int = _SUPERSAMPLE) -> list[Array]:
    """One picture (H, W, 3) uint8 a moment (index of a frame): above all of the robot, below its pads from near."""
    portrait = Portrait(side.embodiment)
    from_afar = _camera(*view.eye_and_target(), _HEIGHT, _FOVY_DEG, supersample)
    pictures = []
    for t in moments:
        sides = [(shown, t) for shown in view.sides[: view.sides.index(side) + 1]]
        middle = side.points_world[t].mean(axis=0)
        eye = middle + _CLOSE_UP_M * side.towards_eye(_CLOSE_UP_DIRECTION)
        close_up = _camera(eye, middle, _CLOSE_UP_HEIGHT, _CLOSE_UP_FOVY_DEG, supersample)
        both = [
            _draw(sides, camera, supersample * radius_px, side.demonstration, t, portrait)
            for camera, radius_px in ((from_afar, 1.5), (close_up, 2.0))
        ]
        both[1][:supersample] = _GREY
        picture = Image.fromarray(np.concatenate(both))
        pictures.append(np.asarray(picture.reduce(supersample)))
    return pictures


def _camera(eye: Array, target: Array, height: int, fovy_deg: float, supersample: int) -> Camera:
    return look_at("view", eye, target, supersample * _WIDTH, supersample * height, fovy_deg)


def _draw(
    sides: Sequence[tuple[Side, int]],
    camera: Camera,
    radius_px: float,
    seen: Demonstration,
    t: int,
    portrait: Portrait | None = None,
) -> Array:
    """The last of some sides' robot with the pads of all, each at a frame of its own; pads that are hidden are pale. With them what is seen at
    frame t: workspace and cloud."""
    side, frame = sides[-1]
    portrait = portrait or Portrait(side.embodiment)
    picture, depth_m = portrait(side.T_world_links[frame], camera)
    splat(picture, depth_m, camera, _edges(seen.scene.workspace_world), np.array(_GREY), radius_px / 3)
    if seen.point_cloud_world is not None:
        splat(picture, depth_m, camera, seen.point_cloud_world[t, :, :3], cloud_rgb(seen, t), radius_px)
    for shown, at in sides:
        points, normals = shown.points_world[at], shown.normals_world[at]
        lines = points[:, None] + NORMAL_M * np.linspace(0, 1, _LINE_DOTS)[:, None] * normals[:, None]
        rgb = np.array(shown.pads_rgb)
        splat(picture, np.zeros_like(depth_m), camera, lines.reshape(-1, 3), _PALE * 255 + (1 - _PALE) * rgb, 0.5)
        splat(picture, depth_m, camera, lines.reshape(-1, 3), rgb, 0.5)
        splat(picture, depth_m, camera, points, rgb, radius_px)
    return picture


def _edges(box: Array) -> Array:
    """(N, 3) points along the edges of a box given by two corners (2, 3)."""
    corners = np.array([[box[i, 0], box[j, 1], box[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    share = np.linspace(0, 1, 300)[:, None]
    pairs = [(a, b) for a, b in combinations(corners, 2) if (a != b).sum() == 1]
    return np.concatenate([a + share * (b - a) for a, b in pairs])
