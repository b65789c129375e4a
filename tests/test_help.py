"""`--help` has words for every option, and only words."""

import re

import pytest

from cei_converters import calibrate, convert, pads, record, replay, report, restore, view
from cei_converters.benchmark import command
from cei_converters.benchmark.anchors import AnchorsConfig
from cei_converters.benchmark.modes import ModesConfig
from cei_converters.benchmark.policy import PolicyBenchmarkConfig
from cei_converters.benchmark.real import RealBenchmarkConfig
from cei_converters.benchmark.replay import ReplayBenchmarkConfig
from cei_converters.cli import option_types
from cei_converters.conversion.config import ConvertConfig
from cei_converters.inspection import command as inspecting
from cei_converters.report.command import ReportConfig
from cei_converters.view.command import ViewConfig

COMMANDS = {
    "convert": (convert.main, ["--help"], ConvertConfig),
    "record": (record.main, ["--help"], record.RecordConfig),
    "replay": (replay.main, ["--help"], replay.ReplayConfig),
    "inspect": (inspecting.main, ["--help"], inspecting.InspectConfig),
    "report": (report.main, ["--help"], ReportConfig),
    "restore": (restore.main, ["--help"], restore.RestoreConfig),
    "calibrate": (calibrate.main, ["--help"], calibrate.CalibrateConfig),
    "pads": (pads.main, ["--help"], pads.PadsConfig),
    "view": (view.main, ["--help"], ViewConfig),
    "benchmark policy": (command.main, ["policy", "--help"], PolicyBenchmarkConfig),
    "benchmark real": (command.main, ["real", "--help"], RealBenchmarkConfig),
    "benchmark anchors": (command.main, ["anchors", "--help"], AnchorsConfig),
    "benchmark modes": (command.main, ["modes", "--help"], ModesConfig),
    "benchmark replay": (command.main, ["replay", "--help"], ReplayBenchmarkConfig),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_is_explained(name: str, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    main, args, config = COMMANDS[name]
    monkeypatch.setenv("COLUMNS", "1000")  # no line is wrapped
    assert main(args) == 0
    printed = capsys.readouterr().out
    for left in ("Attributes:", "Config file for", "self.", "default: None", " def "):
        assert left not in printed
    lines = re.findall(r"^  --(\S+) .+?  +(\S.*)$", re.sub(r"\n {20,}", "  ", printed), re.MULTILINE)
    words = dict(lines)
    assert words.keys() - {"config_path"} == option_types(config).keys()
    for option, text in words.items():
        assert len(re.sub(r"\(default: .*\)", "", text)) > 5, option
