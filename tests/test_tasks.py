"""OpenDrawer and StackCube: starts, success and its opposite by hand, experts; and the switches that all tasks share."""

import warnings
from collections.abc import Iterator

import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from outcomes import outcome
from rollouts import make, wander

from cei_envs.environment import CEIEnv
from cei_envs.experts import make_expert
from cei_envs.mounted import StillBaseController
from cei_gym.embodiment import load_end_effector
from cei_gym.errors import CEIError

PANDA = "Panda-PandaGripper"
TASKS = ("OpenDrawer", "StackCube")
TABLE_Z = 0.8
CONTROL_S = 0.05
FIRST = {"OpenDrawer": "never pulled", "StackCube": "never grasped"}


@pytest.fixture(scope="module")
def envs() -> Iterator[dict[str, CEIEnv]]:
    """Without clouds, which cost most of the time."""
    made = {task: make(task, PANDA, clouds=False) for task in TASKS}
    yield made
    for env in made.values():
        env.close()


@pytest.fixture
def drawer(envs: dict[str, CEIEnv]) -> CEIEnv:
    envs["OpenDrawer"].reset(seed=0)
    return envs["OpenDrawer"]


@pytest.fixture
def stack(envs: dict[str, CEIEnv]) -> CEIEnv:
    envs["StackCube"].reset(seed=0)
    return envs["StackCube"]


def wait(env: CEIEnv, periods: int) -> tuple[bool, dict]:
    """At most that many control periods with the robot at rest; whether it succeeded, and what the last step says."""
    end, info = env.simulation.data.time + (periods - 0.5) * CONTROL_S, {}
    target = env.simulation.qpos
    target[env.embodiment.n_arm :] = env.embodiment.home[env.embodiment.n_arm :]
    while env.simulation.data.time < end:
        *_, terminated, _, info = env.step(target)
        if terminated:
            return True, outcome(info)
    return False, outcome(info)


def assert_same(one: dict, other: dict, keys=("agent_pos", "environment_state")) -> None:
    for key in keys:
        np.testing.assert_array_equal(one[key], other[key], err_msg=key)


def opening_m(env: CEIEnv) -> float:
    """How far the drawer is open."""
    return float(env.read_state()[env.state_names.index("drawer.opening_m")])


def geoms_of(env: CEIEnv, cube: str) -> np.ndarray:
    """Those of one of robosuite's cubes."""
    body = env.model.body(f"{cube}_main")
    return np.arange(body.geomadr[0], body.geomadr[0] + body.geomnum[0])


def shift(env: CEIEnv, joint: str, index: int, by: float) -> None:
    env.simulation.data.joint(joint).qpos[index] += by
    mujoco.mj_forward(env.model, env.simulation.data)


# -- contract ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("task", TASKS)
def test_gymnasium_checks_the_environment(task: str) -> None:
    env = make(task, PANDA)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(env, skip_render_check=True)
    # Joint targets are in rad and m, and nothing bounds what physics does to a joint.
    meant = ("normalized", "value is -infinity", "value is infinity", "different from the unwrapped version")
    rest = [str(w.message) for w in caught if issubclass(w.category, UserWarning)]
    assert not [message for message in rest if not any(m in message for m in meant)]
    observation, info = env.reset(seed=3)
    assert observation["point_cloud"].shape == (1024, 3)
    assert len(observation["environment_state"]) == len(env.state_names) == len(set(env.state_names))
    assert outcome(info) == {"is_success": False, "failure": FIRST[task]}
    # What the task is about is seen: points of the cloud lie on it.
    assert seen(env, observation["point_cloud"]) > 20
    env.close()


def seen(env: CEIEnv, cloud: np.ndarray) -> int:
    """How many points lie on the surface of the handle's bar, or of the two cubes (boxes all of them)."""
    names = ("cabinet_handle",) if env.task == "OpenDrawer" else ("cubeA_g0", "cubeB_g0")
    data, count = env.simulation.data, 0
    for name in names:
        geom = env.model.geom(name).id
        local = (cloud - data.geom_xpos[geom]) @ data.geom_xmat[geom].reshape(3, 3)
        count += int((np.abs(np.abs(local) - env.model.geom_size[geom]).min(axis=1) < 2e-3).sum())
        assert (np.abs(local) < env.model.geom_size[geom] + 1e-3).all(axis=1).sum() > 5
    return count


