"""Which cameras' pictures a conversion keeps, and of which the calibration is known, so that they can be painted."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from cei_converters.cli.options import check_range
from cei_converters.dataset.depth import camera_name
from cei_gym.demonstration import Camera
from cei_gym.errors import CEIError, unknown

NONE = "none"
"""What `--cameras.keep` is where no pictures are."""

NOT_KEPT = "by --cameras.keep"
"""Why a camera's pictures are not in the new dataset."""


@dataclass
class CameraOptions:
    """RGB cameras of a dataset: which are kept, and whether their pictures show the target.

    Attributes:
        keep: cameras whose pictures are in the new dataset, such as front,left, or none; default: all.
        paint: paint the target over the source; each camera kept must be calibrated, and stand still.
        margin_px: around the source's silhouette, what is taken out with it.
    """

    keep: str | None = None
    paint: bool = False
    margin_px: float = 2.0

    def __post_init__(self) -> None:
        check_range("--cameras.margin_px", self.margin_px, 0, 100)
        if self.keep == NONE and self.paint:
            raise CEIError("--cameras.keep=none leaves nothing for --cameras.paint; leave one out.")

    def kept(self, cameras: Sequence[str]) -> list[str]:
        """Those that are kept of a dataset's features of cameras, each of which may be named by the last part of its key.

        Raises:
            CEIError: one that is named is none of them.
        """
        if self.keep is None or self.keep == NONE:
            return [] if self.keep else list(cameras)
        named = [name.strip() for name in self.keep.strip("[]").split(",")]
        for name in named:
            if not any(name in (key, camera_name(key)) for key in cameras):
                raise unknown("camera with pictures", name, [*map(camera_name, cameras), NONE])
        return [key for key in cameras if {key, camera_name(key)} & {*named}]


def calibrated(
    keys: Mapping[str, Mapping[str, Any]], scene_cameras: Sequence[Camera], who: str = "--cameras.paint"
) -> dict[str, Camera]:
    """The calibration of each of a dataset's features of cameras; `who` wants it.

    Raises:
        CEIError: one has none, or it is for pictures of another size.
    """
    known = {camera.name: camera for camera in scene_cameras}
    found = {}
    for key, feature in keys.items():
        name, (height, width, *_) = camera_name(key), feature["shape"]
        if name not in known:
            raise CEIError(
                f"{who}: {key} has no calibration ({', '.join(known) or 'no camera'} has); give that of {name!r} with --calibration=FILE.yaml "
                "(cei-convert --help shows one; a rough one is made exact by cei-calibrate), or leave the camera out."
            )
        camera = known[name]
        if (camera.height, camera.width) != (height, width):
            raise CEIError(
                f"{who}: pictures of {key} are {width}x{height}, but {name!r} is calibrated for {camera.width}x{camera.height}; give its "
                "calibration at the size of its pictures."
            )
        found[key] = camera
    return found
