"""What every CEI environment shares: observation, absolute joint actions that wait, restorable starts, pictures.

Long: one page says all that a task shares with the others and what its author fills in.
"""

import operator
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, ClassVar, cast

import gymnasium as gym
import mujoco
import numpy as np

from cei_envs.picture import Picture
from cei_envs.sensors import SENSORS, check_sensors
from cei_envs.simulate import simulate
from cei_envs.simulation import CONTROL_HZ
from cei_envs.viewpoints import make_cameras
from cei_gym.arrays import Array
from cei_gym.demonstration import Scene
from cei_gym.embodiment import Embodiment, load_embodiment
from cei_gym.environment import Physics
from cei_gym.errors import CEIError, one_line
from cei_gym.pointcloud import crop, farthest_point_sample, fuse_depth
from cei_gym.rendering import DepthCamera, add_noise, as_noise, geom_colours, miscalibrated, shade
from cei_gym.untrusted import finite_row

CLOUD_POINTS = 1024
CAMERAS, IMAGE_WIDTH, IMAGE_HEIGHT = ("front",), 160, 120
"""Defaults of an environment's cameras, and of their images' size."""
MM_PER_M = np.float32(1000)
START_NOISE_RAD = 0.02
_RESET_OPTIONS = ("environment_state", "agent_pos", "friction_scale")
ARM_TOLERANCE_RAD = 0.02
END_EFFECTOR_TOLERANCE_RAD = 0.05
END_EFFECTOR_TOLERANCE_M = 0.002
STALLED_RAD = 0.1  # an arm that ends a step this far from its target is held back
STALLED_STEPS = 10
HELD_TICKS = 20
"""Default of `CEIEnv.held_ticks`, 1 s: success is what lasts."""
AT_REST = 0.05  # rad/s or m/s: joints slower than this have arrived, or are blocked by what they hold


