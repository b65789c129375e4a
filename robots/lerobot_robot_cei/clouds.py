"""The step before a policy that makes its clouds from a robot's depth (the paper's section IV-C), by the code that made its training data."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch
from lerobot.configs import PipelineFeatureType, PolicyFeature
from lerobot.processor import ObservationProcessorStep, ProcessorStepRegistry, RobotObservation
from lerobot.utils.constants import OBS_STATE

from cei_converters.dataset.schema import POINT_CLOUD
from cei_gym.arrays import Array
from cei_gym.demonstration import Scene
from cei_gym.embodiment import Embodiment
from cei_gym.errors import CEIError
from cei_gym.pointcloud import CloudSynthesiser, crop, frame_points
from lerobot_robot_cei.images import depth_m_of, joints_of, picture_of
from lerobot_robot_cei.trained_on import STEP, TrainedOn

_SUPPORT_M = 0.03  # the table's top lies this far below the workspace at most
_FEWEST = 20


@dataclass
@ProcessorStepRegistry.register(STEP)
class RobotClouds(ObservationProcessorStep):
    """Depth and joint positions become `observation.point_cloud`, as `cei-convert` and `CrossEmbodimentWrapper` make it, bit for bit.

    What has a cloud already (datasets, environments) passes. Before the first cloud after a reset, the robot must stand near the start of a
    demonstration, and the cameras must see the workspace.

    Attributes:
        trained_on: a `TrainedOn`, encoded.
        start_tolerance: how far a joint may stand from a start, rad; one that slides, a tenth of it, m.
    """

    trained_on: dict[str, Any]
    start_tolerance: float = 0.2
    _known: TrainedOn = field(init=False, repr=False, compare=False)
    _making: tuple[Embodiment, CloudSynthesiser] | None = field(default=None, init=False, repr=False, compare=False)
    _begun: bool = field(default=False, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        self._known = TrainedOn.decode(self.trained_on, STEP)

    @classmethod
    def of_dataset(cls, root: Path) -> "Self | None":
        """For policies that train on a dataset; None where it has no clouds or says nothing of a robot."""
        known = TrainedOn.of_dataset(root)
        return None if known is None or known.cloud_shape is None else cls(known.encode())

    def observation(self, observation: RobotObservation) -> RobotObservation:
        """The same with a cloud (B, N * 3 or 6), m.

        Args:
            observation: joint positions (B, n), rad or m, in the policy's order, and of each camera depth (B, 1, H, W) or (B, H, W, 1):
                whole numbers are mm, others m; with colours, also pictures (B, 3, H, W) in [0, 1].

        Raises:
            CEIError: a camera's depth is missing or of another size, joints are not the policy's, or nothing of the workspace is seen.
        """
        if POINT_CLOUD in observation:
            return observation
        scene = self._known.metadata.scene
        depth = {camera.name: depth_m_of(camera, observation) for camera in scene.cameras}
        rgb = {camera.name: picture_of(camera, observation) for camera in scene.cameras} if self._coloured else {}
        states = joints_of(observation, self._known)
        clouds = [
            self._cloud(scene, {k: v[i] for k, v in depth.items()}, {k: v[i] for k, v in rgb.items()}, state)
            for i, state in enumerate(states)
        ]
        device = observation[OBS_STATE].device
        return {**observation, POINT_CLOUD: torch.from_numpy(np.stack(clouds)).flatten(1).to(device)}

    def reset(self) -> None:
        """Look at where the robot stands again, before the next cloud."""
        self._begun = False

    def get_config(self) -> dict[str, Any]:
        """What a checkpoint has of it."""
        return {"trained_on": self.trained_on, "start_tolerance": self.start_tolerance}

    def transform_features(
        self, features: dict[PipelineFeatureType, dict[str, PolicyFeature]]
    ) -> dict[PipelineFeatureType, dict[str, PolicyFeature]]:
        """As they are: what policies are made for is their dataset's."""
        return features

    @property
    def _coloured(self) -> bool:
        shape = self._known.cloud_shape
        return shape is not None and shape[1] == 6

    def _cloud(self, scene: Scene, depth_m: dict[str, Array], rgb: dict[str, Array], qpos: Array) -> Array:
        """(N, 3 or 6) float32 of one observation."""
        if self._making is None:
            embodiment = self._known.embodiment()
            self._making = embodiment, CloudSynthesiser(embodiment, embodiment, self._known.clouds())
        embodiment, synthesiser = self._making
        points = frame_points(scene, depth_m, rgb, None, self._coloured)
        assert points is not None
        if not self._begun:
            complaint = self._known.complaint(qpos, embodiment, self.start_tolerance) or _blind(points, scene)
            if complaint:
                raise CEIError(complaint)
            self._begun = True
        if not synthesiser.options.swap:
            return synthesiser.keep(points, scene)
        return synthesiser.add(synthesiser.remove(points, scene, qpos), scene, qpos)


def _blind(points: Array, scene: Scene) -> str | None:
    """Why cameras cannot be where they are said to be: they see neither the workspace nor what it stands on."""
    box = scene.workspace_world.copy()
    box[0, 2] -= _SUPPORT_M
    seen = int(np.count_nonzero(crop(points, box)))
    if seen >= _FEWEST:
        return None
    middle = np.median(points[:, :3], axis=0).round(2).tolist() if len(points) else "nowhere"
    return (
        f"the cameras see {seen} points in the workspace {scene.workspace_world.round(2).tolist()} m and on what it stands on, and most about "
        f"{middle}: their calibration is that of the recorded scene; give the real one (cei-deploy --calibration=FILE.yaml)."
    )
