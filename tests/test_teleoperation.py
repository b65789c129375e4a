"""Recording by hand: robosuite's own device drivers, real physics; only keys, space mouse and screen are made up."""

import contextlib
import json
import os
import queue
import signal
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import cei_gym  # noqa: F401  (registers the environments)
from cei_converters import record, replay
from cei_converters.sources.reader import DatasetReader
from cei_envs import teleoperation
from cei_envs.environment import CEIEnv
from cei_envs.experts.plan import grip_pose
from cei_envs.teleoperation import LEASH_M, STEP_M, Teleoperator
from cei_gym.embodiment import GRID, load_embodiment
from cei_gym.errors import CEIError

PANDA, INSPIRE = "CEI-PickCube-Panda-PandaGripper", "CEI-PickCube-IIWA-Inspire"
KEYS = SimpleNamespace(up="up", down="down", left="left", right="right", space="space")
TAP_RAD = 0.03


class Person:
    """Eyes on the window, hands on keyboard and space mouse; does one step of `script` at each picture."""

    def __init__(self) -> None:
        self.script: Callable[[mujoco.MjData], None] = lambda data: None
        self.pictures, self.windows, self.is_open = 0, 0, False
        self.mouse: queue.Queue[list[int]] = queue.Queue()
        self.has_read = False
        self.opt, self.cam, self.lock = mujoco.MjvOption(), mujoco.MjvCamera(), contextlib.nullcontext

    def tap(self, *keys: str) -> None:
        for key in keys:
            pressed = key if key in vars(KEYS) else SimpleNamespace(char=key)
            self.keyboard.on_press(pressed)
            self.keyboard.on_release(pressed)

    def listener(self, on_press: Callable, on_release: Callable) -> SimpleNamespace:
        self.keyboard = SimpleNamespace(on_press=on_press, on_release=on_release, start=lambda: None, stop=lambda: None)
        return self.keyboard

    def push(self, *axes: float, button: int = 0) -> None:
        """Displace the space mouse: x, y, z, roll, pitch, yaw from -1 to 1, in its driver's axes."""
        x, y, z, *turns = (int(350 * a) & 0xFFFF for a in axes)
        packed = [byte for value in (y, x, -z & 0xFFFF, *turns) for byte in (value & 0xFF, value >> 8)]
        self.mouse.put([1, *packed])
        self.mouse.put([3, button])
        self.mouse.join()  # the driver reads on a thread of its own

    def read(self, size: int) -> list[int]:
        if self.has_read:
            self.mouse.task_done()
        self.has_read = True
        return self.mouse.get()

    # what MuJoCo's window does

    def open_window(self, model: mujoco.MjModel, data: mujoco.MjData) -> "Person":
        self.data, self.is_open = data, True
        self.windows += 1
        return self

    def is_running(self) -> bool:
        return self.is_open

    def sync(self) -> None:
        self.pictures += 1
        self.script(self.data)

    def close(self) -> None:
        self.is_open = False


