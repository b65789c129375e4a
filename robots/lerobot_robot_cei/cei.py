"""`CEIRobot`: a lab's robot behind the names, order, unit and limits that a policy was trained with."""

import logging
from collections import Counter, deque
from functools import cached_property
from time import monotonic, sleep
from typing import Any

import draccus
import numpy as np
from draccus.utils import DraccusException
from lerobot.robots import Robot, RobotConfig, make_robot_from_config

from cei_converters.sources.joint_map import load_joint_map
from cei_gym.arrays import Array
from cei_gym.errors import CEIError, one_line
from lerobot_robot_cei.config_cei import CEIRobotConfig
from lerobot_robot_cei.joints import RobotJoints
from lerobot_robot_cei.trained_on import TrainedOn, find

_ACTIONS_TIMED = 20
_RATES_DIFFER = 0.2
_THERE = 0.02
_AT_REST = 0.05
_LOOK_S = 0.01
_LATENCIES = 10_000


class CEIRobot(Robot):
    """See `CEIRobotConfig`. Joints are compared by name before anything moves; what the robot's hardware couples is told to its leader alone.

    Raises:
        CEIError: joints do not fit, or what the policy was trained on cannot be read.
    """

    config_class = CEIRobotConfig
    """LeRobot's: the options of this robot."""
    name = "cei"
    """LeRobot's: what `--robot.type` calls it."""

    def __init__(self, config: CEIRobotConfig) -> None:
        super().__init__(config)
        self.config = config
        if not 0 <= config.wait_s < float("inf") or not 0 < config.start_tolerance < float("inf"):
            raise CEIError(
                f"--robot.wait_s={config.wait_s:g} and --robot.start_tolerance={config.start_tolerance:g} should be finite, the former 0 or more, "
                "the latter more."
            )
        self._known = TrainedOn.load(find(config.trained_on))
        embodiment = self._known.embodiment()
        self._robot = make_robot_from_config(_own(config.robot))
        observed, commanded = (
            [name for name, kind in features.items() if kind is float]
            for features in (self._robot.observation_features, self._robot.action_features)
        )
        joint_map = None if config.joint_map is None else load_joint_map(config.joint_map)
        self._joints = RobotJoints(embodiment, observed, commanded, joint_map, config.unit)
        self._names = [f"{name}.pos" for name in embodiment.joint_names]
        self._began, self._told = 0.0, 0
        self._seen_at: float | None = None
        self._beyond = Counter[str]()
        self._latencies: deque[float] = deque(maxlen=_LATENCIES)

    @property
    def cameras(self) -> dict[str, Any]:
        """The lab's robot's."""
        return getattr(self._robot, "cameras", {})

    @cached_property
    def observation_features(self) -> dict[str, Any]:
        """`<joint>.pos` of each joint, in the policy's order, and the robot's own pictures."""
        pictures = {k: kind for k, kind in self._robot.observation_features.items() if isinstance(kind, tuple)}
        return {**dict.fromkeys(self._names, float), **pictures}

    @cached_property
    def action_features(self) -> dict[str, Any]:
        """`<joint>.pos` of each joint, in the policy's order."""
        return dict.fromkeys(self._names, float)

    @property
    def is_connected(self) -> bool:
        """Whether the lab's robot is."""
        return self._robot.is_connected

    def connect(self, calibrate: bool = True) -> None:
        """Connect the lab's robot, and say if the demonstrations waited for their joints, as it will not."""
        if not self.config.wait_s and (said := self._known.waiting()):
            logging.warning("%s", said)
        self._robot.connect(calibrate)

    @property
    def is_calibrated(self) -> bool:
        """Whether the lab's robot is."""
        return self._robot.is_calibrated

    def calibrate(self) -> None:
        """Calibrate the lab's robot."""
        self._robot.calibrate()

    def configure(self) -> None:
        """Configure the lab's robot."""
        self._robot.configure()

    def disconnect(self) -> None:
        """Disconnect the lab's robot, and say how long it took from observations to actions."""
        if self._latencies:
            middle, late = np.quantile(self._latencies, (0.5, 0.99)) * 1000
            logging.info(
                "From observation to action: %.0f ms, 99 %% within %.0f ms (%d actions).",
                middle,
                late,
                len(self._latencies),
            )
            self._latencies.clear()
        if self._beyond:
            times = ", ".join(f"{name} {count}" for name, count in self._beyond.most_common())
            logging.warning("Told at their limits, as targets were beyond, of %d actions: %s.", self._told, times)
            self._beyond.clear()
        self._robot.disconnect()

    def get_observation(self) -> dict[str, Any]:
        """Joint positions by name, rad or m, and the robot's own pictures.

        Raises:
            CEIError: a joint is missing or not finite.
        """
        seen = self._robot.get_observation()
        pictures = {key: value for key, value in seen.items() if isinstance(self.observation_features.get(key), tuple)}
        observed = {**dict(zip(self._names, self._joints.qpos(seen).tolist(), strict=True)), **pictures}
        self._seen_at = monotonic()
        return observed

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Tell the robot joint targets, rad or m, those beyond limits at the limit; what was sent, in the same terms.

        Raises:
            CEIError: a target is missing or not finite; or, before the first one, the robot stands where no demonstration starts.
        """
        if self._seen_at is not None:
            self._latencies.append(monotonic() - self._seen_at)
            self._seen_at = None
        missing = [name for name in self._names if name not in action]
        if missing:
            raise CEIError(f"the action lacks {', '.join(missing)}.")
        wanted = np.array([float(action[name]) for name in self._names])
        if not np.isfinite(wanted).all():
            raise CEIError(f"the action has no finite number for {self._names[int((~np.isfinite(wanted)).argmax())]}.")
        if not self._told:
            stands = self._joints.qpos(self._robot.get_observation())
            complaint = self._known.complaint(stands, self._joints.embodiment, self.config.start_tolerance)
            if complaint:
                raise CEIError(complaint)
        self._time()
        self._say_beyond(wanted)
        sent = self._joints.qpos(self._robot.send_action(self._joints.command(wanted)))
        self._wait(sent)
        return dict(zip(self._names, sent.tolist(), strict=True))

    def _wait(self, target: Array) -> None:
        """Until each joint is there (20 mrad, or 20 mm) or at rest (50 a second), at most `wait_s`."""
        until = monotonic() + self.config.wait_s
        last, when = None, monotonic()
        while monotonic() < until:
            sleep(_LOOK_S)
            qpos, now = self._joints.qpos(self._robot.get_observation()), monotonic()
            there = np.abs(qpos - target) < _THERE
            if last is not None:
                there |= np.abs(qpos - last) < _AT_REST * (now - when)
            if there.all():
                return
            last, when = qpos, now

    def _say_beyond(self, wanted: Array) -> None:
        """Say of each joint, the first time, that its target is beyond its limit."""
        for name, over in self._joints.beyond(wanted).items():
            if not self._beyond[name]:
                logging.warning("The target of %s is %.3f beyond its limit, and is told at the limit.", name, abs(over))
            self._beyond[name] += 1

    def _time(self) -> None:
        """Say once at which rate actions come, if it is not that of the demonstrations."""
        self._told += 1
        if self._told == 1:
            self._began = monotonic()
        if self._told == _ACTIONS_TIMED:
            rate = (_ACTIONS_TIMED - 1) / max(monotonic() - self._began, 1e-9)
            fps, step_time = self._known.fps, self._known.metadata.step_time_s
            waiting = fps if step_time is None or not self.config.wait_s else 1 / step_time.mean
            if not (1 - _RATES_DIFFER) * waiting <= rate <= (1 + _RATES_DIFFER) * fps:
                logging.warning("Actions come at %.1f a second; the demonstrations have %g (--fps=%g).", rate, fps, fps)


def _own(raw: dict[str, Any]) -> RobotConfig:
    known = sorted(set(RobotConfig.get_known_choices()) - {CEIRobot.name})
    if raw.get("type") not in known:
        raise CEIError(
            f"--robot.robot={one_line(raw, 100)} should be JSON with the lab's robot's type. Valid: {', '.join(known)}."
        )
    try:
        return draccus.decode(RobotConfig, raw)
    except (DraccusException, TypeError, ValueError) as error:
        raise CEIError(f"--robot.robot: {one_line(error)}.") from error
