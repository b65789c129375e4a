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
}
FORBIDDEN = {
    "cei_gym": {"robosuite", "lerobot", "datasets", "cei_envs", "cei_converters"},
    "cei_envs": {"lerobot", "datasets", "torch", "cei_converters"},
    "cei_converters": {"robosuite", "mujoco", "lerobot_env_cei", "lerobot_policy_dp3"},
    "lerobot_env_cei": {"robosuite", "mujoco", "lerobot_policy_dp3"},
    # of use to anybody who has point clouds in LeRobot datasets
    "lerobot_policy_dp3": {"cei_gym", "cei_envs", "cei_converters", "lerobot_env_cei"},
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
        *("errors", "compiled", "plugins", "untrusted", "untrusted_xml", "channels", "displacement", "demonstration"),
        *("embodiment", "rendering", "environment", "kinematics", "functional", "pointcloud", "alignment"),
        *("augmentation", "transfer", "impersonation", "wrapper"),
    ],
    "cei_gym.embodiment": [
        *("names", "spec", "resources", "mesh_files", "colours", "elements", "couplings", "coupled", "includes"),
        *("assets", "meshes", "mjcf", "urdf", "compiling", "description", "embodiment", "joining", "building"),
        *("catalogue", "identity"),
    ],
    "cei_gym.alignment": [
        *("registry", "options", "kernels", "grip", "manual", "problem", "links", "contact", "solvers", "judge"),
        *("retime", "follow", "start", "stream"),
    ],
    "cei_gym.alignment.kernels": ["step", "target", "quadratic", "distance", "collision", "frame", "contact", "grasp"],
    "cei_gym.transfer": [
        *("options", "attempt", "live", "source_side", "scenes", "specified", "following", "transfer"),
    ],
    "cei_converters": [
        *("signals", "start", "dataset", "cli", "simulation", "sources", "view", "inspection", "conversion"),
        *("pads", "record", "replay", "convert", "restore", "report", "demo", "benchmark"),
    ],
    "cei_converters.conversion": [
        *("executors", "ordered_map", "agreement", "verify", "augment", "gate", "reach", "survey", "episode", "steps"),
        *(
            "shard",
            "config",
            "staging",
            "converter",
            "plan",
            "assumptions",
            "origin",
            "fit",
            "quality_picture",
            "workers",
        ),
        *("writing", "outcomes", "preloaded", "assemble"),
    ],
    "cei_envs": [
        *("gripper", "picture", "viewpoints", "registration", "rollout", "simulation", "sensors", "environment"),
        *("tasks", "experts", "teleoperation"),
    ],
    "lerobot_env_cei": ["workers", "processors", "configuration"],
    "lerobot_policy_dp3": [
        *(
            "clouds",
            "averaging",
            "encoder",
            "fast_reader",
            "configuration_dp3",
            "processor_dp3",
            "unet",
            "modeling_dp3",
        ),
        "original",
    ],
}
"""The rooms of every package, each above those that it may know."""

ON_DEMAND = {
    ("cei_envs", "environment"): {"cei_envs.experts", "cei_envs.teleoperation"},
}
"""What a room asks of one above it only when a caller wants it: a demonstrator and a device are no part of running an environment."""


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
    for first in ("cei_envs", "cei_envs.simulation", "cei_gym.embodiment", "cei_envs.registration"):
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