class CEIEnv(gym.Env, gym.utils.EzPickle, ABC):
    """Base of the tasks; see a task's own docstring for its page.

    A task is a subclass with `task`, `task_text`, `state_names` and the abstract methods; one that lacks any of them cannot be made.
    It becomes `CEI-<Task>-<Arm>-<EndEffector>` by a `cei_envs.registration.Task`.

    Args:
        embodiment: catalogue name, `<Arm>-<EndEffector>`.
        max_hold_ticks: most control periods (1/20 s) that one step waits for the joints to reach its target.
        image_width, image_height: size of the depth cameras' images.
        clouds: whether observations have a `point_cloud`; without, nothing is rendered and a step is several times faster.
        stock_physics: leave out the physics exceptions that embodiments declare, but for those required to drive them.
        cameras: names of `cei_envs.viewpoints`, whose clouds are fused.
        depth_noise: what makes depth images like real ones: "kinect", or fields of `cei_gym.rendering.DepthNoise`; None for
            exact images. It changes no start; `scene.cameras` are as calibrated, with the error that it asks for.
        colours: points of `point_cloud` are x, y, z in m and r, g, b in [0, 1].
        start_qpos: (n,) joint positions near which episodes start, or (k, n) to draw from, rad or m; default: the embodiment's
            home. A policy starts where its demonstrations do, which is elsewhere for those of another robot.
        sensors: names of `cei_envs.sensors`, which `channels` measures too; observations stay what they are.
        T_world_base: (4, 4) where the robot stands, if it is one that robosuite does not mount; default: where robosuite's Panda does.
        render_mode: "rgb_array" or None.
        pixels: observations have `pixels`, the picture of each camera, (H, W, 3) uint8 by its name.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": CONTROL_HZ}  # noqa: RUF012  (as Gymnasium declares it)
    """Gymnasium's: how it renders, at how many steps a second."""

    def __init__(
        self,
        embodiment: str,
        max_hold_ticks: int = 5,
        image_width: int = IMAGE_WIDTH,
        image_height: int = IMAGE_HEIGHT,
        clouds: bool = True,
        stock_physics: bool = False,
        cameras: Sequence[str] = CAMERAS,
        depth_noise: str | Mapping[str, float] | None = None,
        colours: bool = False,
        start_qpos: Sequence[float] | Sequence[Sequence[float]] | None = None,
        sensors: Sequence[str] = (),
        T_world_base: Sequence[Sequence[float]] | None = None,
        render_mode: str | None = None,
        pixels: bool = False,
    ) -> None:
        gym.utils.EzPickle.__init__(
            self,
            embodiment,
            max_hold_ticks,
            image_width,
            image_height,
            clouds,
            stock_physics,
            cameras,
            depth_noise,
            colours,
            start_qpos,
            sensors,
            T_world_base,
            render_mode,
            pixels,
        )
        for name in ("task", "task_text", "state_names"):
            if not hasattr(self, name):
                raise CEIError(f"{type(self).__name__} has no {name}; a task says it (see CEIEnv).")
        if max_hold_ticks < 1:
            raise CEIError(f"max_hold_ticks is at least 1, not {max_hold_ticks}.")
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise CEIError(f"unknown render_mode {render_mode!r}. Valid: {self.metadata['render_modes']} or None.")
        self.embodiment: Embodiment = load_embodiment(embodiment)
        self.render_mode = render_mode
        self._sensors = check_sensors(sensors)
        self._stage = "made"
        self._starts = self._checked_starts(start_qpos)
        self._max_hold_ticks = max_hold_ticks
        placed = make_cameras(cameras, image_width, image_height)
        self._noise = as_noise(depth_noise)
        calibrated = placed if self._noise is None else tuple(miscalibrated(camera, self._noise) for camera in placed)
        self.simulation = simulate(self.embodiment, self.make_robosuite, stock_physics, T_world_base)
        """What it runs: model, joints, contacts, for a task to ask."""
        self.scene = Scene(self.simulation.T_world_base, calibrated, self.workspace_world())
        """Base, depth cameras as calibrated, workspace."""
        self._clouds, self._coloured, self._pixels = clouds, colours, pixels
        self._camera = DepthCamera(self.simulation.model, placed) if clouds or pixels else None
        self._colours = geom_colours(self.simulation.model) if colours or pixels else None
        self._depth_m: dict[str, Array] = {}
        self._rgb: dict[str, Array] = {}
        self._seen: dict[str, Any] = {}
        self._picture: Picture | None = None
        n = len(self.embodiment.joint_names)
        kinds = np.array(self.embodiment.joint_units) == "m"
        arm = np.arange(n) < self.embodiment.n_arm
        tolerance = np.where(kinds, END_EFFECTOR_TOLERANCE_M, END_EFFECTOR_TOLERANCE_RAD)
        self._tolerance = np.where(arm, ARM_TOLERANCE_RAD, tolerance)[self.simulation.driven]
        lower, upper = (x.astype(np.float32) for x in (self.embodiment.lower, self.embodiment.upper))
        self.action_space = gym.spaces.Box(lower, upper, dtype=np.float32)
        box = self.scene.workspace_world
        if colours:
            box = np.concatenate([box, [[0.0] * 3, [1.0] * 3]], axis=1)
        box = np.tile(box.astype(np.float32)[:, None], (1, CLOUD_POINTS, 1))
        spaces: dict[str, gym.Space[Any]] = {
            # Physics lets a joint pass its limit a little.
            "agent_pos": gym.spaces.Box(-np.inf, np.inf, (n,), np.float32),
            # A cloud with too few points is filled up with zeros.
            "point_cloud": gym.spaces.Box(np.minimum(box[0], 0), np.maximum(box[1], 0), dtype=np.float32),
            "environment_state": gym.spaces.Box(-np.inf, np.inf, (len(self.state_names),), np.float32),
        }
        if not clouds:
            del spaces["point_cloud"]
        if pixels:
            spaces["pixels"] = gym.spaces.Dict(
                {camera.name: gym.spaces.Box(0, 255, (camera.height, camera.width, 3), np.uint8) for camera in placed}
            )
        self.observation_space = gym.spaces.Dict(spaces)

    # -- what a task defines ------------------------------------------------------------------------------------

    task: ClassVar[str]
    """Its name in environment ids."""

    task_text: ClassVar[str]
    """The instruction in words."""

    state_names: ClassVar[tuple[str, ...]]
    """Names with units of the entries of `environment_state`; those of an object's pose as `cei_gym.augmentation.move_state` has them."""

    held_ticks: ClassVar[int] = HELD_TICKS
    """Control periods (1/20 s) in a row for which the task must be done to count."""

    expert_arguments: ClassVar[Mapping[str, Any]] = MappingProxyType({})
    """What its experts are told, beside what all experts are."""

    @abstractmethod
    def make_robosuite(self, **robot_arguments: Any) -> Any:
        """The robosuite environment of the task."""

    @abstractmethod
    def workspace_world(self) -> Array:
        """(2, 3) box that clouds are cropped to, metres; its lower face lies just above the support surface."""

    @abstractmethod
    def sample_state(self, rng: np.random.Generator) -> Array:
        """(k,) a random start."""

    @abstractmethod
    def apply_state(self, state: Array) -> None:
        """Put the task's objects into a state (k,)."""

    @abstractmethod
    def read_state(self) -> Array:
        """(k,) state of the task's objects now."""

    @abstractmethod
    def begin(self) -> None:
        """Forget the last episode; called when the start is in place."""

    @abstractmethod
    def is_done(self) -> bool:
        """Whether the task is done at this moment; called once after each control period."""

    @abstractmethod
    def failure_reason(self) -> str:
        """Why the task is not done (yet), in one or two words."""

    # -- Gymnasium ----------------------------------------------------------------------------------------------

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """Start an episode.

        Args:
            seed: of the random start.
            options: `environment_state` (k,) restores a start exactly; `agent_pos` (n,) sets the robot's joints; `friction_scale` makes
                all friction of the episode that times what it is.

        Raises:
            CEIError: an unknown option, one of the wrong shape, a seed that is none, or the environment is closed.
        """
        self._check_open()
        super().reset(seed=_checked_seed(seed))
        # A stream of its own: starts are the same with and without.
        self._noise_random = self.np_random.spawn(1)[0]
        asked: Any = {} if options is None else options
        if not isinstance(asked, Mapping):
            raise CEIError(f"reset options are a mapping of {', '.join(_RESET_OPTIONS)}, not {one_line(asked, 60)}.")
        given = cast("Mapping[Any, Any]", asked)
        if unknown := {str(key) for key in given} - {*_RESET_OPTIONS}:
            raise CEIError(f"unknown reset option {min(unknown)!r}. Valid: {', '.join(_RESET_OPTIONS)}.")
        # Drawn also when restored, and rounded to what datasets store, so that a stored start is the very start.
        state = self.sample_state(self.np_random).astype(np.float32)
        qpos = self._sample_start(self.np_random).astype(np.float32)
        state = self._checked(given, "environment_state", state)
        qpos = self._checked(given, "agent_pos", qpos)
        self.simulation.scale_friction(_checked_scale(given.get("friction_scale", 1.0)))
        self.simulation.reset(qpos)
        self.apply_state(state)
        self.simulation.forward()
        self._target, self._stalled, self._held, self._ticks = qpos, 0, 0, 0
        self.begin()
        self._stage = "begun"
        return self._observation(), self._info()

    def step(self, action: Array):
        """Drive the joints to absolute targets; returns when they are there, at rest, or out of time (`longest_step_s`).

        How long that took in the simulation is `info["step_time_s"]`, one control period or several.

        Raises:
            CEIError: the action is not (n,) finite numbers, or no episode has begun.
        """
        self._check_open()
        if self._stage == "made":
            raise CEIError("no episode has begun: call reset() before step().")
        try:
            action = finite_row(action, len(self.embodiment.lower))
        except CEIError as error:
            n = len(self.embodiment.lower)
            raise CEIError(f"an action of {self.embodiment.name} is {n} finite joint targets, not {error}.") from None
        self._target = np.clip(action, self.embodiment.lower, self.embodiment.upper)
        self._ticks = 0
        for _ in range(self._max_hold_ticks):
            before = self.simulation.qpos
            self.simulation.tick(self._target)
            self._ticks += 1
            self._held = self._held + 1 if self.is_done() else 0
            if self._is_success() or self._arrived(before):
                break
        arm = slice(self.embodiment.n_arm)
        if np.abs(self.simulation.qpos - self._target)[arm].max() > STALLED_RAD:
            self._stalled += 1
        success = self._is_success()
        return self._observation(), float(success), success, False, self._info()

    def render(self) -> Array | None:
        """(240, 320, 3) uint8 picture of the scene; needs neither a display nor a GL library."""
        self._check_open()
        if self.render_mode is None:
            return None
        if self._picture is None:
            self._picture = Picture(self.simulation.model)
        return self._picture.render(self.simulation.data)

    def close(self) -> None:
        """Free the simulation. May be called more than once."""
        if self._stage != "closed":
            self._stage = "closed"
            self.simulation.close()

    # -- beside Gymnasium ---------------------------------------------------------------------------------------

    def depth_m(self) -> dict[str, Array]:
        """Camera name to (H, W) float32 depth behind the last observation, whole millimetres in m, 0 where nothing is."""
        return self._depth_m

    def rgb(self) -> dict[str, Array]:
        """Camera name to the (H, W, 3) uint8 picture that belongs to the depth; empty without `colours`."""
        return self._rgb if self._coloured else {}

    def channels(self) -> dict[str, Any]:
        """What demonstrations have of the moment of the last observation: channel of `cei_gym.demonstration.Demonstration` to its values.

        Raises:
            CEIError: no episode has begun.
        """
        if self._stage == "made":
            raise CEIError("no episode has begun: call reset() before channels().")
        seen = self._seen
        found = {"qpos": seen["agent_pos"], "environment_state": seen["environment_state"]}
        found |= {name: SENSORS[name](self.simulation) for name in self._sensors}
        if self._clouds:
            found |= {"point_cloud_world": seen["point_cloud"], "depth_m": self._depth_m, "rgb": self.rgb()}
        return found

    @property
    def model(self) -> mujoco.MjModel:
        """The simulation's model."""
        return self.simulation.model

    @property
    def longest_step_s(self) -> float:
        """Most time of the simulation, s, that a step waits for the joints."""
        return self._max_hold_ticks / CONTROL_HZ

    @property
    def physics(self) -> Physics:
        """By which rules the simulation treats its robot."""
        return self.simulation.physics

    def expert(self, seed: int, variation: float = 1.0):
        """The scripted expert of this task and embodiment, varied by `seed`: 1 as people vary, 0 not at all.

        Raises:
            CEIError: there is none.
        """
        from cei_envs.experts import make_expert  # mink is not needed to run an environment

        return make_expert(
            self.task, self.embodiment, self.scene.T_world_base, seed, variation, **self.expert_arguments
        )

    def teleoperator(self, device: str):
        """Hand control of the robot by one of robosuite's devices: "keyboard" or "spacemouse".

        Raises:
            CEIError: no such device, or something that it needs (a display, a package, the device itself) is missing.
        """
        from cei_envs.teleoperation import Teleoperator  # opens windows, which nothing else needs

        return Teleoperator(device, self.simulation, self.embodiment)

    # -- inside -------------------------------------------------------------------------------------------------

    def _check_open(self) -> None:
        if self._stage == "closed":
            raise CEIError("the environment is closed; make another one, with gym.make.")

    def _is_success(self) -> bool:
        return self._held >= self.held_ticks

    def _sample_start(self, rng: np.random.Generator) -> Array:
        n, n_arm = len(self.embodiment.home), self.embodiment.n_arm
        noise = np.where(np.arange(n) < n_arm, rng.normal(0.0, START_NOISE_RAD, n), 0.0)
        start = self._starts[rng.integers(len(self._starts)) if len(self._starts) > 1 else 0]
        return np.clip(start + noise, self.embodiment.lower, self.embodiment.upper)

    def _checked_starts(self, start_qpos: Any) -> Array:
        """(k, n) joint positions to start near."""
        n = len(self.embodiment.home)
        try:
            starts = np.atleast_2d(np.asarray(self.embodiment.home if start_qpos is None else start_qpos, float))
        except (TypeError, ValueError):
            starts = np.empty((0, 0))
        if starts.ndim != 2 or not len(starts) or starts.shape[1] != n or not np.isfinite(starts).all():
            raise CEIError(
                f"start_qpos is {n} finite joint positions of {self.embodiment.name}, or several times so many."
            )
        return starts

    def _checked(self, options: Mapping[str, Any], name: str, default: Array) -> Array:
        try:
            return finite_row(options.get(name, default), len(default))
        except CEIError as error:
            raise CEIError(f"reset option {name!r} is {len(default)} finite numbers, not {error}.") from None

    def _arrived(self, before: Array) -> bool:
        driven, qpos = self.simulation.driven, self.simulation.qpos
        close = np.abs(qpos - self._target)[driven] < self._tolerance
        slow = np.abs(qpos - before)[driven] * CONTROL_HZ < AT_REST
        return bool(np.all(close | slow))

    def _observation(self) -> dict[str, Any]:
        observation: dict[str, Any] = {
            "agent_pos": self.simulation.qpos.astype(np.float32),
            "environment_state": self.read_state().astype(np.float32),
        }
        if self._camera is not None:
            self._depth_m, self._rgb = {}, {}
            images = self._camera.render(self.simulation.data)
            for camera, (depth_m, geom_id) in zip(self._camera.cameras, images.values(), strict=True):
                if self._colours is not None:
                    self._rgb[camera.name] = shade(depth_m, geom_id, camera, self._colours)
                if self._noise is not None:
                    depth_m = add_noise(depth_m, camera, self._noise, self._noise_random)
                # Whole millimetres, as depth cameras give and datasets store: what is seen live is what is recorded.
                self._depth_m[camera.name] = np.rint(depth_m * MM_PER_M) / MM_PER_M
        if self._clouds:
            points = fuse_depth(self.scene, self._depth_m, self.rgb())
            points = points[crop(points, self.scene.workspace_world)]
            observation["point_cloud"] = farthest_point_sample(points, CLOUD_POINTS)
        if self._pixels:
            observation["pixels"] = dict(self._rgb)
        self._seen = observation
        return observation

    def _info(self) -> dict[str, Any]:
        success = self._is_success()
        reason = "unreachable" if self._stalled >= STALLED_STEPS else self.failure_reason()
        return {
            "is_success": success,
            "failure": "" if success else reason,
            "step_time_s": self._ticks / CONTROL_HZ,
        }


def _checked_scale(value: Any) -> float:
    """A factor on friction."""
    try:
        (scale,) = finite_row([value], 1)
    except CEIError:
        scale = 0.0
    if scale <= 0:
        raise CEIError(f"reset option 'friction_scale' is a number above 0, not {one_line(value, 60)}.")
    return float(scale)


def _checked_seed(seed: Any) -> int | None:
    """A seed as Gymnasium takes it."""
    try:
        found = None if seed is None else operator.index(seed)
    except TypeError:
        found = -1
    if found is not None and found < 0:
        raise CEIError(f"a seed is a whole number, at least 0, not {one_line(seed, 60)}.")
    return found