@pytest.fixture
def no_devices(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """robosuite.devices is imported afresh, here and by whoever comes next."""

    def forget() -> None:
        for name in [name for name in sys.modules if name.startswith("robosuite.devices")]:
            del sys.modules[name]

    forget()
    monkeypatch.setattr(teleoperation, "require_display", lambda: None)
    monkeypatch.setattr(teleoperation, "sleep", lambda seconds: None)
    yield
    forget()


@pytest.fixture
def person(monkeypatch: pytest.MonkeyPatch, no_devices: None) -> Person:
    import lerobot.utils.import_utils  # noqa: F401  (remembers which packages there are: not the made-up ones)

    person, hid, pynput, keyboard = Person(), ModuleType("hid"), ModuleType("pynput"), ModuleType("pynput.keyboard")
    keyboard.__dict__.update(Controller=None, Key=KEYS, Listener=person.listener)
    described = {"get_manufacturer_string": str, "get_product_string": str}
    hid.__dict__["device"] = lambda: SimpleNamespace(open=lambda vendor, product: None, read=person.read, **described)
    for module in (hid, pynput, keyboard):
        monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setattr(teleoperation, "open_window", person.open_window)
    return person


@pytest.fixture(scope="module")
def envs() -> Iterator[dict[str, CEIEnv]]:
    made = {name: gym.make(name).unwrapped for name in (PANDA, INSPIRE)}
    yield made
    for env in made.values():
        env.close()


def steer(env: CEIEnv, teleoperator: Teleoperator, steps: int = 100, seed: int = 0) -> np.ndarray:
    """(T, n) actions of an episode by hand, of at most so many steps."""
    observation, _ = env.reset(seed=seed)
    actions = []
    for action in teleoperator.actions(observation["agent_pos"]):
        env.step(action)
        actions.append(action)
        if len(actions) == steps:
            break
    return np.array(actions)


def script(person: Person, *lines: Callable[[], None]) -> None:
    """One line a picture; then hands off for a while, and q."""
    waiting = [*lines, *[lambda: None] * 15, lambda: person.tap("q")]
    person.script = lambda data: waiting.pop(0)()


def pose(env: CEIEnv) -> tuple[np.ndarray, Rotation]:
    return grip_pose(env.embodiment, env.simulation.qpos)


def start_pose(env: CEIEnv) -> tuple[np.ndarray, Rotation]:
    env.reset(seed=0)
    return pose(env)


# -- from a device to the grip site ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "key", "direction"),
    [(PANDA, KEYS.down, (1, 0, 0)), (PANDA, KEYS.left, (0, -1, 0)), (INSPIRE, ";", (0, 0, 1))],
)
def test_five_key_presses_move_the_grip_site_by_five_centimetres(
    name: str, key: str, direction: tuple, person: Person, envs: dict[str, CEIEnv]
) -> None:
    env = envs[name]
    position, rotation = start_pose(env)
    script(person, *[lambda: person.tap(key)] * 5)
    with env.teleoperator("keyboard") as teleoperator:
        steer(env, teleoperator)
    moved, turned = pose(env)
    np.testing.assert_allclose(moved - position, 0.05 * np.array(direction), atol=0.004)
    assert (turned * rotation.inv()).magnitude() < 0.03


@pytest.mark.parametrize(
    ("key", "axis"),
    [("o", (0, 0, 1)), ("y", (0, 1, 0)), ("e", (-1, 0, 0))],
)
def test_keys_turn_the_grip_site_about_the_axes_of_the_base(
    key: str, axis: tuple, person: Person, envs: dict[str, CEIEnv]
) -> None:
    env = envs[PANDA]
    position, rotation = start_pose(env)
    script(person, *[lambda: person.tap(key)] * 10)
    with env.teleoperator("keyboard") as teleoperator:
        steer(env, teleoperator)
    moved, turned = pose(env)
    np.testing.assert_allclose((turned * rotation.inv()).as_rotvec(), 10 * TAP_RAD * np.array(axis), atol=0.02)
    assert np.linalg.norm(moved - position) < 0.006


def test_the_space_bar_closes_and_opens_the_gripper(person: Person, envs: dict[str, CEIEnv]) -> None:
    env = envs[PANDA]
    body, hand = env.embodiment, slice(env.embodiment.n_arm, None)
    held = [lambda: None] * 6
    script(person, lambda: person.tap(KEYS.space), *held, lambda: person.tap(KEYS.space))
    with env.teleoperator("keyboard") as teleoperator:
        actions = steer(env, teleoperator)
    np.testing.assert_allclose(actions[:7, hand], np.tile(body.closed[hand], (7, 1)), atol=1e-6)
    np.testing.assert_allclose(actions[7:, hand], np.tile(body.home[hand], (len(actions) - 7, 1)), atol=1e-6)
    np.testing.assert_array_equal(actions[:, : body.n_arm], actions[:1, : body.n_arm].repeat(len(actions), 0))


