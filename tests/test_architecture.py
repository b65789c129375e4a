"""Which package may import which, what an import costs, and that no file names a registry."""

import ast
import importlib
import os
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import pytest
from numba.core.dispatcher import Dispatcher

import cei_gym

ROOT = Path(__file__).parents[1]
PACKAGES = {
    "cei_gym": ROOT / "cei_gym",
    "cei_envs": ROOT / "envs/cei_envs",
    "cei_converters": ROOT / "converters/cei_converters",
    "lerobot_env_cei": ROOT / "envs/lerobot_env_cei",
    "lerobot_policy_dp3": ROOT / "policies/lerobot_policy_dp3",
    "lerobot_robot_cei": ROOT / "robots/lerobot_robot_cei",
}
FORBIDDEN = {
    "cei_gym": {"robosuite", "lerobot", "datasets", "cei_envs", "cei_converters"},
    "cei_envs": {"lerobot", "datasets", "torch", "cei_converters"},
    "cei_converters": {"robosuite", "mujoco", "lerobot_env_cei", "lerobot_policy_dp3", "lerobot_robot_cei"},
    "lerobot_env_cei": {"robosuite", "mujoco", "lerobot_policy_dp3"},
    # of use to anybody who has point clouds in LeRobot datasets
    "lerobot_policy_dp3": {"cei_gym", "cei_envs", "cei_converters", "lerobot_env_cei", "lerobot_robot_cei"},
    # a robot's computer has no simulator
    "lerobot_robot_cei": {"robosuite", "mujoco", "cei_envs", "lerobot_env_cei", "lerobot_policy_dp3"},
}
# Only solvers that are asked for by name need torch: everything else works without.
TORCH = {
    "cei_gym/alignment/solvers/device.py",
    "cei_gym/alignment/solvers/newton_torch.py",
    "cei_gym/alignment/solvers/paper.py",
    "cei_gym/alignment/solvers/torch_model.py",
    "cei_gym/alignment/solvers/torch_records.py",
    "cei_gym/kinematics/torch_chain.py",
}


def sources(package: str) -> list[Path]:
    found = sorted(PACKAGES[package].rglob("*.py"))
    assert found
    return found


def imports(path: Path, top_level: bool = False) -> set[str]:
    """Dotted names that a file imports; with `top_level`, only those that importing the file imports."""
    tree = ast.parse(path.read_text())
    nodes = list(ast.walk(tree))
    if top_level:
        inside = {
            id(child)
            for node in nodes
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
            for child in ast.walk(node)
        }
        nodes = [node for node in nodes if id(node) not in inside]
    names = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are absolute"
            names |= {node.module or "", *(f"{node.module}.{alias.name}" for alias in node.names)}
    return names


def loaded(code: str) -> set[str]:
    """Top-level modules of a fresh interpreter after some code."""
    code += "\nimport sys; print(*sorted({name.partition('.')[0] for name in sys.modules}))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=dict(os.environ))
    assert result.returncode == 0, result.stderr
    return set(result.stdout.splitlines()[-1].split())


@pytest.mark.parametrize("package", PACKAGES)
def test_packages_keep_to_their_layer(package: str) -> None:
    for path in sources(package):
        tops = {name.partition(".")[0] for name in imports(path)}
        assert not tops & FORBIDDEN[package], path


def test_torch_is_only_where_solvers_need_it() -> None:
    users = {
        path.relative_to(ROOT).as_posix()
        for path in sources("cei_gym")
        if {"torch", "pytorch_kinematics"} & {name.partition(".")[0] for name in imports(path)}
    }
    assert users <= TORCH
    for path in sources("cei_gym"):
        if path.relative_to(ROOT).as_posix() not in TORCH:
            reached = imports(path, top_level=True)
            assert not {"cei_gym.alignment.solvers.paper", "cei_gym.kinematics.torch_chain"} & reached, path


