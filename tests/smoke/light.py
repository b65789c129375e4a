"""Use the wheel of the method alone, with none of its extras: `.ci/run` does in a fresh environment. Not a pytest module.

A skill is moved between two robots of one's own, solvers and environments that are not there say which extra brings them, and so does each command.
"""

import subprocess
import sys
import tempfile
from collections.abc import Callable
from importlib.metadata import distribution, distributions
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np

if TYPE_CHECKING:
    from cei_gym import Embodiment

INERTIAL = '<inertial><mass value="0.1"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial>'
HAND = f"""<robot name="hand">
  <link name="palm">{INERTIAL}<collision><geometry><box size="0.04 0.1 0.02"/></geometry></collision></link>
  <link name="left">{INERTIAL}<collision><origin xyz="0 0.005 0.03"/><geometry><box size="0.02 0.01 0.04"/></geometry></collision></link>
  <link name="right">{INERTIAL}<collision><origin xyz="0 -0.005 0.03"/><geometry><box size="0.02 0.01 0.04"/></geometry></collision></link>
  <joint name="open" type="prismatic"><parent link="palm"/><child link="left"/><axis xyz="0 1 0"/>
    <limit lower="0" upper="0.04" effort="5" velocity="0.2"/></joint>
  <joint name="other" type="prismatic"><parent link="palm"/><child link="right"/><axis xyz="0 -1 0"/><mimic joint="open"/>
    <limit lower="0" upper="0.04" effort="5" velocity="0.2"/></joint>
</robot>"""
HAND_YAML = """name: Lab
description: hand.urdf
home: {open: 0.04}
closed: {open: 0}
pads: [{body: left}, {body: right}]
"""
AXES = ("0 0 1", "0 1 0", "0 1 0", "0 0 1", "0 1 0", "0 0 1")
HOME = (0.1, 0.5, 0.6, 0.2, 0.7, 0.1)
FRAMES = 20


def arm(segment_m: float) -> str:
    """A URDF of six joints, each at the end of a segment."""
    links = "".join(
        f'<link name="l{i}">{INERTIAL}<collision><origin xyz="0 0 {segment_m / 2}"/>'
        f'<geometry><box size="0.03 0.03 {segment_m}"/></geometry></collision></link>'
        for i in range(7)
    )
    joints = "".join(
        f'<joint name="j{i}" type="revolute"><origin xyz="0 0 {segment_m}"/><parent link="l{i}"/><child link="l{i + 1}"/>'
        f'<axis xyz="{axis}"/><limit lower="-2.9" upper="2.9" effort="50" velocity="3"/></joint>'
        for i, axis in enumerate(AXES)
    )
    return f'<robot name="arm">{links}{joints}</robot>'


def retarget(folder: Path) -> None:
    """Have a robot follow one of another size, and compare where their fingers are."""
    from cei_gym import Transfer
    from cei_gym.embodiment import ArmSpec, EndEffectorSpec, build_embodiment, load_spec

    (folder / "hand.urdf").write_text(HAND)
    (folder / "hand.yaml").write_text(HAND_YAML)
    hand = load_spec(EndEffectorSpec, folder / "hand.yaml")
    robots = []
    for name, segment_m in (("Short", 0.15), ("Long", 0.17)):
        (folder / f"{name}.urdf").write_text(arm(segment_m))
        spec = ArmSpec(name, f"{name}.urdf", "l6", {f"j{i}": angle for i, angle in enumerate(HOME)})
        robots.append(build_embodiment(spec, hand, folder))
    source, target = robots
    live = Transfer(source, target).stream(dt_s=0.05)  # half of what a whole demonstration has compiled
    apart_m = []
    for turn in np.linspace(0.0, 0.2, FRAMES):
        qpos = source.home + turn * (np.arange(len(source.home)) == 1)
        apart_m.append(np.linalg.norm(fingers(source, qpos) - fingers(target, live(qpos)), axis=1).max())
    assert max(apart_m) < 0.002, apart_m
    print(f"{target.name} follows {source.name}: fingers at most {1000 * max(apart_m):.2f} mm apart")


def fingers(robot: "Embodiment", qpos: np.ndarray) -> np.ndarray:
    """(2, 3) where they are in the base frame, m, by MuJoCo."""
    data = mujoco.MjData(robot.model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(robot.model, data)
    return data.xpos[[robot.body_id("left"), robot.body_id("right")]]


def said(call: Callable[[], object]) -> str:
    """The one line of an error."""
    from cei_gym import CEIError

    try:
        call()
    except CEIError as error:
        assert "\n" not in str(error), error
        return str(error)
    raise AssertionError("it works")


def check_python() -> None:
    """What is imported or opened without its extra says which."""
    import gymnasium as gym

    import cei_gym
    from cei_gym.extras import EXTRAS, installed

    site = Path(sys.prefix).resolve()
    assert Path(cei_gym.__file__).resolve().is_relative_to(site), f"{cei_gym.__file__} is not of the wheel"
    there = [module for extra in EXTRAS.values() for module in extra.modules if installed(module)]
    assert not there, f"the method brings {there}"

    def torch_chain() -> object:
        from cei_gym.kinematics import torch_chain

        return torch_chain

    def sources() -> object:
        from cei_converters.sources import formats

        return formats

    for call, extra in (
        (lambda: gym.make("CEI-PickCube-IIWA-Inspire"), "robosuite"),
        (lambda: cei_gym.load_embodiment("Panda-PandaGripper"), "robosuite"),
        (torch_chain, "torch"),
        (sources, "lerobot"),
    ):
        line = said(call)
        assert f'pip install "cei-gym[{extra}]"' in line, line
        print(line)


def check_commands(folder: Path) -> None:
    """Each says its line, but for `cei-pads`, which needs nothing."""
    scripts = Path(sys.executable).parent
    for command in sorted(e.name for e in distribution("cei-gym").entry_points if e.group == "console_scripts"):
        options = {
            "cei-pads": [f"--end_effector={folder}/hand.yaml", f"--output={folder}/pads.png"],
            "cei-robot": ["check", f"{folder}/hand.yaml"],
        }.get(command, [])
        done = subprocess.run([scripts / command, *options], capture_output=True, text=True, check=False)
        if command == "cei-pads":
            assert done.returncode == 0 and (folder / "pads.png").stat().st_size > 1000, done.stderr
        elif command == "cei-robot":
            assert done.returncode == 0 and "Nothing is wrong with it." in done.stdout, done.stderr or done.stdout
        else:
            extra = "view" if command == "cei-view" else "lerobot"
            assert done.returncode == 1, f"{command} exits {done.returncode}: {done.stderr}"
            assert done.stderr == f'error: {command} needs LeRobot: pip install "cei-gym[{extra}]".\n', done.stderr
        print(f"{command}: {done.stderr.strip() or done.stdout.strip()}")


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        retarget(Path(folder))
        check_python()
        check_commands(Path(folder))
    print(f"{len([*distributions()])} distributions are installed")


if __name__ == "__main__":
    main()
