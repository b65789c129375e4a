"""What is shown: an episode's robots, pads and clouds in the world, on one timeline."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from cei_converters.dataset.corrections import Corrected, held_in_words
from cei_gym.alignment import AlignmentProblem, SolverOptions
from cei_gym.alignment.judge.report import pad_residuals
from cei_gym.arrays import Array
from cei_gym.demonstration import Demonstration
from cei_gym.embodiment import Embodiment
from cei_gym.errors import CEIError
from cei_gym.functional import FunctionalRepresentation, sample_representation
from cei_gym.kinematics import KinematicTree
from cei_gym.transfer import TransferOptions

if TYPE_CHECKING:
    from cei_converters.sources.source import Source

RESIDUALS = {"pad_distance_mm": "mean pad distance (mm)", "normal_angle_deg": "mean angle between normals (deg)"}
NORMAL_M = 0.015
"""How long a normal is drawn."""
_VIEW_DIRECTION = 1.0, 0.7, 0.45  # in the base frame, towards the eye: the robot faces us and a little left


@dataclass(frozen=True)
class Side:
    """One robot's episode of T frames, in the world.

    Attributes:
        role: "source", "target", or "dataset" if it is shown alone; "uncorrected" is what the target would do without its correction.
        embodiment: the robot.
        demonstration: the frames shown.
        frames: (T,) which frames of its own dataset's episode these are.
        T_world_links: (T, L, 4, 4) link poses.
        representation: its pads, as `cei-convert` samples them by default.
        points_world, normals_world: (T, N, 3) pads, m and unit.
        pictures: feature of each RGB camera to (T, H, W, 3) uint8, where they are shown, too.
    """

    role: str
    embodiment: Embodiment
    demonstration: Demonstration
    frames: Array
    T_world_links: Array
    representation: FunctionalRepresentation
    points_world: Array
    normals_world: Array
    pictures: Mapping[str, Array] = field(default_factory=dict[str, Array])

    @property
    def label(self) -> str:
        """Role and robot."""
        name = self.embodiment.name
        return name if self.role == "dataset" else f"{self.role}: {name}"

    @property
    def whose(self) -> str:
        """For its pads, in a legend."""
        return {"dataset": "finger", "uncorrected": "uncorrected"}.get(self.role, f"{self.role}'s")

    @property
    def pads_rgb(self) -> tuple[int, int, int]:
        """Colour of its pads: a source's are blue, what is not corrected is amber, others red."""
        return {"source": (40, 110, 230), "uncorrected": (235, 150, 0)}.get(self.role, (230, 50, 40))

    def towards_eye(self, direction_base: tuple[float, float, float]) -> Array:
        """(3,) unit vector in the world of a direction in the base frame."""
        direction = self.demonstration.scene.T_world_base[:3, :3] @ direction_base
        return direction / np.linalg.norm(direction)


@dataclass(frozen=True)
class View:
    """What is shown side by side, all of T frames.

    Attributes:
        sides: the source, if it is shown, then the dataset's own.
        title: dataset, episode and task in one line.
        residuals: `pad_distance_mm` and `normal_angle_deg`, (T,) each, between source and target; empty without a source, or where
            objects were moved.
        correction: what a refined conversion has corrected, as numbers, in one line; empty if nothing.
        uncorrected: the dataset's robot without it, in the one frame in which the dataset says where that would be; None if it does not.
    """

    sides: tuple[Side, ...]
    title: str
    residuals: dict[str, Array]
    correction: str = ""
    uncorrected: Side | None = None

    def __len__(self) -> int:
        return len(self.sides[0].frames)

    @property
    def times_s(self) -> Array:
        """(T,) time of each frame."""
        return np.arange(len(self)) / self.sides[-1].demonstration.fps

    def eye_and_target(self) -> tuple[Array, Array]:
        """Two (3,) points in the world, from where and at what to look to see both robots and wherever their pads go."""
        parts = [side.points_world.reshape(-1, 3) for side in self.sides]
        parts += [side.T_world_links[:, 1:, :3, 3].reshape(-1, 3) for side in self.sides]
        seen = np.concatenate(parts)
        low, high = seen.min(axis=0), seen.max(axis=0)
        distance_m = 1.5 * np.linalg.norm(high - low)
        return (low + high) / 2 + distance_m * self.sides[-1].towards_eye(_VIEW_DIRECTION), (low + high) / 2


def cloud_rgb(demonstration: Demonstration, t: int) -> Array:
    """(P, 3) uint8 colours of the cloud's points at a frame: their own if it has any, else by height in the workspace."""
    from matplotlib import colormaps

    assert demonstration.point_cloud_world is not None
    cloud = demonstration.point_cloud_world[t]
    if cloud.shape[1] == 6:
        return (255 * np.clip(cloud[:, 3:], 0, 1)).round().astype(np.uint8)
    low, high = demonstration.scene.workspace_world[:, 2]
    return colormaps["viridis"]((cloud[:, 2] - low) / (high - low), bytes=True)[:, :3]


