"""`cei-robot show`: what a click does to pads, what is saved of them, and the page itself in a browser."""

import importlib.util
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import browser
import numpy as np
import pytest
from PIL import Image

from cei_converters.robot import command
from cei_converters.robot.markup import text
from cei_converters.robot.opening import open_robot
from cei_converters.robot.pad_editing import AUTO, CLICKED, Click, PadEditor, first_hit, outward_normal
from cei_converters.robot.pad_file import PadFile
from cei_converters.robot.pads_block import replace_pads
from cei_gym.embodiment import END_EFFECTORS, EndEffectorSpec, Pad, build_embodiment, load_end_effector, load_spec
from cei_gym.errors import CEIError
from cei_gym.kinematics import KinematicTree
from cei_gym.rendering import look_at, project

EVIL = "<i id=evil>right"
"""Name of a link that HTML and Markdown would make something of."""

HAND = """<mujoco>
 <worldbody>
  <body name="palm">
   <geom name="palm_box" type="box" size="0.05 0.03 0.03" rgba="0.2 0.2 0.8 1"/>
   <body name="left" pos="-0.04 0 0.08">
    <joint name="left_slide" type="slide" axis="1 0 0" range="0 0.03"/>
    <geom name="left_box" type="box" size="0.008 0.02 0.05" pos="0 0 0.01" rgba="0.8 0.2 0.2 1"/>
    <geom name="left_tip" type="box" size="0.008 0.02 0.01" pos="0 0 0.07" rgba="0.8 0.2 0.2 1"/>
   </body>
   <body name="EVIL" pos="0.04 0 0.08">
    <joint name="right_slide" type="slide" axis="-1 0 0" range="0 0.03"/>
    <geom name="right_box" type="box" size="0.008 0.02 0.05" pos="0 0 0.01" rgba="0.2 0.8 0.2 1"/>
    <geom name="right_seen" type="box" size="0.008 0.02 0.05" pos="0 0 0.011" contype="0" conaffinity="0" rgba="0.2 0.8 0.2 1"/>
   </body>
  </body>
 </worldbody>
</mujoco>
""".replace("EVIL", "&lt;i id=evil>right")

YAML = """# my hand
name: Jaw
description: jaw.xml
couplings:
  right_slide: {joint: left_slide} # one motor
closed: {left_slide: 0.03}
pads: # of its fingers
  # the left one
  - {body: left, geoms: [left_box], extent: [0, 0.9]} # not the tip
  - body: '<i id=evil>right'
    geoms:
      - right_box
compliance: 1.5 # after the pads
"""

needs_viser = pytest.mark.skipif(importlib.util.find_spec("viser") is None, reason="viser is not installed")
needs_browser = pytest.mark.skipif(browser.CHROMIUM is None, reason="needs Chromium")


@pytest.fixture
def jaw(tmp_path: Path) -> Path:
    """The YAML of a hand of one's own."""
    (tmp_path / "jaw.xml").write_text(HAND)
    path = tmp_path / "jaw.yaml"
    path.write_text(YAML)
    return path


# -- the block in the text -----------------------------------------------------------------------------------------


def pads_of(text: str) -> list[Pad]:
    import yaml

    return [Pad(**raw) for raw in yaml.safe_load(text)["pads"]]


def test_pads_that_are_as_they_were_change_nothing() -> None:
    assert replace_pads(YAML, list(enumerate(pads_of(YAML)))) == YAML


def test_a_pad_is_changed_where_it_stands_and_comments_stay() -> None:
    left, right = pads_of(YAML)
    new = replace_pads(YAML, [(0, replace(left, share=2.0, palmar=[1.0, 0.0, -0.25])), (1, right)])
    old = "  - {body: left, geoms: [left_box], extent: [0, 0.9]} # not the tip\n"
    assert new == YAML.replace(
        old,
        "  - {body: left, geoms: [left_box], share: 2, extent: [0, 0.9], palmar: [1, 0, -0.25]} # not the tip\n",
    )
    new = replace_pads(YAML, [(0, left), (1, replace(right, geoms=[]))])
    changed = "  - body: '<i id=evil>right'\n    geoms:\n      - right_box\n"
    assert new == YAML.replace(changed, "  - {body: <i id=evil>right}\n")


