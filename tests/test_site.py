"""The documentation site: it has every document, its tables say what the code has, its names are documented, and it is built strictly."""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from smoke import documents

import cei_gym
from cei_converters import calibrate, pads, record, replay, restore
from cei_converters.conversion.config import ConvertConfig
from cei_converters.dataset import legacy
from cei_converters.inspection.command import InspectConfig
from cei_converters.report.command import ReportConfig
from cei_converters.sources import formats
from cei_converters.view.command import ViewConfig
from cei_envs.registration import OWN as TASKS
from cei_envs.registration import Task
from cei_gym.alignment import SolverOptions
from cei_gym.alignment.registry import OWN as SOLVERS
from cei_gym.embodiment import ARMS, END_EFFECTORS
from cei_gym.errors import CEIError
from lerobot_robot_cei.deploy import DeployConfig

ROOT = Path(__file__).parents[1]
WEBSITE = ROOT / "scripts/website"
CONFIG = ROOT / "mkdocs.yml"
BUILT = ("cei_gym", "converters", "envs", "policies", "robots", "docs", "results", "examples", "scripts")
"""Folders that the site is made from."""
CONFIGS = {
    "cei-convert": ConvertConfig,
    "cei-record": record.RecordConfig,
    "cei-replay": replay.ReplayConfig,
    "cei-inspect": InspectConfig,
    "cei-report": ReportConfig,
    "cei-deploy": DeployConfig,
    "cei-restore": restore.RestoreConfig,
    "cei-calibrate": calibrate.CalibrateConfig,
    "cei-pads": pads.PadsConfig,
    "cei-view": ViewConfig,
}

needs_mkdocs = pytest.mark.skipif(importlib.util.find_spec("mkdocs") is None, reason="mkdocs is not installed")
needs_griffe = pytest.mark.skipif(importlib.util.find_spec("griffe") is None, reason="griffe is not installed")


@pytest.fixture
def website(monkeypatch: pytest.MonkeyPatch) -> None:
    """The site's own modules can be imported."""
    monkeypatch.syspath_prepend(str(WEBSITE))


def tables(page: str) -> list[list[list[str]]]:
    """Each table of a page: rows of cells, the head first, without the line below it."""
    found: list[list[list[str]]] = []
    last = False
    for line in (ROOT / page).read_text().splitlines():
        if line.startswith("|"):
            found += [] if last else [[]]
            found[-1].append([cell.strip() for cell in line.strip("|").split("|")])
        last = line.startswith("|")
    return [[table[0], *table[2:]] for table in found]


def build(root: Path, site: Path) -> subprocess.CompletedProcess:
    """Build the site of a checkout as `make docs` does."""
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(site)]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    return subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, check=False)


# -- what is on it --------------------------------------------------------------------------------------------------


def test_the_navigation_names_every_document() -> None:
    named = re.findall(r": (\S+\.md)$", CONFIG.read_text(), re.MULTILINE)
    assert len(named) == len({*named})
    assert {*named} == {
        name for name in documents.documents(ROOT) if not name.startswith(".")
    }  # templates are no pages


def test_the_table_of_commands_is_that_of_the_project() -> None:
    scripts = {}
    for folder in (".", "robots"):
        scripts |= tomllib.loads((ROOT / folder / "pyproject.toml").read_text())["project"]["scripts"]
    text, ((_, *rows),) = (ROOT / "docs/commands.md").read_text(), tables("docs/commands.md")
    listed = {re.findall(r"`([\w-]+)`", command)[0]: what for command, what in rows}
    assert listed.keys() == scripts.keys()
    assert {*CONFIGS} == {*scripts} - {"cei-benchmark", "cei-robot"}
    for command, config in CONFIGS.items():
        assert listed[command] == (config.__doc__ or "").partition("\n")[0], command
    for command in scripts:
        assert f"\n## {command}\n" in text
        assert f"<!-- help: {command}" in text


