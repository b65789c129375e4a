"""The tasks of the paper's real robots, in simulation: starts, objects, success and its opposite by hand, demonstrators."""

import warnings
from collections.abc import Callable, Iterator

import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from outcomes import outcome
from rollouts import make, wander
from scipy.spatial.transform import Rotation
from third_party import needs_robots

from cei_envs.experts import make_expert
from cei_envs.registration import tasks
from cei_envs.tasks import insert_flower, package_bread, pick_cup, place_bird, press_button, push_cube
from cei_envs.tasks.objects import ObjectsEnv
from cei_envs.tasks.placed import Placed
from cei_gym.embodiment import load_embodiment

PANDA = "Panda-PandaGripper"
TASKS = ("PushCube", "PlaceBird", "PickCup", "PackageBread", "InsertFlower", "PressButton")
FIRST = dict.fromkeys(TASKS, "never grasped") | {"PushCube": "never pushed", "PressButton": "never touched"}
SPREAD_M, SPREAD_RAD = 0.16, np.radians(40)
CONTROL_S, HELD_S = 0.05, 1.0


@pytest.fixture(scope="module")
def envs() -> Iterator[dict[str, ObjectsEnv]]:
    """Without clouds, which cost most of the time."""
    made = {task: make(task, PANDA, clouds=False) for task in TASKS}
    yield made
    for env in made.values():
        env.close()


@pytest.fixture
def begun(envs: dict[str, ObjectsEnv]) -> Callable[[str], ObjectsEnv]:
    def begin(task: str) -> ObjectsEnv:
        envs[task].reset(seed=0)
        return envs[task]

    return begin


def wait(env: ObjectsEnv, seconds: float = HELD_S + 0.5) -> tuple[bool, str]:
    """At most so long with the robot at rest: whether it succeeded, and the last failure."""
    end, target, failure = env.simulation.data.time + seconds, env.simulation.qpos, ""
    while env.simulation.data.time < end:
        *_, done, _, info = env.step(target)
        failure = info["failure"]
        if done:
            return True, ""
    return False, failure


def put(env: ObjectsEnv, thing: Placed, position_world: np.ndarray, rotation: Rotation | None = None) -> None:
    """Put a free object somewhere else."""
    quat_wxyz = (rotation or Rotation.identity()).as_quat(scalar_first=True)
    thing.apply(env.simulation, np.concatenate([position_world, quat_wxyz]))
    env.simulation.data.qvel[:] = 0.0
    mujoco.mj_forward(env.model, env.simulation.data)


def place(env: ObjectsEnv, thing: Placed) -> np.ndarray:
    """(3,) where its frame is."""
    return thing.T_world(env.simulation)[:3, 3]


# -- contract --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("task", TASKS)
def test_gymnasium_checks_the_environment(task: str) -> None:
    env = make(task, PANDA)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        check_env(env, skip_render_check=True)
    observation, info = env.reset(seed=3)
    assert len(observation["environment_state"]) == len(env.state_names) == len(set(env.state_names))
    assert outcome(info) == {"is_success": False, "failure": FIRST[task]}
    # Each object is seen: points lie within what it is made of.
    for thing in env.objects:
        root = env.simulation.data.body(f"{thing.name}_main").xpos
        near = np.linalg.norm(observation["point_cloud"][:, :2] - root[:2], axis=1) < 0.12
        assert near.sum() > 5, thing.name
    env.close()


@pytest.mark.parametrize("task", TASKS)
def test_every_start_comes_back_bit_for_bit(task: str, envs: dict[str, ObjectsEnv]) -> None:
    env, rng = envs[task], np.random.default_rng(1)
    for _ in range(10):
        state = env.sample_state(rng).astype(np.float32)
        for _ in range(2):
            observation, _ = env.reset(options={"environment_state": state})
            np.testing.assert_array_equal(observation["environment_state"], state)


@pytest.mark.parametrize("task", TASKS)
def test_a_recorded_start_is_restored_exactly(task: str, envs: dict[str, ObjectsEnv]) -> None:
    env, actions = envs[task], wander(envs[task], 4)
    recorded = [env.reset(seed=5)[0], *(env.step(a)[0] for a in actions)]
    env.reset(seed=7)
    for action in wander(env, 3, seed=1):
        env.step(action)
    options = {key: recorded[0][key] for key in ("environment_state", "agent_pos")}
    again = [env.reset(options=options)[0], *(env.step(a)[0] for a in actions)]
    for one, other in zip(recorded, again, strict=True):
        for key, value in one.items():
            np.testing.assert_array_equal(value, other[key], err_msg=key)


