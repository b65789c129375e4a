"""Write demonstrations as a LeRobot v3.0 dataset, all or nothing."""

import contextlib
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from cei_converters import signals
from cei_converters.dataset import schema
from cei_converters.dataset.card import write_card
from cei_converters.dataset.columns import encode
from cei_converters.dataset.encoded import EncodedEpisode, encode_episode
from cei_converters.dataset.episodes import EpisodeWriter
from cei_converters.dataset.essentials import with_essentials
from cei_converters.dataset.home import lerobot_home
from cei_converters.dataset.identity import digest
from cei_converters.dataset.locate import read_info
from cei_converters.dataset.metadata import Environment, Metadata, Provenance, check_scene
from cei_converters.dataset.place import HiddenFolder, absent, publish
from cei_converters.dataset.records import ROWS, Records, RecordWriter
from cei_converters.dataset.step_time import StepTime
from cei_gym.demonstration import Demonstration, Scene
from cei_gym.embodiment import load_embodiment
from cei_gym.errors import CEIError


def default_root(repo_id: str) -> Path:
    """Where LeRobot keeps a local dataset."""
    return lerobot_home() / repo_id


@dataclass(frozen=True)
class Header:
    """What all episodes of a dataset share.

    Attributes:
        embodiment: whose they are.
        fps: frames a second.
        scene: base pose, cameras, workspace.
        features: LeRobot's, without those of passed-through cameras and without what they carry (`essentials`).
    """

    embodiment: str
    fps: float
    scene: Scene
    features: dict[str, dict[str, Any]]

    @classmethod
    def of(cls, demonstration: Demonstration, state_key: str = schema.PRIVILEGED_STATE) -> Self:
        """That of a dataset with this demonstration, the state of its objects under `state_key`."""
        features = schema.features(load_embodiment(demonstration.embodiment), demonstration, state_key)
        return cls(demonstration.embodiment, demonstration.fps, demonstration.scene, features)


class DatasetWriter:
    """Context manager that writes episodes one at a time.

    Files go to a hidden folder beside `root`, whence they move when the block ends well and are removed when
    it does not. Embodiment, scene, rate and features are those of the first episode; others must match them.

    Args:
        repo_id: name of the dataset.
        root: its folder, which must not exist; default: LeRobot's.
        environment: what the episodes replay in.
        clouds: options of the clouds that were made for them; None if they are the cameras' own.
        provenance: how they came about.
        state_key: where `add` puts the state of objects, one of `schema.STATES_OF_OBJECTS`.
        cameras: LeRobot's features of cameras whose pictures pass through.
        carried: LeRobot's features of what is carried over.
        tasks: those that have numbers already, in their order; others follow.
        partial: folder for files, on the same disk, which stays there when the block ends well, for `publish_dataset`; default: one in a
            `HiddenFolder`, published then.

    Attributes:
        partial: folder of unfinished files.
        environment, provenance: as given; the former's start and the latter may be completed until the block ends.
    """

    def __init__(
        self,
        repo_id: str,
        root: str | Path | None = None,
        *,
        environment: Environment | None = None,
        clouds: dict[str, Any] | None = None,
        provenance: Provenance | None = None,
        state_key: str = schema.PRIVILEGED_STATE,
        cameras: Mapping[str, dict[str, Any]] | None = None,
        carried: Mapping[str, dict[str, Any]] | None = None,
        tasks: Sequence[str] = (),
        partial: Path | None = None,
    ) -> None:
        self.repo_id = repo_id
        self.root = Path(root) if root is not None else default_root(repo_id)
        self.environment = environment or Environment()
        self.provenance = provenance or Provenance()
        self._clouds, self._state_key = clouds, state_key
        self._cameras, self._carried, self._tasks = dict(cameras or {}), dict(carried or {}), list(tasks)
        self._hidden = HiddenFolder(self.root, "cei-record") if partial is None else None
        self.partial = partial or HiddenFolder(self.root, "cei-record").path / "dataset"
        self._token = object()
        self._header: Header | None = None
        self._episodes: EpisodeWriter | None = None
        self._records: RecordWriter | None = None
        self._count, self._written = 0, False

    def __enter__(self) -> Self:
        self._token = signals.begin(self._leave)
        try:
            if self._hidden is None:
                absent(self.root)
            else:
                self._hidden.acquire()
        except Exception:
            signals.end(self._token)
            raise
        if self.partial.exists():  # of a process that was killed
            shutil.rmtree(self.partial)
        return self

    def add(self, demonstration: Demonstration, record: dict[str, Any] | None = None) -> None:
        """Write one episode.

        Args:
            demonstration: the episode.
            record: what `meta/cei_episodes.jsonl` shall keep of it (seed, quality, ...).

        Raises:
            CEIError: the episode does not match the first one, or a depth is out of range.
        """
        header = Header.of(demonstration, self._state_key)
        columns = encode(demonstration, self._state_key)
        self.append(header, encode_episode(columns, header.features, demonstration.task), record)

    def append(self, header: Header, episode: EncodedEpisode, record: dict[str, Any] | None = None) -> None:
        """Write one episode that is encoded already, with what passes through and what is carried over; see `add`."""
        if self._header is None:
            self._start(header)
        else:
            _check_same(self._header, header, f"episode {self._count}")
        assert self._episodes is not None and self._records is not None
        self._episodes.add(episode)
        rows = digest(episode.table, header.features, f"episode {self._count}")
        self._records.add({**(record or {}), ROWS: rows})
        self._count += 1

    def _start(self, header: Header) -> None:
        check_scene(header.scene, "episode 0")
        self._header = header
        self._episodes = EpisodeWriter(
            self.repo_id,
            self.partial,
            fps=int(header.fps) if header.fps == int(header.fps) else header.fps,
            features=with_essentials(header.features | self._cameras | self._carried, self._metadata()),
            robot_type=header.embodiment,
            tasks=self._tasks,
        )
        self._records = RecordWriter(self.partial)

    def _metadata(self) -> Metadata:
        assert self._header is not None
        return Metadata(
            embodiment=self._header.embodiment,
            scene=self._header.scene,
            environment=self.environment,
            clouds=self._clouds,
            total_episodes=self._count,
            provenance=self.provenance,
        )

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if error is None:
                self._finish()
        finally:
            self._leave()
            signals.end(self._token)

    def _leave(self) -> None:
        with contextlib.ExitStack() as each:  # is done whatever becomes of the others, last first
            if self._hidden is not None:
                each.callback(self._hidden.release, keep=False)
            if not self._written:
                each.callback(shutil.rmtree, self.partial, ignore_errors=True)
            if self._records is not None:
                each.callback(self._records.close)
            if self._episodes is not None:
                each.callback(self._episodes.finalize)

    def _finish(self) -> None:
        if self._header is None or self._episodes is None or self._records is None:
            raise CEIError(f"no episode was written, so {self.root} is not made.")
        self._episodes.finalize()
        self._episodes.check()
        self._records.close()
        if self._hidden is None:
            self._written = True
        else:
            publish_dataset(self.partial, self.root, self.repo_id, self._metadata())


