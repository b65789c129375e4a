"""Bad input gives one line that says what would be right, an exit code, and no trace on disk."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import older
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from cei_converters.cli.options import parse_episodes
from cei_converters.dataset.schema import parse_joint_feature_name
from cei_converters.dataset.writer import DatasetWriter
from cei_gym.demonstration import Camera, Demonstration, Scene
from cei_gym.embodiment import load_embodiment
from cei_gym.errors import CEIError

ROBOT, TARGET = "Panda-PandaGripper", "IIWA-Inspire"
DATA = "data/chunk-000/file-000.parquet"


@pytest.fixture
def main(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[[list[str]], int]:
    from cei_converters import convert

    monkeypatch.delenv("HF_TOKEN", raising=False)
    monkeypatch.chdir(tmp_path)
    # One start is enough for input that is refused, and for episodes that stand still.
    return lambda args: convert.main([*args, "--init.starts=8", "--init.basins=1"])


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    body = load_embodiment(ROBOT)
    qpos = np.tile(body.home, (4, 1))
    K = np.array([[20.0, 0.0, 4.0], [0.0, 20.0, 4.0], [0.0, 0.0, 1.0]])
    workspace = np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 1.0]])
    scene = Scene(np.eye(4), (Camera("front", 8, 8, K, np.eye(4)),), workspace)
    depth_m = {"front": np.ones((4, 8, 8), np.float32)}
    root = tmp_path_factory.mktemp("good") / "pick"
    with DatasetWriter("me/pick", root) as writer:
        writer.add(Demonstration(ROBOT, 20.0, qpos, qpos, scene, depth_m=depth_m))
        qpos = qpos.copy()
        qpos[2, 0] += 0.5  # a jump, which a solver with few iterations cannot follow
        writer.add(Demonstration(ROBOT, 20.0, qpos, qpos, scene, depth_m=depth_m))
    return root


@pytest.fixture
def root(good: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(good, tmp_path / "pick"))


@pytest.fixture
def refuse(main: Callable, root: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> Callable[..., str]:
    def refuse(**changed: str | None) -> str:
        options = {
            "dataset.repo_id": "me/pick",
            "dataset.root": str(root),
            "target": TARGET,
            "new_repo_id": "me/out",
            "new_root": str(tmp_path / "sub" / "out"),
        } | {key.replace("__", "."): value for key, value in changed.items()}
        before = sorted(tmp_path.rglob("*"))
        code = main([f"--{key}={value}" for key, value in options.items() if value is not None])
        output = capsys.readouterr()
        assert code not in (0, None)
        assert output.err.startswith("error: ")
        assert output.err.count("\n") == 1, output.err
        assert "Traceback" not in output.err + output.out
        assert sorted(tmp_path.rglob("*")) == before
        return output.err

    return refuse


def edit_json(path: Path, edit: Callable[[dict], object]) -> None:
    data = json.loads(path.read_text())
    edit(data)
    path.write_text(json.dumps(data))


def edit_column(root: Path, key: str, edit: Callable[[np.ndarray], object]) -> None:
    table = pq.read_table(root / DATA)
    values = np.stack(table[key].to_numpy()).astype(np.float32)
    edit(values)
    place = table.column_names.index(key)
    column = pa.FixedSizeListArray.from_arrays(values.ravel(), values.shape[1]).cast(table.schema.field(place).type)
    pq.write_table(table.set_column(place, table.schema.field(place), column), root / DATA)


def rename_joint(root: Path, position: int, name: str) -> None:
    def edit(info: dict) -> None:
        info["features"]["observation.state"]["names"][position] = name

    edit_json(root / "meta/info.json", edit)


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"init": "elite"}, "unknown init.method 'elite'. Valid: multistart, eis, given."),
        ({"init__modes": "0"}, "init.modes=0 must be at least 1."),
        ({"init": "given"}, "init.method=given and init.qpos go together: give both or neither."),
        ({"solver__backend": "cuda"}, "unknown solver.backend 'cuda'. Valid: auto, numba, torch, paper."),
        ({"solver__device": "gpu"}, "unknown solver.device 'gpu'. Did you mean 'cpu'? Valid: auto, cpu, cuda, mps."),
        (
            {"solver__device": "cuda"},
            "solver.device=cuda is where torch computes, which solver.backend=auto does without; give solver.backend=torch, or leave "
            "it out.",
        ),
        (
            {"solver__paper__steps": "50"},
            "--solver.paper.steps is of no use without --solver.backend=paper; leave it out.",
        ),
        ({"transfer__method": "manual"}, "unknown transfer.method 'manual'. Valid: cei, bms."),
        (
            {"transfer__representation": "half"},
            "unknown transfer.representation 'half'. Valid: standard, reduced, dropped.",
        ),
    ],
)
def test_options_are_checked_before_any_work(option: dict, message: str, refuse: Callable) -> None:
    assert refuse(**option) == f"error: {message}\n"


def test_a_good_dataset_converts(main: Callable, root: Path, tmp_path: Path, capsys: Any) -> None:
    from cei_converters.sources.reader import DatasetReader

    out = tmp_path / "sub" / "out"
    args = [
        "--dataset.repo_id=me/pick",
        f"--dataset.root={root}",
        f"--target={TARGET}",
        "--new_repo_id=me/out",
    ]
    code = main([*args, f"--new_root={out}", "--json=result.json", "--allow_unreachable", "--transfer.points=32"])
    assert code == 0, capsys.readouterr().err
    assert "Wrote 2 episodes" in capsys.readouterr().out
    result = json.loads((tmp_path / "result.json").read_text())
    assert (result["episodes"], [entry["episode"] for entry in result["results"]]) == (2, [0, 1])
    reader = DatasetReader("me/out", out)
    assert reader.embodiment.name == TARGET
    assert reader.record(1)["source_episode"] == 1
    assert reader.record(1)["alignment"] == {
        k: v
        for k, v in result["results"][1].items()
        if k not in ("episode", "frames", "quality", "fidelity", "weakest")
    }
    assert reader.metadata.provenance.source.fingerprint.startswith("sha256:")
    assert reader.metadata.provenance.options["transfer"]["points"] == 32


@pytest.mark.parametrize("flag", [["--dry_run"], ["--dry_run=true"], ["--dry_run", "true"]])
def test_dry_run_writes_nothing(main: Callable, root: Path, tmp_path: Path, capsys: Any, flag: list[str]) -> None:
    before = sorted(tmp_path.rglob("*"))
    args = ["--dataset.repo_id=me/pick", f"--dataset.root={root}", f"--target={TARGET}", "--episodes=[0]"]
    assert main([*args, *flag]) == 0
    assert "pad distance" in capsys.readouterr().out
    assert sorted(tmp_path.rglob("*")) == before


def test_help_shows_an_example(main: Callable, capsys: Any) -> None:
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    for part in ("cei-convert --dataset.repo_id=", "--transfer.points", "Embodiment to convert to"):
        assert part in text


def test_options(refuse: Callable) -> None:
    assert "unknown option '--targett'. Did you mean '--target'? Valid: --dataset.repo_id" in refuse(targett="x")
    assert "--target is required" in refuse(target=None)
    assert "--dataset.repo_id is required" in refuse(dataset__repo_id=None)
    assert "--dry_run=maybe should be true or false." in refuse(dry_run="maybe")
    assert "--new_repo_id=<user>/<name> is required" in refuse(new_repo_id=None)
    assert "should read <user>/<name>" in refuse(new_repo_id="a/b/c")
    assert "/dev/null is no folder" in refuse(json="/dev/null/result.json")
    assert "leave one out" in refuse(dry_run="true", push_to_hub="true")
    assert "Did you mean 'Inspire'? Valid: FourierRight, " in refuse(target="IIWA-Inspir")
    assert "x,y,z,qw,qx,qy,qz" in refuse(source_pose="1,2")


def test_push_needs_a_login(refuse: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("huggingface_hub.get_token", lambda: None)
    assert "HF_TOKEN" in refuse(push_to_hub="true")


def test_episodes(refuse: Callable) -> None:
    assert "me/pick has no episode 2. Valid: 0 to 1." in refuse(episodes="0,2")
    assert "no episode -1" in refuse(episodes="-1")
    assert "repeats 0." in refuse(episodes="0-1,0")
    assert "no list of episode indices" in refuse(episodes="[]")
    for episodes in ("first", "3-1", "0-1-2", "0-", "-", "0-99999999999999"):
        assert "it should read like 0,3,5 or 0-99." in refuse(episodes=episodes)
    assert parse_episodes("[7, 0 - 2,5]") == [7, 0, 1, 2, 5]


def test_unreachable_episode(refuse: Callable) -> None:
    few = {"solver__iterations": "1", "transfer__stretch": "1"}
    refused = refuse(**few)
    assert "IIWA-Inspire does not follow the source in episode 1, frame 2: at frame 2 r_" in refused
    assert " mm away: " in refused and "--allow_unreachable" in refused
    assert "does not follow the source in episode 1, frame 2: at frame 2 r_" in refuse(dry_run="true", **few)


def test_existing_output(refuse: Callable, tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    assert "already exists" in refuse(new_root=str(tmp_path / "there"))


def test_missing_dataset(refuse: Callable, tmp_path: Path) -> None:
    assert "meta/info.json is missing; set --dataset.root" in refuse(dataset__root=str(tmp_path / "none"))


def test_missing_dataset_on_the_hub(refuse: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    assert "be fetched from the hub" in refuse(dataset__root=None, dataset__repo_id="me/none")


@pytest.mark.parametrize("version", ["v2.0", "v2.1", "v4.0"])
def test_other_versions(refuse: Callable, root: Path, version: str) -> None:
    edit_json(root / "meta/info.json", lambda info: info.update(codebase_version=version))
    message = refuse()
    assert version in message
    assert ("but has no meta/episodes.jsonl" in message) == (version < "v3")


def test_missing_metadata(refuse: Callable, root: Path) -> None:
    shutil.rmtree(root / "meta/episodes")
    assert "meta/episodes is missing" in refuse()
    (root / "meta/cei.json").unlink()
    assert "meta/episodes is missing" in refuse()  # features still say whose it is
    older.forget(root)
    message = refuse()
    for text in ("meta/cei.json", "scene.T_world_base", "--source="):
        assert text in message


def test_metadata_can_be_given(main: Callable, root: Path, capsys: Any) -> None:
    (root / "meta/cei.json").unlink()
    older.forget(root)
    edit_json(root / "meta/info.json", lambda info: info["features"].pop("observation.depth.front"))
    args = ["--dataset.repo_id=me/pick", f"--dataset.root={root}", f"--target={TARGET}", "--dry_run"]
    code = main([*args, "--episodes=0", f"--source={ROBOT}", "--source_pose=0,0,0.5"])
    assert code == 0, capsys.readouterr().err


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda m: m.update(embodiment="Panda-PandaGriper"), "Did you mean 'PandaGripper'? Valid:"),
        (lambda m: m.update(embodiment=TARGET), "observation.state has 9 joints but IIWA-Inspire has"),
        (lambda m: m.pop("scene"), "Missing required field(s) `scene`"),
        (lambda m: m["scene"]["cameras"][0].pop("K"), "`K`"),
        (lambda m: m["scene"]["cameras"][0].update(K=[[1, 2], [3, 4]]), "'front': K should be 3x3"),
        (lambda m: m["scene"].update(T_world_base=[[1, 2], [3, 4]]), "T_world_base should be a 4x4"),
        (lambda m: m["scene"].update(T_world_base="here"), "T_world_base"),
        (lambda m: m["scene"].update(cameras=[]), "observation.depth.front has no calibration"),
        (lambda m: m.update(format_version="9.0"), "format_version is 9.0"),
    ],
)
def test_wrong_metadata(refuse: Callable, root: Path, edit: Callable, message: str) -> None:
    older.forget(root)
    edit_json(root / "meta/cei.json", edit)
    assert message in refuse()


def test_metadata_is_no_json(refuse: Callable, root: Path) -> None:
    (root / "meta/cei.json").write_text("{")
    assert "meta/cei.json cannot be read" in refuse()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("joint1.pos_deg", "joint1.pos_deg: degrees are not supported, convert to rad"),
        ("joint1.pos", "it should read 'joint1.pos_rad' or 'joint1.pos_m'"),
        ("joint1", "it should read 'joint1.pos_rad'"),
        ("joint1.pos_mm", "Valid: rad, m"),
        ("elbow.pos_rad", "joint 0 is 'elbow.pos_rad' but Panda-PandaGripper has 'joint1.pos_rad' there"),
        ("joint2.pos_rad", "its order is joint1.pos_rad, joint2.pos_rad"),
    ],
)
def test_joint_names(refuse: Callable, root: Path, name: str, message: str) -> None:
    rename_joint(root, 0, name)
    assert message in refuse()


def test_joint_names_parse() -> None:
    assert parse_joint_feature_name("a.pos_b.pos_m") == ("a.pos_b", "m")
    with pytest.raises(CEIError):
        parse_joint_feature_name(".pos_rad")


def test_missing_feature(refuse: Callable, root: Path) -> None:
    edit_json(root / "meta/info.json", lambda info: info["features"].pop("action"))
    assert "has no feature 'action'. It has: observation.state" in refuse()


def test_values(refuse: Callable, root: Path) -> None:
    def degrees(values: np.ndarray) -> None:
        values[5, 3] = -135.0

    edit_column(root, "observation.state", degrees)
    assert "episode 1, frame 1, joint joint4: observation.state is -135 rad" in (message := refuse(episodes="1"))
    assert "looks like degrees; convert to rad" in message

    def nan(values: np.ndarray) -> None:
        values[2, 8] = np.nan

    edit_column(root, "action", nan)
    assert "episode 0, frame 2, joint finger_joint2: action is nan" in refuse()


def test_empty_episode(refuse: Callable, root: Path) -> None:
    table = pq.read_table(root / DATA)
    pq.write_table(table.slice(0, 4), root / DATA)
    assert "episode 1 has no frames; leave it out with --episodes" in refuse()


def test_corrupt_files(refuse: Callable, root: Path) -> None:
    whole = (root / DATA).read_bytes()
    (root / DATA).write_bytes(whole[: len(whole) // 2])
    assert f"{DATA} cannot be read" in refuse()
    (root / DATA).unlink()
    assert f"{DATA} cannot be read" in refuse()
    (root / "meta/episodes/chunk-000/file-000.parquet").write_bytes(b"PAR1")
    assert "meta/episodes/chunk-000/file-000.parquet cannot be read" in refuse()
    (root / "meta/info.json").write_text("{")
    assert "meta/info.json cannot be read" in refuse()


def test_interrupt_leaves_nothing(main: Callable, root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("cei_gym.transfer.Transfer.aligned", interrupt)
    before = sorted(tmp_path.rglob("*"))
    args = [
        "--dataset.repo_id=me/pick",
        f"--dataset.root={root}",
        f"--target={TARGET}",
        "--new_repo_id=me/out",
    ]
    assert main([*args, f"--new_root={tmp_path / 'sub' / 'out'}"]) == 130
    assert sorted(tmp_path.rglob("*")) == before
