"""Read demonstrations of 3D Diffusion Policy and DemoGen: one zarr group, episodes end to end."""

import math
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from cei_converters.dataset.opening import embodiment_without_metadata
from cei_converters.sources.actions import BoundActions, action_map, bind_actions
from cei_converters.sources.binding import bind
from cei_converters.sources.calibration import Calibration
from cei_converters.sources.checks import check_cloud
from cei_converters.sources.joint_map import ActionMap, JointMap
from cei_converters.sources.recording import Recording, Recordings, spread
from cei_converters.sources.scene import scene_without_metadata, table_from
from cei_converters.sources.source import Source
from cei_gym.arrays import Array
from cei_gym.demonstration import Demonstration
from cei_gym.errors import CEIError, one_line
from cei_gym.untrusted import load_json

_STATE, _ACTION, _CLOUD, _ENDS = "data/state", "data/action", "data/point_cloud", "meta/episode_ends"
_MOST_BYTES = 2**32
"""Of an episode's rows, and of a chunk: a few bytes of JSON may say that there are petabytes."""

_OF_NUMBERS = frozenset(
    [
        "adler32",
        "astype",
        "bitround",
        "blosc",
        "bytes",
        "bz2",
        "crc32",
        "crc32c",
        "delta",
        "fixedscaleoffset",
        "fletcher32",
        "gzip",
        "jenkins_lookup3",
        "lz4",
        "lzma",
        "packbits",
        "quantize",
        "sharding_indexed",
        "shuffle",
        "transpose",
        "zlib",
        "zstd",
    ]
)
"""Codecs that are let read a stranger's array; of the others some run what they read."""


class ZarrSource(Source):
    """Episodes of a zarr group with `data/state`, maybe `data/point_cloud`, and `meta/episode_ends`.

    Columns are named by their numbers, so that a joint map is needed. Actions are the next frame's state, as those recorded are of
    whatever controller there was; but where the joint map says what they are, they are `data/action`.

    Args:
        repo_id, root, embodiment, T_world_base, calibration, joint_map: see `open_source`.

    Raises:
        CEIError: whatever is wrong with it, in one line.
    """

    def __init__(
        self,
        repo_id: str,
        root: str | Path,
        *,
        embodiment: str | None = None,
        T_world_base: Array | None = None,
        calibration: Calibration | None = None,
        joint_map: JointMap | None = None,
    ) -> None:
        self.repo_id, self.root = repo_id, Path(root)
        if joint_map is None:
            raise CEIError(f"{root} does not say what its columns are; say it with --joint_map.")
        if joint_map.fps is None:
            raise CEIError(f"{root} does not say how many frames a second it has; the joint map can, by fps: 20.")
        self.fps = joint_map.fps
        self.embodiment = embodiment_without_metadata(self.root, embodiment)
        self.scene = scene_without_metadata(T_world_base, calibration)
        self.table_from = table_from(calibration)
        self._state, self._bounds = _state(self.root)
        self._cloud = _array(self.root, _CLOUD, ndim=3) if _has(self.root, _CLOUD) else None
        self.has_clouds = self._cloud is not None
        columns = [str(i) for i in range(self._state.shape[1])]
        self._bound = bind(joint_map, self.embodiment, columns)
        self._values, self._actions = self._bind_actions(joint_map, columns)
        self.quick = self._bound is None or self._bound.pose is None
        used = {_STATE, _CLOUD, _ENDS, *([_ACTION] if self._actions is not None else [])}
        reason = {_ACTION: "of whatever controller there was; a joint map may say what they are"}
        self.carried = {}
        self.dropped = {
            name: reason.get(name, "there is no reader for it in zarr")
            for name in _names(self.root)
            if name not in used
        }

    def _bind_actions(self, joint_map: JointMap, columns: list[str]) -> tuple[Any, BoundActions | None]:
        said = action_map(joint_map, None)
        if said is None:
            return None, None
        said = ActionMap(said.feature or _ACTION, said.kind, said.joints, said.ignore)
        assert said.feature is not None
        if said.feature != _ACTION:
            raise CEIError(f"{self.root} has no {said.feature!r} for actions; zarr groups have them in {_ACTION!r}.")
        values = _array(self.root, _ACTION, ndim=2)
        if values.shape[0] != self._state.shape[0]:
            raise CEIError(f"{self.root}: {_ACTION} has {values.shape[0]} rows, but {_STATE} {self._state.shape[0]}.")
        own = [str(i) for i in range(values.shape[1])]
        return values, bind_actions(said, self.embodiment, own, joint_map, columns)

    def __len__(self) -> int:
        return len(self._bounds) - 1

    def frames(self, index: int) -> int:
        """Frames of an episode, without reading it."""
        return int(self._bounds[index + 1] - self._bounds[index])

    def read(self, index: int, *, clouds: bool = True, colours: bool = True) -> Demonstration:
        """One episode; see `Source.read`."""
        self.select([index])
        where, cloud = f"{self.root}, episode {index}", None
        rows = int(self._bounds[index]), int(self._bounds[index + 1]), where
        state = _rows(self._state, *rows)
        values = None if self._values is None else _rows(self._values, *rows)
        if clouds and self._cloud is not None:
            cloud = check_cloud(_rows(self._cloud, *rows), len(state), where)
        joints = self.joints(state, values, index, self._bound, self._actions)
        return Demonstration(
            embodiment=self.embodiment.name,
            fps=self.fps,
            qpos=joints.qpos,
            action=joints.action,
            scene=self.scene,
            point_cloud_world=cloud,
            index=index,
            figures=joints.figures,
        )


