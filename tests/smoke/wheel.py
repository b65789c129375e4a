"""Use the installed wheels, outside the source tree: `.ci/run` runs it in a fresh environment. Not a pytest module."""

import subprocess
import sys
from importlib.metadata import distribution
from pathlib import Path


def main() -> None:
    import gymnasium as gym

    import cei_converters
    import cei_envs
    import cei_gym
    import lerobot_env_cei
    import lerobot_policy_dp3
    import lerobot_robot_cei
    from cei_gym.embodiment import GRID, load_embodiment

    site = Path(sys.prefix).resolve()
    for package in (cei_gym, cei_converters, cei_envs, lerobot_env_cei, lerobot_policy_dp3, lerobot_robot_cei):
        location = Path(package.__file__).resolve()
        assert location.is_relative_to(site), f"{package.__name__} comes from {location}, not from its wheel"
    print(f"imports: cei-gym {distribution('cei-gym').version}")

    for name in (*GRID, "Sawyer-Robotiq140", "Jaco-RethinkGripper"):
        load_embodiment(name)
    print(f"catalogue: {len(GRID) + 2} embodiments load")

    env = gym.make("CEI-PickCube-IIWA-Inspire")
    _, info = env.reset(seed=0)
    observation, _, _, _, info = env.step(env.action_space.sample())
    assert env.observation_space.contains(observation), "the observation is outside its space"
    assert "is_success" in info
    env.close()
    print("environment: steps")

    commands = [each.name for each in distribution("cei-gym").entry_points if each.group == "console_scripts"]
    assert {"cei-record", "cei-convert", "cei-restore"} <= {*commands}, commands
    for command in commands:
        path = Path(sys.executable).with_name(command)
        done = subprocess.run([path, "--help"], capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{command} --help exits {done.returncode}: {done.stderr}"
        assert "usage" in done.stdout.lower(), f"{command} --help prints no usage"
        print(f"{command} --help: works")


if __name__ == "__main__":
    main()
