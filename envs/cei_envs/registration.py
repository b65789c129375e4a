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
    from cei_gym.embodiment import embodiment_names

    return [environment_id(task, name) for task in TASKS for name in embodiment_names()]


def register() -> None:
    """Register every environment, once; called by `import cei_gym`."""
    from cei_gym.embodiment import embodiment_names

    for task, (entry_point, steps) in TASKS.items():
        for name in embodiment_names():
            if environment_id(task, name) not in gym.registry:
                gym.register(
                    environment_id(task, name),
                    entry_point,
                    max_episode_steps=steps,
                    kwargs={"embodiment": name},
                )