@pytest.mark.parametrize("task", TASKS)
def test_starts_vary_by_sixteen_centimetres_and_forty_degrees(task: str, envs: dict[str, ObjectsEnv]) -> None:
    """Of what is handled; what it goes into varies less."""
    env, rng = envs[task], np.random.default_rng(0)
    states = np.array([env.sample_state(rng) for _ in range(400)])
    thing = env.objects[1] if task in ("PackageBread", "InsertFlower") else env.objects[0]
    column = {name: states[:, i] for i, name in enumerate(env.state_names)}
    for axis in "xy":
        assert np.ptp(column[f"{thing.name}.{axis}_m"]) == pytest.approx(SPREAD_M, abs=0.01)
    yaw = (
        2 * np.arctan2(column[f"{thing.name}.qz"], column[f"{thing.name}.qw"])
        if thing.free
        else column[f"{thing.name}.yaw_rad"]
    )
    assert np.ptp(yaw) == pytest.approx(SPREAD_RAD, abs=0.05)


@pytest.mark.parametrize("task", TASKS)
def test_what_nobody_touches_stays_where_it_is(task: str, begun: Callable) -> None:
    env = begun(task)
    before = {thing: thing.T_world(env.simulation) for thing in env.objects}
    assert wait(env) == (False, FIRST[task])
    for thing, T in before.items():
        np.testing.assert_allclose(thing.T_world(env.simulation)[:3, 3], T[:3, 3], atol=6e-3, err_msg=thing.name)


@pytest.mark.parametrize(
    ("task", "thing", "mass_kg"),
    [
        ("PushCube", push_cube.CUBE, 0.125),
        ("PlaceBird", place_bird.BIRD, 0.070),
        ("PickCup", pick_cup.CUP, 0.060),
        ("PackageBread", package_bread.BREAD, 0.040),
        ("InsertFlower", insert_flower.BOUQUET, 0.025),
    ],
)
def test_objects_weigh_what_their_pages_say(task: str, thing: Placed, mass_kg: float, envs: dict) -> None:
    model = envs[task].model
    assert model.body_subtreemass[model.body(f"{thing.name}_main").id] == pytest.approx(mass_kg, abs=1e-4)


def test_the_cup_is_hollow(begun: Callable) -> None:
    env = begun("PickCup")
    place_m, hit = place(env, pick_cup.CUP), np.zeros(1, np.int32)
    down = np.array([0.0, 0.0, -1.0])
    for x in (-0.02, 0.0, 0.02):
        start = place_m + [x, 0, 0.2]
        depth = mujoco.mj_ray(env.model, env.simulation.data, start, down, None, 1, -1, hit)
        assert depth == pytest.approx(0.2, abs=0.008)  # its bottom, not a lid


# -- success, and its opposite ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("shift", "found"),
    [
        ((0.0, -0.21, 0.0), (True, "")),
        ((0.04, -0.21, 0.0), (True, "")),
        ((0.06, -0.21, 0.0), (False, "off the line")),
        ((0.0, -0.17, 0.0), (False, "too short")),
        ((0.0, 0.21, 0.0), (False, "too short")),
    ],
)
def test_a_cube_is_pushed_when_it_is_twenty_centimetres_to_the_right(shift, found, begun: Callable) -> None:
    env = begun("PushCube")
    put(env, push_cube.CUBE, place(env, push_cube.CUBE) + shift)
    assert wait(env) == found


def test_a_cube_that_is_carried_is_not_pushed(begun: Callable) -> None:
    env = begun("PushCube")
    put(env, push_cube.CUBE, place(env, push_cube.CUBE) + [0, -0.21, 0.05])
    env.is_done()
    assert env.failure_reason() == "lifted"


def test_a_bird_is_placed_when_it_is_in_the_box_and_free(begun: Callable) -> None:
    env = begun("PlaceBird")
    put(env, place_bird.BIRD, place(env, place_bird.BOX) + [0.02, 0.01, 0.02])
    assert wait(env) == (True, "")
    env = begun("PlaceBird")
    put(env, place_bird.BIRD, place(env, place_bird.BOX) + [0.16, 0.0, 0.02])
    assert wait(env)[0] is False


def test_a_bird_in_the_hand_is_not_placed(begun: Callable) -> None:
    env = begun("PlaceBird")
    hand = env.simulation.data.geom_xpos[env.simulation.robot_geoms[-1]]
    put(env, place_bird.BIRD, hand)
    assert not env.is_done()
    assert env.failure_reason() == "not released"


