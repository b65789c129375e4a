"""CEI-Gym's environments as `--env.type=cei`. LeRobot imports this by itself."""

from lerobot_env_cei.configuration import CEIEnvConfig

__all__ = ["CEIEnvConfig"]
