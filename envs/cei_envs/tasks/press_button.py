"""PressButton: press a button through its travel."""

from collections.abc import Sequence
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np

from cei_envs.tasks.objects import ObjectsEnv, names_of
from cei_envs.tasks.placed import Placed
from cei_gym.arrays import Array
from cei_gym.errors import CEIError, one_line
from cei_gym.untrusted import finite_row

BUTTON = Placed("button", free=False)
PLACEMENT_M, YAW_RAD = 0.08, np.radians(20)
PRESSED_M, TOUCHED_M = 0.007, 0.001
FURTHEST_M = (0.26, 0.46)
"""How far from the table's middle places may be drawn around, along x and y, for the housing to stand on the table."""


class PressButtonEnv(ObjectsEnv):
    """Press a button through its travel.

    A push button in a housing of 9 x 9 x 4 cm fixed to a table 1.2 m wide: its cap goes down 8 mm against a spring of 300 N/m. It may stand
    anywhere on the table: `middle_m` says around where seeds draw its place, and `options` take it where they do not.

    ### Action space
    `Box(n,)`, float32: absolute joint position targets, as in `PickCubeEnv`.

    ### Observation space
    `Dict` with `agent_pos` (n,) and `point_cloud` (1024, 3) as in `PickCubeEnv`, and

    | index of `environment_state` (4,) | meaning | unit | at a start |
    |---|---|---|---|
    | 0, 1 | middle of the housing, world | m | within 0.08 of `middle_m`, along each |
    | 2 | its yaw | rad | within 20 degrees |
    | 3 | how far it is pressed | m | 0 |

    ### Reward, success and end
    Reward is 1 on success, else 0. Success (`info["is_success"]`, which also terminates): it has been pressed by at least 7 mm for 20 control
    periods (1 s) in a row. `info["failure"]` says why not yet: never touched, not through, let go. Truncated after 400 steps.

    ### Start
    `reset(seed=...)` draws the button's place and joints (home, or `start_qpos`, plus 0.02 rad of noise);
    `options={"environment_state": ..., "agent_pos": ...}` restores a recorded start exactly.

    ### Arguments
    `middle_m`: x and y in metres, world, around which the button's place is drawn; default: the table's middle, 0 and 0. At most 0.26 and 0.46
    away from it, or it is a `CEIError`. See `CEIEnv` for the others: `embodiment`, `max_hold_ticks`, `image_width`, `image_height`, `clouds`, `cameras`, `depth_noise`, `colours`,
    `start_qpos`, `sensors`, `render_mode`, `pixels`.
    """

    task: ClassVar[str] = "PressButton"
    task_text: ClassVar[str] = "Press the button."
    objects: ClassVar[tuple[Placed, ...]] = (BUTTON,)
    state_names: ClassVar[tuple[str, ...]] = (*names_of(*objects), "cap.pressed_m")
    table_width_m: ClassVar[float] = 1.2

    def __init__(self, embodiment: str, middle_m: Sequence[float] = (0.0, 0.0), **others: Any) -> None:
        self._middle_m = _checked(middle_m)
        super().__init__(embodiment, **others)
        # in place of the base's, which does not know the middle
        gym.utils.EzPickle.__init__(self, embodiment, middle_m, **others)

    def sample_state(self, rng: np.random.Generator) -> Array:
        x, y = self._middle_m + rng.uniform(-PLACEMENT_M, PLACEMENT_M, 2)
        return np.array([*BUTTON.at(x, y, rng.uniform(-YAW_RAD, YAW_RAD)), 0.0])

    def apply_state(self, state: Array) -> None:
        super().apply_state(state[:-1])
        self.simulation.data.joint("button_slide").qpos[:] = state[-1]

    def read_state(self) -> Array:
        return np.array([*super().read_state(), self._pressed_m])

    def begin(self) -> None:
        self._furthest = 0.0

    def is_done(self) -> bool:
        self._furthest = max(self._furthest, self._pressed_m)
        return self._pressed_m >= PRESSED_M

    def failure_reason(self) -> str:
        if self._furthest < TOUCHED_M:
            return "never touched"
        return "not through" if self._furthest < PRESSED_M else "let go"

    @property
    def _pressed_m(self) -> float:
        return float(self.simulation.data.joint("button_slide").qpos[0])


def _checked(middle_m: object) -> Array:
    """(2,) where places are drawn around, m.

    Raises:
        CEIError: it is something else, or too far away.
    """
    try:
        middle = finite_row(middle_m, 2)
        inside = bool((np.abs(middle) <= FURTHEST_M).all())
    except CEIError:
        inside = False
    if not inside:
        x, y = FURTHEST_M
        raise CEIError(
            f"middle_m={one_line(middle_m, 60)} should be x and y in metres, at most {x} and {y} from the table's middle, for the button to stand on it."
        )
    return middle
