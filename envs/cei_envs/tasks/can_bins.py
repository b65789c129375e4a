"""The robosuite environment of PickPlaceCan, with nothing but the can in its bins."""

from robosuite.environments.manipulation.pick_place import PickPlace
from robosuite.models.objects import CanObject


class CanBins(PickPlace):
    """robosuite's PickPlace without what it puts out of sight, and without pictures of objects where they belong."""

    def _construct_visual_objects(self) -> None:
        self.visual_objects = []

    def _construct_objects(self) -> None:
        self.objects = [CanObject(name="Can")]
