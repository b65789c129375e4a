"""`cei-restore`: an edited dataset gets back what other tools have lost of it."""

import shutil
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cei_converters import signals
from cei_converters.cli import DatasetConfig, run
from cei_converters.cli.options import check_overwrite
from cei_gym.errors import CEIError

if TYPE_CHECKING:
    from cei_converters.dataset.metadata import Metadata
    from cei_converters.dataset.records import Record

EXAMPLE = """example:
  lerobot-edit-dataset --repo_id=me/pick --root=data/pick --new_repo_id=me/pick --new_root=data/pick \\
      --operation.type=delete_episodes --operation.episode_indices="[3]"
  cei-restore --dataset.repo_id=me/pick --dataset.root=data/pick --original=data/pick_old
  cei-restore --dataset.repo_id=me/both --dataset.root=data/both --original=data/pick,data/stack

LeRobot's tools carry along what a dataset cannot be used without: it replays, evaluates, trains and converts without this
command. They lose how it came about, what is known of each episode (source, quality, seed), the card and license files."""


@dataclass
class RestoreConfig:
    """Give an edited dataset (episodes deleted, split, merged, features removed) back its provenance, records, card and licenses."""

    dataset: DatasetConfig
    original: str | None = None  # What it was made from, folders or names, with commas between; default: <root>_old.
    json: Path | None = None  # File for the result as JSON.
    overwrite: bool = False  # Replace a JSON file that is there already; never a dataset's.

    def __post_init__(self) -> None:
        check_overwrite(self.overwrite, self.json)


@dataclass(frozen=True, eq=False)
class _Original:
    """A dataset that episodes were taken from.

    Attributes:
        name: of its folder.
        root: its folder.
        metadata: what is known of it.
        records: of its episodes, in their order.
        digests: likewise.
    """

    name: str
    root: Path
    metadata: "Metadata"
    records: "Sequence[Record]"
    digests: list[str]


@dataclass(frozen=True)
class _Match:
    """Where an episode comes from."""

    original: _Original
    episode: int


def restore(config: RestoreConfig) -> dict[str, Any]:
    """Restore a dataset; its episodes are found in the originals by their joints.

    Returns:
        The result: of each episode, which episode of which original it is.

    Raises:
        CEIError: there is nothing to restore, or an episode is in none of the originals; nothing is written then.
    """
    from cei_converters.cli.outputs import JSON, Outputs
    from cei_converters.cli.result import write_json
    from cei_converters.dataset import identity
    from cei_converters.dataset.license import CARD_PATH
    from cei_converters.dataset.locate import locate
    from cei_converters.dataset.metadata import METADATA_PATH
    from cei_converters.dataset.opening import describe
    from cei_converters.dataset.records import RECORDS_PATH

    json = Outputs(config.overwrite).file("--json", config.json, JSON)
    root = locate(config.dataset.repo_id, config.dataset.root)
    if root.parent.name == "snapshots":
        raise CEIError(f"{root} is the hub's cache; download the dataset to a folder, and name that by --dataset.root.")
    for path in (METADATA_PATH, RECORDS_PATH, CARD_PATH):
        if (root / path).exists():
            raise CEIError(f"{root / path} exists; if it is not what belongs there, remove it first.")
    meta = describe(root)
    keys = [key for key in identity.KEYS if key in meta.features]
    if not keys:
        raise CEIError(f"{root} has neither {' nor '.join(identity.KEYS)}, by which its episodes could be told.")
    digests = identity.digests(root, meta, keys)
    originals = [_open(name, keys) for name in _originals(config.original, root)]
    (name, times), *_ = Counter(original.name for original in originals).most_common(1)
    if times > 1:
        raise CEIError(f"--original has {times} that are called {name}, by which records name them; rename a folder.")
    matches = _match(digests, originals, root)
    metadata = _put_together(root, matches, len(digests))
    _write(root, config.dataset.repo_id, metadata, matches, digests)
    counts = Counter(match.original.name for match in matches)
    print(f"Restored {root}: {', '.join(f'{n} episodes of {name}' for name, n in counts.items())}.")
    for original in originals:
        if original.name not in counts:
            print(f"None is of {original.name}.")
    episodes = [{"original": match.original.name, "episode": match.episode} for match in matches]
    result = {"repo_id": config.dataset.repo_id, "root": str(root), "episodes": episodes}
    write_json(json, result)
    return result


def _originals(given: str | None, root: Path) -> list[str]:
    """Folders or names of the datasets to look in.

    Raises:
        CEIError: none is given, and there is none where LeRobot leaves one.
    """
    if given is not None:
        if names := [given] if Path(given).exists() else [name.strip() for name in given.split(",") if name.strip()]:
            return names
        raise CEIError(f"--original={given} names no dataset.")
    backup = root.resolve().with_name(f"{root.resolve().name}_old")
    if not backup.is_dir():
        raise CEIError(f"name what {root} was made from with --original; there is no {backup.name} beside it.")
    return [str(backup)]


