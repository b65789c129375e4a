"""A demonstration: one recorded episode of one embodiment, in SI units and a named scene."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from cei_gym.arrays import Array
from cei_gym.channels import OnDisplacement, OnTransfer, channel, channels, check_channels, present
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
        lag_s: by so much its pictures trail the joints recorded with them, s. Known of cameras whose pictures are painted; depth is taken as it is.
    """

    name: str
    width: int
    height: int
    K: Array
    T_world_camera: Array
    lag_s: float = 0.0


@dataclass(frozen=True)
class Scene:
    """What stands still during an episode.

    Attributes:
        T_world_base: (4, 4) pose of the robot's base in the world frame.
        cameras: the depth cameras.
        workspace_world: (2, 3) lower and upper corner of the box that clouds are cropped to, metres, world.
        table_z_m: height of the surface that objects stand on, world; None where it is the workspace's floor.
    """

    T_world_base: Array
    cameras: tuple[Camera, ...]
    workspace_world: Array
    table_z_m: float | None = None

    @property
    def support_z_m(self) -> float:
        """Height of the surface that objects stand on, world."""
        return float(self.workspace_world[0, 2]) if self.table_z_m is None else self.table_z_m


KEEP, DROP, RECOMPUTE = OnTransfer.KEEP, OnTransfer.DROP, OnTransfer.RECOMPUTE
AS_RECORDED, MOVE = OnDisplacement.AS_RECORDED, OnDisplacement.MOVE
WRENCH = ("force_x_N", "force_y_N", "force_z_N", "torque_x_Nm", "torque_y_Nm", "torque_z_Nm")


@dataclass(frozen=True)
class Demonstration:
    """One episode of T frames: its channels (`cei_gym.channels`), and what holds for all of it.

    Attributes:
        embodiment: catalogue name, `<Arm>-<EndEffector>`.
        fps: frames a second.
        qpos: (T, n) joint positions, arm then end-effector, rad (hinge) or m (slide).
        action: (T, n) absolute joint position targets in the same layout.
        scene: base pose, cameras, workspace.
        task: instruction in words.
        point_cloud_world: (T, P, 3) float32 cloud in metres, or (T, P, 6) with colours in [0, 1], or None.
        depth_m: camera name to (T, H, W) float32 depth along the optical axis in metres, 0 where unknown.
        rgb: camera name to (T, H, W, 3) uint8 pictures that belong to the depth, pixel for pixel.
        environment_state: (T, k) float64 state of the task's objects, or None.
        environment_state_names: k names, with units; none where nobody knows them.
        wrench: (T, 6) force, N, and torque, N m, that the wrist's sensor feels, in the sensor's frame, or None.
        index: the episode's index in the dataset that it came from.
        figures: how well it could be read, where that is in question, such as `ik_position_mm`.
        source_frames: (T,) which frames of that episode these are, where they are not all of it in turn; else None.
        displacement: how what it shows is moved, if it is; state of the objects is already where it should be, joints, images and
            cloud are as recorded.

    Raises:
        CEIError: there are no frames, or a channel is not as declared: of another shape or kind, or not finite.
    """

    embodiment: str
    fps: float
    qpos: Array = field(metadata=channel(("joints",), "rad or m", RECOMPUTE, AS_RECORDED, finite=True))
    action: Array = field(metadata=channel(("joints",), "rad or m", RECOMPUTE, AS_RECORDED, finite=True))
    scene: Scene
    task: str = ""
    point_cloud_world: Array | None = field(
        default=None, metadata=channel(("points", "columns"), "m", RECOMPUTE, AS_RECORDED, frame="world")
    )
    depth_m: Mapping[str, Array] = field(
        default_factory=dict[str, Array],
        metadata=channel(("height", "width"), "m", RECOMPUTE, AS_RECORDED, frame="camera", by_camera=True),
    )
    rgb: Mapping[str, Array] = field(
        default_factory=dict[str, Array],
        metadata=channel(
            ("height", "width", 3), "1/255", RECOMPUTE, AS_RECORDED, "uint8", frame="camera", by_camera=True
        ),
    )
    environment_state: Array | None = field(
        default=None, metadata=channel(("entries",), "as names say", KEEP, MOVE, frame="world", finite=True)
    )
    environment_state_names: tuple[str, ...] = ()
    wrench: Array | None = field(
        default=None,
        metadata=channel((6,), "N, N m", DROP, AS_RECORDED, frame="wrist sensor", names=WRENCH, finite=True),
    )
    index: int = 0
    figures: Mapping[str, float] = field(default_factory=dict[str, float])
    source_frames: Array | None = None
    displacement: Displacement | None = None

    def __post_init__(self) -> None:
        where = f"episode {self.index}"
        if len(self.qpos) == 0:
            raise CEIError(f"{where} has no frames; drop it with --episodes or record it again.")
        check_channels(self, len(self), where)

    def __len__(self) -> int:
        return len(self.qpos)

    def at(self, frames: Array) -> "Demonstration":
        """The demonstration with its frames at these indices, in this order."""
        if np.array_equal(frames, np.arange(len(self))):
            return self
        taken = {name: declared.map(value, lambda array: array[frames]) for name, declared, value in present(self)}
        return replace(
            self,
            **taken,
            source_frames=frames if self.source_frames is None else self.source_frames[frames],
            displacement=None if self.displacement is None else self.displacement.at(frames),
        )

    def of_the_world(self) -> dict[str, Any]:
        """The channels as a demonstration of another embodiment has them before it gets its own: kept, or nothing."""
        return {
            name: getattr(self, name) if declared.on_transfer is OnTransfer.KEEP else declared.nothing
            for name, declared in channels(Demonstration).items()
        }
