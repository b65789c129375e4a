"""Pictures painted as they come: the robot that a policy knows, in the place of the one that acts."""

from dataclasses import dataclass, replace

import numpy as np

from cei_gym import extras
from cei_gym.arrays import Array
from cei_gym.demonstration import Camera
from cei_gym.embodiment import Embodiment
from cei_gym.errors import CEIError
from cei_gym.functional import sample_representation
from cei_gym.kinematics import KinematicTree
from cei_gym.painting.behind import Plate
from cei_gym.painting.carried import HAND_M, LEAST_PIXELS, Flat, Layer, near_hand
from cei_gym.painting.composite import completed, fineness, grown, with_layers, with_robot
from cei_gym.painting.light import Light
from cei_gym.painting.view import Drawn, RobotView, delayed
from cei_gym.rendering import unproject

_LIT_AT = (
    0,
    1,
    2,
    4,
    8,
    16,
    32,
    64,
)  # pictures of an episode that light is read from: of one pose alone it is not right for others
_IN_FRONT_M = 0.01


class LivePainter:
    """Paints a robot over the one that acts, in one fixed camera's pictures, of which no later one is known yet.

    What is behind the robot that acts is as the last picture that showed it has it; before one did, as the plate has it; else it is
    inpainted. Light and edges are read from the pictures themselves. With depth, what is in front of either robot stays there, and what is held is
    drawn whole: as it looked where it lay, moved with the hand. Without, of what is held only that is seen which the acting robot does not hide.

    Args:
        acting, shown: the robots; they may be the same, so that a policy that was trained on painted pictures sees one as painted.
        T_world_acting, T_world_shown: (4, 4) poses of their bases.
        camera: calibrated, and fixed.
        support_z_m: height of the surface that objects lie on, in the world.
        margin_px: around the acting robot's silhouette, what is taken out with it.
        plate: what is behind robots, as pictures of before show it.
        dt_s: time between pictures; needed where they trail the joints (`camera.lag_s`): robots are then drawn at the joints of that much earlier.

    Raises:
        CEIError: the camera's pictures trail the joints, and the time between them is not given.
        MissingExtra: OpenCV is not installed.
    """

    def __init__(
        self,
        acting: Embodiment,
        shown: Embodiment,
        T_world_acting: Array,
        T_world_shown: Array,
        camera: Camera,
        support_z_m: float,
        margin_px: float = 2.0,
        plate: Plate | None = None,
        dt_s: float | None = None,
    ) -> None:
        extras.require_module("painting pictures", "cv2")
        if camera.lag_s and not dt_s:
            raise CEIError(
                f"pictures of {camera.name} trail the joints by {camera.lag_s:g} s; give the time between them (dt_s) for them to be painted."
            )
        self._lag_frames = camera.lag_s / dt_s if dt_s else 0.0
        self.camera, self.margin_px, self.plate = camera, margin_px, plate
        self._support_z_m, self._hand = support_z_m, acting.end_effector_root
        self._acting = RobotView(acting, T_world_acting, camera)
        self._shown = RobotView(shown, T_world_shown, camera)
        self._T_world_acting, self._tree = T_world_acting, KinematicTree(acting)
        self._pads = sample_representation(acting)
        self.reset()

    def reset(self) -> None:
        """A new episode: what was seen counts no longer."""
        size = self.camera.height, self.camera.width
        self._behind, self._known, self._behind_m = np.zeros((*size, 3), np.uint8), np.zeros(size, bool), np.zeros(size)
        self._count, self._lit = 0, list[tuple[Drawn, Array]]()
        self._light, self._finer = Light.assumed(), 1
        self._held, self._carried = False, None
        self._past: list[tuple[Array, Array]] = []

    def __call__(
        self, picture: Array, qpos: Array, shown_qpos: Array, depth_m: Array | None = None, holds: bool = False
    ) -> Array:
        """Paint the next picture.

        Args:
            picture: (H, W, 3) uint8.
            qpos: (n,) joints of the robot that acts, rad or m.
            shown_qpos: (n',) those of the robot that is to be seen.
            depth_m: (H, W) along the optical axis, m, 0 or not finite where unknown; None where there is none.
            holds: whether the robot that acts holds something.

        Returns:
            (H, W, 3) uint8.

        Raises:
            CEIError: the picture or its depth is not of the camera's size.
        """
        self._check("a picture", picture, (self.camera.height, self.camera.width, 3))
        if depth_m is not None:
            self._check("depth", depth_m, (self.camera.height, self.camera.width))
            depth_m = np.nan_to_num(depth_m, nan=0.0, posinf=0.0, neginf=0.0)
        qpos, shown_qpos = self._in_the_picture(qpos, shown_qpos)
        acting = self._acting.draw(qpos)
        silhouette = np.zeros((self.camera.height, self.camera.width), bool)
        silhouette[acting.part] = acting.geom_id >= 0
        covered = grown(silhouette, self.margin_px)
        links = self._T_world_acting @ self._tree.forward(qpos)
        middle_world = self._pads.place(links)[0].mean(axis=0)
        hidden = covered | near_hand(middle_world, self.camera)
        self._remember(picture, depth_m, ~hidden)
        self._carry(links[self._hand], middle_world, hidden, holds and depth_m is not None)
        robot = covered if depth_m is None else covered & ~_before(acting, silhouette, depth_m)
        scene, never = self._uncovered(picture, robot)
        self._look(picture, acting)
        if self._count == 1:
            behind, _, _ = completed(scene.copy(), never, acting, self.plate)
            self._finer = fineness(self._acting, [(qpos, behind, picture)], self._light)
        drawn = self._shown.draw(shown_qpos, self._finer)
        scene, _, _ = completed(scene, never, drawn, self.plate)
        layers = [] if self._carried is None else [self._carried.now(links[self._hand], self.camera)]
        layers = [layer.hard() for layer in layers] if self._finer == 1 else layers
        near_m = with_layers(scene, np.flatnonzero(robot), layers, depth_m)
        return with_robot(scene, near_m, drawn, self._shown.colours, self._light)

    def _check(self, what: str, image: Array, shape: tuple[int, ...]) -> None:
        if image.shape != shape:
            raise CEIError(
                f"{what} of {self.camera.name} should be {shape}, as its calibration says, not {image.shape}."
            )

    def _in_the_picture(self, qpos: Array, shown_qpos: Array) -> tuple[Array, Array]:
        """Joints as a picture that trails them shows them."""
        self._past = [*self._past, (qpos, shown_qpos)][-(int(np.ceil(abs(self._lag_frames))) + 1) :]
        now, shown = (delayed(np.stack(joints), self._lag_frames)[-1] for joints in zip(*self._past, strict=True))
        return now, shown

    def _remember(self, picture: Array, depth_m: Array | None, where: Array) -> None:
        np.copyto(self._behind, picture, where=where[..., None])
        self._known |= where
        if depth_m is not None:
            np.copyto(self._behind_m, depth_m, where=where)

    def _carry(self, T_world_hand: Array, middle_world: Array, hidden: Array, holds: bool) -> None:
        """Take what is held out of what is remembered, when it is taken, and forget it once the place where it was left has been seen."""
        if holds and not self._held:
            where = self._near(middle_world)
            self._carried = None
            if np.count_nonzero(where) >= LEAST_PIXELS:
                flat = Flat.of(self._behind, where, middle_world, self.camera)
                self._carried = _Carried(flat, T_world_hand)
                self._known[grown(where, self.margin_px)] = False
        elif self._held and not holds and self._carried is not None:
            self._carried = replace(self._carried, left=T_world_hand)
        self._held = holds
        carried = self._carried
        if carried is not None and carried.left is not None:
            still_hidden = hidden & (carried.now(T_world_hand, self.camera).alpha > 0)
            self._carried = carried if still_hidden.any() else None

    def _near(self, middle_world: Array) -> Array:
        """(H, W) bool, the pixels that showed something on the support surface where the hand is now."""
        seen_m = np.where(self._known, self._behind_m, 0.0)
        points = unproject(seen_m, self.camera)
        near = np.linalg.norm(points - middle_world, axis=1) < HAND_M
        where = np.zeros(seen_m.shape, bool)
        where[seen_m > 0] = near & (points[:, 2] > self._support_z_m)
        return where

    def _uncovered(self, picture: Array, robot: Array) -> tuple[Array, Array]:
        """(H, W, 3) uint8, the picture without the acting robot, and (H, W) bool, where nothing has shown yet what is behind."""
        scene = picture.copy()
        seen = robot & self._known
        scene[seen] = self._behind[seen]
        return scene, robot & ~self._known

    def _look(self, picture: Array, acting: Drawn) -> None:
        """Read the light, from some pictures."""
        if self._count in _LIT_AT:
            self._lit.append((acting, picture / 255))
            drawn, pictures = zip(*self._lit, strict=True)
            self._light = Light.read(drawn, pictures, self._acting.colours, from_edges_px=2)
        self._count += 1


@dataclass(frozen=True)
class _Carried:
    """What the hand has taken, where `taken` (4, 4) in the world, and perhaps has `left`."""

    flat: Flat
    taken: Array
    left: Array | None = None

    def now(self, T_world_hand: Array, camera: Camera) -> Layer:
        at = T_world_hand if self.left is None else self.left
        return self.flat.moved(at @ np.linalg.inv(self.taken), camera)


def _before(acting: Drawn, silhouette: Array, depth_m: Array) -> Array:
    """(H, W) bool, the pixels of a robot's silhouette in which depth shows something before it; specks are of steep surfaces."""
    import cv2

    part, before = depth_m[acting.part], np.zeros(silhouette.shape, np.uint8)
    before[acting.part] = (acting.geom_id >= 0) & (part > 0) & (part < acting.depth_m - _IN_FRONT_M)
    return cv2.morphologyEx(before, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)).astype(bool)
