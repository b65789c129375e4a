"""Options of a conversion, and what can be said against them before any work."""

from dataclasses import dataclass, field
from pathlib import Path

from cei_converters.cli import DatasetConfig
from cei_converters.cli.options import check_of_use, check_overwrite, check_range, parse_episodes, parse_pose
from cei_converters.conversion.augment import AugmentOptions
from cei_converters.conversion.cameras import CameraOptions
from cei_converters.conversion.evidence import EvidenceOptions
from cei_converters.conversion.executors import NAMES as EXECUTORS
from cei_converters.conversion.executors import SlurmOptions, check_executor
from cei_converters.conversion.gate import Gate
from cei_converters.conversion.refine import RefineOptions
from cei_converters.conversion.verify import VerifyOptions
from cei_gym.alignment import ContactOptions, InitialisationOptions, SolverOptions
from cei_gym.arrays import Array
from cei_gym.errors import CEIError, unknown
from cei_gym.pointcloud import CloudOptions
from cei_gym.transfer import TransferOptions

AUTO = "auto"
"""What `--target_pose` is where the pose is searched."""


@dataclass
class ConvertConfig:
    """Convert a LeRobot dataset of one robot into the same demonstrations by another."""

    dataset: DatasetConfig
    target: str  # Embodiment to convert to, <Arm>-<EndEffector>.
    new_repo_id: str | None = None  # Name of the converted dataset, <user>/<name>.
    new_root: Path | None = None  # Its folder, which must not exist; default: LeRobot's cache.
    source: str | None = None  # Embodiment of a dataset that does not say it (no meta/cei.json).
    source_pose: str | None = None  # Base pose of such a dataset: x,y,z in m, then maybe qw,qx,qy,qz.
    calibration: Path | None = None  # YAML with the cameras of a dataset; it wins over meta/cei.json. See above.
    joint_map: Path | None = None  # YAML that tells which columns of a dataset are which joints. See above.
    check_clouds: bool = True  # Refuse clouds that do not show the source where its joints say.
    table_z_m: float | None = None  # World, m; default: the workspace's floor, else the source's lowest point.
    drop_features: str | None = None  # What not to carry over of what it says it does, such as next.reward,next.done.
    package_path: list[Path] | None = None  # Folders to look for robots' ROS packages in, separated by colons.
    target_pose: str | None = None  # Base pose of the target, same form, or auto: searched; default: the source's.
    episodes: str | None = None  # Episodes to convert, such as 0,3,5 or 0-99; default: all.
    dry_run: bool = False  # Align and report, write no dataset.
    steps: list[str] | None = None  # Steps of installed packages, in this order, such as [paint].
    allow_unreachable: bool = False  # Keep episodes in which the target cannot reach every frame.
    privileged_state: bool = False  # Let policies see the state of objects, as observation.environment_state.
    min_quality: float | None = None  # Leave out what is not known to work with this probability, from 0 to 1.
    flag: float | None = None  # Keep what is not known to work with this one, and mark it.
    drop_strays: bool = False  # Leave out episodes in which the target goes another way in its joints.
    push_to_hub: bool = False  # Upload the converted dataset.
    private: bool = False  # Make the uploaded dataset private.
    branch: str | None = None  # Upload to this branch, made if there is none; default: main.
    pull_request: bool = False  # Upload to a pull request.
    json: Path | None = None  # File for the result as JSON.
    overwrite: bool = False  # Replace a JSON file that is there already; never a dataset.
    workers: int | None = None  # Episodes that are moved at the same time; default: one a core.
    executor: str = "local"  # Who converts: local (this machine), slurm or ray; the dataset is the same.
    slurm: SlurmOptions = field(default_factory=SlurmOptions)
    shard_episodes: int = 50  # Episodes that are converted as one piece of work, lost if it is interrupted.
    resume: bool = False  # Go on with a conversion that was interrupted, with the options it was begun with.
    init: InitialisationOptions = field(default_factory=InitialisationOptions)
    solver: SolverOptions = field(default_factory=SolverOptions)
    contact: ContactOptions = field(default_factory=ContactOptions)
    transfer: TransferOptions = field(default_factory=TransferOptions)
    clouds: CloudOptions = field(default_factory=CloudOptions)
    cameras: CameraOptions = field(default_factory=CameraOptions)  # Pictures: which, and with which robot in them.
    augment: AugmentOptions = field(default_factory=AugmentOptions)  # Objects elsewhere, with --augment.grid.
    verify: VerifyOptions = field(default_factory=VerifyOptions)  # Replay and retry, with --verify.
    refine: RefineOptions = field(default_factory=RefineOptions)  # Search how to take hold by rollouts, with --refine.
    evidence: EvidenceOptions = field(default_factory=EvidenceOptions)  # Ask a twin of the recording, with --evidence.

    def __post_init__(self) -> None:
        parse_episodes(self.episodes)
        parse_pose("--source_pose", self.source_pose)
        if self.target_pose == AUTO and self.transfer.method == "bms":
            raise CEIError(
                "--target_pose=auto judges places by how pads follow, which --transfer.method=bms does not; give a pose."
            )
        _ = self.T_world_target  # which is checked as it is read
        check_range("--workers", self.workers, 1)
        check_range("--shard_episodes", self.shard_episodes, 1)
        check_overwrite(self.overwrite, self.json)
        _ = self.gate  # which checks itself
        for name in self.gate.bounds:
            if not (self.evidence.enabled or self.replays):
                raise CEIError(
                    f"--{name} is about the probability that an episode works, which nothing tells here: add --verify or --refine where the task has an "
                    "environment, else --evidence (a twin of the recording)."
                )
        if self.executor not in EXECUTORS:
            raise unknown("executor", self.executor, EXECUTORS)
        if self.dry_run:
            for option, why in _NOT_DRY.items():
                if getattr(self, option):
                    raise CEIError(f"--dry_run {why} --{option}; leave one out.")
            if self.executor == "slurm":
                raise CEIError("--dry_run is done at once, here; leave out --executor=slurm.")
        if self.evidence.enabled and self.replays:
            raise CEIError(
                "--verify and --refine ask the environment itself, which knows better than the twin of --evidence; leave one out."
            )
        if self.evidence.enabled and self.augment.enabled:
            raise CEIError("--evidence needs what cameras saw of objects, which --augment.* moves; leave one out.")
        if self.augment.enabled and (self.cameras.paint or self.cameras.keep):
            option = "paint" if self.cameras.paint else "keep"
            raise CEIError(
                f"--augment.* moves objects, which pictures do not show, so that none are kept; leave out --cameras.{option}."
            )
        if self.augment.enabled and not self.clouds.swap:
            raise CEIError(
                "--clouds.swap=false keeps the source in the clouds, which --augment.* cannot move; leave one out."
            )
        check_of_use(self, _idle(self))

    @property
    def T_world_target(self) -> Array | None:
        """(4, 4) pose that is given for the target's base; None where it is the source's, or searched.

        Raises:
            CEIError: it cannot be read.
        """
        return None if self.target_pose == AUTO else parse_pose("--target_pose", self.target_pose, AUTO)

    @property
    def replays(self) -> bool:
        """Whether episodes are replayed as they are converted."""
        return self.verify.enabled or self.refine.enabled

    @property
    def gate(self) -> Gate:
        """What `min_quality` and `flag` ask for."""
        return Gate(self.min_quality, self.flag)


