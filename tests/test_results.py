"""Results do not go stale unseen: what each depends on, what makes it older than the code, and how documents say so."""

import json
import re
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from smoke import documents

from cei_converters.benchmark import command
from cei_converters.benchmark.ages import ages
from cei_converters.benchmark.figures import Figure, Manifest
from cei_converters.benchmark.keeping import fill
from cei_converters.benchmark.marks import OLDER, figures_of, marked
from cei_converters.benchmark.measured import MEASURED, measured_by
from cei_converters.benchmark.measured_code import ROOTS, Code, changes, select
from cei_gym.errors import CEIError

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "results"
FOLDERS = sorted(path for path in RESULTS.iterdir() if path.is_dir())
DOCUMENTS = [ROOT / name for name in documents.documents(ROOT)]


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A copy of this checkout's code, with one figure of today for each command that is known, a folder each."""
    for root in ROOTS:
        shutil.copytree(ROOT / root, tmp_path / root, ignore=shutil.ignore_patterns("__pycache__", "*.nb?"))
    code = Code.of_folder(tmp_path)
    for name, patterns in MEASURED.items():
        folder = tmp_path / "results" / folder_of(name)
        folder.mkdir(parents=True)
        (folder / "figure.json").write_text("{}")
        Manifest(folder).keep(Figure(("figure.json",), name, "abc", "2026-11-30", measures=patterns), code)
    return tmp_path


def folder_of(name: str) -> str:
    """A benchmark's name; of one with stages, and the stage."""
    return "_".join(name.split("/")[-1].removeprefix("cei-benchmark ").removesuffix(".py").split(" --stage="))


def older(checkout: Path) -> dict[str, tuple[str, ...]]:
    return {aged.folder.name: aged.changed for aged in ages(checkout / "results") if aged.is_older}


def edit(path: Path, change: Callable[[str], str]) -> None:
    text = path.read_text()
    path.write_text(change(text))
    assert path.read_text() != text


# -- this repository's ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_every_file_says_what_it_depends_on(folder: Path) -> None:
    manifest = Manifest.read(folder)
    manifest.check()
    assert manifest.names()
    for name in manifest.names():
        figure = manifest.figure(name)
        assert figure.command
        if not figure.made_of:
            assert re.fullmatch(r"[0-9a-f]{40}(-dirty)?", str(figure.commit)), name
            assert figure.date and figure.seeds and figure.measures and (figure.versions or figure.note), name
            assert select(manifest.code[str(figure.code)], figure.measures), name


def test_stored_code_is_that_of_the_commit_not_of_today() -> None:
    figure = Manifest.read(RESULTS / "replay").figure("replay.csv")
    cell = Manifest.read(RESULTS / "replay").figure("PickCube-IIWA-Inspire.json")
    assert figure.made_of and cell.commit is not None
    try:
        then = Code.of_commit(ROOT, cell.commit.removesuffix("-dirty"))
    except CEIError:
        pytest.skip("not a clone with its history")
    assert then.name == cell.code
    assert then.digests != Code.of_folder(ROOT).digests


def test_what_a_benchmark_measures_exists() -> None:
    paths = Code.of_folder(ROOT).digests
    for name, patterns in MEASURED.items():
        assert measured_by(f"python {name} --seed=1" if name.endswith(".py") else name) == patterns
        for pattern in patterns:
            assert select(paths, [pattern.removeprefix("!")]), f"{name}: {pattern} is of no file"
    scripts = {path.name for path in ROOT.glob("benchmarks/*.py")} - {"compared.py", "measure.py", "others.py"}
    assert {f"benchmarks/{name}" for name in scripts} == {name for name in MEASURED if name.endswith(".py")}
    with pytest.raises(CEIError, match=r"'python benchmarks/other\.py' measures is not said"):
        measured_by("python benchmarks/other.py")


def test_documents_name_the_commit_of_each_figure_that_they_show() -> None:
    """Whether it is older than the code may be out of date, since every change of code would fail here otherwise: `.ci/run` says so."""
    found, count = ages(RESULTS), 0
    for document in DOCUMENTS:
        text, current = document.read_text(), marked(document, found)
        assert text.replace(OLDER, "") == current.replace(OLDER, ""), f"{document}: make results RESULTS_ARGS=--mark"
        named = {aged.folder.resolve() for aged in figures_of(document, found)}
        for link in re.findall(r"\]\(([^)\s#]+)\)", text):
            path = (document.parent / link).resolve()
            folder = next((f for f in FOLDERS if f in (path, path.parent) and path.name != "README.md"), None)
            assert folder is None or folder in named, f"{document} shows {link} without a mark"
            count += folder is not None
    assert count > 15