@pytest.mark.parametrize("task", TASKS)
def test_a_recorded_start_is_restored_exactly(task: str, envs: dict[str, CEIEnv]) -> None:
    env, actions = envs[task], wander(envs[task], 4)
    recorded = [env.reset(seed=5)[0], *(env.step(a)[0] for a in actions)]
    for seed in (6, None):
        env.reset(seed=7)
        for action in wander(env, 3, seed=1):
            env.step(action)
        options = {key: recorded[0][key] for key in ("environment_state", "agent_pos")}
        again = [env.reset(seed=seed, options=options)[0], *(env.step(a)[0] for a in actions)]
        for one, other in zip(recorded, again, strict=True):
            assert_same(one, other)


@pytest.mark.parametrize("task", TASKS)
def test_every_start_comes_back_bit_for_bit(task: str, envs: dict[str, CEIEnv]) -> None:
    env, rng = envs[task], np.random.default_rng(1)
    for _ in range(25):
        state = env.sample_state(rng).astype(np.float32)
        observation, _ = env.reset(options={"environment_state": state})
        np.testing.assert_array_equal(observation["environment_state"], state)
        np.testing.assert_array_equal(env.reset(options={"environment_state": state})[0]["environment_state"], state)


@pytest.mark.parametrize("task", ["PickCube", *TASKS])
def test_without_clouds_physics_is_the_same(task: str) -> None:
    seeing, blind = make(task, PANDA), make(task, PANDA, clouds=False)
    assert "point_cloud" in seeing.observation_space.spaces
    assert set(blind.observation_space.spaces) == {"agent_pos", "environment_state"}
    actions = wander(seeing, 4)
    one, other = seeing.reset(seed=2)[0], blind.reset(seed=2)[0]
    for action in [*actions, None]:
        assert set(other) == {"agent_pos", "environment_state"}
        assert blind.observation_space.contains(other)
        assert_same(one, other)
        np.testing.assert_array_equal(seeing.simulation.data.qpos, blind.simulation.data.qpos)
        np.testing.assert_array_equal(seeing.simulation.data.qvel, blind.simulation.data.qvel)
        if action is not None:
            one, other = seeing.step(action)[0], blind.step(action)[0]
    assert blind.depth_m() == {}
    assert set(seeing.depth_m()) == {"front"}
    seeing.close()
    blind.close()


# -- the drawer ----------------------------------------------------------------------------------------------


def test_a_drawer_that_stays_open_for_a_second_is_success(drawer: CEIEnv) -> None:
    shift(drawer, "cabinet_slide", 0, 0.11)
    done, info = wait(drawer, 19)
    assert (done, info) == (False, {"is_success": False, "failure": "timed out"})
    done, info = wait(drawer, 1)
    assert (done, info) == (True, {"is_success": True, "failure": ""})


def test_a_drawer_that_is_half_open_is_none(drawer: CEIEnv) -> None:
    shift(drawer, "cabinet_slide", 0, 0.05)
    assert wait(drawer, 30) == (False, {"is_success": False, "failure": "slipped"})
    shift(drawer, "cabinet_slide", 0, 0.0495)  # a millimetre less than it takes
    assert wait(drawer, 25)[0] is False
    drawer.reset(seed=0)
    assert wait(drawer, 2) == (False, {"is_success": False, "failure": "never pulled"})


def test_a_drawer_that_closes_again_starts_its_second_anew(drawer: CEIEnv) -> None:
    shift(drawer, "cabinet_slide", 0, 0.11)
    assert not wait(drawer, 15)[0]
    shift(drawer, "cabinet_slide", 0, -0.05)
    assert wait(drawer, 1) == (False, {"is_success": False, "failure": "slipped"})
    shift(drawer, "cabinet_slide", 0, 0.05)
    assert not wait(drawer, 15)[0]
    assert wait(drawer, 5)[0]


