"""The family `CEI-Pick-<Thing>-<Arm>-<EndEffector>`: things as they are described, starts, success and its opposite, demonstrators."""

from collections.abc import Iterator

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from outcomes import outcome
from rollouts import make, wander
from third_party import needs_robots

from cei_converters.simulation.environment import open_environment, task_names
from cei_converters.simulation.rollout import record_episode
from cei_envs.registration import tasks
from cei_envs.tasks.cube import TABLE_Z_M
from cei_envs.tasks.pick import PickEnv
from cei_envs.tasks.placed import Placed
from cei_envs.tasks.thing import Thing
from cei_gym.errors import CEIError

PANDA = "Panda-PandaGripper"
MASSES_KG = {
    "Sphere": 0.045,
    "Cylinder": 0.230,
    "LyingCylinder": 0.230,
    "ThinBox": 0.060,
    "Plate": 0.090,
    "Mug": 0.239,
    "Hammer": 0.130,
    "Can": 0.016,
    "Lemon": 0.0027,
    "Nut": 0.0158,
}
THINGS = tuple(MASSES_KG)


@pytest.fixture(scope="module", params=THINGS)
def env(request: pytest.FixtureRequest) -> Iterator[PickEnv]:
    made = make(f"Pick-{request.param}", PANDA, clouds=False)
    yield made
    made.close()


def name(env: PickEnv) -> str:
    return env.task.removeprefix("Pick-")


def lift(env: PickEnv, height_m: float) -> None:
    """Put it higher, as it is."""
    env.simulation.data.joint(f"{env.thing.placed.name}_joint0").qpos[2] += height_m
    env.simulation.data.qvel[:] = 0.0
    mujoco.mj_forward(env.model, env.simulation.data)


def test_all_things_have_environments_of_all_robots() -> None:
    assert [task for task in task_names() if task.startswith("Pick-")] == [f"Pick-{thing}" for thing in THINGS]
    assert [task for task in tasks() if task.startswith("Pick-")] == [f"Pick-{thing}" for thing in THINGS]
    assert "CEI-Pick-Mug-UR5e-FourierRight" in gym.registry
    with pytest.raises(CEIError, match=r"unknown task 'Pick-Mugg'\. Did you mean 'Pick-Mug'\?"):
        open_environment("CEI-Pick-Mugg-Panda-PandaGripper")
    with pytest.raises(CEIError, match="unknown end-effector 'Inspyre'"):
        open_environment("CEI-Pick-Mug-Panda-Inspyre")


@pytest.mark.parametrize("thing", ["Sphere", "Nut"])  # one of ours, one of robosuite's
def test_gymnasium_checks_the_environment(thing: str) -> None:
    env = make(f"Pick-{thing}", PANDA)
    check_env(env, skip_render_check=True)
    observation, info = env.reset(seed=3)
    assert outcome(info) == {"is_success": False, "failure": "never grasped"}
    place = observation["environment_state"][:2]
    assert (np.linalg.norm(observation["point_cloud"][:, :2] - place, axis=1) < 0.06).sum() > 5
    env.close()


def test_it_weighs_what_is_said_and_lies_still(env: PickEnv) -> None:
    body = env.model.body(f"{env.thing.placed.name}_main")
    assert body.subtreemass[0] == pytest.approx(MASSES_KG[name(env)], rel=0.02)
    start = env.reset(seed=1)[0]["environment_state"]
    for _ in range(20):
        state = env.step(env.simulation.qpos)[0]["environment_state"]
    assert np.abs(state - start)[:3].max() < 3e-4
    assert np.abs(state - start)[3:].max() < 2e-3


def test_starts_vary_and_come_back_bit_for_bit(env: PickEnv) -> None:
    rng = np.random.default_rng(0)
    states = np.array([env.sample_state(rng) for _ in range(400)])
    assert (np.ptp(states[:, :2], axis=0) > 0.155).all()
    yaws = [env.thing.grasp_world(state)[1] for state in states]
    assert np.ptp(yaws) > np.radians(48)
    for state in states[:5].astype(np.float32):
        for _ in range(2):
            observation, _ = env.reset(options={"environment_state": state})
            np.testing.assert_array_equal(observation["environment_state"], state)


