"""A robot as a viser scene: links, what touches, frames, pads. Nodes go by number, since names of a description may hold anything."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import trimesh
import viser
from scipy.spatial.transform import Rotation

from cei_converters.robot.pad_editing import Click, first_hit, outward_normal
from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment
from cei_gym.embodiment.colours import geom_colours
from cei_gym.embodiment.meshes import collision_geoms, geom_mesh, visual_geoms
from cei_gym.functional.representation import FunctionalRepresentation
from cei_gym.kinematics import KinematicTree
from cei_gym.rendering.portrait import lighter

_COLLISION_RGB, _COLLISION_OPACITY = (250, 140, 20), 0.35
_LIFTED_M = 0.0004  # else what touches fights with what is seen, where they are the same
_GLASS = 0.35  # opacity
_SMOOTH_FACES = 200_000  # above, edges are not looked for, which takes seconds
_SHARP_RAD = np.radians(35)
_FOV_RAD = np.radians(38)
_FROM = np.array([1.0, -1.15, 0.62]) / np.linalg.norm([1.0, -1.15, 0.62])

type Handle = Any
"""A node of a scene: viser's handles have `visible`, but nothing in common that says so."""


class RobotScene:
    """A robot in a viser scene, in its base frame, z up.

    Args:
        server: that shows it.
        embodiment: the robot.
    """

    def __init__(self, server: viser.ViserServer, embodiment: Embodiment) -> None:
        self._scene, self._embodiment = server.scene, embodiment
        self._tree = KinematicTree(embodiment)
        self._meshes: dict[int, trimesh.Trimesh] = {}
        self.visual: dict[int, Handle] = {}
        self.collision: dict[int, Handle] = {}
        self.frames: dict[str, list[Handle]] = {}
        self._names: list[Handle] = []
        self._pads: list[Handle] = []
        model = embodiment.model
        self._links = [self._scene.add_frame(f"/link{i}", show_axes=False) for i in range(model.nbody)]
        seen, colours = visual_geoms(model), lighter(geom_colours(model))
        self._opacity = geom_colours(model)[:, 3].tolist()
        touching = {int(geom) for body in range(model.nbody) for geom in collision_geoms(model, body)}
        for geom in range(model.ngeom):
            if seen[geom]:
                red, green, blue = (int(255 * c) for c in colours[geom, :3])
                self.visual[geom] = self._add_geom("visual", geom, (red, green, blue), self._opacity[geom], True)
            if geom in touching:
                self.collision[geom] = self._add_geom("collision", geom, _COLLISION_RGB, _COLLISION_OPACITY, False)
        self.pose(embodiment.home)
        self.centre_m, self.radius_m = self._bounds()
        self._add_frames()
        self._frame(server)

    def pose(self, qpos: Array) -> None:
        """Put links where joints (n,) have them, rad or m."""
        self._T_base_links = self._tree.forward(qpos)
        for handle, T in zip(self._links, self._T_base_links, strict=True):
            handle.wxyz, handle.position = _wxyz(T[:3, :3]), T[:3, 3]

    def glass(self, on: bool) -> None:
        """Whether what is inside of meshes, or coincides with them, is seen through them."""
        for geom, handle in self.visual.items():
            opacity = self._opacity[geom] * (_GLASS if on else 1.0)
            handle.opacity = None if opacity >= 1 else opacity

    def show_names(self, shown: bool) -> None:
        """Whether frames have their names beside them."""
        for label in self._names:
            label.visible = shown

    def on_click(self, clicked: Callable[[Click], None] | None) -> None:
        """Have clicks on links, as they are shown, told; None has none."""
        for handles in (self.visual, self.collision):
            for geom, handle in handles.items():
                handle.remove_click_callback()
                if clicked is not None:
                    handle.on_click(lambda event, geom=geom: self._clicked(event, geom, clicked))

    def draw_pads(self, pads: Sequence[tuple[FunctionalRepresentation, tuple[int, int, int]]], shown: bool) -> None:
        """Points and outward normals of pads, each in its colour, in place of those that were drawn."""
        for handle in self._pads:
            handle.remove()
        self._pads = []
        size_m = 0.004 * min(self.radius_m, 0.25)
        for i, (pad, colour) in enumerate(pads):
            name, points = f"/link{int(pad.body[0])}/pad{i}", pad.points_link
            lines = np.stack([points, points + 10 * size_m * pad.normals_link], axis=1)
            dots = self._scene.add_point_cloud(
                f"{name}dots", points, colour, point_size=2.6 * size_m, point_shape="circle", precision="float32"
            )
            self._pads += [dots, self._scene.add_line_segments(f"{name}lines", lines, colour, thickness=0.6 * size_m)]
        self.show_pads(shown)

    def show_pads(self, shown: bool) -> None:
        """Whether pads are seen."""
        for handle in self._pads:
            handle.visible = shown

    def _add_geom(self, kind: str, geom: int, rgb: tuple[int, int, int], opacity: float, visible: bool) -> Handle:
        mesh = self._meshes.get(geom)
        if mesh is None:
            mesh = self._meshes[geom] = geom_mesh(self._embodiment.model, geom)
        body = int(self._embodiment.model.geom_bodyid[geom])
        drawn = mesh
        if len(mesh.faces) <= _SMOOTH_FACES:
            drawn = trimesh.graph.smooth_shade(mesh, angle=_SHARP_RAD)  # vertices are apart where an edge is sharp
        return self._scene.add_mesh_simple(
            f"/link{body}/{kind}{geom}",
            np.asarray(drawn.vertices) + (0.0 if visible else _LIFTED_M) * np.asarray(drawn.vertex_normals),
            np.asarray(drawn.faces),
            color=rgb,
            opacity=None if opacity >= 1 else opacity,
            side="double",
            visible=visible,
            cast_shadow=visible,
            receive_shadow=False,
        )

    def _bounds(self) -> tuple[Array, float]:
        """Middle (3,) and radius of the sphere around what is seen, m; of the links' origins, where nothing is."""
        body, T = self._embodiment.model.geom_bodyid, self._T_base_links
        parts = [trimesh.transform_points(self._meshes[geom].vertices, T[body[geom]]) for geom in self.visual]
        points = np.concatenate(parts or [T[:, :3, 3]])
        middle = (points.min(axis=0) + points.max(axis=0)) / 2
        self._floor_m = float(points[:, 2].min())
        return middle, max(float(np.linalg.norm(points - middle, axis=1).max()), 0.01)

    def _add_frames(self) -> None:
        embodiment, base = self._embodiment, "base"
        arm, hand = embodiment.arm, embodiment.end_effector
        large = 0.16 * self.radius_m
        if arm is None:
            base = "base: the flange (z out)"
        self.frames[base] = [self._add_frame("/link0/base", base, large)]
        if arm is not None:
            name = "flange (z out)"
            T = np.eye(4)
            if arm.mount_pos_m:
                T[:3, 3] = arm.mount_pos_m
            if arm.mount_quat_wxyz:
                T[:3, :3] = Rotation.from_quat(arm.mount_quat_wxyz, scalar_first=True).as_matrix()
            link = embodiment.body_names.index(arm.mount_body)
            self.frames[name] = [self._add_frame(f"/link{link}/flange", name, large, T)]
        if hand is not None:
            root = embodiment.end_effector_root
            name = f"mount: {embodiment.link_names[root]}"
            self.frames[name] = [self._add_frame(f"/link{root}/mount", name, 0.8 * large, below=True)]
        small = max(0.25 * large, 0.012)
        self.frames["links"] = [
            self._add_frame(f"/link{i}/frame", embodiment.link_names[i], small)
            for i in range(1, embodiment.model.nbody)
        ]

    def _add_frame(self, node: str, name: str, length_m: float, T: Array | None = None, below: bool = False) -> Handle:
        T = np.eye(4) if T is None else T
        frame = self._scene.add_frame(
            node,
            axes_length=length_m,
            axes_radius=0.03 * length_m,
            wxyz=_wxyz(T[:3, :3]),
            position=T[:3, 3],
            visible=False,
        )
        anchor = "top-left" if below else "bottom-left"
        label = self._scene.add_label(f"{node}/name", name, font_screen_scale=0.8, anchor=anchor)
        self._names.append(label)
        return frame

    def _frame(self, server: viser.ViserServer) -> None:
        """Have the camera see all of the robot, before a light background."""
        distance_m = 1.1 * self.radius_m / np.sin(_FOV_RAD / 2)
        camera = server.initial_camera
        camera.fov, camera.up = _FOV_RAD, (0.0, 0.0, 1.0)
        camera.near, camera.far = 0.01 * distance_m, 100 * distance_m
        camera.look_at, camera.position = self.centre_m, self.centre_m + distance_m * _FROM
        cell_m = 0.1 if self.radius_m > 0.3 else 0.02
        self._scene.add_grid(
            "/floor",
            width=20 * cell_m,
            height=20 * cell_m,
            cell_size=cell_m,
            section_size=5 * cell_m,
            cell_color=(225, 228, 232),
            section_color=(200, 205, 212),
            position=(0.0, 0.0, self._floor_m),
        )

    def _clicked(self, event: viser.SceneNodePointerEvent[Any], geom: int, clicked: Callable[[Click], None]) -> None:
        body = int(self._embodiment.model.geom_bodyid[geom])
        R, p = self._T_base_links[body, :3, :3], self._T_base_links[body, :3, 3]
        origin, direction = (np.array(event.ray_origin) - p) @ R, np.array(event.ray_direction) @ R
        triangles = np.asarray(self._meshes[geom].triangles)
        if (hit := first_hit(triangles, origin, direction)) is not None:
            clicked(Click(body, geom, outward_normal(triangles[hit[0]], direction)))


def _wxyz(R: Array) -> Array:
    return Rotation.from_matrix(R).as_quat(scalar_first=True)