def test_an_arm_that_keeps_falling_short_is_told_apart(drawer: CEIEnv) -> None:
    away = drawer.embodiment.home.copy()
    away[0] += 1.5
    for i in range(10):
        info = drawer.step(away if i % 2 == 0 else drawer.embodiment.home)[4]
        assert info["failure"] == ("never pulled" if i < 9 else "unreachable")


def test_drawers_start_shut_and_spread(drawer: CEIEnv) -> None:
    rng = np.random.default_rng(0)
    x, y, yaw, opening = np.array([drawer.sample_state(rng) for _ in range(400)]).T
    for values, lower, upper in ((x, 0.06, 0.12), (y, -0.08, 0.08), (yaw, -0.25, 0.25)):
        assert lower <= values.min() < lower + 0.05 * (upper - lower)
        assert upper - 0.05 * (upper - lower) < values.max() <= upper
        assert abs(values.mean() - (lower + upper) / 2) < 0.1 * (upper - lower)
    assert (opening == 0).all()
    state = drawer.reset(seed=4)[0]["environment_state"]
    data = drawer.simulation.data
    cabinet = data.body("cabinet_main")
    np.testing.assert_allclose(cabinet.xpos, [*state[:2], TABLE_Z], atol=1e-7)
    turned = [[np.cos(state[2]), -np.sin(state[2]), 0], [np.sin(state[2]), np.cos(state[2]), 0], [0, 0, 1]]
    np.testing.assert_allclose(cabinet.xmat.reshape(3, 3), turned, atol=1e-7)
    # It stands on the table, clear of the robot.
    assert not drawer.simulation.touching(cabinet_geoms(drawer), drawer.simulation.robot_geoms)


def cabinet_geoms(env: CEIEnv) -> np.ndarray:
    owner = [env.model.body(b).name for b in env.model.geom_bodyid]
    return np.flatnonzero([name.startswith("cabinet") for name in owner])


def test_a_drawer_opens_along_its_own_axis(drawer: CEIEnv) -> None:
    state = np.array([0.08, -0.03, 0.2, 0.0], np.float32)
    places = []
    for opening in (0.0, 0.1):
        state[3] = opening
        drawer.reset(options={"environment_state": state})
        places.append(drawer.simulation.data.body("cabinet_drawer").xpos.copy())
    yaw = float(state[2])
    np.testing.assert_allclose(places[1] - places[0], [-0.1 * np.cos(yaw), -0.1 * np.sin(yaw), 0], atol=1e-6)
    assert drawer.read_state()[3] == pytest.approx(0.1)


def test_the_drawer_is_as_declared(drawer: CEIEnv) -> None:
    model, slide = drawer.model, drawer.model.joint("cabinet_slide")
    np.testing.assert_allclose(slide.range, [0, 0.15])
    assert (slide.damping[0], slide.frictionloss[0]) == (20, 1)
    cabinet, inside = model.body("cabinet_main"), model.body("cabinet_drawer")
    assert (cabinet.dofnum[0], inside.dofnum[0]) == (0, 1)
    assert model.body_weldid[cabinet.id] == 0  # part of the world
    handle = model.geom("cabinet_handle")
    np.testing.assert_allclose(2 * handle.size, [0.016, 0.12, 0.016])
    assert inside.mass[0] == pytest.approx(0.79)  # what is drawn weighs nothing
    # It touches nothing of its own cabinet at any opening.
    data = mujoco.MjData(model)
    data.qpos[:] = drawer.simulation.data.qpos
    own = cabinet_geoms(drawer)
    for opening in np.linspace(0, 0.15, 7):
        data.joint("cabinet_slide").qpos[:] = opening
        mujoco.mj_forward(model, data)
        assert not np.isin(data.contact.geom, own).all(axis=1).any()


@pytest.mark.parametrize(("force_n", "speed_m_s"), [(0.9, 0.0), (-5.0, 0.0), (2.0, 0.05), (3.0, 0.1)])
def test_friction_holds_a_drawer_and_damping_slows_it(drawer: CEIEnv, force_n: float, speed_m_s: float) -> None:
    """A pull beyond friction (1 N) moves it at (force - 1 N) / (20 N s/m) once it is up to speed."""
    data = drawer.simulation.data
    data.joint("cabinet_slide").qfrc_applied[:] = force_n
    wait(drawer, 6)
    before = opening_m(drawer)
    wait(drawer, 4)
    data.joint("cabinet_slide").qfrc_applied[:] = 0
    assert (opening_m(drawer) - before) / (4 * CONTROL_S) == pytest.approx(speed_m_s, abs=3e-3)
    assert opening_m(drawer) > -2e-3
    if speed_m_s:  # nobody pulls any more: it stays where it is
        wait(drawer, 3)
        stopped = opening_m(drawer)
        wait(drawer, 6)
        assert opening_m(drawer) == pytest.approx(stopped, abs=1e-4)


