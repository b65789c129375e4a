"""What all tests share."""

import contextlib
import ctypes
import gc
import signal
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

SLOW = {
    "test_main_job": 110,
    "test_anchors_and_modes": 90,
    "test_real_benchmark": 90,
    "test_benchmark_command": 80,
    "test_painting": 75,
    "test_resume": 70,
    "test_bad_input": 60,
    "test_edited": 60,
    "test_extras": 60,
    "test_robot_show": 60,
    "test_lerobot_scripts": 60,
    "test_signals": 60,
    "test_robosuite_tasks": 60,
    "test_pick": 60,
    "test_outlines": 60,
    "test_augmentation": 54,
    "test_embodiment": 53,
    "test_policy_benchmark": 50,
    "test_alignment": 46,
    "test_evidence": 45,
    "test_report": 45,
    "test_own_package": 43,
    "test_benchmarks": 40,
    "test_demo": 40,
    "test_envs": 40,
    "test_hub": 40,
    "test_target_pose_auto": 40,
    "test_malformed": 40,
    "test_provenance": 40,
    "test_real_clouds": 40,
    "test_tasks": 40,
    "test_verify": 40,
    "test_view": 40,
    "test_composed": 35,
    "test_examples": 32,
    "test_cameras": 30,
    "test_gr1": 30,
    "test_descriptions": 28,
    "test_actions": 27,
    "test_functional": 27,
    "test_site": 27,
    "test_step_time": 26,
    "test_rendering": 26,
    "test_wrapper": 25,
    "test_lerobot_env": 22,
    "test_grasp": 21,
    "test_carried": 20,
    "test_manual": 20,
    "test_quality": 20,
    "test_results": 20,
    "test_robosuite": 20,
    "test_teleoperation": 20,
    "test_agreement": 19,
    "test_dp3": 18,
    "test_fast_reader": 17,
    "test_outputs": 17,
    "test_writing": 17,
}
"""Files of tests that take longer than `MOST_S`, and how many seconds of one core (round numbers are estimates). They begin first, longest
first, so that the processes that share the tests end together; `--fast` leaves them out."""

MOST_S = 16

# Shells and nohup have what they start in the background ignore these, and it would be so for every process that a test starts.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--fast", action="store_true", help="leave out the files that take long (SLOW of tests/conftest.py)"
    )


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    return True if config.getoption("--fast") and collection_path.stem in SLOW else None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: -SLOW.get(item.path.stem, 0))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    if not config.getoption("--fast"):
        return
    took_s: Counter[str] = Counter()
    for reports in terminalreporter.stats.values():
        for report in reports:
            if isinstance(report, pytest.TestReport):
                took_s[report.location[0]] += report.duration
    for file, s in took_s.most_common():
        if s > MOST_S:
            terminalreporter.write_line(
                f"{file} took {s:.0f} s. Where this machine was idle, name it in SLOW of tests/conftest.py."
            )


@pytest.fixture(scope="module", autouse=True)
def _memory_is_given_back() -> Iterator[None]:
    """A worker that has run many modules holds what the last one needs: glibc keeps what was freed, half a gigabyte and more."""
    gc.freeze()  # what has been imported stays: each environment that robosuite closes looks through everything, a second where all is loaded
    yield
    gc.collect()
    with contextlib.suppress(OSError, AttributeError):  # no glibc
        ctypes.CDLL("libc.so.6").malloc_trim(0)


@pytest.fixture
def complaint(capsys: pytest.CaptureFixture[str]) -> Callable[[], str]:
    """Reads what a command has said since last asked, which must be all that bad input gets: one line, `error: ...`."""

    def read() -> str:
        error = capsys.readouterr().err
        assert error.startswith("error: ") and error.count("\n") == 1, error
        return error

    return read


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small dataset with depth, as `killed.arguments` convert it. Who changes it copies it."""
    import killed  # not where no test needs it: it takes two seconds

    root = tmp_path_factory.mktemp("source") / "source"
    killed.write_source(root)
    return root


@pytest.fixture
def robomimic(tmp_path: Path) -> Path:
    """A file of robomimic's, with three demonstrations of a Panda."""
    import other_formats

    other_formats.write_robomimic(tmp_path / "demo.hdf5")
    return tmp_path / "demo.hdf5"


@pytest.fixture(scope="module")
def v21(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset as LeRobot 0.1 to 0.3 wrote it, with three demonstrations of a Panda. Who changes it copies it."""
    import other_formats

    root = tmp_path_factory.mktemp("old") / "pick"
    other_formats.write_v21(root)
    return root


@pytest.fixture(scope="module")
def third_party_robots() -> Iterator[None]:
    """Those of ../shared are found by their packages' names; see `third_party.needs_robots`."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CEI_GYM_PACKAGE_PATH", str(Path(__file__).parents[2] / "shared/robots"))
        yield
