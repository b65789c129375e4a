"""`cei-convert`: one robot's LeRobot dataset becomes another's."""

import contextlib
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cei_converters.cli import run
from cei_converters.conversion.assumptions import about_cameras, about_columns, about_table, notes_on_robots
from cei_converters.conversion.config import ConvertConfig, check_options
from cei_converters.conversion.executors import SlurmOptions
from cei_converters.conversion.fit import check_fit
from cei_converters.conversion.ordered_map import in_background
from cei_converters.conversion.origin import files_by_content, provenance_of
from cei_converters.conversion.plan import DATASET, PLACED
from cei_converters.conversion.reach import check_reached
from cei_converters.dataset.provenance import fingerprint
from cei_converters.sources import calibration, joint_map, pose
from cei_gym import extras
from cei_gym.errors import CEIError

if TYPE_CHECKING:
    from cei_converters.conversion.staging import StagingDirectory
    from cei_converters.dataset.metadata import Provenance

EXAMPLE = """example:
  cei-convert --dataset.repo_id=me/pick_panda --target=IIWA-Inspire --new_repo_id=me/pick_iiwa
  cei-convert --dataset.repo_id=me/pick_panda --dataset.root=data/pick_panda --target=IIWA-Inspire \\
      --episodes=0,3,5 --dry_run
  cei-convert --dataset.repo_id=me/pick_panda --target=IIWA-Inspire --new_repo_id=me/pick_iiwa --verify --verify.drop
  cei-convert --dataset.repo_id=me/pick_panda --target=IIWA-Inspire --new_repo_id=me/pick_iiwa \\
      --evidence --min_quality=0.5 --flag=0.8 --push_to_hub --branch=iiwa
  cei-convert --dataset.repo_id=me/real_panda --source=Panda-PandaGripper --calibration=cameras.yaml \\
      --target=IIWA-Inspire --new_repo_id=me/real_iiwa --cameras.paint
  cei-convert --dataset.repo_id=me/pick_panda --episodes=0 --target=UR5e-FourierRight --new_repo_id=me/pick_anywhere \\
      --augment.grid=10,10 --augment.range=0.2,0.2 --augment.rotation_deg=30

""" + "\n\n".join((calibration.FORMAT, joint_map.FORMAT, pose.FORMAT))