def test_a_drawer_ends(drawer: CEIEnv) -> None:
    drawer.simulation.data.joint("cabinet_slide").qfrc_applied[:] = 12
    for _ in range(12):
        drawer.step(drawer.embodiment.home)
    assert 0.14 < opening_m(drawer) < 0.16
    drawer.simulation.data.joint("cabinet_slide").qfrc_applied[:] = 0


# -- the cubes -----------------------------------------------------------------------------------------------


def cubes(red: tuple[float, float, float], green: tuple[float, float, float], lying: float = 0.0) -> np.ndarray:
    """(22,) state: centres above the table; the red one turned by `lying`."""
    parts = []
    for (x, y, z), half, yaw in ((red, 0.020, lying), (green, 0.025, 0.0)):
        mass = 1000 * (2 * half) ** 3
        parts += [x, y, TABLE_Z + z, np.cos(yaw / 2), 0, 0, np.sin(yaw / 2), half, half, half, mass]
    return np.array(parts)


def test_a_cube_that_rests_on_the_other_for_a_second_is_success(stack: CEIEnv) -> None:
    stack.reset(options={"environment_state": cubes((0.01, 0.02, 0.0701), (0.0, 0.02, 0.025), 0.4)})
    done, info = wait(stack, 19)
    assert (done, info["is_success"]) == (False, False)
    # Falling by 0.1 mm costs it a period or two.
    done, info = wait(stack, 3)
    assert (done, info) == (True, {"is_success": True, "failure": ""})


@pytest.mark.parametrize("red", [(0.046, 0.02, 0.02), (0.09, 0.02, 0.02)])
def test_a_cube_beside_the_other_is_none(stack: CEIEnv, red: tuple) -> None:
    stack.reset(options={"environment_state": cubes(red, (0.0, 0.02, 0.025))})
    assert wait(stack, 30) == (False, {"is_success": False, "failure": "never grasped"})


def test_the_lower_cube_on_the_upper_is_none(stack: CEIEnv) -> None:
    stack.reset(options={"environment_state": cubes((0.0, 0.0, 0.02), (0.0, 0.0, 0.0652))})
    done, info = wait(stack, 30)
    assert (done, info["failure"]) == (False, "never grasped")


def test_a_cube_in_the_air_is_none(stack: CEIEnv) -> None:
    """Held up by nothing that the robot or the green cube would feel."""
    stack.reset(options={"environment_state": cubes((0.0, 0.0, 0.08), (0.0, 0.0, 0.025))})
    force, mass = stack.simulation.data.body("cubeA_main").xfrc_applied, stack.model.body("cubeA_main").mass[0]
    force[2] = -mass * stack.model.opt.gravity[2]
    done, info = wait(stack, 30)
    force[:] = 0
    assert stack.read_state()[2] == pytest.approx(TABLE_Z + 0.08, abs=2e-3)
    assert (done, info["failure"]) == (False, "timed out")


def test_why_a_stack_failed(stack: CEIEnv) -> None:
    stack.reset(options={"environment_state": cubes((-0.04, 0.02, 0.02), (0.04, 0.02, 0.025))})
    assert wait(stack, 2)[1]["failure"] == "never grasped"
    shift(stack, "cubeB_joint0", 0, 0.03)  # even so: nothing was lifted yet
    assert wait(stack, 2)[1]["failure"] == "never grasped"
    shift(stack, "cubeB_joint0", 0, -0.03)
    shift(stack, "cubeA_joint0", 2, 0.08)  # lifted, and it falls
    assert wait(stack, 14) == (False, {"is_success": False, "failure": "dropped"})
    shift(stack, "cubeB_joint0", 0, 0.015)  # nudged: allowed
    assert wait(stack, 2)[1]["failure"] == "dropped"
    shift(stack, "cubeB_joint0", 1, 0.03)
    assert wait(stack, 2) == (False, {"is_success": False, "failure": "lower cube pushed"})
    # A new episode knows nothing of it.
    stack.reset(seed=1)
    assert wait(stack, 1)[1]["failure"] == "never grasped"


