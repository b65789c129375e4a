"""The robot that robosuite builds a task's scene around where it is then taken out: its Panda with balls for meshes, which take a second to compile."""

from robosuite.models.robots.manipulators.panda_robot import Panda
from robosuite.robots import register_robot_class


@register_robot_class("FixedBaseRobot")
class CEIStandIn(Panda):
    """It stands where a Panda stands and has the same links, joints and names of shapes."""

    def __init__(self, idn: int = 0) -> None:
        super().__init__(idn)
        for geom in self.worldbody.iter("geom"):
            if geom.attrib.pop("mesh", None):
                geom.set("type", "sphere")
                geom.set("size", "0.01")
        for mesh in self.asset.findall("mesh"):
            self.asset.remove(mesh)
