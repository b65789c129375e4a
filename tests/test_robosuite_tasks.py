"""robosuite's own tasks for any robot: held against robosuite, and files that robosuite made convert into the task they came from."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import mujoco
import numpy as np
import pytest
import robosuite
import robosuite_files
from conversions import records
from rollouts import make
from scipy.spatial.transform import Rotation

from cei_converters import convert, record, replay
from cei_converters.simulation.environment import open_environment
from cei_converters.simulation.rollout import record_episode
from cei_converters.sources.formats import open_source
from cei_converters.sources.source import Source
from cei_envs.tasks.of_robosuite import OfRobosuite
from cei_envs.tasks.stored_model import StoredModel
from cei_gym.errors import CEIError

PANDA = "Panda-PandaGripper"
TASKS = ("Lift", "Stack", "PickPlaceCan", "NutAssemblySquare", "Door")
FREE = {"Lift": ["cube"], "Stack": ["cubeA", "cubeB"], "PickPlaceCan": ["Can"], "NutAssemblySquare": ["SquareNut"]}
BARE: Any = {"robots": "Panda", "has_renderer": False, "has_offscreen_renderer": False, "use_camera_obs": False}
SEED = 7


@pytest.fixture(scope="module", params=TASKS)
def env(request: pytest.FixtureRequest) -> Iterator[OfRobosuite]:
    made = make(request.param, PANDA, clouds=False)
    yield made
    made.close()


@pytest.fixture(scope="module")
def theirs(env: OfRobosuite) -> Iterator[Any]:
    """robosuite's environment of the same task."""
    made = robosuite.make(env.task, **BARE)
    yield made
    made.close()


