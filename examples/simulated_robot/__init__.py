"""A robot for `lerobot-rollout` that stands in a simulation: what a lab's own looks like, with joints in another order, in degrees, and a depth camera.

    PYTHONPATH=examples lerobot-rollout --robot.discover_packages_path=simulated_robot --robot.type=cei \\
        --robot.robot='{"type": "simulated", "env": "CEI-PickCube-IIWA-Inspire"}' --robot.unit=deg ...
"""

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from lerobot.robots import Robot, RobotConfig

import cei_gym  # noqa: F401 -- registers the environments
from cei_gym.embodiment import Embodiment, load_embodiment
from lerobot_robot_cei import TrainedOn


@RobotConfig.register_subclass("simulated")
@dataclass(kw_only=True)
class SimulatedRobotConfig(RobotConfig):
    """What is simulated.

    Attributes:
        env: `CEI-<Task>-<Arm>-<EndEffector>`.
        stands_at: checkpoint or dataset where whose demonstrations start it is put before it is connected; none for its home. A lab drives there.
        seed: of where objects lie.
        pictures: whether its camera gives pictures beside depth.
        lacks: a joint that its hardware does not have, to see what is said.
    """

    env: str
    stands_at: str | None = None
    seed: int = 0
    pictures: bool = False
    lacks: str | None = None


class SimulatedRobot(Robot):
    """Takes and gives the joints that follow no other, the last one first, in degrees (m for those that slide), and depth in mm."""

    config_class = SimulatedRobotConfig
    name = "simulated"

    def __init__(self, config: SimulatedRobotConfig) -> None:
        super().__init__(config)
        self.config = config
        self.embodiment: Embodiment = load_embodiment(config.env.removeprefix("CEI-").split("-", 1)[1])
        self._joints = [q for q in reversed(self.embodiment.coupled.independent) if self._name(q) != config.lacks]
        self._env: gym.Env[Any, Any] | None = None
        self._seen: dict[str, Any] = {}
        self.is_success = False

    def _name(self, q: int) -> str:
        return self.embodiment.joint_names[q]

    @cached_property
    def action_features(self) -> dict[str, Any]:
        return {f"{self._name(q)}.pos": float for q in self._joints}

    @cached_property
    def observation_features(self) -> dict[str, Any]:
        pictures = {"front": (120, 160, 3)} if self.config.pictures else {}
        return {**self.action_features, "front_depth": (120, 160, 1), **pictures}

    @property
    def is_connected(self) -> bool:
        return self._env is not None

    @property
    def is_calibrated(self) -> bool:
        return True

    def calibrate(self) -> None: ...

    def configure(self) -> None: ...

    def connect(self, calibrate: bool = True) -> None:
        self._env = gym.make(self.config.env, pixels=self.config.pictures)
        place = self.config.stands_at
        options = None if place is None else {"agent_pos": TrainedOn.load(Path(place)).starts[0].astype(np.float32)}
        self._seen, _ = self._env.reset(seed=self.config.seed, options=options)

    def disconnect(self) -> None:
        if self._env is not None:
            print(f"The task is {'done' if self.is_success else 'not done'}.", flush=True)
            self._env.close()
            self._env = None

    def get_observation(self) -> dict[str, Any]:
        assert self._env is not None
        depth_mm = np.rint(self._env.get_wrapper_attr("depth_m")()["front"] * 1000).astype(np.uint16)[..., None]
        values = [float(self._seen["agent_pos"][q]) * self._per_si(q) for q in self._joints]
        pictures = self._seen["pixels"] if self.config.pictures else {}
        return {**dict(zip(self.action_features, values, strict=True)), "front_depth": depth_mm, **pictures}

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        assert self._env is not None
        told = self._qpos([action[name] for name in self.action_features])
        self._seen, _, _, _, info = self._env.step(told.astype(np.float32))
        self.is_success |= bool(info["is_success"])
        return action

    def _qpos(self, values: list[float]) -> np.ndarray:
        """All joints, rad or m."""
        u = np.empty(len(self._joints))
        u[::-1] = [value / self._per_si(q) for value, q in zip(values, self._joints, strict=True)]
        return self.embodiment.coupled.expand(u)

    def _per_si(self, q: int) -> float:
        return 180 / math.pi if self.embodiment.joint_units[q] == "rad" else 1.0