def test_a_space_mouse_moves_turns_grasps_and_gives_up(person: Person, envs: dict[str, CEIEnv]) -> None:
    env = envs[PANDA]
    position, rotation = start_pose(env)
    with env.teleoperator("spacemouse") as teleoperator:
        observation, _ = env.reset(seed=0)
        actions = teleoperator.actions(observation["agent_pos"])
        lines = [lambda: person.push(1, 0, 0, 0, 0, 0.5, button=1), *[lambda: None] * 8]
        person.script = lambda data: lines.pop(0)()
        for _ in range(8):
            action = next(actions)
            env.step(action)
        person.push(0, 0, 0, 0, 0, 0, button=2)
        assert list(actions) == []
    body = env.embodiment
    moved, turned = grip_pose(body, action.astype(float))
    # full deflection is 6.25 mm a step
    assert moved[0] - position[0] == pytest.approx(8 * 0.625 * STEP_M, abs=0.003)
    np.testing.assert_allclose((moved - position)[1:], 0, atol=0.002)
    np.testing.assert_allclose((turned * rotation.inv()).as_rotvec(), [0, 0, -8 * 0.025], atol=0.02)
    np.testing.assert_allclose(action[body.n_arm :], body.closed[body.n_arm :], atol=1e-6)


def test_an_episode_starts_with_the_first_motion(person: Person, envs: dict[str, CEIEnv]) -> None:
    env = envs[PANDA]
    script(person, *[lambda: None] * 10, lambda: person.tap(KEYS.up))
    with env.teleoperator("keyboard") as teleoperator:
        actions = steer(env, teleoperator)
    assert len(actions) == 1 + 15
    assert actions.dtype == np.float32


@pytest.mark.parametrize("how", ["q", "window"])
def test_giving_up_ends_the_attempt_and_the_next_one_starts_afresh(
    how: str, person: Person, envs: dict[str, CEIEnv]
) -> None:
    env = envs[PANDA]
    with env.teleoperator("keyboard") as teleoperator:
        for _ in range(2):
            observation, _ = env.reset(seed=0)
            give_up = person.close if how == "window" else lambda: person.tap("q")
            lines = [lambda: person.tap(KEYS.space, KEYS.up), lambda: None, give_up]
            person.script = lambda data, lines=lines: lines.pop(0)()
            actions = list(teleoperator.actions(observation["agent_pos"]))
            assert len(actions) == 2
            np.testing.assert_array_equal(actions[0][7:], env.embodiment.closed[7:].astype(np.float32))
    assert person.windows == (2 if how == "window" else 1)
    assert not person.is_open


def test_targets_stop_where_the_arm_ends_and_come_back_at_once(person: Person, envs: dict[str, CEIEnv]) -> None:
    env = envs[PANDA]
    position, _ = start_pose(env)
    script(person, *[lambda: person.tap(KEYS.down)] * 60, *[lambda: person.tap(KEYS.up)] * 10)
    with env.teleoperator("keyboard") as teleoperator:
        actions = steer(env, teleoperator)
    x = np.array([grip_pose(env.embodiment, a.astype(float))[0][0] for a in actions])
    assert 0.1 < x[59] - position[0] < 0.5
    assert x[59] - x[69] == pytest.approx(0.1, abs=0.01)
    assert np.abs(np.diff(actions, axis=0)).max() < 0.3  # rad: no jump to another solution


def test_targets_do_not_run_away_from_an_arm_that_the_table_holds_back(person: Person, envs: dict[str, CEIEnv]) -> None:
    env = envs[PANDA]
    start_pose(env)
    script(person, *[lambda: person.tap(".")] * 40)
    with env.teleoperator("keyboard") as teleoperator:
        actions = steer(env, teleoperator)
    z = grip_pose(env.embodiment, actions[-1].astype(float))[0][2]
    held = pose(env)[0][2]
    assert held - z < LEASH_M + STEP_M
    assert (env.simulation.T_world_base[2, 3] + held) > 0.79


