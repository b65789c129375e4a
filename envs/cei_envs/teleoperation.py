"""Hand control: robosuite's keyboard or space mouse moves the grip site, and inverse kinematics the joints."""

import contextlib
import sys
import warnings
from collections.abc import Iterator
from importlib import import_module
from io import StringIO
from time import monotonic, sleep
from typing import Any, Self

import glfw
import mujoco
import numpy as np
from mujoco import viewer
from scipy.spatial.transform import Rotation

from cei_envs.experts.plan import TOLERANCE_M, InverseKinematics, grip_pose
from cei_envs.mounted import MountedSimulation
from cei_envs.simulation import CONTROL_HZ, Simulation
from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment
from cei_gym.errors import CEIError, one_line, unknown

DEVICES = {"keyboard": ("Keyboard", "pynput"), "spacemouse": ("SpaceMouse", "pynput hidapi")}
"""Name to class in `robosuite.devices`, and the packages that it needs."""
STEP_M, STEP_RAD = 0.01, 0.2
"""What full deflection of a device moves the grip site by in a step of the environment: one key press is 1 cm or 1.7
degrees, a space mouse pushed all the way 6 mm or 2.9 degrees."""
TOLERANCE_RAD = 0.05
LEASH_M = 0.05  # how far the target may lead the grip site, which a table may hold back


class Teleoperator:
    """A person who moves the grip site in the robot's base frame, watching a window; use it as a context manager.

    Targets stay where they are reachable: a motion that would take them elsewhere is ignored.

    Args:
        device: "keyboard" or "spacemouse".
        simulation: what is shown; the environment steps it.
        embodiment: its robot, whose end-effector's description has a site named `grip_site`.

    Raises:
        CEIError: no such device, no grip site, no display, or a package or the device itself is missing.
    """

    def __init__(self, device: str, simulation: Simulation, embodiment: Embodiment) -> None:
        if device not in DEVICES:
            raise unknown("device for hand control", device, DEVICES)
        if not isinstance(simulation, MountedSimulation):
            raise CEIError(f"hand control is robosuite's, which does not have {embodiment.name}.")
        self._simulation, self._embodiment = simulation, embodiment
        self._solver = InverseKinematics(embodiment, embodiment.home)
        require_display()
        self._device = open_device(device, simulation.robosuite)
        # Of the window's own, so that nothing done in it reaches the physics.
        self._shown = mujoco.MjData(simulation.model)
        self._window = open_window(simulation.model, self._shown)
        self._wall_s = self._simulated_s = 0.0
        self.stopped = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._device.listener.stop()
        self._window.close()

    def stop(self) -> None:
        """End this attempt and all later ones; may be called by a signal handler."""
        self.stopped = True

    def actions(self, start: Array) -> Iterator[Array]:
        """Absolute joint targets (n,) float32, one a step of the environment, in real time from the first motion on.

        They end when the person gives up: Ctrl+q, the space mouse's right button, or a closed window.

        Args:
            start: (n,) joint positions, rad or m.
        """
        if not self._window.is_running():
            self._window = open_window(self._simulation.model, self._shown)
        n_arm = self._embodiment.n_arm
        target = np.array(start, float)
        position, rotation = grip_pose(self._embodiment, target)
        self._device.start_control()
        idle = True
        while not self.stopped:
            self._show()
            state = self._device.get_controller_state()
            # Ctrl+q, robosuite's key to start over, closes MuJoCo's window too.
            if state["reset"] or not self._window.is_running():
                return
            shift, turn = self._motion(state)
            moves = bool(shift.any() or turn.any())
            idle = idle and not (moves or state["grasp"])
            if idle:
                continue
            if moves:
                goal = position + shift, Rotation.from_rotvec(turn) * rotation
                qpos, miss_m, miss_rad = self._solver.solve(target, *goal)
                if miss_m < TOLERANCE_M and miss_rad < TOLERANCE_RAD and not self._runs_away(position, goal[0]):
                    target, (position, rotation) = qpos, goal
            hand = self._embodiment.closed if state["grasp"] else self._embodiment.home
            target[n_arm:] = hand[n_arm:]
            yield target.astype(np.float32)

    def _motion(self, state: dict[str, Any]) -> tuple[Array, Array]:
        """Translation (3,) m and rotation vector (3,) rad of one step: robosuite's axes, each device's own gain."""
        roll, pitch, yaw = state["raw_drotation"]
        shift, turn = self._device._postprocess_device_outputs(state["dpos"], np.array([pitch, roll, -yaw]))
        return STEP_M * shift, STEP_RAD * turn

    def _runs_away(self, position: Array, goal: Array) -> bool:
        actual, _ = grip_pose(self._embodiment, self._simulation.qpos)
        lead = np.linalg.norm(goal - actual)
        return bool(lead > LEASH_M and lead > np.linalg.norm(position - actual))

    def _show(self) -> None:
        """Draw the simulation, and wait until as much time has passed as in it (while it waits: one control period)."""
        data = self._simulation.data
        mujoco.mj_copyData(self._shown, self._simulation.model, data)
        if self._window.is_running():
            with self._window.lock():
                # Keys that steer are shortcuts of MuJoCo's window too, most of which toggle these.
                self._window.opt.flags[:] = mujoco.MjvOption().flags
            self._window.sync()
        period_s = max(data.time - self._simulated_s, 1 / CONTROL_HZ)
        sleep(max(0.0, self._wall_s + period_s - monotonic()))
        self._wall_s, self._simulated_s = monotonic(), data.time


