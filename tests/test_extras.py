"""What is not installed with the method: the table of `cei_gym.extras` is true, and whoever lacks something is told in one line what to install.

Missing packages are made by forbidding their import in a process of its own; `smoke/light.py` has an environment without them.
"""

import ast
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterable
from importlib.metadata import packages_distributions
from pathlib import Path

import killed
import pytest

from cei_envs.registration import OWN, environment_ids
from cei_gym import absent
from cei_gym.extras import EXTRAS, MissingExtra, installed, lacking, missing, needed_by, require

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
ENVS = tomllib.loads((ROOT / "envs/pyproject.toml").read_text())["project"]
SCRIPTS: dict[str, str] = PROJECT["scripts"]
PACKAGES = {
    "cei_gym": "cei_gym",
    "cei_converters": "converters/cei_converters",
    "cei_envs": "envs/cei_envs",
    "lerobot_env_cei": "envs/lerobot_env_cei",
}
OURS = {*PACKAGES, "lerobot_policy_dp3", "lerobot_robot_cei"}
DISTRIBUTIONS = packages_distributions() | {"rerun": ["rerun-sdk"]}  # which lies in a folder of its own
WITHOUT = """
import importlib.metadata, sys
absent = {absent!r}
class Nothing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in absent:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Nothing())
every = importlib.metadata.entry_points()
kept = [point for point in every if point.module.partition(".")[0] not in absent]
importlib.metadata.entry_points = lambda **which: importlib.metadata.EntryPoints(kept).select(**which)
"""


def names(requirements: Iterable[str]) -> set[str]:
    """Of distributions, as registries write them; without this project's own extras."""
    found = {re.split(r"[\s\[<>=!~;]", requirement)[0].lower().replace("_", "-") for requirement in requirements}
    return found - {"cei-gym"}


def distribution(module: str) -> str:
    """Which brings a module."""
    if module in OURS:
        return "lerobot-env-cei"
    (name, *_) = DISTRIBUTIONS[module]
    return name.lower().replace("_", "-")


