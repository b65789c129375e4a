"""Options of a conversion, and what can be said against them before any work."""

import math
from dataclasses import dataclass, field

from cei_converters.cli import DatasetConfig
from cei_converters.conversion.augment import AugmentOptions
from cei_converters.conversion.executors import SlurmOptions, check_executor
from cei_converters.conversion.gate import Gate
from cei_converters.conversion.verify import VerifyOptions
from cei_gym.alignment import ContactOptions, InitialisationOptions, SolverOptions
from cei_gym.errors import CEIError, unknown
from cei_gym.pointcloud import CloudOptions
from cei_gym.transfer import TransferOptions


@dataclass
class ConvertConfig:
    """Convert a LeRobot dataset of one robot into the same demonstrations by another."""

    dataset: DatasetConfig
    target: str  # Embodiment to convert to, <Arm>-<EndEffector>.
    new_repo_id: str | None = None  # Name of the converted dataset, <user>/<name>.
    new_root: str | None = None  # Its folder, which must not exist; default: LeRobot's cache.
    source: str | None = None  # Embodiment of a dataset that does not say it (no meta/cei.json).
    source_pose: str | None = None  # Base pose of such a dataset: x,y,z in m, then maybe qw,qx,qy,qz.
    calibration: str | None = None  # YAML with the depth cameras of a dataset; it wins over meta/cei.json. See above.
    joint_map: str | None = None  # YAML that tells which columns of a dataset are which joints. See above.
    table_z_m: float | None = None  # World, m; default: the workspace's floor, else the source's lowest point.
    drop_features: str | None = None  # What not to carry over of what it says it does, such as next.reward,next.done.
    target_pose: str | None = None  # Base pose of the target, same form; default: where the source's base is.
    episodes: str | None = None  # Episodes to convert, such as 0,3,5 or 0-99; default: all.
    dry_run: bool = False  # Align and report, write no dataset.
    allow_unreachable: bool = False  # Keep episodes in which the target cannot reach every frame.
    min_quality: float | None = None  # Leave out episodes whose quality, from 0 to 1, is lower.
    flag: float | None = None  # Keep episodes whose quality is lower, and mark them.
    push_to_hub: bool = False  # Upload the converted dataset.
    private: bool = False  # Make the uploaded dataset private.
    branch: str | None = None  # Upload to this branch, made if there is none; default: main.
    pull_request: bool = False  # Upload to a pull request.
    json: str | None = None  # File for the result as JSON.
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
    augment: AugmentOptions = field(default_factory=AugmentOptions)  # Objects elsewhere, with --augment.grid.
    verify: VerifyOptions = field(default_factory=VerifyOptions)  # Replay and retry, with --verify.

    @property
    def gate(self) -> Gate:
        """What `min_quality` and `flag` ask for."""
        return Gate(self.min_quality, self.flag)


def check_options(config: ConvertConfig) -> None:
    """Fail before any work is done, not after it."""
    from cei_gym.embodiment import embodiment_names

    for name in (config.target, config.source):
        if name is not None and name not in embodiment_names():
            raise unknown("embodiment", name, embodiment_names())
    if config.workers is not None and config.workers < 1:
        raise CEIError(f"--workers={config.workers} must be at least 1.")
    if config.table_z_m is not None and not math.isfinite(config.table_z_m):
        raise CEIError(f"--table_z_m={config.table_z_m} should be a finite number of metres.")
    check_executor(config.executor, config.slurm)
    Gate(config.min_quality, config.flag)
    if config.dry_run and config.executor == "slurm":
        raise CEIError("--dry_run is done at once, here; leave out --executor=slurm.")
    if config.shard_episodes < 1:
        raise CEIError(f"--shard_episodes={config.shard_episodes} must be at least 1.")
    if config.dry_run and config.push_to_hub:
        raise CEIError("--dry_run writes nothing, so there is nothing for --push_to_hub; leave one out.")
    if config.dry_run and config.resume:
        raise CEIError("--dry_run keeps nothing that --resume could go on with; leave one out.")
    if config.augment.enabled and not config.clouds.swap:
        raise CEIError(
            "--clouds.swap=false keeps the source in the clouds, which --augment.grid cannot move; leave one out."
        )
    if not config.dry_run:
        from cei_converters.dataset.hub import check_repo_id

        if config.new_repo_id is None:
            raise CEIError("--new_repo_id=<user>/<name> is required, or --dry_run.")
        check_repo_id(config.new_repo_id)
    from cei_converters.dataset.hub import check_destination

    check_destination(config.push_to_hub, config.branch, config.pull_request)
