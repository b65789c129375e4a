"""`--target_pose=auto`: the target's base stands where it follows best, and how much better that is than the source's place is said."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from conversions import record_cubes, same

import cei_gym
from cei_converters import convert
from cei_converters.conversion.converter import Converter
from cei_converters.conversion.placing import as_option, told
from cei_converters.dataset.metadata import Metadata
from cei_converters.sources.reader import DatasetReader
from cei_gym.demonstration import Demonstration, Scene
from cei_gym.embodiment import load_embodiment
from cei_gym.transfer import Transfer
from cei_gym.transfer.ground import footprint_m
from cei_gym.transfer.placing import find_place

SHORT = "ShortArm-PandaGripper"
"""Half as long as a Panda: six joints, links of 25 and 22 cm."""

ARM = """<mujoco model="short"><compiler angle="radian"/><worldbody><body name="base">
<geom type="cylinder" size="0.06 0.04" pos="0 0 0.04"/>
<body name="l1" pos="0 0 0.1"><joint name="j1" axis="0 0 1" range="-3 3"/><geom type="sphere" size="0.04" mass="1"/>
<body name="l2" pos="0 0 0.06"><joint name="j2" axis="0 1 0" range="-2 2"/><geom type="capsule" fromto="0 0 0.06 0 0 0.2" size="0.03" mass="1"/>
<body name="l3" pos="0 0 0.25"><joint name="j3" axis="0 1 0" range="0 2.8"/><geom type="capsule" fromto="0 0 0.06 0 0 0.16" size="0.03" mass="1"/>
<body name="l4" pos="0 0 0.2"><joint name="j4" axis="0 0 1" range="-3 3"/><geom type="sphere" size="0.03" mass="0.3"/>
<body name="l5" pos="0 0 0.02"><joint name="j5" axis="0 1 0" range="-2.2 2.2"/><geom type="sphere" size="0.02" mass="0.2"/>
<body name="l6" pos="0 0 0.04"><joint name="j6" axis="0 0 1" range="-3 3"/><geom type="sphere" size="0.02" mass="0.1"/>
<body name="flange" pos="0 0 0.02"/>
</body></body></body></body></body></body></body></worldbody></mujoco>
"""
YAML = """name: ShortArm
description: short.xml
mount_body: flange
home: {j1: 0, j2: 0.4, j3: 1.4, j4: 0, j5: 1.3, j6: 0}
"""


@pytest.fixture(scope="module", autouse=True)
def own(tmp_path_factory: pytest.TempPathFactory):
    folder = tmp_path_factory.mktemp("robots")
    (folder / "arms").mkdir()
    (folder / "arms/short.xml").write_text(ARM)
    (folder / "arms/ShortArm.yaml").write_text(YAML)
    known = {*gym.registry}
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CEI_GYM_EMBODIMENTS", str(folder))
        cei_gym.register_environments()
        yield
    for name in {*gym.registry} - known:
        del gym.registry[name]
    load_embodiment.cache_clear()


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("recorded") / "pick"
    record_cubes(root, 2, 0)
    return root


def arguments(recorded: Path, root: Path, target: str, *options: str) -> list[str]:
    names = ["--dataset.repo_id=me/pick", f"--dataset.root={recorded}", f"--target={target}", "--new_repo_id=me/new"]
    quick = ["--init.starts=64", "--init.basins=4", "--workers=1", "--shard_episodes=1", "--allow_unreachable"]
    return [*names, f"--new_root={root}", *quick, *options]


@pytest.fixture(scope="module")
def placed(recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short arm's dataset, its base found."""
    root = tmp_path_factory.mktemp("placed") / "new"
    assert convert.main(arguments(recorded, root, SHORT, "--target_pose=auto", f"--json={root}.json")) == 0
    return root


def never(*_: object) -> None:
    raise AssertionError("it searches")


def interrupted(*_: object) -> None:
    raise KeyboardInterrupt


# -- the place ------------------------------------------------------------------------------------------------------------


def demonstrations(name: str) -> list[Demonstration]:
    """A robot that turns about its base's axis."""
    body = load_embodiment(name)
    qpos = np.repeat(body.home[None], 8, axis=0)
    qpos[:, 0] += np.linspace(-0.3, 0.3, len(qpos))
    scene = Scene(np.eye(4), (), np.array([[-2.0, -2.0, 0.0], [2.0, 2.0, 1.0]]))
    return [Demonstration(name, 5.0, qpos, qpos, scene)]