def imported(package: str) -> set[str]:
    """Other people's modules that a package imports, wherever in it, and ours of other packages."""
    found = set()
    for path in sorted((ROOT / PACKAGES[package]).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                found |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                found.add((node.module or "").partition(".")[0])
    assert "numpy" in found or package == "lerobot_env_cei"
    return found - sys.stdlib_module_names - {package}


def without(modules: Iterable[str], code: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run some code where modules are not installed."""
    script = WITHOUT.format(absent=sorted(modules)) + code
    options = {"capture_output": True, "text": True, "check": False, "env": dict(os.environ)}
    return subprocess.run([sys.executable, "-c", script, *arguments], **options)


def command(name: str) -> str:
    """A command as installers write it."""
    module, _, function = SCRIPTS[name].partition(":")
    return f"from {module} import {function}\nsys.exit({function}())"


def python(code: str) -> str:
    """Code that prints the one line of what it raises, like a command."""
    return f"try:\n    {code}\nexcept ImportError as error:\n    sys.exit(f'error: {{error}}')"


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("extras") / "source"
    killed.write_source(root)
    return root


# -- the table ------------------------------------------------------------------------------------------------------


def test_whatever_is_imported_comes_with_the_method_or_with_one_extra() -> None:
    base = names(PROJECT["dependencies"])
    for package in ("cei_gym", "cei_converters"):
        for module in imported(package) - OURS:
            extras = [name for name, extra in EXTRAS.items() if module in extra.modules]
            assert (distribution(module) in base) + len(extras) == 1, f"{package} imports {module}"


def test_the_method_alone_brings_whatever_it_imports_but_for_torch_opencv_and_others_descriptions() -> None:
    rest = {module for module in imported("cei_gym") if distribution(module) not in names(PROJECT["dependencies"])}
    assert rest == {*EXTRAS["torch"].modules, *EXTRAS["descriptions"].modules, "cv2"}


def test_painting_says_that_it_needs_opencv() -> None:
    code = python("from cei_gym.painting import Painter; Painter(None, None, None, None, None)")
    assert without(["cv2"], code).stderr == 'error: painting pictures needs cv2: pip install "cei-gym[lerobot]".\n'


def test_environments_bring_what_they_import_and_no_lerobot() -> None:
    base = names(ENVS["dependencies"])
    assert {distribution(module) for module in imported("cei_envs") - OURS} <= base
    assert not names(PROJECT["optional-dependencies"]["lerobot"]) & base - {"opencv-python-headless"}
    theirs = base | names(PROJECT["dependencies"]) | names(ENVS["optional-dependencies"]["lerobot"])
    assert {distribution(module) for module in imported("lerobot_env_cei") - OURS} <= theirs
    assert "cei-gym[lerobot]" in ENVS["optional-dependencies"]["lerobot"]


@pytest.mark.parametrize("extra", EXTRAS)
def test_an_extra_is_what_the_table_says(extra: str) -> None:
    brought = names(PROJECT["optional-dependencies"][extra])
    if extra == "robosuite":
        brought |= {"robosuite"} & names(ENVS["dependencies"])
    assert {distribution(module) for module in EXTRAS[extra].modules} == brought
    everywhere = set().union(*(imported(package) for package in PACKAGES)) | {"cei_envs"}
    assert {*EXTRAS[extra].modules} <= everywhere


def test_every_extra_is_in_all() -> None:
    extras = PROJECT["optional-dependencies"]
    reached, left = set(), ["all"]
    while left:
        reached.add(name := left.pop())
        for requirement in extras[name]:
            if found := re.match(r"cei-gym\[(.*)\]", requirement):
                left += found[1].split(",")
    brought = set().union(*(names(extras[name]) for name in reached))
    assert brought == set().union(*(names(each) for each in extras.values()))


def test_all_of_them_are_here() -> None:
    assert [name for name in EXTRAS if missing(name) is not None] == []
    require("nobody", "lerobot")


def test_names_of_environments_that_are_not_installed_are_those_that_are() -> None:
    assert {*absent.TASKS} == {task.name for task in OWN}
    code = "import cei_gym, gymnasium; print(*(name for name in gymnasium.registry if name.startswith('CEI-')))"
    done = without(EXTRAS["robosuite"].modules, code)
    assert {*done.stdout.split()} == {*environment_ids()}, done.stderr


def test_a_robot_of_ones_own_is_known_where_its_environments_are_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "arms").mkdir()
    (tmp_path / "arms/LabArm.yaml").write_text("")  # nobody looks at it
    monkeypatch.setenv("CEI_GYM_EMBODIMENTS", str(tmp_path))
    code = "import sys, cei_gym, gymnasium\n" + python('gymnasium.make("CEI-PickCube-LabArm-Inspire")')
    done = without(EXTRAS["robosuite"].modules, code)
    assert done.stderr == (
        'error: CEI-PickCube-LabArm-Inspire needs robosuite: pip install "cei-gym[robosuite]". '
        f"LabArm-Inspire itself is known: {tmp_path / 'arms/LabArm.yaml'}.\n"
    )


# -- the line -------------------------------------------------------------------------------------------------------


def test_other_failures_of_imports_stay_what_they_are() -> None:
    with pytest.raises(ModuleNotFoundError, match="no_such_module") as raised, needed_by("a test"):
        import no_such_module  # noqa: F401  # pyright: ignore[reportMissingImports]
    assert not isinstance(raised.value, MissingExtra)
    assert not installed("no_such_module")


def test_what_is_missing_goes_by_its_own_name_where_the_rest_is_there() -> None:
    assert str(lacking("it", "h5py")) == 'it needs h5py: pip install "cei-gym[lerobot]".'
    done = without(["h5py"], command("cei-convert"))
    assert done.stderr == 'error: cei-convert needs h5py: pip install "cei-gym[lerobot]".\n'


@pytest.mark.parametrize("name", sorted({*SCRIPTS} - {"cei-pads", "cei-robot"}))
def test_commands_without_lerobot(name: str) -> None:
    done = without(EXTRAS["lerobot"].modules, command(name))
    extra = "view" if name == "cei-view" else "lerobot"
    assert done.stderr == f'error: {name} needs LeRobot: pip install "cei-gym[{extra}]".\n'
    assert done.returncode == 1


def test_pads_need_nothing(tmp_path: Path) -> None:
    others = [module for name, extra in EXTRAS.items() for module in extra.modules if name != "robosuite"]
    output = tmp_path / "pads.png"
    done = without(others, command("cei-pads"), "--end_effector=Inspire", f"--output={output}")
    assert done.returncode == 0 and output.exists(), done.stderr


RECORD = ("--env=CEI-PickCube-Panda-PandaGripper", "--episodes=1", "--repo_id=me/x", "--root=x")
LACKING = {
    "lerobot": [
        (python("import cei_converters.sources.formats"), (), "cei_converters.sources needs LeRobot"),
        (python("import cei_converters.conversion.steps"), (), "cei_converters.conversion needs LeRobot"),
        (python("import lerobot_env_cei"), (), "lerobot_env_cei needs LeRobot"),
    ],
    "robosuite": [
        (
            python("import cei_gym, gymnasium; gymnasium.make('CEI-PickCube-IIWA-Inspire', clouds=False)"),
            (),
            "CEI-PickCube-IIWA-Inspire needs robosuite",
        ),
        (command("cei-record"), RECORD, "CEI-PickCube-Panda-PandaGripper needs robosuite"),
        (command("cei-record"), (*RECORD, "--sensors=[wrench]"), "CEI-PickCube-Panda-PandaGripper needs robosuite"),
    ],
    "cluster": [
        (command("cei-convert"), ("--executor=slurm", "--slurm.partition=p"), "--executor=slurm needs datatrove"),
        (command("cei-convert"), ("--executor=ray",), "--executor=ray needs datatrove"),
        (command("cei-convert"), ("--workers=6",), "--workers=6 needs datatrove"),
    ],
    "ray": [(command("cei-convert"), ("--executor=ray",), "--executor=ray needs Ray")],
    "view": [
        (command("cei-view"), ("--dataset.repo_id=me/pick", "--rrd=x.rrd"), "cei-view needs rerun"),
        (command("cei-view"), ("--dataset.repo_id=me/pick",), "cei-view needs rerun"),
    ],
    "torch": [
        (python("import cei_gym.kinematics.torch_chain"), (), "TorchChain (the solver 'paper') needs torch"),
        (
            command("cei-convert"),
            ("--solver.backend=paper", "--dry_run"),
            "TorchChain (the solver 'paper') needs pytorch_kinematics",
        ),
    ],
}
"""By extra: some code, its command line, and how the line begins that is said where the extra is missing."""
CASES = [(extra, *case) for extra, cases in LACKING.items() for case in cases]


@pytest.mark.parametrize(("extra", "code", "arguments", "said"), CASES, ids=[f"{c[0]}: {c[3]}" for c in CASES])
def test_one_line_says_what_to_install(
    extra: str,
    code: str,
    arguments: tuple[str, ...],
    said: str,
    source: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    modules = {*EXTRAS[extra].modules}
    if code == command("cei-convert"):
        arguments = (*killed.arguments(source, tmp_path / "new", *arguments),)
        if "--dry_run" in arguments:
            arguments = tuple(each for each in arguments if not each.startswith("--new_"))
            modules.discard("torch")  # which LeRobot needs, too
    done = without(modules, code, *arguments)
    assert done.stderr == f'error: {said}: pip install "cei-gym[{extra}]".\n'
    assert done.returncode == 1
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("solver", ["torch", "paper"])
def test_solvers_without_torch(solver: str) -> None:
    code = "from cei_gym.alignment import SolverOptions; from cei_gym.alignment.solvers import make; "
    made = python(f"{code}make.make_second_order_solver(None, SolverOptions(backend={solver!r}))")
    done = without(EXTRAS["torch"].modules, made)
    assert done.stderr == f'error: the solver {solver!r} needs torch: pip install "cei-gym[torch]".\n'


def test_a_picture_of_an_episode_needs_no_viewer(source: Path, tmp_path: Path) -> None:
    options = ("--dataset.repo_id=me/pick", f"--dataset.root={source}", f"--sheet={tmp_path / 'sheet.png'}")
    done = without(EXTRAS["view"].modules, command("cei-view"), *options)
    assert done.returncode == 0 and (tmp_path / "sheet.png").exists(), done.stderr


def test_without_processes_a_conversion_is_done_in_one_and_says_so(source: Path, tmp_path: Path) -> None:
    given = [each for each in killed.arguments(source, tmp_path / "new") if not each.startswith("--workers")]
    done = without(EXTRAS["cluster"].modules, command("cei-convert"), *given)
    assert done.returncode == 0 and (tmp_path / "new/meta/info.json").exists(), done.stderr
    assert 'note: more than one process needs datatrove: pip install "cei-gym[cluster]".\n' in done.stdout


@pytest.mark.parametrize("options", [["list"], ["new", "any.urdf"]])
def test_tables_of_robots_say_what_they_need(options: list[str]) -> None:
    done = without(["rich"], command("cei-robot"), *options)
    assert done.stderr == f'error: cei-robot {options[0]} needs rich: pip install "cei-gym[lerobot]".\n'
    assert done.returncode == 1