def test_pads_come_go_and_move() -> None:
    left, right = pads_of(YAML)
    head, rest = YAML.split("  # the left one\n")
    old_left, end, rest = rest.partition("# not the tip\n")
    old_left = f"  # the left one\n{old_left}{end}"
    tail = "compliance: 1.5 # after the pads\n"
    old_right = rest.removesuffix(tail)
    assert replace_pads(YAML, [(1, right)]) == head + old_right + tail
    assert replace_pads(YAML, [(1, right), (0, left)]) == head + old_right + old_left + tail
    new = "  - {body: palm, geoms: ['a, b']}\n"
    assert replace_pads(YAML, [(0, left), (None, Pad("palm", ["a, b"]))]) == head + old_left + new + tail
    none = replace_pads(YAML, [])
    assert none == head.replace("pads: #", "pads: [] #") + "  # the left one\n" + tail
    assert replace_pads(none, [(None, Pad("palm"))]) == f"{head}  - {{body: palm}}\n  # the left one\n{tail}"


@pytest.mark.parametrize(
    "name", ["on", "08", "1e5", "null", "a: b", "#x", "é", "a'\"b", "[x]", "~", "0x1F", "1:30", "=", "\t", "&a"]
)
def test_whatever_a_link_is_called_is_read_back(name: str) -> None:
    from cei_gym.untrusted import load_yaml

    new = replace_pads(YAML, [(None, Pad(name, [name]))])
    assert load_yaml(new)["pads"] == [{"body": name, "geoms": [name]}]


def test_line_ends_and_the_last_line_stay_as_they_are() -> None:
    left, right = pads_of(YAML)
    more = [(0, left), (1, replace(right, share=3.0)), (None, Pad("palm"))]
    text = YAML.removesuffix("compliance: 1.5 # after the pads\n").removesuffix("\n")
    new = replace_pads(text, more)
    assert new.startswith(text.partition("  - body:")[0]) and new.endswith("  - {body: palm}")
    windows = YAML.replace("\n", "\r\n")
    assert replace_pads(windows, more) == replace_pads(YAML, more).replace("\n", "\r\n")


@pytest.mark.parametrize("name", END_EFFECTORS)
def test_the_yamls_that_ship_are_written_as_they_are(name: str) -> None:
    spec = load_end_effector(name)
    text = (Path(spec.folder) / f"{name}.yaml").read_text()
    assert replace_pads(text, list(enumerate(spec.pads))) == text


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name: x\n", "no `pads` of its own"),
        ("- a\n", "no `pads` of its own"),
        ("a: &x [{body: b}]\npads: *x\n", "is an alias"),
        ("{name: x, pads: [], closed: {a: 1}}\n", "write them by hand"),
        ("pads:\n  - &a {body: b}\nmore: *a\n", "write them by hand"),
        ("pads: [\n", "expected"),
    ],
)
def test_what_cannot_be_written_into_is_refused(text: str, message: str) -> None:
    with pytest.raises(CEIError, match=re.escape(message)):
        replace_pads(text, [(None, Pad("q"))])


# -- clicks --------------------------------------------------------------------------------------------------------


def test_a_ray_meets_the_nearest_triangle_and_its_normal_looks_back() -> None:
    near = np.array([[0.0, 0, 1], [1, 0, 1], [0, 1, 1]])
    triangles = np.stack([near + [0, 0, 1], near, near[::-1] - [0, 0, 2]])
    for direction, face, along in (([0.0, 0, 1], 1, 1.0), ([0.0, 0, -1], 2, 1.0)):
        ray = np.array(direction)
        assert first_hit(triangles, np.array([0.2, 0.2, 0]), ray) == (face, along)
        np.testing.assert_allclose(outward_normal(triangles[face], ray), -ray)
    assert first_hit(triangles, np.array([0.8, 0.8, 0]), np.array([0.0, 0, 1])) is None
    assert first_hit(triangles, np.array([0.2, 0.2, 0]), np.array([1.0, 0, 0])) is None


