"""The method alone, no simulator and no dataset: a Panda closes its gripper, an IIWA with an Inspire hand follows.

run: python examples/01_retarget_a_trajectory.py
"""

import numpy as np

from cei_gym.demonstration import Demonstration, Scene
from cei_gym.embodiment import load_embodiment
from cei_gym.transfer import Transfer

source, target = load_embodiment("Panda-PandaGripper"), load_embodiment("IIWA-Inspire")

# 40 frames: the arm moves a little while the gripper closes.
qpos = np.tile(source.home, (40, 1))
qpos[:, 1] += np.linspace(0.0, 0.3, 40)  # joint2, rad
qpos[:, 7:] = np.linspace(0.04, 0.01, 40)[:, None] * [1, -1]  # fingers, m

scene = Scene(
    T_world_base=np.eye(4),
    cameras=(),
    workspace_world=np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 1.5]]),
)
demonstration = Demonstration(source.name, fps=20, qpos=qpos, action=qpos, scene=scene)

converted, report = Transfer(source, target)(demonstration)

print(f"{len(converted)} frames of {len(target.joint_names)} joints: {', '.join(target.joint_names[:8])}, ...")
for name, value in report.summary().items():
    print(f"{name:24} {value}")