def load_view(reader: "Source", index: int, source: "Source | None" = None, pictures: bool = False) -> View:
    """Read an episode, and what it was converted from if that is to be shown too.

    Args:
        reader: of the dataset.
        index: which episode.
        source: of the dataset that it was converted from.
        pictures: whether those of RGB cameras are shown, too.

    Raises:
        CEIError: no such episode, or the source is not what it was converted from.
    """
    demonstration = reader.read(index)
    title = f"{reader.repo_id}, episode {index}"
    if demonstration.task:
        title += f" ({' '.join(demonstration.task.split()).rstrip('.')})"
    role = "dataset" if source is None else "target"
    target = make_side(role, reader.embodiment, demonstration, np.arange(len(demonstration)))
    target = _with_pictures(target, reader, index) if pictures else target
    correction = _correction(reader.record(index), target, title)
    if source is None:
        return View((target,), title, {}, *correction)
    source_index, frames = _origin(reader, index, len(demonstration), source)
    recorded = source.read(source_index).at(frames)
    before = make_side("source", source.embodiment, recorded, frames)
    before = _with_pictures(before, source, source_index) if pictures else before
    if "offset" in reader.record(index):
        return View((before, target), f"{title}, objects moved", {}, *correction)  # not where the source's pads were
    return View((before, target), title, _residuals(before, target), *correction)


def _with_pictures(side: Side, reader: "Source", index: int) -> Side:
    keys = [key for key, feature in reader.cameras.items() if feature["shape"][-1] == 3]
    try:
        seen = reader.pictures(index)
        return replace(side, pictures={key: seen.decode(key)[side.frames] for key in keys})
    except CEIError as error:  # what is missing of pictures is no reason to show nothing
        print(f"note: no pictures are shown: {error}")
        return side


def _correction(record: dict[str, Any], target: Side, where: str) -> tuple[str, Side | None]:
    """What is corrected in an episode, in numbers, and its robot without that."""
    shown = target.demonstration
    found = Corrected.of(record, len(shown), len(target.embodiment.joint_names), where)
    if found is None:
        return "", None
    held = held_in_words(record)
    q = np.array([found.plain_qpos])
    without = Demonstration(shown.embodiment, shown.fps, q, q, shown.scene)
    side = make_side("uncorrected", target.embodiment, without, np.array([found.frame]))
    return f"corrected: {found.correction}{held and f'; {held}'}", side


def _origin(reader: "Source", index: int, length: int, source: "Source") -> tuple[int, Array]:
    """Episode of the source, and which of its frames each frame of an episode shows: all in turn if it does not say."""
    record, source_index = reader.record(index), reader.source_episode(index)
    where = f"{reader.repo_id}, episode {index}"
    _check_source(reader, record, source, where)
    if not isinstance(source_index, int) or not 0 <= source_index < len(source):
        raise CEIError(f"{where} was converted from episode {source_index}, which {source.repo_id} does not have.")
    of_source = source.frames(source_index)
    frames = record.get("source_frames", list(range(length)))
    if "source_frames" not in record and of_source != length:
        raise CEIError(
            f"{where} has {length} frames, episode {source_index} of {source.repo_id} has {of_source}, and no "
            "source_frames say which is which; convert it again, name another --source, or leave it out."
        )
    good = isinstance(frames, list) and all(isinstance(t, int) and 0 <= t < of_source for t in frames)
    if not good or len(frames) != length:
        raise CEIError(
            f"{where}: source_frames should be {length} frames of episode {source_index} of {source.repo_id}, "
            f"0 to {of_source - 1}; is --source the dataset that it was converted from?"
        )
    return source_index, np.array(frames)


def _check_source(reader: "Source", record: dict[str, Any], source: "Source", where: str) -> None:
    """Check that the source is what metadata says, as far as it does: of the robot, and, of a merged dataset, of the name."""
    if reader.metadata is None:
        return
    origin = reader.metadata.provenance_of(record, where).source
    if origin is None:
        return
    if origin.embodiment != source.embodiment.name:
        raise CEIError(f"{where} was converted from {origin.embodiment}; --source is of {source.embodiment.name}.")
    if reader.metadata.merged and not {origin.repo_id, origin.root_name} & {source.repo_id, source.root.name}:
        raise CEIError(f"{where} was converted from {origin.repo_id}; --source is {source.repo_id}.")


def make_side(role: str, embodiment: Embodiment, demonstration: Demonstration, frames: Array) -> Side:
    """One side of a view; `frames` are (T,) indices in its own dataset's episode."""
    options = TransferOptions()
    representation = sample_representation(embodiment, options.points, options.seed)
    T_world_links = demonstration.scene.T_world_base @ KinematicTree(embodiment).forward(demonstration.qpos)
    pads = representation.place(T_world_links)
    return Side(role, embodiment, demonstration, frames, T_world_links, representation, *pads)


def _residuals(source: Side, target: Side) -> dict[str, Array]:
    """How far the pads are apart, as `cei-convert` measures it by default."""
    T_base_world = np.linalg.inv(target.demonstration.scene.T_world_base)
    R, p = T_base_world[:3, :3], T_base_world[:3, 3]
    distance_mm, angle_deg = pad_residuals(
        AlignmentProblem(target.representation, KinematicTree(target.embodiment)),
        source.points_world @ R.T + p,
        source.normals_world @ R.T,
        target.embodiment.coupled.reduce(target.demonstration.qpos),
        SolverOptions().lambda_m,
    )
    return {"pad_distance_mm": distance_mm, "normal_angle_deg": angle_deg}
