"""One episode in, one converted episode out, through the steps that options ask for (`steps`)."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from cei_converters.cli.options import parse_episodes, parse_pose
from cei_converters.conversion.agreement import check_clouds
from cei_converters.conversion.augment import Augmentation
from cei_converters.conversion.cameras import NOT_KEPT
from cei_converters.conversion.config import AUTO, ConvertConfig
from cei_converters.conversion.encode import Encode
from cei_converters.conversion.episode import Converted
from cei_converters.conversion.evidence import Witness
from cei_converters.conversion.ordered_map import in_background, ordered_map
from cei_converters.conversion.painting import Painting
from cei_converters.conversion.placing import PLACE_EPISODES, sample
from cei_converters.conversion.starting import Chosen
from cei_converters.conversion.steps import Judge, OnRecorded, OnRetargeted, Read, Retarget, make_steps
from cei_converters.conversion.verify import Verifier, open_stage
from cei_converters.dataset import schema
from cei_converters.dataset.carried import with_objects_moved
from cei_converters.dataset.metadata import BASE, SENSORS, START, Environment, plain
from cei_converters.sources import calibration
from cei_converters.sources.formats import open_source
from cei_converters.sources.recording import spread
from cei_converters.sources.source import Source
from cei_gym.alignment.contact.correction import Correction
from cei_gym.arrays import Array
from cei_gym.embodiment import load_embodiment, use_package_path
from cei_gym.errors import CEIError
from cei_gym.transfer import Transfer
from cei_gym.transfer.placing import Placement, effort, find_place

if TYPE_CHECKING:
    from cei_converters.simulation.stage import Stage
    from cei_gym.alignment.start.basins import Basin

# the frame-0 basin is chosen on this many episodes, spread over the dataset, however large it is
FIT_EPISODES = 8
_ELSEWHERE_M = 0.05


class Converter:
    """Converts the episodes of a dataset; a context manager that closes what it opened.

    Args:
        config: the conversion's options.
        scratch: folder for files that are removed again; None if nothing is to be stored.

    Attributes:
        reader: of the dataset.
        selected: episodes to convert; each as often as augmentation asks for.
        cameras: LeRobot's features of cameras whose pictures are kept; none where objects are moved, which pictures do not show.
        painting: who paints the target in them, if that is asked for.
        transfer: what moves them; to be fitted first, by `fit` or `start_from`.
        target_pose: as the option has it, of the target's base; None where the source's is. To be said first, by `stand`, where it is
            searched.
        placed: what is kept of that search (`placing.record`), where there was one.
        T_world_target: (4, 4) the same.

    Raises:
        CEIError: bad options or data.
    """

    def __init__(self, config: ConvertConfig, scratch: Path | None = None) -> None:
        self._config = config
        use_package_path(config.package_path)
        target = in_background(lambda: load_embodiment(config.target))  # MuJoCo compiles for a second, without the GIL
        self.reader = open_reader(config)
        self.selected = self.reader.select(parse_episodes(config.episodes))
        self.transfer = Transfer(
            self.reader.embodiment,
            target(),
            config.transfer,
            config.solver,
            config.init,
            config.contact,
            config.clouds,
        )
        kept = config.cameras.kept([*self.reader.cameras])
        self.reader.keep_cameras(kept, NOT_KEPT)
        augmentation, self.cameras = None, self.reader.cameras
        if config.augment.enabled:
            augmentation, self.cameras = Augmentation(config.augment, self.reader, self.transfer), {}
            for name, reason in with_objects_moved(self.reader.carried).items():
                self.reader.drop([name], reason)
            self.selected = [index for index in self.selected for _ in range(len(augmentation))]
        self._opened = contextlib.ExitStack()
        added = make_steps(config.steps or (), self.transfer)
        on_recorded = [step for step in added if isinstance(step, OnRecorded)]
        on_retargeted = [step for step in added if isinstance(step, OnRetargeted)]
        stored = scratch is not None
        self._read = Read(
            self.reader,
            self.selected,
            augmentation,
            pictures=stored and bool(self.cameras),
            carried=stored and self.reader.carries,
            then=on_recorded,
        )
        witness = Witness(self.transfer, config.evidence) if config.evidence.enabled else None
        self.painting = (
            Painting(self.reader, self.transfer, self.cameras, self.selected, config.cameras)
            if config.cameras.paint
            else None
        )
        modes, mode = config.init.modes, config.init.mode
        painting = self.painting if stored else None
        self._retarget = Retarget(self.transfer, None, modes, stored, on_retargeted, mode, witness, painting)
        self._judge = Judge(config.gate, config.allow_unreachable, config.drop_strays, config.evidence.drop)
        self._encode = Encode(
            self.reader,
            config.target,
            schema.state_key(config.privileged_state),
            config.init.modes,
            config.allow_unreachable,
            scratch,
        )
        self.target_pose: str | None = None
        self.placed: dict[str, Any] | None = None
        self.T_world_target, self.environment = self.reader.scene.T_world_base, Environment()
        if config.target_pose != AUTO:
            self.stand(config.target_pose)
        elif config.replays:
            self._check_stands_anywhere()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    def stand(self, target_pose: str | None) -> None:
        """Stand the target somewhere, before `fit`.

        Args:
            target_pose: of its base, as the option has it; None where the source's base is.

        Raises:
            CEIError: it cannot be verified there.
        """
        pose = parse_pose("--target_pose", target_pose)
        self.target_pose = target_pose
        self.T_world_target = self.reader.scene.T_world_base if pose is None else pose
        self.transfer.stand(pose)
        self.environment = _environment(self.reader, self._config.target, pose)
        if self._config.replays:
            stage = self._opened.enter_context(self._open_stage(self.environment, self.T_world_target))
            config = self._config
            verifier = Verifier(self.transfer, stage, config.verify, config.allow_unreachable, config.refine)
            self._retarget = replace(self._retarget, verifier=verifier)

    def find_place(self, begin: Callable[[int], None], done: Callable[[int], None]) -> Placement:
        """Search where the target should stand, by frames of episodes spread over the dataset.

        Args:
            begin: called with about how many frames are to be solved.
            done: called with how many more are.

        Raises:
            CEIError: an episode cannot be read.
        """
        few = self._read.changes or not self.reader.quick
        with one_thread():
            sampled, whole = sample(self._read, FIT_EPISODES if few else PLACE_EPISODES)
            begin(effort(sum(map(len, sampled)), self.transfer, whole))
            return find_place(self.transfer, sampled, whole, self._config.init.seed, done)

    def fit(self) -> None:
        """Choose where trajectories start, on a few episodes, whose clouds are checked first.

        Raises:
            CEIError: an episode cannot be read, or clouds do not show the source where its joints say.
        """
        with one_thread():
            read = [self._read(i, quickly=True) for i in spread(len(self.selected), FIT_EPISODES)]
            shown = [each.demonstration for each in read]
            if self._config.check_clouds and (told := check_clouds(self.transfer.source, shown)):
                print(told)
            self.transfer.fit([each.demonstration for each in read if each.inside] or shown[:1])

    def refine(
        self, begin: Callable[[int], None], done: Callable[[int], None]
    ) -> tuple[Chosen | None, Correction | None]:
        """Search, once fitted, from which start all episodes hold better, and then a correction for all, by some of them; None without `--refine`,
        or where none is better.

        Args:
            begin: called with how many starts and generations there may be.
            done: called with how many more are done.

        Raises:
            CEIError: an episode cannot be read.
        """
        options, verifier = self._config.refine, self._retarget.verifier
        if not options.enabled or verifier is None:
            return None, None
        begin(options.starts + options.generations)
        with one_thread():
            read = [self._read(i, quickly=True) for i in spread(len(self.selected), FIT_EPISODES)]
            demonstrations = [each.demonstration for each in read if each.inside]
            chosen = verifier.choose_start(demonstrations, done)
            if chosen is not None:
                finalists = list(self.transfer.finalists)
                self.transfer.start_from([finalists.pop(chosen.start), *finalists])
            verifier.common = verifier.search_common(demonstrations, done)
        return chosen, verifier.common

    def start_from(self, finalists: "Sequence[Basin]", correction: Correction | None = None) -> None:
        """Take what `fit` and `refine` found elsewhere."""
        if self._retarget.verifier is not None:
            self._retarget.verifier.common = correction
        if finalists:
            self.transfer.start_from(finalists)
        else:  # the manual baseline looks at one episode, and quickly
            self.transfer.fit([self._read(0, quickly=True).demonstration])

    def convert(self, positions: Sequence[int], threads: int) -> Iterator[Converted]:
        """Converted episodes, in order.

        Args:
            positions: which of the selected.
            threads: episodes that are moved at the same time; one where they are verified, as a simulation is for one thread.

        Raises:
            CEIError: an episode cannot be read, or the target cannot reach it.
        """
        with one_thread():
            yield from ordered_map(self._convert, positions, 1 if self._config.replays else threads)

    def _open_stage(self, environment: Environment, T_world_target: Array) -> "Stage":
        return open_stage(self.reader.repo_id, environment, self._config.target, T_world_target)

    def _check_stands_anywhere(self) -> None:
        """Check that simulation lets the target stand elsewhere, which only it knows, by having it stand elsewhere.

        Raises:
            CEIError: it does not.
        """
        elsewhere = self.reader.scene.T_world_base.copy()
        elsewhere[0, 3] += _ELSEWHERE_M
        try:
            self._open_stage(_environment(self.reader, self._config.target, elsewhere), elsewhere).close()
        except CEIError as error:
            raise CEIError(f"--target_pose=auto with --verify: {error}") from error

    def _convert(self, position: int) -> Converted:
        return self._encode(self._judge(self._retarget(self._read(position))))


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


def _environment(reader: Source, target: str, T_world_target: Array | None) -> Environment:
    """The source's environment with the robot exchanged, where it is asked to stand; it still starts at that robot's home."""
    known, source = reader.environment, reader.embodiment.name
    if known.id is None or not known.id.endswith(source):
        return Environment()
    kwargs = {name: value for name, value in known.kwargs.items() if name not in (START, SENSORS)}
    if T_world_target is not None:
        kwargs[BASE] = plain(T_world_target)
    return Environment(known.id.removesuffix(source) + target, kwargs)