# -- what makes a figure older ----------------------------------------------------------------------------------------


POLICIES = {"policy", *(f"{name}_policy" for name in ("real", "anchors", "modes"))}
REPLAYS = {"replay", *(f"{name}_replay" for name in ("real", "anchors", "modes"))}
CONVERTING = POLICIES | REPLAYS | {"augmentation", "image_policy", "scale", "transfer"}


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        ("benchmarks/first_frame.py", {"first_frame"}),
        ("policies/lerobot_policy_dp3/unet.py", POLICIES | {"training"}),
        ("converters/cei_converters/conversion/steps.py", CONVERTING),
        ("cei_gym/wrapper.py", POLICIES | {"image_policy", "impersonation", "live_pictures", "observation"}),
        ("cei_gym/augmentation.py", {"anchors_replay", "anchors_policy", "augmentation"}),
        (
            "cei_gym/errors.py",
            CONVERTING | {"direction_weight", "impersonation", "live_pictures", "pictures", "things", "twin"},
        ),
        ("cei_gym/painting/light.py", {"camera_fit", "image_policy", "live_pictures", "pictures"}),
        ("converters/cei_converters/cli/table.py", set()),
    ],
)
def test_a_change_makes_older_what_measures_it_and_is_named(path: str, expected: set[str], checkout: Path) -> None:
    edit(checkout / path, lambda text: f"{text}\nCHANGED = 1\n")
    assert older(checkout) == dict.fromkeys(expected, (path,))


def test_words_alone_make_nothing_older(checkout: Path, capsys: pytest.CaptureFixture) -> None:
    edit(
        checkout / "cei_gym/demonstration.py", lambda text: text.replace('"""', '"""Otherwise said: ', 1) + "\n# more\n"
    )
    specification = checkout / "cei_gym/embodiment/specifications/arms/IIWA.yaml"
    edit(specification, lambda text: f"# more\n{text}")
    assert command.main(["results", f"--results={checkout / 'results'}", "--strict"]) == 0
    assert f"0 of {len(MEASURED)} figures are older" in capsys.readouterr().out
    edit(specification, lambda text: text.replace("name:", "name: x #", 1) if "name:" in text else f"{text}\nmore: 1\n")
    assert {"replay", "first_frame"} < older(checkout).keys()


SNIPPET = '''"""Docstring."""
from a.b import c, d
import e

LIMIT = 3
"""Of something."""


def f(x: int = 1) -> str:
    """Docstring."""
    import g  # here
    return f"{x!r} and" + 'so' + g.on(None)
'''


@pytest.mark.parametrize(
    ("old", "new", "same"),
    [
        ('"""Docstring."""', "", True),
        ('"""Of something."""', "# Of something", True),
        ("  # here", "", True),
        ("'so'", '"so"', True),
        ("from a.b import c, d\nimport e", "import e\nfrom a.b import d\nfrom a.b import c", True),
        ("LIMIT = 3", "LIMIT = 4", False),
        ("LIMIT = 3", "LIMIT = 3.0", False),
        ("x: int = 1", "x: int = 2", False),
        ("x!r", "x!s", False),
        ("None", "", False),
        ("'so'", "b'so'", False),
        ("import c, d", "import c", False),
        ("import e", "import e as f", False),
        ("from a.b", "from a.x", False),
        ("from a.b", "from .b", False),
    ],
)
def test_what_counts_of_a_file(old: str, new: str, same: bool) -> None:
    assert old in SNIPPET
    before, after = (Code({"a.py": text.encode()}) for text in (SNIPPET, SNIPPET.replace(old, new)))
    assert (before.digests == after.digests) is same


def code(**files: str) -> Code:
    return Code({f"cei_gym/{name.replace('__', '/')}.py": text.encode() for name, text in files.items()})


THEN = {"a": "def f(): return 1\n", "b": "from cei_gym.a import f\nx = f()\n", "c": "from cei_gym.b import x\n"}