LAYERS = {
    "cei_gym": [
        *("errors", "arrays", "compiled", "extras", "plugins", "untrusted", "untrusted_xml", "absent", "channels"),
        *("displacement", "demonstration"),
        *("embodiment", "rendering", "environment", "kinematics", "functional", "pointcloud", "alignment"),
        *("augmentation", "transfer", "twin", "painting", "impersonation", "wrapper", "onboarding"),
    ],
    "cei_gym.onboarding": [
        *(
            "structure",
            "digits",
            "overlaps",
            "fingers",
            "closing",
            "search",
            "sides",
            "mounting",
            "padding",
            "hand",
            "arm",
            "propose",
        ),
        *("writing", "check"),
    ],
    "cei_gym.embodiment": [
        *(
            "names",
            "checked",
            "servo",
            "spec",
            "named",
            "resources",
            "xacro",
            "mesh_files",
            "colours",
            "elements",
            "couplings",
            "coupled",
            "includes",
        ),
        *("assets", "meshes", "mjcf", "urdf", "compiling", "description", "embodiment", "joining", "building"),
        *("catalogue", "identity", "drives"),
    ],
    "cei_gym.twin": [
        *("options", "evidence", "calibration", "shape", "hold", "seen", "complete", "fit", "hulls"),
        *("couplings", "robot", "scene", "play", "twin"),
    ],
    "cei_gym.painting": [
        "view",
        "behind",
        "light",
        "carried",
        "composite",
        "calibrated",
        "painter",
        "live",
        "clicks",
        "camera_fit",
        "edges",
        "outline_fit",
    ],
    "cei_gym.alignment": [
        *("registry", "options", "kernels", "grip", "manual", "problem", "links", "contact", "solvers", "judge"),
        *("retime", "follow", "start", "stream"),
    ],
    "cei_gym.alignment.kernels": [
        *("step", "target", "quadratic", "distance", "collision", "overlap", "frame", "contact", "grasp"),
    ],
    "cei_gym.transfer": [
        *("options", "attempt", "source_side", "live", "scenes", "specified", "following", "aligned", "transfer"),
        *("ground", "standing", "placing"),
    ],
    "cei_converters": [
        *("signals", "start", "dataset", "cli", "simulation", "sources", "view", "inspection", "conversion"),
        *("pads", "record", "replay", "convert", "calibrate", "restore", "report", "demo", "robot", "benchmark"),
    ],
    "cei_converters.conversion": [
        *(
            "executors",
            "ordered_map",
            "agreement",
            "refine",
            "reach",
            "evidence",
            "verdict",
            "quality",
            "search",
            "trials",
            "sample",
            "starting",
            "common",
            "verify",
            "augment",
            "gate",
            "survey",
            "cameras",
            "episode",
            "painting",
            "steps",
            "encode",
        ),
        *(
            "shard",
            "config",
            "staging",
            "placing",
            "converter",
            "plan",
            "assumptions",
            "origin",
            "fit",
            "quality_picture",
            "place_picture",
            "stand",
            "planned",
            "workers",
        ),
        *("writing", "outcomes", "preloaded", "assemble"),
    ],
    "cei_envs": [
        *("gripper", "picture", "viewpoints", "registration", "rollout", "rules", "simulation", "mounted"),
        *(
            "stand_in",
            "self_contact",
            "composing",
            "composed",
            "simulate",
            "sensors",
            "environment",
            "tasks",
            "experts",
            "teleoperation",
        ),
    ],
    "lerobot_env_cei": ["workers", "processors", "configuration"],
    "lerobot_policy_dp3": [
        *(
            "clouds",
            "averaging",
            "optimizer",
            "encoder",
            "fast_reader",
            "configuration_dp3",
            "processor_dp3",
            "unet",
            "modeling_dp3",
        ),
        "original",
    ],
    "lerobot_robot_cei": ["trained_on", "joints", "config_cei", "cei", "images", "clouds", "pictures", "deploy"],
}
"""The rooms of every package, each above those that it may know."""

ON_DEMAND = {
    ("cei_gym", "absent"): {"cei_gym.embodiment"},
    ("cei_envs", "environment"): {"cei_envs.experts", "cei_envs.teleoperation"},
}
"""What a room asks of one above it only when a caller wants it: a demonstrator and a device are no part of running an environment; robots of one's own
are looked for only where there are some."""


def rooms(package: str) -> dict[str, list[Path]]:
    """The files of each room of a package: a folder, or a module."""
    folder = PACKAGES[package.partition(".")[0]].joinpath(*package.split(".")[1:])
    found = {path.stem: [path] for path in folder.glob("[a-z]*.py")}
    return found | {path.parent.name: sorted(path.parent.rglob("*.py")) for path in folder.glob("*/__init__.py")}


@pytest.mark.parametrize("package", LAYERS)
def test_lower_rooms_of_a_package_do_not_know_the_upper_ones(package: str) -> None:
    files, depth = rooms(package), package.count(".") + 2
    for height, room in enumerate(LAYERS[package]):
        above = {f"{package}.{name}" for name in LAYERS[package][height + 1 :]}
        allowed = ON_DEMAND.get((package, room), set())
        for path in files[room]:
            reached = {".".join(name.split(".")[:depth]) for name in imports(path)} & above
            at_once = {".".join(name.split(".")[:depth]) for name in imports(path, top_level=True)} & above
            assert reached <= allowed, path
            assert not at_once, path


