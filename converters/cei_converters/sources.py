"""The formats that demonstrations come in: which one a path holds."""

from pathlib import Path

import numpy as np

from cei_converters.calibration import Calibration
from cei_converters.joint_map import JointMap
from cei_converters.source import Source


def open_source(
    repo_id: str,
    root: str | Path | None = None,
    *,
    embodiment: str | None = None,
    T_world_base: np.ndarray | None = None,
    calibration: Calibration | None = None,
    joint_map: JointMap | None = None,
) -> Source:
    """Open recorded episodes of any format that is read.

    Args:
        repo_id: name of the dataset.
        root: its folder or file; default: LeRobot's cache, else the hub.
        embodiment: of a dataset that does not say it.
        T_world_base: (4, 4) base pose for such a dataset; default: identity.
        calibration: of its depth cameras.
        joint_map: which of its columns are which joints.

    Raises:
        CEIError: whatever is wrong with it, in one line.
    """
    from cei_converters.reader import DatasetReader

    options = {
        "embodiment": embodiment,
        "T_world_base": T_world_base,
        "calibration": calibration,
        "joint_map": joint_map,
    }
    return DatasetReader(repo_id, root, **options)
