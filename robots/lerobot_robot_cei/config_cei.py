"""Options of `--robot.type=cei`."""

from dataclasses import dataclass
from typing import Any

from lerobot.robots import RobotConfig


@RobotConfig.register_subclass("cei")
@dataclass(kw_only=True)
class CEIRobotConfig(RobotConfig):
    """Another LeRobot robot, as a policy knows it.

    Attributes:
        robot: the lab's own, with the options that LeRobot's scripts take, JSON such as {"type": "so101_follower", "port": "/dev/ttyACM0"}: draccus
            cannot have a choice of robots in itself.
        trained_on: the policy's checkpoint (`.../pretrained_model`, or its name on the hub), or the folder of the dataset that it was trained on.
        unit: of the robot's turning joints, `rad` or `deg`, where they are named `<joint>.pos` after the embodiment's; sliding ones are in m.
        joint_map: instead, a file that says what the robot's values mean, as `cei-convert --joint_map` takes it for its datasets.
        start_tolerance: how far a joint may stand from where a demonstration starts, before the first action, rad; one that slides, a tenth of it, m.
        wait_s: longest time to wait for the joints after each target, s, until they are there or at rest, as the recorded steps did (the paper's
            closed loop; `cei-deploy` says how long those waited); 0 for actions at LeRobot's fixed rate.
    """

    robot: dict[str, Any]
    trained_on: str
    unit: str | None = None
    joint_map: str | None = None
    start_tolerance: float = 0.2
    wait_s: float = 0.0
