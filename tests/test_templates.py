"""Forms for issues: what GitHub accepts, and commands and distributions that there are."""

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parents[1]
FORMS = sorted(path for path in (ROOT / ".github/ISSUE_TEMPLATE").glob("*.yml") if path.name != "config.yml")
PROJECTS = [
    tomllib.loads((ROOT / name / "pyproject.toml").read_text())["project"]
    for name in (".", "envs", "policies", "robots")
]


@pytest.mark.parametrize("path", FORMS, ids=lambda path: path.stem)
def test_a_form_is_one(path: Path) -> None:
    form: dict[str, Any] = yaml.safe_load(path.read_text())
    assert form.keys() == {"name", "description", "labels", "body"}
    identities = [element["id"] for element in form["body"]]
    assert len({*identities}) == len(identities) > 2
    for element in form["body"]:
        assert element.keys() <= {"type", "id", "attributes", "validations"}
        assert element["type"] in ("textarea", "input")
        assert element["attributes"].keys() <= {"label", "description", "render"}
        assert element["attributes"]["label"]
    assert any(element.get("validations") == {"required": True} for element in form["body"])
    commands = set().union(*(project.get("scripts", {}) for project in PROJECTS))
    assert {*re.findall(r"\bcei-[a-z]+", path.read_text())} <= commands | {project["name"] for project in PROJECTS}


def test_there_is_a_form_for_what_is_wrong_and_for_what_is_missing() -> None:
    assert [path.stem for path in FORMS] == ["bug", "feature"]
    said = next(path for path in FORMS if path.stem == "bug").read_text()
    assert all(project["name"] in said for project in PROJECTS)
