"""Options of spatial augmentation, and the variants of recorded episodes that they ask for."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from cei_converters.cli.options import parse_numbers
from cei_converters.dataset import schema
from cei_gym.arrays import Array
from cei_gym.augmentation import (
    RAMP,
    Handling,
    Offset,
    anchored,
    boxes_of_state,
    carried_box,
    displace,
    grid_offsets,
    segmented,
)
from cei_gym.demonstration import Demonstration
from cei_gym.displacement import Region
from cei_gym.errors import CEIError, unknown
from cei_gym.transfer import Transfer

if TYPE_CHECKING:
    from cei_converters.sources.source import Source

CHOICES = ("all", "state", "box", "segmentation")
RAMPS = ("approach", "episode")
_MOST_PLACES = 100_000


@dataclass
class AugmentOptions:
    """Spatial augmentation; `--augment.grid` or `--augment.anchors` switches it on.

    Attributes:
        grid: how many places along x and y objects are moved to, such as 10,10; each makes an episode of its own.
        range: from the first to the last of them along x and y, m; in the middle is where they were recorded, or an anchor.
        anchors: how far from where they were recorded middles are, x and y, m, such as 0,0;0.2,0;0,-0.2: a grid around each.
        rotation_deg: objects are also turned by an angle drawn from minus to plus this, another for each episode.
        seed: of these angles.
        ramp: share of the frames of `ramp_over` after which the hand has gone all of the offset (the paper's 0.8).
        ramp_over: approach (until the hand first takes hold, as objects stand elsewhere from the start; if it never does, until it first
            touches something that clouds show; if it never does, the whole episode) or episode (the paper, whose demonstrations end at
            the object).
        objects: which points are moved: all (that are not the robot's), state (where the simulator's state of objects
            says that they are), box or segmentation (where observation.segmentation.<depth camera> is bright).
        box: where objects are at first: x0,y0,z0,x1,y1,z1, m, world; what of it the hand carries is followed.
        half_m: half size of objects whose size the state does not say, m.
    """

    grid: str | None = None
    range: str = "0.2,0.2"
    anchors: str | None = None
    rotation_deg: float = 0.0
    seed: int = 0
    ramp: float = RAMP
    ramp_over: str = "approach"
    objects: str = "all"
    box: str | None = None
    half_m: float | None = None

    def __post_init__(self) -> None:
        if not self.enabled and any(getattr(self, f.name) != f.default for f in fields(self)):
            raise CEIError(
                "--augment.* are of no use without --augment.grid, such as --augment.grid=10,10, or --augment.anchors."
            )
        if self.grid is None and self.range != type(self).range:
            raise CEIError("--augment.range is of no use without --augment.grid: each anchor is one place.")
        if self.objects not in CHOICES:
            raise unknown("augment.objects", self.objects, CHOICES)
        if self.ramp_over not in RAMPS:
            raise unknown("augment.ramp_over", self.ramp_over, RAMPS)
        if (self.objects == "box") != (self.box is not None):
            raise CEIError("--augment.objects=box and --augment.box=x0,y0,z0,x1,y1,z1 go together.")
        if not 0 < self.ramp <= 1:
            raise CEIError(f"augment.ramp={self.ramp} must be over 0 and at most 1.")
        if not 0 <= self.rotation_deg <= 180:
            raise CEIError(f"augment.rotation_deg={self.rotation_deg} must be from 0 to 180.")
        if self.half_m is not None and not 0 < self.half_m < np.inf:
            raise CEIError(f"augment.half_m={self.half_m} must be positive and finite.")
        if self.seed < 0:
            raise CEIError(f"augment.seed={self.seed} must be at least 0.")
        _ = self.places, self.box_world  # which are checked as they are read

    @property
    def enabled(self) -> bool:
        """Whether there is anything to do."""
        return self.grid is not None or self.anchors is not None

    @property
    def places(self) -> list[Offset]:
        """Where objects are moved to, not turned.

        Raises:
            CEIError: grid, range or anchors cannot be read, or there are too many.
        """
        if not self.enabled:
            return []
        nx, ny = parse_numbers("--augment.grid", self.grid or "1,1", "10,10")
        x_m, y_m = parse_numbers("--augment.range", self.range, "0.2,0.2")
        anchors = [
            Offset(*parse_numbers("--augment.anchors", each, "0.2,0")) for each in (self.anchors or "0,0").split(";")
        ]
        if min(nx, ny) < 1 or nx % 1 or ny % 1 or nx * ny * len(anchors) > _MOST_PLACES:
            what = f"whole numbers of places along x and y, at least 1, and {_MOST_PLACES} in all at most"
            raise CEIError(f"--augment.grid={self.grid}: {what}.")
        if min(x_m, y_m) < 0:
            raise CEIError(f"--augment.range={self.range} must not be negative.")
        return anchored(anchors, grid_offsets((int(nx), int(ny)), (x_m, y_m)))

    @property
    def box_world(self) -> Array | None:
        """(2, 3) lower and upper corner, m.

        Raises:
            CEIError: the box cannot be read, or has no inside.
        """
        if self.box is None:
            return None
        corners = np.reshape(parse_numbers("--augment.box", self.box, "-0.1,-0.1,0.8,0.1,0.1,0.9"), (2, 3))
        if not (corners[0] < corners[1]).all():
            raise CEIError(f"--augment.box={self.box}: its first corner should be the lower one along x, y and z.")
        return corners


class Augmentation:
    """What an episode becomes.

    Args:
        options: see there; enabled.
        reader: of the demonstrations.
        transfer: of them, too.

    Raises:
        CEIError: what objects are to be told by is not in the dataset.
    """

    def __init__(self, options: AugmentOptions, reader: "Source", transfer: Transfer) -> None:
        self._options, self._reader, self._transfer, self._places = options, reader, transfer, options.places
        self._handled: tuple[int, Handling] | None = None
        if options.objects == "segmentation" and not reader.segmented:
            key = schema.SEGMENTATION_PREFIX + "<camera>"
            raise CEIError(
                f"{reader.repo_id} has no {key} as large as a depth camera's; choose other --augment.objects."
            )

    def __len__(self) -> int:
        """Variants of an episode."""
        return len(self._places)

    def offset(self, episode: int, variant: int) -> Offset:
        """Where a variant's objects are moved to, and how far they turn: the same in whatever order they are made."""
        o, place = self._options, self._places[variant]
        most = np.radians(o.rotation_deg)
        return replace(place, yaw_rad=float(np.random.default_rng([o.seed, episode, variant]).uniform(-most, most)))

    def __call__(self, recorded: Demonstration, variant: int) -> tuple[Demonstration, Offset, bool]:
        """A variant of a recorded demonstration, its offset, and whether the objects are still in the workspace there.

        Raises:
            CEIError: the objects' points cannot be told from others in the way that is asked for.
        """
        o, handling, offset = self._options, self._handling(recorded), self.offset(recorded.index, variant)
        frames = handling.approach if o.ramp_over == "approach" else len(recorded)
        moved = displace(recorded, handling, offset, o.ramp * frames, self._objects(recorded, handling))
        assert moved.displacement is not None
        T, place = moved.displacement.T_world_objects, handling.place_world
        low, high = recorded.scene.workspace_world[:, :2]
        there = T[:2, :3] @ place + T[:2, 3]
        return moved, offset, bool((low <= there).all() and (there <= high).all())

    def _handling(self, recorded: Demonstration) -> Handling:
        """What is the same of all variants: of the last one it is known."""
        if self._handled is None or self._handled[0] != recorded.index:
            self._handled = recorded.index, self._transfer.handling(recorded)
        return self._handled[1]

    def _objects(self, recorded: Demonstration, handling: Handling) -> Region | None:
        o = self._options
        if o.objects == "state":
            if recorded.environment_state is None:
                raise CEIError(
                    f"episode {recorded.index} has no {schema.PRIVILEGED_STATE}; choose other --augment.objects."
                )
            return boxes_of_state(recorded.environment_state, recorded.environment_state_names, o.half_m)
        if o.objects == "segmentation":
            return segmented(recorded, self._reader.masks(recorded.index))
        return None if o.box_world is None else carried_box(o.box_world, handling)


def count(left_out: Iterable[str]) -> dict[str, Any]:
    """The result of an augmentation: of each episode why it is left out, empty if it is not."""
    reasons = Counter(left_out)
    kept = reasons.pop("", 0)
    return {"episodes": kept + reasons.total(), "kept": kept, "left_out": dict(reasons)}


def counted(result: dict[str, Any]) -> str:
    """`count` in one line."""
    reasons = ", ".join(f"{n} {reason}" for reason, n in result["left_out"].items())
    return f"{result['kept']} of {result['episodes']} episodes" + (f"; left out: {reasons}" if reasons else "")


def check_left(result: dict[str, Any]) -> None:
    """Check that an episode is left.

    Raises:
        CEIError: none is.
    """
    if not result["kept"]:
        raise CEIError(f"augmentation leaves {counted(result)}; try a smaller --augment.range, or --allow_unreachable.")