@pytest.mark.parametrize("package", LAYERS)
def test_every_room_has_its_layer(package: str) -> None:
    assert set(rooms(package)) == set(LAYERS[package])
    assert len(LAYERS[package]) == len(set(LAYERS[package]))


def test_every_package_has_its_layers() -> None:
    assert set(PACKAGES) <= set(LAYERS)


def test_no_module_is_long() -> None:
    """300 lines at most, or a reason at the top: a line that begins with "Long: "."""
    for package in PACKAGES:
        for path in sources(package):
            text = path.read_text()
            assert text.count("\n") <= 300 or "\nLong: " in text[:1500], path


def test_robosuite_is_imported_only_by_the_environments_package() -> None:
    for package in ("cei_gym", "cei_converters"):
        for path in sources(package):
            assert "import robosuite" not in path.read_text(), path


@pytest.mark.parametrize(
    ("code", "absent"),
    [
        ("import cei_gym", {"torch", "robosuite", "lerobot", "datasets"}),
        ("import cei_envs", {"torch", "robosuite", "lerobot", "datasets", "mujoco"}),
        ("import cei_gym.transfer", {"torch", "robosuite", "lerobot", "datasets", "pytorch_kinematics"}),
        ("import cei_gym.alignment.manual", {"torch", "mink"}),
        ("import cei_converters.view", {"rerun", "torch", "lerobot", "matplotlib"}),
    ],
)
def test_importing_does_not_load_what_it_does_not_need(code: str, absent: set[str]) -> None:
    assert not loaded(code) & absent


def test_either_package_may_be_imported_first() -> None:
    for first in ("cei_envs", "cei_envs.simulate", "cei_envs.composed", "cei_gym.embodiment", "cei_envs.registration"):
        code = f"import {first}, cei_gym, gymnasium; gymnasium.spec('CEI-PickCube-UR5e-Inspire')"
        assert "cei_gym" in loaded(code)


def test_no_file_names_a_registry_host() -> None:
    hosts = re.compile(r"\b(?:files\.)?(?:pypi\.org|pythonhosted\.org|conda\.anaconda\.org|index-url)\b")
    for package in PACKAGES.values():
        for path in package.rglob("*"):
            if path.suffix in {".py", ".yaml", ".toml", ".md", ".json"}:
                assert not hosts.search(path.read_text()), path


def test_no_package_reads_the_shared_folder_or_an_absolute_path() -> None:
    for package in PACKAGES:
        for path in sources(package):
            strings = {
                node.value
                for node in ast.walk(ast.parse(path.read_text()))
                if isinstance(node, ast.Constant) and isinstance(node.value, str)
            }
            assert not [s for s in strings if s.startswith(("/home", "/work", "/root", "../shared"))], path


def test_compiled_sums_have_one_order() -> None:
    """Sums that LLVM may reorder or fuse are others in the process that compiles than in the next, which reads the cache: it inlines
    differently. Where two starts cost nearly the same, that made other datasets of the same input."""
    compiled = {}
    for info in pkgutil.walk_packages(cei_gym.__path__, "cei_gym."):
        module = importlib.import_module(info.name)
        compiled |= {f"{info.name}.{name}": each for name, each in vars(module).items() if isinstance(each, Dispatcher)}
    assert len(compiled) > 40
    for name, each in compiled.items():
        assert each.targetoptions.get("fastmath", False) in (False, {"nnan", "ninf"}), name


def test_the_names_that_a_user_needs_are_at_the_top_and_cost_nothing_before_they_are_used() -> None:
    for name in cei_gym.__all__:
        assert getattr(cei_gym, name).__name__ == name
        assert name in dir(cei_gym)
    with pytest.raises(AttributeError, match="no attribute 'Transfers'"):
        _ = cei_gym.Transfers  # pyright: ignore
    assert "numba" not in loaded("import cei_gym")


# -- tests and private names -------------------------------------------------------------------------------------------

DOCUMENTED = {"_replace", "_fields", "_asdict", "_make", "_exit"}
"""Of named tuples and of `os`: Python's documentation has them, underscore and all."""


