"""Gymnasium environments over robosuite: `CEI-<Task>-<Arm>-<EndEffector>` for every task and catalogued embodiment.

Importing this package, or registering its environments, imports neither robosuite nor LeRobot.
"""

from cei_envs.registration import environment_id, environment_ids, register

__all__ = ["environment_id", "environment_ids", "register"]