_NOT_DRY = {
    "push_to_hub": "writes nothing, so there is nothing for",
    "resume": "keeps nothing that could be gone on with, by",
}


def _idle(config: ConvertConfig) -> dict[str, str]:
    """Patterns of options that change nothing beside the others, and why."""
    idle = {}
    if config.executor != "slurm":
        idle["slurm.*"] = "without --executor=slurm"
    if config.solver.backend != "paper":
        idle["solver.paper.*"] = "without --solver.backend=paper"
    else:
        second_order = ("temporal_weight", "smoothness_weight", "iterations")
        idle |= dict.fromkeys((f"solver.{name}" for name in second_order), "with --solver.backend=paper")
    if config.transfer.method == "bms":
        followed = ("init.*", "contact.*", "solver.backend", "solver.iterations", "solver.*_weight", "transfer.stretch")
        idle |= dict.fromkeys(followed, "with --transfer.method=bms, which follows no pads")
    if config.init.method != "eis":
        idle["init.draws"] = "without --init=eis"
    if config.init.method == "given":
        idle |= dict.fromkeys(("init.starts", "init.seed"), "with --init=given")
    if config.contact.opposition_weight == 0:
        weights = ("facing", "approach", "turning", "carrying", "posture")
        idle |= dict.fromkeys((f"contact.{name}_weight" for name in weights), "with --contact.opposition_weight=0")
    if not config.clouds.swap:
        put_in = ("robot_share", "robot_points", "voxel_m", "seen_only")
        idle |= dict.fromkeys((f"clouds.{name}" for name in put_in), "with --clouds.swap=false, which puts no robot in")
    if not config.cameras.paint:
        idle["cameras.margin_px"] = "without --cameras.paint"
    if config.augment.rotation_deg == 0:
        idle["augment.seed"] = "without --augment.rotation_deg"
    if config.augment.objects != "state":
        idle["augment.half_m"] = "without --augment.objects=state"
    return idle


def check_options(config: ConvertConfig) -> None:
    """Fail before any work is done, not after it, if what options name is not there.

    Raises:
        CEIError: an embodiment, an executor, a login is missing.
    """
    from cei_converters.dataset.hub import check_destination, check_repo_id
    from cei_gym.embodiment import check_embodiment

    for name in (config.target, config.source):
        if name is not None:
            check_embodiment(name)
    if config.steps:
        from cei_converters.conversion.steps import check_steps

        check_steps(config.steps)
    check_executor(config.executor, config.slurm)
    check_repo_id(config.dataset.repo_id)
    if not config.dry_run:
        if config.new_repo_id is None:
            raise CEIError("--new_repo_id=<user>/<name> is required, or --dry_run.")
        check_repo_id(config.new_repo_id)
    check_destination(config.push_to_hub, config.private, config.branch, config.pull_request)