@pytest.fixture(scope="module")
def lift(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two demonstrations of robosuite's Lift, by its own controller."""
    path = tmp_path_factory.mktemp("robosuite") / "lift.hdf5"
    assert robosuite_files.write(path, "Lift", range(SEED, SEED + 2)) == [True, True]
    return path


def opened(path: Path, **others: Any) -> Source:
    return open_source("lab/robosuite", path, embodiment=PANDA, **others)


# -- against robosuite -----------------------------------------------------------------------------------------


def test_starts_are_drawn_where_robosuite_draws_them(env: OfRobosuite, theirs: Any) -> None:
    """Along x and y, and what else is drawn: the same bounds, to a twentieth of their width."""
    rng, columns = np.random.default_rng(0), [i for i, n in enumerate(env.state_names) if n.endswith((".x_m", ".y_m"))]
    ours = np.array([env.sample_state(rng)[columns] for _ in range(400)])
    found = []
    for _ in range(400):
        placed = theirs.placement_initializer.sample()
        names = FREE.get(env.task, ["Door"])
        found.append([x for name in names for x in placed[name][0][:2]])
    found = np.array(found)
    width = np.ptp(found, axis=0)
    np.testing.assert_allclose(ours.min(axis=0), found.min(axis=0), atol=0.05 * width.max())
    np.testing.assert_allclose(ours.max(axis=0), found.max(axis=0), atol=0.05 * width.max())


def test_it_is_done_where_robosuite_says_so(env: OfRobosuite, theirs: Any) -> None:
    """Of objects at random around where they belong, with the robot far away."""
    rng, verdicts = np.random.default_rng(1), []
    env.reset(seed=SEED)
    for _ in range(300):
        if env.task == "Door":
            opening = rng.uniform(0, 0.4)
            env.apply_state(np.array([-0.12, -0.35, -1.6, opening, 0.0]))
            theirs.sim.data.set_joint_qpos("Door_hinge", opening)
        else:
            at = {
                "Lift": lambda: [0, 0, rng.uniform(0.8, 0.9)],
                "Stack": lambda: [*rng.uniform(-0.05, 0.05, 2), rng.uniform(0.82, 0.9)],
                "PickPlaceCan": lambda: [*rng.uniform([0.05, 0.2], [0.35, 0.6]), rng.uniform(0.78, 0.92)],
                "NutAssemblySquare": lambda: [*rng.uniform([0.18, 0.05], [0.28, 0.15]), rng.uniform(0.82, 0.92)],
            }[env.task]()
            pose = np.array([*at, 1, 0, 0, 0])
            others = {"cubeB": np.array([0, 0, 0.825, 1.0, 0, 0, 0])} if env.task == "Stack" else {}
            for name, place in ({FREE[env.task][0]: pose} | others).items():
                env.simulation.data.joint(f"{name}_joint0").qpos = place
                theirs.sim.data.set_joint_qpos(f"{name}_joint0", place)
        mujoco.mj_forward(env.model, env.simulation.data)
        theirs.sim.forward()
        verdicts.append((env.is_done(), robosuite_files.is_done(theirs)))
    ours, their = np.array(verdicts).T
    np.testing.assert_array_equal(ours, their)
    assert 0.02 < ours.mean() < 0.98


def test_the_robot_stands_where_robosuites_does(env: OfRobosuite, theirs: Any) -> None:
    np.testing.assert_allclose(env.scene.T_world_base[:3, 3], theirs.sim.data.get_body_xpos("robot0_base"), atol=1e-6)
    assert env.surface_z_m <= env.scene.workspace_world[0, 2] < env.surface_z_m + 0.01


def test_a_start_is_restored_by_any_robot(env: OfRobosuite) -> None:
    start = env.reset(seed=SEED)[0]["environment_state"]
    for robot in (PANDA, "UR5e-FourierRight"):
        other = make(env.task, robot, clouds=False)
        seen = other.reset(seed=SEED + 1, options={"environment_state": start})[0]["environment_state"]
        np.testing.assert_array_equal(seen, start)
        other.close()


def test_the_demonstrator_does_it(env: OfRobosuite) -> None:
    demonstration, info, variation = record_episode(env, SEED, 0)
    assert info["is_success"], info
    assert variation["speed"] > 0
    blind = env.expert(SEED, variation=0).plan(
        *(env.reset(seed=SEED + 1)[0][k] for k in ("agent_pos", "environment_state"))
    )
    assert len(blind) != len(demonstration)


def test_nothing_but_the_can_is_in_its_bins() -> None:
    env = make("PickPlaceCan", PANDA, clouds=False)
    free = [
        env.model.joint(j).name for j in range(env.model.njnt) if env.model.joint(j).type == mujoco.mjtJoint.mjJNT_FREE
    ]
    assert free == ["Can_joint0"]
    assert not any("Visual" in env.model.body(b).name for b in range(env.model.nbody))
    env.close()


def test_an_unknown_task_of_robosuites_is_told_of() -> None:
    with pytest.raises(CEIError, match=r"unknown task 'ToolHang'.*NutAssemblySquare"):
        open_environment("CEI-ToolHang-Panda-PandaGripper")


# -- stored models ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("task", TASKS)
def test_a_stored_model_says_what_mujocos_does(task: str) -> None:
    theirs = robosuite.make(task, **BARE)
    stored = StoredModel(theirs.sim.model.get_xml())
    model, state = robosuite_files.model_of(theirs), theirs.sim.get_state().flatten()
    assert stored.width == len(state)
    for j in range(model.njnt):
        name, at = model.joint(j).name, 1 + model.jnt_qposadr[j]
        found = stored.joint(name, state[None])[0]
        np.testing.assert_array_equal(found, state[at : at + len(found)])
    for cube in FREE[task] if task in ("Lift", "Stack") else ():
        *half, mass = stored.box(f"{cube}_g0")
        np.testing.assert_allclose(half, model.geom(f"{cube}_g0").size, atol=1e-6)
        assert mass == pytest.approx(model.body(f"{cube}_main").mass[0], rel=1e-4)
    theirs.close()


@pytest.mark.parametrize(
    ("mjcf", "says"),
    [
        ("<mujoco>", "the stored model cannot be read: not well-formed XML"),
        ("<mujoco><worldbody><body><joint type='screw'/></body></worldbody></mujoco>", "a joint of type 'screw'"),
        ("<mujoco><worldbody/></mujoco>", "no body table fixed to the world"),
        ("<mujoco><worldbody><body name='table' pos='0 x'/></worldbody></mujoco>", "pos='0 x'; it should be 3 numbers"),
        (
            "<mujoco><worldbody><body name='table' pos='0 0 0.9'/></worldbody></mujoco>",
            "table is at 0, 0, 0.9 m in the",
        ),
        ("<mujoco><worldbody><body name='table' pos='0 0 .775'/></worldbody></mujoco>", "no body robot0_base"),
        (
            "<mujoco><worldbody><body name='table' pos='0 0 .775'/><body name='robot0_base'/></worldbody></mujoco>",
            r"states have shape \(3, 5\), but the stored model's have 1 columns",
        ),
    ],
)
def test_what_is_wrong_with_a_stored_model_is_said(mjcf: str, says: str) -> None:
    from cei_envs.tasks.lift import LiftEnv

    with pytest.raises(CEIError, match=says):
        LiftEnv.restore(mjcf, np.zeros((3, 5)))


# -- files -----------------------------------------------------------------------------------------------------


def test_a_file_says_which_task_it_is_of_and_where_all_of_it_is(lift: Path) -> None:
    source = opened(lift)
    assert source.environment.id == f"CEI-Lift-{PANDA}"
    np.testing.assert_array_equal(source.scene.T_world_base[:3, 3], [-0.56, 0, 0.912])
    assert (source.scene.table_z_m, source.table_from) == (0.8, f"CEI-Lift-{PANDA}")
    assert source.dropped["object"] == "as states say it" and "states" not in source.dropped
    for index, demonstration in enumerate(source):
        with h5py.File(lift) as file:
            seen = file[f"data/demo_{index}/obs/object"][:]
        state = demonstration.environment_state
        assert state is not None and demonstration.environment_state_names[7:] == (
            *("cube.half_x_m", "cube.half_y_m", "cube.half_z_m", "cube.mass_kg"),
        )
        # As robosuite observed it, which is a physics step (2 ms) before it stored the state.
        np.testing.assert_allclose(state[:, :3], seen[:, :3], atol=2e-3)
        turn = Rotation.from_quat(state[:, 3:7], scalar_first=True) * Rotation.from_quat(seen[:, 3:7]).inv()
        assert turn.magnitude().max() < 0.02


@pytest.mark.parametrize("task", ["PickPlaceCan", "NutAssemblySquare", "Door", "Stack"])
def test_an_episode_of_each_task_is_restored(task: str) -> None:
    """What robosuite stores of a moment, restored here, is where robosuite observed it; of all bodies of the task's objects."""
    theirs = robosuite.make(task, **BARE)
    theirs.reset()
    mjcf = theirs.sim.model.get_xml()  # MuJoCo's of the last model that was made, whosever it is
    for _ in range(5):
        theirs.step(np.zeros(7))
    env = make(task, "UR5e-FourierRight", clouds=False)
    restored = type(env).restore(mjcf, theirs.sim.get_state().flatten()[None])
    np.testing.assert_allclose(restored.T_world_base[:3, 3], theirs.sim.data.get_body_xpos("robot0_base"), atol=1e-6)
    env.reset(options={"environment_state": restored.environment_state[0]})
    theirs.sim.forward()
    bodies = ["Door_door", "Door_latch"] if task == "Door" else [f"{name}_main" for name in FREE[task]]
    for body in bodies:
        np.testing.assert_allclose(env.simulation.data.body(body).xpos, theirs.sim.data.get_body_xpos(body), atol=1e-5)
    env.close()
    theirs.close()


def spoilt(lift: Path, folder: Path, change: Any) -> Path:
    """A copy of the file that is otherwise."""
    path = folder / "other.hdf5"
    path.write_bytes(lift.read_bytes())
    with h5py.File(path, "a") as file:
        change(file["data"])
    return path


def _renamed(data: Any) -> None:
    data.attrs["env_args"] = json.dumps(json.loads(data.attrs["env_args"]) | {"env_name": "Wipe"})


def _without_model(data: Any) -> None:
    del data["demo_0"].attrs["model_file"]


def _higher_table(data: Any) -> None:
    xml = data["demo_0"].attrs["model_file"]
    data["demo_0"].attrs["model_file"] = xml.replace(
        '<body name="table" pos="0 0 0.775">', '<body name="table" pos="0 0 0.875">'
    )


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (_renamed, "the simulator's, the source robot in it"),
        (_without_model, "without model_file nobody knows what is where"),
        (_higher_table, "table is at 0, 0, 0.875 m in the stored model, but at 0.0, 0.0, 0.775 m in Lift"),
    ],
)
def test_a_file_of_another_task_or_scene_names_no_environment(
    change: Any, says: str, lift: Path, tmp_path: Path
) -> None:
    source = opened(spoilt(lift, tmp_path, change))
    assert source.environment.id is None and source.table_from == ""
    assert says in source.dropped["states"]
    state = source.read(0).environment_state_names
    assert state[0] == "object.0"


