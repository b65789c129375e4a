"""Documents keep up with the code: links lead somewhere, commands and options exist, and nothing escapes `smoke/documents.py`, which runs them."""

import re
import shlex
import subprocess
from pathlib import Path

import pytest
from malformed import corpus
from smoke import documents

from cei_converters import record, replay, restore
from cei_converters.benchmark.anchors import AnchorsConfig
from cei_converters.benchmark.listing import ResultsConfig
from cei_converters.benchmark.modes import ModesConfig
from cei_converters.benchmark.policy import PolicyBenchmarkConfig
from cei_converters.benchmark.real import RealBenchmarkConfig
from cei_converters.benchmark.replay import ReplayBenchmarkConfig
from cei_converters.calibrate import CalibrateConfig
from cei_converters.cli import option_types
from cei_converters.conversion.config import ConvertConfig
from cei_converters.inspection.command import InspectConfig
from cei_converters.pads import PadsConfig
from cei_converters.report.command import ReportConfig
from cei_converters.robot.check import CheckConfig
from cei_converters.robot.listing import ListConfig
from cei_converters.robot.new import NewConfig
from cei_converters.robot.show import ShowConfig
from cei_converters.view.command import ViewConfig
from lerobot_robot_cei.deploy import DeployConfig

ROOT = Path(__file__).parents[1]
DOCUMENTS = [ROOT / name for name in documents.documents(ROOT)]
BLOCKS = [block for path in DOCUMENTS for block in documents.blocks(ROOT, path.relative_to(ROOT).as_posix())]
COMMANDS = [command for block in BLOCKS if block.language in documents.SHELL for command in block.commands()]
NOT_RUN = ("text", "yaml", "json", "bibtex")
"""Languages of blocks in which nothing can be run."""
SCRIPTS = sorted(ROOT.glob("examples/*.sh"))
OPTIONS = {
    name: {option.rstrip("_") for option in option_types(config)} | {"help", "config_path"}
    for name, config in {
        "cei-convert": ConvertConfig,
        "cei-record": record.RecordConfig,
        "cei-replay": replay.ReplayConfig,
        "cei-inspect": InspectConfig,
        "cei-report": ReportConfig,
        "cei-deploy": DeployConfig,
        "cei-restore": restore.RestoreConfig,
        "cei-calibrate": CalibrateConfig,
        "cei-pads": PadsConfig,
        "cei-view": ViewConfig,
        "cei-robot new": NewConfig,
        "cei-robot check": CheckConfig,
        "cei-robot show": ShowConfig,
        "cei-robot list": ListConfig,
        "cei-benchmark replay": ReplayBenchmarkConfig,
        "cei-benchmark real": RealBenchmarkConfig,
        "cei-benchmark anchors": AnchorsConfig,
        "cei-benchmark modes": ModesConfig,
        "cei-benchmark policy": PolicyBenchmarkConfig,
        "cei-benchmark results": ResultsConfig,
    }.items()
}


