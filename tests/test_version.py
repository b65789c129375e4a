"""`scripts/version`: distributions, citation and changelog are of one version, and a tag is of that one."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FILES = (
    "pyproject.toml",
    "envs/pyproject.toml",
    "policies/pyproject.toml",
    "robots/pyproject.toml",
    "CITATION.cff",
    "CHANGELOG.md",
)


def check(root: Path, *tag: str) -> tuple[int, list[str]]:
    done = subprocess.run([sys.executable, root / "scripts/version", *tag], capture_output=True, text=True, check=False)
    assert not done.stderr
    return done.returncode, done.stdout.splitlines()


@pytest.fixture
def release(tmp_path: Path) -> Path:
    """The files of this checkout, as they would be tagged v3.2.1."""
    for name in (*FILES, "scripts/version"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    for name in FILES[:-1]:
        edit(tmp_path / name, r'^(version(?: =|:) "?)[^"\n]+', r"\g<1>3.2.1")
    edit(tmp_path / "CHANGELOG.md", r"^## \[Unreleased\].*$", "## [Unreleased]\n\n## [3.2.1] - 2031-02-03")
    return tmp_path


def edit(path: Path, pattern: str, text: str) -> None:
    changed, count = re.subn(pattern, text, path.read_text(), count=1, flags=re.MULTILINE)
    assert count
    path.write_text(changed)


def test_this_checkout_is_of_one_version() -> None:
    code, said = check(ROOT)
    assert code == 0, said


def test_a_release_may_be_tagged_with_its_version_only(release: Path) -> None:
    assert check(release) == (0, ["3.2.1"])
    assert check(release, "v3.2.1") == (0, ["3.2.1"])
    code, said = check(release, "v3.2.0")
    assert code == 1
    assert said == [f"{name} says 3.2.1, not 3.2.0." for name in FILES[:-1]] + [
        "CHANGELOG.md has no heading '## [3.2.0] - YYYY-MM-DD'."
    ]
    for tag in ("3.2.1", "v3.2", "version-3"):
        assert check(release, tag) == (1, [f"{tag} is no version; a version is X.Y.Z, or X.Y.Zrc1, and a tag vX.Y.Z."])
    assert check(release, "--help")[0] == 2


@pytest.mark.parametrize("name", FILES)
def test_what_stays_behind_is_named(name: str, release: Path) -> None:
    edit(release / name, r"3\.2\.1", "3.2.0")
    code, said = check(release, "v3.2.1")
    assert code == 1
    assert [line.split()[0] for line in said] == [name]


def test_a_heading_has_its_date(release: Path) -> None:
    edit(release / "CHANGELOG.md", " - 2031-02-03", "")
    assert check(release, "v3.2.1") == (1, ["CHANGELOG.md has no heading '## [3.2.1] - YYYY-MM-DD'."])
    assert check(release)[0] == 0


def test_addresses_are_the_same_in_all_three(release: Path) -> None:
    with (release / "envs/pyproject.toml").open("a") as file:
        file.write('\n[project.urls]\nRepository = "https://example.org"\n')
    assert check(release) == (1, ["[project.urls] of envs/pyproject.toml are not those of pyproject.toml."])


def test_ci_asks_of_every_tag_of_a_commit(release: Path) -> None:
    """The lines of `.ci/run` as they stand, in a repository of their own."""
    script = re.search(
        r"^\.venv/bin/python scripts/version\n(?:.*\n)*?done\n", (ROOT / ".ci/run").read_text(), re.MULTILINE
    )
    assert script is not None
    who = {f"GIT_{who}_{what}": "x@example.org" for who in ("AUTHOR", "COMMITTER") for what in ("NAME", "EMAIL")}

    (release / ".venv/bin").mkdir(parents=True)
    (release / ".venv/bin/python").symlink_to(sys.executable)

    def git(*arguments: str) -> None:
        subprocess.run(["git", *arguments], cwd=release, env=os.environ | who, capture_output=True, check=True)

    def passes() -> bool:
        return subprocess.run(["bash", "-euo", "pipefail", "-c", script[0]], cwd=release, check=False).returncode == 0

    git("init")
    git("add", *FILES)
    git("commit", "-m", "x")
    assert passes()
    git("tag", "other")
    git("tag", "v3.2.1")
    assert passes()
    git("tag", "v3.2.2")
    assert not passes()
