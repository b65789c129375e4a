"""The refusal of clouds that do not show the source where its joints say."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from cei_gym.arrays import Array
from cei_gym.demonstration import Demonstration
from cei_gym.embodiment import Embodiment
from cei_gym.errors import CEIError
from cei_gym.pointcloud import crop, frame_points
from cei_gym.pointcloud.agreement import Agreement, cloud_agreement

_EPISODES, _FRAMES = 3, 8
_ODD = 0.5  # less of what moves on the robot is worth a word


def check_clouds(source: Embodiment, demonstrations: Sequence[Demonstration]) -> str:
    """Compare a dataset's clouds with its joints, on the first of a few episodes in which enough moves.

    Args:
        source: the recorded robot.
        demonstrations: some of its episodes, with what cameras saw, as recorded.

    Returns:
        What was found, in a line; empty where there are no clouds.

    Raises:
        CEIError: they contradict each other.
    """
    found = None
    for demonstration in demonstrations[:_EPISODES]:
        frames = np.unique(np.linspace(0, len(demonstration) - 1, _FRAMES).round().astype(int))
        clouds = [_cloud(demonstration, t) for t in frames]
        if any(cloud is None for cloud in clouds):
            return ""
        T_world_base = demonstration.scene.T_world_base
        found = cloud_agreement(source, [c for c in clouds if c is not None], demonstration.qpos[frames], T_world_base)
        if found.known:
            break
    return "" if found is None else _told(source.name, found)


def _cloud(demonstration: Demonstration, t: int) -> Array | None:
    depth_m = {name: images[t] for name, images in demonstration.depth_m.items()}
    recorded = demonstration.point_cloud_world
    points = frame_points(demonstration.scene, depth_m, {}, None if recorded is None else recorded[t], colours=False)
    return None if points is None else points[crop(points, demonstration.scene.workspace_world)]


def _told(robot: str, found: Agreement) -> str:
    if not found.known:
        return f"Too little moves in the clouds to tell whether {robot} is where its joints say."
    here, there = f"{found.share:.0%}", f"{found.share_there:.0%}"
    anyway = "--check_clouds=false converts the dataset as it is."
    if found.elsewhere:
        position = ",".join(f"{x:.3f}" for x in found.T_world_base[:3, 3])
        quaternion = ",".join(
            f"{q:.4f}" for q in Rotation.from_matrix(found.T_world_base[:3, :3]).as_quat(True, scalar_first=True)
        )
        raise CEIError(
            f"the clouds show {robot} {found.offset_m:.2f} m from where its joints and its base pose say: of what moves in them, "
            f"{here} is on it there, and {there} with its base at {position},{quaternion}. If that is right, give it as "
            "--source_pose, or as T_world_base in --calibration; else the cameras' poses or the joint map are wrong. "
            + anyway
        )
    if found.nowhere:
        raise CEIError(
            f"the clouds do not show {robot} where its joints and its base pose say: of what moves in them, {here} is on it, "
            f"and nowhere else more than {there}. Clouds and base should be in one frame (--source_pose, --calibration), and "
            "joints in their order, sign and unit (--joint_map). " + anyway
        )
    if found.share < _ODD:
        return f"Of what moves in the clouds only {here} is on {robot} where its joints say; look at it with cei-view."
    off = f", {1e3 * found.offset_m:.0f} mm off" if found.offset_m > 0.01 else ""
    return f"Clouds show {robot} where its joints say ({here} of what moves is on it{off})."
