"""Live use: one configuration of the source in, one of the target out, as for a robot that is being moved by hand.

run: python examples/05_live_retargeting.py
"""

import time

import numpy as np

from cei_gym.embodiment import load_embodiment
from cei_gym.transfer import Transfer

source, target = load_embodiment("Panda-PandaGripper"), load_embodiment("UR5e-FourierRight")
live = Transfer(source, target).stream(dt_s=0.05)  # 20 Hz: joints keep their velocity limits

milliseconds = []
for t in range(200):
    qpos = source.home.copy()
    qpos[1] += 0.2 * np.sin(t / 40)  # rad
    qpos[7:] = (0.02 + 0.02 * np.cos(t / 15)) * np.array([1, -1])  # m
    start = time.perf_counter()
    command = live(qpos)
    milliseconds.append(1e3 * (time.perf_counter() - start))

print(f"first frame, found from scratch: {milliseconds[0]:.0f} ms")
print(f"the others: median {np.median(milliseconds[1:]):.2f} ms, p99 {np.quantile(milliseconds[1:], 0.99):.2f} ms")
print("last command:", dict(zip(target.joint_names[:6], command[:6].round(3).tolist(), strict=True)), "...")
