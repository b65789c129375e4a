"""A lab's robot's joints as the embodiment's, both ways."""

from collections.abc import Mapping, Sequence

import numpy as np

from cei_converters.sources.binding import bind
from cei_converters.sources.joint_map import JointGroup, JointMap
from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment
from cei_gym.errors import CEIError

UNITS = ("rad", "deg")
_BEYOND = 1e-3  # rad or m; by less a policy is merely not exact


class RobotJoints:
    """Which of a robot's values are which joints, by a joint map or by their names.

    Args:
        embodiment: the robot as policies know it.
        observed, commanded: names of the values that the lab's robot gives, and takes.
        joint_map: what they mean, the one that the lab's datasets are read with; None where they are `<joint>.pos`.
        unit: of turning joints then, `rad` or `deg`; sliding ones are in m.

    Raises:
        CEIError: a joint is missing, or the map does not fit.
    """

    def __init__(
        self,
        embodiment: Embodiment,
        observed: Sequence[str],
        commanded: Sequence[str],
        joint_map: JointMap | None = None,
        unit: str | None = None,
    ) -> None:
        self.embodiment = embodiment
        followers: dict[str, str] = {}
        if joint_map is None:
            joint_map, followers = _by_name(embodiment, observed, commanded, unit), _keys(commanded)
        elif unit is not None:
            raise CEIError("give --robot.joint_map, which says units, or --robot.unit, not both.")
        if joint_map.pose is not None:
            raise CEIError("the joint map has a pose in the place of joints; a policy's robot is told joints.")
        bound = bind(joint_map, embodiment, observed)
        self._observed = [observed[column] for column in bound.column]
        self._scale, self._offset = bound.scale, bound.offset
        self._moves = np.flatnonzero(bound.scale)  # what is fixed is told nothing
        missing = [self._observed[u] for u in self._moves if self._observed[u] not in commanded]
        if missing:
            raise CEIError(f"the robot observes {_listed(missing)} but takes {_listed(commanded)}.")
        self._followers = {
            q: followers[name]
            for q, name in enumerate(embodiment.joint_names)
            if name in followers and q not in embodiment.coupled.independent
        }
        self._to_unit = 180 / np.pi if unit == "deg" else 1.0

    def qpos(self, values: Mapping[str, float]) -> Array:
        """(n,) joint positions, rad or m, from what the robot observes; what follows another joint does so.

        Raises:
            CEIError: a value is missing or not finite.
        """
        try:
            read = np.array([float(values[self._observed[i]]) for i in self._moves])
        except KeyError as error:
            raise CEIError(f"the robot says nothing of {error}; it does of {_listed(values)}.") from None
        if not np.isfinite(read).all():
            bad = _listed([self._observed[i] for i in self._moves[~np.isfinite(read)]])
            raise CEIError(f"the robot gives no finite number for {bad}.")
        u = self._offset.copy()
        u[self._moves] += read * self._scale[self._moves]
        return self.embodiment.coupled.expand(u)

    def beyond(self, qpos: Array) -> dict[str, float]:
        """How far joint targets (n,) are beyond limits, rad or m, by the joints' names; none that are within."""
        embodiment = self.embodiment
        u = embodiment.coupled.reduce(qpos)
        over = u - np.clip(u, *embodiment.independent_limits)
        names = [embodiment.joint_names[q] for q in embodiment.coupled.independent]
        return {names[i]: float(over[i]) for i in self._moves if abs(over[i]) > _BEYOND}

    def command(self, qpos: Array) -> dict[str, float]:
        """What the robot is told, from joint targets (n,), rad or m: those of the joints that it takes, within limits."""
        embodiment = self.embodiment
        u = np.clip(embodiment.coupled.reduce(qpos), *embodiment.independent_limits)
        told = {self._observed[i]: float((u[i] - self._offset[i]) / self._scale[i]) for i in self._moves}
        followed = embodiment.coupled.expand(u)
        for q, name in self._followers.items():
            turns = embodiment.joint_units[q] == "rad"
            told[name] = float(followed[q] * (self._to_unit if turns else 1.0))
        return told


def _by_name(embodiment: Embodiment, observed: Sequence[str], commanded: Sequence[str], unit: str | None) -> JointMap:
    if unit not in UNITS:
        raise CEIError(
            f"--robot.unit={unit}: say in which unit the robot's joints are, {' or '.join(UNITS)}; or give --robot.joint_map=FILE.yaml."
        )
    independent = [embodiment.joint_names[q] for q in embodiment.coupled.independent]
    for verb, names in (("observes", observed), ("takes", commanded)):
        known = _keys(names)
        if lacking := [joint for joint in independent if joint not in known]:
            raise CEIError(
                f"the policy moves {_listed(independent)}; the robot {verb} {_listed(names)}, not {_listed(lacking)}. Joints are known "
                "by their names, in any order; if others mean the same, give --robot.joint_map=FILE.yaml."
            )
    found = _keys(observed)
    groups = [
        JointGroup([joint], [found[joint]], unit if embodiment.joint_units[q] == "rad" else "m")
        for joint, q in zip(independent, embodiment.coupled.independent, strict=True)
    ]
    return JointMap(groups, ignore="rest")


def _keys(names: Sequence[str]) -> dict[str, str]:
    """Joint to the value that is its position, as LeRobot names them; speeds and others are none."""
    return {name.removesuffix(".pos"): name for name in names if name.endswith(".pos")}


def _listed(names: Sequence[str] | Mapping[str, object]) -> str:
    return ", ".join(names) or "nothing"