@pytest.mark.parametrize("name", [name for name in GRID if name.startswith("Kinova3-")])
def test_every_hand_has_a_grip_site_that_only_the_arm_moves(name: str) -> None:
    body = load_embodiment(name)
    qpos = np.array(body.home)
    qpos[body.n_arm :] = body.closed[body.n_arm :]
    np.testing.assert_allclose(grip_pose(body, qpos)[0], grip_pose(body, body.home)[0], atol=1e-9)


# -- the command -----------------------------------------------------------------------------------------------


def picker(person: Person, model: mujoco.MjModel, done: Callable[[], None]) -> Callable[[mujoco.MjData], None]:
    """Someone who picks the cube up by looking at the picture and tapping keys; `done` follows the last motion."""
    site, cube = model.site("gripper0_right_grip_site").id, model.body("cube_main").id
    phase, waited, start_z = 0, 0, 0.0

    def toward(error: np.ndarray) -> bool:
        """Tap towards a goal (x, y, z) in metres; whether it is reached."""
        keys = [(KEYS.up, KEYS.down), (KEYS.left, KEYS.right), (".", ";")]
        off = [pair[int(e > 0)] for pair, e in zip(keys, error, strict=True) if abs(e) > 0.006]
        person.tap(*off)
        return not off

    def script(data: mujoco.MjData) -> None:
        nonlocal phase, waited, start_z
        if data.time == 0.0:
            phase = waited = 0
            start_z = data.xpos[cube, 2]
            if person.pictures % 4:  # looks around before it begins
                return
        error = data.xpos[cube] - data.site_xpos[site]
        closing, edge = data.site_xmat[site].reshape(3, 3)[:2, 1], data.xmat[cube].reshape(3, 3)[:2, 0]
        turn = np.arctan2(edge[1], edge[0]) - np.arctan2(closing[1], closing[0])
        turn = (turn + np.pi / 4) % (np.pi / 2) - np.pi / 4
        if phase == 0:
            if abs(turn) > 0.04:
                person.tap("o" if turn > 0 else "p")
            phase += toward(error + [0, 0, 0.08]) and abs(turn) <= 0.04
        elif phase == 1:
            phase += toward(error)
            if phase == 2:
                person.tap(KEYS.space)
        elif phase == 2:
            waited += 1
            phase += waited > 6
        elif phase == 3:
            phase += toward(np.array([0, 0, start_z + 0.08 - data.xpos[cube, 2]]))
            if phase == 4:
                done()

    return script


def options(folder: Path, episodes: int) -> list[str]:
    return [f"--env={PANDA}", "--teleop=keyboard", f"--episodes={episodes}", "--seed=3", "--repo_id=me/hand"] + [
        f"--root={folder / 'hand'}",
        f"--json={folder / 'record.json'}",
    ]


