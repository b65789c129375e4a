"""A demonstration of one embodiment in, the same demonstration of another out (the paper's section IV)."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from cei_gym.alignment import (
    AlignmentProblem,
    AlignmentReport,
    Basin,
    InitialisationOptions,
    SolverOptions,
    find_basins,
    judge_basins,
    make_solver,
)
from cei_gym.alignment.report import make_report
from cei_gym.demonstration import Demonstration
from cei_gym.embodiment import Embodiment
from cei_gym.errors import CEIError
from cei_gym.functional import FunctionalRepresentation, sample_representation
from cei_gym.kinematics import KinematicTree
from cei_gym.pointcloud import fuse_depth
from cei_gym.pointcloud.synthesise import CloudSynthesiser

_FIRST_FRAME_ITERATIONS = 200
_FINALISTS = 8


@dataclass(frozen=True)
class TransferOptions:
    """Options of a transfer.

    Attributes:
        points: point-normal pairs of each functional representation.
        seed: of every random choice.
        squeeze_m: how far actions close each pad beyond the contact that was observed, at most, while the source's
            gripper is told to close further than it can; it carries grip force over. 0 is the paper.
        unreachable_mm: mean pad distance above which a frame counts as out of the target's reach.
        tau_m: threshold of the robot mask.
        robot_points: points sampled over the target's whole surface.
        cloud_points: points of a synthesised cloud.
        solver: the alignment's options.
        init: the multi-start's options.
    """

    points: int = 64
    seed: int = 0
    squeeze_m: float = 0.010
    unreachable_mm: float = 30.0
    tau_m: float = 0.005
    robot_points: int = 16384
    cloud_points: int = 1024
    solver: SolverOptions = field(default_factory=SolverOptions)
    init: InitialisationOptions = field(default_factory=InitialisationOptions)


class Transfer:
    """Moves demonstrations from a source to a target embodiment.

    One frame-0 basin serves all demonstrations, so that a policy sees one way of doing things: call `fit` with a few
    demonstrations, or the first one transferred decides.

    Args:
        source: embodiment of the demonstrations.
        target: embodiment wanted.
        options: see `TransferOptions`.
        T_world_target: (4, 4) pose of the target's base; the source's own if None.
    """

    def __init__(
        self,
        source: Embodiment,
        target: Embodiment,
        options: TransferOptions | None = None,
        T_world_target: np.ndarray | None = None,
    ) -> None:
        self.source, self.target = source, target
        self.options = o = options or TransferOptions()
        self._T_world_target = T_world_target
        self._source_tree = KinematicTree(source)
        self.source_representation: FunctionalRepresentation = sample_representation(source, o.points, o.seed)
        self.problem = AlignmentProblem(sample_representation(target, o.points, o.seed), KinematicTree(target))
        self._solver = make_solver(self.problem, o.solver)
        self._synthesise = CloudSynthesiser(source, target, o.tau_m, o.robot_points, o.cloud_points, o.seed)
        self.basins: list[Basin] = []

    def fit(self, demonstrations: Sequence[Demonstration]) -> None:
        """Choose where trajectories start, by following candidates through whole demonstrations."""
        trajectories = [self._squeezed(d) for d in demonstrations]
        points, normals = trajectories[0]
        candidates = find_basins(self.problem, self.options.solver, points[0], normals[0], self.options.init)
        scene = demonstrations[0].scene
        # Bases stand upright, so a height in the world and one in the base frame differ by the base's own.
        support_z = scene.workspace_world[0, 2] - self._base(demonstrations[0])[2, 3]
        # The first demonstration rules most candidates out; the rest decide among the few that are left.
        few = judge_basins(self.problem, self.options.solver, trajectories[:1], candidates, support_z)[:_FINALISTS]
        starts = np.array([basin.u for basin in few])
        self.basins = judge_basins(self.problem, self.options.solver, trajectories, starts, support_z)

    def __call__(self, demonstration: Demonstration) -> tuple[Demonstration, AlignmentReport]:
        """Transfer one demonstration.

        Returns:
            The target's demonstration (state `q_t`, action `q_(t+1)`, synthesised cloud), and how well it follows.

        Raises:
            CEIError: the demonstration is of another embodiment.
        """
        if demonstration.embodiment != self.source.name:
            raise CEIError(
                f"episode {demonstration.index} is of {demonstration.embodiment}, not of {self.source.name}."
            )
        if not self.basins:
            self.fit([demonstration])
        points, normals = self._representation(demonstration)
        u0 = self._solver.track(points[:1], normals[:1], self.basins[0].u, _FIRST_FRAME_ITERATIONS).u[0]
        track = self._solver.track(points, normals, u0)
        o = self.options
        report = make_report(self.problem, points, normals, track, o.solver.lambda_m, o.unreachable_mm)
        qpos = self.target.coupled.expand(track.u)
        squeezed, _ = self._squeezed(demonstration)
        closing = track.u
        if np.any(squeezed != points):
            closing = self._solver.track(squeezed, normals, u0).u
        # a_t = q_(t+1); the last frame holds.
        action = self.target.coupled.expand(np.concatenate([closing[1:], closing[-1:]]))
        return (
            replace(
                demonstration,
                embodiment=self.target.name,
                qpos=qpos,
                action=action,
                scene=replace(demonstration.scene, T_world_base=self._base(demonstration)),
                depth_m={},
                point_cloud_world=self._clouds(demonstration, qpos),
            ),
            report,
        )

    def _base(self, demonstration: Demonstration) -> np.ndarray:
        return demonstration.scene.T_world_base if self._T_world_target is None else self._T_world_target

    def _representation(self, demonstration: Demonstration, qpos: np.ndarray | None = None):
        """The source's points and normals (T, N, 3) in the target's base frame."""
        T_target_source = np.linalg.inv(self._base(demonstration)) @ demonstration.scene.T_world_base
        links = self._source_tree.forward(demonstration.qpos if qpos is None else qpos)
        return self.source_representation.place(T_target_source @ links)

    def _squeezed(self, demonstration: Demonstration):
        """The same, with each pad moved along its normal by what its command asks beyond where it is, up to squeeze_m."""
        points, normals = self._representation(demonstration)
        commanded = demonstration.qpos.copy()
        hand = slice(self.source.n_arm, None)
        commanded[:, hand] = demonstration.action[:, hand]
        wanted, _ = self._representation(demonstration, commanded)
        gap = np.einsum("tni,tni->tn", wanted - points, normals).mean(axis=1)
        squeeze = np.clip(gap, 0.0, self.options.squeeze_m)
        return points + squeeze[:, None, None] * normals, normals

    def _clouds(self, demonstration: Demonstration, qpos: np.ndarray) -> np.ndarray | None:
        recorded = demonstration.point_cloud_world
        if not demonstration.depth_m and recorded is None:
            return None
        scene, base = demonstration.scene, self._base(demonstration)
        clouds = []
        for t in range(len(demonstration)):
            depth = {name: images[t] for name, images in demonstration.depth_m.items()}
            points = fuse_depth(scene, depth) if recorded is None or depth else recorded[t]
            clouds.append(
                self._synthesise(
                    points, scene.workspace_world, demonstration.qpos[t], scene.T_world_base, qpos[t], base
                )
            )
        return np.stack(clouds)
