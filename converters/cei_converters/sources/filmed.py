"""What a fixed camera of a dataset saw of one robot, or of several on one base, and where their joints were."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cei_converters.sources.clicks import Click, load_clicks
from cei_converters.sources.recording import spread
from cei_converters.sources.source import Source
from cei_gym.arrays import Array
from cei_gym.demonstration import Camera
from cei_gym.errors import CEIError
from cei_gym.painting import delayed
from cei_gym.painting.clicks import Clicks
from cei_gym.painting.view import RobotView

_A_PART = 6  # of an episode's pictures at most so many are looked at, where there are enough episodes


class Filmed:
    """Pictures of a camera, and the joints around them.

    Args:
        sources: the dataset, once for each robot in view; joints are theirs in turn.
        key: of the camera's feature.
        most: so many pictures, spread over the dataset: by turns where joints are fastest and where they are slowest.

    Attributes:
        pictures: (N, H, W, 3) uint8.

    Raises:
        CEIError: there are fewer than eight.
    """

    def __init__(self, sources: Sequence[Source], key: str, most: int) -> None:
        self._sources, self._fps = sources, sources[0].fps
        self._joints: dict[int, Array] = {}
        episodes = spread(len(sources[0]), max(1, most // _A_PART))
        each = -(-most // len(episodes))
        pictures: list[Array] = []
        self._at: list[tuple[int, int]] = []
        for index in episodes:
            few = _by_turns(self._qpos(index), each)
            pictures.append(sources[0].pictures(index).at(few).decode(key))
            self._at += [(index, int(frame)) for frame in few]
        if len(self._at) < 8:
            raise CEIError(f"{sources[0].repo_id} has {len(self._at)} frames; a camera is found by 8 or more.")
        self._at, self.pictures = self._at[:most], np.concatenate(pictures)[:most]

    def qpos_at(self, lag_s: float) -> Array:
        """(N, n) joints that the pictures show, if they trail them by a lag, s; rad or m."""
        return self._of(self._at, lag_s)

    def clicks(self, path: Path, camera: Camera) -> "Clicked":
        """What was clicked.

        Raises:
            CEIError: the file is wrong, or an episode or frame is none of the dataset's.
        """
        robots = [source.embodiment for source in self._sources]
        clicks = load_clicks(path, robots, camera.width, camera.height)
        for i, click in enumerate(clicks):
            if click.episode >= len(self._sources[0]):
                raise CEIError(
                    f"{path.name}: click {i + 1}: episode {click.episode} is none of the {len(self._sources[0])}."
                )
            frames = len(self._qpos(click.episode))
            if click.frame >= frames:
                raise CEIError(
                    f"{path.name}: click {i + 1}: frame {click.frame} is none of the {frames} of episode {click.episode}."
                )
        view = RobotView(robots[0], self._sources[0].scene.T_world_base, camera, robots[1:])
        return Clicked(self, clicks, view)

    def of(self, clicks: Sequence[Click], lag_s: float) -> Array:
        """(K, n) joints where points were clicked, likewise."""
        return self._of([(click.episode, click.frame) for click in clicks], lag_s)

    def _of(self, at: Sequence[tuple[int, int]], lag_s: float) -> Array:
        late = {index: delayed(self._qpos(index), lag_s * self._fps) for index in {index for index, _ in at}}
        return np.stack([late[index][frame] for index, frame in at])

    def _qpos(self, index: int) -> Array:
        if index not in self._joints:
            each = [source.read(index, clouds=False).qpos for source in self._sources]
            self._joints[index] = np.concatenate(each, axis=1)
        return self._joints[index]


class Clicked:
    """Points of robots that were clicked, as they are in the world if pictures trail the joints by a lag."""

    def __init__(self, filmed: Filmed, clicks: Sequence[Click], view: RobotView) -> None:
        self._filmed, self._clicks, self._view = filmed, clicks, view

    def __call__(self, lag_s: float) -> Clicks:
        """They by a lag, s."""
        joints = self._filmed.of(self._clicks, lag_s)
        T = np.stack([self._view.poses(q)[click.body] for q, click in zip(joints, self._clicks, strict=True)])
        points = np.einsum("kij,kj->ki", T[:, :3, :3], np.stack([click.xyz_link for click in self._clicks]))
        return Clicks(points + T[:, :3, 3], np.stack([click.pixel for click in self._clicks]))


def _by_turns(qpos: Array, count: int) -> Array:
    """Frames of (T, n) joints, at most so many, in order: of each stretch the fastest or the slowest, by turns."""
    if len(qpos) <= count:
        return np.arange(len(qpos))
    speed = np.abs(np.gradient(qpos, axis=0)).max(axis=1)
    speed[[0, -1]] = np.median(speed)  # nobody knows what was before and after
    stretches = np.array_split(np.arange(len(qpos)), count)
    return np.array([s[speed[s].argmax() if i % 2 else speed[s].argmin()] for i, s in enumerate(stretches)])