def test_the_command_records_what_a_person_does(
    person: Person, envs: dict[str, CEIEnv], tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    """Gives up a first attempt, picks the cube up, and then, asked for another demonstration, presses Ctrl-C."""
    picked = False

    def done() -> None:
        nonlocal picked
        picked = True

    pick = picker(person, envs[PANDA].model, done)

    def script(data: mujoco.MjData) -> None:
        if person.pictures == 10:
            person.tap("q")
        elif picked and data.time == 0.0:
            os.kill(os.getpid(), signal.SIGINT)
        else:
            pick(data)

    person.script = script
    assert record.main(options(tmp_path, 2)) == 0
    output = capsys.readouterr().out
    assert output.count("Seed 3: never grasped; discarded. The same start again.\n") == 1
    assert "Interrupted after 1 of 2 demonstrations, which are kept." in output
    result = json.loads((tmp_path / "record.json").read_text())
    assert (result["episodes"], result["successes"]) == (1, 1)

    reader = DatasetReader("me/hand", tmp_path / "hand")
    stored = dict(reader.record(0))
    assert min(stored.pop("step_times_s")["each"]) > 0
    assert stored == {"seed": 3, "success": True, "teleop": "keyboard"}
    assert len(reader.records) == 1
    episode = reader.read(0)
    start, _ = envs[PANDA].reset(seed=3)
    np.testing.assert_array_equal(episode.qpos[0], start["agent_pos"])
    assert np.abs(episode.action[0] - episode.qpos[0]).max() > 1e-3  # no idle start
    dataset = ["--dataset.repo_id=me/hand", f"--dataset.root={tmp_path / 'hand'}"]
    assert replay.main([*dataset, "--video_episodes=0", f"--json={tmp_path / 'replay.json'}"]) == 0
    assert json.loads((tmp_path / "replay.json").read_text())["successes"] == 1


def test_ctrl_c_before_the_first_success_leaves_nothing(
    person: Person, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    lines = [lambda: person.tap(KEYS.up)] * 3 + [lambda: os.kill(os.getpid(), signal.SIGINT)]
    person.script = lambda data: lines.pop(0)()
    before = signal.getsignal(signal.SIGINT)
    assert record.main(options(tmp_path, 1)) == 130
    assert capsys.readouterr().err == "interrupted\n"
    assert list(tmp_path.iterdir()) == []
    assert signal.getsignal(signal.SIGINT) is before


def test_an_attempt_that_runs_out_of_time_is_discarded(capsys: pytest.CaptureFixture) -> None:
    env = gym.make(PANDA, max_episode_steps=2)
    attempts = []

    class Idler:
        stopped = False

        def actions(self, start: np.ndarray) -> Iterator[np.ndarray]:
            attempts.append(start)
            self.stopped = len(attempts) == 2
            while not self.stopped:
                yield start

    assert list(record.by_hand(env, [7], Idler(), "keyboard")) == []
    assert capsys.readouterr().out.endswith("Seed 7: never grasped; discarded. The same start again.\n")
    np.testing.assert_array_equal(*attempts)
    env.close()


# -- what may be missing ---------------------------------------------------------------------------------------


def refused(tmp_path: Path, capsys: pytest.CaptureFixture, teleop: str) -> str:
    assert (
        record.main([f"--env={PANDA}", f"--teleop={teleop}", "--repo_id=me/x", f"--root={tmp_path / 'a' / 'x'}"]) == 1
    )
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
    return error


def test_an_unknown_device_lists_the_valid_ones(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert "'keybord'. Did you mean 'keyboard'? Valid: keyboard, spacemouse." in refused(tmp_path, capsys, "keybord")


def test_no_display(tmp_path: Path, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DISPLAY", ":98765")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert "needs a display" in refused(tmp_path, capsys, "keyboard")


@pytest.mark.parametrize(("device", "packages"), [("keyboard", "pynput"), ("spacemouse", "pynput hidapi")])
def test_no_pynput(
    device: str,
    packages: str,
    no_devices: None,
    tmp_path: Path,
    capsys: pytest.CaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "pynput", None)
    assert f"pip install {packages}." in refused(tmp_path, capsys, device)


def test_no_hidapi(
    person: Person, tmp_path: Path, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "hid", None)
    assert "pip install pynput hidapi." in refused(tmp_path, capsys, "spacemouse")


def test_no_space_mouse(
    person: Person, tmp_path: Path, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(vendor: int, product: int) -> None:
        raise OSError("open failed")

    monkeypatch.setattr(sys.modules["hid"], "device", lambda: SimpleNamespace(open=fail))
    assert "the spacemouse cannot be opened (open failed): connect it" in refused(tmp_path, capsys, "spacemouse")


def test_a_hand_without_a_grip_site(person: Person, envs: dict[str, CEIEnv]) -> None:
    env = envs[PANDA]
    bare = replace(env.embodiment, model=mujoco.MjModel.from_xml_string("<mujoco/>"))
    with pytest.raises(CEIError, match="no site named 'grip_site'"):
        Teleoperator("keyboard", env.simulation, bare)