@pytest.mark.parametrize(
    ("now", "expected"),
    [
        (THEN | {"new": "y = 1\n"}, []),
        (
            {
                "room__a": THEN["a"],
                "room__b": "from cei_gym.room.a import f\nx = f()\n",
                "c": "from cei_gym.room.b import x\n",
            },
            [],
        ),
        (
            {"room__a": THEN["a"], "b": "from cei_gym.room import a\nx = a.f()\n", "c": THEN["c"]},
            ["cei_gym/b.py"],
        ),
        (THEN | {"other": "def f(): return 2\n", "b": "from cei_gym.other import f\nx = f()\n"}, ["cei_gym/b.py"]),
        ({"b": "x = 1\n", "c": THEN["c"]}, ["cei_gym/a.py (gone)", "cei_gym/b.py"]),
        ({**THEN, "room__a": THEN["a"].replace("1", "2")}, []),
        ({"room__a": THEN["a"].replace("1", "2"), "b": THEN["b"], "c": THEN["c"]}, ["cei_gym/a.py (gone)"]),
    ],
    ids=["new", "moved", "moved and used otherwise", "from elsewhere", "gone", "new, not used", "moved and changed"],
)
def test_a_move_is_no_change_but_everything_else_is(now: dict[str, str], expected: list[str]) -> None:
    assert changes(code(**THEN).digests, code(**now), ["cei_gym/*"]) == expected


def test_a_newer_library_makes_older(checkout: Path) -> None:
    manifest = Manifest.read(checkout / "results/replay")
    manifest.figures = [replace(manifest.figures[0], versions={"mujoco": "3.9.0", "rich": "1.0"})]
    manifest.write()
    (checkout / "requirements.lock").write_text("mujoco==3.9.0 ; x\nrich==2.0\n")
    assert older(checkout) == {}
    (checkout / "requirements.lock").write_text("mujoco==3.10.0 ; x\n")
    assert older(checkout) == {"replay": ("mujoco 3.9.0, now 3.10.0",)}


# -- manifests --------------------------------------------------------------------------------------------------------


