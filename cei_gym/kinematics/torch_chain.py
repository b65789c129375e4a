"""The same kinematics as a `pytorch_kinematics` chain, built from the compiled model (differentiable, batched).

Built by hand because pytorch_kinematics' own MJCF reader refuses bodies with several joints and ignores `ref`,
equalities and mimic joints.
"""

import numpy as np

from cei_gym import extras

with extras.needed_by("TorchChain (the solver 'paper')"):
    import pytorch_kinematics as pk
    import torch
    from pytorch_kinematics.frame import Frame, Joint, Link
    from pytorch_kinematics.transforms import Transform3d

from cei_gym.arrays import Array
from cei_gym.embodiment.embodiment import Embodiment
from cei_gym.kinematics.tree import KinematicTree


class TorchChain:
    """Differentiable forward kinematics of an embodiment in its base frame.

    Args:
        embodiment: the embodiment.
        dtype, device: of the computation.
    """

    def __init__(self, embodiment: Embodiment, dtype=torch.float64, device="cpu") -> None:
        self.embodiment, self.dtype, self.device = embodiment, dtype, device
        tree = KinematicTree(embodiment).arrays
        self._reference = torch.tensor(tree.reference, dtype=dtype, device=device)
        frames = [Frame("body_0", link=Link("body_0"))]
        for body in range(1, len(tree.parent)):
            parent = frames[tree.parent[body]]
            offset = self._transform(tree.rot[body], tree.pos[body])
            for joint in range(tree.joint_start[body], tree.joint_start[body + 1]):
                # Move to the joint's anchor, turn or slide there, and move back.
                offset = offset.compose(self._transform(np.eye(3), tree.anchor[joint]))
                kind = "revolute" if tree.hinge[joint] else "prismatic"
                name = f"joint_{joint}"
                frame = Frame(name, Link(name), Joint(name, offset, kind, tree.axis[joint], dtype, device))
                parent.add_child(frame)
                parent, offset = frame, self._transform(np.eye(3), -tree.anchor[joint])
            name = f"body_{body}"
            frame = Frame(name, Link(name), Joint(f"fixed_{body}", offset, "fixed", None, dtype, device))
            parent.add_child(frame)
            frames.append(frame)
        self.chain = pk.Chain(frames[0], dtype=dtype, device=device)
        self._order = [int(n.removeprefix("joint_")) for n in self.chain.get_joint_parameter_names()]
        self._names = [f.name for f in frames]
        self._frames = self.chain.get_frame_indices(*self._names)

    def _transform(self, rot: Array, pos: Array) -> Transform3d:
        return Transform3d(
            rot=torch.tensor(rot, dtype=self.dtype, device=self.device),
            pos=torch.tensor(pos, dtype=self.dtype, device=self.device),
            dtype=self.dtype,
            device=self.device,
        )

    def forward(self, qpos: torch.Tensor, bodies: list[int] | None = None) -> torch.Tensor:
        """Poses of links: (B, n) joint positions (rad, m) to T_base_links (B, L, 4, 4).

        Args:
            qpos: (B, n) joint positions.
            bodies: the links wanted, all by default.
        """
        wanted = range(len(self._names)) if bodies is None else bodies
        theta = (qpos - self._reference)[:, self._order]
        poses = self.chain.forward_kinematics(theta, self._frames[list(wanted)])
        return torch.stack([poses[self._names[i]].get_matrix() for i in wanted], dim=1)
