"""The step before a policy that looks at pictures, and was trained on painted ones: the robot is painted over itself."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from lerobot.configs import PipelineFeatureType, PolicyFeature
from lerobot.processor import ObservationProcessorStep, ProcessorStepRegistry, RobotObservation
from lerobot.utils.constants import OBS_IMAGES

from cei_gym.arrays import Array
from cei_gym.demonstration import Camera
from cei_gym.errors import CEIError, unknown
from lerobot_robot_cei.images import depth_m_of, has_depth, joints_of, picture_of
from lerobot_robot_cei.trained_on import PICTURES_STEP, TrainedOn

if TYPE_CHECKING:
    from cei_gym.painting import LivePainter


@dataclass
@ProcessorStepRegistry.register(PICTURES_STEP)
class RobotPictures(ObservationProcessorStep):
    """In a camera's pictures the robot looks as `cei-convert --cameras.paint` has drawn it in the data behind the policy, whatever a real one looks like.

    Painted as they come (`cei_gym.painting.LivePainter`), one episode after the other between resets. With depth beside them
    (`observation.images.<camera>_depth`), what is in front of the robot stays there. Before the first picture after a reset, the robot must
    stand near the start of a demonstration.

    Attributes:
        trained_on: a `TrainedOn`, encoded.
        cameras: names of those whose pictures, `observation.images.<camera>`, are painted.
        start_tolerance: how far a joint may stand from a start, rad; one that slides, a tenth of it, m.
    """

    trained_on: dict[str, Any]
    cameras: list[str]
    start_tolerance: float = 0.2
    _known: TrainedOn = field(init=False, repr=False, compare=False)
    _painters: "dict[tuple[int, str], LivePainter]" = field(default_factory=dict, init=False, repr=False, compare=False)
    _begun: bool = field(default=False, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        self._known = TrainedOn.decode(self.trained_on, PICTURES_STEP)
        calibrated = [camera.name for camera in self._known.metadata.scene.cameras]
        if not self.cameras:
            raise CEIError(f"{PICTURES_STEP}: cameras should be some of {', '.join(calibrated) or 'none'}.")
        for name in self.cameras:
            if name not in calibrated:
                raise unknown(f"camera of {PICTURES_STEP}", name, calibrated)

    def observation(self, observation: RobotObservation) -> RobotObservation:
        """The same with painted pictures.

        Args:
            observation: joint positions (B, n), rad or m, in the policy's order, and of each camera a picture (B, 3, H, W) in [0, 1].

        Raises:
            CEIError: a picture is missing or of another size, joints are not the policy's, or the robot stands where no demonstration starts.
        """
        states = joints_of(observation, self._known)
        self._begin(states)
        painted: dict[str, Any] = {}
        for camera in self._known.metadata.scene.cameras:
            if camera.name not in self.cameras:
                continue
            pictures = picture_of(camera, observation)
            depth_m = depth_m_of(camera, observation) if has_depth(camera, observation) else [None] * len(states)
            rows = zip(pictures, states, depth_m, strict=True)
            shown = np.stack([self._paint(i, camera, *row) for i, row in enumerate(rows)])
            given = observation[f"{OBS_IMAGES}.{camera.name}"]
            painted[f"{OBS_IMAGES}.{camera.name}"] = torch.from_numpy(shown).permute(0, 3, 1, 2).to(given) / 255
        return {**observation, **painted}

    def reset(self) -> None:
        """A new episode."""
        self._begun = False
        for painter in self._painters.values():
            painter.reset()

    def get_config(self) -> dict[str, Any]:
        """What a checkpoint has of it."""
        return {"trained_on": self.trained_on, "cameras": self.cameras, "start_tolerance": self.start_tolerance}

    def transform_features(
        self, features: dict[PipelineFeatureType, dict[str, PolicyFeature]]
    ) -> dict[PipelineFeatureType, dict[str, PolicyFeature]]:
        """As they are."""
        return features

    def _begin(self, states: Array) -> None:
        if self._begun:
            return
        embodiment = self._known.embodiment()
        for qpos in states:
            if complaint := self._known.complaint(qpos, embodiment, self.start_tolerance):
                raise CEIError(complaint)
        self._begun = True

    def _paint(self, index: int, camera: Camera, picture: Array, qpos: Array, depth_m: Array | None) -> Array:
        from cei_gym.painting import LivePainter  # OpenCV, which LeRobot's start should not wait for

        if (index, camera.name) not in self._painters:
            robot, scene = self._known.embodiment(), self._known.metadata.scene
            base = scene.T_world_base
            self._painters[index, camera.name] = LivePainter(
                robot, robot, base, base, camera, scene.support_z_m, dt_s=1 / self._known.fps
            )
        return self._painters[index, camera.name](picture, qpos, qpos, depth_m)
