"""`--target_pose=auto`: which frames places are judged by, and what is said and kept of the place that is found."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from cei_converters.conversion.config import AUTO
from cei_converters.dataset.metadata import plain
from cei_converters.sources.recording import spread
from cei_gym.demonstration import Demonstration
from cei_gym.transfer.placing import AS_GOOD_M, FOLLOWED, SAMPLED, Placement, Standing

if TYPE_CHECKING:
    from cei_converters.conversion.steps import Read
    from cei_gym.embodiment import Embodiment

PLACE_PICTURE = "target_pose.png"
"""In the dataset's `meta/`."""
PLACE_EPISODES = 64
"""Places are judged by frames of so many episodes, spread over the dataset, however large it is."""


def sample(read: "Read", most: int) -> tuple[list[Demonstration], list[Demonstration]]:
    """Demonstrations of at most so many episodes thinned to `SAMPLED` frames in all, and `FOLLOWED` of them as they are.

    Raises:
        CEIError: an episode cannot be read.
    """
    positions = spread(len(read.selected), most)
    each = max(1, SAMPLED // len(positions))
    thinned: list[Demonstration] = []
    for position in positions:
        recorded = read(position, quickly=True, clouds=False)
        if recorded.inside or position == positions[0]:
            joints = replace(recorded.demonstration, depth_m={}, rgb={}, point_cloud_world=None)
            thinned.append(joints.at(np.array(spread(len(joints), each))))
    return thinned, [read(positions[i], quickly=True).demonstration for i in spread(len(positions), FOLLOWED)]


def as_option(placement: Placement) -> str | None:
    """The place as `--target_pose` has it; None where it is the source's."""
    if placement.kept:
        return None
    T = placement.chosen.T_world_base
    quaternion_wxyz = Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True, scalar_first=True)
    return ",".join(f"{x:.6g}" for x in (*T[:3, 3], *quaternion_wxyz.round(6)))


def record(placement: Placement) -> dict[str, Any]:
    """What provenance and result have of it, in JSON types."""
    return {
        "target_pose": as_option(placement),
        "frames": placement.frames,
        "episodes": placement.episodes,
        "chosen": plain(placement.chosen),
        "source": plain(placement.source),
    }


def told(placement: Placement) -> str:
    """One line: where the target's base stands, and how much better that is than where the source's does."""
    chosen, source, n = placement.chosen, placement.source, placement.frames
    over = f"over {n} frames of {placement.episodes} episodes"
    if placement.kept:
        good = f"no place searched is better than the source's by {1e3 * AS_GOOD_M:g} mm of cost, so the target stands there"
        return f"target_pose: {AUTO}: {good}; {over}: {_figures(chosen, n)}."
    x, y, z = chosen.T_world_base[:3, 3]
    at = f"base at {x:.4g}, {y:.4g}, {z:.4g} m, turned by {np.degrees(chosen.yaw_rad):.0f} deg"
    return f"target_pose: {AUTO}: {at}; {over}: {_figures(chosen, n)} (source's place: {_figures(source, n)})."


def note_on_simulation(target: "Embodiment", placement: Placement, environment: str | None) -> str:
    """What is said where a simulation will not have the target there; empty where nothing is to be."""
    parts = [part for part in (target.arm, target.end_effector) if part is not None]
    if environment is None or placement.kept or not all(part.simulator_name for part in parts):
        return ""
    return (
        f"note: robosuite has {target.name} and stands it where its own robot does, so {environment} does not open with the base there: "
        "cei-replay and lerobot-eval want it converted without --target_pose."
    )


def _figures(standing: Standing, frames: int) -> str:
    figures = [
        f"fidelity {standing.fidelity:.2f}",
        f"out of reach {standing.out_of_reach} of {frames}",
        f"worst pad error {standing.pad_distance_mm:.1f} mm",
        f"least manipulability {standing.manipulability:.2f} of the arm's best",
        f"a joint within {standing.limit_margin:.0%} of its range of a limit",
        f"{standing.penetration_mm:.1f} mm in itself, its stand or the table",
    ]
    if standing.among_mm:
        figures.append(f"its base {standing.among_mm:.0f} mm in the workspace")
    return ", ".join(figures)
