"""`cei-convert`: one robot's LeRobot dataset becomes another's."""

import contextlib
import os
from collections import defaultdict
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cei_converters import calibration
from cei_converters.cli import DatasetConfig, run
from cei_converters.options import parse_episodes, parse_pose
from cei_converters.quality import check_reached, print_table
from cei_converters.verify import Verdict, Verifier, VerifyOptions, check_kept, open_stage, sentence, summarise, without
from cei_gym.alignment import ContactOptions, InitialisationOptions, SolverOptions
from cei_gym.errors import CEIError, unknown
from cei_gym.pointcloud import CloudOptions
from cei_gym.transfer import TransferOptions

if TYPE_CHECKING:
    from cei_converters.metadata import Environment, Provenance
    from cei_converters.reader import DatasetReader
    from cei_converters.writer import DatasetWriter
    from cei_gym.alignment import AlignmentReport
    from cei_gym.demonstration import Demonstration
    from cei_gym.transfer import Transfer

EXAMPLE = (
    """example:
  cei-convert --dataset.repo_id=me/pick_panda --target=IIWA-Inspire --new_repo_id=me/pick_iiwa
  cei-convert --dataset.repo_id=me/pick_panda --dataset.root=data/pick_panda --target=IIWA-Inspire \\
      --episodes=0,3,5 --dry_run
  cei-convert --dataset.repo_id=me/pick_panda --target=IIWA-Inspire --new_repo_id=me/pick_iiwa --verify --verify.drop
  cei-convert --dataset.repo_id=me/real_panda --source=Panda-PandaGripper --calibration=cameras.yaml \\
      --target=IIWA-Inspire --new_repo_id=me/real_iiwa

"""
    + calibration.FORMAT
)
# the frame-0 basin is chosen on this many episodes, spread over the dataset, however large it is
FIT_EPISODES = 8


@dataclass
class ConvertConfig:
    """Convert a LeRobot dataset of one robot into the same demonstrations by another."""

    dataset: DatasetConfig
    target: str  # Embodiment to convert to, <Arm>-<EndEffector>.
    new_repo_id: str | None = None  # Name of the converted dataset, <user>/<name>.
    new_root: str | None = None  # Its folder, which must not exist; default: LeRobot's cache.
    source: str | None = None  # Embodiment of a dataset that does not say it (no meta/cei.json).
    source_pose: str | None = None  # Base pose of such a dataset: x,y,z in m, then maybe qw,qx,qy,qz.
    calibration: str | None = None  # YAML with the depth cameras of a dataset; it wins over meta/cei.json. See below.
    target_pose: str | None = None  # Base pose of the target, same form; default: where the source's base is.
    episodes: str | None = None  # Episodes to convert, such as 0,3,5; default: all.
    dry_run: bool = False  # Align and report, write no dataset.
    allow_unreachable: bool = False  # Keep episodes in which the target cannot reach every frame.
    push_to_hub: bool = False  # Upload the converted dataset.
    private: bool = False  # Make the uploaded dataset private.
    json: str | None = None  # File for the result as JSON.
    workers: int | None = None  # Episodes that are moved at the same time; default: one a core. With --verify, one.
    init: InitialisationOptions = field(default_factory=InitialisationOptions)
    solver: SolverOptions = field(default_factory=SolverOptions)
    contact: ContactOptions = field(default_factory=ContactOptions)
    transfer: TransferOptions = field(default_factory=TransferOptions)
    clouds: CloudOptions = field(default_factory=CloudOptions)
    verify: VerifyOptions = field(default_factory=VerifyOptions)  # Replay and retry, with --verify.