def names(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def check_options(text: str, where: str) -> int:
    """Check the options of each of our commands in a script; returns how many commands there are."""
    count = 0
    for line in text.replace("\\\n", " ").splitlines():
        found = re.search(r"\bcei-(?:(?:benchmark|robot) \w+|\w+)(?= --| *$| [^-\s]\S*)", line.partition("#")[0])
        if found is None:
            continue
        command, count = found.group(), count + 1
        assert command in OPTIONS, f"{where}: {command}"
        rest = line.partition("#")[0][found.end() :]
        for word in shlex.split(rest):
            if word.startswith("--"):
                option = word.removeprefix("--").partition("=")[0]
                known = {option, f"{option}.method", f"{option}.enabled"} & OPTIONS[command]
                assert known, f"{where}: {command} has no {word}"
    return count


@pytest.mark.parametrize("path", DOCUMENTS, ids=names)
def test_links_lead_somewhere(path: Path) -> None:
    for target in re.findall(r"\]\(([^)\s#]+)[^)]*\)", path.read_text()):
        if "://" not in target:
            assert (path.parent / target).exists(), target


def test_commands_in_documents_and_examples_have_the_options_they_are_given() -> None:
    count = sum(check_options(command, "a document") for command in COMMANDS)
    for path in DOCUMENTS:
        for inline in re.findall(r"`(cei-[^`]+ --[^`]+)`", path.read_text()):
            count += check_options(inline, names(path))
    for path in SCRIPTS:
        count += check_options(path.read_text(), names(path))
    assert count > 20


def test_options_that_documents_explain_exist() -> None:
    ours = set().union(*OPTIONS.values())
    groups = {option.partition(".")[0] for option in ours if "." in option} - {"dataset", "source"}
    count = 0
    for path in DOCUMENTS:
        for option, all_of_it in re.findall(r"`--([a-z0-9_]+(?:\.[a-z0-9_]+)*)(\.\*)?", path.read_text()):
            if option.partition(".")[0] in groups:
                count += 1
                known = any(each.startswith(f"{option}.") for each in ours) if all_of_it else option in ours
                assert known or {f"{option}.method", f"{option}.enabled"} & ours, f"{names(path)}: --{option}"
    assert count > 20


def test_every_command_writes_json_and_replaces_it_only_if_told() -> None:
    for name, options in OPTIONS.items():
        assert ({"json", "overwrite"} <= options) is not name.startswith(
            ("cei-benchmark", "cei-robot new", "cei-robot show")
        ), name


# -- that everything is run ---------------------------------------------------------------------------------------


def test_all_documents_are_found() -> None:
    tracked = subprocess.run(["git", "ls-files", "*.md"], cwd=ROOT, capture_output=True, text=True, check=False)
    if tracked.returncode != 0:
        pytest.skip("not a clone")
    assert {*documents.documents(ROOT)} == {*tracked.stdout.split()}


def test_every_block_is_of_a_language_that_is_run_or_in_which_nothing_can_be() -> None:
    assert len(BLOCKS) > 15
    for block in BLOCKS:
        assert block.language in (*documents.SHELL, *documents.PYTHON, *NOT_RUN), f"{block.document}: {block.text}"
        if block.language in documents.SHELL:
            assert block.commands(), f"{block.document} has a block of no command: {block.text}"
    for path in DOCUMENTS:  # a fence that the above does not see, or commands that are indented only
        fences = re.findall(r"^ *(?:```|~~~)", path.read_text(), re.MULTILINE)
        assert len(fences) == 2 * len([block for block in BLOCKS if block.document == names(path)]), names(path)
        outside = re.sub(r"^ *(```+|~~~+).*?^ *\1 *$", "", path.read_text(), flags=re.DOTALL | re.MULTILINE)
        assert not re.search(r"^(?: {4,}|\t)(?:\$ )?(?:cei-|lerobot-|python |make |pip )", outside, re.MULTILINE), (
            names(path)
        )


def test_commands_stand_alone() -> None:
    """Each is run in a shell of its own: what one sets is not there for the next."""
    for command in COMMANDS:
        assert not re.match(r"(cd|export|set|alias) |\w+=\S*$", command), command
        assert subprocess.run(["bash", "-n", "-c", command], check=False).returncode == 0, command


def test_no_exception_and_no_shortening_is_out_of_date() -> None:
    for pattern, why in documents.ELSEWHERE.items():
        assert any(re.fullmatch(pattern, command) for command in COMMANDS), f"no document says {pattern}"
        for test in re.findall(r"tests/\w+\.py", why):
            assert (ROOT / test).is_file(), why
        for script in re.findall(r"benchmarks/\((\S+?)\)", pattern) if "tests/" in why else ():
            for name in script.split("|"):
                assert f'"{name}.py"' in (ROOT / "tests/test_benchmarks.py").read_text(), name
    for pattern, _ in documents.SMALLER:
        assert any(re.search(pattern, command) for command in COMMANDS), pattern
    left = {why for command in COMMANDS if (why := documents.left_out(command))}
    assert len(left) < len(COMMANDS) / 3
    assert {*documents.BEFORE} <= {block.document for block in BLOCKS if block.language in documents.PYTHON}


def test_nothing_long_is_run() -> None:
    """Hours of training would otherwise run as they stand."""
    for command in map(documents.smaller, filter(lambda each: documents.left_out(each) is None, COMMANDS)):
        for option, most in (("steps", 10), ("episodes", 5), ("eval.n_episodes", 2), ("batch_size", 8)):
            for value in re.findall(rf" --{re.escape(option)}=(\d+)\b", command):
                assert int(value) <= most, command
        if command.startswith("lerobot-train"):
            assert "--steps=" in command
        if command.startswith("lerobot-eval"):
            assert "--eval.n_episodes=" in command


def test_every_example_is_run() -> None:
    numbered = {path.name for path in (ROOT / "examples").iterdir() if re.match(r"\d\d_", path.name)}
    data = {name for name in numbered if name.endswith((".yaml", ".png"))}
    assert {name for name in numbered if name.endswith(".sh")} == {*documents.EXAMPLES}
    by_test = {name for name in numbered if name.endswith(".py")}  # tests/test_examples.py runs whatever ends so
    assert numbered - data == {*documents.EXAMPLES} | by_test


@pytest.mark.parametrize("language", ["bash", "sh", "shell", "console", "python"])
def test_a_command_that_breaks_is_seen(language: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(documents, "BEFORE", {})
    for works in (True, False):
        checkout, work = (tmp_path / name / str(works) for name in ("checkout", "work"))
        checkout.mkdir(parents=True)
        work.mkdir(parents=True)
        line = {True: "print(1)", False: "print(1)[0]"} if language == "python" else {True: "$ true", False: "$ false"}
        text = line[works] if language in ("python", "console") else line[works].removeprefix("$ ")
        (checkout / "README.md").write_text(f"# New\n\n```{language}\n{text}\n```\n")
        runner = documents.Runner(checkout, work)
        if works:
            runner.run("README.md")
        else:
            with pytest.raises(SystemExit, match=r"README\.md"):
                runner.run("README.md")
        assert len(runner.ran) == 1


def test_a_file_that_a_document_gives_is_there_for_its_commands(tmp_path: Path) -> None:
    (tmp_path / "README.md").write_text(
        "```yaml\n# robots/mine.yaml\nname: Mine\n```\n\n```bash\ngrep -q Mine robots/mine.yaml\n```\n\n```yaml\nname: Other\n```\n"
    )
    (tmp_path / "work").mkdir()
    documents.Runner(tmp_path, tmp_path / "work").run("README.md")
    assert [path.name for path in (tmp_path / "work/README/robots").iterdir()] == ["mine.yaml"]


def test_a_command_that_makes_nothing_is_seen(tmp_path: Path) -> None:
    (tmp_path / "README.md").write_text("```bash\ntrue --sheet=outputs/picture.png\n```\n")
    (tmp_path / "work").mkdir()
    with pytest.raises(SystemExit, match=r"makes no outputs/picture\.png"):
        documents.Runner(tmp_path, tmp_path / "work").run("README.md")


def test_ci_runs_the_documents_the_demo_and_the_wheels() -> None:
    lines = [line.partition("#")[0].strip() for line in (ROOT / ".ci/run").read_text().splitlines()]
    runs = r"""make (setup|check|docs|test|build)\b.*|make demo .*|installed wheel\.py|installed documents\.py "\$PWD"|test -s outputs/demo/report\.html"""
    found = [line for line in lines if re.fullmatch(runs, line)]
    assert "set -euo pipefail" in lines
    assert len(found) == 9, found
    made = (ROOT / "Makefile").read_text()
    assert re.search(r"^demo: .*\n\t@.*cei_converters\.start demo", made, re.MULTILINE)
    assert re.search(r"^documents: .*\n\t@.*smoke/documents\.py", made, re.MULTILINE)
    assert re.search(r"^docs: .*\n\t@.*mkdocs build --strict$", made, re.MULTILINE)


def test_documents_count_what_they_count() -> None:
    commands, changes = ((ROOT / name).read_text() for name in ("docs/commands.md", "CHANGELOG.md"))
    for text in (commands, changes):
        claimed = int(re.findall(r"more than\s+([\d,]+)\s+(?:ways|cases)", text)[0].replace(",", ""))
        assert 0.8 * len(corpus(seed=0)) < claimed < len(corpus(seed=0))
