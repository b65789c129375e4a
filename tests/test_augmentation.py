"""Spatial augmentation: the ramp, what moves where, and episodes that can be replayed from their new starts."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import killed
import numpy as np
import pytest
from conversions import record_cubes, records, same
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from cei_converters import convert, record, replay, view
from cei_converters.conversion import shard
from cei_converters.conversion.augment import Augmentation, AugmentOptions
from cei_converters.dataset import schema
from cei_converters.dataset.columns import encode
from cei_converters.dataset.encoded import encode_episode
from cei_converters.dataset.writer import DatasetWriter, Header
from cei_converters.sources.reader import DatasetReader
from cei_gym.alignment import InitialisationOptions
from cei_gym.augmentation import (
    Handling,
    Offset,
    anchored,
    boxes_of_state,
    carried_box,
    displace,
    displacement,
    grid_offsets,
    move_state,
    ramp,
)
from cei_gym.demonstration import Demonstration, Scene
from cei_gym.displacement import Boxes
from cei_gym.embodiment import load_embodiment
from cei_gym.embodiment.meshes import visual_link_meshes
from cei_gym.errors import CEIError
from cei_gym.kinematics import KinematicTree
from cei_gym.pointcloud import CloudOptions, RobotMask
from cei_gym.transfer import Transfer, TransferOptions

SOURCE, TARGET = "Panda-PandaGripper", "UR5e-PandaGripper"
FRAMES = 10
OFFSET, ABOUT = Offset(0.07, -0.04, 0.5), np.array([0.3, 0.1, 0.8])
CUBE = tuple(f"cube.{e}" for e in ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz", "half_x_m", "half_y_m", "half_z_m"))


def handling(held: list[int], frames: int = FRAMES, touched: list[int] | None = None) -> Handling:
    """A hand that rises by 1 cm a frame, and turns, over the origin."""
    T = np.tile(np.eye(4), (frames, 1, 1))
    T[:, 2, 3] = 0.01 * np.arange(frames)
    T[:, :3, :3] = Rotation.from_rotvec(np.outer(np.arange(frames), [0, 0, 0.1])).as_matrix()
    return Handling(np.isin(np.arange(frames), held), T[:, :3, 3], T, np.isin(np.arange(frames), touched or []))


# -- geometry ------------------------------------------------------------------------------------------------------------


def test_the_ramp_is_the_papers() -> None:
    L = 25
    np.testing.assert_allclose(ramp(L, 0.8 * L), [min(t / (0.8 * L), 1) for t in range(L)])
    np.testing.assert_array_equal(ramp(3, 0), 1)


def test_without_a_turn_points_go_the_papers_way() -> None:
    X, L = np.random.default_rng(0).normal(size=(FRAMES, 5, 3)), ramp(FRAMES, 6.5)
    T = displacement(Offset(0.1, -0.2), ABOUT, L)
    paper = X + L[:, None, None] * ((X + [0.1, -0.2, 0]) - X)
    np.testing.assert_allclose(X @ T[:, :3, :3].mT + T[:, None, :3, 3], paper, atol=1e-12)


def test_a_turn_is_about_the_vertical_through_the_hold_and_bends_nothing() -> None:
    T = displacement(OFFSET, ABOUT, ramp(FRAMES, 6))
    np.testing.assert_allclose(T[0], np.eye(4), atol=1e-12)
    np.testing.assert_allclose(T[6:], np.tile(displacement(OFFSET, ABOUT), (FRAMES - 6, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(T[:, :3, :3].mT @ T[:, :3, :3], np.tile(np.eye(3), (FRAMES, 1, 1)), atol=1e-12)
    half = T[3]  # of the way
    np.testing.assert_allclose(half[:3, :3] @ ABOUT + half[:3, 3], ABOUT + [0.035, -0.02, 0], atol=1e-12)
    np.testing.assert_allclose(half[:3, :3] @ [1, 0, 0], [np.cos(0.25), np.sin(0.25), 0], atol=1e-12)


def test_a_grid_is_even_and_around_the_recorded_place() -> None:
    places = [(o.x_m, o.y_m) for o in grid_offsets((3, 2), (0.2, 0.1))]
    assert places == [(-0.1, -0.05), (-0.1, 0.05), (0.0, -0.05), (0.0, 0.05), (0.1, -0.05), (0.1, 0.05)]
    assert grid_offsets((1, 1), (0.2, 0.2)) == [Offset(0.0, 0.0)]


def test_around_each_anchor_is_the_same_grid() -> None:
    around = grid_offsets((1, 2), (0.2, 0.1))
    places = [(o.x_m, o.y_m) for o in anchored([Offset(0.2, 0.0), Offset(-0.1, 0.3)], around)]
    np.testing.assert_allclose(places, [(0.2, -0.05), (0.2, 0.05), (-0.1, 0.25), (-0.1, 0.35)], atol=1e-12)


def test_the_approach_ends_where_the_hand_takes_hold_or_else_first_touches_something() -> None:
    assert [handling(*given).approach for given in (([4, 5], 10, [2]), ([], 10, [2, 3]), ([], 10))] == [4, 2, 10]
    np.testing.assert_allclose(handling([], 10, [2, 3]).place_world, [0, 0, 0.02])
    np.testing.assert_allclose(handling([], 10).place_world, [0, 0, 0.09])


def test_a_moved_state_is_that_of_the_moved_object() -> None:
    pose, T = Rotation.random(rng=np.random.default_rng(1)), displacement(OFFSET, ABOUT)
    place, corner = np.array([0.2, -0.1, 0.83]), np.array([0.02, 0.021, 0.022])
    state = np.array([[*place, *pose.as_quat(scalar_first=True), *corner]])
    (moved,) = move_state(state, CUBE, T)
    np.testing.assert_array_equal(moved[7:], corner)
    there = moved[:3] + Rotation.from_quat(moved[3:7], scalar_first=True).apply(corner)
    np.testing.assert_allclose(there, T[:3, :3] @ (place + pose.apply(corner)) + T[:3, 3], atol=1e-12)


def test_a_yaw_stays_within_half_a_turn() -> None:
    names = ("cabinet.x_m", "cabinet.y_m", "cabinet.yaw_rad", "drawer.opening_m")
    (moved,) = move_state(np.array([[*ABOUT[:2], 3.0, 0.02]]), names, displacement(OFFSET, ABOUT))
    np.testing.assert_allclose(moved, [0.37, 0.06, 3.5 - 2 * np.pi, 0.02], atol=1e-12)


def test_a_state_without_places_is_refused() -> None:
    with pytest.raises(CEIError, match=r"augmented starts need <object>.x_m and <object>.y_m"):
        move_state(np.zeros((1, 1)), ("drawer.opening_m",), np.eye(4))


# -- which points are objects' -------------------------------------------------------------------------------------------


def test_what_the_hand_carries_takes_its_part_of_the_box_along() -> None:
    boxes = carried_box(np.array([[-0.02, -0.02, 0.0], [0.1, 0.02, 0.04]]), handling([4, 5, 6]))
    middle = np.array([0.04, 0.0, 0.02])
    carried = Rotation.from_rotvec([0, 0, 0.2]).apply(middle) + [0, 0, 0.02]  # two frames of the hand's way
    for t, where in {3: middle, 4: middle, 6: carried, 9: carried}.items():
        np.testing.assert_allclose(boxes.T_world_box[t, :, :3, 3], [middle, where], atol=1e-12)
    points = np.array([[0.09, 0.01, 0.03], [0.06, 0.03, 0.055], [0.09, -0.01, 0.055]])
    assert boxes.contains(points, 3).tolist() == [True, False, False]
    assert boxes.contains(points, 9).tolist() == [True, True, False]


def test_the_state_says_where_objects_are() -> None:
    turned = Rotation.from_euler("z", 45, degrees=True).as_quat(scalar_first=True)
    state = np.array([[0.1, 0.2, 0.8, *turned, 0.02, 0.02, 0.02]])
    boxes = boxes_of_state(state, CUBE)
    along = np.array([1, 1, 0]) / np.sqrt(2)
    points = state[0, :3] + np.array([0.029 * along, [0.031, 0, 0], 0.031 * along, [0, 0, 0.031]])
    assert boxes.contains(points, 0).tolist() == [True, True, False, False]
    with pytest.raises(CEIError, match=r"does not say how large cabinet is .* give --augment.half_m"):
        boxes_of_state(np.zeros((1, 2)), ("cabinet.x_m", "cabinet.y_m"))
    column = boxes_of_state(np.zeros((1, 2)), ("cabinet.x_m", "cabinet.y_m"), half_m=0.1)
    assert column.contains(np.array([[0.1, 0, 5.0], [0.12, 0, 0]]), 0).tolist() == [True, False]


# -- transfers -----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def demonstration() -> Demonstration:
    """A Panda that leans forward; beside it a block, and something that does not belong to it."""
    body, s = load_embodiment(SOURCE), np.linspace(0, 1, FRAMES)[:, None]
    qpos = body.home + s * np.array([0.1, 0.15, 0, -0.1, 0, 0.1, 0, 0, 0])
    random = np.random.default_rng(0)
    block = random.uniform([0.45, 0.35, 0.05], [0.5, 0.4, 0.1], (150, 3))
    rest = random.uniform([0.4, -0.45, 0.05], [0.5, -0.35, 0.1], (150, 3))
    cloud = np.tile(np.concatenate([block, rest]).astype(np.float32), (FRAMES, 1, 1))
    scene = Scene(np.eye(4), (), np.array([[-1.0, -1.0, 0.0], [1.2, 1.2, 1.2]]))
    return Demonstration(SOURCE, 20.0, qpos, qpos, scene, point_cloud_world=cloud)


@pytest.fixture(scope="module")
def transfer(demonstration: Demonstration) -> Callable[..., Transfer]:
    def make(**options) -> Transfer:
        given = TransferOptions(points=16), None, InitialisationOptions(starts=16, basins=2)
        clouds = CloudOptions(robot_points=2048, points=600)
        return Transfer(load_embodiment(SOURCE), load_embodiment(TARGET), *given, None, clouds, **options)

    return make


def test_a_source_that_is_displaced_throughout_is_one_that_stands_elsewhere(
    demonstration: Demonstration, transfer: Callable
) -> None:
    here = transfer(T_world_target=np.eye(4))
    moved = displace(demonstration, here.handling(demonstration), OFFSET, whole=0)
    base = displacement(OFFSET, here.handling(demonstration).place_world)
    there = replace(demonstration, scene=replace(demonstration.scene, T_world_base=base), point_cloud_world=None)
    here.fit([moved])
    other = transfer(T_world_target=np.eye(4))
    other.start_from(here.finalists)
    got, _ = here(replace(moved, point_cloud_world=None))
    expected, _ = other(there)
    np.testing.assert_allclose(got.qpos, expected.qpos, atol=1e-6)
    assert got.displacement is None


def test_the_hand_goes_from_where_it_was_to_where_objects_are(demonstration: Demonstration, transfer: Callable) -> None:
    t = transfer()
    t.fit([demonstration])
    plain, _ = t(demonstration, clouds=False)
    hand, offset = t.handling(demonstration), Offset(0.05, 0.03, 0.3)
    moved, _ = t(displace(demonstration, hand, offset, whole=0.8 * len(plain)), clouds=False)
    target = transfer().problem
    before, after = (target.place(load_embodiment(TARGET).coupled.reduce(d.qpos))[0] for d in (plain, moved))
    np.testing.assert_allclose(after[0], before[0], atol=2e-3)
    T = displacement(offset, hand.place_world)
    np.testing.assert_allclose(after[-1], before[-1] @ T[:3, :3].T + T[:3, 3], atol=5e-3)


def test_clouds_show_when_a_hand_that_holds_nothing_is_at_something(
    demonstration: Demonstration, transfer: Callable
) -> None:
    t, d = transfer(), demonstration
    assert not t.handling(d).touched.any()  # all is far off
    points, _ = t.source_representation.place(KinematicTree(t.source).forward(d.qpos))
    tip = points[6, points[6, :, 2].argmin()]
    below = tip - [0, 0, 0.01] + np.random.default_rng(1).uniform([-0.01, -0.01, -0.01], [0.01, 0.01, 0.0], (60, 3))
    beside = replace(d, point_cloud_world=np.concatenate([d.point_cloud_world, np.tile(below, (FRAMES, 1, 1))], axis=1))
    touched = t.handling(beside).touched
    assert touched[6]
    assert not touched[0]
    assert t.handling(beside).approach == touched.argmax()
    assert not t.handling(replace(d, point_cloud_world=None)).touched.any()


def test_only_the_objects_points_move(demonstration: Demonstration, transfer: Callable) -> None:
    t, recorded = transfer(), demonstration
    T_box = np.tile(np.eye(4), (FRAMES, 1, 1, 1))
    T_box[:, 0, :3, 3] = [0.475, 0.375, 0.075]
    hand = t.handling(recorded)
    moved = displace(recorded, hand, OFFSET, 5, Boxes(T_box, np.full((1, 3), 0.03)))
    T = displacement(OFFSET, hand.place_world)
    block, rest = np.split(recorded.point_cloud_world[0].astype(float), 2)
    expected = np.concatenate([block @ T[:3, :3].T + T[:3, 3], rest])
    converted, _ = t(moved)
    target = load_embodiment(TARGET)
    on_robot = RobotMask(visual_link_meshes(target.model), tau_m=1e-3)
    for cloud, T_links in zip(converted.point_cloud_world, KinematicTree(target).forward(converted.qpos), strict=True):
        objects = cloud[~on_robot(cloud, T_links)]
        distance_m, which = KDTree(expected).query(objects)
        assert distance_m.max() < 1e-5
        assert np.bincount(which >= len(block)).min() > 10  # of the block, and of what does not belong to it


# -- the command ---------------------------------------------------------------------------------------------------------

AUGMENT = ("--augment.grid=2,2", "--augment.range=0.1,0.06", "--augment.rotation_deg=20", "--episodes=0,3")


@pytest.fixture(scope="module")
def augmented(source: Path) -> Path:
    root = source.with_name("augmented")
    assert convert.main([*killed.arguments(source, root, *AUGMENT, f"--json={root}.json")]) == 0
    return root


def test_every_episode_becomes_one_for_each_place(augmented: Path) -> None:
    found = records(augmented)
    assert [r["source_episode"] for r in found] == [0] * 4 + [3] * 4
    offsets = [r["offset"] for r in found]
    places = [(-0.05, -0.03), (-0.05, 0.03), (0.05, -0.03), (0.05, 0.03)]
    assert [(o["x_m"], o["y_m"]) for o in offsets] == places * 2
    turns = [o["yaw_rad"] for o in offsets]
    assert len(set(turns)) == 8
    assert np.abs(turns).max() <= np.radians(20)
    counted = json.loads(Path(f"{augmented}.json").read_text())["augment"]
    assert counted == {"episodes": 8, "kept": 8, "left_out": {}}
    assert "2 recorded episodes became 8" in (augmented / "README.md").read_text()


def test_an_episode_is_shown_beside_its_source_without_residuals(source: Path, augmented: Path, tmp_path: Path) -> None:
    shown = ["--dataset.repo_id=me/out", f"--dataset.root={augmented}", "--episode=5"]
    beside = ["--source.repo_id=me/pick", f"--source.root={source}"]
    assert view.main([*shown, *beside, f"--sheet={tmp_path / 'x.png'}", f"--json={tmp_path / 'x.json'}"]) == 0
    assert (tmp_path / "x.png").stat().st_size > 1000
    assert json.loads((tmp_path / "x.json").read_text())["residuals"] == {}  # its pads are not where the source's were


def test_it_is_the_same_however_it_is_cut_and_interrupted(
    source: Path, augmented: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    args = killed.arguments(source, tmp_path / "out", *AUGMENT, "--shard_episodes=3")
    add, added = shard.ShardWriter.add, []

    def interrupted(self: shard.ShardWriter, converted: shard.Converted) -> None:
        added.append(converted)
        if len(added) == 5:
            raise KeyboardInterrupt
        add(self, converted)

    with monkeypatch.context() as patch:
        patch.setattr(shard.ShardWriter, "add", interrupted)
        assert convert.main(args) == 130
    assert not (tmp_path / "out").exists()
    assert convert.main([*args, "--resume", "--augment.seed=1"]) == 1
    assert "--augment.seed was 0, now it is 1" in capsys.readouterr().err
    assert convert.main([*args, "--resume"]) == 0
    same(tmp_path / "out", augmented)


def test_of_many_episodes_the_table_has_the_worst(source: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    options = [
        "--augment.grid=9,6",
        "--episodes=0",
        "--dry_run",
        "--shard_episodes=50",
        f"--json={tmp_path / 'all.json'}",
    ]
    assert convert.main(killed.arguments(source, tmp_path / "out", *options)) == 0
    printed = capsys.readouterr().out
    assert "of 54 episodes, the 20 least likely to work, or of lowest fidelity, and the mean of all" in " ".join(
        printed.split()
    )
    rows = [line.split("│")[1:-1] for line in printed.splitlines() if line.startswith("│")]
    qualities = sorted(entry["fidelity"] for entry in json.loads((tmp_path / "all.json").read_text())["results"])
    assert len(qualities) == 54
    shown = [float(row[-2]) for row in rows]
    np.testing.assert_allclose(shown, [*qualities[:20], np.mean(qualities)], rtol=5e-3)
    assert rows[-1][0].strip() == "mean"


def test_what_cannot_be_is_left_out_and_counted(source: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    root = tmp_path / "out"
    args = [*killed.arguments(source, root), "--augment.grid=3,1", "--episodes=1", f"--json={root}.json"]
    assert convert.main([*args, "--augment.range=3,0"]) == 0
    assert "Augmentation: 1 of 3 episodes; left out: 2 outside the workspace." in capsys.readouterr().out
    assert [r["offset"]["x_m"] for r in records(root)] == [0.0]
    result = json.loads(Path(f"{root}.json").read_text())
    assert len(result["results"]) == len(result["residuals"]) == result["episodes"] == 1
    args = [arg.replace("out", "none") for arg in args if arg != "--allow_unreachable"]
    assert convert.main([*args, "--augment.range=0.1,0", "--transfer.unreachable_mm=0.1"]) == 1
    assert "augmentation leaves 0 of 3 episodes; left out: 3 out of reach" in capsys.readouterr().err
    assert not list(tmp_path.glob("*none*"))


def test_pictures_are_left_out_and_those_of_objects_say_which_points_they_are(
    source: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    reader, key = DatasetReader("me/pick", source), f"{schema.SEGMENTATION_PREFIX}front"
    feature = {"dtype": "image", "shape": (8, 8, 3), "names": ["height", "width", "channels"]}
    recorded = reader.read(0)
    masks = np.random.default_rng(2).random((len(recorded), 8, 8)) < 0.3
    encoded = encode_episode({key: np.repeat(255 * masks[..., None], 3, axis=-1).astype(np.uint8)}, {key: feature}, "")
    with DatasetWriter("me/seen", tmp_path / "seen", cameras={key: feature}) as writer:
        header = Header.of(recorded)
        writer.append(header, encode_episode(encode(recorded), header.features, recorded.task).joined(encoded))
    root, segmentation = tmp_path / "out", "--augment.objects=segmentation"
    assert convert.main(killed.arguments(tmp_path / "seen", root, "--augment.grid=2,1", segmentation)) == 0
    assert f"left out, as they show objects where they were recorded: {key}." in capsys.readouterr().out
    assert key not in json.loads((root / "meta/info.json").read_text())["features"]

    reader = DatasetReader("me/seen", tmp_path / "seen")
    options = AugmentOptions(grid="1,2", range="0,0.2", objects="segmentation")
    transfer = Transfer(load_embodiment(SOURCE), load_embodiment(TARGET))
    moved, _, _ = Augmentation(options, reader, transfer)(recorded, 1)
    assert moved.displacement is not None
    K, depth = recorded.scene.cameras[0].K, recorded.depth_m["front"][2]
    v, u = np.mgrid[:8, :8]
    points = np.stack([(u - K[0, 2]) / K[0, 0] * depth, (v - K[1, 2]) / K[1, 1] * depth, depth], axis=-1)
    went = moved.displacement.move(points.reshape(-1, 3), 2) - points.reshape(-1, 3)
    np.testing.assert_allclose(went[:, 1], 0.1 * masks[2].reshape(-1), atol=1e-9)
    assert convert.main([*killed.arguments(source, tmp_path / "no"), "--augment.grid=2,1", segmentation]) == 1
    assert "me/pick has no observation.segmentation.<camera>" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        (["--augment.range=0.1,0.1"], 2, "of no use without --augment.grid"),
        (["--augment.anchors=0,0;0.1,0", "--augment.range=0.1,0.1"], 2, "--augment.range is of no use without"),
        (["--augment.anchors=0,0;0.1"], 2, "--augment.anchors=0.1 should read like 0.2,0"),
        (["--augment.anchors=0,0;0,nan"], 2, "--augment.anchors=0,nan should read like 0.2,0"),
        (["--augment.grid=10"], 2, "--augment.grid=10 should read like 10,10"),
        (["--augment.grid=1.5,2"], 2, "--augment.grid=1.5,2: whole numbers of places"),
        (["--augment.grid=0,2"], 2, "--augment.grid=0,2: whole numbers of places"),
        (["--augment.grid=2,2", "--augment.range=0.1,-1"], 2, "must not be negative"),
        (["--augment.grid=2,2", "--augment.range=0.1,nan"], 2, "should read like 0.2,0.2"),
        (["--augment.grid=2,2", "--augment.ramp=0"], 2, "augment.ramp=0.0 must be over 0 and at most 1"),
        (["--augment.grid=2,2", "--augment.objects=bax"], 2, "Did you mean 'box'? Valid: all, state, box, segmentation."),
        (["--augment.grid=2,2", "--augment.objects=box"], 2, "--augment.objects=box and --augment.box="),
        (["--augment.grid=2,2", "--augment.objects=box", "--augment.box=0,0,0,1,1,0"], 2, "the lower one"),
        (["--augment.grid=2,2", "--augment.objects=state"], 1, "episode 0 has no privileged.environment_state"),
        (["--augment.grid=2,2", "--clouds.swap=false"], 2, "--clouds.swap=false keeps the source in the clouds"),
    ],
)  # fmt: skip
def test_bad_options_are_refused_in_one_line(
    options: list[str], code: int, message: str, source: Path, tmp_path: Path, complaint: Callable
) -> None:
    assert convert.main(killed.arguments(source, tmp_path / "out", *options)) == code
    assert message in complaint()
    assert list(tmp_path.iterdir()) == []


# -- in physics ----------------------------------------------------------------------------------------------------------


def test_cubes_elsewhere_are_picked_from_the_starts_that_the_dataset_has(tmp_path: Path) -> None:
    record_cubes(tmp_path / "source", 1, 0)
    source = ["--dataset.repo_id=me/source", f"--dataset.root={tmp_path / 'source'}", "--new_repo_id=me/target"]
    quick = ["--clouds.robot_points=2048", "--clouds.points=1024", "--init.starts=64", "--init.basins=8"]
    augment = ["--augment.grid=2,1", "--augment.range=0.2,0.2", "--augment.rotation_deg=30", "--augment.objects=state"]
    target = ["--target=UR5e-FourierRight", f"--new_root={tmp_path / 'target'}", "--workers=1"]
    assert convert.main([*source, *target, *quick, *augment]) == 0
    options = ["--dataset.repo_id=me/target", f"--dataset.root={tmp_path / 'target'}", "--video_episodes=0"]
    assert replay.main([*options, f"--json={tmp_path / 'replay.json'}"]) == 0
    assert json.loads((tmp_path / "replay.json").read_text())["successes"] == 2

    before = DatasetReader("me/source", tmp_path / "source").read(0).environment_state
    env = gym.make("CEI-PickCube-UR5e-FourierRight", clouds=False)
    assert before is not None
    for demonstration, x_m in zip(DatasetReader("me/target", tmp_path / "target"), (-0.1, 0.1), strict=True):
        cloud, state = demonstration.point_cloud_world, demonstration.environment_state
        assert cloud is not None
        assert state is not None
        start = {"environment_state": state[0], "agent_pos": demonstration.qpos[0]}
        observation, _ = env.reset(options=start)
        np.testing.assert_array_equal(observation["environment_state"], state[0].astype(np.float32))
        np.testing.assert_allclose(state[0, :3], before[0, :3] + [x_m, 0, 0], atol=6e-3)  # turned about the hold
        top = cloud[0][np.abs(cloud[0][:, 2] - state[0, 2] - state[0, 9]) < 2e-3]
        assert np.linalg.norm(top[:, :2] - state[0, :2], axis=1).max() < 0.035  # nothing is left where it was
        assert len(top) > 5  # of the cube
    env.close()


def test_buttons_at_anchors_are_pressed(tmp_path: Path) -> None:
    """The demonstration goes back up at its end: a ramp over all of it would be under way as the button is met."""
    source = ["--repo_id=me/source", f"--root={tmp_path / 'source'}"]
    assert record.main(["--env=CEI-PressButton-Panda-PandaGripper", "--episodes=1", *source]) == 0
    args = ["--dataset.repo_id=me/source", f"--dataset.root={tmp_path / 'source'}", "--target=UR5e-FourierRight"]
    quick = ["--clouds.robot_points=2048", "--init.starts=64", "--init.basins=8", "--workers=1"]
    new = ["--new_repo_id=me/target", f"--new_root={tmp_path / 'target'}", "--augment.anchors=0,-0.2;-0.15,0.1"]
    assert convert.main([*args, *quick, *new]) == 0
    options = ["--dataset.repo_id=me/target", f"--dataset.root={tmp_path / 'target'}", "--video_episodes=0"]
    assert replay.main([*options, f"--json={tmp_path / 'replay.json'}"]) == 0
    assert json.loads((tmp_path / "replay.json").read_text())["successes"] == 2
    places = [record["offset"] for record in records(tmp_path / "target")]
    assert [(place["x_m"], place["y_m"]) for place in places] == [(0.0, -0.2), (-0.15, 0.1)]
