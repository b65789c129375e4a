"""`CrossEmbodimentWrapper`: at inference, the observations that a policy was trained on (the paper's section IV-C)."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, cast

import gymnasium as gym
import numpy as np

from cei_gym.arrays import Array
from cei_gym.demonstration import Scene
from cei_gym.embodiment import Embodiment, load_embodiment
from cei_gym.errors import CEIError, unknown
from cei_gym.impersonation import Impersonation
from cei_gym.pointcloud import CloudOptions, CloudSynthesiser, frame_points
from cei_gym.transfer import Transfer
from cei_gym.untrusted import finite_row

if TYPE_CHECKING:
    from cei_gym.painting import LivePainter


PIXELS = "pixels"
"""Entry of an observation with its pictures, as Gymnasium's environments and LeRobot have it."""


class CrossEmbodimentWrapper(gym.Wrapper, gym.utils.RecordConstructorArgs, gym.utils.EzPickle):
    """Shows a policy the clouds that the converter makes, and, if asked to, another robot than the one that acts.

    *Augment* (the default): clouds lose the robot as the cameras see it and gain points sampled on all of its surface, as in
    converted datasets, so that a policy trained on those runs on the target robot.

    *Impersonate*: a policy trained on another robot runs unchanged. It sees that robot's joints, and a cloud in which it
    stands in the place of the one that acts; its actions are retargeted live.

    *Pictures*: the `pixels` of an observation, one of each of the scene's cameras, are painted over (`cei_gym.painting.LivePainter`) where another
    robot is impersonated, or where asked for, as for a policy that was trained on painted ones.

    Clouds come from the images of an environment that has them (`depth_m()`, with colours `rgb()`, and cameras in its scene), else
    from its observation. The environment's `embodiment` and `scene` are used where they are not given.

    Args:
        env: its observation is a `Dict` with joint positions (n,) and a cloud (N, 3) or, with colours,
            (N, 6), its actions are joint targets (n,). An impersonated robot's steps are as far apart as its metadata's
            `render_fps` says; without one, speeds are unlimited and nothing is known to be held.
        impersonate: from the robot that the policy was trained on to the one that acts, fitted to a few demonstrations; None to
            augment.
        embodiment: name of the robot that acts.
        scene: its base, the cameras and the workspace; the impersonated robot has the same base.
        clouds: options of the cloud, those that the converter had; by default those of `impersonate`.
        joints_key, cloud_key: entries of the observation.
        start_option: reset option by which the environment puts its joints somewhere, for an impersonated robot to start from
            its home, or where that very option says; None if it has no such option: the other robot then starts from where
            its pads come nearest.
        paint: whether the robot that the policy sees is painted over the one that acts in `pixels`, camera name to (H, W, 3) uint8 picture of a
            fixed camera of the scene; None for where there are any and another robot is impersonated.

    Raises:
        CEIError: the environment lacks something of the above.
        MissingExtra: pictures are painted, and OpenCV is not installed.
    """

    def __init__(
        self,
        env: gym.Env,
        impersonate: Transfer | None = None,
        embodiment: str | None = None,
        scene: Scene | None = None,
        clouds: CloudOptions | None = None,
        joints_key: str = "agent_pos",
        cloud_key: str = "point_cloud",
        start_option: str | None = "agent_pos",
        paint: bool | None = None,
    ) -> None:
        arguments: dict[str, Any] = {
            "impersonate": impersonate,
            "embodiment": embodiment,
            "scene": scene,
            "clouds": clouds,
            "joints_key": joints_key,
            "cloud_key": cloud_key,
            "start_option": start_option,
            "paint": paint,
        }
        gym.utils.RecordConstructorArgs.__init__(self, **arguments)
        gym.utils.EzPickle.__init__(self, env, **arguments)
        gym.Wrapper.__init__(self, env)
        self._joints_key, self._cloud_key, self._start_option = joints_key, cloud_key, start_option
        acting = self._given("embodiment", load_embodiment(embodiment) if embodiment else None)
        self._scene: Scene = self._given("scene", scene)
        spaces = self._checked_spaces(acting)
        shown = acting if impersonate is None else impersonate.source
        if impersonate is not None and impersonate.target.name != acting.name:
            raise CEIError(f"impersonate moves {shown.name} to {impersonate.target.name}, but {acting.name} acts.")
        clouds = clouds or (CloudOptions() if impersonate is None else impersonate.clouds)
        self._synthesiser = CloudSynthesiser(acting, shown, clouds)
        self.clouds: CloudOptions = clouds
        """Options of the clouds that the policy sees."""
        rate_hz = env.metadata.get("render_fps")  # a step is a frame, as Gymnasium has it
        dt_s = 1 / rate_hz if rate_hz else None
        self._impersonation = None if impersonate is None else Impersonation(impersonate, np.eye(4), dt_s)
        if paint is None:
            paint = impersonate is not None and PIXELS in spaces
        self._painters: dict[str, LivePainter] = _painters(spaces, acting, shown, self._scene, dt_s) if paint else {}
        spaces[cloud_key] = _cloud_space(self._scene.workspace_world, clouds, spaces[cloud_key])
        if impersonate is not None:
            spaces[joints_key] = gym.spaces.Box(-np.inf, np.inf, (len(shown.home),), np.float32)
            self.action_space = gym.spaces.Box(shown.lower.astype(np.float32), shown.upper.astype(np.float32))
        self.observation_space = gym.spaces.Dict(spaces)
        self.embodiment: Embodiment = shown
        """The robot that the policy sees."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """As the environment's; of an impersonated robot, `options[start_option]` is its own joint positions."""
        for painter in self._painters.values():
            painter.reset()
        playing = self._impersonation
        if playing is None:
            observation, info = self.env.reset(seed=seed, options=options)
            return self._shown(observation), info
        if self._start_option is None:
            observation, info = self.env.reset(seed=seed, options=options)
            playing.begin_at(observation[self._joints_key])
        else:
            qpos = (options or {}).get(self._start_option, playing.source.home)
            start = {self._start_option: playing.reset(self._checked(qpos, playing.source))}
            observation, info = self.env.reset(seed=seed, options={**(options or {}), **start})
        return self._shown(observation), info

    def step(self, action: Array):
        """As the environment's, with actions of the robot that is shown."""
        if self._impersonation is not None:
            wanted = self._impersonation.act(self._checked(action, self._impersonation.source))
            action = wanted.astype(np.float32)
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._shown(observation), reward, terminated, truncated, info

    def _shown(self, observation: dict[str, Any]) -> dict[str, Any]:
        qpos = np.asarray(observation[self._joints_key], float)
        points, acting, shown = self._points(observation), qpos, dict[str, Any]()
        swap = self._synthesiser.options.swap
        kept = self._synthesiser.remove(points, self._scene, qpos) if swap else points
        if self._impersonation is not None:
            qpos = self._impersonation.observe(qpos)
            shown[self._joints_key] = qpos.astype(np.float32)
        shown[self._cloud_key] = (
            self._synthesiser.add(kept, self._scene, qpos) if swap else self._synthesiser.keep(kept, self._scene)
        )
        if self._painters:
            pixels, depth_m = observation[PIXELS], self._images("depth_m")
            holds = self._impersonation is not None and self._impersonation.holds
            shown[PIXELS] = {
                name: painter(pixels[name], acting, qpos, depth_m.get(name), holds)
                for name, painter in self._painters.items()
            }
        return {**observation, **shown}

    def _points(self, observation: dict[str, Any]) -> Array:
        depth_m, rgb = (self._images(name) for name in ("depth_m", "rgb"))
        cloud = np.asarray(observation[self._cloud_key], float)
        points = frame_points(self._scene, depth_m, rgb, cloud, self._synthesiser.options.colours)
        assert points is not None
        return points

    def _images(self, name: str) -> dict[str, Array]:
        """What the environment's cameras saw, if it has any that say so."""
        return self.env.get_wrapper_attr(name)() if self.env.has_wrapper_attr(name) else {}

    def _given(self, name: str, value: Any) -> Any:
        if value is not None:
            return value
        if not self.env.has_wrapper_attr(name):
            raise CEIError(f"{self.env} has no attribute {name!r}; give it to the wrapper: {name}=...")
        return self.env.get_wrapper_attr(name)

    def _checked_spaces(self, acting: Embodiment) -> dict[str, gym.Space[Any]]:
        """The environment's own observation spaces."""
        space: Any = self.env.observation_space
        n = len(acting.home)
        spaces: dict[str, gym.Space[Any]] = (
            dict(space.spaces) if isinstance(self.env.observation_space, gym.spaces.Dict) else {}
        )
        for key in (self._joints_key, self._cloud_key):
            if key not in spaces:
                raise CEIError(f"observations of {self.env} have no {key!r}. They have: {', '.join(spaces) or space}.")
        shapes = {"observed joints": spaces[self._joints_key].shape, "actions": self.env.action_space.shape}
        for what, shape in shapes.items():
            if shape != (n,):
                raise CEIError(f"{acting.name} has {n} joints, but {what} of {self.env} have shape {shape}.")
        return spaces

    @staticmethod
    def _checked(qpos: Array, of: Embodiment) -> Array:
        try:
            return finite_row(qpos, len(of.home))
        except CEIError as error:
            raise CEIError(f"{of.name} takes {len(of.home)} finite joint positions, not {error}.") from None