def test_a_recorded_start_is_restored_exactly(env: PickEnv) -> None:
    actions = wander(env, 4)
    recorded = [env.reset(seed=5)[0], *(env.step(a)[0] for a in actions)]
    env.reset(seed=7)
    env.step(actions[0])
    options = {key: recorded[0][key] for key in ("environment_state", "agent_pos")}
    again = [env.reset(options=options)[0], *(env.step(a)[0] for a in actions)]
    for one, other in zip(recorded, again, strict=True):
        for key, value in one.items():
            np.testing.assert_array_equal(value, other[key], err_msg=key)


def test_five_centimetres_for_a_second_are_a_success_and_less_is_not(env: PickEnv) -> None:
    """Held by nothing but that gravity is off for a moment."""
    gravity = env.model.opt.gravity.copy()
    try:
        for height_m, expected in ((0.06, True), (0.04, False)):
            env.reset(seed=0)
            env.model.opt.gravity[:] = 0
            lift(env, height_m)
            for _ in range(25):
                *_, done, _, info = env.step(env.simulation.qpos)
                if done:
                    break
            assert outcome(info) == {"is_success": expected, "failure": "" if expected else "too low"}
        env.model.opt.gravity[:] = gravity
        for _ in range(20):
            *_, info = env.step(env.simulation.qpos)
        assert info["failure"] == "slipped"
    finally:
        env.model.opt.gravity[:] = gravity


def test_a_grasp_is_where_it_is_said_however_the_thing_lies() -> None:
    thing = Thing(Placed("a"), 0.03, 0.06, lying_rad=(0.0, np.pi / 2, 0.0), grasp_m=(0.01, 0.0, 0.02), across_rad=0.5)
    state = thing.at(0.1, -0.2, 0.3, TABLE_Z_M)
    middle, across = thing.grasp_world(state)
    np.testing.assert_allclose(middle, [0.1 + 0.01 * np.cos(0.3), -0.2 + 0.01 * np.sin(0.3), TABLE_Z_M + 0.05])
    assert across == pytest.approx(0.8)


def test_an_object_of_ones_own_is_a_class(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "brick.xml"
    file.write_text(
        '<mujoco model="brick"><worldbody><body><body name="object"><geom name="g" type="box" size="0.03 0.015 0.02" mass="0.1" '
        'rgba="1 0 0 1" group="0"/></body></body></worldbody></mujoco>'
    )

    class PickBrickEnv(PickEnv):
        """A brick."""

        task = "Pick-Brick"
        task_text = "Pick up the brick."
        thing = Thing(Placed("brick", description=str(file)), height_m=0.02, width_m=0.03)

    env = PickBrickEnv(PANDA, clouds=False)
    assert env.state_names[0] == "brick.x_m"
    assert env.reset(seed=0)[0]["environment_state"][2] == pytest.approx(TABLE_Z_M + 0.02)
    env.close()


@pytest.mark.parametrize("thing", THINGS)
def test_a_gripper_demonstrates_it(thing: str) -> None:
    env = make(f"Pick-{thing}", PANDA, clouds=False)
    outcomes = [record_episode(env, seed, 0)[1] for seed in range(5)]
    env.close()
    assert sum(info["is_success"] for info in outcomes) >= 4, outcomes


@pytest.mark.parametrize("hand", ["IIWA-Inspire", "Panda-RobotiqThreeFinger"])
@pytest.mark.parametrize(
    ("task", "seeds"),
    [
        ("PickCube", 3),
        ("Pick-Can", 3),
        *((f"Pick-{each}", 1) for each in ("Sphere", "Cylinder", "LyingCylinder", "Mug")),
    ],
)
def test_a_hand_demonstrates_it(task: str, seeds: int, hand: str) -> None:
    """By its own pads, not by what was transferred to it."""
    env = make(task, hand, clouds=False)
    outcomes = [record_episode(env, seed, 0)[1] for seed in range(seeds)]
    env.close()
    assert all(info["is_success"] for info in outcomes), outcomes


@needs_robots
@pytest.mark.parametrize("thing", ["Sphere", "Plate", "Nut"])
def test_the_ag95_demonstrates_it(thing: str, third_party_robots: None) -> None:
    env = make(f"Pick-{thing}", "UR5e-AG95", clouds=False)
    outcomes = [record_episode(env, seed, 0)[1] for seed in range(3)]
    env.close()
    assert sum(info["is_success"] for info in outcomes) >= 2, outcomes