def _open(name: str, keys: Sequence[str]) -> _Original:
    from cei_converters.dataset import identity
    from cei_converters.dataset.essentials import Remains
    from cei_converters.dataset.locate import locate
    from cei_converters.dataset.opening import describe, find_metadata
    from cei_converters.dataset.records import load_records

    is_folder = Path(name).is_dir()
    root = locate(name, name if is_folder else None)
    metadata = find_metadata(root)
    if metadata is None or isinstance(metadata, Remains):
        raise CEIError(f"{root} was edited itself, and has nothing to restore from; name what it was made from.")
    meta = describe(root)
    for key in keys:
        if key not in meta.features:
            raise CEIError(f"{root} has no {key}, by which its episodes could be told.")
    records = load_records(root, int(meta.total_episodes))
    return _Original(
        root.resolve().name if is_folder else name, root, metadata, records, identity.digests(root, meta, keys)
    )


def _match(digests: list[str], originals: list[_Original], root: Path) -> list[_Match]:
    """Which episode of which original each is; those that are alike are taken in turn.

    Raises:
        CEIError: one is in none of them.
    """
    known: dict[str, list[_Match]] = {}
    for original in originals:
        for episode, found in enumerate(original.digests):
            known.setdefault(found, []).append(_Match(original, episode))
    if missing := [i for i, found in enumerate(digests) if found not in known]:
        raise CEIError(
            f"{len(missing)} of {len(digests)} episodes of {root}, the first of them {missing[0]}, are in none of "
            f"{', '.join(original.name for original in originals)}: name all that it was made from with --original."
        )
    taken: Counter[str] = Counter()
    matches = []
    for found in digests:
        matches.append(known[found][taken[found] % len(known[found])])
        taken[found] += 1
    return matches


def _put_together(root: Path, matches: list[_Match], total: int) -> "Metadata":
    """Metadata of the edited dataset.

    Raises:
        CEIError: the originals, or what the dataset has kept, are of different robots, scenes or clouds.
    """
    from cei_converters.dataset import schema
    from cei_converters.dataset.essentials import difference, find_essentials
    from cei_converters.dataset.locate import INFO_PATH, read_info
    from cei_converters.dataset.metadata import FORMAT_VERSION, START
    from cei_converters.dataset.starts import find_starts

    originals = _unique([match.original for match in matches])
    features = read_info(root).get("features", {})
    kept = find_essentials(features, f"{root.name}/{INFO_PATH}")
    first = originals[0].metadata
    for name, other in [(each.name, each.metadata) for each in originals] + [(str(root), kept or first)]:
        if differing := difference(first, other):
            raise CEIError(f"{originals[0].name} and {name} are of one dataset, but differ in {differing}.")
    provenance, *merged = _unique([each for original in originals for each in original.metadata.provenances])
    environment = first.environment
    starts = [start for each in originals for start in each.metadata.environment.kwargs.get(START, [])]
    if starts:
        found = find_starts(root) if schema.STATE in features else starts
        environment = replace(environment, kwargs=environment.kwargs | {START: found})
    return replace(
        first,
        environment=environment,
        total_episodes=total,
        provenance=provenance,
        merged=tuple(merged),
        format_version=FORMAT_VERSION,
    )


def _write(root: Path, repo_id: str, metadata: "Metadata", matches: list[_Match], digests: list[str]) -> None:
    """Write all files, or none."""
    from cei_converters.dataset.card import write_card
    from cei_converters.dataset.license import merge_license_files
    from cei_converters.dataset.locate import INFO_PATH, read_info
    from cei_converters.dataset.metadata import PICTURE_PATH
    from cei_converters.dataset.place import temporary_folder
    from cei_converters.dataset.records import ROWS, Records, RecordWriter
    from cei_converters.dataset.step_time import StepTime

    originals = _unique([match.original for match in matches])
    with temporary_folder(within=root) as made:
        (made / "meta").mkdir()
        with RecordWriter(made) as records:
            for match, rows in zip(matches, digests, strict=True):
                record = dict(match.original.records[match.episode]) if match.original.records else {}
                whose = match.original.metadata.provenance_of(record, f"{match.original.name}, episode {match.episode}")
                record.pop("provenance", None)
                if metadata.merged:
                    record["provenance"] = metadata.provenances.index(whose)
                origin = {"repo_id": match.original.name, "episode": match.episode}
                records.add({**record, ROWS: rows, "restored_from": origin})
        metadata = replace(metadata, step_time_s=StepTime.of(Records(made), read_info(root)["fps"]))
        whole = [match.episode for match in matches] == list(range(len(originals[0].digests)))
        if len(originals) == 1 and whole and (originals[0].root / PICTURE_PATH).is_file():
            shutil.copyfile(originals[0].root / PICTURE_PATH, made / PICTURE_PATH)
        merge_license_files([(original.name, original.root) for original in originals], made)
        shutil.copyfile(root / INFO_PATH, made / INFO_PATH)  # the card is of both
        write_card(made, repo_id, metadata)
        (made / INFO_PATH).unlink()
        metadata.save(made)
        new = [path.relative_to(made) for path in sorted(made.rglob("*"), reverse=True) if path.is_file()]
        with signals.held():
            for path in new:
                if (root / path).exists():
                    raise CEIError(f"{root / path} exists; if it is not what belongs there, remove it first.")
            for path in new:
                (made / path).rename(root / path)


def _unique[Thing](things: Sequence[Thing]) -> list[Thing]:
    """Each once, in their order; they need not be hashable."""
    found: list[Thing] = []
    for thing in things:
        if thing not in found:
            found.append(thing)
    return found


def main(args: list[str] | None = None) -> int:
    """Entry point of `cei-restore`."""
    return run(RestoreConfig, restore, args, prog="cei-restore", example=EXAMPLE)


if __name__ == "__main__":
    raise SystemExit(main())