def convert(config: ConvertConfig) -> dict[str, Any]:
    """Convert a dataset; print a table of how good each episode is.

    Returns:
        The result: source, target, under `results` one entry an episode, under `verify` what replaying showed, if asked for,
        under `evidence` what twins of the recordings say, if asked for,
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
    from cei_converters.conversion.outcomes import residuals, summarise_conversion
    from cei_converters.conversion.painting import in_words
    from cei_converters.conversion.plan import Plan, to_begin_anew
    from cei_converters.conversion.planned import planned
    from cei_converters.conversion.staging import StagingDirectory
    from cei_converters.conversion.stand import stand
    from cei_converters.conversion.survey import LOWEST, survey
    from cei_converters.conversion.workers import convert_shards, default_workers, processes_for
    from cei_converters.conversion.writing import Writing
    from cei_converters.dataset.essentials import Remains
    from cei_converters.dataset.metadata import plain, restore_with
    from cei_converters.dataset.picture_encoding import VIDEO_ENCODER
    from cei_converters.dataset.place import temporary_folder

    if config.resume and (root := _new_root(config)).exists():
        return _finished(config, root)
    json = Outputs(config.overwrite, None if config.dry_run else _new_root(config)).file("--json", config.json, JSON)
    with contextlib.ExitStack() as stack:
        root = stack.enter_context(temporary_folder()) / "dry_run" if config.dry_run else _new_root(config)
        place = stack.enter_context(StagingDirectory(root, config.resume))
        writes = not config.dry_run and config.executor != "slurm"
        writing = stack.enter_context(Writing()) if writes else None
        begun = Plan.load(place.plan) if place.plan.exists() else None
        known = "" if begun is None else _check_unchanged(begun.provenance, config, to_begin_anew(place.folder))
        converter = stack.enter_context(Converter(config, None if config.dry_run else place.scratch))
        reader = converter.reader
        check_fit(config, reader)
        # it takes a second a gigabyte, beside the choice of the start
        content = (lambda: known) if known or config.dry_run else in_background(lambda: fingerprint(reader.root))
        for name, notes in notes_on_robots(converter).items():
            print("\n".join(f"note: {name}: {note}" for note in notes))
        reader.check_videos(sorted(set(converter.selected)))
        painting, shown = converter.painting, bool(converter.cameras)
        about = about_cameras(reader, shown, bool(config.steps), painting is not None)
        print("\n".join([about, *about_columns(reader)]))
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
            videos = any(feature["dtype"] == "video" for feature in converter.cameras.values())
            warm_up("cei_converters.conversion.preloaded", *[VIDEO_ENCODER] * videos)
        frames = [reader.frames(index) for index in converter.selected]
        progress = stack.enter_context(progress_bar("frames"))
        task = progress.add_task("reading joints", total=sum(frames))
        table_z_m = survey(reader, converter.selected, lambda done: progress.advance(task, done))
        if table_z_m is not None:
            reader.set_table(table_z_m, LOWEST)
            config = replace(config, table_z_m=table_z_m)
            progress.console.print(about_table(table_z_m), highlight=False, soft_wrap=True)
        agreed = {}
        if painting is not None:
            progress.reset(task, total=None, description="looking at pictures")
            agreed = painting.look()
            progress.console.print(in_words(agreed, config.target), highlight=False, soft_wrap=True)
        stand(config, place, begun, converter, progress, task)
        progress.reset(task, total=sum(frames), description="choosing the start")
        plan = planned(config, place, begun, converter, content, progress, task)
        if config.executor == "slurm" and (missing := place.missing(len(plan.shards))):
            return _submitted(config, place, missing)
        progress.reset(task, total=sum(frames), description="converting")
        if writing is not None:
            passed = {"cameras": converter.cameras, "carried": reader.carried}
            writing.begin(place.root, **plain({"environment": converter.environment, "tasks": reader.tasks, **passed}))
        convert_shards(place, plan, converter, workers, lambda done: progress.update(task, completed=done))
        progress.stop()
        summary = summarise_conversion(place, plan, f"{reader.embodiment.name} -> {config.target}")
        result = {
            "source": {"repo_id": reader.repo_id, "embodiment": reader.embodiment.name},
            "target": config.target,
            "repo_id": None if config.dry_run else config.new_repo_id,
            "root": None if config.dry_run else str(place.root),
            "dry_run": config.dry_run,
            "depth_cameras": list(reader.depth_cameras),
            "passed_through": [] if painting is not None else list(converter.cameras),
            "painted": {key: asdict(of) for key, of in agreed.items()},
            "carried_features": list(reader.carried),
            "dropped_features": reader.dropped,
            "table": {"z_m": reader.scene.support_z_m, "said_by": reader.table_from},
            "notes": notes_on_robots(converter),
            **({} if converter.placed is None else {PLACED: converter.placed}),
            "episodes": len(summary.entries),
            "frames": sum(entry["frames"] for entry in summary.entries),
            "results": summary.entries,
            **summary.choices,
        }
        if writing is not None:
            assemble(place, plan, converter, summary, writing)
        write_json(json, result, residuals=residuals(place, plan))
    if config.dry_run:
        if not config.allow_unreachable:
            check_reached(config.target, summary.entries)
        return result
    print(f"Wrote {len(summary.entries)} episodes to {place.root}.")
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
        check_same(metadata.provenance, provenance_of(config, converter, content), anew)
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
    check_unchanged(begun, {DATASET: content, **files_by_content(config)}, anew)
    return content


def _submitted(config: ConvertConfig, place: "StagingDirectory", missing: list[int]) -> dict[str, Any]:
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
        from cei_converters.conversion.staging import StagingDirectory

        place = StagingDirectory(Path(self.root), resume=True)
        plan = Plan.load(place.plan)
        place.check_complete(len(plan.shards))
        here = {"executor": "local", "slurm": SlurmOptions(), "workers": 1, "resume": True}
        convert(replace(plan.config, new_root=Path(self.root), **here))


def _new_root(config: ConvertConfig) -> Path:
    from cei_converters.dataset.writer import default_root

    return Path(config.new_root) if config.new_root is not None else default_root(str(config.new_repo_id))


def main(args: list[str] | None = None) -> int:
    """Entry point of `cei-convert`."""
    return run(ConvertConfig, convert, args, prog="cei-convert", example=EXAMPLE)


if __name__ == "__main__":
    from cei_converters import start  # whose module is not __main__: workers get what it sends by name

    raise SystemExit(start.convert())