def convert(config: ConvertConfig) -> dict[str, Any]:
    """Convert a dataset; print a table of the quality of each episode.

    Returns:
        The result: source, target, under `results` one entry an episode, under `residuals` the same frame by frame,
        under `verify` what replaying showed, if asked for. Episodes that verification drops are in the last only.

    Raises:
        CEIError: bad options or data, an episode that the target cannot reach, or none that verification keeps.
    """
    selection = parse_episodes(config.episodes)
    T_world_base = parse_pose("--source_pose", config.source_pose)
    _check_options(config)
    calibrated = None if config.calibration is None else calibration.load_calibration(config.calibration)
    if calibrated is not None and calibrated.T_world_base is not None and T_world_base is not None:
        raise CEIError("--source_pose and T_world_base of --calibration are the same thing; give one.")

    from cei_converters.provenance import fingerprint
    from cei_converters.reader import DatasetReader
    from cei_converters.result import check_json_path, write_json
    from cei_gym.embodiment import load_embodiment
    from cei_gym.transfer import Transfer

    check_json_path(config.json)
    reader = DatasetReader(
        config.dataset.repo_id,
        config.dataset.root,
        embodiment=config.source,
        T_world_base=T_world_base,
        calibration=calibrated,
    )
    selected = reader.select(selection)
    reader.check_videos(selected)
    print(_about_cameras(reader))
    with contextlib.ExitStack() as stack:
        writer = None
        if not config.dry_run:
            writer = stack.enter_context(_writer(config, reader, fingerprint(reader.root)))
        pose = parse_pose("--target_pose", config.target_pose)
        transfer = Transfer(
            reader.embodiment,
            load_embodiment(config.target),
            config.transfer,
            config.solver,
            config.init,
            config.contact,
            config.clouds,
            pose,
        )
        verifier = None
        if config.verify.enabled:
            base = reader.scene.T_world_base if pose is None else pose
            stage = open_stage(reader.repo_id, _environment(reader, config.target), config.target, base)
            verifier = Verifier(transfer, stack.enter_context(stage), config.verify, config.allow_unreachable)
        entries, residuals, verdicts, starts = _transfer_episodes(config, reader, selected, transfer, writer, verifier)
        print_table(_rows(entries, verdicts), f"{reader.embodiment.name} -> {config.target}")
        summary = summarise(verdicts) if verifier is not None else None
        if summary is not None:
            print(f"Verification: {sentence(summary)}.")
            check_kept(summary)
            entries, residuals = (without(summary["dropped"], each) for each in (entries, residuals))
        if writer is not None:
            writer.provenance = _with_choices(writer.provenance, transfer, summary)
            writer.environment = _with_start(writer.environment, starts)
        result = {
            "source": {"repo_id": reader.repo_id, "embodiment": reader.embodiment.name},
            "target": config.target,
            "repo_id": None if config.dry_run else config.new_repo_id,
            "root": str(writer.root) if writer is not None else None,
            "dry_run": config.dry_run,
            "depth_cameras": list(reader.depth_cameras),
            "passed_through": list(reader.cameras),
            "ignored_features": reader.ignored_features,
            "episodes": len(entries),
            "frames": sum(entry["frames"] for entry in entries),
            "results": entries,
            "residuals": residuals,
            **({"verify": summary} if summary is not None else {}),
        }
        if config.dry_run:
            write_json(config.json, result)
            if not config.allow_unreachable:
                check_reached(config.target, entries)
    if writer is not None:
        write_json(config.json, result)
        print(f"Wrote {len(entries)} episodes to {writer.root}.")
        if config.push_to_hub:
            from cei_converters.hub import push

            push(writer.root, writer.repo_id, private=config.private)
    return result


def _check_options(config: ConvertConfig) -> None:
    """Fail before any work is done, not after it."""
    from cei_gym.embodiment import embodiment_names

    for name in (config.target, config.source):
        if name is not None and name not in embodiment_names():
            raise unknown("embodiment", name, embodiment_names())
    if config.workers is not None and config.workers < 1:
        raise CEIError(f"--workers={config.workers} must be at least 1.")
    if config.dry_run and config.push_to_hub:
        raise CEIError("--dry_run writes nothing, so there is nothing for --push_to_hub; leave one out.")
    if not config.dry_run:
        from cei_converters.hub import check_repo_id

        if config.new_repo_id is None:
            raise CEIError("--new_repo_id=<user>/<name> is required, or --dry_run.")
        check_repo_id(config.new_repo_id)
    if config.push_to_hub:
        from cei_converters.hub import check_login

        check_login()


def _about_cameras(reader: "DatasetReader") -> str:
    """One line: what becomes of the dataset's cameras."""
    if reader.depth_cameras:
        clouds = f"Clouds are made from the depth of {', '.join(reader.depth_cameras)}"
    elif reader.has_clouds:
        clouds = "Clouds are made from the recorded ones"
    else:
        clouds = "Neither depth nor clouds: converted in joints"
    if not reader.cameras:
        return clouds + "."
    return f"{clouds}; passed through untouched, so they still show the source robot: {', '.join(reader.cameras)}."


def _writer(config: ConvertConfig, reader: "DatasetReader", source_fingerprint: str) -> "DatasetWriter":
    from cei_converters.card import source_license
    from cei_converters.metadata import Source
    from cei_converters.provenance import collect
    from cei_converters.writer import DatasetWriter

    assert config.new_repo_id is not None
    source = Source(
        repo_id=reader.repo_id,
        embodiment=reader.embodiment.name,
        root_name=reader.root.name if config.dataset.root else None,
        revision=_revision(reader.root) if config.dataset.root is None else None,
        fingerprint=source_fingerprint,
        license=source_license(reader.root),
        depth_cameras=reader.depth_cameras,
    )
    options = {
        "target": config.target,
        "target_pose": config.target_pose,
        **({"calibration": Path(config.calibration).name} if config.calibration else {}),
        "episodes": config.episodes,
        "allow_unreachable": config.allow_unreachable,
        "init": config.init,
        "solver": config.solver,
        "contact": config.contact,
        "transfer": config.transfer,
        "clouds": config.clouds,
        **({"verify": config.verify} if config.verify.enabled else {}),
    }
    return DatasetWriter(
        config.new_repo_id,
        config.new_root,
        environment=_environment(reader, config.target),
        provenance=collect(options, source=source),
        cameras=reader.cameras,
    )


