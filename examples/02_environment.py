"""A Gymnasium environment: make it, look at an observation, move one joint, save a picture.

run: python examples/02_environment.py
"""

from pathlib import Path

import gymnasium as gym
from PIL import Image

import cei_gym  # noqa: F401  (registers the environments)

env = gym.make("CEI-PickCube-IIWA-Inspire", render_mode="rgb_array")
observation, info = env.reset(seed=0)
for key, value in observation.items():
    print(f"{key:18} {value.shape} {value.dtype}")

action = observation["agent_pos"].copy()  # absolute joint targets: staying is the current position
action[0] += 0.2  # rad, first arm joint
for _ in range(5):
    observation, reward, terminated, truncated, info = env.step(action)
print(f"joint_1 is at {observation['agent_pos'][0]:.3f} rad; success: {info['is_success']} ({info['failure']})")

# A recorded start can be restored exactly.
start = {"environment_state": observation["environment_state"], "agent_pos": observation["agent_pos"]}
env.reset(options=start)

Path("outputs").mkdir(exist_ok=True)
Image.fromarray(env.render()).save("outputs/environment.png")
print("wrote outputs/environment.png")
env.close()
