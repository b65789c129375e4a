"""Gymnasium environments over robosuite: `CEI-<Task>-<Arm>-<EndEffector>` for every task and catalogued embodiment.

Importing this package, or registering its environments, imports neither robosuite nor LeRobot.
"""

import logging

from cei_envs.registration import environment_id, environment_ids, register

__all__ = ["environment_id", "environment_ids", "register"]

# robosuite reports optional packages that nothing here uses, at every import.
logging.getLogger("robosuite_logs").addFilter(lambda record: record.levelno >= logging.ERROR)
