"""Spatial augmentation: a demonstration as it would have been with its objects elsewhere (the paper's section VII-A1).

The objects stand displaced by T_i from the first frame on; the source's hand goes there by and by, L(t) of the way at frame t, and
is with them as it was recorded once L is 1.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from cei_gym.arrays import Array
from cei_gym.channels import OnDisplacement, entry_names, present
from cei_gym.demonstration import Demonstration
from cei_gym.displacement import Boxes, Displacement, Region, Seen
from cei_gym.errors import CEIError
from cei_gym.pointcloud import fuse_depth

RAMP = 0.8
"""Share of the way's frames after which all of the offset is reached (the paper's)."""
_MARGIN_M = 0.01  # around what the state says of an object: depth is noisy
_SAME_M = 0.002  # two clouds of one camera have the same points
_QUATERNION = ("qw", "qx", "qy", "qz")
_HALF = ("half_x_m", "half_y_m", "half_z_m")


@dataclass(frozen=True)
class Offset:
    """How objects are displaced.

    Attributes:
        x_m, y_m: along the world's axes.
        yaw_rad: turn about the vertical through where the hand first takes hold.
    """

    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0


@dataclass(frozen=True)
class Handling:
    """What a recorded hand does to objects over T frames (`Transfer.handling`).

    Attributes:
        held: (T,) whether it holds something.
        middle_world: (T, 3) middle of its pads, m.
        T_world_hand: (T, 4, 4) pose of its root: what is held moves with it.
        touched: (T,) whether its pads are at something, of a hand that never holds anything and of which clouds show what is there; else nowhere.
    """

    held: Array
    middle_world: Array
    T_world_hand: Array
    touched: Array

    @property
    def approach(self) -> int:
        """Frames before something is held, or, where nothing ever is, touched for the first time; all of them where neither is ever."""
        handled = self.held if self.held.any() else self.touched
        return int(handled.argmax()) if handled.any() else len(handled)

    @property
    def place_world(self) -> Array:
        """(3,) where it first takes hold, or touches something, or ends, m."""
        return self.middle_world[min(self.approach, len(self.held) - 1)]


def grid_offsets(positions: tuple[int, int], extent_m: tuple[float, float]) -> list[Offset]:
    """Offsets on a grid around no offset.

    Args:
        positions: how many along x and y; a single one is in the middle.
        extent_m: from the first to the last along x and y.
    """
    x, y = (np.linspace(-e / 2, e / 2, n) if n > 1 else np.zeros(1) for n, e in zip(positions, extent_m, strict=True))
    return [Offset(float(a), float(b)) for a in x for b in y]


def anchored(anchors: Sequence[Offset], around: Sequence[Offset]) -> list[Offset]:
    """Offsets by each anchor, and around each of them by what is around no offset."""
    return [
        replace(near, x_m=anchor.x_m + near.x_m, y_m=anchor.y_m + near.y_m) for anchor in anchors for near in around
    ]


def ramp(frames: int, whole: float) -> Array:
    """L(t), the clipped linear ramp.

    Args:
        frames: T.
        whole: the frame, maybe a fraction, from which on it is 1.

    Returns:
        (T,) from 0 to 1; 1 throughout where `whole` is 0.
    """
    return np.minimum(np.arange(frames) / whole, 1.0) if whole > 0 else np.ones(frames)


def displacement(offset: Offset, about_world: Array, share: Array | float = 1.0) -> Array:
    """(..., 4, 4) rigid motion in the world by a share of an offset, which turns about the vertical through a point (3,), m.

    The paper moves points by a share of the straight line between X and T_i(X); a turn would shrink pads on the way. Here the
    angle grows by that share; without a turn both are the same.
    """
    share = np.asarray(share, float)
    T = np.tile(np.eye(4), (*share.shape, 1, 1))
    T[..., :3, :3] = Rotation.from_rotvec(share[..., None] * [0, 0, offset.yaw_rad]).as_matrix()
    way = share[..., None] * [offset.x_m, offset.y_m, 0]
    T[..., :3, 3] = about_world + way - T[..., :3, :3] @ about_world
    return T


def displace(
    demonstration: Demonstration,
    handling: Handling,
    offset: Offset,
    whole: float,
    objects: Region | None = None,
) -> Demonstration:
    """A demonstration with its objects elsewhere, to be transferred (`Transfer`).

    Args:
        demonstration: as recorded.
        handling: what its hand does.
        offset: T_i.
        whole: the frame from which on the hand has gone all of it: L(t) = min(t / whole, 1).
        objects: which points of the clouds are moved; None for all but the source's.

    Returns:
        The same joints, clouds and images, with a `displacement`; states of objects are already moved.
    """
    about = handling.place_world
    T_world_objects = displacement(offset, about)
    there = {
        name: move_state(value, entry_names(demonstration, name), T_world_objects)
        if declared.on_displacement is OnDisplacement.MOVE
        else declared.nothing
        for name, declared, value in present(demonstration)
        if declared.on_displacement is not OnDisplacement.AS_RECORDED
    }
    T_world_source = displacement(offset, about, ramp(len(demonstration), whole))
    moved = Displacement(T_world_objects, T_world_source, objects)
    return replace(demonstration, **there, displacement=moved)


def move_state(state: Array, names: tuple[str, ...], T_world: Array) -> Array:
    """(T, k) state of objects that all move as one.

    Args:
        state: (T, k) as recorded.
        names: k names; those of an object's pose are `<object>.x_m`, `.y_m`, and `.qw` to `.qz` or `.yaw_rad`.
        T_world: (4, 4) horizontal motion.

    Raises:
        CEIError: no name is that of an object's place.
    """
    R, p, moved = Rotation.from_matrix(T_world[:3, :3]), T_world[:2, 3], state.copy()
    for column in _objects(names).values():
        place = [column["x_m"], column["y_m"]]
        moved[:, place] = state[:, place] @ T_world[:2, :2].T + p
        if "qw" in column:
            turn = [column[name] for name in _QUATERNION]
            moved[:, turn] = (R * Rotation.from_quat(state[:, turn], scalar_first=True)).as_quat(scalar_first=True)
        if "yaw_rad" in column:
            yaw = state[:, column["yaw_rad"]] + R.as_rotvec()[2]
            moved[:, column["yaw_rad"]] = (yaw + np.pi) % (2 * np.pi) - np.pi
    return moved


def boxes_of_state(state: Array, names: tuple[str, ...], half_m: float | None = None) -> Boxes:
    """Where objects are by the task's state, a centimetre of margin around them.

    Args:
        state: (T, k) as recorded.
        names: see `move_state`; sizes are `<object>.half_x_m`, `.half_y_m`, `.half_z_m`.
        half_m: half size of objects whose size is not in the state.

    Raises:
        CEIError: no object, or the size of one is not known.
    """
    poses, halves = [], []
    for name, column in _objects(names).items():
        T = np.tile(np.eye(4), (len(state), 1, 1))
        T[:, 0, 3], T[:, 1, 3] = state[:, column["x_m"]], state[:, column["y_m"]]
        if "z_m" in column:
            T[:, 2, 3] = state[:, column["z_m"]]
        if "qw" in column:
            turn = [column[entry] for entry in _QUATERNION]
            T[:, :3, :3] = Rotation.from_quat(state[:, turn], scalar_first=True).as_matrix()
        elif "yaw_rad" in column:
            T[:, :3, :3] = Rotation.from_euler("z", state[:, column["yaw_rad"]]).as_matrix()
        if all(entry in column for entry in _HALF):
            half = state[0, [column[entry] for entry in _HALF]]
        elif half_m is not None:
            half = np.array([half_m, half_m, half_m if "z_m" in column else np.inf])
        else:
            raise CEIError(f"the state does not say how large {name} is ({name}.half_x_m, ...); give --augment.half_m.")
        poses.append(T)
        halves.append(half + _MARGIN_M)
    return Boxes(np.stack(poses, axis=1), np.array(halves))


def carried_box(box_world: Array, handling: Handling) -> Boxes:
    """A box in which objects are at first, and the same box wherever the hand has carried it.

    Args:
        box_world: (2, 3) lower and upper corner, m.
        handling: what the hand does.
    """
    T = np.tile(np.eye(4), (len(handling.held), 2, 1, 1))
    T[:, :, :3, 3] = box_world.mean(axis=0)
    for t in range(1, len(T)):
        T[t, 1] = T[t - 1, 1]
        if handling.held[t] and handling.held[t - 1]:
            T[t, 1] = handling.T_world_hand[t] @ np.linalg.inv(handling.T_world_hand[t - 1]) @ T[t - 1, 1]
    return Boxes(T, np.tile(np.diff(box_world, axis=0) / 2, (2, 1)))


def segmented(demonstration: Demonstration, masks: Mapping[str, Array]) -> Seen:
    """What images show to be objects.

    Args:
        demonstration: with depth images.
        masks: camera name to (T, H, W) bool, pixel for pixel with its depth.
    """
    d = demonstration
    objects = [
        fuse_depth(d.scene, {name: np.where(mask[t], d.depth_m[name][t], 0) for name, mask in masks.items()})
        for t in range(len(d))
    ]
    return Seen(objects, _SAME_M)


def _objects(names: tuple[str, ...]) -> dict[str, dict[str, int]]:
    """Find the columns of each object whose place is among the names."""
    columns: dict[str, dict[str, int]] = {}
    for i, name in enumerate(names):
        of, _, entry = name.rpartition(".")
        columns.setdefault(of, {})[entry] = i
    found = {name: column for name, column in columns.items() if {"x_m", "y_m"} <= column.keys()}
    if not found:
        raise CEIError(
            f"no object's place is in the state of objects, whose names are {', '.join(names)}; "
            "augmented starts need <object>.x_m and <object>.y_m."
        )
    return found
