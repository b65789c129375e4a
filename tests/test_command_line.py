"""Options: what a name or a path contains means nothing, numbers are numbers, and whatever is wrong is one line and exit code 2."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from cei_converters import convert, pads, record, replay, view
from cei_converters.benchmark import command as benchmark
from cei_converters.benchmark.anchors import AnchorsConfig
from cei_converters.benchmark.modes import ModesConfig
from cei_converters.benchmark.policy import PolicyBenchmarkConfig
from cei_converters.benchmark.real import RealBenchmarkConfig
from cei_converters.benchmark.replay import ReplayBenchmarkConfig
from cei_converters.cli import option_types, parse, run
from cei_converters.conversion.config import ConvertConfig
from cei_converters.inspection import command as inspecting
from cei_converters.view.command import ViewConfig
from cei_gym.errors import CEIError

NAMES = [
    *(
        "runs/pick #2",
        "007",
        "null",
        "~",
        "yes",
        "no",
        "1e3",
        "0x10",
        "1_000",
        "[a]",
        "{a: b}",
        "a: b",
        "- a",
        "*a",
        "&a",
        "!a",
    ),
    *(
        "@x",
        "`x`",
        "%x",
        "'x'",
        '"x"',
        "x'",
        "a=b=c",
        "--x",
        "-x",
        "$HOME",
        "a b",
        " a ",
        "include x",
        "2024-01-01",
        "true",
    ),
    *("<user>", "é\udcff", "#", "|", "...", "a\nb", "𝛼"),
]


@dataclass
class Group:
    """Options of a group."""

    name: str = "x"  # A name.
    root: Path | None = None  # A folder.
    numbers: list[float] | None = None  # Some numbers.


@dataclass
class Options:
    """Options of each type."""

    file: Path  # A file.
    name: str | None = None  # A name.
    names: list[str] | None = None  # Names.
    files: list[Path] | None = None  # Files.
    count: int = 1  # How many.
    share: float | None = 0.5  # How much.
    sizes: tuple[int, ...] = (1, 2)  # How large.
    quick: bool = False  # Whether.
    group: Group = field(default_factory=Group)


def options(*args: str) -> Options:
    given = [] if any(arg.startswith(("--file=", "--config_path")) for arg in args) else ["--file=f"]
    return parse(Options, [*given, *args], "options", "")


def refusal(*args: str) -> str:
    with pytest.raises(CEIError) as error:
        options(*args)
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize("name", NAMES)
def test_names_and_paths_are_taken_as_they_are(name: str) -> None:
    found = options(
        f"--name={name}", f"--file={name}", f"--group.name={name}", f'--files=["{name.replace("\n", "n")}"]'
    )
    assert (found.name, found.group.name) == (name, name)
    assert found.file == (Path.home() if name == "~" else Path(name))
    if '"' not in name and "~" not in name and "\n" not in name:
        assert found.files == [Path(name)]


def test_a_home_folder_is_expanded_and_variables_are_not(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HOME", "/home/me")
    found = options("--file=~/a", "--group.root=~/b~", "--files=~/c:$HOME/d:e, f/~", "--name=~/x")
    assert (found.file, found.group.root) == (Path("/home/me/a"), Path("/home/me/b~"))
    assert found.files == [Path("/home/me/c"), Path("$HOME/d"), Path("e, f/~")]
    assert found.name == "~/x"  # no path
    assert "--file=~nobody-at-all/x: there is no such user" in refusal("--file=~nobody-at-all/x")
    file = tmp_path / "o.yaml"
    file.write_text("file: ~/a\n")
    assert options(f"--config_path={file}").file == Path("/home/me/a")


def test_lists_and_numbers() -> None:
    found = options("--names=front, left", "--sizes=[3,4]", "--share=1e-3", "--count=+7", "--group.numbers=[1, 2.5]")
    assert (found.names, found.sizes, found.share, found.count) == (["front", "left"], (3, 4), 1e-3, 7)
    assert found.group.numbers == [1.0, 2.5]
    assert options('--names=["a, b", "c"]').names == ["a, b", "c"]
    assert options("--share=null", "--names=null").share is None
    assert options("--quick").quick and options("--quick", "true").quick and not options("--quick=false").quick
    assert options("--name", "x", "--count", "-3").count == -3


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["--count=1.5"], "--count=1.5 should be a whole number"),
        (["--count=1e3"], "--count=1e3 should be a whole number"),
        (["--count=null"], "--count=null should be a whole number"),
        (["--count=" + "9" * 20], "should be a whole number, of 64 bits at most"),
        (["--count=" + "9" * 9999], "should be a whole number, of 64 bits at most"),
        (["--share=nan"], "--share=nan should be a finite number"),
        (["--share=1e999"], "--share=1e999 should be a finite number"),
        (["--share=0,5"], "--share=0,5 should be a finite number"),
        (["--sizes=[3, a]"], "--sizes=a should be a whole number"),
        (["--sizes=3,,4"], "--sizes= is empty"),
        (["--group.numbers={a: 1}"], "should be a finite number"),
        (["--quick=maybe"], "--quick=maybe should be true or false"),
        (["--quick=1"], "--quick=1 should be true or false"),
        (["--name="], "--name= is empty; give it a value, or leave it out."),
        (["--name"], "--name needs a value: --name=..."),
        (["--name", "--quick"], "--name needs a value"),
        (["--name=a", "--name=b"], "--name is given twice."),
        (["--quick", "--quick=false"], "--quick is given twice."),
        (["--group-name=a"], "unknown option '--group-name'. Did you mean '--group.name'?"),
        (["--nam=a"], "unknown option '--nam'. Did you mean '--name'?"),
        (["a"], "'a' belongs to no option; options read --name=value."),
        (["-x"], "'-x' belongs to no option"),
        (["--"], "'--' belongs to no option"),
        (["--=a"], "'--=a' belongs to no option"),
        (["--group=a"], "unknown option '--group'"),
        (["--config_path=none.yaml"], "--config_path=none.yaml cannot be read"),
    ],
    ids=str,
)
def test_what_is_wrong_is_said_in_one_line(args: list[str], message: str) -> None:
    assert message in refusal(*args)


def test_what_is_required_is_named() -> None:
    with pytest.raises(CEIError, match=r"^--dataset\.repo_id, --target are required\. See cei-convert --help\.$"):
        parse(ConvertConfig, [], "cei-convert", "")


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("file: a #2", "a"),  # as YAML has it
        ("file: 'a #2'", "a #2"),
        ("file: 007", "7"),
        ("file: a\ngroup: {name: b}", "a"),
        ("file: 1.5", "file is 1.5; put it in quotes if that is its name"),
        ("file: true", "file is True; put it in quotes"),
        ("file: yes", "yes"),  # a truth in YAML 1.1 only
        ("file: null", "--file is null; give it a value, or leave it out"),
        ("file: [a]", "put it in quotes"),
        ("file: a\ncount: 1.5", "count=1.5 should be a whole number"),
        ("file: a\ncount: true", "count=true should be a whole number"),
        ("file: a\nshare: .nan", "share=NaN should be a finite number"),
        ("file: a\ngroup: {nam: b}", "unknown option '--group.nam'"),
        ("file: a\ngroup.name: b", "a"),
        ("file: a\nfile: b", "'file' is given twice"),
        ('file: "a\\0b"', "a path has no null character"),
        ("file: !!python/name:os.system x", "cannot be read"),
        ("- file", "should have a key for each option"),
        ("file: [", "cannot be read"),
        ("", "should have a key for each option"),
    ],
)
def test_a_file_of_options_is_yaml(text: str, found: str, tmp_path: Path) -> None:
    path = tmp_path / "options.yaml"
    path.write_text(text)
    try:
        assert str(options(f"--config_path={path}").file) == found
    except CEIError as error:
        assert found in str(error)
        assert "\n" not in str(error)


def test_the_command_line_wins_over_a_file(tmp_path: Path) -> None:
    (tmp_path / "o.yaml").write_text("file: a\ncount: 3\ngroup: {name: b, numbers: [1, 2]}\n")
    found = options(f"--config_path={tmp_path / 'o.yaml'}", "--count=4", "--group.name=c")
    assert (found.file, found.count, found.group) == (Path("a"), 4, Group("c", None, [1.0, 2.0]))


CONFIGS: dict[str, tuple[type, Callable, list[str]]] = {
    "convert": (ConvertConfig, convert.main, ["--dataset.repo_id=a/b", "--target=IIWA-Inspire", "--new_repo_id=a/c"]),
    "record": (record.RecordConfig, record.main, ["--env=CEI-x", "--repo_id=a/b"]),
    "replay": (replay.ReplayConfig, replay.main, ["--dataset.repo_id=a/b"]),
    "inspect": (inspecting.InspectConfig, inspecting.main, ["--dataset.repo_id=a/b"]),
    "pads": (pads.PadsConfig, pads.main, ["--end_effector=Inspire", "--output=a.png"]),
    "view": (ViewConfig, view.main, ["--dataset.repo_id=a/b"]),
    "benchmark replay": (ReplayBenchmarkConfig, lambda args: benchmark.main(["replay", *args]), []),
    "benchmark real": (RealBenchmarkConfig, lambda args: benchmark.main(["real", *args]), []),
    "benchmark anchors": (AnchorsConfig, lambda args: benchmark.main(["anchors", *args]), []),
    "benchmark modes": (ModesConfig, lambda args: benchmark.main(["modes", *args]), []),
    "benchmark policy": (PolicyBenchmarkConfig, lambda args: benchmark.main(["policy", *args]), []),
}


def every_option() -> list[tuple[str, str, Any]]:
    return [(name, option, hint) for name, (cls, *_) in CONFIGS.items() for option, hint in option_types(cls).items()]


@pytest.mark.parametrize(("name", "option", "hint"), every_option(), ids=lambda value: str(value)[:40])
def test_no_value_of_any_option_is_more_than_one_line(
    name: str, option: str, hint: Any, capsys: pytest.CaptureFixture
) -> None:
    """Values that parse go no further: what the command then does with them is other tests' business."""
    config_cls, _, required = CONFIGS[name]
    rest = [arg for arg in required if not arg.startswith(f"--{option}=")]
    for value in (
        "",
        "-1",
        "0",
        "1e308",
        "-1e308",
        "nan",
        str(2**62),
        "a",
        "@x",
        "[",
        "{a: b}",
        "null",
        "0,3-",
        "1,,2",
    ):
        code = run(config_cls, lambda _: None, [*rest, f"--{option}={value}"], prog="cei-x", example="")
        error = capsys.readouterr().err
        assert code in (0, 2), value
        assert (code == 0) == (error == ""), value
        if code:
            assert error.startswith("error: ") and error.count("\n") == 1, (value, error)


