"""What is wrong with an embodiment's joints as a source reads them: limits and speeds."""

from collections.abc import Sequence

import numpy as np

from cei_converters.sources.source import Source
from cei_gym.errors import CEIError

_SPEED_SLACK = 1.5  # a recorded velocity is a difference of noisy positions


def check_joints(source: Source, episodes: Sequence[int]) -> list[str]:
    """What cannot be read, joints outside their limits, and joints that are faster than they can be."""
    found, read = [], []
    for index in episodes:
        try:
            read.append(source.read(index, clouds=False))
        except CEIError as error:
            found.append(str(error))
    if len(found) > 3:
        found = [*found[:3], f"and {len(found) - 3} more episodes like these."]
    body = source.embodiment
    for q in body.coupled.independent if read else ():
        values = [demonstration.qpos[:, q] for demonstration in read]
        together, unit, joint = np.concatenate(values), body.joint_units[q], body.joint_names[q]
        slack = 0.02 * (body.upper[q] - body.lower[q])
        outside = [(v < body.lower[q] - slack) | (v > body.upper[q] + slack) for v in values]
        if any(each.any() for each in outside):
            where = next(i for i, each in enumerate(outside) if each.any())
            found.append(
                f"{joint} is outside its limits [{body.lower[q]:.4g}, {body.upper[q]:.4g}] {unit} in "
                f"{100 * np.concatenate(outside).mean():.3g} % of the frames, from {together.min():.4g} to {together.max():.4g}, first in episode "
                f"{read[where].index}, frame {np.argmax(outside[where])}: the wrong column, unit, sign or offset, or a finger that is pressed."
            )
        speeds = [np.abs(np.diff(v)) * source.fps for v in values]
        fastest = [float(s.max(initial=0.0)) for s in speeds]
        where = int(np.argmax(fastest))
        if fastest[where] > _SPEED_SLACK * body.max_velocity[q]:
            found.append(
                f"{joint} moves at {fastest[where]:.3g} {unit}/s in episode {read[where].index}, frame {np.argmax(speeds[where]) + 1}, and can do "
                f"{body.max_velocity[q]:.3g}: the wrong unit or fps, or a jump."
            )
    return found
