"""Names of the environments, and their registration with Gymnasium."""

import gymnasium as gym

TASKS = {
    "OpenDrawer": ("cei_envs.tasks.open_drawer:OpenDrawerEnv", 400),
    "PickCube": ("cei_envs.tasks.pick_cube:PickCubeEnv", 400),
    "StackCube": ("cei_envs.tasks.stack_cube:StackCubeEnv", 400),
}
"""Task name to entry point and time limit in steps."""


def environment_id(task: str, embodiment: str) -> str:
    """`CEI-<Task>-<Arm>-<EndEffector>`."""
    return f"CEI-{task}-{embodiment}"


def environment_ids() -> list[str]:
    """All environments that this package registers."""
    # Importing cei_gym registers the environments, for which this module must be complete.
    from cei_gym.embodiment import ARMS, END_EFFECTORS

    # robosuite has no others
    robots = [f"{arm}-{end_effector}" for arm in ARMS for end_effector in END_EFFECTORS]
    return [environment_id(task, robot) for task in TASKS for robot in robots]


def register() -> None:
    """Register every environment, once; called by `import cei_gym`."""
    for name in environment_ids():
        if name not in gym.registry:
            _, task, robot = name.split("-", 2)
            entry_point, steps = TASKS[task]
            gym.register(name, entry_point, max_episode_steps=steps, kwargs={"embodiment": robot})
