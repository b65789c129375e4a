"""Descriptions by the names that robot_descriptions and mujoco-menagerie gave them: found, downloaded whole or not at all, and said in one line if not."""

import dataclasses
import hashlib
import socket
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from cei_gym.embodiment import ArmSpec, Embodiment, EndEffectorSpec, build_embodiment, fingerprint, load_spec, named
from cei_gym.embodiment.resources import locate
from cei_gym.errors import CEIError

pytest.importorskip("robot_descriptions")
menagerie = pytest.importorskip("mujoco_menagerie")

INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
LINKS = f'<link name="base">{INERTIAL}</link><link name="flange">{INERTIAL}{{}}</link>'
JOINT = (
    '<joint name="j" type="revolute"><parent link="base"/><child link="flange"/><axis xyz="0 0 1"/>'
    '<limit lower="-1" upper="1" effort="1" velocity="{}"/></joint>'
)
URDF = f'<robot name="r">{LINKS.format("")}{JOINT.format(1)}</robot>'
MJCF = """<mujoco><worldbody><body name="base"><geom size=".1"/><body name="flange"><joint name="j" range="-1 1"/><geom size=".1"/></body></body>
</worldbody></mujoco>"""
SCENE = '<mujoco><include file="panda.xml"/><worldbody><geom type="plane" size="1 1 1"/></worldbody></mujoco>'
XACRO = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="$(arg name)"><xacro:arg name="name"/><xacro:arg name="ur_type"/>
<xacro:arg name="speed" default="1"/><xacro:include filename="$(find ur_description)/urdf/macro.xacro"/>
<xacro:arm type="$(arg ur_type)"/></robot>"""
MACRO = f"""<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="arm" params="type">
{LINKS.format("")}<xacro:if value="${{type == 'ur5e'}}">{JOINT.format("$(arg speed)")}</xacro:if></xacro:macro></robot>"""

REPOSITORIES = {
    "Gepetto/example-robot-data": {"robots/panda_description/urdf/panda.urdf": URDF},
    "UniversalRobots/Universal_Robots_ROS2_Description": {"urdf/ur.urdf.xacro": XACRO, "urdf/macro.xacro": MACRO},
    "flexivrobotics/flexiv_description": {"urdf/flexiv.urdf.xacro": XACRO},
    "deepmind/mujoco_menagerie": {"universal_robots_ur5e/ur5e.xml": MJCF},
}


def write(folder: Path, files: dict[str, str]) -> None:
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(content)


def git(*words: str | Path) -> None:
    subprocess.run(["git", *map(str, words)], check=True, capture_output=True)


def redirect(monkeypatch: pytest.MonkeyPatch, to: str) -> None:
    """Have git look elsewhere for what is on GitHub."""
    monkeypatch.setenv("GIT_CONFIG_COUNT", "2")
    monkeypatch.setenv("GIT_CONFIG_KEY_0", f"url.{to}/.insteadOf")
    monkeypatch.setenv("GIT_CONFIG_VALUE_0", "https://github.com/")
    monkeypatch.setenv("GIT_CONFIG_KEY_1", "protocol.file.allow")
    monkeypatch.setenv("GIT_CONFIG_VALUE_1", "always")


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Empty caches of both packages, and nobody to download from."""
    monkeypatch.setenv(named.CACHE, str(tmp_path / "cache"))
    monkeypatch.setenv("MENAGERIE_CACHE_DIR", str(tmp_path / "menagerie"))
    for variable in ("MENAGERIE_ROOT", "MENAGERIE_BASE_URL", "ROBOT_DESCRIPTION_COMMIT"):
        monkeypatch.delenv(variable, raising=False)
    redirect(monkeypatch, (tmp_path / "nowhere").as_uri())
    monkeypatch.setenv("MENAGERIE_BASE_URL", (tmp_path / "nowhere").as_uri())
    return tmp_path / "cache"


