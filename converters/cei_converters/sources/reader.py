"""Read a LeRobot v3.0 dataset as demonstrations, one episode at a time."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cei_converters.dataset import identity, schema
from cei_converters.dataset.cameras import Pictures, find_clip, read_pictures
from cei_converters.dataset.columns import decode_array, read_columns
from cei_converters.dataset.decoding import decode_frames, decode_pictures
from cei_converters.dataset.depth import camera_name, check_depth_feature, image_depth_m, video_depth_m
from cei_converters.dataset.locate import locate
from cei_converters.dataset.metadata import restore_with
from cei_converters.dataset.opening import choose_embodiment, load_lerobot_metadata, load_metadata
from cei_converters.dataset.records import RECORDS_PATH, ROWS, load_records
from cei_converters.sources.calibration import Calibration
from cei_converters.sources.joint_map import BoundJointMap, JointMap, bind
from cei_converters.sources.recording import Recording, Recordings, spread
from cei_converters.sources.source import Source, scene_without_metadata
from cei_gym.demonstration import Camera, Demonstration
from cei_gym.errors import CEIError

BRIGHT = 127


class DatasetReader(Source):
    """A checked dataset of one embodiment.

    Memory holds one episode at a time.

    Args:
        repo_id: name of the dataset.
        root: its folder; default: LeRobot's cache, else the hub.
        embodiment: catalogue name; needed only where the dataset has no `meta/cei.json`.
        T_world_base: (4, 4) base pose for such a dataset; default: identity.
        calibration: of its depth cameras; it wins over `meta/cei.json`.
        joint_map: of a dataset whose columns are not named after the embodiment's joints.

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
        joint_map: JointMap | None = None,
    ) -> None:
        self.repo_id = repo_id
        self.root = locate(repo_id, root)
        self.metadata = load_metadata(self.root, embodiment)
        self.embodiment = choose_embodiment(self.root, self.metadata, embodiment)
        scene = self.metadata.scene if self.metadata is not None else scene_without_metadata(T_world_base, calibration)
        self.scene = scene if calibration is None else calibration.over(scene)
        self._meta = load_lerobot_metadata(repo_id, self.root)
        self.records = load_records(self.root, int(self._meta.total_episodes))
        self.fps = float(self._meta.fps)
        self.has_clouds = schema.POINT_CLOUD in self._meta.features
        self._bound = self._bind(joint_map)
        self._check_features()

    def _bind(self, joint_map: JointMap | None) -> BoundJointMap | None:
        features = self._meta.features
        self._state, self._action = schema.STATE, schema.ACTION
        if joint_map is not None:
            self._state, self._action = joint_map.state, joint_map.action
        for key in filter(None, (self._state, self._action)):
            if key not in features:
                raise CEIError(f"{self.root.name} has no feature {key!r}. It has: {', '.join(features)}.")
        if joint_map is None:
            return None
        (count,) = shape = tuple(features[self._state]["shape"])
        if self._action is not None and tuple(features[self._action]["shape"]) != shape:
            raise CEIError(
                f"{self._action} has shape {features[self._action]['shape']} but {self._state} {shape}; "
                "with action: null the joint map takes the next frame's state instead."
            )
        names = schema.feature_names(features[self._state])
        return bind(joint_map, self.embodiment, names if len(names) == count else list(map(str, range(count))))

    def _check_features(self) -> None:
        features = self._meta.features
        for key in (schema.STATE, schema.ACTION) if self._bound is None else ():
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
        self.segmented = bool(masks)
        self._rgb = {camera_name(key): key for key in belonging if key not in masks}
        self.cameras = {key: features[key] for key in self._meta.camera_keys if key not in self._depth}
        self._objects = next((key for key in schema.STATES_OF_OBJECTS if key in features), schema.PRIVILEGED_STATE)
        used = {self._state, self._action, schema.POINT_CLOUD, *schema.STATES_OF_OBJECTS, *self._meta.camera_keys}
        own = {"timestamp", "frame_index", "episode_index", "index", "task_index"}
        self.ignored_features = [key for key in features if key not in used | own]

    def __len__(self) -> int:
        return int(self._meta.total_episodes)

    def frames(self, index: int) -> int:
        """Frames of an episode, without reading it."""
        return int(self._meta.episodes[index]["length"])

    def record(self, index: int) -> dict[str, Any]:
        """What is known of an episode; empty if nothing is.

        Raises:
            CEIError: what should be of it is of another episode.
        """
        record = super().record(index)
        expected = record.pop(ROWS, None)
        if expected is not None and expected != self.digest(index):
            raise CEIError(
                f"line {index + 1} of {self.root / RECORDS_PATH} is of another episode than episode {index}: the dataset was "
                f"changed; remove the file, or restore it. {restore_with(self.root)}"
            )
        return record

    def digest(self, index: int) -> str:
        """Of an episode's joints; see `identity`.

        Raises:
            CEIError: it cannot be read.
        """
        keys = [key for key in identity.KEYS if key in self._meta.features]
        rows = read_columns(self.root, self._meta, index, keys)
        return identity.digest(rows, self._meta.features, f"episode {index}", keys)

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
        trajectories = [key for key in (self._state, self._action) if key is not None]
        keys = [*trajectories, self._objects]
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
        action = None if self._action is None else values[self._action]
        joints = self.joints(values[self._state], action, index, self._bound)
        clouds_world = values.get(schema.POINT_CLOUD)
        if clouds_world is not None:
            shape = schema.cloud_shape(features[schema.POINT_CLOUD], schema.POINT_CLOUD)
            clouds_world = clouds_world.reshape(len(clouds_world), *shape)
        environment_state = values.get(self._objects)
        tasks = self._meta.episodes[index]["tasks"]
        return Demonstration(
            embodiment=self.embodiment.name,
            fps=self.fps,
            qpos=joints.qpos,
            action=joints.action,
            figures=joints.figures,
            scene=self.scene,
            task=tasks[0] if tasks else "",
            depth_m={camera.name: self._depth_m(index, key, camera, table) for key, camera in depth.items()},
            rgb={name: self._pictures(index, key, table) for name, key in rgb.items()},
            point_cloud_world=clouds_world,
            environment_state=None if environment_state is None else environment_state.astype(np.float64),
            environment_state_names=tuple(schema.feature_names(features.get(self._objects, {}))),
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
        """See `Source.masks`."""
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


def recordings(repo_id: str, root: str | Path | None, most: int, state: str, action: str | None) -> Recordings:
    """Columns of some episodes; see `read_recordings`."""
    folder = locate(repo_id, root)
    meta = load_lerobot_metadata(repo_id, folder)
    for key in filter(None, (state, action)):
        if key not in meta.features:
            raise CEIError(f"{folder.name} has no feature {key!r}. It has: {', '.join(meta.features)}.")
    shape = tuple(meta.features[state]["shape"])
    if len(shape) != 1:
        raise CEIError(f"{state} should be one row of numbers a frame, not {shape}.")
    same = action is not None and tuple(meta.features[action]["shape"]) == shape

    def episodes() -> Iterator[Recording]:
        for index in spread(meta.total_episodes, most):
            table = read_columns(folder, meta, index, list(dict.fromkeys(filter(None, (state, action, "timestamp")))))
            found = {
                key: decode_array(table[key], meta.features[key], f"episode {index}, {key}").astype(float)
                for key in table.column_names
            }
            times_s = found["timestamp"].ravel() if "timestamp" in found else None
            yield Recording(found[state], found[action] if same and action else None, times_s)

    names = schema.feature_names(meta.features[state])
    if len(names) != shape[0]:
        names = [str(i) for i in range(shape[0])]
    return Recordings(names, float(meta.fps), list(episodes()), meta.total_episodes)
