"""The objective of many configurations at once in torch: the DCD, its majoriser's derivatives, clearance.

The arithmetic of `kernels.distance`, `kernels.quadratic` and `kernels.collision` as few wide operations: B problems at once,
each a configuration against one frame of a source.
"""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from cei_gym.alignment.kernels.collision import CollisionConstraint
from cei_gym.alignment.kernels.target import Target
from cei_gym.alignment.problem import Motion
from cei_gym.alignment.solvers.torch_records import BatchPose, Sources
from cei_gym.alignment.solvers.torch_tree import ancestors, carried_by, coupling, motions, placing
from cei_gym.arrays import Array

_SMOOTHING_M = 1e-3  # see `kernels.quadratic`
_FAR_M = 1e6  # where obstacle points are that only fill an array
_PAIRS_AT_ONCE = {"cpu": 1 << 17}  # what matching compares: a CPU's cache holds them
_MOST_PAIRS_AT_ONCE = 1 << 27  # elsewhere: 2 GB


class TorchModel:
    """A target on a device.

    Args:
        target: its arrays.
        collision: links that stay clear of surroundings; without, none do.
        lambda_m: weight of direction, m.
        device, dtype: of the computation.
    """

    def __init__(
        self,
        target: Target,
        collision: CollisionConstraint | None,
        lambda_m: float,
        device: torch.device,
        dtype: torch.dtype,
    ) -> None:
        self.device, self.dtype, self._lambda = device, dtype, lambda_m
        real, whole = self.tensor, self._whole
        self.lower, self.upper, self.fastest = real(target.lower), real(target.upper), real(target.fastest)
        joints, n = target.joints, len(target.leader)
        self._leader, self._scale = whole(target.leader), real(target.scale)
        self._shift, self._fold = real(target.offset - joints.reference), real(coupling(target))
        self._motion, self._axis = real(motions(joints)), real(joints.axis)
        self._hinge = torch.as_tensor(joints.hinge, device=device)[:, None]
        self._up = [whole(up) for up in ancestors(joints.parent)]
        carried = carried_by(joints.parent)  # (n + 1, n): rows are joints and the base
        self._above = real(carried[:n])
        self._moves = real(carried[target.pad_joint])
        carriers, which = np.unique(target.pad_joint, return_inverse=True)
        self._carriers, self._pads = whole(carriers % (n + 1)), real(placing(target.pads, which, len(carriers)))
        self._links = None if collision is None or collision.weight <= 0 else _Links(self, collision, carried)

    def tensor(self, x) -> Tensor:
        """An array of reals on the device."""
        return torch.as_tensor(np.asarray(x, float)).to(self.dtype).to(self.device)

    def _whole(self, x) -> Tensor:
        return torch.as_tensor(np.asarray(x, np.int64), device=self.device)

    def sources(self, motions: Sequence[Motion]) -> Sources:
        """All frames of motions, one after the other."""
        points = np.concatenate([np.asarray(m.points_base, float) for m in motions])
        normals = np.concatenate([np.asarray(m.normals_base, float) for m in motions])
        origin = points.mean(axis=1)
        pairs = self.tensor(np.concatenate([points - origin[:, None], normals], axis=2)).mT.contiguous()
        height, obstacles = _surroundings(motions)
        return Sources(self.tensor(origin), pairs, self.tensor(height), self.tensor(obstacles - origin[:, None]))

    def evaluate(self, u: Tensor, sources: Sources, frame: Tensor) -> tuple[Tensor, Tensor, BatchPose]:
        """The objective of configurations (B, m), each for one of the sources' frames, by its index (B,).

        Returns:
            (B,) DCD, m, (B,) penalty on lacking clearance, m, and what `derivatives` takes.
        """
        origin, source = sources.origin[frame], sources.pairs[frame]
        frames = self._place_joints(u, origin)
        pairs = self._place_pads(frames)
        forth, back = _match(source, pairs, self._lambda)
        there, pull_there = self._meet(source, _gather(pairs, forth))
        here, pull = self._meet(_gather(source, back), pairs)
        pull = pull.scatter_add(2, forth[:, None].expand(-1, 8, -1), pull_there)
        lacking, wrench, penalty = u.new_zeros(len(u), 0), u.new_zeros(len(u), 0, 6), torch.zeros_like(here)
        if self._links is not None:
            lacking, wrench = self._links.contacts(
                frames, sources.height[frame] - origin[:, 2], sources.obstacles[frame]
            )
            penalty = 0.5 * self._links.weight * lacking.square().sum(1)
        return there + here, penalty, BatchPose(frames, pairs, pull, lacking, wrench)

    def derivatives(self, pose: BatchPose) -> tuple[Tensor, Tensor]:
        """Gradient (B, m) and Hessian (B, m, m) of the majoriser and of the penalty, in the independent joints."""
        force, weight, lever, moment = self._loads(pose)
        screw = self._screws(pose.frames)
        linear, angular = screw.split(3, dim=2)
        # What moving a joint alone takes from all that it carries: its composite 6x6 block times its screw.
        trace = moment.diagonal(dim1=2, dim2=3).sum(2, keepdim=True)
        effort = torch.cat(
            [
                weight * linear - _cross(lever, angular),
                _cross(lever, linear) + trace * angular - (moment @ angular[..., None])[..., 0],
            ],
            dim=2,
        )
        half = self._above * (effort @ screw.mT)
        hessian = half + half.mT - torch.diag_embed(half.diagonal(dim1=1, dim2=2))
        gradient = (screw * force).sum(2) @ self._fold
        hessian = self._fold.T @ hessian @ self._fold
        if self._links is not None:
            out = self._links.moves * (pose.wrench @ screw.mT) @ self._fold * (pose.lacking > 0)[..., None]
            gradient = gradient - self._links.weight * (pose.lacking[:, None] @ out)[:, 0]
            hessian = hessian + self._links.weight * (out.mT @ out)
        return gradient, hessian

    def _place_joints(self, u: Tensor, origin: Tensor) -> Tensor:
        q = u[:, self._leader] * self._scale + self._shift
        terms = torch.stack([torch.ones_like(q), q.sin(), 1 - q.cos(), q], dim=2)
        own = torch.einsum("bjt,jtx->bjx", terms, self._motion).unflatten(2, (4, 4))
        base = torch.eye(4, dtype=self.dtype, device=self.device).expand(len(u), 1, 4, 4)
        frames = torch.cat([own, base], dim=1)
        for up in self._up:
            frames = frames[:, up] @ frames
        frames[..., :3, 3] -= origin[:, None]
        return frames

    def _place_pads(self, frames: Tensor) -> Tensor:
        carriers = frames[:, self._carriers, :3].transpose(1, 2).flatten(2)
        return (carriers @ self._pads).unflatten(2, (2, -1)).transpose(1, 2).flatten(1, 2)

    def _screws(self, frames: Tensor) -> Tensor:
        """(B, n, 6) velocity at the centroid, linear then angular, as each joint moves."""
        frames = frames[:, :-1]
        axis = (frames[..., :3, :3] @ self._axis[..., None])[..., 0]
        return torch.cat([torch.where(self._hinge, _cross(frames[..., :3, 3], axis), axis), self._hinge * axis], 2)

    def _loads(self, pose: BatchPose) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Sums over all pads that each joint carries.

        Returns:
            (B, n, 6) forces, (B, n, 1) weights, (B, n, 3) and (B, n, 3, 3) their first and second moments, the second with
            the weights of turning normals.
        """
        point, normal = pose.pairs.split(3, dim=1)
        weight, turn = pose.pull[:, 6:7], pose.pull[:, 7:]
        torque, turning = _cross(pose.pairs.unflatten(1, (2, 3)), pose.pull[:, :6].unflatten(1, (2, 3))).unbind(1)
        lever = weight * point
        moment = lever[:, :, None] * point[:, None] + (turn * normal)[:, :, None] * normal[:, None]
        loads = (
            torch.cat([pose.pull[:, :3], torque - turning, weight, lever, moment.flatten(1, 2)], dim=1) @ self._moves
        )
        force, weight, lever, moment = loads.mT.split([6, 1, 3, 9], dim=2)
        return force, weight, lever, moment.unflatten(2, (3, 3))

    def _meet(self, source: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
        """(B,) mean cost of matched pairs (B, 6, K), m, and (B, 8, K) how they pull; see `BatchPose`."""
        share = 1.0 / source.shape[2]
        offset, normal = target[:, :3] - source[:, :3], source[:, 3:]
        squared = offset.square().sum(1, keepdim=True)
        cost = squared.sqrt()[:, 0] - self._lambda * (normal * target[:, 3:]).sum(1)
        stiffness = share * (squared + _SMOOTHING_M**2).rsqrt()
        turn = torch.full_like(stiffness, share * self._lambda)
        return cost.mean(1), torch.cat([stiffness * offset, turn * normal, stiffness, turn], 1)


class _Links:
    """Links as convex shapes on a device: see `kernels.collision`. Contacts are K with the surface, then I with objects."""

    def __init__(self, model: TorchModel, collision: CollisionConstraint, carried: Array) -> None:
        self.weight = collision.weight
        idle = np.flatnonzero(collision.idle)
        joint = torch.as_tensor(collision.joint, device=model.device)
        self._joint, self._idle_joint = joint, joint[torch.as_tensor(idle, device=model.device)]
        margin = collision.margin_m
        self._margin, self._idle_margin = model.tensor(margin), model.tensor(margin[idle])
        self.moves = model.tensor(carried[np.concatenate([collision.joint, collision.joint[idle]])])
        # Links have as many vertices as the richest one: the last counts several times.
        count = np.diff(collision.start)
        which = collision.start[:-1, None] + np.minimum(np.arange(count.max(initial=1)), count[:, None] - 1)
        self._vertices = model.tensor(collision.vertices[which])
        self._directions, self._reach = model.tensor(collision.directions), model.tensor(collision.reach[idle])

    def contacts(self, frames: Tensor, height: Tensor, obstacles: Tensor) -> tuple[Tensor, Tensor]:
        """(B, C) lacking clearance, m, and (B, C, 6) wrenches; see `BatchPose`."""
        found = self._surface(frames, height), self._objects(frames, obstacles)
        lacking, point, normal = (torch.cat(x, dim=1) for x in zip(*found, strict=True))
        return lacking.clamp(min=0), torch.cat([normal, _cross(point, normal)], dim=2)

    def _surface(self, frames: Tensor, height: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Clearance that links lack above a surface at (B,) heights, each one's lowest point, and the way out."""
        pose = frames[:, self._joint]
        lowest, which = torch.einsum("bkx,kvx->bkv", pose[..., 2, :3], self._vertices).min(dim=2)
        vertex = self._vertices[torch.arange(len(self._joint), device=which.device), which]
        point = (pose[..., :3, :3] @ vertex[..., None])[..., 0] + pose[..., :3, 3]
        normal = torch.zeros_like(point)
        normal[..., 2] = 1
        return height[:, None] + self._margin - (lowest + pose[..., 2, 3]), point, normal

    def _objects(self, frames: Tensor, obstacles: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Clearance that idle links lack from objects, the nearest point of those, and the link's way out."""
        pose = frames[:, self._idle_joint]
        rot, pos = pose[..., :3, :3], pose[..., :3, 3]
        local = (obstacles[:, None] - pos[:, :, None]) @ rot  # (B, I, P, 3)
        outside = (local @ self._directions.T - self._reach[:, None]).amax(dim=3)
        distance, nearest = outside.min(dim=2)
        point = _pick(obstacles[:, None].expand(-1, rot.shape[1], -1, -1), nearest)
        face = (_pick(local, nearest) @ self._directions.T - self._reach).argmax(dim=2)
        normal = -(rot @ self._directions[face][..., None])[..., 0]
        return self._idle_margin - distance, point, normal


def _match(source: Tensor, target: Tensor, lambda_m: float) -> tuple[Tensor, Tensor]:
    """Nearest pairs both ways, (B, N) and (B, N') indices, of pairs (B, 6, N) and (B, 6, N').

    Costs become integers with room for an index below them, so that the least integer brings its place along: a search
    for the place of a minimum takes ten times as long.
    """
    n, n_target, device = source.shape[2], target.shape[2], source.device
    row = torch.arange(n, dtype=torch.int32, device=device)[:, None]
    column = torch.arange(n_target, dtype=torch.int32, device=device)
    (a, normal_a), (b, normal_b) = source.split(3, dim=1), target.split(3, dim=1)
    aa, bb = a.square().sum(1, keepdim=True), b.square().sum(1, keepdim=True)
    room, most = max(n, n_target), aa.amax(2, True).sqrt() + bb.amax(2, True).sqrt() + 1.01 * abs(lambda_m) + 1e-6
    scale = (2**31 / room - 2) / most
    near = torch.cat([aa, torch.ones_like(aa), a], 1), scale**2 * torch.cat([torch.ones_like(bb), bb, -2 * b], 1)
    factors = *near, normal_a, -lambda_m * scale * normal_b
    at_once = max(1, _PAIRS_AT_ONCE.get(device.type, _MOST_PAIRS_AT_ONCE) // (n * n_target))
    forth, back = [], []
    for some in zip(*(x.split(at_once) for x in factors), strict=True):
        cost = (some[0].mT @ some[1]).clamp_(min=0).sqrt_().baddbmm_(some[2].mT, some[3]).to(torch.int32)
        forth.append(torch.add(column, cost, alpha=room).amin(dim=2))
        back.append(torch.add(row, cost, alpha=room).amin(dim=1))
    return torch.cat(forth).remainder_(room).long(), torch.cat(back).remainder_(room).long()


def _gather(pairs: Tensor, which: Tensor) -> Tensor:
    return pairs.gather(2, which[:, None].expand(-1, pairs.shape[1], -1))


def _pick(x: Tensor, which: Tensor) -> Tensor:
    """Pick from (B, I, P, 3) one point each, (B, I, 3), by its index (B, I)."""
    return x.gather(2, which[..., None, None].expand(-1, -1, 1, 3))[:, :, 0]


def _cross(a: Tensor, b: Tensor) -> Tensor:
    return torch.linalg.cross(a, b, dim=2)


def _surroundings(motions: Sequence[Motion]) -> tuple[Array, Array]:
    """(F,) heights and (F, P, 3) obstacle points of all frames."""
    heights, obstacles = [], []
    for motion in motions:
        around, frames = motion.surroundings, len(motion.points_base)
        heights += [-np.inf if around is None else around.support_z_base_m] * frames
        points = () if around is None else around.obstacles_base
        obstacles += list(points) if len(points) else [np.zeros((0, 3))] * frames
    filled = np.full((len(obstacles), max([1, *map(len, obstacles)]), 3), _FAR_M)
    for row, points in zip(filled, obstacles, strict=True):
        row[: len(points)] = points
    return np.array(heights), filled
