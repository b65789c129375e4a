"""One episode in, one converted episode out: reading, moving, verifying, encoding."""

import contextlib
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Self

from cei_converters.cli.options import parse_episodes, parse_pose
from cei_converters.conversion.agreement import check_clouds
from cei_converters.conversion.augment import Augmentation
from cei_converters.conversion.config import ConvertConfig
from cei_converters.conversion.gate import DROPPED, FLAGGED, LOW_QUALITY
from cei_converters.conversion.in_order import in_background, in_order
from cei_converters.conversion.reach import check_reached
from cei_converters.conversion.shard import Converted
from cei_converters.conversion.verify import Verdict, Verifier, open_stage
from cei_converters.dataset import schema
from cei_converters.dataset.carried import with_objects_moved
from cei_converters.dataset.columns import encode
from cei_converters.dataset.episodes import encode_episode
from cei_converters.dataset.metadata import SENSORS, START, Environment, plain
from cei_converters.dataset.writer import Header
from cei_converters.sources import calibration
from cei_converters.sources.formats import open_source
from cei_converters.sources.recording import spread
from cei_converters.sources.source import Source
from cei_gym.alignment import assess
from cei_gym.augmentation import Offset
from cei_gym.demonstration import Demonstration
from cei_gym.embodiment import load_embodiment, use_package_path
from cei_gym.errors import CEIError
from cei_gym.transfer import Transfer

if TYPE_CHECKING:
    from cei_gym.alignment import Basin

# the frame-0 basin is chosen on this many episodes, spread over the dataset, however large it is
FIT_EPISODES = 8


class Converter:
    """Converts the episodes of a dataset; a context manager that closes what it opened.

    Attributes:
        reader: of the dataset.
        selected: episodes to convert; each as often as augmentation asks for.
        cameras: LeRobot's features of cameras whose pictures pass through; none where objects are moved, which pictures do not show.
        transfer: what moves them; to be fitted first, by `fit` or `start_from`.
        T_world_target: (4, 4) pose of the target's base.

    Raises:
        CEIError: bad options or data.
    """

    def __init__(self, config: ConvertConfig) -> None:
        self._config = config
        use_package_path(config.package_path)
        target = in_background(lambda: load_embodiment(config.target))  # MuJoCo compiles for a second, without the GIL
        self.reader = open_reader(config)
        self.selected = self.reader.select(parse_episodes(config.episodes))
        pose = parse_pose("--target_pose", config.target_pose)
        self.T_world_target = self.reader.scene.T_world_base if pose is None else pose
        self.transfer = Transfer(
            self.reader.embodiment,
            target(),
            config.transfer,
            config.solver,
            config.init,
            config.contact,
            config.clouds,
            pose,
        )
        self._augmentation, self.cameras = None, self.reader.cameras
        if config.augment.enabled:
            self._augmentation, self.cameras = Augmentation(config.augment, self.reader, self.transfer), {}
            for name, reason in with_objects_moved(self.reader.carried).items():
                self.reader.drop([name], reason)
            self.selected = [index for index in self.selected for _ in range(len(self._augmentation))]
        self.environment = _environment(self.reader, config.target)
        self._opened = contextlib.ExitStack()
        self._verifier = None
        if config.verify.enabled:
            stage = open_stage(self.reader.repo_id, self.environment, config.target, self.T_world_target)
            self._opened.enter_context(stage)
            self._verifier = Verifier(self.transfer, stage, config.verify, config.allow_unreachable)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    def fit(self) -> None:
        """Choose where trajectories start, on a few episodes, whose clouds are checked first.

        Raises:
            CEIError: an episode cannot be read, or clouds do not show the source where its joints say.
        """
        with one_thread():
            read = [self._read(i, colours=False) for i in spread(len(self.selected), FIT_EPISODES)]
            if self._config.check_clouds and (told := check_clouds(self.transfer.source, [each[0] for each in read])):
                print(told)
            self.transfer.fit([demonstration for demonstration, _, inside in read if inside] or [read[0][0]])

    def start_from(self, finalists: "Sequence[Basin]") -> None:
        """Take what `fit` found elsewhere."""
        if finalists:
            self.transfer.start_from(finalists)
        else:  # the manual baseline looks at one episode, and quickly
            self.transfer.fit([self._read(0, colours=False)[0]])

    def convert(self, positions: Sequence[int], threads: int) -> Iterator[Converted]:
        """Converted episodes, in order.

        Args:
            positions: which of the selected.
            threads: episodes that are moved at the same time; one where they are verified, as a simulation is for one thread.

        Raises:
            CEIError: an episode cannot be read, or the target cannot reach it.
        """
        with one_thread():
            yield from in_order(self._convert, positions, 1 if self._verifier is not None else threads)

    def _read(self, position: int, colours: bool) -> tuple[Demonstration, Offset | None, bool]:
        """One of the selected, its objects' offset if it is augmented, and whether they are then in the workspace."""
        recorded = self.reader.read(self.selected[position], colours=colours)
        if self._augmentation is None:
            return recorded, None, True
        return self._augmentation(recorded, position % len(self._augmentation))

    def _convert(self, position: int) -> Converted:
        config, index = self._config, self.selected[position]
        recorded, offset, inside = self._read(position, colours=config.clouds.colours)
        mode = position % config.init.modes  # motions take turns: a dataset is an even mixture
        if self._verifier is None:
            moved, report = self.transfer(recorded, mode, clouds=not config.dry_run)
            verdict = None
        else:
            moved, report, verdict = self._verifier(recorded, mode)
        summary = report.summary() | ({"mode": mode} if config.init.modes > 1 else {})
        quality = assess(report)
        fate = config.gate.fate(quality.score)
        record = {**self.reader.record(index), "source_episode": index}
        for of_the_source in ("verified", "source_frames", "flagged", "offset"):
            record.pop(of_the_source, None)
        if offset is not None:
            record["offset"] = plain(offset)
        record["quality"] = {"score": quality.score, "parts": quality.parts}
        if fate == FLAGGED:
            record["flagged"] = True
        entry = {
            "episode": index,
            **record.get("offset", {}),
            "frames": len(moved),
            **recorded.figures,
            **summary,
            "quality": quality.score,
            "weakest": quality.weakest,
        }
        if verdict is not None:
            record["verified"] = verdict.record()
        source_frames = None if moved.source_frames is None else moved.source_frames.tolist()
        if source_frames is not None:
            record["source_frames"] = source_frames
        worst = quality.frame
        qpos_source = recorded.qpos[worst if moved.source_frames is None else moved.source_frames[worst]]
        frames = {"pad_distance_mm": report.pad_distance_mm, "normal_angle_deg": report.normal_angle_deg}
        outcome = {
            "entry": entry,
            "residuals": {"episode": index, **frames},
            "record": {**record, **recorded.figures, "alignment": summary},
            "worst": {"frame": worst, "qpos_source": qpos_source, "qpos_target": moved.qpos[worst]},
            "verdict": verdict,
            "left_out": self._left_out(inside, offset is not None and bool(report.unreachable_frames), verdict, fate),
            "mode": mode,
            "start_qpos": moved.qpos[0],
        }
        state_key = schema.state_key(config.privileged_state)
        header = Header.of(moved, state_key)
        kept = not config.dry_run and not outcome["left_out"]
        if kept and not config.allow_unreachable:
            check_reached(config.target, [entry])
        encoded = encode_episode(encode(moved, state_key), header.features, moved.task) if kept else None
        return Converted(plain(outcome), header, encoded)

    def _left_out(self, inside: bool, unreachable: bool, verdict: Verdict | None, fate: str) -> str:
        """Why an episode is left out of the dataset; empty if it is not. Recorded ones that are unreachable end the conversion."""
        if not inside:
            return "outside the workspace"
        if unreachable and not self._config.allow_unreachable:
            return "out of reach"
        if verdict is not None and verdict.dropped:
            return "fails"
        return LOW_QUALITY if fate == DROPPED else ""


