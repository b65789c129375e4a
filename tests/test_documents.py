"""Documents keep up with the code: links lead somewhere, commands and options exist."""

import re
import shlex
from pathlib import Path

import pytest

from cei_converters import record, replay, restore
from cei_converters.benchmark.policy import PolicyBenchmarkConfig
from cei_converters.benchmark.replay import ReplayBenchmarkConfig
from cei_converters.cli import option_types
from cei_converters.conversion.config import ConvertConfig
from cei_converters.inspection.command import InspectConfig
from cei_converters.pads import PadsConfig
from cei_converters.view.command import ViewConfig

ROOT = Path(__file__).parents[1]
FOLDERS = (ROOT, *(ROOT / name for name in ("docs", "examples", "envs", "policies", "results")))
DOCUMENTS = sorted({path for folder in FOLDERS for path in (*folder.glob("*.md"), *folder.glob("*/README.md"))})
SCRIPTS = sorted(ROOT.glob("examples/*.sh"))
OPTIONS = {
    name: option_types(config).keys() | {"help", "config_path"}
    for name, config in {
        "cei-convert": ConvertConfig,
        "cei-record": record.RecordConfig,
        "cei-replay": replay.ReplayConfig,
        "cei-inspect": InspectConfig,
        "cei-restore": restore.RestoreConfig,
        "cei-pads": PadsConfig,
        "cei-view": ViewConfig,
        "cei-benchmark replay": ReplayBenchmarkConfig,
        "cei-benchmark policy": PolicyBenchmarkConfig,
    }.items()
}


def names(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def check_options(text: str, where: str) -> int:
    """Check the options of each of our commands in a script; returns how many commands there are."""
    count = 0
    for line in text.replace("\\\n", " ").splitlines():
        found = re.search(r"\bcei-(?:benchmark \w+|\w+)(?= --| *$)", line.partition("#")[0])
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
    count = 0
    for path in DOCUMENTS:
        for block in re.findall(r"```bash\n(.*?)```", path.read_text(), re.DOTALL):
            count += check_options(block, names(path))
    for path in SCRIPTS:
        count += check_options(path.read_text(), names(path))
    assert count > 20


def test_options_that_documents_explain_exist() -> None:
    ours = set().union(*OPTIONS.values())
    groups = {option.partition(".")[0] for option in ours if "." in option} - {"dataset", "source"}
    count = 0
    for path in DOCUMENTS:
        for option, all_of_it in re.findall(r"`--([a-z_]+(?:\.[a-z_]+)*)(\.\*)?", path.read_text()):
            if option.partition(".")[0] in groups:
                count += 1
                known = any(each.startswith(f"{option}.") for each in ours) if all_of_it else option in ours
                assert known or {f"{option}.method", f"{option}.enabled"} & ours, f"{names(path)}: --{option}"
    assert count > 20
