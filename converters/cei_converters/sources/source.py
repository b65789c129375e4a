"""What is converted: recorded episodes, whatever format they are in."""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from cei_converters.dataset.cameras import Pictures
from cei_converters.dataset.carried import Carried
from cei_converters.dataset.essentials import Remains
from cei_converters.dataset.metadata import Environment, Metadata, restore_with
from cei_converters.sources.actions import BoundActions
from cei_converters.sources.binding import BoundJointMap
from cei_converters.sources.checks import LEAST_FRAMES, check_finite, likely_unit
from cei_converters.sources.joint_map import ABSOLUTE
from cei_converters.sources.plausible import check_actions
from cei_gym.arrays import Array
from cei_gym.demonstration import Demonstration, Scene
from cei_gym.embodiment import Embodiment
from cei_gym.errors import CEIError, unknown
from cei_gym.kinematics.inverse import follow_link

# how far outside its range a joint may be read, before its unit must be wrong
UNIT_SLACK = {"rad": np.pi, "m": 0.5}


@dataclass(frozen=True)
class Joints:
    """An episode's joints.

    Attributes:
        qpos, action: (T, n) positions and targets, rad or m.
        figures: how well they could be had, such as `ik_position_mm`.
    """

    qpos: Array
    action: Array
    figures: Mapping[str, float] = field(default_factory=dict[str, float])


