"""Pick: lift some thing off the table and hold it."""

from abc import ABC
from typing import Any, ClassVar

import numpy as np

from cei_envs.tasks.cube import TABLE_Z_M
from cei_envs.tasks.lifted import LiftedEnv
from cei_envs.tasks.objects import names_of
from cei_envs.tasks.placed import Placed
from cei_envs.tasks.thing import Thing
from cei_gym.arrays import Array

FRONT_X_M, PLACEMENT_M, YAW_RAD = -0.02, 0.08, np.radians(25)
ROBOSUITE = "package://robosuite/models/assets/objects/"


class PickEnv(LiftedEnv, ABC):
    """Lift some thing off the table by 5 cm and hold it; the family `CEI-Pick-<Thing>-<Arm>-<EndEffector>`.

    A subclass says which `thing`, and is a task of its own, `Pick-<Thing>`. It lies near the middle of robosuite's table.

    ### Action space
    `Box(n,)`, float32: absolute joint position targets, as in `PickCubeEnv`.

    ### Observation space
    `Dict` with `agent_pos` (n,) and `point_cloud` (1024, 3) as in `PickCubeEnv`, and

    | index of `environment_state` (7,) | meaning | unit | at a start |
    |---|---|---|---|
    | 0, 1, 2 | origin of the thing, world | m | x in [-0.10, 0.06], y in [-0.08, 0.08]; z on the table |
    | 3, 4, 5, 6 | its orientation, unit quaternion w, x, y, z | - | yaw within 25 degrees |

    ### Reward, success and end
    Reward is 1 on success, else 0. Success (`info["is_success"]`, which also terminates): for 20 control periods (1 s) in a row, the thing
    is at least 5 cm above its start. `info["failure"]` says why not yet: never grasped, slipped, too low. Truncated after 400 steps.

    ### Start
    `reset(seed=...)` draws the thing's place and joints (home, or `start_qpos`, plus 0.02 rad of noise);
    `options={"environment_state": ..., "agent_pos": ...}` restores a recorded start exactly.

    ### Arguments
    See `CEIEnv`: `embodiment`, `max_hold_ticks`, `image_width`, `image_height`, `clouds`, `cameras`, `depth_noise`, `colours`,
    `start_qpos`, `sensors`, `render_mode`, `pixels`.
    """

    thing: ClassVar[Thing]
    """What is picked up."""

    def __init_subclass__(cls, **arguments: Any) -> None:
        super().__init_subclass__(**arguments)
        cls.lifted = cls.thing.placed
        cls.objects = (cls.lifted,)
        cls.state_names = names_of(cls.lifted)
        cls.expert_arguments = {"thing": cls.thing}

    def sample_state(self, rng: np.random.Generator) -> Array:
        x, y = rng.uniform(-PLACEMENT_M, PLACEMENT_M, 2) + [FRONT_X_M, 0.0]
        return self.thing.at(x, y, rng.uniform(-YAW_RAD, YAW_RAD), TABLE_Z_M)


class PickSphereEnv(PickEnv):
    """`PickEnv` of a ball of hard rubber, 44 mm and 45 g."""

    task: ClassVar[str] = "Pick-Sphere"
    task_text: ClassVar[str] = "Pick up the ball."
    thing: ClassVar[Thing] = Thing(Placed("sphere"), height_m=0.022, width_m=0.044)


class PickCylinderEnv(PickEnv):
    """`PickEnv` of a round of beech, 60 mm wide, 120 mm long and 230 g, which stands."""

    task: ClassVar[str] = "Pick-Cylinder"
    task_text: ClassVar[str] = "Pick up the wooden cylinder."
    thing: ClassVar[Thing] = Thing(Placed("cylinder"), height_m=0.060, width_m=0.060, grasp_m=(0, 0, 0.025))


class PickLyingCylinderEnv(PickEnv):
    """`PickEnv` of the same round of beech, which lies, and can roll."""

    task: ClassVar[str] = "Pick-LyingCylinder"
    task_text: ClassVar[str] = "Pick up the lying cylinder."
    thing: ClassVar[Thing] = Thing(Placed("cylinder"), height_m=0.030, width_m=0.060, lying_rad=(0.0, np.pi / 2, 0.0))


class PickThinBoxEnv(PickEnv):
    """`PickEnv` of a box of cards, 20 x 80 x 40 mm and 60 g, which stands on its long edge."""

    task: ClassVar[str] = "Pick-ThinBox"
    task_text: ClassVar[str] = "Pick up the box of cards."
    thing: ClassVar[Thing] = Thing(Placed("thin_box"), height_m=0.020, width_m=0.020)


class PickPlateEnv(PickEnv):
    """`PickEnv` of a flat plate, 100 x 60 x 14 mm and 90 g."""

    task: ClassVar[str] = "Pick-Plate"
    task_text: ClassVar[str] = "Pick up the plate."
    thing: ClassVar[Thing] = Thing(Placed("plate"), height_m=0.007, width_m=0.060)


class PickMugEnv(PickEnv):
    """`PickEnv` of a hollow mug with a handle, 70 mm wide, 85 mm high and 240 g, taken by its body."""

    task: ClassVar[str] = "Pick-Mug"
    task_text: ClassVar[str] = "Pick up the mug."
    thing: ClassVar[Thing] = Thing(Placed("mug"), height_m=0.0, width_m=0.070, grasp_m=(0, 0, 0.055))


class PickHammerEnv(PickEnv):
    """`PickEnv` of a small mallet, 160 mm long and 130 g, taken by its handle of 24 mm where it balances."""

    task: ClassVar[str] = "Pick-Hammer"
    task_text: ClassVar[str] = "Pick up the hammer."
    thing: ClassVar[Thing] = Thing(Placed("hammer"), height_m=0.012, width_m=0.024, grasp_m=(-0.010, 0, 0))


class PickCanEnv(PickEnv):
    """`PickEnv` of robosuite's can, 50 mm wide, 80 mm high and 16 g."""

    task: ClassVar[str] = "Pick-Can"
    task_text: ClassVar[str] = "Pick up the can."
    thing: ClassVar[Thing] = Thing(Placed("can", description=ROBOSUITE + "can.xml"), height_m=0.0403, width_m=0.050)


class PickLemonEnv(PickEnv):
    """`PickEnv` of robosuite's lemon, 68 mm long, 40 mm thick and 3 g."""

    task: ClassVar[str] = "Pick-Lemon"
    task_text: ClassVar[str] = "Pick up the lemon."
    thing: ClassVar[Thing] = Thing(
        Placed("lemon", description=ROBOSUITE + "lemon.xml"),
        height_m=0.0196,
        width_m=0.040,
        lying_rad=(0.130, -0.059, 0.0),  # where its mesh comes to rest
    )


class PickNutEnv(PickEnv):
    """`PickEnv` of robosuite's square nut, 20 mm flat and 16 g, taken by its handle."""

    task: ClassVar[str] = "Pick-Nut"
    task_text: ClassVar[str] = "Pick up the nut."
    thing: ClassVar[Thing] = Thing(
        Placed("nut", description=ROBOSUITE + "square-nut.xml"), height_m=0.010, width_m=0.032, grasp_m=(0.0615, 0, 0)
    )
