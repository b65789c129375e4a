"""A demonstration of one embodiment in, the same demonstration of another out (the paper's section IV)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cei_gym.alignment import (
    AlignmentProblem,
    AlignmentReport,
    Basin,
    ContactOptions,
    Follower,
    Grip,
    InitialisationOptions,
    ManualAlignment,
    Motion,
    Reach,
    SolverOptions,
    Stream,
    Surroundings,
    Track,
    choose_modes,
    find_basins,
    judge,
    judge_basins,
    link_shapes,
    make_report,
    onto_objects,
    opposing_sides,
    pace,
    pad_shapes,
    source_grip,
    squeeze,
)
from cei_gym.augmentation import Handling
from cei_gym.demonstration import Demonstration
from cei_gym.embodiment import Embodiment
from cei_gym.errors import CEIError, unknown
from cei_gym.functional import VARIANTS, FunctionalRepresentation, directional_chamfer_distance, sample_representation
from cei_gym.kinematics import KinematicTree
from cei_gym.pointcloud import CloudOptions, CloudSynthesiser, crop, frame_points
from cei_gym.pointcloud.attached import attached
from cei_gym.pointcloud.isolated import isolated
from cei_gym.pointcloud.remember import remember

METHODS = ("cei", "bms")
_MOST_POINTS = 100_000
_FIRST_FRAME_ITERATIONS = 200
_FINALISTS = 8
_TOLERATED_M = 0.005  # of penetration, and of contact points that miss the source's
_ABOVE_SUPPORT_M = 0.005
_NEAR_HAND_M = 0.2  # what is farther from the source's pads is no obstacle
_COMPANY_M = 0.02  # within which a point of an object has some others; what has fewer is noise
_COMPANY = 5  # so many; with three, of a cloud of 30 % outliers some 20 points a frame pass
_CARRIED_M = 0.005
_OTHER_SQUEEZES = (0.5, 1.5)
_AT_REST = 0.02  # rad/s or m/s: a finger slower than this has stopped


@dataclass(frozen=True)
class TransferOptions:
    """Options of a transfer.

    Attributes:
        method: "cei", or "bms" (the paper's baseline, binary manual specification: see `ManualAlignment`).
        representation: which points stand for a pad: "standard", or "reduced" or "dropped" (the paper's sensitivity
            analysis).
        points: point-normal pairs of each functional representation.
        seed: of sampling pads.
        stretch: how many times as long an episode may become where the target is too slow to keep up: the source then waits
            for it, frame by frame. 1 keeps the frames as they are.
        unreachable_mm: mean pad distance above which a frame counts as out of the target's reach.
    """

    method: str = "cei"
    representation: str = "standard"
    points: int = 64
    seed: int = 0
    stretch: float = 2.0
    unreachable_mm: float = 30.0

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise unknown("transfer.method", self.method, METHODS)
        if self.representation not in VARIANTS:
            raise unknown("transfer.representation", self.representation, VARIANTS)
        if not 1 <= self.stretch < np.inf:
            raise CEIError(f"transfer.stretch={self.stretch} must be at least 1.")
        if not 1 <= self.points <= _MOST_POINTS:
            raise CEIError(f"transfer.points={self.points} must be at least 1, and at most {_MOST_POINTS}.")
        if self.seed < 0:
            raise CEIError(f"transfer.seed={self.seed} must be at least 0.")
        if not 0 < self.unreachable_mm < np.inf:
            raise CEIError(f"transfer.unreachable_mm={self.unreachable_mm} must be positive.")


@dataclass(frozen=True)
class Attempt:
    """One way of transferring a demonstration, for callers that can tell whether it worked; by default the plain one.

    Attributes:
        basin: which of the finalists of `Transfer.fit` to start from, best first; None for the mode's own.
        squeeze: factor on how far actions squeeze.
        representation: which points stand for a pad; None for those of the options.
    """

    basin: int | None = None
    squeeze: float = 1.0
    representation: str | None = None

    def __str__(self) -> str:
        if self.basin is not None:
            return f"basin {self.basin + 1}"
        if self.representation is not None:
            return f"pads {self.representation}"
        return "plain" if self.squeeze == 1 else f"squeeze x{self.squeeze:g}"


class Transfer:
    """Moves demonstrations from a source to a target embodiment.

    One frame-0 basin (or one a mode) serves all demonstrations, so that a policy sees one way of doing things: call `fit`
    with a few demonstrations, or the first one transferred decides. A demonstration that cannot be followed that way
    takes the best of the others.

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
        T_world_target: np.ndarray | None = None,
    ) -> None:
        self.source, self.target = source, target
        self.options = o = options or TransferOptions()
        self.solver_options, self.init = solver or SolverOptions(), init or InitialisationOptions()
        self.contact = contact or ContactOptions()
        self._T_world_target = T_world_target
        self._source_tree = KinematicTree(source)
        self.source_representation: FunctionalRepresentation = sample_representation(
            source, o.points, o.seed, o.representation
        )
        self.problem = AlignmentProblem(
            sample_representation(target, o.points, o.seed, o.representation), KinematicTree(target)
        )
        self._source_shapes = link_shapes(source)
        self._follower = Follower(self.problem, self.solver_options, self.contact)
        self._reach = Reach(self.problem)
        self._sides = opposing_sides(self.source_representation, self._source_tree)
        self._source_pads = None if self._sides is None else pad_shapes(self.source_representation, self._sides)
        self._root = source.end_effector_root
        self._manual: ManualAlignment | None = None
        self._synthesiser = CloudSynthesiser(source, target, clouds)
        self.clouds = self._synthesiser.options
        self.basins: list[Basin] = []
        """One basin a mode, once fitted."""
        self._finalists: list[Basin] = []
        self._other_pads: dict[str, Transfer] = {}

    def fit(self, demonstrations: Sequence[Demonstration]) -> None:
        """Choose where trajectories start, by following candidates through whole demonstrations.

        Raises:
            CEIError: there are fewer distinct motions than `init.modes`.
        """
        if self.options.method == "bms":
            self._manual = self._specify(demonstrations[0])
            return
        motions = []
        for demonstration in demonstrations:
            if demonstration.point_cloud_world is not None:  # enough here, and quicker
                demonstration = replace(demonstration, depth_m={}, rgb={})
            motions.append(self._motion(demonstration, self._scenes(demonstration)))
        starts = find_basins(
            self.problem, self.solver_options, motions[0].points_base[0], motions[0].normals_base[0], self.init
        )
        # The first demonstration rules most candidates out; the rest decide among the few that are left.
        few = judge_basins(self._follower, motions[:1], starts, refine=False)[: _FINALISTS * self.init.modes]
        self.start_from(judge_basins(self._follower, motions, np.array([b.u for b in few])))

    @property
    def finalists(self) -> list[Basin]:
        """What `fit` judged on all its demonstrations, best first; none with "bms"."""
        return self._finalists

    def start_from(self, finalists: Sequence[Basin]) -> None:
        """Take what another transfer of the same options has fitted.

        Raises:
            CEIError: there are fewer distinct motions than `init.modes`.
        """
        self._finalists = list(finalists)
        self.basins = choose_modes(self._finalists, self.init.modes)

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
        if demonstration.embodiment != self.source.name:
            raise CEIError(
                f"episode {demonstration.index} is of {demonstration.embodiment}, not of {self.source.name}."
            )
        if not self.basins and self._manual is None:
            self.fit([demonstration])
        attempt = attempt or Attempt()
        if attempt.representation is not None:
            other = self._with_pads(attempt.representation)
            return other(demonstration, mode, attempt=replace(attempt, representation=None), clouds=clouds)
        scenes = self._scenes(demonstration)
        motion = self._motion(demonstration, scenes=scenes)
        if self._manual is not None:
            track = closing = self._specified(self._manual, demonstration, motion)
            report = self._report(motion, track)
        else:
            if attempt.basin is None:
                frames, motion, track, report = self._follow(motion, mode)
            else:
                followed = self._follow_from(self._finalists[attempt.basin], motion)
                frames, motion, track = followed.frames, followed.motion, followed.track
                report = self._report(motion, track)
            demonstration, scenes = demonstration.at(frames), [scenes[t] for t in frames] if scenes else scenes
            depth_m = attempt.squeeze * self._squeeze_m(demonstration, motion)
            closing = replace(track, u=squeeze(self.problem, track.u, depth_m))
        # a_t = q_(t+1); the last frame holds.
        qpos, action = (self._joints(u) for u in (track.u, np.concatenate([closing.u[1:], closing.u[-1:]])))
        base = self._base(demonstration)
        return (
            replace(
                demonstration,
                **demonstration.of_the_world()
                | {
                    "qpos": qpos,
                    "action": action,
                    "point_cloud_world": self._clouds(demonstration, scenes, qpos) if clouds else None,
                },
                embodiment=self.target.name,
                scene=replace(demonstration.scene, T_world_base=base),
                displacement=None,
            ),
            report,
        )

    def attempts(self, most: int, mode: int = 0) -> list[Attempt]:
        """What to try in turn, once fitted, for a demonstration that goes wrong in physics.

        In order: plain; from the other finalists, best first; squeezing less and more; with other points on the pads.
        Where that is more than `most`, it is finalists that are left out, so that each kind has its turn.
        """
        if self._manual is not None:
            return [Attempt()]
        own = self.basins[mode % len(self.basins)]
        basins = [Attempt(basin=i) for i, basin in enumerate(self._finalists) if basin is not own]
        pads = "standard" if self.options.representation == "reduced" else "reduced"
        rest = [*(Attempt(squeeze=factor) for factor in _OTHER_SQUEEZES), Attempt(representation=pads)]
        return [Attempt(), *basins[: max(1, most - 1 - len(rest))], *rest][:most]

    def stream(self, dt_s: float | None = None, T_target_source: np.ndarray | None = None) -> "LiveTransfer":
        """Retarget live, one configuration of the source at a time, from where `fit` starts.

        Args:
            dt_s: time between configurations; with it, joints keep their velocity limits.
            T_target_source: (4, 4) pose of the source's base in the target's base frame; identity if None.
        """
        u0 = self.basins[0].u if self.basins else None
        stream = Stream(self.problem, self.solver_options, self.init, u0, dt_s)
        return LiveTransfer(self, stream, np.eye(4) if T_target_source is None else T_target_source)

    def place_source(self, qpos: np.ndarray, T_target_source: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The source's points and normals (..., N, 3) in the target's base frame, at (..., n) joint positions.

        T_target_source is (4, 4), or (..., 4, 4): one for each.
        """
        return self.source_representation.place(T_target_source[..., None, :, :] @ self._source_tree.forward(qpos))

    def handling(self, demonstration: Demonstration) -> Handling:
        """What the source does to objects, as recorded: for spatial augmentation."""
        motion = self._motion(demonstration)
        T_world_target = self._base(demonstration)
        held = np.zeros(len(demonstration), bool) if motion.grip is None else motion.grip.held
        middle = motion.points_base.mean(axis=1) @ T_world_target[:3, :3].T + T_world_target[:3, 3]
        return Handling(held, middle, T_world_target @ self._source_links(demonstration)[:, self._root])

    def _joints(self, u: np.ndarray) -> np.ndarray:
        """(T, n) joint positions as datasets store and environments observe them, so that clouds show the target just where they say."""
        return self.target.coupled.expand(u).astype(np.float32).astype(float)

    def _with_pads(self, representation: str) -> "Transfer":
        """This transfer with other points on the pads; it starts where this one does."""
        if representation not in self._other_pads:
            options = replace(self.options, representation=representation)
            given = self.solver_options, self.init, self.contact, self.clouds, self._T_world_target
            other = Transfer(self.source, self.target, options, *given)
            other.basins, other._finalists = self.basins, self._finalists
            self._other_pads[representation] = other
        return self._other_pads[representation]

    def _follow(self, motion: Motion, mode: int) -> tuple[np.ndarray, Motion, Track, AlignmentReport]:
        """Follow a motion from its mode's basin, or from the best of the others where that goes wrong."""
        best = self._follow_from(self.basins[mode % len(self.basins)], motion)
        report = self._report(best.motion, best.track)
        if report.unreachable_frames or best.wrong:
            best = min(
                [best, *(self._follow_from(other, motion) for other in self._finalists)], key=lambda x: x.basin.cost
            )
            report = self._report(best.motion, best.track)
        return best.frames, best.motion, best.track, report

    def _follow_from(self, basin: Basin, motion: Motion) -> "_Followed":
        points, normals = motion.points_base[:1], motion.normals_base[:1]
        u0 = self._follower.solver.track(points, normals, basin.u, _FIRST_FRAME_ITERATIONS).u[0]
        motion = replace(motion, u0=u0)
        frames, free = pace(self.problem, self._follower.solver, self.solver_options, motion, self.options.stretch)
        motion = motion.at(frames)
        track = self._follower.follow(motion, free)
        return _Followed(frames, motion, track, judge(self._follower, [motion], basin.u, [track]))

    def _report(self, motion: Motion, track: Track) -> AlignmentReport:
        report = make_report(
            self.problem,
            motion.points_base,
            motion.normals_base,
            track,
            self.solver_options.lambda_m,
            self.options.unreachable_mm,
            motion.dt_s,
            self._follower.penetration(motion, track.u),
        )
        if not report.unreachable_frames:
            return report
        return replace(report, miss=self._reach.explain(motion, track, int(report.pad_distance_mm.argmax())))

    def _specify(self, demonstration: Demonstration) -> ManualAlignment:
        """BMS with the thumb on the side from which the arm follows more closely: a person would try both."""
        motion = self._motion(demonstration)
        both = [ManualAlignment(self.source, self.target, half_turn) for half_turn in (False, True)]
        return min(both, key=lambda manual: self._specified(manual, demonstration, motion).objective.mean())

    def _specified(self, manual: ManualAlignment, demonstration: Demonstration, motion: Motion) -> Track:
        u = manual.track(demonstration.qpos, self._T_target_source(demonstration))
        objective = [
            directional_chamfer_distance(p, n, *self.problem.place(q), self.solver_options.lambda_m)
            for p, n, q in zip(motion.points_base, motion.normals_base, u, strict=True)
        ]
        return Track(u, np.array(objective), np.zeros(len(u), int))

    def _base(self, demonstration: Demonstration) -> np.ndarray:
        return demonstration.scene.T_world_base if self._T_world_target is None else self._T_world_target

    def _support_z_base_m(self, demonstration: Demonstration) -> float:
        """Height of the support surface: the scene's, or lower where the source itself went lower."""
        scene = demonstration.scene
        lowest_world = self._source_shapes.lowest(scene.T_world_base @ self._source_tree.forward(demonstration.qpos))
        # Bases stand upright, so a height in the world and one in the base frame differ by the base's own.
        return min(scene.support_z_m, lowest_world) - float(self._base(demonstration)[2, 3])

    def _motion(self, demonstration: Demonstration, scenes: Sequence[np.ndarray] = ()) -> Motion:
        """What the source's pads do, in the target's base frame; it starts from the target's home."""
        points, normals = self.place_source(demonstration.qpos, self._T_target_source(demonstration))
        home = self.target.coupled.reduce(self.target.home)
        motion = Motion(points, normals, home, dt_s=1.0 / demonstration.fps)
        grip = self._grip(demonstration, motion)
        obstacles = self._obstacles(demonstration, scenes, points.mean(axis=1), grip) if len(scenes) else ()
        if grip is not None and self._source_pads is not None and len(obstacles):
            pads = np.concatenate(self._source_pads.place(self._source_links(demonstration)), axis=1)
            grip = onto_objects(grip, pads, obstacles, self.contact.grip_radius_m)
        surroundings = Surroundings(self._support_z_base_m(demonstration), obstacles)
        return replace(motion, grip=grip, surroundings=surroundings)

    def _closing_m(self, demonstration: Demonstration, motion: Motion) -> np.ndarray:
        """(T,) how far each pad is told to go beyond where it is, in the mean, m."""
        commanded = demonstration.qpos.copy()
        hand = slice(self.source.n_arm, None)
        commanded[:, hand] = demonstration.action[:, hand]
        wanted, _ = self.place_source(commanded, self._T_target_source(demonstration))
        return np.einsum("tni,tni->tn", wanted - motion.points_base, motion.normals_base).mean(axis=1)

    def _squeeze_m(self, demonstration: Demonstration, motion: Motion) -> np.ndarray:
        return np.clip(self._closing_m(demonstration, motion), 0.0, self.contact.squeeze_m)

    def _grip(self, demonstration: Demonstration, motion: Motion) -> Grip | None:
        if self._sides is None:
            return None
        # Told to close, but at rest: something is in between.
        hand = demonstration.qpos[:, self.source.n_arm :]
        moves = (np.abs(np.diff(hand, axis=0)) * demonstration.fps > _AT_REST).any(axis=1)
        at_rest = ~np.append(False, moves) & ~np.append(moves, False)  # neither on its way nor about to set out
        held = (self._closing_m(demonstration, motion) > self.contact.held_m) & at_rest
        T_links = self._source_links(demonstration)
        return source_grip(self.source_representation, self._sides, self._root, T_links, held)

    def _source_links(self, demonstration: Demonstration) -> np.ndarray:
        """(T, L, 4, 4) the source's links in the target's base frame."""
        T_target_source = self._T_target_source(demonstration)
        return T_target_source[..., None, :, :] @ self._source_tree.forward(demonstration.qpos)

    def _T_target_source(self, demonstration: Demonstration) -> np.ndarray:
        """(4, 4), or (T, 4, 4) where the source is displaced."""
        T_world_source, moved = demonstration.scene.T_world_base, demonstration.displacement
        if moved is not None:
            T_world_source = moved.T_world_source @ T_world_source
        return np.linalg.inv(self._base(demonstration)) @ T_world_source

    def _obstacles(
        self, demonstration: Demonstration, scenes: Sequence[np.ndarray], hand_base: np.ndarray, grip: Grip | None
    ) -> list[np.ndarray]:
        """For each frame points on what stands on the support surface near the hand, target's base frame."""
        T_base_world = np.linalg.inv(self._base(demonstration))
        floor = demonstration.scene.support_z_m + _ABOVE_SUPPORT_M
        above = [s[s[:, 2] > floor, :3] for s in scenes]
        above = [s[~isolated(s, _COMPANY_M, _COMPANY)] for s in above]
        objects = [s @ T_base_world[:3, :3].T + T_base_world[:3, 3] for s in above]
        held = np.zeros(len(scenes), bool) if grip is None else grip.held
        T_hand = self._source_links(demonstration)[:, self._root]
        tool = attached(objects, T_hand, hand_base, ~held, _NEAR_HAND_M)
        objects = [points[~its] for points, its in zip(objects, tool, strict=True)]
        moved = np.zeros(len(scenes), bool) if grip is None else grip.carried_m > _CARRIED_M
        return remember(objects, hand_base, moved, _NEAR_HAND_M)

    def _scenes(self, demonstration: Demonstration) -> list[np.ndarray]:
        """For each frame the recorded points (M, 3 or 6) without the source robot, world, objects displaced if they are to be;
        empty where nothing was recorded."""
        d, scenes = demonstration, []
        for t, qpos in enumerate(d.qpos):
            points = self._recorded(d, t)
            if points is None:
                return []
            points = self._synthesiser.remove(points, d.scene, qpos)
            if d.displacement is not None:
                points = d.displacement.move(points, t)
                points = points[crop(points, d.scene.workspace_world)]
            scenes.append(points)
        return scenes

    def _recorded(self, d: Demonstration, t: int) -> np.ndarray | None:
        """(N, 3 or 6) a frame's recorded points, world; None where nothing was recorded."""
        depth_m, rgb = ({name: images[t] for name, images in each.items()} for each in (d.depth_m, d.rgb))
        cloud = None if d.point_cloud_world is None else d.point_cloud_world[t]
        return frame_points(d.scene, depth_m, rgb, cloud, self.clouds.colours)

    def _clouds(
        self, demonstration: Demonstration, scenes: Sequence[np.ndarray], qpos: np.ndarray
    ) -> np.ndarray | None:
        if not scenes:
            return None
        if not self.clouds.swap:
            if demonstration.displacement is not None:
                raise CEIError(
                    "clouds.swap=false keeps the source in the clouds, which cannot be displaced with objects."
                )
            recorded = (self._recorded(demonstration, t) for t in range(len(demonstration)))
            return np.stack([self._synthesiser.keep(p, demonstration.scene) for p in recorded if p is not None])
        scene = replace(demonstration.scene, T_world_base=self._base(demonstration))
        return np.stack([self._synthesiser.add(s, scene, q) for s, q in zip(scenes, qpos, strict=True)])


@dataclass(frozen=True)
class _Followed:
    """A motion at the target's pace (which of its frames), followed from a basin, and how that went."""

    frames: np.ndarray
    motion: Motion
    track: Track
    basin: Basin

    @property
    def wrong(self) -> bool:
        b = self.basin
        return max(b.penetration_m, b.overlap_m, b.contact_miss_m) > _TOLERATED_M or b.torque_share > 1


class LiveTransfer:
    """One configuration of the source in, one of the target out; see `Transfer.stream`."""

    def __init__(self, transfer: Transfer, stream: Stream, T_target_source: np.ndarray) -> None:
        self._transfer, self._stream, self._T_target_source = transfer, stream, T_target_source

    def __call__(self, qpos: np.ndarray) -> np.ndarray:
        """(n,) joint positions of the source to (n',) of the target, rad or m."""
        points, normals = self._transfer.place_source(qpos, self._T_target_source)
        return self._transfer.target.coupled.expand(self._stream(points, normals))

    def reset(self) -> None:
        """Start anew: the next configuration is a first frame."""
        self._stream.reset()
