"""What does not depend on the robot is carried over, frame by frame, and what does is listed."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from cei_converters import convert
from cei_converters.dataset import schema
from cei_converters.dataset.carried import choose
from cei_converters.sources.formats import open_source
from cei_gym.embodiment import load_embodiment

ROBOT = "Panda-PandaGripper"
BODY = load_embodiment(ROBOT)
LENGTHS = (12, 9)
TASKS = ("pick the cube", "place the cube", "rest")


def value(dtype: str, shape: tuple[int, ...]) -> dict[str, Any]:
    return {"dtype": dtype, "shape": shape, "names": None}


CARRIED = {
    "next.reward": value("float32", (1,)),
    "next.done": value("bool", (1,)),
    "next.success": value("bool", (2,)),
    "language_instruction": value("string", (1,)),
    "subtask_index": value("int64", (1,)),
    "annotation.human.action.task_description": value("int64", (1,)),
    "complementary_info.is_intervention": value("uint8", (1,)),
    "language_embedding": value("float64", (5,)),
    "stage_scores": value("float16", (2, 3)),
    "counts": value("int8", (4,)),
    "observation.instruction": value("string", (1,)),
}
DROPPED = {
    "observation.velocity": value("float32", (9,)),
    "observation.effort": value("float32", (1,)),
    "action.torque": value("float32", (9,)),
    "eef_pose": value("float32", (6,)),
    "gripperState": value("float32", (1,)),
    "extra": {**value("float32", (2,)), "names": ["joint1.vel", "joint2.vel"]},
    "next.state": value("float32", (9,)),
}


def task_of(episode: int, t: int) -> str:
    """Two tasks an episode, the first of which changes in the middle."""
    return TASKS[2 * episode] if episode else TASKS[t >= 5]


def frame(episode: int, t: int) -> dict[str, Any]:
    """What no other frame has, in every feature that is carried."""
    k = 20 * episode + t
    return {
        "next.reward": np.array([k / 7], np.float32),
        "next.done": np.array([t == LENGTHS[episode] - 1]),
        "next.success": np.array([k % 2 == 0, k % 3 == 0]),
        "language_instruction": f"do {k}",
        "subtask_index": np.array([k % 4], np.int64),
        "annotation.human.action.task_description": np.array([k % 3], np.int64),
        "complementary_info.is_intervention": np.array([k % 2], np.uint8),
        "language_embedding": np.arange(5) + k / 3,
        "stage_scores": (np.arange(6).reshape(2, 3) + k).astype(np.float16),
        "counts": (np.arange(4) - k).astype(np.int8),
        "observation.instruction": f"seen {k}",
    }


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As LeRobot itself writes it, of a Panda that turns faster than its target can."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    root = tmp_path_factory.mktemp("carried") / "pick"
    names = schema.joint_feature_names(BODY)
    joints = {"dtype": "float32", "shape": (len(names),), "names": names}
    features = {schema.STATE: joints, schema.ACTION: joints, **CARRIED, **DROPPED}
    dataset = LeRobotDataset.create(
        "me/pick", fps=20, features=features, root=root, robot_type="panda", use_videos=False
    )
    for episode, length in enumerate(LENGTHS):
        for t in range(length):
            qpos = BODY.home.astype(np.float32)
            qpos[0] += 0.1 * max(t - 4, 0)
            others = {key: np.zeros(feature["shape"], np.float32) for key, feature in DROPPED.items()}
            known = {schema.STATE: qpos, schema.ACTION: qpos, "task": task_of(episode, t)}
            dataset.add_frame(known | frame(episode, t) | others)
        dataset.save_episode()
    dataset.finalize()
    return root


def run(root: Path, out: Path, *options: str) -> int:
    args = ["--dataset.repo_id=me/pick", f"--dataset.root={root}", f"--source={ROBOT}", "--target=IIWA-PandaGripper"]
    quick = ["--init.starts=8", "--init.basins=1", "--allow_unreachable", "--new_repo_id=me/out", f"--new_root={out}"]
    return convert.main([*args, *quick, *options])


@pytest.fixture(scope="module")
def converted(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("out") / "out"
    assert run(source, out, f"--json={out.parent / 'result.json'}") == 0
    return out


def plain(found: Any) -> Any:
    return found if isinstance(found, str) else np.asarray(found).ravel()


def test_every_frame_has_what_its_source_frame_has(converted: Path) -> None:
    """Read by LeRobot itself; repeated frames repeat it."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    from cei_converters.dataset.records import Records

    dataset, records = LeRobotDataset("me/out", converted), Records(converted)
    assert [record["source_episode"] for record in records] == [0, 1]
    count = 0
    for episode, record in enumerate(records):
        frames = record.get("source_frames", list(range(LENGTHS[episode])))
        assert len(frames) > LENGTHS[episode]  # it had to wait
        for t in frames:
            item = dataset[count]
            count += 1
            for key, expected in frame(episode, t).items():
                found, expected = plain(item[key]), plain(expected)
                if key == "language_embedding":  # which LeRobot gives in single precision
                    expected = expected.astype(np.float32)
                np.testing.assert_array_equal(found, expected, err_msg=f"{key}, frame {t}")
            assert item["task"] == task_of(episode, t)
    assert count == len(dataset)


