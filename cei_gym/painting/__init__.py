"""Pictures that show another robot: the source taken out, what is behind it put in, the target drawn in the same light.

Geometry alone, of a calibrated camera that stands still: no network, no weights. It needs OpenCV, which LeRobot brings (`cei-gym[lerobot]`).
"""

from cei_gym.painting.behind import Plate
from cei_gym.painting.calibrated import Agreement, agreement
from cei_gym.painting.camera_fit import CameraFit, fit_camera
from cei_gym.painting.carried import Carry, carries
from cei_gym.painting.live import LivePainter
from cei_gym.painting.outline_fit import Footage, fit_outlines
from cei_gym.painting.painter import Figures, Painter, Shot
from cei_gym.painting.view import delayed

__all__ = [
    "Agreement",
    "CameraFit",
    "Carry",
    "Figures",
    "Footage",
    "LivePainter",
    "Painter",
    "Plate",
    "Shot",
    "agreement",
    "carries",
    "delayed",
    "fit_camera",
    "fit_outlines",
]
