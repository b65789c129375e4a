"""What a conversion is: decided once, before the first shard, and the same for every worker and every resumption."""

import json
import os
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import draccus
from draccus.utils import DraccusException

from cei_converters.conversion.config import ConvertConfig
from cei_converters.dataset.metadata import Provenance, plain
from cei_gym.alignment import Basin
from cei_gym.errors import CEIError

# what may differ from one run to the next without changing what becomes of the dataset
_UPLOAD = ("push_to_hub", "private", "branch", "pull_request")
_INCIDENTAL = ("workers", "executor", "slurm", "shard_episodes", "resume", "json", *_UPLOAD)


@dataclass(frozen=True)
class Plan:
    """A conversion.

    Attributes:
        config: its options, files by absolute path.
        provenance: of the run that began it.
        finalists: what `Transfer.fit` found.
        frames: of each episode to convert, as recorded.
    """

    config: ConvertConfig
    provenance: Provenance
    finalists: list[Basin] = field(default_factory=list)
    frames: list[int] = field(default_factory=list)

    @property
    def shards(self) -> list[range]:
        """Of each shard, its positions among the episodes to convert."""
        n, each = len(self.frames), self.config.shard_episodes
        return [range(start, min(start + each, n)) for start in range(0, n, each)]

    def save(self, path: Path) -> None:
        """Write, whole or not at all."""
        partial = path.with_suffix(".partial")
        partial.write_text(json.dumps(plain(self), indent=1) + "\n")
        partial.replace(path)

    @classmethod
    def load(cls, path: Path) -> "Plan":
        """Read.

        Raises:
            CEIError: it is damaged.
        """
        try:
            return draccus.decode(cls, json.loads(path.read_text()))
        except (OSError, ValueError, DraccusException) as error:
            raise CEIError(f"{path} is damaged; remove {path.parent} and begin anew.") from error

    def check_same(self, config: ConvertConfig, provenance: Provenance, where: Path) -> None:
        """Check that what was begun is what is wanted now.

        Raises:
            CEIError: naming what differs.
        """
        anew = f"; to begin anew, remove {where}."
        begun, wanted = (_flat(plain(_essential(c))) for c in (self.config, config))
        for option in sorted(begun.keys() | wanted.keys()):
            if (before := begun.get(option)) != (now := wanted.get(option)):
                raise CEIError(f"--resume: --{option} was {before}, now it is {now}; give what was given before{anew}")
        ours, theirs = self.provenance, provenance
        assert ours.source is not None and theirs.source is not None
        if ours.source.fingerprint != theirs.source.fingerprint:
            raise CEIError(f"--resume: {config.dataset.repo_id} has changed since the conversion began{anew}")
        before = {**ours.versions, "commit": ours.git_commit}
        now = {**theirs.versions, "commit": theirs.git_commit}
        for name in sorted(before.keys() | now.keys()):
            if before.get(name) != now.get(name):
                raise CEIError(f"--resume: begun with {name} {before.get(name)}, this is {now.get(name)}{anew}")


def absolute(config: ConvertConfig, dataset_root: Path) -> ConvertConfig:
    """Options that mean the same in other folders and on other machines with the same disks."""
    dataset = replace(config.dataset, root=str(dataset_root.resolve()))
    files = {name: getattr(config, name) for name in ("calibration", "joint_map")}
    packages = config.package_path and os.pathsep.join(
        str(Path(folder).expanduser().resolve()) for folder in config.package_path.split(os.pathsep) if folder
    )
    files = {name: path and str(Path(path).resolve()) for name, path in files.items()}
    return replace(config, dataset=dataset, package_path=packages, **files)


def _essential(config: ConvertConfig) -> ConvertConfig:
    return replace(config, **dict.fromkeys(_INCIDENTAL))


def _flat(options: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat = {}
    for name, value in options.items():
        flat |= _flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name: value}
    return flat
