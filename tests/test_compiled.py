"""What is cached of compiled code is of the code that there is."""

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from cei_gym.compiled import forget_stale

RULES = Path(__file__).parents[1] / "cei_gym/compiled.py"


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package whose compiled function calls one of another file."""
    folder = tmp_path / "pack"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "compiled.py").write_text(RULES.read_text())
    (folder / "part.py").write_text("from pack.compiled import njit\n\n@njit(cache=True)\ndef part():\n    return 1\n")
    (folder / "whole.py").write_text(
        textwrap.dedent(
            """
            from pack.compiled import njit
            from pack.part import part

            @njit(cache=True)
            def whole():
                return part()

            print(whole(), sum(whole.stats.cache_hits.values()))
            """
        )
    )
    return folder


def run(package: Path) -> str:
    environment = {**os.environ, "PYTHONPATH": str(package.parent)}
    code = [sys.executable, "-c", "import pack.whole"]
    return subprocess.run(code, env=environment, capture_output=True, text=True, check=True).stdout.strip()


def test_a_function_is_compiled_again_when_one_that_it_calls_has_changed(package: Path) -> None:
    assert [run(package), run(package)] == ["1 0", "1 1"]
    part = package / "part.py"
    part.write_text(part.read_text().replace("return 1", "return 1 + 1"))
    assert [run(package), run(package)] == ["2 0", "2 1"]


def test_only_what_is_stale_is_forgotten(package: Path) -> None:
    run(package)
    assert not forget_stale(package)
    (package / "more.py").touch()
    assert forget_stale(package)
    assert not forget_stale(package)


def test_of_many_processes_that_begin_at_once_one_forgets(package: Path) -> None:
    run(package)
    (package / "more.py").touch()
    code = [sys.executable, "-c", "from pack.compiled import forget_stale, Path; print(forget_stale(Path('pack')))"]
    (package / "compiled.py").write_text(RULES.read_text().replace("\nforget_stale(Path(__file__).parent)\n", "\n"))
    begun = [subprocess.Popen(code, cwd=package.parent, stdout=subprocess.PIPE, text=True) for _ in range(6)]
    assert sorted(each.communicate()[0].strip() for each in begun) == ["False"] * 5 + ["True"]