def publish_dataset(partial: Path, root: Path, repo_id: str, metadata: Metadata) -> None:
    """Complete a dataset whose episodes are written, by its metadata and card, and move it to where it is wanted.

    Args:
        partial: where it is.
        root: where it is wanted.
        repo_id: its name.
        metadata: what is known of it; how long steps took, its records say.

    Raises:
        CEIError: something is there now.
    """
    metadata = replace(metadata, step_time_s=StepTime.of(Records(partial), read_info(partial)["fps"]))
    metadata.save(partial)
    write_card(partial, repo_id, metadata)
    publish(partial, root)


def _check_same(first: Header, other: Header, where: str) -> None:
    for what in ("embodiment", "fps"):
        ours, theirs = getattr(first, what), getattr(other, what)
        if ours != theirs:
            raise CEIError(f"{where}: {what} is {theirs} but the dataset's is {ours}.")
    if not _same_scene(first.scene, other.scene):
        raise CEIError(f"{where}: base, cameras or workspace differ from episode 0; use one dataset a scene.")
    for key in sorted(first.features.keys() | other.features.keys()):
        expected, got = (_shape(found.features.get(key)) for found in (first, other))
        if expected != got:
            raise CEIError(f"{where}: {key} has shape {got} but the dataset's is {expected}.")


def _shape(feature: dict[str, Any] | None) -> list[int] | None:
    """A feature's shape, that which it lies flat of where it does."""
    return None if feature is None else (feature.get("info") or {}).get("shape") or [*feature["shape"]]


def _same_scene(a: Scene, b: Scene) -> bool:
    return (
        np.allclose(a.T_world_base, b.T_world_base)
        and np.allclose(a.workspace_world, b.workspace_world)
        and a.support_z_m == b.support_z_m
        and len(a.cameras) == len(b.cameras)
        and all(
            (one.name, one.width, one.height) == (other.name, other.width, other.height)
            and np.allclose(one.K, other.K)
            and np.allclose(one.T_world_camera, other.T_world_camera)
            and one.lag_s == other.lag_s
            for one, other in zip(a.cameras, b.cameras, strict=True)
        )
    )
