"""What a conversion is: decided once, before the first shard, and the same for every worker and every resumption."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import draccus
from draccus.utils import DraccusException

from cei_converters.conversion.config import ConvertConfig
from cei_converters.conversion.starting import Chosen
from cei_converters.conversion.survey import LOWEST
from cei_converters.dataset.metadata import Provenance, plain
from cei_gym.alignment.contact.correction import Correction
from cei_gym.alignment.start.basins import Basin
from cei_gym.errors import CEIError

BY_CONTENT = ("calibration", "joint_map")
"""Options that name files."""

DATASET = "dataset"
"""What `check_unchanged` calls the dataset that is converted."""

WHERE = ("package_path",)
"""Options that say where to look for what has a fingerprint anyway."""

PLACED = "placed"
"""What provenance has of the place that `--target_pose=auto` found."""

DECIDED = (
    "basins",
    "gate",
    "verify.dropped",
    "evidence.dropped",
    "refine.common",
    "refine.start",
    "strays",
    "table",
    PLACED,
)
"""What provenance has among the options of a finished conversion that nobody gave; see `assemble`."""


POSE = "target_pose"
"""The option that says where the target's base is; a plan has what was found."""

TABLE = "table_z_m"
"""The option that says where the table is; where it is not given, it is what was found."""


@dataclass(frozen=True)
class Plan:
    """A conversion.

    Attributes:
        config: its options, paths absolute.
        provenance: of the run that began it.
        finalists: what `Transfer.fit` found, the one first that all episodes follow from.
        frames: of each episode to convert, as recorded.
        correction: that all episodes have, if one was found (`--refine`).
        chosen: why another start than the one that follows best is first (`--refine`); None if it is that one.
    """

    config: ConvertConfig
    provenance: Provenance
    finalists: list[Basin] = field(default_factory=list[Basin])
    frames: list[int] = field(default_factory=list[int])
    correction: Correction | None = None
    chosen: Chosen | None = None

    @property
    def shards(self) -> list[range]:
        """The positions of each shard's episodes among those to convert."""
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

    def check_same(self, wanted: Provenance, where: Path) -> None:
        """Check that what was begun is what is wanted now, made by the same code of the same content.

        Raises:
            CEIError: naming what differs.
        """
        anew = to_begin_anew(where)
        check_same(self.provenance, wanted, anew)
        before = {**self.provenance.versions, "commit": self.provenance.git_commit}
        now = {**wanted.versions, "commit": wanted.git_commit}
        for name in sorted(before.keys() | now.keys()):
            if before.get(name) != now.get(name):
                raise CEIError(f"--resume: begun with {name} {before.get(name)}, this is {now.get(name)}{anew}")


def to_begin_anew(where: Path) -> str:
    """What is said at the end of a refusal to go on with what is there."""
    return f"; to begin anew, remove {where}."


def check_same(begun: Provenance, wanted: Provenance, anew: str) -> None:
    """Check that two conversions have the same options and are made of the same content, wherever it is and whatever its files are called.

    Args:
        begun: of the one that is there, finished or not.
        wanted: of the one that is asked for.
        anew: what else can be done, for the message.

    Raises:
        CEIError: naming what differs.
    """
    before, now = (_compared(p.options) | {"dataset.repo_id": p.source and p.source.repo_id} for p in (begun, wanted))
    table = begun.options.get("table") or {}
    if table.get("said_by") == LOWEST and now.get(TABLE) in (None, before.get(TABLE)):  # found, not given
        for options in (before, now):
            options.pop(TABLE, None)
    if (placed := begun.options.get(PLACED)) is not None and now.get(POSE) == placed[POSE]:  # found, and given
        for options in (before, now):
            options.pop(POSE, None)
    for option in sorted(before.keys() | now.keys()):
        if (was := before.get(option)) != (it_is := now.get(option)):
            raise CEIError(f"--resume: --{option} was {was}, now it is {it_is}; give what was given before{anew}")
    check_unchanged(begun, {**dict.fromkeys(begun.inputs), **_content(wanted)}, anew)


def check_unchanged(begun: Provenance, content: Mapping[str, str | None], anew: str) -> None:
    """Check that what a conversion was begun with has not changed.

    Args:
        begun: of the one that is there, finished or not.
        content: the dataset, the calibration, ..., to its fingerprint now; None where there is none any more.
        anew: what else can be done, for the message.

    Raises:
        CEIError: naming what has.
    """
    before = _content(begun)
    for name, now in sorted(content.items()):
        if before.get(name) != now:
            what = begun.source.repo_id if name == DATASET and begun.source is not None else f"the {name}"
            raise CEIError(f"--resume: {what} has changed since the conversion began{anew}")


def _content(provenance: Provenance) -> dict[str, str | None]:
    return {DATASET: provenance.source and provenance.source.fingerprint, **provenance.inputs}


def absolute(config: ConvertConfig, dataset_root: Path) -> ConvertConfig:
    """Options that mean the same in other folders and on other machines with the same disks."""
    found = {f.name: value for f in fields(config) if isinstance(value := getattr(config, f.name), (Path, list))}
    paths = {name: _resolved(value) for name, value in found.items()}
    return replace(config, **paths, dataset=replace(config.dataset, root=dataset_root.resolve()))


def _resolved(value: Any) -> Any:
    if isinstance(value, list):
        return [_resolved(item) for item in value]
    return value.resolve() if isinstance(value, Path) else value


def _compared(options: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Options by their dotted names, without what was decided on the way, and without files, which are compared by their content."""
    flat: dict[str, Any] = {}
    for key, value in options.items():
        if (name := prefix + key) not in (*BY_CONTENT, *WHERE, *DECIDED):
            flat |= _compared(value, f"{name}.") if isinstance(value, dict) else {name: value}
    return flat