def click(editor: PadEditor, embodiment, link: str, geom: str, normal=(1.0, 0.0, 0.0)) -> None:
    geoms = [embodiment.model.geom(i).name for i in range(embodiment.model.ngeom)]
    editor.click(Click(embodiment.body_id(link), geoms.index(f"ee/{geom}"), np.array(normal)))


def test_clicks_choose_link_and_surfaces(jaw: Path) -> None:
    embodiment = open_robot(str(jaw)).embodiment
    editor = PadEditor(embodiment)
    with pytest.raises(CEIError, match="no pad is chosen"):
        click(editor, embodiment, "left", "left_tip")
    editor.choose(0)
    click(editor, embodiment, "left", "left_tip")
    assert editor.pad == Pad("left", ["left_box", "left_tip"], extent=[0, 0.9])
    click(editor, embodiment, "left", "left_box")
    assert editor.pad.geoms == ["left_tip"]
    click(editor, embodiment, EVIL, "right_box")
    assert (editor.pad.body, editor.pad.geoms) == (EVIL, ["right_box"])
    click(editor, embodiment, EVIL, "right_seen")  # of another kind
    assert editor.pad.geoms == ["right_seen"]
    click(editor, embodiment, EVIL, "right_seen")
    assert editor.pad.geoms == []
    assert editor.pads[1] == (1, pads_of(YAML)[1])


def test_a_click_says_which_way_a_pad_faces_where_it_is_asked(jaw: Path) -> None:
    embodiment = open_robot(str(jaw)).embodiment
    editor = PadEditor(embodiment)
    editor.choose(0)
    with pytest.raises(CEIError, match="click on the pad's surface"):
        editor.face(CLICKED)
    click(editor, embodiment, "left", "left_box", (0.0, 0.6, 0.80001))
    assert (editor.pad.palmar, editor.pad.geoms) == ([0.0, 0.6, 0.8], ["left_box"])  # none is taken away
    editor.face(AUTO)
    assert editor.pad.palmar == "auto"
    editor.face(CLICKED)  # where it was clicked last
    assert editor.pad.palmar == [0.0, 0.6, 0.8]
    editor.choose(1)
    assert not editor.follows_clicks
    editor.choose(0)
    assert editor.follows_clicks


def test_new_pads_have_points_once_they_are_clicked(jaw: Path) -> None:
    embodiment = open_robot(str(jaw)).embodiment
    editor = PadEditor(embodiment)
    assert len(editor.sample(0, 128)) == 64
    editor.add()
    for unfinished in (lambda: editor.sample(2, 128), editor.finished):
        with pytest.raises(CEIError, match="click on the surface"):
            unfinished()
    click(editor, embodiment, "palm", "palm_box")
    with pytest.raises(CEIError, match="no joint that moves it"):
        editor.sample(2, 128)
    editor.face(CLICKED)
    editor.change(share=2.0)
    pad = editor.sample(2, 128)
    assert len(pad) == 64
    np.testing.assert_allclose(pad.normals_link, np.broadcast_to([1.0, 0, 0], (64, 3)))
    editor.choose(0)
    editor.change(extent=(0.5, 0.75))
    assert np.ptp(editor.sample(0, 128).points_link[:, 2]) < 0.26 * 0.1
    editor.remove()
    assert editor.chosen is None and [source for source, _ in editor.pads] == [1, None]
    for _ in range(2):
        editor.choose(0)
        editor.remove()
    with pytest.raises(CEIError, match="without pads"):
        editor.finished()


def test_pads_are_not_on_the_arm() -> None:
    embodiment = open_robot("Panda-PandaGripper").embodiment
    editor = PadEditor(embodiment)
    editor.choose(0)
    with pytest.raises(CEIError, match="is a link of the arm"):
        editor.click(Click(1, 0, np.array([1.0, 0, 0])))


