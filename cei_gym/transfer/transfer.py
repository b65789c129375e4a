"""Moves demonstrations from a source to a target embodiment (the paper's section IV)."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cei_gym.alignment.contact.live import LiveGrasp
from cei_gym.alignment.contact.refine import GraspRefiner
from cei_gym.alignment.contact.squeeze import squeeze
from cei_gym.alignment.judge.report import AlignmentReport
from cei_gym.alignment.manual import ManualAlignment
from cei_gym.alignment.options import ContactOptions, SolverOptions
from cei_gym.alignment.problem import AlignmentProblem, Motion
from cei_gym.alignment.start.basins import Basin
from cei_gym.alignment.start.starts import InitialisationOptions
from cei_gym.alignment.stream import Stream
from cei_gym.arrays import Array
from cei_gym.augmentation import Handling
from cei_gym.demonstration import Demonstration
from cei_gym.embodiment import Embodiment
from cei_gym.errors import CEIError
from cei_gym.functional import FunctionalRepresentation, sample_representation
from cei_gym.kinematics import KinematicTree
from cei_gym.pointcloud import CloudOptions, CloudSynthesiser
from cei_gym.pointcloud.near import any_near
from cei_gym.transfer.aligned import Aligned
from cei_gym.transfer.attempt import Attempt, attempts
from cei_gym.transfer.following import Followed, Following
from cei_gym.transfer.live import LiveSource, LiveTransfer
from cei_gym.transfer.options import TransferOptions
from cei_gym.transfer.scenes import Scenes
from cei_gym.transfer.source_side import SourceSide
from cei_gym.transfer.specified import Specified

_TOUCHED_M = 0.015  # pads are sampled, and depth is some millimetres wrong


class Transfer:
    """Moves demonstrations from a source to a target embodiment.

    One frame-0 basin (or one a mode) serves all demonstrations, so that a policy sees one way of doing things: call `fit`
    with a few demonstrations, or the first one transferred decides. A demonstration that cannot be followed that way
    takes the best of those whose hands do the same, and another way only where none of them reaches it.

    Args:
        source: embodiment of the demonstrations.
        target: embodiment wanted.
        options, solver, init, contact, clouds: see each class.
        T_world_target: (4, 4) pose of the target's base; the source's own if None.
    """

    def __init__(
        self,
        source: Embodiment,
        target: Embodiment,
        options: TransferOptions | None = None,
        solver: SolverOptions | None = None,
        init: InitialisationOptions | None = None,
        contact: ContactOptions | None = None,
        clouds: CloudOptions | None = None,
        T_world_target: Array | None = None,
    ) -> None:
        self.source, self.target = source, target
        self.options = o = options or TransferOptions()
        self.solver_options, self.init = solver or SolverOptions(), init or InitialisationOptions()
        self.contact = contact or ContactOptions()
        self._T_world_target = T_world_target
        representation = sample_representation(source, o.points, o.seed, o.representation)
        self.source_representation: FunctionalRepresentation = representation
        self.problem = AlignmentProblem(
            sample_representation(target, o.points, o.seed, o.representation), KinematicTree(target)
        )
        self._side = SourceSide(representation, self.contact, T_world_target)
        self.synthesiser = CloudSynthesiser(source, target, clouds)
        self._scenes = Scenes(self.synthesiser)
        self.clouds = self._scenes.options
        self._following = Following(
            self.problem, self.solver_options, self.init, self.contact, o.stretch, o.unreachable_mm
        )
        self._holding: Motion | None = None
        self._specified: Specified | None = None
        if o.method == "bms":
            first, second = (ManualAlignment(source, target, half_turn) for half_turn in (False, True))
            self._specified = Specified(self.problem, (first, second), self.solver_options.lambda_m)
        self._other_pads: dict[str, Transfer] = {}

    def stand(self, T_world_target: Array | None) -> None:
        """Stand the target elsewhere, before it is fitted; see `T_world_target` above."""
        self._T_world_target = T_world_target
        self._side = SourceSide(self.source_representation, self.contact, T_world_target)

    @property
    def basins(self) -> list[Basin]:
        """One basin a mode, once fitted; none with "bms"."""
        return self._following.basins

    @property
    def finalists(self) -> list[Basin]:
        """What `fit` judged on all its demonstrations, best first; none with "bms"."""
        return self._following.finalists

    def fit(self, demonstrations: Sequence[Demonstration]) -> None:
        """Choose where trajectories start, by following candidates through whole demonstrations.

        Raises:
            CEIError: there are fewer distinct motions than `init.modes`.
        """
        if self._specified is not None:
            first = demonstrations[0]
            self._specified.fit(first.qpos, self._side.T_target_source(first), self.motion(first))
            return
        motions: list[Motion] = []
        for demonstration in demonstrations:
            if demonstration.point_cloud_world is not None:  # enough here, and quicker
                demonstration = replace(demonstration, depth_m={}, rgb={})
            motions.append(self.motion(demonstration, self._scenes.without_source(demonstration)))
        self._following.fit(motions)
        self._holding = next((m for m in motions if m.grip is not None and m.grip.held.any()), None)

    def start_from(self, finalists: Sequence[Basin]) -> None:
        """Take what another transfer of the same options has fitted.

        Raises:
            CEIError: there are fewer distinct motions than `init.modes`.
        """
        self._following.start_from(finalists)

    def __call__(
        self, demonstration: Demonstration, mode: int = 0, *, attempt: Attempt | None = None, clouds: bool = True
    ) -> tuple[Demonstration, AlignmentReport]:
        """Transfer one demonstration.

        Args:
            demonstration: of the source.
            mode: which of the `init.modes` motions.
            attempt: one of `attempts`; None for the plain one.
            clouds: synthesise clouds too.

        Returns:
            The target's demonstration (state `q_t`, action `q_(t+1)`, synthesised cloud), and how well it follows.

        Raises:
            CEIError: the demonstration is of another embodiment.
        """
        attempt = attempt or Attempt()
        return self.made(self.aligned(demonstration, mode, attempt), attempt, clouds)

    def aligned(self, demonstration: Demonstration, mode: int = 0, attempt: Attempt | None = None) -> Aligned:
        """The first half of transferring a demonstration, which takes longest: how the target follows it. Attempts that differ in force or in a
        correction alone share it.

        Raises:
            CEIError: as calls do.
        """
        if demonstration.embodiment != self.source.name:
            raise CEIError(
                f"episode {demonstration.index} is of {demonstration.embodiment}, not of {self.source.name}."
            )
        if not self.basins and not (self._specified is not None and self._specified.fitted):
            self.fit([demonstration])
        attempt = attempt or Attempt()
        if attempt.representation is not None:
            return self._with_pads(attempt.representation).aligned(
                demonstration, mode, replace(attempt, representation=None)
            )
        scenes = self._scenes.without_source(demonstration)
        followed, report = self._follow(demonstration, self.motion(demonstration, scenes), mode, attempt)
        return Aligned(demonstration, scenes, followed, report)

    def made(
        self, aligned: Aligned, attempt: Attempt | None = None, clouds: bool = True
    ) -> tuple[Demonstration, AlignmentReport]:
        """The second half: what the target does and sees.

        Args:
            aligned: the first half, of this attempt or of one that differs in force or correction alone.
            attempt, clouds: as for calls.
        """
        attempt = attempt or Attempt()
        followed, report = aligned.followed, aligned.report
        if attempt.correction is not None:
            followed, report = self._following.corrected(followed, report, attempt.correction)
        frames, track = followed.frames, followed.track
        demonstration, scenes = aligned.demonstration.at(frames), aligned.scenes
        scenes = [scenes[int(t)] for t in frames] if scenes else scenes
        closing = track.u
        if self._specified is None:
            depth_m = attempt.force * self._side.squeeze_m(demonstration)
            closing = squeeze(self.problem, track.u, depth_m, attempt.asymmetry)
        # a_t = q_(t+1); the last frame holds.
        qpos, action = (self._joints(u) for u in (track.u, np.concatenate([closing[1:], closing[-1:]])))
        base = self._side.T_world_target(demonstration)
        cloud = self._scenes.clouds(demonstration, scenes, qpos, base) if clouds else None
        moved = replace(
            demonstration,
            **demonstration.of_the_world() | {"qpos": qpos, "action": action, "point_cloud_world": cloud},
            embodiment=self.target.name,
            scene=replace(demonstration.scene, T_world_base=base),
            displacement=None,
        )
        return moved, report

    def attempts(self, most: int, mode: int = 0) -> list[Attempt]:
        """What to try in turn, once fitted, for a demonstration that goes wrong in physics; see `attempts`."""
        if self._specified is not None:
            return [Attempt()]
        return attempts(self._following.others(mode), self.options.representation, most)

    def stream(self, dt_s: float | None = None, T_target_source: Array | None = None) -> LiveTransfer:
        """Retarget live, one configuration of the source at a time, from where `fit` starts. Contact is carried over if something was held in what
        `fit` looked at; else pads are followed, no more.

        Args:
            dt_s: time between configurations; with it, joints keep their velocity limits, and what is held is known.
            T_target_source: (4, 4) pose of the source's base in the target's base frame; identity if None.
        """
        return LiveTransfer(self.target, *self.live(dt_s, T_target_source))

    def live(self, dt_s: float | None = None, T_target_source: Array | None = None) -> tuple[LiveSource, Stream]:
        """What `stream` is made of: the source's pads, frame by frame, and what follows them."""
        u0 = self.basins[0].u if self.basins else None
        T = np.eye(4) if T_target_source is None else T_target_source
        stream = Stream(self.problem, self.solver_options, self.init, u0, dt_s, self._live_grasp(dt_s))
        return LiveSource(self._side, T, self.contact.held_m, dt_s), stream

    def _live_grasp(self, dt_s: float | None) -> LiveGrasp | None:
        """Carries contact over; None where nothing that was fitted shows how something is held, or the target has nothing that closes."""
        refiner = GraspRefiner(self.problem, self.solver_options, self.contact)
        if self._holding is None or not refiner.carries_over:
            return None
        followed, _ = self._following.follow(self._holding, 0)
        return LiveGrasp(refiner, (followed.motion, followed.track), dt_s)

    def place_source(self, qpos: Array, T_target_source: Array) -> tuple[Array, Array]:
        """The source's points and normals (..., N, 3) in the target's base frame, at (..., n) joint positions.

        T_target_source is (4, 4), or (..., 4, 4): one for each.
        """
        return self._side.place(qpos, T_target_source)

    def handling(self, demonstration: Demonstration) -> Handling:
        """What the source does to objects, as recorded: for spatial augmentation."""
        motion = self.motion(demonstration)
        T_world_target = self._side.T_world_target(demonstration)
        held = np.zeros(len(demonstration), bool) if motion.grip is None else motion.grip.held
        middle = motion.points_base.mean(axis=1) @ T_world_target[:3, :3].T + T_world_target[:3, 3]
        touched = np.zeros(len(held), bool)
        if not held.any():  # where something is, that begins it
            around = self.motion(demonstration, self._scenes.without_source(demonstration)).surroundings
            if around is not None and len(around.obstacles_base):
                pairs = zip(motion.points_base, around.obstacles_base, strict=True)
                touched = np.array([any_near(pads, objects, _TOUCHED_M) for pads, objects in pairs])
        return Handling(held, middle, T_world_target @ self._side.hand(demonstration), touched)

    def motion(self, demonstration: Demonstration, scenes: Sequence[Array] = ()) -> Motion:
        """What the source's pads do, in the target's base frame; it starts from the target's home.

        Args:
            demonstration: of the source.
            scenes: for each frame (M, 3 or 6) points that were seen beside the source, world, m: what is near becomes obstacles.
        """
        motion = self._side.motion(demonstration, self.target.coupled.reduce(self.target.home))
        if not len(scenes):
            return motion
        base, hand = self._side.T_world_target(demonstration), self._side.hand(demonstration)
        return self._side.among(
            demonstration, motion, *self._scenes.obstacles(demonstration, scenes, motion, base, hand)
        )

    def _follow(
        self, demonstration: Demonstration, motion: Motion, mode: int, attempt: Attempt
    ) -> tuple[Followed, AlignmentReport]:
        if self._specified is not None:
            track = self._specified.follow(demonstration.qpos, self._side.T_target_source(demonstration), motion)
            return Followed(np.arange(len(track.u)), motion, track), self._following.report(motion, track)
        if attempt.basin is not None:
            return self._following.follow_from(attempt.basin, motion)
        return self._following.follow(motion, mode)

    def _joints(self, u: Array) -> Array:
        """(T, n) joint positions as datasets store and environments observe them, so that clouds show the target just where they say."""
        return self.target.coupled.expand(u).astype(np.float32).astype(float)

    def _with_pads(self, representation: str) -> "Transfer":
        """This transfer with other points on the pads; it starts where this one does."""
        if representation not in self._other_pads:
            options = replace(self.options, representation=representation)
            given = self.solver_options, self.init, self.contact, self.clouds, self._T_world_target
            other = Transfer(self.source, self.target, options, *given)
            other.start_from(self.finalists)
            self._other_pads[representation] = other
        return self._other_pads[representation]
