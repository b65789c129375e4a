"""Converted episodes on disk, before they are part of a dataset: one folder a shard, whole or not at all."""

import contextlib
import hashlib
import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import draccus
import numpy as np
import pyarrow as pa

from cei_converters.conversion.episode import Converted, Outcome
from cei_converters.dataset.cameras import Clip
from cei_converters.dataset.encoded import EncodedEpisode
from cei_converters.dataset.metadata import plain
from cei_converters.dataset.writer import Header

_FRAMES, _EPISODES, _PROGRESS = "frames.arrow", "episodes.json", "progress"


class ShardWriter:
    """Context manager that writes one shard; the folder appears when the block ends well.

    Args:
        folder: of the shard, which must not exist.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._partial = folder.with_name(f".{folder.name}-{os.getpid()}")
        self._file: pa.RecordBatchFileWriter | None = None
        self._header: Header | None = None
        self._episodes: list[dict[str, Any]] = []
        self._frames = 0

    def __enter__(self) -> "ShardWriter":
        self._partial.mkdir(parents=True)
        return self

    def add(self, converted: Converted) -> None:
        """Append an episode."""
        self._header = self._header or converted.header
        stored: dict[str, Any] = {"outcome": converted.outcome.encode(), "rows": None}
        if (encoded := converted.encoded) is not None:
            if self._file is None:
                self._file = pa.ipc.new_file(self._partial / _FRAMES, encoded.table.schema)
            (batch,) = encoded.table.combine_chunks().to_batches()
            self._file.write_batch(batch)
            stored |= {"rows": batch.num_rows, **self._beside(encoded, len(self._episodes))}
        self._episodes.append(stored)
        self._frames += converted.outcome.entry["frames"]
        (self._partial / _PROGRESS).write_text(str(self._frames))

    def _beside(self, encoded: EncodedEpisode, number: int) -> dict[str, Any]:
        """What is not in rows, in JSON types; videos go to files."""
        names = {key: f"video-{number:06d}-{i}.mp4" for i, key in enumerate(encoded.videos)}
        for key, video in encoded.videos.items():
            (self._partial / names[key]).write_bytes(video)
        clips = {
            key: [str(clip.path.absolute()), clip.start_s, clip.end_s, clip.fps] for key, clip in encoded.clips.items()
        }
        tasks = None if encoded.tasks is None else [*encoded.tasks]
        statistics = {
            key: {name: value.tolist() for name, value in found.items()} for key, found in encoded.statistics.items()
        }
        return {"task": encoded.task, "tasks": tasks, "statistics": statistics, "clips": clips, "videos": names}

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        try:
            if self._file is not None:
                self._file.close()
            if kind is None:
                assert self._header is not None
                found = {"header": plain(self._header), "episodes": self._episodes, "sha256": _sha256(self._partial)}
                (self._partial / _EPISODES).write_text(json.dumps(found))
                try:
                    self._partial.rename(self._folder)
                except OSError:
                    if not self._folder.exists():  # else another worker, thought lost, was faster
                        raise
        finally:
            shutil.rmtree(self._partial, ignore_errors=True)


class Shard:
    """A finished shard.

    Args:
        folder: of the shard.

    Raises:
        OSError: it is damaged, or there is none.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        try:
            found = json.loads((folder / _EPISODES).read_text())
            self._sha256: str = found["sha256"]
            self._episodes: list[dict[str, Any]] = found["episodes"]
            self.outcomes = [Outcome.decode(stored["outcome"]) for stored in self._episodes]
            """One an episode, those that are left out included."""
            for feature in found["header"]["features"].values():
                feature["shape"] = tuple(feature["shape"])
            self.header: Header = draccus.decode(Header, found["header"])
        except (OSError, KeyError, TypeError, ValueError, draccus.utils.DraccusException) as error:
            raise OSError(f"{folder} is no finished shard; --resume makes it again.") from error

    def check(self) -> None:
        """Check that frames are those that were written; all of them are read.

        Raises:
            OSError: they are not.
        """
        if self._sha256 != _sha256(self._folder):
            raise OSError(f"{self._folder} is damaged; --resume makes it again.")

    def __iter__(self) -> Iterator[Converted]:
        batches = iter(())
        if (self._folder / _FRAMES).exists():
            file = pa.ipc.open_file(pa.memory_map(str(self._folder / _FRAMES)))
            batches = (file.get_batch(i) for i in range(file.num_record_batches))
        for stored, outcome in zip(self._episodes, self.outcomes, strict=True):
            encoded = None
            if stored["rows"] is not None:
                encoded = EncodedEpisode(
                    pa.Table.from_batches([next(batches)]),
                    {key: {n: np.array(v) for n, v in found.items()} for key, found in stored["statistics"].items()},
                    stored["task"],
                    stored["tasks"],
                    {key: Clip(Path(path), *where) for key, (path, *where) in stored["clips"].items()},
                    {key: (self._folder / name).read_bytes() for key, name in stored["videos"].items()},
                )
            yield Converted(outcome, self.header, encoded)


def frames_done(folder: Path) -> int:
    """Frames of unfinished shards in a folder, for progress."""
    done = 0
    for path in folder.glob(f".*/{_PROGRESS}"):
        with contextlib.suppress(OSError, ValueError):
            done += int(path.read_text())
    return done


def unfinished(folder: Path) -> list[int]:
    """Processes that write shards in a folder, or did."""
    return [int(path.name.rpartition("-")[2]) for path in folder.glob(".*-*")]


def _sha256(folder: Path) -> str:
    """Of all that is in a shard beside what says so."""
    found = hashlib.sha256()
    for path in sorted([*folder.glob(_FRAMES), *folder.glob("video-*")]):
        with path.open("rb") as file:
            found.update(hashlib.file_digest(file, "sha256").digest())
    return found.hexdigest()