def test_cubes_start_apart_and_spread(stack: CEIEnv) -> None:
    rng = np.random.default_rng(0)
    states = np.array([stack.sample_state(rng) for _ in range(400)])
    red, green = states[:, :11], states[:, 11:]
    apart = np.linalg.norm((red - green)[:, :2], axis=1)
    assert 0.065 <= apart.min() < 0.07
    for cube, half in ((red, 0.020), (green, 0.025)):
        assert np.abs(cube[:, :2]).max() <= 0.08
        assert (cube[:, :2].min(axis=0) < -0.072).all()
        assert (cube[:, :2].max(axis=0) > 0.072).all()
        np.testing.assert_allclose(cube[:, 2], TABLE_Z + half)
        np.testing.assert_allclose(cube[:, 7:10], half)
        np.testing.assert_allclose(cube[:, 10], 1000 * (2 * half) ** 3)
        assert (cube[:, 4:6] == 0).all()
        yaw = 2 * np.arctan2(cube[:, 6], cube[:, 3])
        assert yaw.min() < -2.8
        assert yaw.max() > 2.8
    for seed in range(5):  # neither in each other nor in the table, and they stay where they are
        observation, _ = stack.reset(seed=seed)
        data = stack.simulation.data
        assert (data.contact.dist > -1e-3).all()
        assert not stack.simulation.touching(*(geoms_of(stack, name) for name in ("cubeA", "cubeB")))
        wait(stack, 3)
        after = stack.read_state()
        np.testing.assert_allclose(after, observation["environment_state"], atol=1e-3)


def test_cubes_are_robosuites_own() -> None:
    """Sizes, masses, friction and contact of the model as robosuite compiles it."""
    import robosuite
    from robosuite.controllers import load_composite_controller_config

    env = make("StackCube", PANDA, clouds=False)
    env.reset(seed=0)
    stock = robosuite.make(
        "Stack",
        robots="Panda",
        controller_configs=load_composite_controller_config(controller="BASIC"),
        has_renderer=False,
        has_offscreen_renderer=False,
        use_camera_obs=False,
    )
    model = stock.sim.model._model  # private: MuJoCo's own model, which robosuite wraps and gives no other name
    for name in ("cubeA", "cubeB"):
        ours, theirs = env.model.body(f"{name}_main"), model.body(f"{name}_main")
        np.testing.assert_allclose(ours.mass, theirs.mass, rtol=1e-6)
        np.testing.assert_allclose(ours.inertia, theirs.inertia, rtol=1e-6)
        one, other = env.model.geom(f"{name}_g0"), model.geom(f"{name}_g0")
        for field in ("size", "friction", "solref", "solimp", "margin", "condim"):
            np.testing.assert_allclose(getattr(one, field), getattr(other, field), rtol=1e-6)
    stock.close()
    env.close()


# -- experts -------------------------------------------------------------------------------------------------


def plan_of(env: CEIEnv, seed: int, start: dict) -> np.ndarray:
    return env.expert(seed).plan(start["agent_pos"], start["environment_state"])