class Source(ABC):
    """Recorded episodes of one embodiment.

    Attributes:
        repo_id: name of the dataset.
        root: its folder or file.
        embodiment, scene: of all its episodes.
        quick: whether joints are read in no time: not by inverse kinematics.
        table_from: who says where the scene's table is; empty if nobody does.
        metadata: contents of `meta/cei.json`, or None.
        records: what is known of each episode (seed, quality, ...), of those that it is known of.
        fps: frames a second.
        has_clouds: whether point clouds are recorded.
        segmented: whether pictures say where depth cameras see objects.
        depth_cameras: names of the cameras whose depth is read.
        cameras: LeRobot's features of the others, whose pictures are not looked at.
        carried: LeRobot's features of what does not depend on the robot, and is carried over.
        dropped: names of what is neither read, carried nor a picture, and why.
    """

    repo_id: str
    root: Path
    embodiment: Embodiment
    scene: Scene
    quick: bool = True
    table_from: str = ""
    metadata: Metadata | None = None
    records: Sequence[Mapping[str, Any]] = ()
    fps: float
    has_clouds: bool = False
    segmented: bool = False
    depth_cameras: tuple[str, ...] = ()
    cameras: Mapping[str, dict[str, Any]] = {}
    carried: dict[str, dict[str, Any]]
    dropped: dict[str, str]

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether what a path holds, which is none of our own formats, is of this one; for formats of other packages (`formats`)."""
        return False

    @property
    def environment(self) -> Environment:
        """What its episodes replay in, if anything says."""
        return Environment() if self.metadata is None else self.metadata.environment

    @property
    def tasks(self) -> list[str]:
        """All of the dataset's, in the order of their numbers, where it has them; else none."""
        return []

    @property
    def carries(self) -> bool:
        """Whether `carry` has anything: columns, or tasks that may differ from frame to frame."""
        return bool(self.carried)

    @abstractmethod
    def __len__(self) -> int: ...

    @abstractmethod
    def frames(self, index: int) -> int:
        """Frames of an episode, without reading it."""

    @abstractmethod
    def read(self, index: int, *, clouds: bool = True, colours: bool = True) -> Demonstration:
        """One episode.

        Args:
            index: which.
            clouds: also read what cameras saw, depth and point clouds: nearly all of an episode's bytes.
            colours: with them pictures that belong to depth: those of a feature named after a calibrated depth camera, of its size.

        Raises:
            CEIError: it is absent, empty, unreadable, not finite, or in the wrong unit.
        """

    def __iter__(self) -> Iterator[Demonstration]:
        return (self.read(index) for index in range(len(self)))

    def record(self, index: int) -> dict[str, Any]:
        """What is known of an episode; empty if nothing is."""
        return dict(self.records[index]) if index < len(self.records) else {}

    def source_episode(self, index: int) -> int:
        """Which episode of the dataset that it was converted from an episode was.

        Raises:
            CEIError: nothing says so.
        """
        found = self.record(index).get("source_episode")
        if found is None:
            lost = isinstance(self.metadata, Remains)
            raise CEIError(
                f"{self.repo_id} does not say what its episode {index} was converted from; leave --source out."
                + (f" {restore_with(self.root)}" if lost else "")
            )
        return found

    def check_videos(self, episodes: Sequence[int]) -> None:  # noqa: B027  (most formats have none)
        """Check that episodes' video files are there.

        Raises:
            CEIError: one is missing.
        """

    def pictures(self, index: int) -> Pictures:
        """What an episode's RGB cameras saw, as it is stored.

        Raises:
            CEIError: a picture, a video or statistics are missing.
        """
        return Pictures()

    def carry(self, index: int) -> Carried:
        """What does not depend on the robot, as it is stored.

        Raises:
            CEIError: it is missing or damaged.
        """
        return Carried()

    def set_table(self, z_m: float, said_by: str) -> None:
        """Say where the table is: its height in the world, m."""
        self.scene, self.table_from = replace(self.scene, table_z_m=z_m), said_by

    def keep_cameras(self, keys: Sequence[str], reason: str) -> None:
        """Have pictures of these cameras only; the others are dropped, for a reason."""
        self.dropped |= {key: reason for key in self.cameras if key not in keys}
        self.cameras = {key: feature for key, feature in self.cameras.items() if key in keys}

    def drop(self, names: Sequence[str], reason: str) -> None:
        """Carry features no more.

        Raises:
            CEIError: one is not carried.
        """
        for name in names:
            if name not in self.carried:
                raise unknown("feature that is carried over", name, self.carried)
            del self.carried[name]
            self.dropped[name] = reason

    def masks(self, index: int) -> dict[str, Array]:
        """Depth camera's name to (T, H, W) bool, where it sees objects; none without a feature that says so.

        Raises:
            CEIError: a picture or a video is missing or damaged.
        """
        return {}

    def select(self, episodes: Sequence[int] | None) -> list[int]:
        """Checked episode indices; None selects all.

        Raises:
            CEIError: the selection is empty, repeats an index, or has one that the dataset lacks.
        """
        if episodes is None:
            return list(range(len(self)))
        if not episodes:
            raise CEIError("the selection of episodes is empty.")
        for index in episodes:
            if not 0 <= index < len(self):
                raise CEIError(f"{self.repo_id} has no episode {index}. Valid: 0 to {len(self) - 1}.")
        (most, times), *_ = Counter(episodes).most_common(1)
        if times > 1:
            raise CEIError(f"the selection of episodes repeats {most}.")
        return list(episodes)

    def joints(
        self,
        state: Array,
        values: Array | None,
        index: int,
        bound: BoundJointMap | None,
        actions: BoundActions | None,
    ) -> Joints:
        """Checked joints of an episode.

        Args:
            state: (T, k) as recorded.
            values: (T, l) of the feature with the actions, likewise.
            index: of the episode.
            bound: which columns of the state are which joints; None if they are the embodiment's, in its order.
            actions: what the others say; None takes the next frame's state for them.

        Raises:
            CEIError: a value is not finite, or in the wrong unit, or actions are not what they are said to be.
        """
        where = f"episode {index}"
        state = state.astype(np.float64)
        if not len(state):
            raise CEIError(f"{where} has no frames; leave it out with --episodes or record it again.")
        qpos, figures = state if bound is None else bound.qpos(state), {}
        if bound is not None and bound.pose is not None:
            check_finite(state[:, bound.pose_columns], where, "pose", [f"column {c}" for c in bound.pose_columns])
            qpos, figures = self._recover(bound, state, qpos, where)
        self._check_values(qpos, where, "observation.state")
        self._check_widths(qpos, where)
        if actions is None or values is None:
            return Joints(qpos, np.concatenate([qpos[1:], qpos[-1:]]), figures)
        values = values.astype(np.float64)
        if not np.isfinite(values[:, actions.column]).all():
            check_finite(values, where, actions.feature, [f"column {c}" for c in range(values.shape[1])])
        body = self.embodiment
        # before limits clip them: what is far off is in the wrong unit
        meant = np.where(actions.of_kind(ABSOLUTE), actions.absolute(values), body.coupled.reduce(qpos))
        self._check_values(body.coupled.expand(meant), where, actions.feature)
        check_actions(actions, values, qpos, self.fps, where)
        if actions.as_it_is:
            self._check_values(values, where, actions.feature)
        return Joints(qpos, actions.targets(values, qpos, self.fps), figures)

    def _recover(self, bound: BoundJointMap, state: Array, qpos: Array, where: str):
        assert bound.pose is not None and self.embodiment.arm is not None
        link = self.embodiment.body_id(bound.pose.link or self.embodiment.arm.mount_body)
        T_base_link = bound.pose.T_base_link(state[:, bound.pose_columns], self.scene.T_world_base, where)
        found = follow_link(self.embodiment, link, T_base_link)
        n_arm = self.embodiment.n_arm
        figures = {
            "ik_position_mm": float(1e3 * found.position_m.max()),
            "ik_angle_deg": float(np.degrees(found.angle_rad.max())),
        }
        return np.column_stack([found.qpos[:, :n_arm], qpos[:, n_arm:]]), figures

    def _check_values(self, values: Array, where: str, key: str) -> None:
        """values: (T, n) rad or m."""
        body = self.embodiment
        check_finite(values, where, key, [f"joint {name}" for name in body.joint_names])
        slack = np.array([UNIT_SLACK[unit] for unit in body.joint_units])
        far = np.argwhere((values < body.lower - slack) | (values > body.upper + slack))
        if len(far):
            frame, joint = map(int, far[0])
            unit = body.joint_units[joint]
            raise CEIError(
                f"{where}, frame {frame}, joint {body.joint_names[joint]}: {key} is {values[frame, joint]:.4g} {unit}, far outside "
                f"{self._limits(joint)}; it looks like {likely_unit(unit, float(np.abs(values[:, joint]).max()))}."
            )

    def _check_widths(self, qpos: Array, where: str) -> None:
        """Refuse fingers that slide and are far beyond their limits for long: the distance of two is twice as much."""
        body = self.embodiment
        for q in body.coupled.independent if len(qpos) >= LEAST_FRAMES else ():
            wide = qpos[:, q] > body.upper[q] + 0.5 * (body.upper[q] - body.lower[q])
            if q >= body.n_arm and body.joint_units[q] == "m" and wide.mean() > 0.1:
                raise CEIError(
                    f"{where}, frame {np.argmax(wide)}, joint {body.joint_names[q]}: observation.state is {qpos[np.argmax(wide), q]:.4g} m, far "
                    f"outside {self._limits(q)}, and so in {100 * wide.mean():.0f} % of the frames; it looks like the distance of two fingers, or another "
                    "gripper's; a joint map says so by unit: normalised, range: [closed, open]."
                )

    def _limits(self, q: int) -> str:
        body = self.embodiment
        return f"[{body.lower[q]:.4g}, {body.upper[q]:.4g}] {body.joint_units[q]}"
