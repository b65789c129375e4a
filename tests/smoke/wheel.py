"""Use the installed wheels, outside the source tree: `.ci/run` runs it in a fresh environment. Not a pytest module."""

import shlex
import subprocess
import sys
import tempfile
from importlib.metadata import distribution
from pathlib import Path

COMMANDS = ("cei-record", "cei-convert", "cei-inspect", "cei-replay", "cei-pads", "cei-view", "cei-benchmark")
DATASET = "--dataset.repo_id=me/ur5e --dataset.root=ur5e"
JOB = f"""
cei-record --env=CEI-PickCube-Panda-PandaGripper --episodes=2 --seed=0 --repo_id=me/panda --root=panda
cei-convert --dataset.repo_id=me/panda --dataset.root=panda --target=UR5e-FourierRight --new_repo_id=me/ur5e --new_root=ur5e
cei-replay {DATASET} --video=replay.mp4
lerobot-train {DATASET} --policy.type=dp3 --policy.size=small --policy.points=64 --policy.device=cpu --policy.push_to_hub=false \
    --batch_size=4 --steps=4 --save_freq=4 --num_workers=0 --output_dir=train
lerobot-eval --policy.path=train/checkpoints/last/pretrained_model --policy.device=cpu --env.type=cei --env.dataset=ur5e \
    --env.episode_length=10 --eval.n_episodes=1 --eval.batch_size=1 --seed=1000 --output_dir=eval
"""


def main() -> None:
    import gymnasium as gym

    import cei_converters
    import cei_envs
    import cei_gym
    import lerobot_env_cei
    import lerobot_policy_dp3
    from cei_gym.embodiment import embodiment_names, load_embodiment

    site = Path(sys.prefix).resolve()
    for package in (cei_gym, cei_converters, cei_envs, lerobot_env_cei, lerobot_policy_dp3):
        location = Path(package.__file__).resolve()
        assert location.is_relative_to(site), f"{package.__name__} comes from {location}, not from its wheel"
    print(f"imports: cei-gym {distribution('cei-gym').version}")

    names = embodiment_names()
    for name in names:
        load_embodiment(name)
    print(f"catalogue: {len(names)} embodiments load")

    env = gym.make("CEI-PickCube-IIWA-Inspire")
    _, info = env.reset(seed=0)
    observation, _, _, _, info = env.step(env.action_space.sample())
    assert env.observation_space.contains(observation), "the observation is outside its space"
    assert "is_success" in info
    env.close()
    print("environment: steps")

    for command in COMMANDS:
        path = Path(sys.executable).with_name(command)
        done = subprocess.run([path, "--help"], capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{command} --help exits {done.returncode}: {done.stderr}"
        assert "usage" in done.stdout.lower(), f"{command} --help prints no usage"
        print(f"{command} --help: works")

    # The main job, to a trained and evaluated policy; LeRobot's scripts find both plugins by themselves.
    with tempfile.TemporaryDirectory() as folder:
        for line in JOB.replace("\\\n", "").strip().splitlines():
            command, *options = shlex.split(line)
            path = Path(sys.executable).with_name(command)
            done = subprocess.run([path, *options], cwd=folder, capture_output=True, text=True, check=False)
            assert done.returncode == 0, f"{command} exits {done.returncode}: {done.stderr}"
            print(f"{command}: done", flush=True)
        for made in ("replay.mp4", "eval/eval_info.json"):
            assert Path(folder, made).stat().st_size > 100, f"{made} is empty"


if __name__ == "__main__":
    main()