def closing_steps(env: CEIEnv, plan: np.ndarray) -> tuple[int, int]:
    """The first step that closes the hand, and the first after it that opens it again (or the plan's end)."""
    open_hand = np.abs(plan[:, -1] - env.embodiment.home[-1]) < 1e-9
    first = int(np.argmin(open_hand))
    again = np.flatnonzero(open_hand[first:])
    return first, first + int(again[0]) if len(again) else len(plan)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_expert_opens_the_drawer_with_the_bar_between_its_pads(seed: int, envs: dict[str, CEIEnv]) -> None:
    env = envs["OpenDrawer"]
    start, _ = env.reset(seed=seed)
    plan = plan_of(env, seed, start)
    closing, _ = closing_steps(env, plan)
    data, model = env.simulation.data, env.model
    pads = [model.geom(f"gripper0_right_finger{i}_pad_collision").id for i in (1, 2)]
    handle, stood = model.geom("cabinet_handle").id, data.body("cabinet_main").xpos.copy()
    half, info, pulled_by = model.geom_size[handle], {}, []
    for step, action in enumerate([*plan, *[plan[-1]] * 25]):
        if step == closing:
            R = data.geom_xmat[handle].reshape(3, 3)
            x, y, z = ((data.geom_xpos[pads] - data.geom_xpos[handle]) @ R).T
            assert min(x) < -half[0]
            assert max(x) > half[0]
            assert (np.abs(y) < half[1]).all()
            assert (np.abs(z) < half[2] + 0.01).all()
            assert opening_m(env) < 1e-3
            assert not env.simulation.touching(np.array([handle]), env.simulation.robot_geoms)
        terminated, _, info = env.step(action)[2:]
        if 0.03 < opening_m(env) < 0.08:
            touching = [env.simulation.touching(np.array([handle]), np.array([pad])) for pad in pads]
            pulled_by.append(any(touching))
        if terminated:
            break
    assert outcome(info) == {"is_success": True, "failure": ""}
    assert len(pulled_by) > 2
    assert all(pulled_by)  # by the bar, not by friction on something else
    np.testing.assert_array_equal(data.body("cabinet_main").xpos, stood)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_expert_stacks_and_success_waits_for_it_to_let_go(seed: int, envs: dict[str, CEIEnv]) -> None:
    env = envs["StackCube"]
    start, _ = env.reset(seed=seed)
    plan = plan_of(env, seed, start)
    closing, opening = closing_steps(env, plan)
    assert closing < opening < len(plan)
    infos = [env.step(action)[4] for action in plan[:closing]]
    assert {info["failure"] for info in infos} == {"never grasped"}
    for action in plan[closing:opening]:
        env.step(action)
    for _ in range(25 if seed == 0 else 1):  # held for more than a second
        *_, terminated, _, info = env.step(plan[opening - 1])
        assert (terminated, outcome(info)) == (False, {"is_success": False, "failure": "not released"})
    for action in [*plan[opening:], *[plan[-1]] * 25]:
        *_, terminated, _, info = env.step(action)
        if terminated:
            break
    assert outcome(info) == {"is_success": True, "failure": ""}
    red, green = env.read_state()[:11], env.read_state()[11:]
    assert red[2] - green[2] == pytest.approx(0.045, abs=1e-3)
    assert np.linalg.norm((red - green)[:2]) < 0.025
    assert not env.simulation.touching(geoms_of(env, "cubeA"), env.simulation.robot_geoms)


@pytest.mark.parametrize("task", TASKS)
def test_experts_differ_by_seed_and_repeat_by_seed(task: str, envs: dict[str, CEIEnv]) -> None:
    env = envs[task]
    start, _ = env.reset(seed=0)
    one, again, other = (plan_of(env, seed, start) for seed in (0, 0, 1))
    np.testing.assert_array_equal(one, again)
    assert one.shape != other.shape or np.abs(one - other).max() > 0.01
    assert env.expert(0).describe() == env.expert(0).describe() != env.expert(1).describe()
    lower, upper = env.embodiment.lower, env.embodiment.upper
    for plan in (one, other):
        assert ((plan >= lower - 1e-6) & (plan <= upper + 1e-6)).all()
    ideal, alike = env.expert(0, variation=0.0), env.expert(1, variation=0.0)
    assert ideal.describe() == alike.describe() != env.expert(0).describe()
    np.testing.assert_array_equal(*(e.plan(start["agent_pos"], start["environment_state"]) for e in (ideal, alike)))
    # And it looks at where things are: another start, another plan of the same expert.
    elsewhere, _ = env.reset(seed=1)
    assert np.abs(plan_of(env, 0, elsewhere)[30] - one[30]).max() > 0.01