def private_uses(text: str) -> list[tuple[int, str]]:
    """Lines and names of what a test uses although its maker keeps it to itself: attributes, imports, and names in strings that patch or
    look up. What a class of the test has of its own does not count."""
    tree, own, found = ast.parse(text), set(), set()
    for cls in (node for node in ast.walk(tree) if isinstance(node, ast.ClassDef)):
        for node in ast.walk(cls):
            if isinstance(node, ast.FunctionDef):
                own.add(node.name)
            elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
                own.add(node.attr)
    for node in ast.walk(tree):
        match node:
            case ast.Attribute(attr=name):
                names = [name]
            case ast.Import(names=aliases):
                names = [part for alias in aliases for part in alias.name.split(".")]
            case ast.ImportFrom(module=module, names=aliases):
                names = [*(module or "").split("."), *(alias.name for alias in aliases)]
            case ast.Call(func=ast.Attribute(attr=function) | ast.Name(id=function), args=arguments) if re.search(
                "attr|patch", function
            ):
                texts = [a.value for a in arguments if isinstance(a, ast.Constant) and isinstance(a.value, str)]
                names = [part for each in texts for part in each.split(".")]
            case ast.Subscript(slice=ast.Constant(value=str(key)), value=ast.Call(func=ast.Name(id="vars"))):
                names = [key]
            case ast.Subscript(slice=ast.Constant(value=str(key)), value=ast.Attribute(attr="__dict__")):
                names = [key]
            case _:
                continue
        private = {name for name in names if re.match("_[A-Za-z]", name)} - DOCUMENTED - own
        found |= {(node.lineno, name) for name in private}
    return sorted(found)


def test_tests_use_public_names() -> None:
    """Less than ten times not, and then the line, or the one above, says why: `# private: ...`."""
    uses = []
    for path in sorted((ROOT / "tests").rglob("*.py")):
        lines = path.read_text().splitlines()
        for number, name in private_uses(path.read_text()):
            uses.append(f"{path.name}:{number}: {name}")
            assert re.search(r"# private: \S+ \S+", "\n".join(lines[max(number - 2, 0) : number])), uses[-1]
    assert len(uses) < 10, "\n".join(uses)


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("x._a + x.b + x.__dict__", ["_a"]),
        ("from cei_gym.transfer import _A, B", ["_A"]),
        ("import cei_gym._hidden.x", ["_hidden"]),
        ("monkeypatch.setattr('cei_gym.transfer._A', 1)", ["_A"]),
        ("getattr(x, '_a'); patch.setattr(x, '_b', 1); patch.setenv('_c', '1')", ["_a", "_b"]),
        ("vars(x)['_a'], x.__dict__['_b'], x['_c']", ["_a", "_b"]),
        ("os._exit(1); point._replace(x=1)", []),
        ("class A:\n  def __init__(self): self._a = 1\n  def _b(self): ...\nA()._a, A()._b, x._c", ["_c"]),
        ("def fit(self): self._a = 1", ["_a"]),
    ],
)
def test_private_uses_are_found(text: str, names: list[str]) -> None:
    assert [name for _, name in private_uses(text)] == names


# -- the fast set ------------------------------------------------------------------------------------------------------


def test_files_that_are_left_out_of_the_fast_set_exist_longest_first(pytestconfig: pytest.Config) -> None:
    """Names are of files that there are, each once, and `make test-fast` asks for the option that leaves them out."""
    conftest = next(each for each in pytestconfig.pluginmanager.get_plugins() if hasattr(each, "MOST_S"))
    files = {path.stem for path in (ROOT / "tests").glob("test_*.py")}
    assert files > conftest.SLOW.keys()
    assert [*conftest.SLOW.values()] == sorted(conftest.SLOW.values(), reverse=True)
    assert min(conftest.SLOW.values()) > conftest.MOST_S
    keys = [key.value for key in slow_keys((ROOT / "tests/conftest.py").read_text())]
    assert len({*keys}) == len(keys)
    assert re.search(r"^test-fast: .*\n\t@\$\(PYTEST\) --fast ", (ROOT / "Makefile").read_text(), re.MULTILINE)


def slow_keys(text: str) -> list[ast.Constant]:
    """The names in SLOW as they are written, where a dict would hide one that is there twice."""
    (table,) = (
        node.value
        for node in ast.parse(text).body
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "SLOW"
    )
    return table.keys


def test_the_fast_set_leaves_out_what_is_slow_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "conftest.py").write_text(
        re.sub(r"(?s)SLOW = \{.*?\}", 'SLOW = {"test_long": 100}', (ROOT / "tests/conftest.py").read_text())
    )
    for name in ("test_brief", "test_long", "test_last"):
        (tmp_path / f"{name}.py").write_text(f"import time\n\ndef {name}():\n    time.sleep(0.01)\n")
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-v", "--rootdir", tmp_path]
    for option, expected in (([], ["test_long", "test_brief", "test_last"]), (["--fast"], ["test_brief", "test_last"])):
        done = subprocess.run([*command, *option, tmp_path], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout
        assert re.findall(r"::(\w+) PASSED", done.stdout) == expected