@pytest.mark.parametrize(
    ("name", "args", "message"),
    [
        ("record", ["--seed=-1"], "--seed=-1 should be at least 0."),
        ("record", ["--episodes=0"], "--episodes=0 should be at least 1."),
        ("record", ["--variation=1.5"], "--variation=1.5 should be at least 0 and at most 1."),
        ("record", ["--teleop=keyboard", "--variation=0.5"], "--variation is the scripted expert's"),
        ("record", ["--overwrite"], "--overwrite is of no use without a file of results"),
        ("replay", ["--episodes=first"], "--episodes=first is no list of episode indices"),
        ("replay", ["--video_episodes=-1"], "--video_episodes=-1 should be at least 0."),
        ("replay", ["--video_episodes=0", "--video=a.mp4"], "--video is of no use with --video_episodes=0"),
        ("replay", ["--video_episodes=0", "--source.repo_id=a/b"], "--source.repo_id is of no use with"),
        ("replay", ["--source.root=a"], "--source.root is of no use without --source.repo_id."),
        ("view", ["--source.joint_map=a"], "--source.joint_map is of no use without --source.repo_id."),
        ("view", ["--episode=-1"], "--episode=-1 should be at least 0."),
        ("inspect", ["--episodes=0"], "--episodes=0 should be at least 1."),
        ("inspect", ["--joint_map=a", "--state=b"], "leave out --state and --action"),
        ("inspect", ["--joint_map=a", "--save_map=b.yaml"], "is a map already"),
        ("pads", ["--points=0"], "--points=0 should be at least 1 and at most 1e+06."),
        ("pads", ["--seed=-1"], "--seed=-1 should be at least 0."),
        ("pads", ["--pose=shut"], "unknown pose 'shut'. Valid: home, half, closed."),
        ("convert", ["--workers=0"], "--workers=0 should be at least 1."),
        ("convert", ["--episodes=3-1"], "--episodes=3-1 is no list of episode indices"),
        ("convert", ["--source_pose=1,2"], "--source_pose=1,2 should read x,y,z"),
        ("convert", ["--executor=slum"], "unknown executor 'slum'. Did you mean 'slurm'?"),
        ("convert", ["--slurm.qos=high"], "--slurm.qos is of no use without --executor=slurm; leave it out."),
        ("convert", ["--dry_run", "--resume"], "--dry_run keeps nothing that could be gone on with"),
        ("convert", ["--dry_run", "--push_to_hub"], "leave one out"),
        ("convert", ["--solver.paper.steps=5"], "--solver.paper.steps is of no use without --solver.backend=paper"),
        ("convert", ["--init.draws=5"], "--init.draws is of no use without --init=eis"),
        ("convert", ["--transfer.method=bms", "--init.starts=5"], "is of no use with --transfer.method=bms"),
        ("convert", ["--clouds.swap=false", "--clouds.voxel_m=0.1"], "is of no use with --clouds.swap=false"),
        ("convert", ["--contact.opposition_weight=0", "--contact.facing_weight=1"], "--contact.facing_weight is of no"),
        ("convert", ["--augment.grid=2,2", "--augment.seed=1"], "is of no use without --augment.rotation_deg"),
        ("convert", ["--augment.grid=2,2", "--augment.half_m=0.1"], "is of no use without --augment.objects=state"),
        ("convert", ["--verify.drop"], "are of no use without --verify"),
        ("benchmark replay", ["--seed=-1"], "--seed=-1 should be at least 0."),
        ("benchmark replay", ["--redraw", "--jobs=2"], "--redraw runs nothing"),
        ("benchmark policy", ["--variation=2"], "--variation=2"),
        ("benchmark real", ["--trials=0"], "--trials=0 should be at least 1."),
        ("benchmark real", ["--redraw", "--films"], "--redraw runs nothing; leave out --jobs, --stage and --films."),
        (
            "benchmark real",
            ["--films", "--stage=policy"],
            "--films shows what is replayed, which --stage=policy does not",
        ),
        ("benchmark real", ["--stage=replays"], "unknown --stage 'replays'. Did you mean 'replay'?"),
    ],
    ids=str,
)
def test_values_out_of_range_and_options_of_no_use_are_refused(
    name: str,
    args: list[str],
    message: str,
    complaint: Callable,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    _, main, required = CONFIGS[name]
    assert main([*required, *args]) == 2
    assert message in complaint()
    assert list(tmp_path.iterdir()) == []