def open_reader(config: ConvertConfig) -> Source:
    """The dataset to convert.

    Raises:
        CEIError: bad options or data.
    """
    T_world_base = parse_pose("--source_pose", config.source_pose)
    use_package_path(config.package_path)
    calibrated = None if config.calibration is None else calibration.load_calibration(config.calibration)
    if calibrated is not None and calibrated.T_world_base is not None and T_world_base is not None:
        raise CEIError("--source_pose and T_world_base of --calibration are the same thing; give one.")
    reader = open_source(
        config.dataset.repo_id,
        config.dataset.root,
        embodiment=config.source,
        T_world_base=T_world_base,
        calibration=calibrated,
        joint_map=config.joint_map,
    )
    if config.table_z_m is not None:
        reader.set_table(config.table_z_m, "--table_z_m")
    if config.drop_features is not None:
        reader.drop([name.strip() for name in config.drop_features.split(",")], "--drop_features")
    return reader


def one_thread() -> contextlib.AbstractContextManager:
    """BLAS keeps to one: its own would spin on the cores that our workers have, waiting for the next product of a few thousand
    points."""
    from threadpoolctl import threadpool_limits

    return threadpool_limits(1, user_api="blas")


def _environment(reader: Source, target: str) -> Environment:
    """The source's environment with the robot exchanged; it still starts at that robot's home."""
    known = reader.metadata.environment if reader.metadata is not None else Environment()
    source = reader.embodiment.name
    if known.id is None or not known.id.endswith(source):
        return Environment()
    kwargs = {name: value for name, value in known.kwargs.items() if name not in (START, SENSORS)}
    return Environment(known.id.removesuffix(source) + target, kwargs)
