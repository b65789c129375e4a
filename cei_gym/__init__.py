"""CEI-Gym: move robot skills between bodies.

Importing it registers with Gymnasium the environments of every installed package that offers some (the entry point group
`cei_gym.environments`), so `import cei_gym; gym.make("CEI-PickCube-IIWA-Inspire")` works, and so does
`gym.make("cei_gym:CEI-PickCube-IIWA-Inspire")`. Neither torch, the simulator nor LeRobot is imported; the names below are, when they are used.
"""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from cei_gym import extras, plugins

if TYPE_CHECKING:
    from cei_gym.demonstration import Camera, Demonstration, Scene
    from cei_gym.embodiment import Embodiment, embodiment_names, load_embodiment
    from cei_gym.errors import CEIError
    from cei_gym.pointcloud import CloudOptions
    from cei_gym.transfer import Transfer, TransferOptions
    from cei_gym.wrapper import CrossEmbodimentWrapper

__all__ = [
    "CEIError",
    "Camera",
    "CloudOptions",
    "CrossEmbodimentWrapper",
    "Demonstration",
    "Embodiment",
    "Scene",
    "Transfer",
    "TransferOptions",
    "embodiment_names",
    "load_embodiment",
]
__version__ = version("cei-gym")

_MODULES = {
    **dict.fromkeys(("Camera", "Demonstration", "Scene"), "cei_gym.demonstration"),
    **dict.fromkeys(("Embodiment", "embodiment_names", "load_embodiment"), "cei_gym.embodiment"),
    **dict.fromkeys(("Transfer", "TransferOptions"), "cei_gym.transfer"),
    "CEIError": "cei_gym.errors",
    "CloudOptions": "cei_gym.pointcloud",
    "CrossEmbodimentWrapper": "cei_gym.wrapper",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def register_environments() -> None:
    """Register with Gymnasium what is not registered yet: for robots that `CEI_GYM_EMBODIMENTS` has named since the import."""
    for point in plugins.found("cei_gym.environments"):
        point.load()()
    if not extras.installed("cei_envs"):
        from cei_gym import absent

        absent.register()


register_environments()