@pytest.mark.parametrize(
    ("task", "name"), [("OpenDrawer", "IIWA-Inspire"), ("StackCube", "Panda-Inspire"), ("PourTea", PANDA)]
)
def test_without_an_expert_those_there_are_are_named(task: str, name: str) -> None:
    from cei_gym.embodiment import load_embodiment

    with pytest.raises(CEIError) as error:
        make_expert(task, load_embodiment(name), np.eye(4), 0)
    message = str(error.value)
    assert message.startswith(f"no scripted expert for CEI-{task}-{name}. There is one for: ")
    assert "\n" not in message
    assert all(f"CEI-{task}-<Arm>-PandaGripper" in message for task in ("OpenDrawer", "PickCube", "StackCube"))


# -- physics -------------------------------------------------------------------------------------------------


def hand_bodies(env: CEIEnv) -> list[int]:
    return [b for b in range(env.model.nbody) if env.model.body(b).name.startswith("gripper0_right_")]


def excluded(env: CEIEnv) -> int:
    """How many pairs of the hand's bodies never touch by declaration."""
    own = set(hand_bodies(env))
    signatures = env.model.exclude_signature
    return sum((int(s) >> 16) in own and (int(s) & 0xFFFF) in own for s in signatures)


def test_stock_physics_leaves_out_all_exceptions_but_the_required() -> None:
    name = "Panda-FourierRight"
    stock, ours = make("PickCube", name, clouds=False, stock_physics=True), make("PickCube", name, clouds=False)
    mass = [sum(env.model.body_mass[hand_bodies(env)]) for env in (stock, ours)]
    assert mass[0] > 4  # robosuite's own: 0.5 kg a geom
    assert mass[1] < 2
    root = hand_bodies(ours)[0]
    mount = load_end_effector("FourierRight").mount_quat_wxyz
    for env in (stock, ours):
        col = [g for g in range(env.model.ngeom) if env.model.geom(g).name.endswith("R_thumb_distal_link_col")]
        assert len(col) == 1
        np.testing.assert_allclose(np.abs(env.model.body_quat[root] @ mount), 1, atol=1e-6)  # required
        env.reset(seed=0)
        target = env.embodiment.home.copy()
        for _ in range(8):
            observation = env.step(target)[0]
        # Absolute joint targets (required) still mean what they mean.
        assert np.abs(observation["agent_pos"] - target)[: env.embodiment.n_arm].max() < 0.1
    bodies = len(hand_bodies(ours))
    assert excluded(ours) >= 0.5 * bodies * (bodies - 1) / 2
    assert excluded(stock) < 0.5 * excluded(ours)
    stock.close()
    ours.close()


def test_stock_physics_of_a_hand_without_exceptions_is_its_physics() -> None:
    envs = [make("StackCube", PANDA, clouds=False, stock_physics=stock) for stock in (True, False)]
    actions = wander(envs[0], 4)
    for env in envs:
        env.reset(seed=1)
    for action in actions:
        one, other = (env.step(action)[0] for env in envs)
        assert_same(one, other)
    for env in envs:
        env.close()


@pytest.mark.parametrize("name", [PANDA, "IIWA-Inspire"])
def test_a_base_that_stands_still_saves_time_only(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same trajectories, bit for bit, as robosuite's own basic controller."""
    fast = make("PickCube", name, clouds=False)
    monkeypatch.setattr(StillBaseController, "name", "BASIC")
    basic = make("PickCube", name, clouds=False)
    quick = []
    monkeypatch.setattr(StillBaseController, "update_state", lambda self: quick.append(self))
    start, _ = fast.reset(seed=0)
    fast.step(start["agent_pos"])
    assert len(quick) > 0
    quick.clear()
    basic.reset(seed=0)
    basic.step(start["agent_pos"])
    assert not quick
    actions = plan_of(fast, 0, start)[:60] if name == PANDA else wander(fast, 12)
    for action in actions:
        fast.step(action)
        basic.step(action)
        for field in ("qpos", "qvel", "ctrl"):
            one, other = (getattr(env.simulation.data, field) for env in (fast, basic))
            np.testing.assert_array_equal(one, other, err_msg=field)
    # Also in the next episode: nothing is remembered of the last.
    for env in (fast, basic):
        env.reset(seed=1)
        env.step(actions[0])
    np.testing.assert_array_equal(fast.simulation.data.qpos, basic.simulation.data.qpos)
    fast.close()
    basic.close()
