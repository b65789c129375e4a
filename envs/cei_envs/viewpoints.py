"""Where the depth cameras of the tasks may stand."""

from collections.abc import Sequence

from cei_gym.demonstration import Camera
from cei_gym.errors import CEIError, unknown
from cei_gym.rendering import look_at

FOVY_DEG = 45.0
VIEWPOINTS = {
    "front": ((0.75, 0.45, 1.45), (-0.08, 0.0, 0.85)),
    "left": ((-0.15, 1.0, 1.35), (-0.05, 0.0, 0.88)),
    "right": ((-0.15, -1.0, 1.35), (-0.05, 0.0, 0.88)),
    "top": ((0.15, 0.0, 2.0), (-0.05, 0.0, 0.85)),
}
"""Name to eye and target: world, metres. The robot looks along x from x < -0.5, so its left is at y > 0."""


def make_cameras(names: Sequence[str], width: int, height: int) -> tuple[Camera, ...]:
    """Cameras of some viewpoints, with images of this size.

    Raises:
        CEIError: there is no such viewpoint, one is named twice, or none is.
    """
    if not names or isinstance(names, str) or len(set(names)) < len(names):
        raise CEIError(f"cameras are one or more different names of {', '.join(VIEWPOINTS)}, not {names!r}.")
    for name in names:
        if name not in VIEWPOINTS:
            raise unknown("camera", name, VIEWPOINTS)
    return tuple(look_at(name, *VIEWPOINTS[name], width, height, FOVY_DEG) for name in names)