# -- the file ------------------------------------------------------------------------------------------------------


def test_the_yaml_is_saved_again_and_again(jaw: Path) -> None:
    jaw.write_bytes(YAML.replace("\n", "\r\n").encode())
    file, pads = PadFile(jaw), list(enumerate(pads_of(YAML)))
    for share in (2.0, 3.0):
        pads = file.save([(None, Pad("left", ["left_tip"])), (1, replace(pads[1][1], share=share)), *pads[2:]][-2:])
        assert f"share: {share:g}}}\r\ncompliance: 1.5 # after the pads\r\n" in jaw.read_bytes().decode()
    assert load_spec(EndEffectorSpec, jaw).pads == [pad for _, pad in pads]
    assert sorted(path.name for path in jaw.parent.iterdir()) == ["jaw.xml", "jaw.yaml"]


def test_what_would_not_load_is_not_saved(jaw: Path) -> None:
    file = PadFile(jaw)
    for pad, message in ((Pad("middle"), "unknown link"), (Pad("left", extent=[0.5, 0.2]), "`extent` must be")):
        with pytest.raises(CEIError, match=message):
            file.save([(None, pad)])
    jaw.write_text(YAML + "# mine\n")
    with pytest.raises(CEIError, match="changed by somebody else"):
        file.save([(None, Pad("left"))])
    assert jaw.read_text() == YAML + "# mine\n"
    assert sorted(path.name for path in jaw.parent.iterdir()) == ["jaw.xml", "jaw.yaml"]


def test_what_ships_is_not_overwritten_and_a_copy_is(tmp_path: Path) -> None:
    robot = open_robot("UR5e-PandaGripper")
    assert robot.end_effector_file is not None
    before = robot.end_effector_file.read_bytes()
    pads = list(enumerate(load_end_effector("PandaGripper").pads))
    with pytest.raises(CEIError, match="ships with CEI-Gym and is not overwritten; start with --output="):
        PadFile(robot.end_effector_file).save(pads)
    with pytest.raises(CEIError, match="ships with CEI-Gym"):
        PadFile(robot.end_effector_file, robot.end_effector_file, overwrite=True)
    copy = tmp_path / "mine" / "Gripper.yaml"
    file = PadFile(robot.end_effector_file, copy)
    for _ in range(2):  # its own file is replaced
        pads = file.save(pads)
        assert copy.read_bytes() == before == robot.end_effector_file.read_bytes()
    with pytest.raises(CEIError, match="already exists"):
        PadFile(robot.end_effector_file, copy)


def test_a_copy_that_does_not_find_its_description_is_refused(jaw: Path) -> None:
    elsewhere = jaw.parent / "other" / "jaw.yaml"
    with pytest.raises(CEIError, match=r"jaw\.xml"):
        PadFile(jaw, elsewhere).save(list(enumerate(pads_of(YAML))))
    assert not elsewhere.parent.exists()


# -- which robot ---------------------------------------------------------------------------------------------------


def test_robots_go_by_name_or_file(jaw: Path, tmp_path: Path) -> None:
    assert open_robot("Panda").embodiment.end_effector is None
    assert open_robot("PandaGripper").embodiment.arm is None
    assert open_robot("Panda-PandaGripper").embodiment.name == "Panda-PandaGripper"
    assert open_robot(str(jaw)).end_effector_file == jaw
    arm = tmp_path / "arm.yaml"
    arm.write_text("name: A\ndescription: jaw.xml\nmount_body: left\nhome: {}\n")
    assert open_robot(str(arm)).embodiment.arm is not None
    (tmp_path / "x.yaml").write_text("name: x\n")
    for robot, message in (
        ("Pandas", "unknown robot 'Pandas'. Did you mean 'Panda'?"),
        (str(tmp_path / "y.yaml"), "no such file"),
        (str(tmp_path / "x.yaml"), "this has neither"),
        ("~no.such.user/x.yaml", "there is no such user"),
    ):
        with pytest.raises(CEIError, match=re.escape(message)):
            open_robot(robot)


