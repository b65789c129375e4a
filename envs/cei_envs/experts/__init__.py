"""Scripted experts, by task and embodiment."""

from pkgutil import resolve_name
from typing import Any

from cei_envs.experts.expert import Expert
from cei_envs.registration import environment_id, tasks
from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment
from cei_gym.errors import CEIError

__all__ = ["Expert", "make_expert"]


def make_expert(
    task: str, embodiment: Embodiment, T_world_base: Array, seed: int, variation: float = 1.0, **others: Any
) -> Expert:
    """The expert of a task for an embodiment; `variation` as in `Expert`, `others` as its class takes them.

    Raises:
        CEIError: there is none (the message lists those there are), or it is no `Expert`.
    """
    known = tasks()
    named = known[task].expert_of(embodiment.name) if task in known else None
    if named is None:
        robots = [
            (each.name, robot if "-" in robot else f"<Arm>-{robot}")
            for each in known.values()
            for robot in each.experts
        ]
        listed = ", ".join(environment_id(*pair) for pair in robots)
        raise CEIError(f"no scripted expert for {environment_id(task, embodiment.name)}. There is one for: {listed}.")
    kind = resolve_name(named)
    if not (isinstance(kind, type) and issubclass(kind, Expert)):
        raise CEIError(f"{named} is no cei_envs.experts.Expert.")
    return kind(embodiment, T_world_base, seed, variation, **others)
