"""Sensors of an environment's robot whose values demonstrations may have: channels that are measured on request."""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

from cei_envs.simulation import Simulation
from cei_gym.arrays import Array
from cei_gym.errors import unknown

SENSORS: Mapping[str, Callable[[Simulation], Array]] = MappingProxyType({"wrench": lambda it: it.wrench})
"""Channel of `cei_gym.demonstration.Demonstration` to what measures it."""


def check_sensors(names: Sequence[str]) -> tuple[str, ...]:
    """Names of sensors, each once.

    Raises:
        CEIError: there is none of that name.
    """
    for name in names:
        if name not in SENSORS:
            raise unknown("sensor", name, SENSORS)
    return tuple(dict.fromkeys(names))