def test_a_base_that_is_said_to_be_elsewhere_is_told_of(lift: Path) -> None:
    source = opened(lift, T_world_base=np.eye(4))
    assert source.environment.id is None
    assert source.dropped["states"] == "as the simulator has the robot at -0.56, 0, 0.912 m, not where it is said to be"
    there = np.eye(4)
    there[:3, 3] = -0.56, 0, 0.912
    assert opened(lift, T_world_base=there).environment.id == f"CEI-Lift-{PANDA}"


def _no_states(data: Any) -> None:
    del data["demo_1/states"]


def _short_states(data: Any) -> None:
    rows = data["demo_1/states"][:-1]
    del data["demo_1/states"]
    data["demo_1/states"] = rows


def _moved_base(data: Any) -> None:
    xml = data["demo_1"].attrs["model_file"]
    data["demo_1"].attrs["model_file"] = xml.replace('pos="-0.56 0 0.912"', 'pos="-0.46 0 0.912"')


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (_no_states, "demo_1 lacks states, which the first episode has; leave it out with --episodes"),
        (_short_states, r"demo_1 has \d+ rows of states but \d+ frames"),
        (_moved_base, "demo_1: the robot stands elsewhere than in demo_0"),
    ],
)
def test_an_episode_that_cannot_be_restored_is_refused(change: Any, says: str, lift: Path, tmp_path: Path) -> None:
    source = opened(spoilt(lift, tmp_path, change))
    source.read(0)
    with pytest.raises(CEIError, match=says):
        source.read(1)


