"""Opening an environment by its id, with one clear line when that fails."""

import inspect
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from typing import Any

import gymnasium as gym
from gymnasium.envs.registration import load_env_creator

import cei_gym
from cei_gym.absent import unavailable
from cei_gym.embodiment import arm_names, end_effector_names
from cei_gym.embodiment.catalogue import FOLDERS, own_yamls
from cei_gym.errors import CEIError, one_line, unknown

PREFIX = "CEI-"
HOW_TO_MAKE_ONE = f"`cei-robot new FILE` makes one of your own from a description, in a folder that {FOLDERS} names."


def open_environment(env_id: str, **kwargs: Any) -> gym.Env:
    """`gym.make`, limited to ids of ours.

    Raises:
        CEIError: no such environment (the message lists the valid ones), none is installed, or it takes no such argument.
    """
    if env_id not in gym.registry:
        cei_gym.register_environments()
    ids = [name for name in gym.registry if name.startswith(PREFIX)]
    if env_id not in ids:
        raise _unknown(env_id, ids)
    check_arguments(env_id, kwargs)
    try:
        return gym.make(env_id, **kwargs)
    except CEIError:
        raise
    except (TypeError, ValueError, AssertionError, gym.error.Error) as error:  # arguments may come from a dataset
        raise CEIError(f"{env_id} cannot be opened with {one_line(kwargs, 100)}: {one_line(error)}") from error


def task_names() -> list[str]:
    """Tasks that there are environments of ours of, `CEI-<Task>-<Arm>-<EndEffector>`, those of installed packages last."""
    cei_gym.register_environments()
    return _tasks([name for name in gym.registry if name.startswith(PREFIX) and name.count("-") >= 3])


def _unknown(env_id: str, ids: list[str]) -> CEIError:
    """What of an id is not known: its task, its arm or its end-effector, where it is made like ours."""
    parts = env_id.removeprefix(PREFIX).rsplit("-", 2)
    if not env_id.startswith(PREFIX) or len(parts) != 3:
        close = get_close_matches(env_id, ids, n=1)
        return CEIError(
            f"unknown environment {env_id!r}.{f' Did you mean {close[0]!r}?' if close else ''} Environments are {PREFIX}<Task>-<Arm>-<EndEffector>,"
            f" of the tasks {', '.join(_tasks(ids))}, the arms {', '.join(arm_names())}, and the end-effectors {', '.join(end_effector_names())}."
        )
    task, arm, end_effector = parts
    for kind, name, valid in (("arm", arm, arm_names()), ("end-effector", end_effector, end_effector_names())):
        if name not in valid:
            return CEIError(f"{env_id}: {unknown(kind, name, valid)} {HOW_TO_MAKE_ONE}")
    robot, tasks = f"{arm}-{end_effector}", _tasks(ids)
    yamls = [str(path) for path in own_yamls(robot)]
    known = f"The robot {robot} is known{': ' if yamls else ''}{', '.join(yamls)}."
    if task not in tasks:
        return CEIError(f"{env_id}: {unknown('task', task, tasks)} {known}")
    return CEIError(f"{env_id}: no installed package registers it for this robot. {known}")


def _tasks(ids: list[str]) -> list[str]:
    return list(dict.fromkeys(name.removeprefix(PREFIX).rsplit("-", 2)[0] for name in ids))


def check_arguments(env_id: str, kwargs: Mapping[str, Any]) -> None:
    """Check the names of an environment's arguments, which may come from a dataset.

    Raises:
        CEIError: it takes no such argument, its id says it already, or the environment is not installed.
    """
    spec = gym.spec(env_id)
    assert spec.entry_point is not None
    if spec.entry_point is unavailable:
        unavailable(env_id)
    creator = spec.entry_point if callable(spec.entry_point) else load_env_creator(spec.entry_point)
    takes = [*_parameters(creator), "max_episode_steps", "disable_env_checker"]
    takes = [name for name in takes if name not in spec.kwargs]
    for name in kwargs:
        if name not in takes:
            raise unknown(f"argument of {env_id}", name, takes)


def _parameters(creator: Callable[..., Any]) -> list[str]:
    """Names of what makes an environment takes; of a class also those that its `**others` pass on."""
    names: list[str] = []
    for each in creator.__mro__ if isinstance(creator, type) else [creator]:
        found = inspect.signature(each).parameters.values()
        names += [p.name for p in found if p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL)]
        if all(p.kind is not p.VAR_KEYWORD for p in found):
            break
    return list(dict.fromkeys(names))
