"""At inference: the clouds a policy was trained on, and a policy of one robot that runs, unchanged, on another.

run: python examples/06_policy_on_another_robot.py
"""

import gymnasium as gym

import cei_gym  # noqa: F401  (registers the environments)
from cei_converters.simulation.rollout import record_episode
from cei_gym.embodiment import load_embodiment
from cei_gym.pointcloud import CloudOptions
from cei_gym.transfer import Transfer
from cei_gym.wrapper import CrossEmbodimentWrapper

# Augment: as the cameras see it, and as the converter shows it (the whole robot, no holes where it hides itself).
env = gym.make("CEI-PickCube-UR5e-FourierRight")
observation, _ = env.reset(seed=0)
print("cloud as seen:   ", observation["point_cloud"].shape, "robot as the camera has it")
augmented = CrossEmbodimentWrapper(env, clouds=CloudOptions(points=2048))
observation, _ = augmented.reset(seed=0)
print("cloud, augmented:", observation["point_cloud"].shape, augmented.embodiment.name)

# Impersonate: the Panda's own policy (here its scripted expert) sees a Panda and moves one; a UR5e with a hand acts.
panda = gym.make("CEI-PickCube-Panda-PandaGripper")
transfer = Transfer(load_embodiment("Panda-PandaGripper"), load_embodiment("UR5e-FourierRight"))
transfer.fit([record_episode(panda, seed, seed)[0] for seed in range(6)])
env = CrossEmbodimentWrapper(env, impersonate=transfer)
observation, info = env.reset(seed=1)
print("joints shown:    ", observation["agent_pos"].shape, "acting:", env.unwrapped.embodiment.name)
plan = panda.unwrapped.expert(1).plan(observation["agent_pos"], observation["environment_state"])
for action in [*plan, *[plan[-1]] * 30]:
    observation, reward, terminated, truncated, info = env.step(action.astype("float32"))
    if terminated or truncated:
        break
print("the cube is", "lifted" if info["is_success"] else f"not lifted ({info['failure']})")
