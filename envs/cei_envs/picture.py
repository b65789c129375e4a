"""RGB pictures of a simulation by our own rasteriser: the same on every machine, with a GL library or without."""

import mujoco

from cei_gym.arrays import Array
from cei_gym.rendering import DepthCamera, geom_colours, look_at, shade

WIDTH, HEIGHT = 320, 240


class Picture:
    """A fixed view of table and robot, 320 x 240.

    Args:
        model: the simulation's model.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._view = look_at("picture", (0.80, 0.70, 1.35), (-0.18, -0.02, 0.98), WIDTH, HEIGHT, 40.0)
        self._camera = DepthCamera(model, (self._view,))
        self._colours = geom_colours(model)

    def render(self, data: mujoco.MjData) -> Array:
        """(240, 320, 3) uint8."""
        depth, geom = self._camera.render(data)[self._view.name]
        return shade(depth, geom, self._view, self._colours)
