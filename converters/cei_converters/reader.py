"""Read a LeRobot v3.0 dataset as demonstrations, one episode at a time."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cei_converters import schema
from cei_converters.calibration import Calibration
from cei_converters.cameras import Pictures, find_clip, read_pictures
from cei_converters.columns import decode_array, read_columns
from cei_converters.decoding import decode_frames, decode_pictures
from cei_converters.depth import camera_name, check_depth_feature, image_depth_m, video_depth_m
from cei_converters.locate import locate
from cei_converters.opening import choose_embodiment, load_lerobot_metadata, load_metadata
from cei_gym.demonstration import Camera, Demonstration, Scene
from cei_gym.errors import CEIError

# how far outside its range a joint may be read before its unit must be wrong
UNIT_SLACK = {"rad": np.pi, "m": 0.5}
WRONG_UNIT = {"rad": "degrees; convert to rad", "m": "millimetres or percent; convert to m"}
BRIGHT = 127
# stands in for the workspace of a dataset that does not say: about any arm's reach
DEFAULT_WORKSPACE_M = np.array([[-2.0, -2.0, -2.0], [2.0, 2.0, 2.0]])


class DatasetReader:
    """A checked dataset of one embodiment.

    Memory holds one episode at a time.

    Args:
        repo_id: name of the dataset.
        root: its folder; default: LeRobot's cache, else the hub.
        embodiment: catalogue name; needed only where the dataset has no `meta/cei.json`.
        T_world_base: (4, 4) base pose for such a dataset; default: identity.
        calibration: of its depth cameras; it wins over `meta/cei.json`.

    Attributes:
        root, repo_id, embodiment, scene: of the dataset.
        metadata: contents of `meta/cei.json`, or None.
        depth_cameras: names of the cameras whose depth is read.
        cameras: LeRobot's features of the others, whose pictures are not looked at.
        ignored_features: keys of what is neither read nor a picture.

    Raises:
        CEIError: whatever is wrong with the dataset, in one line.
    """

    def __init__(
        self,
        repo_id: str,
        root: str | Path | None = None,
        *,
        embodiment: str | None = None,
        T_world_base: np.ndarray | None = None,
        calibration: Calibration | None = None,
    ) -> None:
        self.repo_id = repo_id
        self.root = locate(repo_id, root)
        self.metadata = load_metadata(self.root, embodiment)
        self.embodiment = choose_embodiment(self.root, self.metadata, embodiment)
        if self.metadata is not None:
            scene = self.metadata.scene
        else:
            if T_world_base is None and calibration is not None:
                T_world_base = calibration.T_world_base
            T_world_base = np.eye(4) if T_world_base is None else T_world_base
            workspace_world = DEFAULT_WORKSPACE_M + T_world_base[:3, 3]
            scene = Scene(T_world_base=T_world_base, cameras=(), workspace_world=workspace_world)
        self.scene = scene if calibration is None else calibration.over(scene)
        self._meta = load_lerobot_metadata(repo_id, self.root)
        self._check_features()

    def _check_features(self) -> None:
        features = self._meta.features
        for key in (schema.STATE, schema.ACTION):
            if key not in features:
                raise CEIError(f"{self.root.name} has no feature {key!r}. It has: {', '.join(features)}.")
            schema.check_joint_names(schema.feature_names(features[key]), self.embodiment, key)
            if tuple(features[key]["shape"]) != (len(self.embodiment.joint_names),):
                raise CEIError(
                    f"{key} has shape {features[key]['shape']} but {len(self.embodiment.joint_names)} names."
                )
        calibrated = {camera.name: camera for camera in self.scene.cameras}
        self._depth: dict[str, Camera] = {}
        for key in self._meta.depth_keys:
            check_depth_feature(key, features[key], calibrated)
            self._depth[key] = calibrated[camera_name(key)]
        self.depth_cameras = tuple(camera.name for camera in self._depth.values())
        if len(set(self.depth_cameras)) < len(self.depth_cameras):
            raise CEIError(
                f"two depth features are of one camera: {', '.join(self._depth)}; their last parts should differ."
            )
        pairs = {camera.name: (camera.height, camera.width, 3) for camera in self._depth.values()}
        belonging = [
            key
            for key in self._meta.camera_keys
            if key not in self._depth and tuple(features[key]["shape"]) == pairs.get(camera_name(key))
        ]
        masks = [key for key in belonging if key.startswith(schema.SEGMENTATION_PREFIX)]
        self._masks = {camera_name(key): key for key in masks}
        self._rgb = {camera_name(key): key for key in belonging if key not in masks}
        self.cameras = {key: features[key] for key in self._meta.camera_keys if key not in self._depth}
        used = {schema.STATE, schema.ACTION, schema.POINT_CLOUD, schema.ENVIRONMENT_STATE, *self._meta.camera_keys}
        own = {"timestamp", "frame_index", "episode_index", "index", "task_index"}
        self.ignored_features = [key for key in features if key not in used | own]

    @property
    def has_clouds(self) -> bool:
        """Whether point clouds are recorded."""
        return schema.POINT_CLOUD in self._meta.features

    @property
    def segmented(self) -> bool:
        """Whether a picture says where a depth camera sees objects."""
        return bool(self._masks)

    @property
    def fps(self) -> float:
        """Frames a second."""
        return float(self._meta.fps)

    def __len__(self) -> int:
        return int(self._meta.total_episodes)

    def __iter__(self) -> Iterator[Demonstration]:
        return (self.read(index) for index in range(len(self)))

    def frames(self, index: int) -> int:
        """Frames of an episode, without reading it."""
        return int(self._meta.episodes[index]["length"])

    def record(self, index: int) -> dict[str, Any]:
        """What `meta/cei.json` keeps of an episode (seed, ...)."""
        records = self.metadata.episodes if self.metadata is not None else ()
        return dict(records[index]) if index < len(records) else {}

    def select(self, episodes: Sequence[int] | None) -> list[int]:
        """Checked episode indices; None selects all.

        Raises:
            CEIError: the selection is empty, repeats an index, or has one that the dataset lacks.
        """
        if episodes is None:
            return list(range(len(self)))
        if not episodes:
            raise CEIError("the selection of episodes is empty.")
        for index in episodes:
            if not 0 <= index < len(self):
                raise CEIError(f"{self.repo_id} has no episode {index}. Valid: 0 to {len(self) - 1}.")
        if len(set(episodes)) != len(episodes):
            raise CEIError(f"the selection of episodes repeats one: {', '.join(map(str, episodes))}.")
        return list(episodes)

    def read(self, index: int, *, clouds: bool = True, colours: bool = True) -> Demonstration:
        """One episode.

        Args:
            index: which.
            clouds: also read what cameras saw, depth and point clouds: nearly all of an episode's bytes.
            colours: with them pictures that belong to depth: those of a feature named after a calibrated depth camera, of its size.

        Raises:
            CEIError: it is absent, empty, unreadable, not finite, or in the wrong unit.
        """
        self.select([index])
        depth = self._depth if clouds else {}
        keys = [schema.STATE, schema.ACTION, schema.ENVIRONMENT_STATE]
        rgb = self._rgb if clouds and colours else {}
        images = [key for key in rgb.values() if key in self._meta.image_keys]
        keys = [*keys, schema.POINT_CLOUD, "timestamp", *depth, *images] if clouds else keys
        table = read_columns(self.root, self._meta, index, keys)
        if table.num_rows == 0:
            raise CEIError(f"episode {index} has no frames; leave it out with --episodes or record it again.")
        features = self._meta.features
        values = {
            key: decode_array(table[key], features[key], f"episode {index}, {key}")
            for key in table.column_names
            if key not in (*depth, *images)
        }
        for key in (schema.STATE, schema.ACTION):
            self._check_values(values[key], f"episode {index}", key)
        environment_state = values.get(schema.ENVIRONMENT_STATE)
        tasks = self._meta.episodes[index]["tasks"]
        return Demonstration(
            embodiment=self.embodiment.name,
            fps=self.fps,
            qpos=values[schema.STATE].astype(np.float64),
            action=values[schema.ACTION].astype(np.float64),
            scene=self.scene,
            task=tasks[0] if tasks else "",
            depth_m={camera.name: self._depth_m(index, key, camera, table) for key, camera in depth.items()},
            rgb={name: self._pictures(index, key, table) for name, key in rgb.items()},
            point_cloud_world=values.get(schema.POINT_CLOUD),
            environment_state=None if environment_state is None else environment_state.astype(np.float64),
            environment_state_names=tuple(schema.feature_names(features.get(schema.ENVIRONMENT_STATE, {}))),
            index=index,
        )

    def check_videos(self, episodes: Sequence[int]) -> None:
        """Check that episodes' video files are there.

        Raises:
            CEIError: one is missing.
        """
        for index in episodes:
            for key in self._meta.video_keys:
                find_clip(self.root, self._meta, index, key)

    def pictures(self, index: int) -> Pictures:
        """What an episode's RGB cameras saw, as it is stored.

        Raises:
            CEIError: a picture, a video or statistics are missing.
        """
        return read_pictures(self.root, self._meta, index, list(self.cameras))

    def masks(self, index: int) -> dict[str, np.ndarray]:
        """Depth camera's name to (T, H, W) bool, where it sees objects; none without a feature that says so.

        Raises:
            CEIError: a picture or a video is missing or damaged.
        """
        images = [key for key in self._masks.values() if key in self._meta.image_keys]
        table = read_columns(self.root, self._meta, index, ["timestamp", *images])
        return {name: self._pictures(index, key, table).max(-1) > BRIGHT for name, key in self._masks.items()}

    def _pictures(self, index: int, key: str, table: Any) -> np.ndarray:
        """(T, H, W, 3) uint8."""
        feature = self._meta.features[key]
        if feature["dtype"] == "image":
            return decode_pictures(table[key], feature, f"episode {index}, {key}")
        clip = find_clip(self.root, self._meta, index, key)
        return decode_frames(clip.path, clip.start_s + table["timestamp"].to_numpy(), self.fps).transpose(0, 2, 3, 1)

    def _depth_m(self, index: int, key: str, camera: Camera, table: Any) -> np.ndarray:
        feature = self._meta.features[key]
        if feature["dtype"] == "image":
            return image_depth_m(table[key], feature, camera, f"episode {index}, {key}")
        clip = find_clip(self.root, self._meta, index, key)
        depth_m = video_depth_m(clip.path, clip.start_s + table["timestamp"].to_numpy(), self.fps, feature)
        if depth_m.shape[1:] != (camera.height, camera.width):
            raise CEIError(f"{clip.path} has frames of {depth_m.shape[1:]}, not of {(camera.height, camera.width)}.")
        return depth_m

    def _check_values(self, values: np.ndarray, where: str, key: str) -> None:
        """values: (T, n) rad or m."""
        body = self.embodiment
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            frame, joint = bad[0]
            raise CEIError(
                f"{where}, frame {frame}, joint {body.joint_names[joint]}: {key} is {values[frame, joint]}; "
                "leave the episode out with --episodes or record it again."
            )
        slack = np.array([UNIT_SLACK[unit] for unit in body.joint_units])
        far = np.argwhere((values < body.lower - slack) | (values > body.upper + slack))
        if len(far):
            frame, joint = far[0]
            unit = body.joint_units[joint]
            limits = f"[{body.lower[joint]:.4g}, {body.upper[joint]:.4g}] {unit}"
            raise CEIError(
                f"{where}, frame {frame}, joint {body.joint_names[joint]}: {key} is "
                f"{values[frame, joint]:.4g} {unit}, far outside {limits}; it looks like {WRONG_UNIT[unit]}."
            )
