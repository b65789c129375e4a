"""A twin of each recording: built, tried by the source's own motion, then by the target's."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull

from cei_gym.alignment.grip import Grip
from cei_gym.alignment.links import link_shapes
from cei_gym.arrays import Array
from cei_gym.demonstration import Demonstration
from cei_gym.embodiment import Embodiment
from cei_gym.kinematics import KinematicTree
from cei_gym.twin.complete import complete
from cei_gym.twin.evidence import Evidence
from cei_gym.twin.fit import fit_primitive
from cei_gym.twin.hold import Hold
from cei_gym.twin.hulls import one_hull, slices
from cei_gym.twin.options import TwinOptions
from cei_gym.twin.play import Played, Player
from cei_gym.twin.robot import RobotPart
from cei_gym.twin.scene import build_scene
from cei_gym.twin.seen import Seen, see
from cei_gym.twin.shape import Shape

_APPROACH_M = 0.07  # a motion begins where the hand is so far from where it takes hold
_TOLERATED_M, _TOLERATED_SHARE = 0.025, 0.35  # from where the hand's motion would have brought it
_LIFTED_M = 0.01
_FINGERS = 15  # frames before the hold, at which fingers are looked at
_TOUCHING_M = 0.004  # a finger may be so deep in what it holds, as joints are read
_ENOUGH = 4  # tries, if they agree
_FRICTIONS = (1.0, 0.8, 1.2)


@dataclass(frozen=True)
class Reconstruction:
    """What a recording's scene is taken for.

    Attributes:
        hold: of the source.
        seen: of what is held.
        shapes: what it may be, the likeliest first.
    """

    hold: Hold
    seen: Seen
    shapes: tuple[Shape, ...]


class Twin:
    """Judges transferred demonstrations in scenes built from their recordings.

    Args:
        source, target: who moves.
        options: see there.
    """

    def __init__(self, source: Embodiment, target: Embodiment, options: TwinOptions | None = None) -> None:
        self._source, self._target = RobotPart.of(source), RobotPart.of(target)
        self._tree, self._links = KinematicTree(source), link_shapes(source)
        self._options = options or TwinOptions()

    def reconstruct(
        self, demonstration: Demonstration, scenes: Sequence[Array], grip: Grip | None, T_world_grip: Array
    ) -> "Reconstruction | Evidence":
        """The scene of a recording, or why there is none.

        Args:
            demonstration: of the source.
            scenes: for each frame (M, 3 or 6) points beside the source, world, m; none without clouds.
            grip: of the source, frame by frame, in the frame of a base at a (4, 4) pose, T_world_grip.
        """
        if not len(scenes):
            return Evidence.none("there are no clouds")
        hold = Hold.of(grip, 1 / demonstration.fps, T_world_grip)
        if hold is None:
            return Evidence.none("the source carries nothing")
        seen = see(demonstration, scenes, hold)
        if seen is None:
            return Evidence.none("nothing was seen where the source takes hold")
        hold = hold.where_seen(seen.points_world)
        completed = complete(seen, hold, self._fingers(demonstration, hold))
        sliced = slices(completed, hold)
        found = (fit_primitive(seen, completed, hold), sliced, one_hull(completed, hold, sliced))
        shapes = tuple(shape for shape in found if shape is not None)
        return Reconstruction(hold, seen, shapes) if shapes else Evidence.none("what is held is too flat to be seen")

    def judge(
        self,
        demonstration: Demonstration,
        scenes: Sequence[Array],
        grip: Grip | None,
        moved: Demonstration,
        frames: Array,
    ) -> Evidence:
        """Whether a transferred demonstration holds what the source held.

        Args:
            demonstration: of the source.
            scenes: see `reconstruct`.
            grip: of the source, frame by frame of its demonstration, in the target's base frame.
            moved: the target's demonstration.
            frames: (T',) which of the source's frames its frames are.
        """
        found = self.reconstruct(demonstration, scenes, grip, moved.scene.T_world_base)
        if isinstance(found, Evidence):
            return found
        hold, seen = found.hold, found.seen
        begin = _begin(hold)
        players: list[tuple[Shape, Player]] = []
        for shape in found.shapes:
            player = self._player(self._source, demonstration, seen.support_z_m, shape)
            if player is not None and carried(self._play(player, demonstration, begin, hold.last), hold):
                stage = self._player(self._target, moved, seen.support_z_m, shape)
                if stage is not None:
                    players.append((shape, stage))
        if not players:
            return Evidence.none("the source's own motion does not hold it either")
        if not any(shape.primitive for shape, _ in players):
            return Evidence.none("no sphere, cylinder or box explains it, and hulls do not know what fingers meet")
        first, last = np.searchsorted(frames, begin), np.searchsorted(frames, hold.last, "right") - 1
        rng = np.random.default_rng([self._options.seed, demonstration.index])
        votes: list[bool] = []
        tries, sure = self._options.tries, self._options.sure
        for k in range(tries):
            heading = rng.uniform(-np.pi, np.pi)
            shift = (k >= len(players)) * self._options.shift_m * np.array([np.cos(heading), np.sin(heading), 0.0])
            player = players[k % len(players)][1]
            friction = _FRICTIONS[k // len(players) % len(_FRICTIONS)]
            played = self._play(player, moved, int(first), int(last), shift, friction)
            if not played.finite:
                return Evidence.none("physics becomes unstable in its twin")
            votes.append(carried(played, hold))
            if (len(votes) >= _ENOUGH and len(set(votes)) == 1) or Evidence.lost(votes, tries, sure):
                break
        return Evidence.of(votes, [shape.name for shape, _ in players], sure)

    def _player(self, robot: RobotPart, d: Demonstration, support: float, shape: Shape) -> Player | None:
        """A scene with the shape in it; None where MuJoCo cannot have it."""
        try:
            model = build_scene(robot, d.scene.T_world_base, support, shape, self._options)
        except ValueError:
            return None
        return Player(model, robot.embodiment, 1 / d.fps)

    def _play(
        self,
        player: Player,
        d: Demonstration,
        first: int,
        last: int,
        shift_world: Array | None = None,
        friction_scale: float = 1.0,
    ) -> Played:
        return player.play(d.qpos[first], d.action[first : last + 1], shift_world, friction_scale)

    def _fingers(self, demonstration: Demonstration, hold: Hold) -> Callable[[Array], Array]:
        """Whether points are where the source's hand was, up to the hold's begin."""
        frames = np.arange(max(0, hold.first - _FINGERS), hold.first + 1)
        T = demonstration.scene.T_world_base @ self._tree.forward(demonstration.qpos[frames])
        hulls = [
            (body, ConvexHull(vertices).equations)
            for body, vertices, hand in zip(self._links.body, self._links.vertices_link, self._links.hand, strict=True)
            if hand
        ]

        def inside(points: Array) -> Array:
            found = np.zeros(len(points), bool)
            for poses in T:
                for body, equations in hulls:
                    pose = poses[body]
                    p = (points - pose[:3, 3]) @ pose[:3, :3]
                    found |= (p @ equations[:, :3].T + equations[:, 3]).max(axis=1) < -_TOUCHING_M
            return found

        return inside


def carried(played: Played, hold: Hold) -> bool:
    """Whether what is held is where the hand's motion would have brought it, and off the support if that has been lifted."""
    if not played.finite:
        return False
    middle = hold.contacts_world.mean(axis=0)
    wanted, got = (T[:3, :3] @ middle + T[:3, 3] for T in (hold.moved, played.T_start_end))
    far = float(np.linalg.norm(wanted - middle))
    if wanted[2] - middle[2] > _LIFTED_M and played.on_support:
        return False
    return float(np.linalg.norm(got - wanted)) < max(_TOLERATED_M, _TOLERATED_SHARE * far)


def _begin(hold: Hold) -> int:
    """The last frame before the hold at which the hand is far enough away."""
    away = np.linalg.norm(hold.middle_world[: hold.first + 1] - hold.contacts_world.mean(axis=0), axis=1)
    far = np.flatnonzero(away > _APPROACH_M)
    return int(far[-1]) if len(far) else 0