def test_tasks_stay_per_frame_with_their_numbers(source: Path, converted: Path) -> None:
    """An annotation may refer to them by number."""
    import pandas as pd

    tables = [pd.read_parquet(root / "meta/tasks.parquet") for root in (source, converted)]
    assert tables[0]["task_index"].to_dict() == tables[1]["task_index"].to_dict()
    episodes = pq.read_table(converted / "meta/episodes/chunk-000/file-000.parquet")
    assert episodes["tasks"].to_pylist() == [[TASKS[0], TASKS[1]], [TASKS[2]]]


def test_tasks_stay_per_frame_though_their_numbers_have_gaps_and_nothing_else_is_carried(
    source: Path, tmp_path: Path
) -> None:
    import pandas as pd

    root = Path(shutil.copytree(source, tmp_path / "pick"))
    tasks, data = root / "meta/tasks.parquet", root / "data/chunk-000/file-000.parquet"
    numbers = pd.read_parquet(tasks)
    numbers["task_index"] *= 2
    numbers.to_parquet(tasks)
    table = pq.read_table(data)
    doubled = pa.array(2 * table["task_index"].to_numpy())
    pq.write_table(table.set_column(table.schema.get_field_index("task_index"), "task_index", doubled), data)
    assert run(root, tmp_path / "out", f"--drop_features={','.join(CARRIED)}") == 0
    out = open_source("me/out", tmp_path / "out")
    for episode in range(len(out)):
        frames = out.record(episode)["source_frames"]
        assert out.carry(episode).tasks == tuple(task_of(episode, t) for t in frames)


def test_types_shapes_and_statistics_are_lerobots(source: Path, converted: Path) -> None:
    info = [json.loads((root / "meta/info.json").read_text())["features"] for root in (source, converted)]
    for key in CARRIED:
        assert info[0][key] == info[1][key]
    stats = json.loads((converted / "meta/stats.json").read_text())
    table = pq.read_table(next(converted.glob("data/*/*.parquet")))
    reward = table["next.reward"].to_numpy()
    assert stats["next.reward"]["mean"] == pytest.approx([reward.mean()], rel=1e-5)
    assert stats["next.reward"]["max"] == pytest.approx([reward.max()]) and stats["next.reward"]["count"] == [
        len(reward)
    ]
    assert (
        table.schema.field("next.done").type == pa.bool_() and table.schema.field("counts").type.value_type == pa.int8()
    )
    assert not {"language_instruction", "observation.instruction"} & set(stats)


