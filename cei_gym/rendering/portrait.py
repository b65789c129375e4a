"""A picture of an embodiment alone, without a scene."""

from cei_gym.arrays import Array
from cei_gym.demonstration import Camera
from cei_gym.embodiment import Embodiment
from cei_gym.embodiment.colours import geom_colours
from cei_gym.embodiment.meshes import visual_geoms
from cei_gym.rendering.camera import DepthCamera
from cei_gym.rendering.shading import shade


def lighter(rgba: Array) -> Array:
    """Colours in [0, 1] made lighter: black hands, as most are, would hide their own shape."""
    return 0.35 + 0.65 * rgba


class Portrait:
    """Draws an embodiment in its own colours, made lighter.

    Args:
        embodiment: whose visual geoms are drawn.
    """

    def __init__(self, embodiment: Embodiment) -> None:
        self._eye = DepthCamera(embodiment.model, (), geoms=visual_geoms(embodiment.model))
        self._colours = lighter(geom_colours(embodiment.model))

    def __call__(self, T_world_links: Array, camera: Camera) -> tuple[Array, Array]:
        """One picture.

        Args:
            T_world_links: (L, 4, 4) link poses.
            camera: viewpoint, in the same frame.

        Returns:
            RGB (H, W, 3) uint8, and depth (H, W) along the optical axis in metres, 0 where nothing is.
        """
        self._eye.cameras = (camera,)
        depth_m, geom_id = self._eye.render_at(T_world_links)[camera.name]
        return shade(depth_m, geom_id, camera, self._colours), depth_m