def test_the_matrix_has_the_robots_tasks_and_experts_of_the_code() -> None:
    (head, *rows), *_ = tables("docs/support.md")
    columns: dict[str, list[Task]] = {}
    for task in TASKS:
        columns.setdefault("Pick-<Thing>" if task.name.startswith("Pick-") else task.name, []).append(task)
    assert head[3:] == [*columns]
    assert [row[0] for row in rows] == [f"{arm}-{end_effector}" for arm in ARMS for end_effector in END_EFFECTORS]
    for robot, source, target, *cells in rows:
        assert (source, target) == ("yes", "yes")
        for cell, of_column in zip(cells, columns.values(), strict=True):
            having = sum(task.expert_of(robot) is not None for task in of_column)
            assert cell == {0: "env", len(of_column): "env, expert"}.get(having, "env, expert of some"), robot
    by_hand = [task.name for task in columns["Pick-<Thing>"] if task.expert_of("IIWA-Inspire")]
    assert by_hand == [task.name for task in columns["Pick-<Thing>"] if task.expert_of("Panda-RobotiqThreeFinger")]
    some = ", ".join(name.removeprefix("Pick-") for name in by_hand[:-1])
    assert f"*some* of them {some} and {by_hand[-1].removeprefix('Pick-')};" in (ROOT / "docs/support.md").read_text()


def test_the_matrix_has_the_formats_of_the_code() -> None:
    _, (_, *rows), _ = tables("docs/support.md")
    ours = " ".join(row[0] for row in rows[:-1])
    for name in (formats.LEROBOT, formats.HDF5, formats.ZARR, *legacy.VERSIONS):
        assert name in ours
    assert [row[0] for row in rows if row[2] == "yes"] == ["LeRobot v3.0"]
    assert [row[0] for row in rows if row[1] == "by upgrade"] == ["LeRobot v2.1, v2.0"]
    assert len(rows) - 1 == len((formats.LEROBOT, formats.HDF5, formats.ZARR)) + 1  # LeRobot has two lines


def test_the_matrix_says_which_solvers_compute_on_which_device() -> None:
    *_, (head, *rows) = tables("docs/support.md")
    devices = head[1:4]
    assert devices == ["cpu", "cuda", "mps"]
    listed = {found[1]: row[1:4] for row in rows if (found := re.match(r"alignment, `(\w+)`", row[0]))}
    assert listed.keys() == SOLVERS.keys()
    for solver, cells in listed.items():
        for device, cell in zip(devices, cells, strict=True):
            try:
                SolverOptions(backend=solver, device=device)
                taken = True
            except CEIError:
                taken = False
            assert cell == ("yes" if taken else "no"), f"{solver} on {device}"


def test_the_pictures_are_what_their_script_makes(website: None, tmp_path: Path) -> None:
    import pictures

    again = "python scripts/website/pictures.py makes them anew"
    assert (ROOT / "docs/pipeline.svg").read_text() == pictures.pipeline(), again
    pictures.pads(tmp_path / "pads.png")
    made, kept = (
        np.asarray(Image.open(path).convert("RGB"), int) for path in (tmp_path / "pads.png", ROOT / "docs/pads.png")
    )
    assert made.shape == kept.shape, again
    assert (np.abs(made - kept).max(axis=2) > 8).mean() < 0.002, again  # but for the names, whose font may be another


def test_distributions_do_not_have_it() -> None:
    for path in (
        ROOT / "pyproject.toml",
        ROOT / "envs/pyproject.toml",
        ROOT / "policies/pyproject.toml",
        ROOT / "robots/pyproject.toml",
    ):
        build = tomllib.loads(path.read_text())["tool"]["hatch"]["build"]["targets"]
        for target in build.values():
            for folder in (*target.get("include", ()), *target.get("packages", ())):
                assert folder.partition("/")[0] not in ("docs", "outputs", "scripts", "results"), path


# -- public names ---------------------------------------------------------------------------------------------------


@needs_griffe
def test_public_names_are_documented(website: None) -> None:
    import names

    listed = names.listed(ROOT)
    assert len(listed) > 80
    assert names.complaints(ROOT) == []
    short = {name.rpartition(".")[2] for name in listed}
    assert {*cei_gym.__all__} <= short