@pytest.mark.parametrize(
    ("tilt_deg", "lift_m", "done"), [(0, 0.06, True), (20, 0.06, True), (30, 0.06, False), (0, 0.04, False)]
)
def test_a_cup_is_picked_when_it_is_lifted_upright(tilt_deg: float, lift_m: float, done: bool, begun: Callable) -> None:
    env = begun("PickCup")
    put(env, pick_cup.CUP, place(env, pick_cup.CUP) + [0, 0, lift_m], Rotation.from_euler("x", tilt_deg, degrees=True))
    assert env.is_done() is done
    if not done:
        assert env.failure_reason() == ("tipped" if tilt_deg > 25 else "too low")


def test_bread_is_packed_when_it_is_down_in_the_bag(begun: Callable) -> None:
    env = begun("PackageBread")
    bag = package_bread.BAG.T_world(env.simulation)
    put(env, package_bread.BREAD, bag[:3, 3] + [0, 0, 0.01], Rotation.from_matrix(bag[:3, :3]))
    assert wait(env) == (True, "")
    env = begun("PackageBread")
    put(
        env, package_bread.BREAD, bag[:3, 3] + [0, 0, 0.11], Rotation.from_euler("y", 90, degrees=True)
    )  # across its mouth
    assert wait(env)[0] is False


def test_flowers_are_inserted_when_their_stem_is_in_the_vase(begun: Callable) -> None:
    env = begun("InsertFlower")
    vase = place(env, insert_flower.VASE)
    put(env, insert_flower.BOUQUET, vase + [0, 0, 0.02])
    assert wait(env) == (True, "")
    env = begun("InsertFlower")
    put(env, insert_flower.BOUQUET, vase + [0.06, 0, 0.02])  # beside it
    assert wait(env)[0] is False


@pytest.mark.parametrize(("pressed_m", "done", "failure"), [(0.0075, True, ""), (0.004, False, "not through")])
def test_a_button_is_pressed_when_it_is_through(pressed_m: float, done: bool, failure: str, begun: Callable) -> None:
    env = begun("PressButton")
    env.simulation.data.joint("button_slide").qpos[:] = pressed_m
    assert env.is_done() is done
    if not done:
        assert env.failure_reason() == failure
    env.simulation.data.joint("button_slide").qpos[:] = 0.0
    assert not env.is_done()
    assert env.failure_reason() == ("let go" if done else "not through")


def test_a_button_comes_back_by_its_spring(begun: Callable) -> None:
    env = begun("PressButton")
    env.simulation.data.joint("button_slide").qpos[:] = press_button.PRESSED_M
    assert wait(env)[0] is False
    assert env.read_state()[-1] < 0.001


# -- demonstrators ---------------------------------------------------------------------------------------------------


def demonstrates(env: ObjectsEnv, seed: int) -> str:
    """The failure of an expert's demonstration, "" if it succeeds."""
    observation, info = env.reset(seed=seed)
    actions = env.expert(seed).plan(observation["agent_pos"], observation["environment_state"])
    for action in [*actions, *[actions[-1]] * 20]:
        *_, done, _, info = env.step(action.astype(np.float32))
        if done:
            break
    return info["failure"]


@pytest.mark.parametrize("task", ["PlaceBird", "PressButton"])
def test_the_pandas_gripper_has_a_demonstrator(task: str, envs: dict[str, ObjectsEnv]) -> None:
    assert [demonstrates(envs[task], seed) for seed in range(4)] == [""] * 4


OF_THE_PAPER = {
    "UR5e-AG95": ("PushCube", "OpenDrawer", "PlaceBird", "PressButton"),
    "UR5e-XHand": ("PickCup", "PackageBread", "InsertFlower"),
}


@needs_robots
@pytest.mark.parametrize(("robot", "task"), [(robot, task) for robot, each in OF_THE_PAPER.items() for task in each])
def test_the_papers_robots_have_demonstrators(robot: str, task: str, third_party_robots: None) -> None:
    env = make(task, robot, clouds=False)
    assert [demonstrates(env, seed) for seed in range(40, 46)] == [""] * 6
    env.close()


@needs_robots
def test_demonstrations_of_a_task_reach_down_alike(third_party_robots: None) -> None:
    """A gripper's two ways to close along a line are half a turn apart; a dataset that mixed them would make a hand do two things."""
    robot, turns = load_embodiment("UR5e-AG95"), []
    for yaw in (-0.25, -0.05, 0.05, 0.25):
        expert = make_expert("OpenDrawer", robot, np.eye(4), seed=0, variation=0.0)
        turns.append(expert.reaching_down(yaw))
    apart = [(one.inv() * other).magnitude() for one in turns for other in turns]
    assert max(apart) < 0.6


def test_every_task_says_who_demonstrates_it() -> None:
    assert {task.name for task in tasks().values() if not task.experts} == set()
