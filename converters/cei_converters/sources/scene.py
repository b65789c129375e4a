"""The scene of a dataset that does not say what it is."""

from dataclasses import replace

import numpy as np

from cei_converters.sources.calibration import Calibration
from cei_gym.arrays import Array
from cei_gym.demonstration import Scene

# stands in for the workspace of a dataset that does not say: about any arm's reach; where the table is, it says nothing of
DEFAULT_WORKSPACE_M = np.array([[-2.0, -2.0, -2.0], [2.0, 2.0, 2.0]])


def scene_without_metadata(T_world_base: Array | None, calibration: Calibration | None) -> Scene:
    """What is known of the scene of a dataset that does not say. Where its table is, only a calibration's workspace says."""
    if T_world_base is None:
        T_world_base = (
            np.eye(4) if calibration is None or calibration.T_world_base is None else calibration.T_world_base
        )
    scene = Scene(T_world_base, (), DEFAULT_WORKSPACE_M + T_world_base[:3, 3])
    return scene if calibration is None else replace(calibration, T_world_base=None).over(scene)


def table_from(calibration: Calibration | None) -> str:
    """Who says where the table is, if a calibration does."""
    return "the calibration's workspace" if calibration is not None and calibration.workspace_world is not None else ""
