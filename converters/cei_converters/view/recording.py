"""A view as a rerun recording: entities, timelines, and how the viewer lays them out."""

import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from trimesh.visual import ColorVisuals

from cei_converters import signals
from cei_converters.cli.outputs import whole
from cei_converters.dataset import schema
from cei_converters.dataset.place import temporary_folder
from cei_converters.view.episode import NORMAL_M, RESIDUALS, Side, View, cloud_rgb
from cei_gym.arrays import Array
from cei_gym.embodiment.meshes import visual_link_meshes
from cei_gym.errors import CEIError
from cei_gym.rendering import lighter

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

APPLICATION, CORRECTION = "cei-view", "correction"
_POINT_M, _PAD_M, _ARROW_M = 0.0025, 0.0012, 0.0005  # radii


def save(view: View, path: Path) -> None:
    """Write a recording that rerun's viewer opens."""
    import rerun as rr

    rr.set_strict_mode(True)  # a mistake is an error, not a warning
    with whole(path) as partial:
        recording = rr.RecordingStream(APPLICATION)
        recording.send_recording_name(view.title)
        recording.save(partial, default_blueprint=_blueprint(view))
        _log(recording, view)
        recording.disconnect()


def open_viewer(view: View) -> None:
    """Show it in a window of rerun's viewer, until that is closed.

    Raises:
        CEIError: the viewer fails, as it does where it finds no display.
    """
    with temporary_folder() as folder:
        path = folder / f"{APPLICATION}.rrd"
        save(view, path)
        viewer = subprocess.Popen([sys.executable, "-m", "rerun", path])
        with signals.unfinished(viewer.terminate):
            code = viewer.wait()
        if code != 0:
            raise CEIError("rerun's viewer failed; save --rrd=<file>.rrd or --sheet=<file>.png instead.")


def _log(recording: "rr.RecordingStream", view: View) -> None:
    import rerun as rr

    times = [rr.TimeColumn("frame", sequence=range(len(view))), rr.TimeColumn("time", duration=view.times_s)]
    for side in view.sides:
        recording.log(side.role, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        _log_robot(recording, times, side)
        _log_pads(recording, times, side)
        _log_cloud(recording, times, side)
        _log_cameras(recording, view, side)
        _log_pictures(recording, view, side)
        _log_joints(recording, times, side)
    _log_correction(recording, view)
    for key, label in RESIDUALS.items():
        if key in view.residuals:
            _log_series(recording, times, f"residuals/{key}", label, view.residuals[key])


def _log_robot(recording: "rr.RecordingStream", times: list[Any], side: Side) -> None:
    import rerun as rr

    names = [name.replace("/", "_") for name in side.embodiment.body_names]
    for link, (name, mesh) in enumerate(zip(names, visual_link_meshes(side.embodiment.model), strict=True)):
        path = f"{side.role}/robot/{rr.escape_entity_path_part(name)}"
        T = side.T_world_links[:, link]
        columns = rr.Transform3D.columns(translation=T[:, :3, 3], mat3x3=T[:, :3, :3])
        recording.send_columns(path, indexes=times, columns=columns)
        if mesh is not None:
            shape = rr.Mesh3D(
                vertex_positions=mesh.vertices,
                triangle_indices=mesh.faces,
                vertex_normals=mesh.vertex_normals,
                vertex_colors=lighter(cast(ColorVisuals, mesh.visual).vertex_colors / 255),
            )
            recording.log(path, shape, static=True)


def _log_pads(recording: "rr.RecordingStream", times: list[Any], side: Side) -> None:
    import rerun as rr

    frames, pairs, _ = side.points_world.shape
    points, lengths = side.points_world.reshape(-1, 3), [pairs] * frames
    normals = NORMAL_M * side.normals_world.reshape(-1, 3)
    rgb = side.pads_rgb
    path = f"{side.role}/pads/points"
    recording.log(path, rr.Points3D.from_fields(colors=rgb, radii=_PAD_M), static=True)
    columns = rr.Points3D.columns(positions=points).partition(lengths)
    recording.send_columns(path, indexes=times, columns=columns)
    path = f"{side.role}/pads/normals"
    recording.log(path, rr.Arrows3D.from_fields(colors=rgb, radii=_ARROW_M), static=True)
    columns = rr.Arrows3D.columns(origins=points, vectors=normals).partition(lengths)
    recording.send_columns(path, indexes=times, columns=columns)


def _log_cloud(recording: "rr.RecordingStream", times: list[Any], side: Side) -> None:
    import rerun as rr

    cloud = side.demonstration.point_cloud_world
    if cloud is not None:
        frames, points, _ = cloud.shape
        path = f"{side.role}/cloud"
        recording.log(path, rr.Points3D.from_fields(radii=_POINT_M), static=True)
        colours = np.concatenate([cloud_rgb(side.demonstration, t) for t in range(frames)])
        columns = rr.Points3D.columns(positions=cloud[..., :3].reshape(-1, 3), colors=colours)
        recording.send_columns(path, indexes=times, columns=columns.partition([points] * frames))


def _log_cameras(recording: "rr.RecordingStream", view: View, side: Side) -> None:
    import rerun as rr

    scene = side.demonstration.scene
    low, high = scene.workspace_world
    box = rr.Boxes3D(centers=[(low + high) / 2], half_sizes=[(high - low) / 2], colors=[(150, 150, 150)])
    recording.log(rr.new_entity_path([side.role, "workspace"]), box, static=True)
    for camera in scene.cameras:
        path = f"{side.role}/cameras/{rr.escape_entity_path_part(camera.name)}"
        T = camera.T_world_camera
        recording.log(path, rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3]), static=True)
        pinhole = rr.Pinhole(
            image_from_camera=camera.K,
            resolution=[camera.width, camera.height],
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=0.1,
        )
        recording.log(path, pinhole, static=True)
        for t, depth_m in enumerate(side.demonstration.depth_m.get(camera.name, ())):
            recording.set_time("frame", sequence=t)
            recording.set_time("time", duration=view.times_s[t])
            recording.log(f"{path}/depth", rr.DepthImage(depth_m, meter=1.0))


