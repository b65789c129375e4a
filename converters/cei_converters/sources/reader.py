"""Read a LeRobot v3.0 dataset as demonstrations, one episode at a time.

Long: one format, read lazily, column by column; its parts share the open dataset.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cei_converters.dataset import carried, identity, schema
from cei_converters.dataset.cameras import Pictures, find_clip, read_pictures
from cei_converters.dataset.carried import Carried, frame_tasks, read_carried
from cei_converters.dataset.columns import decode_array, read_columns
from cei_converters.dataset.decoding import decode_frames, decode_pictures
from cei_converters.dataset.depth import camera_name, check_depth_feature, image_depth_m, video_depth_m
from cei_converters.dataset.locate import locate
from cei_converters.dataset.metadata import METADATA_PATH, restore_with
from cei_converters.dataset.opening import choose_embodiment, describe, find_metadata, load_metadata, task_texts
from cei_converters.dataset.records import RECORDS_PATH, ROWS, load_records
from cei_converters.sources.actions import BoundActions, action_map, bind_actions, of_all_joints
from cei_converters.sources.binding import BoundJointMap, bind
from cei_converters.sources.calibration import Calibration
from cei_converters.sources.joint_map import ActionMap, JointMap
from cei_converters.sources.recording import Recording, Recordings, spread
from cei_converters.sources.scene import scene_without_metadata, table_from
from cei_converters.sources.source import Source
from cei_gym.arrays import Array
from cei_gym.channels import OnTransfer, channels
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
        joints_only: whether nothing that cameras saw is read, so that they need no calibration.

    Raises:
        CEIError: whatever is wrong with the dataset, in one line.
    """

    def __init__(
        self,
        repo_id: str,
        root: str | Path | None = None,
        *,
        embodiment: str | None = None,
        T_world_base: Array | None = None,
        calibration: Calibration | None = None,
        joint_map: JointMap | None = None,
        joints_only: bool = False,
    ) -> None:
        self.repo_id = repo_id
        self.root = locate(repo_id, root)
        self.metadata = load_metadata(self.root, embodiment)
        self.embodiment = choose_embodiment(self.root, self.metadata, embodiment)
        scene = self.metadata.scene if self.metadata is not None else scene_without_metadata(T_world_base, calibration)
        self.scene = scene if calibration is None else calibration.over(scene)
        self.table_from = table_from(calibration) or (METADATA_PATH if self.metadata is not None else "")
        self._meta = describe(self.root)
        self.records = load_records(self.root, int(self._meta.total_episodes))
        self.fps = float(self._meta.fps)
        self.has_clouds = schema.POINT_CLOUD in self._meta.features
        self._tasks = task_texts(self._meta)
        self._bound, self._actions = self._bind(joint_map)
        self.quick = self._bound is None or self._bound.pose is None
        self._check_features([] if joints_only else self._meta.depth_keys)

    def _bind(self, joint_map: JointMap | None) -> tuple[BoundJointMap | None, BoundActions | None]:
        features, body = self._meta.features, self.embodiment
        self._state = schema.STATE if joint_map is None else joint_map.state
        said = _DEFAULT_ACTION if joint_map is None else action_map(joint_map, _DEFAULT_ACTION)
        columns = [
            _columns(features, key, self.root) for key in (self._state, said and said.feature) if key is not None
        ]
        if joint_map is None or not (joint_map.joints or joint_map.pose):
            self._check_joint_names(self._state)
            if said == _DEFAULT_ACTION:
                self._check_joint_names(schema.ACTION)
                return None, of_all_joints(body, schema.ACTION)
        bound = (
            None if joint_map is None or not (joint_map.joints or joint_map.pose) else bind(joint_map, body, columns[0])
        )
        return bound, None if said is None else bind_actions(said, body, columns[1], joint_map, columns[0])

    def _check_joint_names(self, key: str) -> None:
        body, feature = self.embodiment, self._meta.features[key]
        try:
            schema.check_joint_names(schema.feature_names(feature), body, key)
        except CEIError as error:
            raise CEIError(
                f"{error} Or --joint_map says which columns are which joints; cei-inspect proposes one."
            ) from error
        if tuple(feature["shape"]) != (len(body.joint_names),):
            raise CEIError(f"{key} has shape {feature['shape']} but {len(body.joint_names)} names.")

    def _check_features(self, depth_keys: Sequence[str]) -> None:
        features = self._meta.features
        calibrated = {camera.name: camera for camera in self.scene.cameras}
        self._depth: dict[str, Camera] = {}
        for key in depth_keys:
            check_depth_feature(key, features[key], calibrated)
            self._depth[key] = calibrated[camera_name(key)]
        self.depth_cameras = tuple(camera.name for camera in self._depth.values())
        if len(set(self.depth_cameras)) < len(self.depth_cameras):
            raise CEIError(
                f"two depth features are of one camera: {', '.join(self._depth)}; their last parts should differ."
            )
        absent = [key for key in self._meta.video_keys if key not in self._depth] if self._without_videos() else []
        cameras = [key for key in self._meta.camera_keys if key not in absent]
        pairs = {camera.name: (camera.height, camera.width, 3) for camera in self._depth.values()}
        belonging = [
            key
            for key in cameras
            if key not in self._depth and tuple(features[key]["shape"]) == pairs.get(camera_name(key))
        ]
        masks = [key for key in belonging if key.startswith(schema.SEGMENTATION_PREFIX)]
        self._masks = {camera_name(key): key for key in masks}
        self.segmented = bool(masks)
        self._rgb = {camera_name(key): key for key in belonging if key not in masks}
        self.cameras = {key: features[key] for key in cameras if key not in self._depth}
        self._objects = next((key for key in schema.STATES_OF_OBJECTS if key in features), schema.PRIVILEGED_STATE)
        action = None if self._actions is None else self._actions.feature
        self._sensors = schema.sensors(features)
        kept = [
            key for name, key in self._sensors.items() if channels(Demonstration)[name].on_transfer is OnTransfer.KEEP
        ]
        used = {self._state, action, schema.POINT_CLOUD, *schema.STATES_OF_OBJECTS, *self._meta.camera_keys, *kept}
        self.carried, self.dropped = carried.choose(features, {key for key in used if key is not None})
        self.dropped |= dict.fromkeys(absent, "as the dataset is here without its videos") | carried.of_episodes(
            self._meta
        )

    def _without_videos(self) -> bool:
        """Whether videos were never published, or not downloaded; where some are missing, `find_clip` refuses it."""
        template = self._meta.video_path
        return template is not None and not (self.root / Path(template).parts[0]).exists()

    def __len__(self) -> int:
        return int(self._meta.total_episodes)

    def frames(self, index: int) -> int:
        """Frames of an episode, without reading it."""
        return int(self._meta.episode(index)["length"])

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
        """The digest of an episode's joints; see `identity`.

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
        keys = [self._state, self._objects, *self._sensors.values(), "task_index"]
        keys += [] if self._actions is None else [self._actions.feature]
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
            if key not in (*depth, *images, "task_index")
        }
        actions = None if self._actions is None else values[self._actions.feature]
        joints = self.joints(values[self._state], actions, index, self._bound, self._actions)
        clouds_world = values.get(schema.POINT_CLOUD)
        if clouds_world is not None:
            shape = schema.cloud_shape(features[schema.POINT_CLOUD], schema.POINT_CLOUD)
            clouds_world = clouds_world.reshape(len(clouds_world), *shape)
        environment_state = values.get(self._objects)
        sensors: dict[str, Any] = {name: values[key].astype(float) for name, key in self._sensors.items()}
        tasks = frame_tasks(table, self._tasks, index) or self._meta.episode(index)["tasks"]
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
            **sensors,
        )

    def check_videos(self, episodes: Sequence[int]) -> None:
        """Check that episodes' video files are there.

        Raises:
            CEIError: one is missing.
        """
        for index in episodes:
            for key in self._meta.video_keys:
                if key not in (*self.cameras, *self._depth, *self._rgb.values()):
                    continue
                find_clip(self.root, self._meta, index, key)

    def pictures(self, index: int) -> Pictures:
        """What an episode's RGB cameras saw, as it is stored.

        Raises:
            CEIError: a picture, a video or statistics are missing.
        """
        return read_pictures(self.root, self._meta, index, list(self.cameras))

    def carry(self, index: int) -> Carried:
        """See `Source.carry`."""
        return read_carried(self.root, self._meta, index, self.carried, self._tasks)

    @property
    def tasks(self) -> list[str]:
        """See `Source.tasks`."""
        counted = sorted(self._tasks) == list(range(len(self._tasks))) == list(range(len(set(self._tasks.values()))))
        return [self._tasks[number] for number in sorted(self._tasks)] if counted else []

    @property
    def carries(self) -> bool:
        """See `Source.carries`."""
        return super().carries or len(self._tasks) > 1

    def masks(self, index: int) -> dict[str, Array]:
        """See `Source.masks`."""
        images = [key for key in self._masks.values() if key in self._meta.image_keys]
        table = read_columns(self.root, self._meta, index, ["timestamp", *images])
        return {name: self._pictures(index, key, table).max(-1) > BRIGHT for name, key in self._masks.items()}

    def _pictures(self, index: int, key: str, table: Any) -> Array:
        """(T, H, W, 3) uint8."""
        feature = self._meta.features[key]
        if feature["dtype"] == "image":
            return decode_pictures(table[key], feature, f"episode {index}, {key}")
        clip = find_clip(self.root, self._meta, index, key)
        return decode_frames(clip.path, clip.start_s + table["timestamp"].to_numpy(), self.fps).transpose(0, 2, 3, 1)

    def _depth_m(self, index: int, key: str, camera: Camera, table: Any) -> Array:
        feature = self._meta.features[key]
        if feature["dtype"] == "image":
            return image_depth_m(table[key], feature, camera, f"episode {index}, {key}")
        clip = find_clip(self.root, self._meta, index, key)
        depth_m = video_depth_m(clip.path, clip.start_s + table["timestamp"].to_numpy(), self.fps, feature)
        if depth_m.shape[1:] != (camera.height, camera.width):
            raise CEIError(f"{clip.path} has frames of {depth_m.shape[1:]}, not of {(camera.height, camera.width)}.")
        return depth_m


_DEFAULT_ACTION = ActionMap(feature=schema.ACTION)


def _columns(features: dict[str, Any], key: str, root: Path) -> list[str]:
    """Names of a feature's columns; numbers where it has none, or not as many.

    Raises:
        CEIError: there is no such feature, or it is no row of numbers a frame.
    """
    if key not in features:
        raise CEIError(f"{root.name} has no feature {key!r}. It has: {', '.join(features)}.")
    dtype, shape = features[key]["dtype"], tuple(features[key]["shape"])
    if len(shape) != 1 or not dtype.startswith(("float", "int", "uint")):
        raise CEIError(f"{key} is {dtype} of shape {shape}; it should be a row of numbers a frame.")
    names = schema.feature_names(features[key])
    return names if len(names) == shape[0] else [str(i) for i in range(shape[0])]


def recordings(repo_id: str, root: str | Path | None, most: int, state: str, action: str | None) -> Recordings:
    """Columns of some episodes; see `read_recordings`."""
    folder = locate(repo_id, root)
    meta = describe(folder)
    names = _columns(meta.features, state, folder)
    action_names = [] if action is None else _columns(meta.features, action, folder)
    keys = [key for key in dict.fromkeys((state, action, "timestamp", "frame_index")) if key is not None]

    def episodes() -> Iterator[Recording]:
        for index in spread(meta.total_episodes, most):
            table = read_columns(folder, meta, index, keys)
            found = {
                key: decode_array(table[key], meta.features[key], f"episode {index}, {key}").astype(float)
                for key in table.column_names
            }
            times_s, numbers = (found[key].ravel() if key in found else None for key in ("timestamp", "frame_index"))
            yield Recording(index, found[state], None if action is None else found[action], times_s, numbers)

    metadata = find_metadata(folder)
    step_time_s = None if metadata is None else metadata.step_time_s
    return Recordings(names, float(meta.fps), list(episodes()), meta.total_episodes, action_names, step_time_s)
