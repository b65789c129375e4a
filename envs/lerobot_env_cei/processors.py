"""Between the environments and policies: observations as their dataset has them."""

from dataclasses import dataclass

from lerobot.configs import PipelineFeatureType, PolicyFeature
from lerobot.processor import ObservationProcessorStep, ProcessorStepRegistry, RobotObservation
from lerobot.utils.constants import OBS_STR

POINT_CLOUD = f"{OBS_STR}.point_cloud"


@dataclass
@ProcessorStepRegistry.register("cei_flat_clouds")
class FlatClouds(ObservationProcessorStep):
    """Clouds (B, N, 3 or 6) become (B, N * 3 or 6), as datasets that LeRobot's tools can edit have them."""

    def observation(self, observation: RobotObservation) -> RobotObservation:
        """The same with a flat cloud, if it has one."""
        if POINT_CLOUD in observation:
            observation[POINT_CLOUD] = observation[POINT_CLOUD].flatten(1)
        return observation

    def transform_features(
        self, features: dict[PipelineFeatureType, dict[str, PolicyFeature]]
    ) -> dict[PipelineFeatureType, dict[str, PolicyFeature]]:
        """As they are: what policies are made for is their dataset's."""
        return features