def test_what_is_not_carried_is_listed(
    source: Path, converted: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    result = json.loads((converted.parent / "result.json").read_text())
    assert set(result["carried_features"]) == set(CARRIED) and set(result["dropped_features"]) == set(DROPPED)
    assert result["dropped_features"]["observation.velocity"] == "of the source robot"
    assert result["dropped_features"]["gripperState"] == "of the source robot, as 'gripper' in its name says"
    card = (converted / "README.md").read_text()
    for key in CARRIED:
        assert f"`{key}`" in card.split("Carried over")[1].split("\n")[0]
    for key, reason in result["dropped_features"].items():
        assert f"| `{key}` | {reason} |" in card
    made = json.loads((converted / "meta/cei.json").read_text())["provenance"]["source"]
    assert set(made["carried"]) == set(CARRIED) and made["dropped"] == result["dropped_features"]
    capsys.readouterr()
    assert (
        run(
            source,
            tmp_path / "out",
            "--episodes=1",
            "--drop_features=next.reward, counts",
            "--json=none.json",
            "--dry_run",
        )
        == 0
    )
    said = " ".join(capsys.readouterr().out.split())
    assert "Carried over as they are: next.done, next.success, language_instruction" in said
    assert "Not carried over, --drop_features: next.reward, counts." in said
    assert "Not carried over, of the source robot: observation.velocity, observation.effort, action.torque." in said
    Path("none.json").unlink()
    assert run(source, tmp_path / "out", "--drop_features=rewards") == 1
    assert "unknown feature that is carried over 'rewards'. Did you mean 'next.reward'?" in capsys.readouterr().err


def test_it_converts_again_with_all_of_it(converted: Path, tmp_path: Path) -> None:
    args = [
        "--dataset.repo_id=me/out",
        f"--dataset.root={converted}",
        "--target=UR5e-PandaGripper",
        "--new_repo_id=me/again",
    ]
    quick = ["--init.starts=8", "--init.basins=1", "--allow_unreachable", f"--new_root={tmp_path / 'again'}"]
    assert convert.main([*args, *quick, "--episodes=1"]) == 0
    again, first = open_source("me/again", tmp_path / "again"), open_source("me/out", converted)
    assert list(again.carried) == list(CARRIED)
    assert again.carry(0).tasks is not None and set(again.carry(0).tasks or ()) == {TASKS[2]}
    length = min(len(again.carry(0).columns["counts"]), len(first.carry(1).columns["counts"]))
    np.testing.assert_array_equal(again.carry(0).columns["counts"][0], first.carry(1).columns["counts"][0])
    assert length >= LENGTHS[1]


def test_objects_that_are_moved_are_not_told_to_be_where_they_were(source: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert (
        run(source, out, "--episodes=1", "--augment.grid=1,2", f"--json={tmp_path / 'r.json'}", "--transfer.stretch=1")
        == 0
    )
    result = json.loads((tmp_path / "r.json").read_text())
    reason = "may say where objects are, which are moved"
    assert {key for key, why in result["dropped_features"].items() if why == reason} == {
        "language_embedding",
        "stage_scores",
    }
    assert len(open_source("me/out", out)) == 2


def test_lerobots_language_columns_are_carried(source: Path, tmp_path: Path) -> None:
    import shutil

    from datasets.table import cast_array_to_feature
    from lerobot.datasets.language import (
        LANGUAGE_EVENTS,
        LANGUAGE_PERSISTENT,
        language_events_column_feature,
        language_feature_info,
        language_persistent_column_feature,
    )
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    root = Path(shutil.copytree(source, tmp_path / "pick"))
    info = json.loads((root / "meta/info.json").read_text())
    info["features"] |= {key: feature | {"shape": [1]} for key, feature in language_feature_info().items()}
    (root / "meta/info.json").write_text(json.dumps(info))
    path = next(root.glob("data/*/*.parquet"))
    table = pq.read_table(path)

    def said(k: int, **more: float) -> dict[str, Any]:
        return {
            "role": "user",
            "content": f"say {k}",
            "style": "subtask",
            **more,
            "camera": None,
            "tool_calls": ['{"a": 1}'],
        }

    texts = [(name, pa.string()) for name in ("role", "content", "style", "camera")]
    kind = pa.struct([*texts, ("tool_calls", pa.list_(pa.string()))])
    timed = pa.struct([*texts[:3], ("timestamp", pa.float32()), texts[3], ("tool_calls", pa.list_(pa.string()))])
    rows = [[said(k)] * (k % 3) for k in range(len(table))]
    events = cast_array_to_feature(pa.array(rows, pa.list_(kind)), language_events_column_feature())
    rows = [[said(k, timestamp=k / 20)] for k in range(len(table))]
    lasting = cast_array_to_feature(pa.array(rows, pa.list_(timed)), language_persistent_column_feature())
    table = table.append_column(LANGUAGE_PERSISTENT, lasting).append_column(LANGUAGE_EVENTS, events)
    pq.write_table(table.replace_schema_metadata(), path)
    assert run(root, tmp_path / "out", "--episodes=0") == 0
    from cei_converters.dataset.records import Records

    frames = Records(tmp_path / "out")[0].get("source_frames", list(range(LENGTHS[0])))
    made = pq.read_table(next((tmp_path / "out").glob("data/*/*.parquet")))
    contents = [[row["content"] for row in rows] for rows in made[LANGUAGE_EVENTS].to_pylist()]
    assert contents == [[f"say {t}"] * (t % 3) for t in frames]
    assert [rows[0]["content"] for rows in made[LANGUAGE_PERSISTENT].to_pylist()] == [f"say {t}" for t in frames]
    assert LeRobotDataset("me/out", tmp_path / "out")[3][LANGUAGE_PERSISTENT][0]["content"] == f"say {frames[3]}"


@pytest.mark.parametrize(
    ("key", "feature", "carried"),
    [
        ("is_first", value("bool", (1,)), True),
        ("discount", value("float32", (1,)), True),
        ("episode.success", value("bool", (1,)), True),
        ("leader.joint_1", value("float32", (1,)), False),
        ("tcp_force", value("float32", (3,)), False),
        ("wrist.imu", value("float32", (3,)), False),
        ("jointTorques", value("float32", (7,)), False),
        ("anything", value("complex64", (1,)), False),
        ("deep", value("float32", (1, 1, 1, 1, 1, 1)), False),
    ],
)
def test_names_say_what_depends_on_the_robot(key: str, feature: dict, carried: bool) -> None:
    kept, dropped = choose({key: feature}, ())
    assert (key in kept, key in dropped) == (carried, not carried)


@pytest.mark.parametrize("missing", ["next.reward", "language_instruction"])
def test_a_value_that_is_missing(missing: str, source: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    """Numbers cannot be told from it, texts can: they stay null."""
    import shutil

    root = Path(shutil.copytree(source, tmp_path / "pick"))
    path = next(root.glob("data/*/*.parquet"))
    table = pq.read_table(path)
    place, rows = table.column_names.index(missing), table[missing].to_pylist()
    rows[3] = None
    table = table.set_column(place, table.schema.field(place), pa.array(rows, table.schema.field(place).type))
    pq.write_table(table, path)
    code = run(root, tmp_path / "out")
    if missing == "next.reward":
        assert code == 1 and not (tmp_path / "out").exists()
        assert "episode 0, next.reward: 1 frames have no value" in (said := capsys.readouterr().err)
        assert "leave it out with --drop_features=next.reward" in said
        assert run(root, tmp_path / "out", "--drop_features=next.reward") == 0
    else:
        assert code == 0