def test_what_robosuite_recorded_replays_in_its_task_with_another_robot(
    lift: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    """One command each."""
    out = tmp_path / "out"
    args = ["--dataset.repo_id=lab/lift", f"--dataset.root={lift}", f"--source={PANDA}", "--target=UR5e-FourierRight"]
    assert convert.main([*args, "--new_repo_id=me/lift", f"--new_root={out}"]) == 0
    assert "warning" not in capsys.readouterr().err
    metadata = json.loads((out / "meta/cei.json").read_text())
    assert metadata["environment"]["id"] == "CEI-Lift-UR5e-FourierRight"
    assert (
        replay.main(
            [
                "--dataset.repo_id=me/lift",
                f"--dataset.root={out}",
                "--video_episodes=0",
                f"--json={tmp_path / 'r.json'}",
            ]
        )
        == 0
    )
    assert json.loads((tmp_path / "r.json").read_text())["successes"] == 2


def test_an_episode_that_no_expert_can_reach_costs_no_other(tmp_path: Path, complaint: Callable[[], str]) -> None:
    """Seed 5 has the nut where the hand cannot be turned as its handle lies; seed 6 does not."""
    root = tmp_path / "nuts"
    options = ["--env=CEI-NutAssemblySquare-Panda-PandaGripper", "--repo_id=me/nuts", f"--root={root}"]
    assert record.main([*options, "--episodes=2", "--seed=5"]) == 1
    assert "the expert failed 1 of 2 times; left out: seed 5 (Panda-PandaGripper: the expert's waypoint " in complaint()
    assert [each["seed"] for each in records(root)] == [6]
