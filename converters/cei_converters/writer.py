"""Write demonstrations as a LeRobot v3.0 dataset, all or nothing."""

import contextlib
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from cei_converters import schema
from cei_converters.cameras import Pictures
from cei_converters.card import write_card
from cei_converters.columns import encode
from cei_converters.episodes import EpisodeWriter
from cei_converters.metadata import Environment, Metadata, Provenance, check_scene, plain
from cei_gym.demonstration import Demonstration, Scene
from cei_gym.embodiment import load_embodiment
from cei_gym.errors import CEIError


def default_root(repo_id: str) -> Path:
    """Where LeRobot keeps a local dataset."""
    from lerobot.utils.constants import HF_LEROBOT_HOME

    return HF_LEROBOT_HOME / repo_id


class DatasetWriter:
    """Context manager that writes episodes one at a time.

    Files go to a hidden sibling of `root`, which becomes `root` when the block ends well and is removed when
    it does not. Embodiment, scene, rate and features are those of the first episode; others must match them.

    Args:
        repo_id: name of the dataset.
        root: its folder, which must not exist; default: LeRobot's.
        environment: what the episodes replay in.
        provenance: how they came about.
        cameras: LeRobot's features of cameras whose pictures pass through.

    Attributes:
        environment, provenance: as given; they may be completed until the block ends.
    """

    def __init__(
        self,
        repo_id: str,
        root: str | Path | None = None,
        *,
        environment: Environment | None = None,
        provenance: Provenance | None = None,
        cameras: Mapping[str, dict] | None = None,
    ) -> None:
        self.repo_id = repo_id
        self.root = Path(root) if root is not None else default_root(repo_id)
        self.environment = environment or Environment()
        self.provenance = provenance or Provenance()
        self._cameras = dict(cameras or {})
        self._partial = self.root.parent / f".{self.root.name}.partial-{os.getpid()}"
        self._new_folders: list[Path] = []
        self._records: list[dict[str, Any]] = []
        self._first: Demonstration | None = None
        self._features: dict[str, dict] = {}
        self._episodes: EpisodeWriter | None = None

    def __enter__(self) -> Self:
        if self.root.exists():
            raise CEIError(f"{self.root} already exists; choose another folder or remove it first.")
        folders = (self.root.parent, *self.root.parent.parents)
        self._new_folders = [folder for folder in folders if not folder.exists()]
        self.root.parent.mkdir(parents=True, exist_ok=True)
        return self

    def add(
        self, demonstration: Demonstration, record: dict[str, Any] | None = None, pictures: Pictures | None = None
    ) -> None:
        """Write one episode.

        Args:
            demonstration: the episode.
            record: what `meta/cei.json` shall keep of it (seed, quality, ...).
            pictures: what cameras saw in these frames, if any pass through.

        Raises:
            CEIError: the episode does not match the first one, or a depth is out of range.
        """
        where = f"episode {len(self._records)}"
        if self._first is None:
            self._start(demonstration)
        else:
            self._check_matches_first(demonstration, where)
        assert self._episodes is not None
        self._episodes.add(encode(demonstration), demonstration.task, pictures)
        self._records.append(plain(record or {}))

    def _start(self, first: Demonstration) -> None:
        if first.fps != int(first.fps):
            raise CEIError(f"fps {first.fps} is not an integer, as LeRobot requires.")
        check_scene(first.scene, "episode 0")
        self._features = schema.features(load_embodiment(first.embodiment), first)
        self._episodes = EpisodeWriter(
            self.repo_id,
            self._partial,
            fps=int(first.fps),
            features=self._features | self._cameras,
            robot_type=first.embodiment,
        )
        # only what later episodes are compared with, not its frames
        self._first = _without_frames(first)

    def _check_matches_first(self, other: Demonstration, where: str) -> None:
        first = self._first
        assert first is not None
        for what in ("embodiment", "fps"):
            ours, theirs = getattr(first, what), getattr(other, what)
            if ours != theirs:
                raise CEIError(f"{where}: {what} is {theirs} but the dataset's is {ours}.")
        if not _same_scene(first.scene, other.scene):
            raise CEIError(f"{where}: base, cameras or workspace differ from episode 0; use one dataset a scene.")
        theirs = schema.features(load_embodiment(other.embodiment), other)
        for key in sorted(self._features.keys() | theirs.keys()):
            expected, got = (found.get(key, {}).get("shape") for found in (self._features, theirs))
            if key.startswith(("observation.", "action")) and expected != got:
                raise CEIError(f"{where}: {key} has shape {got} but the dataset's is {expected}.")

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if error is None:
                self._finish()
        finally:
            if self._episodes is not None:
                self._episodes.finalize()
            if self._partial.exists():
                shutil.rmtree(self._partial)
            for folder in self._new_folders:
                with contextlib.suppress(OSError):  # not empty: the dataset is in it
                    folder.rmdir()

    def _finish(self) -> None:
        if self._first is None or self._episodes is None:
            raise CEIError(f"no episode was written, so {self.root} is not made.")
        self._episodes.finalize()
        metadata = Metadata(
            embodiment=self._first.embodiment,
            scene=self._first.scene,
            environment=self.environment,
            provenance=self.provenance,
            episodes=tuple(self._records),
        )
        metadata.save(self._partial)
        write_card(self._partial, self.repo_id, metadata)
        if self.root.exists():
            raise CEIError(f"{self.root} came into being meanwhile; choose another folder.")
        self._partial.rename(self.root)


def _without_frames(demonstration: Demonstration) -> Demonstration:
    return Demonstration(
        embodiment=demonstration.embodiment,
        fps=demonstration.fps,
        qpos=demonstration.qpos[:1].copy(),
        action=demonstration.action[:1].copy(),
        scene=demonstration.scene,
    )


def _same_scene(a: Scene, b: Scene) -> bool:
    return (
        np.allclose(a.T_world_base, b.T_world_base)
        and np.allclose(a.workspace_world, b.workspace_world)
        and len(a.cameras) == len(b.cameras)
        and all(
            (one.name, one.width, one.height) == (other.name, other.width, other.height)
            and np.allclose(one.K, other.K)
            and np.allclose(one.T_world_camera, other.T_world_camera)
            for one, other in zip(a.cameras, b.cameras, strict=True)
        )
    )