def test_bad_options_are_one_line_each(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        for args, code, message in (
            (["Panda", f"--port={port}"], 1, f"--port={port} is taken; choose another"),
            (["Panda", "--port=70000"], 2, "--port=70000 should be at least 0"),
            (["Panda", "--port=0", "--host=nowhere.invalid"], 1, "no address of this machine"),
            (["Panda", "--port=0", "--host=192.0.2.1"], 1, "no address of this machine"),
            (["Nobody", "--port=0"], 1, "unknown robot 'Nobody'"),
            (["Panda", "--port=0", "--overwrite"], 2, "of no use without --output"),
            (["Panda", "--port=0", f"--output={tmp_path}/x.yaml"], 1, "--output is of no use with Panda"),
            (["PandaGripper", "--port=0", f"--output={tmp_path}/x.png"], 1, "should end in .yaml"),
            ([], 2, "--robot is required"),
        ):
            assert command.main(["show", *args]) == code, args
            error = capsys.readouterr().err
            assert error.startswith("error: ") and error.count("\n") == 1
            assert message in error
    assert list(tmp_path.iterdir()) == []


def test_without_viser_it_says_how_to_install_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.setattr("cei_gym.extras.installed", lambda module: module != "viser")
    assert command.main(["show", "Panda"]) == 1
    assert capsys.readouterr().err == 'error: cei-robot show needs viser: pip install "cei-gym[show]".\n'


# -- the page ------------------------------------------------------------------------------------------------------


def test_text_means_nothing_but_itself() -> None:
    assert "<img" not in text("<img src=x>", ("<b>", '"><script>')) + text("{alert(1)}", colour="#444")
    assert text("", "") == ""


@contextmanager
def shown(robot: str, file: Path | None, profile: Path) -> Iterator[tuple]:
    """A robot's page: as it is known here, in the browser, and where on the page points of its base frame are."""
    from cei_converters.robot.page import Page, Server

    opened = open_robot(robot)
    source = file or opened.end_effector_file
    server = Server(host="localhost", port=0, verbose=False)
    try:
        page = Page(server, opened.embodiment, None if source is None else PadFile(source))
        with browser.browse(f"http://localhost:{server.get_port()}/", profile) as tab:
            tab.wait(
                "document.body?.innerText.includes('Reset all joints') && document.querySelector('canvas') !== null"
            )
            while not (clients := server.get_clients()):
                time.sleep(0.1)
            eye, wanted = next(iter(clients.values())).camera, server.initial_camera
            while not (np.allclose(eye.position, wanted.position) and np.isclose(eye.fov, wanted.fov)):
                time.sleep(0.1)

            def pixel(point) -> tuple[float, float]:
                camera = look_at("", eye.position, eye.look_at, 1280, 800, np.degrees(eye.fov))
                (v, u), _ = (each[0] for each in project(np.array([point]), camera))
                return float(u), float(v)

            yield opened.embodiment, page, tab, pixel
    finally:
        server.stop()


def colour(tab: browser.Page, path: Path, at: tuple[float, float]) -> np.ndarray:
    tab.picture(path)
    return np.asarray(Image.open(path).convert("RGB"), int)[round(at[1]), round(at[0])]


def seen(tab: browser.Page, path: Path, at: tuple[float, float], what: str) -> None:
    """Wait until a pixel is redder, or greener, than anything else; or of the light background."""
    end = time.monotonic() + browser.PATIENCE_S
    while True:
        rgb = colour(tab, path, at)
        is_light = rgb.min() > 200
        if (what == "light" and is_light) or (what != "light" and not is_light and "rgb"[rgb.argmax()] == what[0]):
            return
        assert time.monotonic() < end, f"{what} is {rgb} at {at} of {path}"
        time.sleep(0.2)


@needs_viser
@needs_browser
def test_pads_are_edited_in_a_browser(jaw: Path, tmp_path: Path) -> None:
    with shown(str(jaw), None, tmp_path / "profile") as (embodiment, page, tab, pixel):
        shot = tmp_path / "page.png"
        T = KinematicTree(embodiment).forward(embodiment.home)
        left, right = (T[embodiment.body_id(link), :3, 3] for link in ("left", EVIL))
        beside_left, outside_right = left - [0.0, 0.02, 0.0], right + [0.008, -0.01, 0.02]
        seen(tab, shot, pixel(beside_left), "red")
        seen(tab, shot, pixel(outside_right), "green")
        # a joint, and the one that follows it
        x, y = tab.place("left_slide (m)", "[role=slider]")
        tab.mouse("mouseMoved", x, y)
        tab.mouse("mousePressed", x, y, button="left", buttons=1, clickCount=1)
        for step in range(1, 11):
            tab.mouse("mouseMoved", x + 20 * step, y, button="left", buttons=1)
        tab.mouse("mouseReleased", x + 200, y, button="left", clickCount=1)
        seen(tab, shot, pixel(left + [-0.007, -0.02, 0.03]), "light")
        np.testing.assert_allclose(page.qpos, [0.03, 0.03])
        tab.press("Reset all joints")
        seen(tab, shot, pixel(beside_left), "red")
        np.testing.assert_allclose(page.qpos, [0, 0])
        tab.press("half")
        seen(tab, shot, pixel(left + [-0.007, -0.02, 0.03]), "light")
        np.testing.assert_allclose(page.qpos, [0.015, 0.015])
        tab.press("home")
        # the first pad goes to the other finger, and faces outwards
        tab.press("Pads")
        tab.press("edit pad", "input")
        tab.press("1: left")
        tab.wait("document.body.innerText.includes('link: left')")
        tab.press("palmar", "input")
        tab.press(CLICKED)
        tab.wait("document.body.innerText.includes('click on the pad')")
        tab.click(*pixel(outside_right))
        tab.wait("document.body.innerText.includes('along [1.0, 0.0, 0.0]')")
        tab.wait(f"document.body.innerText.includes('link: {EVIL}')")  # as it is written
        assert tab.evaluate("document.getElementById('evil') === null")
        assert "surfaces: right_seen" in tab.text()
        # what is wrong is said
        tab.press("New pad")
        tab.wait("document.body.innerText.includes('link: -')")
        tab.press("Save")
        tab.wait("document.body.innerText.includes('pad 3 has no link yet')")
        assert jaw.read_text() == YAML
        tab.press("Remove this pad")
        tab.wait("document.body.innerText.includes('Choose a pad')")
        tab.press("Save")
        tab.wait("document.body.innerText.includes('Saved to')")
    old = "{body: left, geoms: [left_box], extent: [0, 0.9]}"
    new = "{body: <i id=evil>right, geoms: [right_seen], extent: [0, 0.9], palmar: [1, 0, 0]}"
    assert jaw.read_text() == YAML.replace(old, new)
    assert load_spec(EndEffectorSpec, jaw).pads[0].palmar == [1, 0, 0]
    build_embodiment(None, load_spec(EndEffectorSpec, jaw))


@needs_viser
def test_it_runs_until_it_is_told_to_end(jaw: Path) -> None:
    args = [sys.executable, "-c", "import sys; from cei_converters import start; sys.exit(start.robot())"]
    process = subprocess.Popen(
        [*args, "show", str(jaw), "--port=0"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    said = process.stdout.readline()
    found = re.fullmatch(r"Jaw is shown at http://localhost:(\d+)/ until you press Ctrl-C\.\n", said)
    assert found, said
    with socket.create_connection(("localhost", int(found[1]))) as visitor:
        visitor.sendall(b"HEAD / HTTP/1.1\r\n\r\n")  # which viser does not know
        visitor.recv(100)
    process.send_signal(signal.SIGINT)
    assert process.communicate(timeout=60) == ("", "interrupted\n")
    assert process.returncode == 130