def test_the_place_of_the_source_is_kept_where_it_is_as_good() -> None:
    source = load_embodiment("Panda-PandaGripper")
    shown = demonstrations(source.name)
    found = find_place(Transfer(source, source), shown, shown)
    assert found.kept and found.chosen is found.source
    np.testing.assert_array_equal(found.chosen.T_world_base, shown[0].scene.T_world_base)
    assert found.chosen.out_of_reach == 0 and found.chosen.fidelity > 0.95
    # others were looked at, all around
    assert len(found.scored) > 100 and np.ptp(found.scored[:, 0]) > 1 and np.ptp(found.scored[:, 1]) > 1
    assert told(found).startswith("target_pose: auto: no place searched is better than the source's by 10 mm of cost")
    assert as_option(found) is None


def test_a_footprint_is_of_the_links_that_stand_still() -> None:
    assert footprint_m(load_embodiment(SHORT)) == pytest.approx(0.06, abs=1e-3)


# -- the command ----------------------------------------------------------------------------------------------------------


def test_what_is_out_of_reach_from_the_sources_place_is_reached(placed: Path, recorded: Path) -> None:
    result = json.loads(Path(f"{placed}.json").read_text())
    found = result["placed"]
    assert found["source"]["out_of_reach"] > 0.25 * found["frames"] and found["episodes"] == 2
    assert found["chosen"]["out_of_reach"] == 0
    assert all(not episode["unreachable_frames"] for episode in result["results"])
    # it is said wherever a pose that is given is
    metadata = Metadata.load(placed)
    base = metadata.scene.T_world_base
    np.testing.assert_allclose(base, found["chosen"]["T_world_base"], atol=1e-5)
    assert metadata.environment.id == f"CEI-PickCube-{SHORT}"
    np.testing.assert_allclose(metadata.environment.kwargs["T_world_base"], base)
    assert metadata.provenance.options["target_pose"] == "auto" and metadata.provenance.options["placed"] == found
    assert "--target_pose=auto" in metadata.provenance.command
    env = gym.make(metadata.environment.id, clouds=False, T_world_base=metadata.environment.kwargs["T_world_base"])
    np.testing.assert_allclose(env.get_wrapper_attr("scene").T_world_base, base)
    env.close()
    low, high = DatasetReader("me/pick", recorded).scene.workspace_world[:, :2]
    assert np.linalg.norm(np.maximum(np.maximum(low - base[:2, 3], base[:2, 3] - high), 0.0)) > 0.04
    assert (placed / "meta/target_pose.png").stat().st_size > 10_000


def test_one_line_says_it_and_what_is_gone_on_with_does_not_search_again(
    recorded: Path, placed: Path, tmp_path: Path, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    found, root = json.loads(Path(f"{placed}.json").read_text())["placed"], tmp_path / "new"
    with monkeypatch.context() as patch:
        patch.setattr("cei_converters.conversion.assemble.assemble", interrupted)
        assert convert.main(arguments(recorded, root, SHORT, "--target_pose=auto")) != 0
    (said,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("target_pose: auto: ")]
    x, y, z = (f"{row[3]:.4g}" for row in found["chosen"]["T_world_base"][:3])
    assert f"auto: base at {x}, {y}, {z} m, turned by " in said
    n = found["frames"]
    assert f"over {n} frames of 2 episodes: fidelity " in said and f"out of reach 0 of {n}" in said
    assert re.search(rf"\(source's place: .*out of reach {found['source']['out_of_reach']} of {n}", said)
    assert not root.exists()
    monkeypatch.setattr(Converter, "find_place", never)
    assert convert.main(arguments(recorded, root, SHORT, "--target_pose=auto", "--resume")) == 0
    same(placed, root)  # where the other search ended, too
    # a finished dataset is known by either name of its place, as Slurm's last job has it
    capsys.readouterr()
    for pose in ("auto", found["target_pose"]):
        assert convert.main(arguments(recorded, root, SHORT, f"--target_pose={pose}", "--resume")) == 0
        assert "is finished" in capsys.readouterr().out
    assert convert.main(arguments(recorded, root, SHORT, "--target_pose=0,0,0.9", "--resume")) == 1
    assert "--target_pose was auto, now it is 0,0,0.9" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        (["--target_pose=best"], 2, "--target_pose=best should read x,y,z or x,y,z,qw,qx,qy,qz (metres), or auto."),
        (["--target_pose=auto", "--transfer.method=bms"], 2, "--target_pose=auto judges places by how pads follow"),
        (["--target_pose=auto", "--verify"], 1, "--target_pose=auto with --verify: robosuite stands UR5e-PandaGripper"),
    ],
)
def test_what_cannot_be_is_said_before_the_work(
    options: list[str], code: int, message: str, recorded: Path, tmp_path: Path, complaint: Callable
) -> None:
    names = ["--dataset.repo_id=me/pick", f"--dataset.root={recorded}", "--new_repo_id=me/new"]
    assert convert.main([*names, "--target=UR5e-PandaGripper", f"--new_root={tmp_path / 'new'}", *options]) == code
    assert message in complaint()
    assert list(tmp_path.iterdir()) == []