def _log_pictures(recording: "rr.RecordingStream", view: View, side: Side) -> None:
    import rerun as rr

    for key, pictures in side.pictures.items():
        for t, picture in enumerate(pictures):
            recording.set_time("frame", sequence=t)
            recording.set_time("time", duration=view.times_s[t])
            recording.log(_picture_path(side, key), rr.Image(picture).compress(jpeg_quality=90))


def _picture_path(side: Side, key: str) -> str:
    import rerun as rr

    return f"{side.role}/pictures/{rr.escape_entity_path_part(key)}"


def _log_joints(recording: "rr.RecordingStream", times: list[Any], side: Side) -> None:
    for kind, values in (("position", side.demonstration.qpos), ("action", side.demonstration.action)):
        for name, series in zip(schema.joint_feature_names(side.embodiment), values.T, strict=True):
            _log_series(recording, times, f"{side.role}/joints/{kind}/{name}", name, series)


def _log_correction(recording: "rr.RecordingStream", view: View) -> None:
    """Pads in the one frame in which it is known where they would be without the correction, the source's too, and how it moves each point."""
    import rerun as rr

    if view.uncorrected is None:
        return
    frame, path = int(view.uncorrected.frames[0]), CORRECTION
    recording.log(path, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    recording.log(f"{path}/words", rr.TextDocument(f"Frame {frame}: {view.correction}."), static=True)
    for side, t in [*((side, frame) for side in view.sides), (view.uncorrected, 0)]:
        points, normals, rgb = side.points_world[t], side.normals_world[t], side.pads_rgb
        log = {
            "points": rr.Points3D(points, colors=rgb, radii=_PAD_M),
            "normals": rr.Arrows3D(origins=points, vectors=NORMAL_M * normals, colors=rgb, radii=_ARROW_M),
        }
        for name, shape in log.items():
            recording.log(f"{path}/{side.role}/{name}", shape, static=True)
    before, after = view.uncorrected.points_world[0], view.sides[-1].points_world[frame]
    moves = rr.Arrows3D(origins=before, vectors=after - before, colors=(120, 120, 120), radii=_ARROW_M)
    recording.log(f"{path}/moves", moves, static=True)


def _log_series(recording: "rr.RecordingStream", times: list[Any], path: str, label: str, values: Array) -> None:
    import rerun as rr

    recording.log(path, rr.SeriesLines(names=label), static=True)
    recording.send_columns(path, indexes=times, columns=rr.Scalars.columns(scalars=values))


def _blueprint(view: View) -> "rrb.Blueprint":
    """Robots side by side, seen from the same point; depth images beside them, series over time below."""
    import rerun.blueprint as rrb

    eye, target = view.eye_and_target()
    robots = [
        rrb.Spatial3DView(
            origin=side.role,
            # a depth image would be drawn as one more cloud; the source's pads show how far the target's are from them
            contents=["$origin/**", f"- {side.role}/cameras/*/depth", f"- {side.role}/pictures/**", "source/pads/**"],
            name=side.label,
            eye_controls=rrb.EyeControls3D(position=eye, look_target=target),
        )
        for side in view.sides
    ]
    images = [
        rrb.Spatial2DView(origin=f"{side.role}/cameras/{camera}", name=f"{side.role}: depth of {camera}")
        for side in view.sides
        for camera in side.demonstration.depth_m
    ]
    images += [
        rrb.Spatial2DView(origin=_picture_path(side, key), name=f"{side.role}: {key}")
        for side in view.sides
        for key in side.pictures
    ]
    if view.uncorrected is not None:
        middle = view.uncorrected.points_world[0].mean(axis=0)
        near = rrb.EyeControls3D(
            position=middle + 0.25 * view.uncorrected.towards_eye((1.0, 0.5, 0.3)), look_target=middle
        )
        images += [
            rrb.Spatial3DView(
                origin=CORRECTION, name="pads without the correction (amber), with it (red)", eye_controls=near
            ),
            rrb.TextDocumentView(origin=f"{CORRECTION}/words", name="correction"),
        ]
    above = [*robots, rrb.Vertical(*images)] if images else robots
    below = [
        *(rrb.TimeSeriesView(origin=f"residuals/{key}", name=RESIDUALS[key]) for key in view.residuals),
        *(
            rrb.Tabs(
                *(
                    rrb.TimeSeriesView(origin=f"{side.role}/joints/{kind}", name=f"{side.role}: joint {kind}s")
                    for kind in ("position", "action")
                )
            )
            for side in view.sides
        ),
    ]
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(*above, column_shares=[3] * len(robots) + [2] * bool(images)),
            rrb.Horizontal(*below),
            row_shares=[2, 1],
        ),
        rrb.TimePanel(timeline="time", state="collapsed"),
        collapse_panels=True,
    )