def _with_choices(provenance: "Provenance", transfer: "Transfer", summary: dict[str, Any] | None) -> "Provenance":
    """Provenance with what was decided on the way: where trajectories start, on which pads, which episodes are dropped."""
    from cei_converters.metadata import plain

    pads = {e.name: plain(e.end_effector.pads) for e in (transfer.source, transfer.target) if e.end_effector}
    options = provenance.options | {"basins": plain(transfer.basins)}
    if summary is not None:
        options["verify"] = options["verify"] | {"dropped": summary["dropped"]}
    return replace(provenance, pads=pads, options=options)


def _revision(root: Path) -> str | None:
    """Commit of a dataset in the hub's cache, where folders are named by it."""
    return root.name if root.parent.name == "snapshots" else None


def _environment(reader: "DatasetReader", target: str) -> "Environment":
    """The source's environment with the robot exchanged; it still starts at that robot's home."""
    from cei_converters.metadata import Environment

    known = reader.metadata.environment if reader.metadata is not None else Environment()
    source = reader.embodiment.name
    if known.id is None or not known.id.endswith(source):
        return Environment()
    kwargs = {name: value for name, value in known.kwargs.items() if name != "start_qpos"}
    return Environment(known.id.removesuffix(source) + target, kwargs)


def _with_start(environment: "Environment", starts: dict[int, list[np.ndarray]]) -> "Environment":
    """The environment with episodes that start where the demonstrations of each mode do: a policy knows no other way."""
    if environment.id is None:
        return environment
    middles = [np.round(np.median(qpos, axis=0), 4).tolist() for _, qpos in sorted(starts.items())]
    return replace(environment, kwargs=environment.kwargs | {"start_qpos": middles})


def _rows(entries: list[dict[str, Any]], verdicts: list[Verdict]) -> list[dict[str, Any]]:
    """The table's rows, with what verification found, if there was any."""
    if not verdicts:
        return entries
    return [entry | verdict.row() for entry, verdict in zip(entries, verdicts, strict=True)]


def _transfer_episodes(
    config: ConvertConfig,
    reader: "DatasetReader",
    selected: list[int],
    transfer: "Transfer",
    writer: "DatasetWriter | None",
    verifier: Verifier | None,
) -> tuple[list[dict[str, Any]], list[dict[str, Any]], list[Verdict], dict[int, list[np.ndarray]]]:
    """Summaries for the table, residuals frame by frame, and what a verifier says; dropped episodes included. Last, by mode,
    the joints at which those that are kept start."""
    from threadpoolctl import threadpool_limits

    from cei_converters.progress import progress_bar
    from cei_converters.workers import in_order

    def moved(item: tuple[int, int]) -> tuple["Demonstration", "AlignmentReport", Verdict | None]:
        i, index = item
        recorded, mode = (
            reader.read(index, colours=config.clouds.colours),
            i % config.init.modes,
        )  # motions take turns: a dataset is an even mixture
        return (*transfer(recorded, mode), None) if verifier is None else verifier(recorded, mode)

    entries, residuals, verdicts = [], [], []
    starts: dict[int, list[np.ndarray]] = defaultdict(list)
    # BLAS's own threads would spin on the cores that our workers have, waiting for the next product of a few thousand points.
    with progress_bar("frames") as progress, threadpool_limits(1, user_api="blas"):
        task = progress.add_task("choosing the start", total=sum(reader.frames(index) for index in selected))
        spread = sorted({round(i) for i in np.linspace(0, len(selected) - 1, FIT_EPISODES)})
        transfer.fit([reader.read(selected[i], colours=False) for i in spread])
        workers = 1 if verifier is not None else config.workers or os.cpu_count() or 1  # a simulation is for one thread
        results = in_order(moved, enumerate(selected), workers)
        for i, (index, (demonstration, report, verdict)) in enumerate(zip(selected, results, strict=True)):
            progress.update(task, description=f"episode {index}")
            record: dict[str, Any] = {**reader.record(index), "source_episode": index}
            for of_the_source in ("verified", "source_frames"):
                record.pop(of_the_source, None)
            if verdict is not None:
                verdicts.append(verdict)
                record["verified"] = verdict.record()
            mode = i % config.init.modes
            summary = report.summary() | ({"mode": mode} if config.init.modes > 1 else {})
            entry = {"episode": index, "frames": len(demonstration), **summary}
            entries.append(entry)
            frames = {"pad_distance_mm": report.pad_distance_mm, "normal_angle_deg": report.normal_angle_deg}
            residuals.append({"episode": index, **frames})
            if writer is not None and not (verdict is not None and verdict.dropped):
                if not config.allow_unreachable:
                    check_reached(config.target, [entry])
                if demonstration.source_frames is not None:
                    record["source_frames"] = demonstration.source_frames.tolist()
                pictures = reader.pictures(index).at(demonstration.source_frames)
                writer.add(demonstration, {**record, "alignment": summary}, pictures)
                starts[mode].append(demonstration.qpos[0])
            progress.advance(task, len(demonstration))
    return entries, residuals, verdicts, starts


def main(args: list[str] | None = None) -> int:
    """Entry point of `cei-convert`."""
    return run(ConvertConfig, convert, args, prog="cei-convert", example=EXAMPLE)


if __name__ == "__main__":
    raise SystemExit(main())
