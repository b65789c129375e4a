"""CEI-Gym's environments as `--env.type=cei`. LeRobot imports this by itself."""

from cei_gym import extras

with extras.needed_by(__name__):
    from lerobot_env_cei.configuration import CEIEnvConfig

__all__ = ["CEIEnvConfig"]
