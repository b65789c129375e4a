"""Environments of robots that robosuite does not have: composed from descriptions, held against the models that solvers believe."""

import json
import shutil
from pathlib import Path
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
import pytest
import robosuite
from gymnasium.utils.env_checker import check_env
from PIL import Image

import cei_gym
from cei_converters import convert, record, replay
from cei_converters.simulation.environment import open_environment
from cei_envs.composing import joint_names, scene_without_robot
from cei_envs.environment import CEIEnv
from cei_envs.simulate import mountable
from cei_envs.simulation import CONTROL_HZ
from cei_gym.embodiment import Embodiment, load_embodiment
from cei_gym.errors import CEIError
from lerobot_env_cei.configuration import CEIEnvConfig

SPECIFICATIONS = Path(cei_gym.__file__).parent / "embodiment/specifications"
SHARED = Path(__file__).parents[2] / "shared/robots"
ELSEWHERE = [[0.0, -1.0, 0.0, -0.4], [1.0, 0.0, 0.0, 0.1], [0.0, 0.0, 1.0, 0.85], [0.0, 0.0, 0.0, 1.0]]
TASKS = ("OpenDrawer", "PickCube", "StackCube")
OWN = ("LabArm-PandaGripper", "LabArm-LabHand")
"""An arm with a gripper of robosuite's, and one with a hand whose fingers have followers."""


def own_part(folder: Path, kind: str, known: str, name: str) -> None:
    """A part that ships under another name, and as one that the simulator has never heard of."""
    lines = (SPECIFICATIONS / kind / f"{known}.yaml").read_text().splitlines()
    kept = [line for line in lines if not line.startswith(("simulator_name", "name:"))]
    (folder / kind).mkdir(parents=True, exist_ok=True)
    (folder / kind / f"{name}.yaml").write_text("\n".join([f"name: {name}", *kept]) + "\n")


@pytest.fixture(scope="module", autouse=True)
def own(tmp_path_factory: pytest.TempPathFactory):
    """Robots of one's own: a Panda, and an Inspire hand, which the simulator is not told of."""
    folder = tmp_path_factory.mktemp("robots")
    own_part(folder, "arms", "Panda", "LabArm")
    own_part(folder, "end_effectors", "Inspire", "LabHand")
    with pytest.MonkeyPatch.context() as patch:
        known = {*gym.registry}
        patch.setenv("CEI_GYM_EMBODIMENTS", str(folder))
        cei_gym.register_environments()
        yield folder
    for name in {*gym.registry} - known:
        del gym.registry[name]
    load_embodiment.cache_clear()


def opened(name: str, task: str = "PickCube", **options) -> CEIEnv:
    env = open_environment(f"CEI-{task}-{name}", clouds=False, **options).unwrapped
    assert isinstance(env, CEIEnv)
    return env


def test_a_step_says_what_the_simulations_clock_says() -> None:
    env = opened(OWN[1])
    env.reset(seed=0)
    target, took = env.embodiment.home.astype(np.float32), []
    for shift in (0.1, 0.0, 0.0, 0.0):
        target[: env.embodiment.n_arm] += shift
        before = env.simulation.data.time
        took.append(env.step(target)[4]["step_time_s"])
        assert took[-1] == pytest.approx(env.simulation.data.time - before)
    assert took[0] > took[-1] == 1 / CONTROL_HZ
    env.close()


@pytest.fixture(scope="module", params=OWN)
def env(request: pytest.FixtureRequest):
    env = opened(request.param, T_world_base=ELSEWHERE)
    yield env
    env.close()


def random_qpos(body: Embodiment, rng: np.random.Generator) -> np.ndarray:
    lower, upper = body.independent_limits
    return body.coupled.expand(rng.uniform(lower, upper))


def test_links_are_where_the_solvers_have_them(env: CEIEnv) -> None:
    body, simulation, rng = env.embodiment, env.simulation, np.random.default_rng(0)
    np.testing.assert_allclose(simulation.T_world_base, ELSEWHERE)
    for _ in range(5):
        qpos = random_qpos(body, rng)
        simulation.reset(qpos)
        simulation.forward()
        data = mujoco.MjData(body.model)
        data.qpos[:] = qpos
        mujoco.mj_kinematics(body.model, data)
        for link in range(1, body.model.nbody):
            expected = simulation.T_world_base @ [*data.xpos[link], 1.0]
            found = simulation.data.body(f"robot/{body.model.body(link).name}").xpos
            np.testing.assert_allclose(found, expected[:3], atol=1e-9)


