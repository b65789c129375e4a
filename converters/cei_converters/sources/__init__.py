"""What can be converted: formats that demonstrations come in, and what their columns mean."""

from cei_gym import extras

extras.require(__name__, "lerobot")
