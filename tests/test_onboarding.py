"""From a description to a YAML with `cei-robot` alone: what it proposes, what it says is wrong, and that what it writes is what it means."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from cei_converters.robot import command
from cei_gym.embodiment import (
    ArmSpec,
    EndEffectorSpec,
    Pad,
    build_embodiment,
    load_arm,
    load_end_effector,
    load_spec,
)
from cei_gym.embodiment.catalogue import load_part
from cei_gym.embodiment.description import load_description
from cei_gym.embodiment.resources import locate
from cei_gym.errors import CEIError
from cei_gym.kinematics import KinematicTree
from cei_gym.onboarding import check_arm, check_end_effector, propose
from cei_gym.onboarding.overlaps import Overlaps
from cei_gym.onboarding.structure import find_parts
from cei_gym.onboarding.writing import yaml_of

SHARED = Path(__file__).parents[2] / "shared/robots"
shared = pytest.mark.skipif(not SHARED.is_dir(), reason="third-party descriptions are not in ../shared/robots")
NINE = {
    "so101/so101_new_calib.urdf": ("SO101", {"arms/SO101", "end_effectors/SO101Hand"}),
    "dh_robotics_ag95_description/urdf/dh_robotics_ag95.urdf": ("AG95", {"end_effectors/AG95"}),
    "xhand_right/xhand_right.urdf": ("XHand", {"end_effectors/XHand"}),
    "allegro_hand/allegro_hand_right.urdf": ("Allegro", {"end_effectors/Allegro"}),
    "shadow_hand/shadow_hand_right.urdf": ("Shadow", {"end_effectors/Shadow"}),
    "schunk_hand/schunk_svh_hand_right.urdf": ("SVH", {"end_effectors/SVH"}),
    "panda_gripper/panda_gripper_glb.urdf": ("FrankaHand", {"end_effectors/FrankaHand"}),
    "xarm7/xarm7.urdf": ("XArm7", {"arms/XArm7"}),
    "unitree_g1/g1_body29_hand14.urdf": (
        "G1",
        {"arms/G1Left", "arms/G1Right", "end_effectors/G1LeftHand", "end_effectors/G1RightHand"},
    ),
}
GRIPPER = """<robot name="lab_gripper">
  <link name="palm"><inertial><mass value="0.5"/><inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0 0 0.03"/><geometry><box size="0.06 0.12 0.06"/></geometry></collision></link>
  {finger_left}{finger_right}