def test_masses_and_shapes_are_the_descriptions(env: CEIEnv) -> None:
    body, model = env.embodiment.model, env.simulation.model
    for link in range(1, body.nbody):
        ours = model.body(f"robot/{body.body(link).name}")
        assert ours.mass[0] == pytest.approx(body.body_mass[link])
        np.testing.assert_allclose(ours.inertia, body.body_inertia[link])
        assert ours.geomnum[0] == body.body_geomnum[link]


def test_it_stays_where_it_is_and_goes_where_it_is_told(env: CEIEnv) -> None:
    body, simulation = env.embodiment, env.simulation
    simulation.reset(body.home)
    simulation.forward()
    for _ in range(2 * CONTROL_HZ):
        simulation.tick(body.home)
    np.testing.assert_allclose(simulation.qpos, body.home, atol=1e-3)
    lower, upper = body.independent_limits
    u = body.coupled.reduce(body.home)
    for joint in range(len(u)):
        goal = u.copy()
        goal[joint] += 0.2 * (upper - lower)[joint] * (1 if u[joint] < (lower + upper)[joint] / 2 else -1)
        target = body.coupled.expand(goal)
        simulation.reset(body.home)
        simulation.forward()
        for _ in range(2 * CONTROL_HZ):
            simulation.tick(target)
        # Followers too, which nothing drives: equality constraints are springs, and stiff ones.
        np.testing.assert_allclose(simulation.qpos, target, atol=0.01)


def test_what_nothing_drives_is_ignored_in_an_action(env: CEIEnv) -> None:
    body, simulation = env.embodiment, env.simulation
    followers = np.setdiff1d(np.arange(len(body.home)), body.coupled.independent)
    ends = []
    for beside in (0.0, 0.3):
        simulation.reset(body.home)
        simulation.forward()
        target = body.home.copy()
        target[followers] += beside
        for _ in range(5):
            simulation.tick(target)
        ends.append(simulation.qpos)
    np.testing.assert_array_equal(*ends)


def test_it_touches_objects_and_not_itself(env: CEIEnv) -> None:
    simulation, rng = env.simulation, np.random.default_rng(1)
    env.reset(seed=0)
    for _ in range(20):
        simulation.data.qpos[[simulation.model.joint(n).qposadr[0] for n in joint_names(env.embodiment)]] = random_qpos(
            env.embodiment, rng
        )
        mujoco.mj_forward(simulation.model, simulation.data)
        assert not simulation.touching(simulation.robot_geoms, simulation.robot_geoms)
    solid = simulation.robot_geoms[simulation.model.geom_contype[simulation.robot_geoms] > 0]
    assert len(solid)
    cube = env.simulation.data.joint("cube_joint0")
    cube.qpos[:3] = simulation.data.geom_xpos[solid[-1]]
    mujoco.mj_forward(simulation.model, simulation.data)
    others = np.flatnonzero(simulation.model.geom_bodyid == simulation.model.body("cube_main").id)
    assert simulation.touching(others, simulation.robot_geoms)


def test_gains_are_of_what_a_joint_moves_and_forces_the_descriptions(own: Path) -> None:
    path = own / "arms/WeakArm.yaml"
    text = (own / "arms/LabArm.yaml").read_text().replace("LabArm", "WeakArm")
    path.write_text(text + "servo: {frequency_rad_s: 30, damping_ratio: 0.7, armature_kg_m2: 0.2, torque_n_m: 40}\n")
    cei_gym.register_environments()
    env = opened("WeakArm-PandaGripper")
    model, body = env.simulation.model, env.embodiment
    data = mujoco.MjData(body.model)
    data.qpos[:] = body.home
    mujoco.mj_forward(body.model, data)
    inertia = np.zeros((body.model.nv, body.model.nv))
    mujoco.mj_fullM(body.model, inertia, data.qM)
    for q in range(body.n_arm):
        servo = model.actuator(f"robot/{body.joint_names[q]}")
        moved = inertia[q, q] + 0.2
        assert servo.gainprm[0] == pytest.approx(30**2 * moved)
        assert servo.biasprm[1:3].tolist() == pytest.approx([-(30**2) * moved, -2 * 0.7 * 30 * moved])
        np.testing.assert_allclose(servo.forcerange, [-40, 40])
    env.close()
    path.write_text(text + "servo: {frequency_rad_s: 0}\n")
    load_embodiment.cache_clear()
    with pytest.raises(
        CEIError, match=r"^WeakArm.yaml: not a valid ArmSpec: `frequency_rad_s` should be above 0, not 0\.0"
    ):
        load_embodiment("WeakArm-PandaGripper")
    path.unlink()