def _cloud_space(workspace_world: Array, clouds: CloudOptions, given: gym.Space[Any]) -> gym.spaces.Box:
    lower, upper = workspace_world.astype(np.float32)
    # An empty cloud is filled up with zeros.
    low, high = np.minimum(lower, 0), np.maximum(upper, 0)
    if clouds.colours and given.shape is not None and given.shape[-1] == 6:
        low, high = np.append(low, np.zeros(3)), np.append(high, np.ones(3))
    low, high = (np.tile(corner, (clouds.points, 1)).astype(np.float32) for corner in (low, high))
    return gym.spaces.Box(low, high, dtype=np.float32)


def _painters(
    spaces: dict[str, gym.Space[Any]], acting: Embodiment, shown: Embodiment, scene: Scene, dt_s: float | None
) -> "dict[str, LivePainter]":
    from cei_gym.painting import LivePainter  # OpenCV, scipy

    of_cameras = cast("Mapping[str, Any]", getattr(spaces.get(PIXELS), "spaces", {}))
    if not of_cameras:
        raise CEIError(
            f"there is nothing to paint: observations have no {PIXELS!r}, camera name to picture (CEI-Gym's: pixels=True)."
        )
    cameras = {camera.name: camera for camera in scene.cameras}
    for name, space in of_cameras.items():
        if name not in cameras:
            raise unknown(f"camera of {PIXELS!r}, which has to be calibrated,", name, [*cameras])
        size = cameras[name].height, cameras[name].width, 3
        if space.shape != size or space.dtype != np.uint8:
            raise CEIError(
                f"{PIXELS!r} of {name} are {space.dtype} of {space.shape}, where its calibration is of uint8, {size}."
            )
    base = scene.T_world_base
    return {
        name: LivePainter(acting, shown, base, base, cameras[name], scene.support_z_m, dt_s=dt_s) for name in of_cameras
    }