</robot>"""
FINGER = """<link name="{side}_finger"><inertial><mass value="0.05"/><inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0 0 0.04"/><geometry><box size="0.02 0.01 0.08"/></geometry></collision></link>
  <joint name="{side}_slide" type="prismatic"><parent link="palm"/><child link="{side}_finger"/><origin xyz="0 {y} 0.06"/>
    <axis xyz="0 1 0"/><limit lower="{low}" upper="{high}" effort="20" velocity="0.1"/></joint>"""


def gripper(folder: Path) -> Path:
    """Two fingers on slides of their own, 9 cm apart at 0."""
    path = folder / "lab_gripper.urdf"
    left = FINGER.format(side="left", y=0.05, low=-0.045, high=0)
    right = FINGER.format(side="right", y=-0.05, low=0, high=0.045)
    path.write_text(GRIPPER.format(finger_left=left, finger_right=right))
    return path


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> EndEffectorSpec:
    """What is proposed for that gripper."""
    folder = tmp_path_factory.mktemp("gripper")
    (proposal,) = propose(str(gripper(folder)), folder)
    assert isinstance(proposal.spec, EndEffectorSpec)
    return replace(proposal.spec, folder=str(folder))


def described(path: Path) -> mujoco.MjSpec:
    return load_description(locate(str(path), path.parent)).spec


def wrong(findings) -> list[str]:
    return [finding.text for finding in findings if finding.wrong]


# -- new -----------------------------------------------------------------------------------------------------


def test_a_gripper_is_understood(known: EndEffectorSpec) -> None:
    """Fingers open wide and meet, one leads the other, pads are their inner sides, and it points out of the flange."""
    assert known.couplings["right_slide"].joint == "left_slide"
    assert known.couplings["right_slide"].scale == -1
    assert known.home == {}
    assert known.closed == {"left_slide": -0.045}
    assert {pad.body for pad in known.pads} == {"left_finger", "right_finger"}
    hand = build_embodiment(None, known)
    tips = KinematicTree(hand).forward(hand.closed)[[hand.body_id("left_finger"), hand.body_id("right_finger")]]
    assert np.abs(tips[0, 1, 3] - tips[1, 1, 3]) == pytest.approx(0.01, abs=1e-6)  # as thick as a finger
    assert (tips[:, 2, 3] > 0).all()
    assert not wrong(check_end_effector(known))


@shared
@pytest.mark.parametrize("description", NINE)
def test_each_shared_description_gives_yamls_that_pass(description: str, tmp_path: Path, capsys) -> None:
    name, expected = NINE[description]
    assert command.main(["new", str(SHARED / description), f"--name={name}", f"--output={tmp_path}"]) == 0
    printed = capsys.readouterr().out
    assert "WRONG" not in printed
    written = {path.relative_to(tmp_path).with_suffix("").as_posix(): path for path in tmp_path.glob("*/*.yaml")}
    assert set(written) == expected
    for path in written.values():
        assert command.main(["check", str(path)]) == 0
        spec = load_part(path)
        if isinstance(spec, EndEffectorSpec):
            # Fingers lie ahead of the flange.
            hand = build_embodiment(None, spec)
            tips = KinematicTree(hand).forward(hand.home)[[hand.body_id(pad.body) for pad in spec.pads]]
            assert (tips[:, 2, 3] > 0).all()


def test_what_is_written_is_what_was_proposed(known: EndEffectorSpec, tmp_path: Path) -> None:
    (proposal,) = propose(str(gripper(tmp_path)), tmp_path)
    path = tmp_path / "LabGripper.yaml"
    path.write_text(yaml_of(proposal))
    assert "UNSURE: nothing says that its two fingers move together" in path.read_text()
    assert replace(load_spec(EndEffectorSpec, path), folder="") == replace(proposal.spec, folder="")


@shared
def test_an_arm_and_its_gripper_in_one_file_come_apart_and_together_again(tmp_path: Path) -> None:
    """The pair is the robot of the file, and the arm carries another gripper without the jaws."""
    urdf = str(SHARED / "so101/so101_new_calib.urdf")
    arm, jaw = (proposal.spec for proposal in propose(urdf, tmp_path, name="SO101"))
    assert isinstance(arm, ArmSpec)
    assert isinstance(jaw, EndEffectorSpec)
    both = build_embodiment(arm, jaw)
    original = mujoco.MjModel.from_xml_path(str(SHARED / "so101/so101_new_calib.xml"))
    rng = np.random.default_rng(0)
    tree, data = KinematicTree(both), mujoco.MjData(original)
    for _ in range(5):
        q = rng.uniform(both.lower, both.upper)
        data.qpos[:] = [q[both.joint_names.index(original.joint(i).name)] for i in range(original.njnt)]
        mujoco.mj_kinematics(original, data)
        T = tree.forward(q)
        ours = T[both.body_id("moving_jaw_so101_v1_link")]
        theirs = data.body("moving_jaw_so101_v1")
        np.testing.assert_allclose(ours[:3, 3], theirs.xpos - data.body("base").xpos, atol=2e-5)
    alone = build_embodiment(arm, load_end_effector("PandaGripper"))
    flange = alone.body_id("gripper_link")
    assert not (alone.model.geom_bodyid == flange).any()
    assert "gripper" not in alone.joint_names
    assert "wrist_roll" in alone.joint_names


@shared
def test_of_a_file_with_both_only_what_is_asked_for_is_proposed(tmp_path: Path) -> None:
    urdf = str(SHARED / "so101/so101_new_calib.urdf")
    (arm,) = propose(urdf, tmp_path, kind="arm")
    assert isinstance(arm.spec, ArmSpec)
    assert arm.spec.until_body == "gripper_link"
    (jaw,) = propose(urdf, tmp_path, kind="end_effector")
    assert jaw.embodiment.joint_names == ("gripper",)


@shared
def test_legs_are_listed_as_left_out_and_arms_are_not_chosen_among(tmp_path: Path) -> None:
    parts, left_out = find_parts(described(SHARED / "unitree_g1/g1_body29_hand14.urdf"))
    assert len(parts) == 4
    assert {"left_ankle_roll_link", "right_ankle_roll_link"} <= {*left_out}
    with pytest.raises(CEIError, match=r"several chains of joints, to .*'right_wrist', .*--root"):
        propose("package://robosuite/models/assets/robots/baxter/robot.xml", tmp_path, kind="arm")


def test_a_file_that_is_there_is_found_before_the_work(tmp_path: Path) -> None:
    seen: list[tuple[str, str]] = []

    def refuse(named: list[tuple[str, str]]) -> None:
        seen.extend(named)
        raise CEIError("it is there")

    with pytest.raises(CEIError, match="it is there"):
        propose(str(gripper(tmp_path)), tmp_path, named=refuse)
    assert seen == [("end_effector", "LabGripper")]


def test_a_xacro_takes_its_arguments(tmp_path: Path, capsys) -> None:
    text = gripper(tmp_path).read_text()
    xacro = text.replace("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ').replace(
        '<link name="palm">', '<xacro:arg name="wide"/><link name="palm">'
    )
    path = tmp_path / "lab.urdf.xacro"
    path.write_text(xacro.replace('size="0.06 0.12 0.06"', 'size="0.06 $(arg wide) 0.06"'))
    out = f"--output={tmp_path / 'own'}"
    assert command.main(["new", str(path), out]) == 1
    assert "wide" in capsys.readouterr().err
    assert command.main(["new", str(path), out, "--xacro_args=[wide=0.1]"]) == 1
    assert "should read name:=value" in capsys.readouterr().err
    assert command.main(["new", str(path), out, "--xacro_args=[wide:=0.12]"]) == 0
    assert load_part(tmp_path / "own/end_effectors/Lab.yaml").xacro_args == {"wide": "0.12"}


def test_new_says_what_it_cannot_do(tmp_path: Path, capsys) -> None:
    path = gripper(tmp_path)
    out = f"--output={tmp_path / 'own'}"
    still = tmp_path / "still.urdf"
    still.write_text('<robot name="x"><link name="a"/></robot>')
    for args, said in {
        ("new", str(path), "--as=leg", out): "Valid: arm, end_effector, both",
        ("new", str(path), "--as=both", out): "end-effector without an arm",
        ("new", str(path), "--root=pam", out): "Did you mean 'palm'",
        ("new", str(path), "--name=Lab-Gripper", out): "no hyphen",
        ("new", str(still), out): "nothing of it moves",
        ("new", str(tmp_path / "none.urdf"), out): "no robot description at",
    }.items():
        assert command.main(list(args)) in (1, 2)
        error = capsys.readouterr().err
        assert said in error
        assert error.count("\n") == 1
    assert not (tmp_path / "own").exists()
    assert command.main(["new", str(path), out]) == 0
    written = tmp_path / "own/end_effectors/LabGripper.yaml"
    before = written.read_bytes()
    assert command.main(["new", str(path), out]) == 1
    assert "--overwrite" in capsys.readouterr().err
    assert written.read_bytes() == before
    assert command.main(["new", str(path), out, "--overwrite"]) == 0
    assert command.main(["old"]) == 2
    assert "Valid: new, check, show, list" in capsys.readouterr().err


# -- check ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda s: replace(s, home=s.closed, closed={"left_slide": 0.0}), "swapped?"),
        (lambda s: replace(s, closed={}), "`closed` is where `home` is"),
        (lambda s: replace(s, mount_quat_wxyz=[0.0, 1.0, 0.0, 0.0]), "behind the flange"),
        (lambda s: replace(s, pads=[Pad("left_finger", palmar=[1, 0, 0]), Pad("right_finger", palmar=[1, 0, 0])]), "no pads face"),
        (
            lambda s: replace(s, pads=[*s.pads, Pad("palm", palmar=[1, 0, 0])]),
            "'palm' opposes nothing",
        ),
        (lambda s: replace(s, pads=[Pad("thumb")]), "'thumb'"),
        (lambda s: replace(s, description="none.urdf"), "none.urdf"),
    ],
)  # fmt: skip
def test_check_says_in_plain_words_what_is_wrong(known: EndEffectorSpec, change, said: str) -> None:
    assert any(said in text for text in wrong(check_end_effector(change(known))))


def test_check_knows_scale_and_degrees(tmp_path: Path) -> None:
    path = gripper(tmp_path)
    (proposal,) = propose(str(path), tmp_path)
    text = path.read_text()
    path.write_text(text.replace("0.06 0.12 0.06", "0.6 1.2 0.6"))
    assert any("another unit" in text for text in wrong(check_end_effector(proposal.spec, tmp_path)))
    hinged = (
        text.replace("prismatic", "revolute").replace('upper="0"', 'upper="90"').replace('upper="0.045"', 'upper="90"')
    )
    path.write_text(hinged)
    assert any("degrees" in text for text in wrong(check_end_effector(proposal.spec, tmp_path)))


def test_a_flange_that_points_backwards_is_told_with_what_would_be_right() -> None:
    arm = load_arm("UR5e")
    assert not wrong(check_arm(arm))
    (text,) = wrong(check_arm(replace(arm, mount_quat_wxyz=[0.0, 1.0, 0.0, 0.0])))
    assert "points backwards" in text
    assert "mount_quat_wxyz" in text


def test_links_in_each_other_at_home_are_told() -> None:
    arm = load_arm("UR5e")
    body = build_embodiment(arm, None)
    poses = np.random.default_rng(0).uniform(body.lower, body.upper, size=(50, len(body.lower)))
    deepest = max(poses, key=Overlaps(body).deepest_m)
    home = dict(zip(body.joint_names, deepest.tolist(), strict=True))
    assert any("deep in" in text for text in wrong(check_arm(replace(arm, home=home))))


# -- what the catalogue has ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["Sawyer", "Jaco", "SpotArm", "TiagoRight", "BaxterLeft", "GR1RightArm"])
def test_arms_of_the_wheel_are_right(name: str) -> None:
    assert not wrong(check_arm(load_arm(name)))


@pytest.mark.parametrize("name", ["Robotiq140", "RethinkGripper", "BDGripper", "InspireLeft"])
def test_end_effectors_of_the_wheel_are_right(name: str) -> None:
    assert not wrong(check_end_effector(load_end_effector(name)))


@shared
@pytest.mark.parametrize(
    "name", ["AG95", "XHand", "AllegroHand", "ShadowHand", "SVHHand", "FrankaHand", "SO101Gripper"]
)
def test_end_effectors_of_others_are_right(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CEI_GYM_PACKAGE_PATH", str(SHARED))
    assert not wrong(check_end_effector(load_end_effector(name)))


def test_what_is_tied_to_a_follower_follows_along() -> None:
    """Robotiq's right finger follows its knuckle by a tendon, and the YAML has the knuckle follow the left one."""
    hand = build_embodiment(None, load_end_effector("Robotiq140"))
    assert [hand.joint_names[q] for q in hand.coupled.independent] == ["finger_joint"]


def test_motors_do_not_narrow_a_range() -> None:
    """Spot's motors have a servo's numbers among their defaults, and are none."""
    arm = build_embodiment(load_arm("SpotArm"), None)
    assert arm.upper[arm.joint_names.index("arm_el0")] == pytest.approx(3.14, abs=0.01)


def test_list_says_what_each_is_good_for(tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CEI_GYM_PACKAGE_PATH", raising=False)
    assert command.main(["list", f"--json={tmp_path / 'list.json'}"]) == 0
    printed = capsys.readouterr().out
    assert "five joints: of poses in six dimensions most are out of its reach" in printed
    assert "dh_robotics_ag95_description" in printed  # not here, and what is needed
    assert "parallel gripper; the paper's source" in printed
    with pytest.raises(CEIError, match="Did you mean 'AG95'"):
        load_end_effector("AG-95")