@pytest.fixture
def github(tmp_path: Path) -> Path:
    """Repositories, each with a tag `v1`."""
    for name, files in REPOSITORIES.items():
        work = tmp_path / "work" / name
        write(work, files)
        git("init", "-q", work)
        git("-C", work, "add", "-A")
        git("-C", work, "-c", "user.name=a", "-c", "user.email=a@b", "commit", "-q", "-m", "a")
        git("-C", work, "tag", "v1")
        git("clone", "-q", "--bare", work, tmp_path / "github" / f"{name}.git")
    return tmp_path / "github"


@pytest.fixture
def online(cache: Path, github: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The cache, where there is something to download."""
    redirect(monkeypatch, github.as_uri())
    monkeypatch.setenv("ROBOT_DESCRIPTION_COMMIT", "v1")
    return cache


@pytest.fixture
def silent() -> Iterator[str]:
    """Address of a server that takes calls and says nothing."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield f"http://127.0.0.1:{server.getsockname()[1]}"


def arm(folder: Path, description: str, **fields: object) -> Embodiment:
    folder.mkdir(exist_ok=True)
    (folder / "arm.yaml").write_text(
        yaml.safe_dump({"name": "Arm", "description": description, "mount_body": "flange", "home": {}, **fields})
    )
    return build_embodiment(load_spec(ArmSpec, folder / "arm.yaml"), None)


def refusal(uri: str) -> str:
    with pytest.raises(CEIError) as error:
        locate(uri, Path())
    message = str(error.value)
    assert "\n" not in message and len(message) < 800 and "Traceback" not in message
    return message


def entries(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []


# -- names -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("uri", "nearest"),
    [
        ("robot_descriptions:panda", "panda_description"),
        ("robot_descriptions:ur5_mj_description", "ur5e_mj_description"),
        ("robot_descriptions:../../x", "of its"),
        ("robot_descriptions:os", "of its"),
        ("robot_descriptions:_cache", "of its"),
        ("robot_descriptions:loaders.mujoco", "of its"),
        ("robot_descriptions:", "of its"),
        ("mujoco_menagerie:franka_panda", "franka_emika_panda"),
        ("mujoco_menagerie:franka_emika_panda/hnd", "hand"),
        ("mujoco_menagerie:franka_emika_panda/../../x", "of its"),
        ("mujoco_menagerie:", "of its"),
    ],
)
def test_an_unknown_name_lists_the_nearest_and_downloads_nothing(cache: Path, uri: str, nearest: str) -> None:
    message = refusal(uri)
    assert nearest in message and message.startswith(uri.partition(":")[0])
    assert not cache.exists() and not cache.with_name("menagerie").exists()


def test_other_colons_are_paths(cache: Path, tmp_path: Path) -> None:
    (tmp_path / "other:name.urdf").write_text(URDF)
    assert locate("other:name.urdf", tmp_path).path.name == "other:name.urdf"


@pytest.mark.parametrize("package", ["robot_descriptions", "mujoco_menagerie"])
def test_without_the_package_the_extra_is_named(package: str) -> None:
    code = f"""import sys; sys.modules[{package!r}] = None
from pathlib import Path
from cei_gym.embodiment.resources import locate
try: locate("{package}:x", Path())
except Exception as error: print(type(error).__name__, error)"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("MissingExtra") and 'pip install "cei-gym[descriptions]"' in done.stdout


# -- robot_descriptions ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "root"),
    [
        ("panda_description", "example-robot-data"),
        ("ur5e_description", "ur_description"),
        ("ur5e_mj_description", "mujoco_menagerie"),
    ],
)
def test_a_description_is_downloaded_once(
    online: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, root: str
) -> None:
    uri = f"robot_descriptions:{name}"
    first = arm(tmp_path / "a", uri)
    assert first.joint_names == ("j",)
    place = locate(uri, Path())
    assert place.root == online / f"{root}-v1" / root and place.path.is_relative_to(place.root)
    assert entries(online) == [f"{root}-v1"]  # and nothing of the download
    redirect(monkeypatch, "file:///nowhere")
    code = f"from pathlib import Path; from cei_gym.embodiment.resources import locate; print(locate({uri!r}, Path()).path)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == (f"{place.path}\n", "")


def test_what_it_is_does_not_depend_on_the_cache(online: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("panda_description", "ur5e_description"):
        monkeypatch.setenv(named.CACHE, str(online))
        here = fingerprint(arm(tmp_path / "a", f"robot_descriptions:{name}"))
        monkeypatch.setenv(named.CACHE, str(tmp_path / "an/other/cache"))
        assert fingerprint(arm(tmp_path / "a", f"robot_descriptions:{name}")) == here


def test_a_xacros_arguments_come_with_its_name_and_the_yaml_has_the_last_word(online: Path, tmp_path: Path) -> None:
    assert locate("robot_descriptions:ur5e_description", Path()).xacro_args == {"ur_type": "ur5e", "name": "ur5e"}
    assert arm(tmp_path / "a", "robot_descriptions:ur5e_description").max_velocity == pytest.approx([1])
    fast = arm(tmp_path / "a", "robot_descriptions:ur5e_description", xacro_args={"speed": 3})
    assert fast.max_velocity == pytest.approx([3])
    with pytest.raises(CEIError, match="hang on no joint"):
        arm(tmp_path / "a", "robot_descriptions:ur5e_description", xacro_args={"ur_type": "ur10e"})


def test_packages_that_a_xacro_needs_come_with_its_name(online: Path) -> None:
    place = locate("robot_descriptions:rizon4_description", Path())
    assert place.packages[0] == place.root == place.package("flexiv_description")


def test_offline_is_one_line_and_leaves_nothing(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    message = refusal("robot_descriptions:panda_description")
    assert "cannot be downloaded" in message and "example-robot-data" in message and "path" in message
    assert entries(cache) == []


def test_without_a_network_it_says_which_project_did_not_answer(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As it is where tests are run without a network; with one, an address that is nobody's."""
    redirect(monkeypatch, "https://github.invalid")
    message = refusal("robot_descriptions:panda_description")
    assert "https://github.invalid/Gepetto/example-robot-data.git" in message and "resolve host" in message
    assert entries(cache) == []


def test_a_failed_download_does_not_spoil_the_next(
    cache: Path, github: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROBOT_DESCRIPTION_COMMIT", "v1")
    refusal("robot_descriptions:panda_description")
    redirect(monkeypatch, github.as_uri())
    assert arm(tmp_path / "a", "robot_descriptions:panda_description").joint_names == ("j",)
    monkeypatch.setenv("ROBOT_DESCRIPTION_COMMIT", "v2")
    assert "v2" in refusal("robot_descriptions:panda_description")
    assert entries(cache) == ["example-robot-data-v1"]


def test_what_the_packages_own_failed_download_left_is_mended(
    cache: Path, github: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROBOT_DESCRIPTION_COMMIT", "v1")
    code = "import robot_descriptions.panda_description"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, check=False).returncode != 0
    assert entries(cache) == ["example-robot-data-v1"]
    redirect(monkeypatch, github.as_uri())
    assert arm(tmp_path / "a", "robot_descriptions:panda_description").joint_names == ("j",)


def test_a_silent_server_is_given_up(cache: Path, silent: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(named, "NO_ANSWER_S", 2.0)
    redirect(monkeypatch, silent)
    message = refusal("robot_descriptions:panda_description")
    assert "its project 'example-robot-data' sent nothing for 2 s" in message
    assert entries(cache) == []


def test_a_cache_that_may_only_be_read_is_read(online: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = locate("robot_descriptions:panda_description", Path()).path
    make = tempfile.mkdtemp

    def read_only(prefix: str, dir: Path | None = None) -> str:
        if dir is not None:
            raise PermissionError
        return make(prefix=prefix)

    monkeypatch.setattr(tempfile, "mkdtemp", read_only)
    monkeypatch.setenv("HOME", str(tmp_path))  # so that it is asked again
    assert locate("robot_descriptions:panda_description", Path()).path == path


def test_a_cache_that_is_no_folder(online: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(named.CACHE, str(tmp_path / "file"))
    assert "cannot be written" in refusal("robot_descriptions:panda_description")


def test_a_description_may_read_its_repository_and_nothing_else(
    online: Path, github: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = locate("robot_descriptions:panda_description", Path())
    for mesh, said in (("../../../../outside.stl", "outside"), ("../../../shared.stl", "no such file")):
        geom = f'<visual><geometry><mesh filename="{mesh}"/></geometry></visual>'
        place.path.write_text(f'<robot name="r">{LINKS.format(geom)}{JOINT.format(1)}</robot>')
        with pytest.raises(CEIError, match=said):
            arm(tmp_path / "a", "robot_descriptions:panda_description")


# -- mujoco-menagerie --------------------------------------------------------------------------------------------------

MODEL = {"panda.xml": MJCF, "hand.xml": MJCF, "scene.xml": SCENE}


def test_a_checkout_of_the_menagerie(cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MENAGERIE_ROOT", str(tmp_path / "checkout"))
    assert "MENAGERIE_ROOT" in refusal("mujoco_menagerie:franka_emika_panda")
    write(tmp_path / "checkout/franka_emika_panda", MODEL)
    place = locate("mujoco_menagerie:franka_emika_panda", Path())
    assert place.path.name == "panda.xml" and place.root == tmp_path / "checkout/franka_emika_panda"
    assert locate("mujoco_menagerie:franka_emika_panda/hand", Path()).path.name == "hand.xml"
    assert arm(tmp_path / "a", "mujoco_menagerie:franka_emika_panda").joint_names == ("j",)


def test_a_model_that_is_cached(cache: Path, tmp_path: Path) -> None:
    folder = menagerie.Cache().model_path(menagerie.get("franka_emika_panda"))
    write(folder, {**MODEL, ".complete": "{}"})
    assert arm(tmp_path / "a", "mujoco_menagerie:franka_emika_panda").joint_names == ("j",)
    (tmp_path / "a/hand.yaml").write_text(
        yaml.safe_dump({"name": "H", "description": "mujoco_menagerie:franka_emika_panda/hand", "pads": []})
    )
    assert build_embodiment(None, load_spec(EndEffectorSpec, tmp_path / "a/hand.yaml")).joint_names == ("j",)


def test_a_model_is_downloaded_whole(cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    robot = menagerie.get("franka_emika_panda")
    write(tmp_path / "made/franka_emika_panda", MODEL)
    archive = tmp_path / "server" / robot.asset
    archive.parent.mkdir()
    with tarfile.open(archive, "w:xz") as tar:
        tar.add(tmp_path / "made/franka_emika_panda", "franka_emika_panda")
    content = archive.read_bytes()
    robot = dataclasses.replace(robot, sha256=hashlib.sha256(content).hexdigest(), download_size=len(content))
    monkeypatch.setattr(menagerie, "get", lambda name: robot)
    message = refusal("mujoco_menagerie:franka_emika_panda")
    assert "cannot be downloaded" in message and robot.asset in message
    monkeypatch.setenv("MENAGERIE_BASE_URL", archive.parent.as_uri())
    archive.write_bytes(content[:-10])
    assert "digest" in refusal("mujoco_menagerie:franka_emika_panda")
    archive.write_bytes(content)
    assert arm(tmp_path / "a", "mujoco_menagerie:franka_emika_panda").joint_names == ("j",)


def test_a_menagerie_that_does_not_answer_is_given_up(
    cache: Path, silent: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(named, "NO_ANSWER_S", 0.5)
    monkeypatch.setenv("MENAGERIE_BASE_URL", silent)
    message = refusal("mujoco_menagerie:franka_emika_panda")
    assert "cannot be downloaded" in message and silent in message and "path" in message


def test_a_menagerie_that_is_not_there_is_one_line(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MENAGERIE_BASE_URL", "https://github.invalid/x")
    message = refusal("mujoco_menagerie:franka_emika_panda")
    assert "https://github.invalid/x/franka_emika_panda" in message and "cannot be downloaded" in message