def test_a_file_that_nothing_is_said_of_is_one_clear_line(checkout: Path, capsys: pytest.CaptureFixture) -> None:
    results = checkout / "results"
    (results / "replay/new.csv").write_text("1")
    assert command.main(["results", f"--results={results}"]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "replay/new.csv belongs to no figure of" in error
    (results / "replay/new.csv").rename(results / "new.csv")
    assert command.main(["results", f"--results={results}"]) == 1
    assert "new.csv is in no folder of figures" in capsys.readouterr().err
    (results / "new.csv").unlink()
    (results / "replay/figure.json").write_text('{"commit": "abd"}')
    assert command.main(["results", f"--results={results}"]) == 1
    assert "figure.json says that it is of commit abd, " in capsys.readouterr().err
    (results / "replay/depends.yaml").write_text("- a\n")
    assert command.main(["results", f"--results={results}"]) == 1
    assert "depends.yaml is no list of figures" in capsys.readouterr().err
    assert command.main(["results", "--results=nowhere"]) == 1
    assert "nowhere is no folder of results" in capsys.readouterr().err


def test_files_of_one_run_stand_together_and_those_of_another_take_their_place(tmp_path: Path) -> None:
    names = [f"cell-{i}.json" for i in range(3)]
    for name in (*names, "table.md"):
        (tmp_path / name).write_text("{}")
    first, second = (Figure((), "cei-benchmark replay", commit, measures=("cei_gym/*",)) for commit in "ab")
    for name in names:
        Manifest.read(tmp_path).keep(replace(first, files=(name,)), code(**THEN))
    Manifest.read(tmp_path).keep(Figure(("table.md",), "cei-benchmark replay --redraw", made_of=("cell-*",)))
    manifest = Manifest.read(tmp_path)
    manifest.check()
    assert manifest.figures[0].files == (*names,)
    manifest.figures = [replace(manifest.figures[0], files=("cell-*.json",), note="By hand."), manifest.figures[1]]
    manifest.write()
    before = (tmp_path / "depends.yaml").read_text()
    manifest.keep(replace(first, files=(names[2],)), code(**THEN))
    assert (tmp_path / "depends.yaml").read_text() == before
    manifest.keep(replace(second, files=(names[1],)), code(a="x = 1"))
    read = Manifest.read(tmp_path)
    read.check()
    assert {figure.commit: figure.files for figure in read.figures if not figure.made_of} == {
        "a": (names[0], names[2]),
        "b": (names[1],),
    }
    assert read.figure(names[0]).note == "By hand."
    assert len(read.code) == 2
    read.keep(replace(second, files=(names[0], names[2])), code(a="x = 1"))
    assert len(Manifest.read(tmp_path).code) == 1


def test_a_table_is_as_old_as_the_oldest_that_it_is_made_of(checkout: Path) -> None:
    folder = checkout / "results/replay"
    for name in ("other.json", "table.md"):
        (folder / name).write_text("{}")
    own = Figure(("other.json",), "cei-benchmark replay", "abd", measures=("benchmarks/measure.py",))
    Manifest.read(folder).keep(own, Code.of_folder(checkout))
    Manifest.read(folder).keep(Figure(("table.md",), "cei-benchmark replay --redraw", made_of=("*.json",)))
    edit(checkout / "benchmarks/measure.py", lambda text: f"{text}\nCHANGED = 1\n")
    found = {aged.figure.files[0]: aged for aged in ages(checkout / "results") if aged.folder == folder}
    assert {name for name, aged in found.items() if aged.is_older} == {"other.json", "table.md"}
    assert found["table.md"].commits == ("abc", "abd")


def test_code_is_taken_from_history_and_history_is_not_needed_after_that(tmp_path: Path) -> None:
    for root in ROOTS:
        (tmp_path / root).mkdir()
        (tmp_path / root / "some.py").write_text("x = 1\n")
    folder = tmp_path / "results/replay"
    folder.mkdir(parents=True)
    git = ["git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@b.c", "-c", "init.defaultBranch=main"]
    for arguments in (["init", "-q"], ["add", "."], ["commit", "-qm", "One"]):
        subprocess.run([*git, *arguments], check=True)
    commit = subprocess.run([*git, "rev-parse", "HEAD"], check=True, capture_output=True, text=True).stdout.strip()
    said = {"commit": f"{commit}-dirty", "seeds": [1, 3], "versions": {"mujoco": "3.9.0"}}
    for name in ("a.json", "b.json"):
        (folder / name).write_text(json.dumps(said | ({"date": "2026-11-30T01:02:03"} if name == "b.json" else {})))
    edit(tmp_path / "cei_gym/some.py", lambda _: "x = 2\n")
    entry = "files: ['*.json'], command: cei-benchmark replay"
    (folder / "depends.yaml").write_text(f"figures: [{{{entry}, commit: {commit}-dirty}}]\n")
    assert "has no code of it" in older(tmp_path)["replay"][0]
    (folder / "depends.yaml").write_text(f"figures: [{{{entry}}}]\n")
    assert fill(Manifest.read(folder), tmp_path) == 1
    shutil.rmtree(tmp_path / ".git")
    assert older(tmp_path) == {"replay": ("cei_gym/some.py",)}
    figure = Manifest.read(folder).figures[0]
    assert (figure.date, figure.seeds, figure.versions) == ("2026-11-30", (1, 3), {"mujoco": "3.9.0"})
    edit(tmp_path / "cei_gym/some.py", lambda _: "x = 1  # as it was\n")
    assert older(tmp_path) == {}
    manifest = Manifest.read(folder)
    manifest.figures[0] = replace(figure, code=None)
    with pytest.raises(CEIError, match=r"git archive fails .* a shallow clone lacks old commits"):
        fill(manifest, tmp_path)
    (folder / "a.json").write_text(json.dumps(said | {"commit": "b" * 40}))
    with pytest.raises(CEIError, match="should name one commit; it names 2"):
        fill(manifest, tmp_path)


# -- marks and the listing --------------------------------------------------------------------------------------------


def test_documents_are_marked_and_the_listing_says_where_marks_are_out_of_date(
    checkout: Path, capsys: pytest.CaptureFixture
) -> None:
    document = checkout / "docs/guide.md"
    document.parent.mkdir()
    mark = "<!-- measured ../results/{} -->{}<!-- end -->"
    text = f"95 % {mark}, 3 ms {mark}.\n\n```text\n{mark}\n```\n"
    names = ("replay/figure.json", "observation", "replay")
    document.write_text(text.format(*(each for name in names for each in (name, ""))))
    shown = "docs/guide.md: marks are out of date"
    options = ["results", f"--results={checkout / 'results'}"]
    assert command.main(options) == 0
    assert shown in capsys.readouterr().out
    assert command.main([*options, "--mark"]) == 0
    assert command.main(options) == 0
    assert "docs/guide.md: marked" in (printed := capsys.readouterr().out)
    assert shown not in printed
    fresh = text.format(names[0], "(`abc`)", names[1], "(`abc`)", names[2], "")
    assert document.read_text() == fresh

    edit(checkout / "cei_gym/wrapper.py", lambda text: f"{text}\nCHANGED = 1\n")
    assert command.main([*options, "--strict"]) == 1
    captured = capsys.readouterr()
    assert "cei_gym/wrapper.py" in captured.out
    assert shown in captured.out
    assert captured.err.count("\n") == 1
    assert f"8 of {len(MEASURED)} figures are older than what they measure" in captured.err
    assert document.read_text() == fresh
    assert command.main([*options, "--mark"]) == 0
    assert document.read_text() == text.format(names[0], "(`abc`)", names[1], f"(`abc`{OLDER})", names[2], "")

    document.write_text(mark.format("other", ""))
    assert command.main(options) == 1
    assert "'../results/other' in a mark is no figure and no folder of figures" in capsys.readouterr().err
