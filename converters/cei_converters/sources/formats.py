"""The formats that demonstrations come in: which one a path holds."""

from pathlib import Path
from typing import Any, TypeGuard

import numpy as np

from cei_converters.dataset import schema
from cei_converters.sources.calibration import Calibration
from cei_converters.sources.joint_map import load_joint_map
from cei_converters.sources.recording import Recordings
from cei_converters.sources.source import Source
from cei_gym.errors import CEIError


def open_source(
    repo_id: str,
    root: str | Path | None = None,
    *,
    embodiment: str | None = None,
    T_world_base: np.ndarray | None = None,
    calibration: Calibration | None = None,
    joint_map: str | Path | None = None,
) -> Source:
    """Open recorded episodes of any format that is read.

    Args:
        repo_id: name of the dataset.
        root: its folder or file; default: LeRobot's cache, else the hub.
        embodiment: of a dataset that does not say it, nor its joint map.
        T_world_base: (4, 4) base pose for such a dataset; default: identity.
        calibration: of its depth cameras.
        joint_map: YAML that tells which of its columns are which joints.

    Raises:
        CEIError: whatever is wrong with it, in one line.
    """
    mapped = None if joint_map is None else load_joint_map(joint_map)
    if mapped is not None and embodiment is not None and mapped.embodiment not in (None, embodiment):
        raise CEIError(f"{joint_map} is a map of {mapped.embodiment}, not of {embodiment}; leave --source out.")
    options: dict[str, Any] = {
        "embodiment": embodiment or (mapped and mapped.embodiment),
        "T_world_base": T_world_base,
        "calibration": calibration,
        "joint_map": mapped,
    }
    if _is_hdf5(root):
        from cei_converters.sources.robomimic import RobomimicSource

        return RobomimicSource(repo_id, root, **options)
    if _is_zarr(root):
        from cei_converters.sources.zarr_source import ZarrSource

        return ZarrSource(repo_id, root, **options)
    from cei_converters.sources.reader import DatasetReader

    return DatasetReader(repo_id, root, **options)


def read_recordings(
    repo_id: str, root: str | Path | None, most: int, state: str = schema.STATE, action: str | None = schema.ACTION
) -> Recordings:
    """Columns of some episodes, spread over the dataset; of LeRobot's formats, HDF5 or zarr.

    Args:
        repo_id, root: see `open_source`.
        most: how many episodes to read.
        state, action: LeRobot's features to look at.

    Raises:
        CEIError: it cannot be read, or has no features to choose.
    """
    if (_is_hdf5(root) or _is_zarr(root)) and (state != schema.STATE or action not in (None, schema.ACTION)):
        raise CEIError(f"{root} has none of LeRobot's features to look at; leave out --state and --action.")
    if _is_hdf5(root):
        from cei_converters.sources.robomimic import recordings

        return recordings(Path(root), most)
    if _is_zarr(root):
        from cei_converters.sources.zarr_source import recordings

        return recordings(Path(root), most)
    from cei_converters.sources.reader import recordings

    return recordings(repo_id, root, most, state, action)


def _is_hdf5(root: str | Path | None) -> TypeGuard[str | Path]:
    return root is not None and Path(root).suffix in (".hdf5", ".h5") and Path(root).is_file()


def _is_zarr(root: str | Path | None) -> TypeGuard[str | Path]:
    return root is not None and any(Path(root, mark).is_file() for mark in (".zgroup", "zarr.json"))
