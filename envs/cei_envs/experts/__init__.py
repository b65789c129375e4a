"""Scripted experts, by task and embodiment."""

from cei_gym.errors import CEIError

EXPERTS = {
    ("OpenDrawer", "Panda-PandaGripper"): "cei_envs.experts.open_drawer:OpenDrawerExpert",
    ("PickCube", "Panda-PandaGripper"): "cei_envs.experts.pick_cube:PickCubeExpert",
    ("StackCube", "Panda-PandaGripper"): "cei_envs.experts.stack_cube:StackCubeExpert",
}


def make_expert(task: str, embodiment, T_world_base, seed: int, variation: float = 1.0):
    """The expert of a task for an embodiment; `variation` as in `Expert`.

    Raises:
        CEIError: there is none (the message lists those there are).
    """
    from importlib import import_module

    if (task, embodiment.name) not in EXPERTS:
        known = ", ".join(f"CEI-{t}-{e}" for t, e in EXPERTS)
        raise CEIError(f"no scripted expert for CEI-{task}-{embodiment.name}. There is one for: {known}.")
    module, name = EXPERTS[task, embodiment.name].split(":")
    return getattr(import_module(module), name)(embodiment, T_world_base, seed, variation)