def recordings(root: Path, most: int) -> Recordings:
    """Columns of `data/state`, of some episodes.

    Raises:
        CEIError: it cannot be read.
    """
    state, bounds = _state(root)
    chosen = spread(len(bounds) - 1, most)
    episodes = [
        Recording(i, _rows(state, int(bounds[i]), int(bounds[i + 1]), f"{root}, episode {i}").astype(float))
        for i in chosen
    ]
    return Recordings([str(i) for i in range(state.shape[1])], None, episodes, len(bounds) - 1)


def _state(root: Path) -> tuple[Any, Array]:
    """`data/state`, and where its episodes begin and end."""
    state, marks = _array(root, _STATE, ndim=2), _array(root, _ENDS, ndim=1)
    ends = _rows(marks, 0, marks.shape[0], f"{root / _ENDS}")
    bounds = np.concatenate([[0], ends]).astype(np.int64)
    if not len(ends) or (np.diff(bounds) <= 0).any() or bounds[-1] != state.shape[0]:
        raise CEIError(
            f"{root}: {_ENDS} should rise to the {state.shape[0]} frames of {_STATE}, not {one_line(ends, 60)}."
        )
    return state, bounds


def _names(root: Path) -> list[str]:
    """Arrays in `data`."""
    found = (
        [path.name for path in (root / "data").iterdir() if not path.name.startswith(".")]
        if (root / "data").is_dir()
        else []
    )
    return [f"data/{name}" for name in sorted(found) if _has(root, f"data/{name}")]


def _has(root: Path, name: str) -> bool:
    return any((root / name / mark).is_file() for mark in (".zarray", "zarr.json"))


def _array(root: Path, name: str, ndim: int) -> Any:
    import zarr

    if not _has(root, name):
        raise CEIError(f"{root} has no {name}; of zarr groups, those of DP3 and DemoGen are read.")
    try:
        _check_described(root / name)
        array = zarr.open_array(root / name, mode="r")
    except CEIError:
        raise
    except Exception as error:  # zarr raises many kinds on damaged metadata
        raise CEIError(f"{root / name} cannot be read ({one_line(error)}).") from error
    if array.dtype.kind not in "fiu" or array.ndim != ndim:  # objects would be pickles
        raise CEIError(f"{root / name} should have {ndim} dimensions of numbers, not {array.ndim} of {array.dtype}.")
    if math.prod(array.chunks) * array.dtype.itemsize > _MOST_BYTES:
        raise CEIError(f"{root / name} has chunks of {array.chunks}, which are too large.")
    return array


def _check_described(path: Path) -> None:
    """Check what an array says of itself before zarr takes its word: a codec may be one that runs what it reads.

    Raises:
        CEIError: it has another codec than those of numbers, or is no JSON.
    """
    file = path / ".zarray" if (path / ".zarray").is_file() else path / "zarr.json"
    try:
        described = load_json(file.read_text())
    except (OSError, ValueError) as error:
        raise CEIError(f"{file} cannot be read ({one_line(error)}).") from error
    if bad := sorted(set(_codecs(described)) - _OF_NUMBERS):
        raise CEIError(
            f"{path} is stored by {one_line(bad[0], 60)!r}, which is no codec of numbers and may run code; write it by one of "
            f"{', '.join(sorted(_OF_NUMBERS))}."
        )


def _codecs(described: object) -> Iterator[str]:
    """Names of an array's codecs, in zarr's second format or its third, those within others too."""
    if not isinstance(described, dict):
        return
    lists = [found for key in _CODECS if isinstance(found := described.get(key), list)]
    for codec in [described.get("compressor"), *chain.from_iterable(lists)]:
        if isinstance(codec, dict):
            yield str(codec.get("id", codec.get("name"))).removeprefix("numcodecs.")
            yield from _codecs(codec.get("configuration"))
        elif codec is not None:
            yield str(codec)


_CODECS = ("filters", "codecs", "index_codecs")


def _rows(array: Any, first: int, last: int, where: str) -> Array:
    """Rows of an array.

    Raises:
        CEIError: they are far too many, or cannot be read.
    """
    if (last - first) * math.prod(array.shape[1:]) * array.dtype.itemsize > _MOST_BYTES:
        raise CEIError(f"{where}: {last - first} rows of {array.shape[1:]} numbers are too many for an episode.")
    try:
        return np.asarray(array[first:last])
    except Exception as error:  # codecs raise many kinds on damaged chunks
        raise CEIError(f"{where} cannot be read ({one_line(error)}).") from error