def closed_fist(env: CEIEnv) -> list[tuple[str, str]]:
    """Links of the robot that touch each other when its hand closes to its limits."""
    simulation, body = env.simulation, env.embodiment
    target = np.where(np.arange(len(body.home)) < body.n_arm, body.home, body.upper)
    simulation.reset(body.home)
    simulation.forward()
    assert not simulation.touching(simulation.robot_geoms, simulation.robot_geoms)
    found: set[tuple[str, str]] = set()
    for _ in range(3 * CONTROL_HZ):
        simulation.tick(target)
        for pair in simulation.data.contact.geom:
            if np.isin(pair, simulation.robot_geoms).all():
                links = (simulation.model.body(simulation.model.geom_bodyid[geom]).name for geom in pair)
                found.add(tuple(sorted(name.removeprefix("robot/ee/") for name in links)))
    return sorted(found)


@pytest.mark.parametrize("rule", ["none", "fingers", "all"])
def test_links_touch_each_other_as_the_yaml_says(own: Path, rule: str) -> None:
    path = own / "end_effectors/FistHand.yaml"
    text = (own / "end_effectors/LabHand.yaml").read_text().replace("LabHand", "FistHand")
    path.write_text(f"{text}self_contact: {rule}\n")
    cei_gym.register_environments()
    load_embodiment.cache_clear()
    env = opened("LabArm-FistHand")
    touching = closed_fist(env)
    (said,) = (each.says for each in env.physics.rules if (each.part, each.kind) == ("FistHand", "self-contact"))
    env.close()
    path.unlink()
    assert bool(touching) == (rule != "none") == ("pairs of shapes" in said)
    if rule == "fingers":
        fingers = ("thumb", "index", "middle", "ring", "pinky")
        for pair in touching:
            one, other = (next(finger for finger in fingers if finger in link) for link in pair)
            assert one != other


def test_a_rule_of_self_contact_is_one_that_there_is(own: Path) -> None:
    path = own / "arms/FistArm.yaml"
    text = (own / "arms/LabArm.yaml").read_text().replace("LabArm", "FistArm")
    path.write_text(f"{text}self_contact: fingers\n")
    with pytest.raises(CEIError, match=r"unknown self_contact of FistArm 'fingers'\. Valid: none, all\.$"):
        load_embodiment("FistArm-LabHand")
    path.unlink()


def test_what_is_by_rule_is_said(env: CEIEnv) -> None:
    model, body, physics = env.simulation.model, env.embodiment, env.physics
    assert {rule.kind for rule in physics.rules} >= {"base", "servos", "rotors", "efforts", "self-contact", "weight"}
    assert len(physics.joints) == len(body.coupled.independent)
    for row in physics.joints:
        q = body.joint_names.index(row["joint"])
        joint = joint_names(body)[q]
        servo = model.actuator(joint)
        assert servo.gainprm[0] == pytest.approx(row["kp"], rel=1e-5)
        assert -servo.biasprm[2] == pytest.approx(row["kv"], rel=1e-5)
        assert model.joint(joint).armature[0] == pytest.approx(row["armature"])
        assert servo.forcerange[1] == pytest.approx(row["limit"])
        declared = bool(body.model.jnt_actfrclimited[q] and body.model.jnt_actfrcrange[q, 1] > 0)
        assert (row["limit_from"] == "description") == declared
    assert not {rule.kind for rule in physics.rules} & {"absolute_joint_control", "no_self_contact"}
    json.dumps(physics.record())


@pytest.mark.parametrize("task", TASKS)
def test_every_task_has_it(task: str) -> None:
    env = gym.make(f"CEI-{task}-LabArm-LabHand", image_width=32, image_height=24, render_mode="rgb_array")
    check_env(env.unwrapped, skip_render_check=True)
    (one, _), (other, _) = (env.reset(seed=3) for _ in range(2))
    for key in one:
        np.testing.assert_array_equal(one[key], other[key])
    picture = env.render()
    assert isinstance(picture, np.ndarray) and np.ptp(np.asarray(Image.fromarray(picture))) > 50
    env.close()


def test_the_scene_is_robosuites() -> None:
    ours, theirs = opened("LabArm-LabHand"), opened("Panda-Inspire")
    for name in ("table", "cube_main"):
        np.testing.assert_allclose(
            ours.simulation.model.body(name).pos, theirs.simulation.model.body(name).pos, atol=1e-9
        )
    np.testing.assert_allclose(ours.scene.T_world_base, theirs.scene.T_world_base, atol=1e-3)
    state = [env.reset(seed=5)[0]["environment_state"] for env in (ours, theirs)]
    np.testing.assert_allclose(*state, atol=1e-6)
    for option in ("timestep", "cone", "impratio"):
        assert getattr(ours.simulation.model.opt, option) == getattr(theirs.simulation.model.opt, option)
    for env in (ours, theirs):
        env.close()


