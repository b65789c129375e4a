"""A demonstration: one recorded episode of one embodiment, in SI units and a named scene."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from cei_gym.displacement import Displacement
from cei_gym.errors import CEIError


@dataclass(frozen=True)
class Camera:
    """A calibrated pinhole camera.

    Attributes:
        name: the name under which depth images are stored.
        width, height: image size in pixels.
        K: (3, 3) intrinsics in pixels.
        T_world_camera: (4, 4) pose of the camera in the world; OpenCV axes (x right, y down, z forward).
    """

    name: str
    width: int
    height: int
    K: np.ndarray
    T_world_camera: np.ndarray


@dataclass(frozen=True)
class Scene:
    """What stands still during an episode.

    Attributes:
        T_world_base: (4, 4) pose of the robot's base in the world frame.
        cameras: the depth cameras.
        workspace_world: (2, 3) lower and upper corner of the box that clouds are cropped to, metres, world.
        table_z_m: height of the surface that objects stand on, world; None where it is the workspace's floor.
    """

    T_world_base: np.ndarray
    cameras: tuple[Camera, ...]
    workspace_world: np.ndarray
    table_z_m: float | None = None

    @property
    def support_z_m(self) -> float:
        """Height of the surface that objects stand on, world."""
        return float(self.workspace_world[0, 2]) if self.table_z_m is None else self.table_z_m


@dataclass(frozen=True)
class Demonstration:
    """One episode of T frames.

    Attributes:
        embodiment: catalogue name, `<Arm>-<EndEffector>`.
        fps: frames a second.
        qpos: (T, n) joint positions, arm then end-effector, rad (hinge) or m (slide).
        action: (T, n) absolute joint position targets in the same layout.
        scene: base pose, cameras, workspace.
        task: instruction in words.
        depth_m: camera name to (T, H, W) float32 depth along the optical axis in metres, 0 where unknown.
        rgb: camera name to (T, H, W, 3) uint8 pictures that belong to the depth, pixel for pixel.
        point_cloud_world: (T, P, 3) float32 cloud in metres, or (T, P, 6) with colours in [0, 1], or None.
        environment_state: (T, k) float64 state of the task's objects, or None.
        environment_state_names: k names, with units.
        index: the episode's index in the dataset that it came from.
        figures: how well it could be read, where that is in question, such as `ik_position_mm`.
        source_frames: (T,) which frames of that episode these are, where they are not all of it in turn; else None.
        displacement: how what it shows is moved, if it is; state of the objects is already where it should be, joints, images and
            cloud are as recorded.
    """

    embodiment: str
    fps: float
    qpos: np.ndarray
    action: np.ndarray
    scene: Scene
    task: str = ""
    depth_m: Mapping[str, np.ndarray] = field(default_factory=dict)
    rgb: Mapping[str, np.ndarray] = field(default_factory=dict)
    point_cloud_world: np.ndarray | None = None
    environment_state: np.ndarray | None = None
    environment_state_names: tuple[str, ...] = ()
    index: int = 0
    figures: Mapping[str, float] = field(default_factory=dict)
    source_frames: np.ndarray | None = None
    displacement: Displacement | None = None

    def __post_init__(self) -> None:
        where = f"episode {self.index}"
        if len(self.qpos) == 0:
            raise CEIError(f"{where} has no frames; drop it with --episodes or record it again.")
        if self.qpos.shape != self.action.shape:
            raise CEIError(f"{where}: state {self.qpos.shape} and action {self.action.shape} differ in shape.")
        state = self.environment_state
        if state is not None and not np.isfinite(state).all():
            raise CEIError(
                f"{where}: environment_state is not finite at frame {np.argwhere(~np.isfinite(state))[0][0]}."
            )
        for name, values in (("state", self.qpos), ("action", self.action)):
            bad = np.argwhere(~np.isfinite(values))
            if len(bad):
                frame, joint = bad[0]
                raise CEIError(f"{where}: {name} is not finite at frame {frame}, joint {joint}.")

    def __len__(self) -> int:
        return len(self.qpos)

    def at(self, frames: np.ndarray) -> "Demonstration":
        """The demonstration with its frames at these indices, in this order."""
        if np.array_equal(frames, np.arange(len(self))):
            return self

        def taken(value: np.ndarray | None) -> np.ndarray | None:
            return None if value is None else value[frames]

        return replace(
            self,
            qpos=self.qpos[frames],
            action=self.action[frames],
            depth_m={name: images[frames] for name, images in self.depth_m.items()},
            rgb={name: images[frames] for name, images in self.rgb.items()},
            point_cloud_world=taken(self.point_cloud_world),
            environment_state=taken(self.environment_state),
            source_frames=frames if self.source_frames is None else self.source_frames[frames],
            displacement=None if self.displacement is None else self.displacement.at(frames),
        )