@needs_griffe
def test_what_is_not_documented_is_seen(website: None, tmp_path: Path) -> None:
    import names

    (tmp_path / "docs/api").mkdir(parents=True)
    (tmp_path / "lab.py").write_text(
        '"""A lab."""\n\nfrom dataclasses import dataclass\n\n\ndef silent(): ...\n\n\n'
        '@dataclass\nclass Arm:\n    """An arm.\n\n    Attributes:\n        left, right: (n,) joints, rad.\n    """\n\n'
        "    left: int\n    right: int\n    between: int\n\n"
        '    def said(self):\n        """Something."""\n\n    def unsaid(self): ...\n\n    def _own(self): ...\n\n\n'
        'class Hand(Arm):\n    """A hand."""\n\n    def said(self): ...\n'
    )
    page = tmp_path / "docs/api/lab.md"
    page.write_text("# Lab\n\n::: lab.Hand\n")
    assert names.complaints(tmp_path) == []  # a base says it
    page.write_text("# Lab\n\n::: lab.silent\n\n::: lab.Arm\n\n::: lab.gone\n")
    said = names.complaints(tmp_path)
    assert [line.partition(": ")[2].partition(" (")[0] for line in said] == [
        "lab.silent has no docstring.",
        "lab.Arm.between has no docstring.",
        "lab.Arm.unsaid has no docstring.",
        "there is no lab.gone",
    ]


@needs_griffe
def test_shared_entries_become_an_entry_each(website: None) -> None:
    from shared_entries import separate

    docstring = "An arm.\n\nArgs:\n    lower, upper: (n,) limits,\n        rad.\n    home: where it rests.\n\nReturns:\n    a, b: as it is."
    assert separate(docstring) == (
        "An arm.\n\nArgs:\n    lower: (n,) limits,\n        rad.\n    upper: (n,) limits,\n        rad.\n    home: where it rests.\n\n"
        "Returns:\n    a, b: as it is."
    )


# -- building it ----------------------------------------------------------------------------------------------------


@needs_mkdocs
def test_it_is_built_and_needs_no_network(tmp_path: Path) -> None:
    done = build(ROOT, tmp_path)
    assert done.returncode == 0, done.stderr
    pages = sorted(tmp_path.rglob("*.html"))
    assert len(pages) > len(documents.documents(ROOT))
    for page in pages:
        fetched = re.findall(
            r"<(?:script|img|iframe|link)\b[^>]*?(?:src|href)=[\"']?(https?:[^\"' >]+)", page.read_text()
        )
        assert fetched == [], page
    for style in tmp_path.rglob("*.css"):
        assert not re.search(r"url\([\"']?https?:|@import", style.read_text()), style
    method = (tmp_path / "docs/method.html").read_text()
    assert method.count("<math") > 20
    assert "arithmatex" not in method
    assert 'href="examples/index.html"' in (tmp_path / "index.html").read_text()  # a link to a folder
    commands = (tmp_path / "docs/commands.html").read_text()
    assert "<!-- help" not in commands
    assert "--new_repo_id" in commands
    assert "T_world_target" in (tmp_path / "docs/api/transfer.html").read_text()


@needs_mkdocs
def test_what_is_broken_is_not_built(tmp_path: Path) -> None:
    root = tmp_path / "checkout"
    for folder in BUILT:
        shutil.copytree(ROOT / folder, root / folder, ignore=shutil.ignore_patterns("__pycache__"))
    for path in (*ROOT.glob("*.md"), CONFIG, ROOT / "pyproject.toml", ROOT / "LICENSE"):
        shutil.copy(path, root)
    commands = root / "docs/commands.md"
    commands.write_text(re.sub(r"<!-- help.*", "", commands.read_text()))  # which takes long
    done = build(root, tmp_path / "site")
    assert done.returncode == 0, done.stderr
    with (root / "docs/policies.md").open("a") as page:
        page.write("\n[gone](gone.md) [folder](../nowhere) [anchor](method.md#nowhere)\n")
    (root / "docs/forgotten.md").write_text("# Forgotten\n")
    errors = root / "cei_gym/errors.py"
    errors.write_text(re.sub(r"(def one_line\(.*\n) +\"\"\"(?:.|\n)*?\"\"\"\n", r"\1", errors.read_text()))
    done = build(root, tmp_path / "site")
    assert done.returncode != 0
    for said in (
        "'gone.md'",
        "'../nowhere'",
        "'method.md#nowhere'",
        "docs/forgotten.md",
        "cei_gym.errors.one_line has no docstring",
    ):
        assert said in done.stderr, said
