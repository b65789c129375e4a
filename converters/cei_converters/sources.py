"""The formats that demonstrations come in: which one a path holds."""

from pathlib import Path
from typing import Any

import numpy as np

from cei_converters.calibration import Calibration
from cei_converters.joint_map import load_joint_map
from cei_converters.source import Source


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
    options: dict[str, Any] = {
        "embodiment": embodiment or (mapped and mapped.embodiment),
        "T_world_base": T_world_base,
        "calibration": calibration,
        "joint_map": mapped,
    }
    if root is not None and Path(root).suffix in (".hdf5", ".h5") and Path(root).is_file():
        from cei_converters.robomimic import RobomimicSource

        return RobomimicSource(repo_id, root, **options)
    if root is not None and any(Path(root, mark).is_file() for mark in (".zgroup", "zarr.json")):
        from cei_converters.zarr_source import ZarrSource

        return ZarrSource(repo_id, root, **options)
    from cei_converters.reader import DatasetReader

    return DatasetReader(repo_id, root, **options)