@pytest.mark.parametrize("pose", [[[1, 0], [0, 1]], "home", (2 * np.eye(4)).tolist(), np.diag([1, 1, -1, 1]).tolist()])
def test_a_place_that_is_none_is_refused(pose: object) -> None:
    with pytest.raises(CEIError) as error:
        opened("LabArm-LabHand", T_world_base=pose)
    assert str(error.value) == "T_world_base should be a 4x4 rigid transform [[R, t], [0, 0, 0, 1]]."


def test_the_wrist_feels_what_pulls_at_the_hand(env: CEIEnv) -> None:
    simulation, body = env.simulation, env.embodiment
    simulation.reset(body.home)
    simulation.forward()
    simulation.tick(body.home)
    before = simulation.wrench
    hand = next(name for name in body.model.names.decode().split("\0") if name.startswith("ee/"))
    simulation.data.body(f"robot/{hand}").xfrc_applied[:3] = 0, 0, -5.0
    for _ in range(CONTROL_HZ):
        simulation.tick(body.home)
    assert np.linalg.norm((simulation.wrench - before)[:3]) == pytest.approx(5.0, rel=0.05)
    simulation.data.body(f"robot/{hand}").xfrc_applied[:] = 0


def test_robosuite_says_where_its_robots_stand() -> None:
    with pytest.raises(CEIError, match=r"^robosuite stands Panda-Inspire at -0.56, 0, 0.912 m, upright; elsewhere"):
        opened("Panda-Inspire", T_world_base=ELSEWHERE)
    place = np.eye(4)
    place[:3, 3] = -0.56, 0, 0.912
    opened("Panda-Inspire", T_world_base=place.tolist()).close()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "CEI-PickCube-LabArm2-LabHand",
            "CEI-PickCube-LabArm2-LabHand: unknown arm 'LabArm2'. Did you mean 'LabArm'? Valid: UR5e, ",
        ),
        (
            "CEI-PickCube-LabArm-Hand",
            ", LabHand. `cei-robot new FILE` makes one of your own from a description, in a folder that CEI_GYM_EMBODIMENTS names.",
        ),
        (
            "CEI-PickCubes-LabArm-LabHand",
            "unknown task 'PickCubes'. Did you mean 'PickCube'? Valid: OpenDrawer, PickCube, StackCube, PushCube, ",
        ),
        ("CEI-PickCubes-LabArm-LabHand", "/arms/LabArm.yaml, "),
        ("CEI-PickCubes-Panda-LabHand", "The robot Panda-LabHand is known: "),
        ("CEI-PickCubes-Panda-Inspire", "The robot Panda-Inspire is known."),
        ("CEI-PickCube", "unknown environment 'CEI-PickCube'. Did you mean"),
    ],
)
def test_what_of_an_environments_name_is_unknown_is_said(name: str, message: str) -> None:
    with pytest.raises(CEIError) as error:
        open_environment(name)
    assert message in str(error.value)


def test_a_name_of_robosuites_is_not_enough_to_be_its_robot(own: Path) -> None:
    path = own / "arms/Copy.yaml"
    path.write_text((SPECIFICATIONS / "arms/Panda.yaml").read_text().replace("name: Panda", "name: Copy", 1))
    cei_gym.register_environments()
    assert mountable(load_embodiment("Copy-Inspire"))
    shutil.copytree(Path(robosuite.__file__).parent / "models/assets/robots/panda", own / "panda")
    path.write_text(
        path.read_text().replace("package://robosuite/models/assets/robots/panda/robot.xml", "../panda/robot.xml")
    )
    load_embodiment.cache_clear()
    assert not mountable(load_embodiment("Copy-Inspire"))
    path.unlink()


