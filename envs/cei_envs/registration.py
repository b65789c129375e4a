"""Tasks, the names of their environments, and their registration with Gymnasium."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache

import gymnasium as gym
from gymnasium.envs.registration import EnvSpec

GROUP = "cei_gym.tasks"
"""Entry points by which packages offer tasks of their own: each names a `Task`, in a module that is quick to import."""


@dataclass(frozen=True)
class Task:
    """A task as it is registered; nothing of it is imported before it is needed.

    Attributes:
        name: the middle of `CEI-<Task>-<Arm>-<EndEffector>`.
        environment: "module:Class", a subclass of `cei_envs.environment.CEIEnv`.
        experts: embodiment, or end-effector on any arm, to "module:Class" of a `cei_envs.experts.Expert` that solves the task with it.
        max_episode_steps: after which an episode is truncated.
    """

    name: str
    environment: str
    experts: Mapping[str, str] = field(default_factory=dict[str, str])
    max_episode_steps: int = 400

    def expert_of(self, embodiment: str) -> str | None:
        """The expert for an embodiment, "module:Class"; None if there is none."""
        return self.experts.get(embodiment, self.experts.get(embodiment.partition("-")[2]))


_GRIPPER = "PandaGripper"
_GRIPPERS = (_GRIPPER, "AG95")
_HANDS = ("Inspire", "RobotiqThreeFinger")  # whose first pad opposes the others on a straight way to closed
_BY_HAND = ("Sphere", "Cylinder", "LyingCylinder", "Mug", "Can")  # what they pick up by the same script as grippers
_THINGS = ("Sphere", "Cylinder", "LyingCylinder", "ThinBox", "Plate", "Mug", "Hammer", "Can", "Lemon", "Nut")


def _of_grippers(expert: str, others: tuple[str, ...] = ()) -> dict[str, str]:
    return dict.fromkeys((*_GRIPPERS, *others), f"cei_envs.experts.{expert}")


OWN = (
    Task(
        "OpenDrawer",
        "cei_envs.tasks.open_drawer:OpenDrawerEnv",
        {
            _GRIPPER: "cei_envs.experts.open_drawer:OpenDrawerExpert",
            "AG95": "cei_envs.experts.open_drawer:OpenDrawerPadExpert",
        },
    ),
    Task(
        "PickCube",
        "cei_envs.tasks.pick_cube:PickCubeEnv",
        {
            _GRIPPER: "cei_envs.experts.pick_cube:PickCubeExpert",
            **dict.fromkeys(_HANDS, "cei_envs.experts.pick_cube:PickCubePadExpert"),
        },
    ),
    Task(
        "StackCube", "cei_envs.tasks.stack_cube:StackCubeEnv", {_GRIPPER: "cei_envs.experts.stack_cube:StackCubeExpert"}
    ),
    Task("PushCube", "cei_envs.tasks.push_cube:PushCubeEnv", _of_grippers("push_cube:PushCubeExpert")),
    Task("PlaceBird", "cei_envs.tasks.place_bird:PlaceBirdEnv", _of_grippers("place_bird:PlaceBirdExpert")),
    Task("PressButton", "cei_envs.tasks.press_button:PressButtonEnv", _of_grippers("press_button:PressButtonExpert")),
    Task("PickCup", "cei_envs.tasks.pick_cup:PickCupEnv", {"XHand": "cei_envs.experts.pick_cup:PickCupExpert"}),
    Task(
        "PackageBread",
        "cei_envs.tasks.package_bread:PackageBreadEnv",
        {"XHand": "cei_envs.experts.package_bread:PackageBreadExpert"},
    ),
    Task(
        "InsertFlower",
        "cei_envs.tasks.insert_flower:InsertFlowerEnv",
        {"XHand": "cei_envs.experts.insert_flower:InsertFlowerExpert"},
    ),
    *(
        Task(
            f"Pick-{thing}",
            f"cei_envs.tasks.pick:Pick{thing}Env",
            _of_grippers("pick:PickExpert", _HANDS if thing in _BY_HAND else ()),
        )
        for thing in _THINGS
    ),
    Task("Lift", "cei_envs.tasks.lift:LiftEnv", {_GRIPPER: "cei_envs.experts.pick_cube:PickCubeExpert"}),
    Task("Stack", "cei_envs.tasks.stack:StackEnv", {_GRIPPER: "cei_envs.experts.stack_cube:StackCubeExpert"}),
    Task(
        "PickPlaceCan",
        "cei_envs.tasks.pick_place_can:PickPlaceCanEnv",
        _of_grippers("pick_place_can:PickPlaceCanExpert"),
    ),
    Task(
        "NutAssemblySquare",
        "cei_envs.tasks.nut_assembly_square:NutAssemblySquareEnv",
        _of_grippers("nut_assembly_square:NutAssemblySquareExpert"),
    ),
    Task("Door", "cei_envs.tasks.door:DoorEnv", _of_grippers("door:DoorExpert")),
)


@cache
def tasks() -> dict[str, Task]:
    """All tasks by name: ours, then those that packages offer. One that cannot be had is left out, with a warning, as the others are of use."""
    from cei_gym import plugins
    from cei_gym.errors import CEIError

    found = {task.name: task for task in OWN}
    for name in plugins.offered(GROUP):
        try:
            offered: Task = plugins.load(GROUP, name, Task, "task")
            if offered.name != name or name in found:
                raise CEIError(
                    f"task {name!r} is called {offered.name!r} by its package, or there is another one of that name."
                )
            found[name] = offered
        except CEIError as error:
            warnings.warn(str(error), stacklevel=2)
    return found


def environment_id(task: str, embodiment: str) -> str:
    """`CEI-<Task>-<Arm>-<EndEffector>`; a task may have hyphens, a robot has one."""
    return f"CEI-{task}-{embodiment}"


def environment_ids() -> list[str]:
    """All environments that this package registers."""
    return [environment_id(task, robot) for task in tasks() for robot in _robots()]


def _robots() -> list[str]:
    """Embodiments that have environments: all that have a name. Where those of one's own cannot be listed the others are of use."""
    # Importing cei_gym registers the environments, for which this module must be complete.
    from cei_gym.embodiment import GRID, embodiment_names
    from cei_gym.errors import CEIError

    try:
        return [name for name in embodiment_names() if name.count("-") == 1]
    except CEIError as error:
        warnings.warn(str(error), stacklevel=2)
        return [*GRID]


def register() -> None:
    """Register every environment that is not yet; called by `import cei_gym`, and again where robots may have come since."""
    robots = _robots()
    for task in tasks().values():
        for robot in robots:
            if (name := environment_id(task.name, robot)) not in gym.registry:
                # What gym.register does, less its look at all others for each: of thousands that takes a second.
                gym.registry[name] = EnvSpec(
                    name,
                    task.environment,
                    max_episode_steps=task.max_episode_steps,
                    kwargs={"embodiment": robot},
                )
