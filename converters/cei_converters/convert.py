"""`cei-convert`: one robot's LeRobot dataset becomes another's."""

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cei_converters.cli import run
from cei_converters.cli.options import check_of_use
from cei_converters.conversion.config import ConvertConfig, check_options
from cei_converters.conversion.executors import SlurmOptions
from cei_converters.conversion.in_order import in_background
from cei_converters.conversion.plan import BY_CONTENT, DATASET
from cei_converters.conversion.reach import check_reached
from cei_converters.dataset.provenance import fingerprint
from cei_converters.sources import calibration, joint_map, pose
from cei_gym import extras
from cei_gym.errors import CEIError

if TYPE_CHECKING:
    from cei_converters.conversion.converter import Converter
    from cei_converters.conversion.plan import Plan
    from cei_converters.conversion.workplace import Workplace
    from cei_converters.dataset.metadata import Provenance
    from cei_converters.sources.source import Source as Recorded

EXAMPLE = """example:
  cei-convert --dataset.repo_id=me/pick_panda --target=IIWA-Inspire --new_repo_id=me/pick_iiwa
  cei-convert --dataset.repo_id=me/pick_panda --dataset.root=data/pick_panda --target=IIWA-Inspire \\
      --episodes=0,3,5 --dry_run
  cei-convert --dataset.repo_id=me/pick_panda --target=IIWA-Inspire --new_repo_id=me/pick_iiwa --verify --verify.drop
  cei-convert --dataset.repo_id=me/pick_panda --target=IIWA-Inspire --new_repo_id=me/pick_iiwa \\
      --min_quality=0.3 --flag=0.6 --push_to_hub --branch=iiwa
  cei-convert --dataset.repo_id=me/real_panda --source=Panda-PandaGripper --calibration=cameras.yaml \\
      --target=IIWA-Inspire --new_repo_id=me/real_iiwa
  cei-convert --dataset.repo_id=me/pick_panda --episodes=0 --target=UR5e-FourierRight --new_repo_id=me/pick_anywhere \\
      --augment.grid=10,10 --augment.range=0.2,0.2 --augment.rotation_deg=30

""" + "\n\n".join((calibration.FORMAT, joint_map.FORMAT, pose.FORMAT))