def test_a_folder_that_is_missing_takes_no_environments_away(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CEI_GYM_EMBODIMENTS", str(tmp_path / "none"))
    with pytest.warns(UserWarning, match="CEI_GYM_EMBODIMENTS: no such folder"):
        cei_gym.register_environments()
    assert "CEI-PickCube-IIWA-Inspire" in gym.registry


# -- commands ------------------------------------------------------------------------------------------------------


def test_a_grippers_expert_demonstrates_on_any_arm_and_is_replayed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = f"--root={tmp_path / 'own'}"
    assert record.main(["--env=CEI-PickCube-LabArm-PandaGripper", "--episodes=1", "--repo_id=me/own", root]) == 0
    options = ["--dataset.repo_id=me/own", f"--dataset.root={tmp_path / 'own'}", f"--json={tmp_path}/replay.json"]
    capsys.readouterr()
    assert replay.main([*options, "--video_episodes=0"]) == 0
    found, printed = json.loads((tmp_path / "replay.json").read_text()), capsys.readouterr().out
    assert found["successes"] == 1
    assert len(found["physics"]["joints"]) == 8
    for rule in found["physics"]["rules"]:
        assert f"  {rule['part']}, {rule['kind']}: {rule['says']} ({rule['source']})\n" in printed


def test_lerobot_evaluates_in_it_by_its_name() -> None:
    (vector,) = CEIEnvConfig(task="CEI-PickCube-LabArm-LabHand").create_envs(1)["cei"].values()
    observation, _ = vector.reset(seed=0)
    assert observation["agent_pos"].shape == (1, len(load_embodiment("LabArm-LabHand").home))
    vector.step(observation["agent_pos"])
    vector.close()


# -- from the data of one robot to physics of another -------------------------------------------------------------


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("recorded") / "pick"
    options = ["--env=CEI-PickCube-Panda-PandaGripper", "--episodes=2", "--repo_id=me/pick", f"--root={root}"]
    assert record.main(options) == 0
    return root


def converted(recorded: Path, root: Path, target: str, *options: str) -> dict:
    names = ["--dataset.repo_id=me/pick", f"--dataset.root={recorded}", f"--target={target}", "--new_repo_id=me/new"]
    assert convert.main([*names, f"--new_root={root}", f"--json={root}.json", *options]) == 0
    return json.loads(Path(f"{root}.json").read_text())


def test_converted_demonstrations_are_verified_in_it_wherever_it_stands(recorded: Path, tmp_path: Path) -> None:
    result = converted(recorded, tmp_path / "new", "LabArm-LabHand", "--verify", "--target_pose=-0.5,0.05,0.9")
    assert result["verify"]["verified_successes"] == 2
    known = json.loads((tmp_path / "new/meta/cei.json").read_text())["environment"]
    assert known["id"] == "CEI-PickCube-LabArm-LabHand"
    np.testing.assert_allclose(np.array(known["kwargs"]["T_world_base"])[:3, 3], [-0.5, 0.05, 0.9])
    options = ["--dataset.repo_id=me/new", f"--dataset.root={tmp_path / 'new'}", f"--json={tmp_path}/replay.json"]
    assert replay.main([*options, "--video_episodes=0"]) == 0
    assert json.loads((tmp_path / "replay.json").read_text())["successes"] == 2
    (vector,) = CEIEnvConfig(dataset=str(tmp_path / "new")).create_envs(1)["cei"].values()
    place = vector.get_attr("scene")[0].T_world_base
    np.testing.assert_allclose(place[:3, 3], [-0.5, 0.05, 0.9])
    observation, _ = vector.reset(seed=0)
    vector.step(observation["agent_pos"])
    vector.close()


@pytest.mark.skipif(not SHARED.is_dir(), reason="third-party descriptions are not in ../shared/robots")
def test_a_strangers_arm_and_hand_pick_the_cube(
    recorded: Path, own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robots = Path(shutil.copytree(Path(__file__).parent / "robots", tmp_path / "robots"))
    for name in ("xarm7", "allegro_hand"):
        shutil.copytree(SHARED / name, robots / name)
    monkeypatch.setenv("CEI_GYM_EMBODIMENTS", str(robots))
    result = converted(recorded, tmp_path / "new", "OwnXArm7-Allegro", "--verify")
    assert result["verify"]["plain_successes"] == 2


def test_a_scene_is_its_own_whatever_was_loaded_since() -> None:
    """MuJoCo saves as XML what was loaded last in the process: another thread's environment stood in the place of one's own."""
    env = gym.make("CEI-PickCube-Panda-PandaGripper", clouds=False)

    def make(**arguments: Any) -> Any:
        made = env.unwrapped.make_robosuite(**arguments)
        mujoco.MjModel.from_xml_string(
            "<mujoco><worldbody><body name='theirs'><geom size='1'/></body></worldbody></mujoco>"
        )
        return made

    scene, _ = scene_without_robot(make)
    names = {body.name for body in scene.bodies}
    assert "cube_main" in names and "theirs" not in names
    env.close()
