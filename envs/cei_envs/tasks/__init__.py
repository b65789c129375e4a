"""The tasks, each an environment over robosuite."""

from cei_gym import extras

extras.require(__name__, "robosuite")