def require_display() -> None:
    """Fail here rather than hang: where no window can open, MuJoCo's viewer waits for it for ever.

    Raises:
        CEIError: there is no display.
    """
    if sys.platform == "darwin":  # mjpython has GLFW on a thread of its own
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", glfw.GLFWError)
        opens = False
        if glfw.init():
            glfw.window_hint(glfw.VISIBLE, glfw.FALSE)
            opens = bool(glfw.create_window(8, 8, "", None, None))
            glfw.terminate()
    if not opens:
        raise CEIError(
            "hand control needs a display, but no window opens; run it where there is a screen, with DISPLAY set."
        )


def open_window(model: mujoco.MjModel, data: mujoco.MjData) -> viewer.Handle:
    """MuJoCo's passive viewer, seen from the front, so that a device's "away" is away.

    Raises:
        CEIError: macOS without mjpython.
    """
    try:
        window = viewer.launch_passive(model, data, show_left_ui=False, show_right_ui=False)
    except RuntimeError as error:
        raise CEIError(
            f"the window cannot be opened ({one_line(error, 120)}); on macOS: mjpython -m cei_converters.record ..."
        ) from error
    with window.lock():
        window.opt.geomgroup[0] = 0  # robosuite's collision shapes
        window.cam.lookat[:] = 0.0, 0.0, 0.9
        window.cam.distance, window.cam.azimuth, window.cam.elevation = 1.3, 180, -30
    return window


def open_device(name: str, robosuite_env: Any) -> Any:
    """One of robosuite's devices, listening.

    Raises:
        CEIError: a package that it needs, or the device itself, is missing.
    """
    class_name, packages = DEVICES[name]
    try:
        with contextlib.redirect_stdout(StringIO()):  # a page about the space mouse where hidapi is missing
            module = import_module(f"robosuite.devices.{name}")
    except ImportError as error:
        raise CEIError(f"the {name} needs {packages} ({one_line(error, 80)}): pip install {packages}.") from error
    try:
        return getattr(module, class_name)(robosuite_env)
    except OSError as error:
        raise CEIError(
            f"the {name} cannot be opened ({one_line(error, 80)}): connect it, allow this user to read it, and set "
            "SPACEMOUSE_VENDOR_ID and SPACEMOUSE_PRODUCT_ID in robosuite's macros_private.py if it is another model."
        ) from error
