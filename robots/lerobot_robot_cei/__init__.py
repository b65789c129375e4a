"""What a policy trained on converted data needs on a robot: its joints by name (`--robot.type=cei`), its clouds and pictures. LeRobot imports this by itself."""

from lerobot_robot_cei.cei import CEIRobot
from lerobot_robot_cei.clouds import RobotClouds
from lerobot_robot_cei.config_cei import CEIRobotConfig
from lerobot_robot_cei.pictures import RobotPictures
from lerobot_robot_cei.trained_on import TrainedOn

__all__ = ["CEIRobot", "CEIRobotConfig", "RobotClouds", "RobotPictures", "TrainedOn"]