def convert(config: ConvertConfig) -> dict[str, Any]:
    """Convert a dataset; print a table of the quality of each episode.

    Returns:
        The result: source, target, under `results` one entry an episode, under `verify` what replaying showed, if asked for,
        and under `gate` which episodes are dropped or flagged for their quality, if asked for. Episodes that are dropped are in
        the last two only. `--json` has `residuals`, too: frame by frame how far pads are apart.

    Raises:
        CEIError: bad options or data, an episode that the target cannot reach, or none that is kept.
    """
    check_options(config)

    from cei_converters.cli.outputs import JSON, Outputs
    from cei_converters.cli.progress import progress_bar
    from cei_converters.cli.result import write_json
    from cei_converters.conversion.assemble import assemble
    from cei_converters.conversion.converter import Converter
    from cei_converters.conversion.executors import warm_up
    from cei_converters.conversion.outcomes import account, residuals
    from cei_converters.conversion.plan import Plan, to_begin_anew
    from cei_converters.conversion.survey import LOWEST, survey
    from cei_converters.conversion.workers import convert_shards, default_workers, processes_for
    from cei_converters.conversion.workplace import Workplace
    from cei_converters.conversion.writing import Writing
    from cei_converters.dataset.essentials import Remains
    from cei_converters.dataset.metadata import plain, restore_with
    from cei_converters.dataset.place import temporary_folder

    if config.resume and (root := _new_root(config)).exists():
        return _finished(config, root)
    json = Outputs(config.overwrite, None if config.dry_run else _new_root(config)).file("--json", config.json, JSON)
    with contextlib.ExitStack() as stack:
        root = stack.enter_context(temporary_folder()) / "dry_run" if config.dry_run else _new_root(config)
        place = stack.enter_context(Workplace(root, config.resume))
        writes = not config.dry_run and config.executor != "slurm"
        writing = stack.enter_context(Writing()) if writes else None
        begun = Plan.load(place.plan) if place.plan.exists() else None
        known = "" if begun is None else _check_unchanged(begun.provenance, config, to_begin_anew(place.folder))
        converter = stack.enter_context(Converter(config))
        reader = converter.reader
        _check_fit(config, reader)
        # it takes a second a gigabyte, beside the choice of the start
        content = (lambda: known) if known or config.dry_run else in_background(lambda: fingerprint(reader.root))
        for name, notes in _notes(converter).items():
            print("\n".join(f"note: {name}: {note}" for note in notes))
        reader.check_videos(sorted(set(converter.selected)))
        print("\n".join([_about_cameras(reader, bool(converter.cameras)), *_about_columns(reader)]))
        if isinstance(reader.metadata, Remains):
            print(
                f"{reader.repo_id} was edited by a tool that lost how it came about: its license is not carried over, nor what was "
                f"known of its episodes. {restore_with(reader.root)}"
            )
        local = config.executor == "local"
        workers = config.workers or (local and default_workers()) or len(converter.selected)
        if local and config.workers is None and (absent := extras.missing("cluster")):
            print(f"note: {extras.lacking('more than one process', absent)}")
        if local and processes_for(workers, -(-len(converter.selected) // config.shard_episodes)) > 1:
            extras.require(f"--workers={workers}", "cluster")
            warm_up("cei_converters.conversion.preloaded")
        frames = [reader.frames(index) for index in converter.selected]
        progress = stack.enter_context(progress_bar("frames"))
        task = progress.add_task("reading joints", total=sum(frames))
        table_z_m = survey(reader, converter.selected, lambda done: progress.advance(task, done))
        if table_z_m is not None:
            reader.set_table(table_z_m, LOWEST)
            config = replace(config, table_z_m=table_z_m)
            progress.console.print(_about_table(table_z_m), highlight=False, soft_wrap=True)
        progress.reset(task, description="choosing the start")
        plan = _planned(config, place, begun, converter, frames, content)
        if config.executor == "slurm" and (missing := place.missing(len(plan.shards))):
            return _submitted(config, place, missing)
        progress.update(task, description="converting")
        if writing is not None:
            passed = {"cameras": converter.cameras, "carried": reader.carried, "carries": reader.carries}
            writing.begin(place.root, **plain({"environment": converter.environment, "tasks": reader.tasks, **passed}))
        convert_shards(place, plan, converter, workers, lambda done: progress.update(task, completed=done))
        progress.stop()
        told = account(place, plan, f"{reader.embodiment.name} -> {config.target}")
        result = {
            "source": {"repo_id": reader.repo_id, "embodiment": reader.embodiment.name},
            "target": config.target,
            "repo_id": None if config.dry_run else config.new_repo_id,
            "root": None if config.dry_run else str(place.root),
            "dry_run": config.dry_run,
            "depth_cameras": list(reader.depth_cameras),
            "passed_through": list(converter.cameras),
            "carried_features": list(reader.carried),
            "dropped_features": reader.dropped,
            "table": {"z_m": reader.scene.support_z_m, "said_by": reader.table_from},
            "notes": _notes(converter),
            "episodes": len(told.entries),
            "frames": sum(entry["frames"] for entry in told.entries),
            "results": told.entries,
            **told.choices,
        }
        if writing is not None:
            assemble(place, plan, converter, told, writing)
        write_json(json, result, residuals=residuals(place, plan))
    if config.dry_run:
        if not config.allow_unreachable:
            check_reached(config.target, told.entries)
        return result
    print(f"Wrote {len(told.entries)} episodes to {place.root}.")
    _upload(config, place.root)
    return result


def _finished(config: ConvertConfig, root: Path) -> dict[str, Any]:
    """What is to be done when a dataset is there that is gone on with: maybe its upload.

    Raises:
        CEIError: it is of another robot, or was made with other options or of other content.
    """
    from cei_converters.conversion.converter import Converter
    from cei_converters.conversion.plan import check_same
    from cei_converters.dataset.metadata import Metadata
    from cei_converters.dataset.place import tidy

    metadata = Metadata.load(root)
    if metadata.embodiment != config.target:
        raise CEIError(f"{root} already exists and is no dataset of {config.target}; choose another folder.")
    anew = f", or remove {root}."
    content = _check_unchanged(metadata.provenance, config, anew)
    with Converter(config) as converter:
        check_same(metadata.provenance, _provenance(config, converter, content), anew)
    tidy(root)
    print(f"{root} is finished; nothing is left to do{' but to upload it' * config.push_to_hub}.")
    if config.json is not None and not config.json.exists():
        print(f"{config.json} is not made: a result is written when its conversion ends.")
    _upload(config, root)
    return {"root": str(root), "repo_id": config.new_repo_id, "dry_run": False}


def _check_unchanged(begun: "Provenance", config: ConvertConfig, anew: str) -> str:
    """Check that files are what they were, before any of them is read: what was changed may not be readable.

    Args:
        begun: of what is gone on with.
        config: of the conversion.
        anew: what else can be done, for the message.

    Returns:
        The dataset's fingerprint.

    Raises:
        CEIError: one has changed.
    """
    from cei_converters.conversion.plan import check_unchanged
    from cei_converters.sources.formats import find_root

    content = fingerprint(find_root(config.dataset.repo_id, config.dataset.root))
    check_unchanged(begun, {DATASET: content, **_files(config)}, anew)
    return content


def _files(config: ConvertConfig) -> dict[str, str]:
    """Fingerprints of the files that options name."""
    named = {name.replace("_", " "): getattr(config, name) for name in BY_CONTENT}
    return {name: fingerprint(Path(file)) for name, file in named.items() if file is not None}


def _planned(
    config: ConvertConfig,
    place: "Workplace",
    begun: "Plan | None",
    converter: "Converter",
    frames: list[int],
    content: Callable[[], str],
) -> "Plan":
    """The plan that is gone on with, or a new one; the converter then starts where it says.

    Args:
        config, place, converter: of the conversion.
        begun: the plan that is gone on with.
        frames: of each episode to convert.
        content: waits for the dataset's fingerprint.

    Raises:
        CEIError: what was begun is not what is wanted now, or an episode cannot be read.
    """
    from cei_converters.conversion.plan import Plan, absolute

    absolutely = absolute(config, converter.reader.root)
    if begun is not None:
        begun.check_same(_provenance(config, converter, content()), place.folder)
        converter.start_from(begun.finalists)
        if config.shard_episodes != begun.config.shard_episodes:
            print(f"Shards stay as they were begun: --shard_episodes={begun.config.shard_episodes}.")
        return replace(begun, config=replace(absolutely, shard_episodes=begun.config.shard_episodes))
    converter.fit()
    provenance = _provenance(config, converter, content())
    plan = Plan(absolutely, provenance, converter.transfer.finalists, frames)
    plan.save(place.plan)
    return plan


def _submitted(config: ConvertConfig, place: "Workplace", missing: list[int]) -> dict[str, Any]:
    """Leave the rest to Slurm."""
    from cei_converters.conversion.executors import submit_slurm
    from cei_converters.conversion.workers import ShardTask

    place.keep()
    shards, rest = ShardTask(str(place.root), missing, threads=1), _Rest(str(place.root))
    logs = place.root.with_name(f"{place.root.name}.slurm")
    job = submit_slurm(shards, rest, len(missing), config.workers or -1, logs, config.slurm)
    print(f"Submitted {len(missing)} shards to Slurm; job {job} then makes {place.root}. Logs: {logs}.")
    return {"root": str(place.root), "repo_id": config.new_repo_id, "dry_run": False, "job": job}


def _upload(config: ConvertConfig, root: Path) -> None:
    """Upload a finished dataset, if it is asked for.

    Raises:
        CEIError: it could not be uploaded.
    """
    from cei_converters.dataset.hub import push

    if config.push_to_hub:
        to = {"private": config.private, "branch": config.branch, "pull_request": config.pull_request}
        try:
            print(f"Uploaded to {push(root, str(config.new_repo_id), **to)}.")
        except CEIError as error:
            raise CEIError(f"{error} The same command with --resume goes on.") from error


@dataclass(frozen=True)
class _Rest:
    """What is left to do in the last of a conversion's jobs: the dataset of its shards."""

    root: str

    def __call__(self, data: object = None, rank: int = 0, world_size: int = 1) -> None:
        from cei_converters.conversion.plan import Plan
        from cei_converters.conversion.workplace import Workplace

        place = Workplace(Path(self.root), resume=True)
        plan = Plan.load(place.plan)
        place.check_complete(len(plan.shards))
        here = {"executor": "local", "slurm": SlurmOptions(), "workers": 1, "resume": True}
        convert(replace(plan.config, new_root=Path(self.root), **here))


def _new_root(config: ConvertConfig) -> Path:
    from cei_converters.dataset.writer import default_root

    return Path(config.new_root) if config.new_root is not None else default_root(str(config.new_repo_id))


def _check_fit(config: ConvertConfig, reader: "Recorded") -> None:
    """Check that a dataset has what options are about.

    Raises:
        CEIError: an option changes nothing with this dataset.
    """
    if reader.metadata is not None and config.source_pose is not None:
        raise CEIError(f"{reader.repo_id} says where its base is (meta/cei.json); leave out --source_pose.")
    if not (reader.has_clouds or reader.depth_cameras):
        check_of_use(
            config, dict.fromkeys(("clouds.*", "check_clouds"), "where a dataset has neither depth nor clouds")
        )


def _about_cameras(reader: "Recorded", pass_through: bool) -> str:
    """One line: what becomes of the dataset's cameras."""
    if reader.depth_cameras:
        clouds = f"Clouds are made from the depth of {', '.join(reader.depth_cameras)}"
    elif reader.has_clouds:
        clouds = "Clouds are made from the recorded ones"
    else:
        clouds = "Neither depth nor clouds: converted in joints"
    if not reader.cameras:
        return clouds + "."
    if not pass_through:
        return f"{clouds}; left out, as they show objects where they were recorded: {', '.join(reader.cameras)}."
    return f"{clouds}; passed through untouched, so they still show the source robot: {', '.join(reader.cameras)}."


def _notes(converter: "Converter") -> dict[str, list[str]]:
    """What was assumed or left out of the descriptions of robots, by their names; nothing of those of which nothing is said."""
    return {body.name: [*body.notes] for body in (converter.reader.embodiment, converter.transfer.target) if body.notes}


def _about_columns(reader: "Recorded") -> list[str]:
    """A line each: which features are carried over as they are, and which are not, and why."""
    lines = [f"Carried over as they are: {', '.join(reader.carried)}."] if reader.carried else []
    reasons: dict[str, list[str]] = {}
    for name, reason in reader.dropped.items():
        reasons.setdefault(reason, []).append(name)
    return [*lines, *(f"Not carried over, {reason}: {', '.join(names)}." for reason, names in reasons.items())]


def _about_table(z_m: float) -> str:
    return (
        f"warning: nothing says where the table is, so it is taken to be at {z_m:g} m (world), where the source's lowest point was; if it is "
        "elsewhere, give --table_z_m, or a --calibration with workspace_world."
    )


def _provenance(config: ConvertConfig, converter: "Converter", content: str) -> "Provenance":
    """How the dataset comes about; `content` is the fingerprint of the one that is converted."""
    from cei_converters.dataset.license import source_license
    from cei_converters.dataset.metadata import Source
    from cei_converters.dataset.provenance import collect, command_line, published
    from cei_converters.sources.joint_map import load_joint_map
    from cei_gym.embodiment import fingerprint as identity

    reader, root = converter.reader, config.dataset.root
    source = Source(
        repo_id=reader.repo_id,
        embodiment=reader.embodiment.name,
        root_name=Path(root).name if root else None,
        revision=_revision(reader.root) if root is None else None,
        fingerprint=content,
        depth_cameras=reader.depth_cameras,
        carried=tuple(reader.carried),
        dropped=dict(reader.dropped),
        **source_license(reader.root),
    )
    options = published(config)
    del options["dataset"]  # which is the source
    options["table"] = {"z_m": reader.scene.support_z_m, "said_by": reader.table_from}
    inputs = {
        "source embodiment": identity(reader.embodiment),
        "target embodiment": identity(converter.transfer.target),
        **_files(config),
    }
    if config.joint_map is not None:
        options["joint_map"] = load_joint_map(config.joint_map)
    return collect(options, command_line("cei-convert", config), source=source, inputs=inputs, notes=_notes(converter))


def _revision(root: Path) -> str | None:
    """Commit of a dataset in the hub's cache, where folders are named by it."""
    return root.name if root.parent.name == "snapshots" else None


def main(args: list[str] | None = None) -> int:
    """Entry point of `cei-convert`."""
    return run(ConvertConfig, convert, args, prog="cei-convert", example=EXAMPLE)


if __name__ == "__main__":
    from cei_converters import start  # whose module is not __main__: workers get what it sends by name

    raise SystemExit(start.convert())
