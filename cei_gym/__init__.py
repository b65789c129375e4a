"""CEI-Gym: move robot skills between bodies.

Importing it registers with Gymnasium the environments of every installed package that offers some (the entry point group
`cei_gym.environments`), so `import cei_gym; gym.make("CEI-PickCube-IIWA-Inspire")` works, and so does
`gym.make("cei_gym:CEI-PickCube-IIWA-Inspire")`. Neither torch, the simulator nor LeRobot is imported.
"""

from importlib.metadata import entry_points, version

__version__ = version("cei-gym")

for _entry_point in entry_points(group="cei_gym.environments"):
    _entry_point.load()()
