"""Malformed inputs: small valid files of each kind, and named and random ways of spoiling them."""

import json
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import yaml

ROBOT = "Panda-PandaGripper"
INFO, CEI, RECORDS, CARD = "meta/info.json", "meta/cei.json", "meta/cei_episodes.jsonl", "README.md"
STATS, TASKS, EPISODES = "meta/stats.json", "meta/tasks.parquet", "meta/episodes/chunk-000/file-000.parquet"
DATA = "data/chunk-000/file-000.parquet"
VIDEO_KEY, PICTURE_KEY, DEPTH_KEY = "observation.images.front", "observation.images.side", "observation.depth.front"
VIDEO = f"videos/{VIDEO_KEY}/chunk-000/file-000.mp4"
CLOUD, OBJECTS = "observation.point_cloud", "observation.environment_state"
STATE, ACTION = "observation.state", "action"
LENGTHS = (4, 4)
WIDTH, HEIGHT = 64, 48

Spoil = Callable[[Path], object]


@dataclass(frozen=True)
class Case:
    """One malformed input.

    Attributes:
        kind: which of the valid folders is spoilt: "urdf" or "mjcf" (an end-effector), "dataset", "hdf5", "zarr".
        name: what is wrong.
        spoil: does it, given a copy of the folder.
        says: what the refusal must contain.
        through: the command that is given the folder: "pads", "convert", "calibrate", "replay", or "read", "hdf5" or "zarr" for a
            reader that reads all of a dataset.
        may_pass: whether the result may be valid after all: bytes that were changed at random.
    """

    kind: str
    name: str
    spoil: Spoil
    says: str
    through: str
    may_pass: bool = False

    def __str__(self) -> str:
        return self.name


def corpus(seed: int = 0, damages: int = 3) -> list[Case]:
    """All cases.

    Args:
        seed: of the random ones.
        damages: how many times each file is cut short, and how many times it has bytes changed.
    """
    import malformed_sources  # which imports this

    named = [
        *_yaml(),
        *_urdf(),
        *_mjcf(),
        *_mesh(),
        *_calibration(),
        *_info(),
        *_cei(),
        *_records(),
        *_tables(),
        *_video(),
        *_replay(),
        *malformed_sources.cases(),
    ]
    return [*named, *_random(seed, damages)]


# -- what is spoilt -------------------------------------------------------------------------------------------

HAND: dict[str, Any] = {
    "name": "Hand",
    "description": "hand.urdf",
    "pads": [{"body": "left", "extent": [0.0, 1.0]}, {"body": "right", "palmar": [0.0, -1.0, 0.0]}],
    "home": {"left": 0.0},
    "closed": {"left": 0.04},
    "max_velocity": {"left": 0.2},
    "mount_pos_m": [0.0, 0.0, 0.1],
    "mount_quat_wxyz": [1.0, 0.0, 0.0, 0.0],
    "physics": [{"kind": "geom_mass", "reason": "a test", "parameters": {"geoms": "*", "mass_kg": 0.1}}],
}
INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
URDF = f"""<robot name="hand">
  <link name="palm">{INERTIAL}<collision><geometry><box size="0.1 0.1 0.02"/></geometry></collision></link>
  <link name="left">{INERTIAL}<collision><geometry><mesh filename="finger.stl"/></geometry></collision></link>
  <link name="right">{INERTIAL}<collision><geometry><box size="0.02 0.01 0.05"/></geometry></collision></link>
  <joint name="left" type="prismatic">
    <origin xyz="0 -0.05 0.05" rpy="0 0 0"/><parent link="palm"/><child link="left"/><axis xyz="0 1 0"/>
    <limit lower="0" upper="0.04" effort="1" velocity="0.1"/>
  </joint>
  <joint name="right" type="prismatic">
    <origin xyz="0 0.05 0.05" rpy="0 0 0"/><parent link="palm"/><child link="right"/><axis xyz="0 -1 0"/>
    <limit lower="0" upper="0.04" effort="1" velocity="0.1"/><mimic joint="left" multiplier="1" offset="0"/>
  </joint>
</robot>"""
MJCF = """<mujoco><compiler angle="radian"/><include file="assets.xml"/><worldbody><body name="palm">
  <geom type="box" size="0.05 0.05 0.01"/>
  <body name="left" pos="0 -0.05 0.05">
    <joint name="left" type="slide" axis="0 1 0" range="0 0.04"/><geom type="mesh" mesh="finger"/>
  </body>
  <body name="right" pos="0 0.05 0.05">
    <joint name="right" type="slide" axis="0 -1 0" range="0 0.04"/><geom type="box" size="0.01 0.005 0.025"/>
  </body>
</body></worldbody><equality><joint joint1="right" joint2="left" polycoef="0 1 0 0 0"/></equality></mujoco>"""
CAMERA = {
    "width": WIDTH,
    "height": HEIGHT,
    "K": {"fx": 60.0, "fy": 60.0, "cx": 32.0, "cy": 24.0},
    "T_world_camera": {"position": [0.5, 0.0, 2.0], "quaternion_wxyz": [0.0, 1.0, 0.0, 0.0]},
}
CALIBRATION = {"cameras": {"front": CAMERA}, "workspace_world": [[-1.0, -1.0, -0.5], [1.0, 1.0, 1.5]]}


def write_hand(folder: Path, description: str) -> None:
    """An end-effector with a mesh: `hand.yaml` over `hand.urdf` or, with an include, `hand.xml`."""
    import trimesh

    folder.mkdir(parents=True)
    # in one flow: cut anywhere, it is no YAML any more
    hand = yaml.safe_dump(HAND | {"description": description}, default_flow_style=True, width=10_000, sort_keys=False)
    (folder / "hand.yaml").write_text(hand.strip())
    (folder / "hand.urdf").write_text(URDF)
    (folder / "hand.xml").write_text(MJCF)
    (folder / "assets.xml").write_text('<mujoco><asset><mesh name="finger" file="finger.stl"/></asset></mujoco>')
    trimesh.creation.box((0.02, 0.01, 0.05)).export(folder / "finger.stl")


def write_dataset(root: Path) -> None:
    """Two episodes with all that a dataset may have, as LeRobot writes it, and beside it a `cameras.yaml`."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    from cei_converters.dataset import schema
    from cei_converters.dataset.metadata import Environment, Metadata
    from cei_converters.dataset.records import RecordWriter
    from cei_gym.demonstration import Camera, Scene
    from cei_gym.embodiment import load_embodiment

    body = load_embodiment(ROBOT)
    joints = {"dtype": "float32", "shape": (len(body.joint_names),), "names": schema.joint_feature_names(body)}
    sides = {"shape": (HEIGHT, WIDTH, 3), "names": ["height", "width", "channels"]}
    depth = {"is_depth_map": True, "depth_unit": "mm"}
    features = {
        STATE: joints,
        ACTION: joints,
        VIDEO_KEY: {"dtype": "video", **sides},
        PICTURE_KEY: {"dtype": "image", **sides},
        DEPTH_KEY: {"dtype": "image", **sides, "shape": (HEIGHT, WIDTH, 1), "info": depth},
        CLOUD: {"dtype": "float32", "shape": (8, 3), "names": ["point", "xyz_m"]},
        OBJECTS: {"dtype": "float32", "shape": (2,), "names": ["x_m", "y_m"]},
    }
    dataset = LeRobotDataset.create("me/pick", fps=20, features=features, root=root, robot_type="panda")
    qpos = body.home.astype(np.float32)
    for length in LENGTHS:
        for t in range(length):
            picture = np.full((HEIGHT, WIDTH, 3), 20 * t, np.uint8)
            seen = {VIDEO_KEY: picture, PICTURE_KEY: picture, DEPTH_KEY: np.full((HEIGHT, WIDTH, 1), 900, np.uint16)}
            other = {CLOUD: np.zeros((8, 3), np.float32), OBJECTS: np.zeros(2, np.float32), "task": "pick"}
            dataset.add_frame({STATE: qpos, ACTION: qpos, **seen, **other})
        dataset.save_episode()
    dataset.finalize()
    K = np.array([[60.0, 0.0, 32.0], [0.0, 60.0, 24.0], [0.0, 0.0, 1.0]])
    scene = Scene(np.eye(4), (Camera("front", WIDTH, HEIGHT, K, np.eye(4)),), np.array([[-1.0] * 3, [1.0] * 3]))
    Metadata(ROBOT, scene, Environment(f"CEI-PickCube-{ROBOT}", {})).save(root)
    with RecordWriter(root) as records:
        for seed in range(len(LENGTHS)):
            records.add({"seed": seed})
    (root / CARD).write_text("---\nlicense: mit\n---\n# Pick\n")
    (root / "cameras.yaml").write_text(yaml.safe_dump(CALIBRATION, default_flow_style=True, width=10_000).strip())


# -- ways of spoiling -----------------------------------------------------------------------------------------


def put(path: str, content: str | bytes) -> Spoil:
    """Another content of a file."""
    return lambda folder: (folder / path).write_bytes(content if isinstance(content, bytes) else content.encode())


def change(path: str, old: str, new: str) -> Spoil:
    """One text for another, all over a file that has it."""

    def spoil(folder: Path) -> None:
        text = (folder / path).read_text()
        assert old in text, f"{path} has no {old!r}"
        (folder / path).write_text(text.replace(old, new))

    return spoil


def edit(path: str, how: Callable[[Any], object]) -> Spoil:
    """Edit what a JSON or YAML file holds."""

    def spoil(folder: Path) -> None:
        old = yaml.safe_load((folder / path).read_text())
        new = yaml.safe_load((folder / path).read_text())
        how(new)
        assert new != old, "nothing is spoilt"
        text = json.dumps(new) if path.endswith("json") else yaml.safe_dump(new, default_flow_style=True, width=10_000)
        (folder / path).write_text(text)

    return spoil


def has(path: str, *keys: str | int, value: object) -> Spoil:
    """Another value somewhere in a JSON or YAML file."""

    def how(content: Any) -> None:
        for key in keys[:-1]:
            content = content[key]
        content[keys[-1]] = value

    return edit(path, how)


def lacks(path: str, *keys: str | int) -> Spoil:
    """A field less in a JSON or YAML file."""

    def how(content: Any) -> None:
        for key in keys[:-1]:
            content = content[key]
        del content[keys[-1]]

    return edit(path, how)


def table(path: str, how: Callable[[pa.Table], pa.Table]) -> Spoil:
    """Edit a Parquet file."""

    def spoil(folder: Path) -> None:
        old = pq.read_table(folder / path)
        new = how(old).replace_schema_metadata()
        assert not new.equals(old), "nothing is spoilt"
        pq.write_table(new, folder / path)

    return spoil


def column(path: str, key: str, values: Callable[[list], Any]) -> Spoil:
    """Other values (and what type they have) in a column of a Parquet file."""
    return table(path, lambda t: t.set_column(t.column_names.index(key), key, pa.array(values(t[key].to_pylist()))))


def both(*spoils: Spoil) -> Spoil:
    """One after the other."""
    return lambda folder: [spoil(folder) for spoil in spoils]


def linked(path: str, target: str) -> Spoil:
    """A symbolic link in place of a file, to where a copy of it is."""

    def spoil(folder: Path) -> None:
        content = (folder / path).read_bytes()
        (folder / path).unlink()
        to = (folder / path).parent / target
        if to != folder / path:
            to.write_bytes(content)
        (folder / path).symlink_to(target)

    return spoil


def folder_at(path: str) -> Spoil:
    """A folder in place of a file."""
    return lambda folder: ((folder / path).unlink(), (folder / path).mkdir())


def outside(path: str) -> Spoil:
    """A copy of a file beside the folder, readable, so that only a rule can refuse it."""
    return lambda folder: (folder.parent / Path(path).name).write_bytes((folder / path).read_bytes())


def _cut(path: str, seed: list[int]) -> Spoil:
    def spoil(folder: Path) -> None:
        whole = (folder / path).read_bytes()
        (folder / path).write_bytes(whole[: np.random.default_rng(seed).integers(len(whole) - 1)])

    return spoil


def _flipped(path: str, seed: list[int]) -> Spoil:
    def spoil(folder: Path) -> None:
        rng = np.random.default_rng(seed)
        content = np.frombuffer((folder / path).read_bytes(), np.uint8).copy()
        places = rng.choice(len(content), min(len(content), 8), replace=False)
        content[places] ^= rng.integers(1, 256, len(places), dtype=np.uint8)
        (folder / path).write_bytes(content.tobytes())

    return spoil


def _random(seed: int, damages: int) -> Iterator[Case]:
    files = [
        ("urdf", "hand.yaml", "pads"),
        ("urdf", "hand.urdf", "pads"),
        ("urdf", "finger.stl", "pads"),
        ("mjcf", "hand.xml", "pads"),
        ("mjcf", "assets.xml", "pads"),
        ("dataset", "cameras.yaml", "calibrate"),
        *(("dataset", path, "read") for path in (INFO, CEI, STATS, TASKS, EPISODES, DATA, VIDEO)),
    ]
    for place, (kind, path, through) in enumerate(files):
        name = Path(path).name if through == "pads" else path
        for i in range(damages):
            says = "Hand" if path == "finger.stl" else "meta" if path.startswith("meta") else Path(path).name
            cut, flipped = _cut(path, [seed, place, i]), _flipped(path, [seed, place, damages + i])
            yield Case(kind, f"{name} cut {i}", cut, says, through)
            yield Case(kind, f"{name} flipped {i}", flipped, "", through, may_pass=True)


NO_TEXT = {
    "empty": b"",
    "zeros": b"\0" * 64,
    "no UTF-8": b"\xff\xfe\xfa\x80 name: \xc3\x28",
    "UTF-16": "name: Hand".encode("utf-16"),
    "a picture": b"\x89PNG\r\n\x1a\n" + bytes(range(256)),
}
LAUGHS = "a0: &a0 [lol, lol]\n" + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 10))


def _yaml() -> Iterator[Case]:
    file = "hand.yaml"

    def case(name: str, spoil: Spoil, says: str = file) -> Case:
        return Case("urdf", f"hand.yaml: {name}", spoil, says, "pads")

    for name, content in NO_TEXT.items():
        yield case(name, put(file, content))
    for field in ("name", "description", "pads"):
        yield case(
            f"no {field}",
            lacks(file, field),
            f"{file}: not a valid EndEffectorSpec: Missing required field(s) `{field}`",
        )
    yield case("a list", put(file, "- a\n- b"))
    yield case("a number", put(file, "5"))
    yield case("an unknown field", has(file, "homee", value={}), "homee")
    yield case("a tab", put(file, "name:\tHand\n\tpads: []"))
    yield case("python object", put(file, "!!python/object/apply:os.system ['touch pwned']"))
    yield case("python module", put(file, "name: !!python/module:os ''\npads: []\ndescription: hand.urdf"))
    yield case("billion laughs", put(file, LAUGHS + "name: *a9\ndescription: hand.urdf\npads: *a9\n"))
    yield case("billion laughs as a pad", put(file, LAUGHS + "name: H\ndescription: hand.urdf\npads: [{body: *a9}]\n"))
    yield case("an alias of itself", put(file, "name: H\ndescription: hand.urdf\npads: []\nhome: &h {left: *h}"))
    yield case("deep nesting", put(file, "name: " + "[" * 20_000 + "]" * 20_000))
    yield case("deep nesting of maps", put(file, "{a: " * 20_000 + "}" * 20_000))
    yield case("a field twice", change(file, "home: {left: 0.0}", "home: {left: 0.0}, home: {left: 0.01}"), "home")
    yield case("a joint twice", change(file, "closed: {left: 0.04}", "closed: {left: 0.04, left: 0.0}"), "left")
    yield case("two documents", put(file, "name: a\n---\nname: b"))
    yield case("a list as a key", put(file, "? [a, b]\n: 1"))
    for field, value in [
        ("home", [1]),
        ("home", {"left": "far"}),
        ("home", {"left": None}),
        ("pads", "left"),
        ("pads", [5]),
    ]:
        yield case(f"{field} is {value}", has(file, field, value=value))
    yield case("an unknown joint in home", has(file, "home", value={"elbow": 0.0}), "'elbow'")
    yield case("a follower in home", has(file, "home", value={"right": 0.01}), "'right'")
    for value in (np.nan, np.inf, 1e308, -1.0):
        yield case(f"home is {value}", has(file, "home", value={"left": value}), "home")
    for value in (np.nan, 0.0, -1.0):
        yield case(f"max_velocity is {value}", has(file, "max_velocity", value={"left": value}), "max_velocity of Hand")
    for field, value in [
        ("mount_pos_m", [0.0, 0.1]),
        ("mount_pos_m", [np.nan] * 3),
        ("mount_pos_m", [0.0, 1e300, np.inf]),
        ("mount_quat_wxyz", [0.0] * 4),
        ("mount_quat_wxyz", [1.0, 0.0]),
        ("mount_quat_wxyz", [np.nan] * 4),
        ("inertia_groups", [0]),
        ("inertia_groups", [7, -3, 99, 4]),
        ("inertia_groups", [2**40, 0]),
    ]:
        yield case(f"{field} is {value}", has(file, field, value=value), field)
    for value in ([0.5], [1.0, 0.0], [0.0, np.nan], [-1.0, 2.0], [0.2, 0.1, 0.0]):
        yield case(f"extent is {value}", has(file, "pads", 0, "extent", value=value), "extent")
    for value in ("inwards", [0.0, 0.0, 0.0], [1.0], [np.nan, 0.0, 1.0], [np.inf, 0.0, 0.0]):
        yield case(f"palmar is {value}", has(file, "pads", 0, "palmar", value=value), "palmar")
    for value in (0.0, -1.0, np.nan, np.inf):
        yield case(f"share is {value}", has(file, "pads", 0, "share", value=value), "share")
    yield case("palmar_cosine is 2", has(file, "pads", 0, "palmar_cosine", value=2.0), "palmar_cosine")
    yield case("palmar_cosine is nan", has(file, "pads", 0, "palmar_cosine", value=np.nan), "palmar_cosine")
    yield case("no pads in pads", has(file, "pads", value=[]), "no finger pads")
    yield case("a pad on no link", has(file, "pads", 0, "body", value="thumb"), "'thumb'")
    yield case("a pad of no geom", has(file, "pads", 0, "geoms", value=["../x"]), "'../x'")
    yield case("mass without a number", has(file, "physics", 0, "parameters", value={"geoms": "*"}), "mass_kg")
    yield case(
        "mass is text", has(file, "physics", 0, "parameters", value={"geoms": "*", "mass_kg": "much"}), "mass_kg"
    )
    yield case(
        "mass is negative", has(file, "physics", 0, "parameters", value={"geoms": "*", "mass_kg": -1.0}), "mass_kg"
    )
    yield case(
        "mass is nan", has(file, "physics", 0, "parameters", value={"geoms": "*", "mass_kg": np.nan}), "parameters"
    )
    yield case(
        "geoms is a list", has(file, "physics", 0, "parameters", value={"geoms": ["*"], "mass_kg": 1.0}), "geoms"
    )
    loop = {"left": {"joint": "right"}, "right": {"joint": "left"}}
    yield case("couplings in a circle", has(file, "couplings", value=loop), "in a circle")
    yield case("coupled to no joint", has(file, "couplings", value={"right": {"joint": "x"}}), "'x'")
    for field, value in [("scale", np.nan), ("scale", np.inf), ("offset", np.nan), ("offset", 1e308)]:
        coupling = {"right": {"joint": "left", field: value}}
        yield case(
            f"a coupling's {field} is {value}",
            has(file, "couplings", value=coupling),
            field if value != 1e308 else "right",
        )
    for value in (
        "",
        ".",
        "../hand.urdf",
        "none.urdf",
        "a\0b",
        "package://",
        "package://no_such/x.xml",
        "package:///etc/passwd",
        "x" * 5000,
    ):
        says = "is no path to a file" if "\0" in value or len(value) > 99 else "description"
        yield case(f"description is {value[:24]!r}", has(file, "description", value=value), says)
    yield case(
        "description climbs out of a package", has(file, "description", value="package://yaml/../../x.xml"), "outside"
    )
    yield case("an unknown root_body", has(file, "root_body", value="wrist"), "root_body of Hand")
    yield case("an unknown angle", has(file, "angle", value="turns"), "angle of Hand")
    for value in (0.0, -1.0, np.nan):
        yield case(f"compliance is {value}", has(file, "compliance", value=value), "compliance")


BOMB = "<!DOCTYPE x [<!ENTITY l0 'lol'>{}]>".format(
    "".join(f"<!ENTITY l{i} '{f'&l{i - 1};' * 10}'>" for i in range(1, 9))
)


def _xml(kind: str, file: str, tag: str) -> Iterator[Case]:
    """What is wrong with any XML."""

    def case(name: str, spoil: Spoil, says: str = "hand") -> Case:
        return Case(kind, f"{file}: {name}", spoil, says, "pads")

    for name, content in NO_TEXT.items():
        yield case(name, put(file, content))
    yield case("an entity bomb", change(file, f"<{tag}", f"{BOMB}<{tag} a='&l8;'"), "entities are not allowed")
    secret = "<!DOCTYPE x [<!ENTITY x SYSTEM 'file:///etc/hostname'>]>"
    yield case("an external entity", change(file, f"<{tag}", f"{secret}<{tag} a='&x;'"), "entities are not allowed")
    yield case("an unknown entity", change(file, f"<{tag}", f"<{tag} a='&x;'"), "not well-formed")
    yield case("a parameter entity", put(file, "<!DOCTYPE x [<!ENTITY % p SYSTEM 'x.dtd'> %p;]><robot/>"), "entities")
    yield case("another root", put(file, "<sdf/>"), "root element <sdf>")
    yield case("a folder", folder_at(file))
    yield case("deep nesting", put(file, f"<{tag}>" + "<body>" * 50_000 + "</body>" * 50_000 + f"</{tag}>"))
    yield case("an unknown encoding", put(file, f"<?xml version='1.0' encoding='x-none'?><{tag}/>"))
    yield case("nothing in it", put(file, f"<{tag}/>"), "Hand")


def _urdf() -> Iterator[Case]:
    file = "hand.urdf"

    def case(name: str, spoil: Spoil, says: str = "hand") -> Case:
        return Case("urdf", f"{file}: {name}", spoil, says, "pads")

    yield from _xml("urdf", file, "robot")
    left = '<limit lower="0" upper="0.04" effort="1" velocity="0.1"/>\n'
    for value in ("nan", "inf", "1e400", "far", "", "-1"):
        yield case(
            f"upper is {value!r}", change(file, left, left.replace("0.04", value)), "upper" if value != "-1" else "left"
        )
    for value in ("nan", "-inf", "1"):
        yield case(
            f"lower is {value!r}",
            change(file, left, left.replace('lower="0"', f'lower="{value}"')),
            "lower" if value != "1" else "left",
        )
    yield case("velocity is text", change(file, left, left.replace('"0.1"', '"fast"')), "velocity='fast'")
    yield case("no limit", change(file, left, ""), "left")
    for value in ("0 0 0", "nan 0 0", "1", "a b c", "1 0 0 0", "1e308 1e308 0", "inf 0 0"):
        yield case(f"axis is {value!r}", change(file, "0 1 0", value))
    for value in ("nan 0 0", "1", "x", "1e400 0 0"):
        yield case(f"origin is {value!r}", change(file, "0 -0.05 0.05", value))
    yield case("no parent", change(file, '<parent link="palm"/><child link="left"/>', '<child link="left"/>'))
    yield case("no child", change(file, '<parent link="palm"/><child link="left"/>', '<parent link="palm"/>'))
    yield case(
        "an unknown parent",
        change(file, '<parent link="palm"/><child link="left"/>', '<parent link="x"/><child link="left"/>'),
    )
    yield case(
        "a link that is its own parent",
        change(file, '<parent link="palm"/><child link="left"/>', '<parent link="left"/><child link="left"/>'),
    )

    def hung(child: str, parent: str) -> Spoil:
        return change(
            file, f'<parent link="palm"/><child link="{child}"/>', f'<parent link="{parent}"/><child link="{child}"/>'
        )

    yield case("links in a circle", both(hung("left", "right"), hung("right", "left")))
    yield case("two links of one name", change(file, '<link name="right">', '<link name="left">'))
    yield case("two joints of one name", change(file, '<joint name="right"', '<joint name="left"'))
    yield case("a joint without a name", change(file, '<joint name="right"', "<joint"))
    yield case("a link without a name", change(file, '<link name="right">', "<link>"))
    yield case("an unknown kind of joint", change(file, 'type="prismatic"', 'type="magic"'))
    yield case(
        "a floating joint",
        change(file, '<joint name="left" type="prismatic"', '<joint name="left" type="floating"'),
        "Hand",
    )
    for value in ("nan", "0", "-1", "heavy", "inf"):
        yield case(f"mass is {value!r}", change(file, '<mass value="1"/>', f'<mass value="{value}"/>'))
    yield case("inertia is nan", change(file, 'ixx="1"', 'ixx="nan"'))
    for value in ("0 0 0", "-1 1 1", "nan 1 1", "1", "1e300 1 1"):
        yield case(f"box is {value!r}", change(file, "0.02 0.01 0.05", value))
    mimic = '<mimic joint="left" multiplier="1" offset="0"/>'
    for old, new, says in [
        ('joint="left"', 'joint="right"', "in a circle"),
        ('joint="left"', 'joint="none"', "'none'"),
        ('joint="left" ', "", "coupling"),
        ('"1"', '"nan"', "multiplier"),
        ('"1"', '"inf"', "multiplier"),
        ('"1"', '"x"', "multiplier"),
        ('"0"', '"nan"', "offset"),
        ('"0"', '"9"', "right"),
    ]:
        yield case(f"mimic: {new or 'no joint'}, {says}", change(file, mimic, mimic.replace(old, new)), says)
    yield from _mesh_paths("urdf", file)
    yield case("a mesh of an unknown package", change(file, "finger.stl", "package://x/finger.stl"), "'x'")
    yield case("a mesh by http", change(file, "finger.stl", "http://localhost:9/finger.stl"))
    for value in ("nan 1 1", "0 0 0", "x", "1"):
        yield case(f"mesh scale is {value!r}", change(file, '"finger.stl"', f'"finger.stl" scale="{value}"'))
    yield from _urdf_kinds(case, file)


def _urdf_kinds(case: Callable[..., Case], file: str) -> Iterator[Case]:
    """What other programs' URDFs have, and what asks for files, memory or time."""
    left = '<limit lower="0" upper="0.04" effort="1" velocity="0.1"/>\n'
    mesh, link = "finger.stl", '<link name="right">'
    tree = '<parent link="palm"/><child link="left"/>'
    yield case(
        "a package that is a folder above",
        both(outside(mesh), change(file, mesh, f"package://sub/{mesh}")),
        "no enclosing folder is named 'sub'",
    )
    yield case(
        "a package that is a link to a folder above",
        both(
            outside(mesh), lambda folder: (folder / "up").symlink_to(".."), change(file, mesh, f"package://up/{mesh}")
        ),
        "no enclosing folder is named 'up'",
    )
    yield case(
        "a package of a bomb",
        both(
            put("package.xml", f"{BOMB}<package><name>&l8;</name></package>"),
            change(file, mesh, f"package://hand/{mesh}"),
        ),
        "no enclosing folder is named 'hand'",
    )
    yield case(
        "a package that climbs",
        both(outside(mesh), change(file, mesh, f"package://../{mesh}")),
        "no enclosing folder is named '..'",
    )
    for scheme, says in [("model://", "package '..'"), ("file://", "points outside"), ("http://localhost:9/", mesh)]:
        yield case(f"a mesh at {scheme}", both(outside(mesh), change(file, mesh, f"{scheme}../{mesh}")), says)
    yield case(
        "a folder of meshes above",
        both(
            outside(mesh),
            change(file, link, '<mujoco><compiler meshdir=".."/></mujoco>' + link),
            change(file, mesh, f"nowhere/{mesh}"),
        ),
        "points outside its folder",
    )
    yield case("a mesh in a CAD format", change(file, mesh, "finger.step"), "finger.step")
    yield case(
        "a mesh in millimetres", change(file, '"finger.stl"', '"finger.stl" scale="1000 1000 1000"'), 'scale="1 1 1"'
    )
    yield case(
        "a mesh in kilometres", change(file, '"finger.stl"', '"finger.stl" scale="1e-4 1e-4 1e-4"'), 'scale="1 1 1"'
    )
    yield case("a box in millimetres", change(file, "0.02 0.01 0.05", "20 10 50"), "millimetres")
    yield case("an origin in millimetres", change(file, "0 -0.05 0.05", "0 -50 50"), "millimetres")
    yield case(
        "20000 links", change(file, link, "".join(f'<link name="l{i}"/>' for i in range(20_000)) + link), "20003 <link>"
    )
    geoms = '<visual><geometry><box size="0.01 0.01 0.01"/></geometry></visual>' * 20_000
    yield case("20000 geoms", change(file, link, link + geoms), "20000 <visual>")
    yield case("300000 elements", change(file, link, "<gazebo/>" * 300_000 + link), "200000 elements")
    yield case("a huge file", change(file, link, f"<!--{'x' * 17_000_000}-->" + link), "16000000 are allowed")
    yield case("a xacro", change(file, 'value="1"', 'value="${mass}"'), "${mass}: 'mass' is not defined")
    yield case("a xacro's include", change(file, link, '<xacro:include filename="../x.xacro"/>' + link), "xacro")
    yield case("two bases", change(file, link, '<link name="base"/>' + link), "'palm', 'base' hang on no joint")
    yield case("a planar joint", change(file, 'name="left" type="prismatic"', 'name="left" type="planar"'), "planar")
    yield case("limits that are one", change(file, left, left.replace('lower="0"', 'lower="0.04"')), "make it fixed")
    yield case("a joint of no links", change(file, tree, ""), "")


def _mesh_paths(kind: str, file: str) -> Iterator[Case]:
    """Meshes that are not inside the folder, though they are there."""
    mesh, out = "finger.stl", outside("finger.stl")
    where = "assets.xml" if kind == "mjcf" else file

    def case(name: str, spoil: Spoil, says: str = "points outside its folder") -> Case:
        return Case(kind, f"{file}: {name}", both(out, spoil), says, "pads")

    def absolute(folder: Path) -> None:
        change(where, mesh, str(folder.parent / mesh))(folder)

    yield case("a mesh at ../", change(where, mesh, "../finger.stl"))
    yield case("a mesh through a folder and ../../", change(where, mesh, "x/../../finger.stl"))
    yield case("a mesh at an absolute path", absolute)
    yield case("a mesh linked to outside", linked(mesh, "../finger.stl"))
    yield case("a mesh linked to itself", linked(mesh, mesh), mesh)
    yield case("a mesh that is missing", change(where, mesh, "none.stl"), "none.stl")
    yield case("a mesh that is a folder", change(where, mesh, "."), "")
    yield case("a mesh without a name", change(where, f'"{mesh}"', '""'), "")
    yield case("a mesh of another kind", change(where, mesh, "hand.yaml"), "hand.yaml")
    if kind == "urdf":
        yield case("a mesh at file:///", change(where, mesh, "file:///etc/hostname"))
        package = "package://in/../finger.stl"
        yield case("a mesh that climbs out of its package", change(where, mesh, package))


def _mjcf() -> Iterator[Case]:
    file, parts = "hand.xml", "assets.xml"

    def case(name: str, spoil: Spoil, says: str = "hand") -> Case:
        return Case("mjcf", f"{file}: {name}", spoil, says, "pads")

    yield from _xml("mjcf", file, "mujoco")
    yield from _mesh_paths("mjcf", file)
    include = '<include file="assets.xml"/>'
    yield case("includes itself", change(file, parts, file))
    yield case(
        "includes go round",
        both(
            put("other.xml", f"<mujoco>{include}</mujoco>"), put(parts, '<mujoco><include file="other.xml"/></mujoco>')
        ),
        "",
    )
    yield case("includes what is missing", change(file, parts, "none.xml"), "none.xml")
    yield case("includes what is outside", both(outside(parts), change(file, parts, "../assets.xml")), "points outside")
    yield case("includes what is linked to outside", linked(parts, "../assets.xml"), "points outside")
    yield case("includes a bomb", put(parts, f"{BOMB}<mujoco model='&l8;'/>"), "entities are not allowed")
    yield case("includes a folder", change(file, parts, "."), "")
    yield case("includes a mesh", change(file, parts, "finger.stl"), "")
    yield case("a plugin", change(file, include, include + '<extension><plugin plugin="x.y"/></extension>'))
    yield case(
        "a huge height field",
        change(
            file,
            include,
            include + '<asset><hfield name="h" nrow="2000000000" ncol="2000000000" size="1 1 1 1"/></asset>',
        ),
    )
    yield case(
        "a huge texture",
        change(
            file,
            include,
            include
            + '<asset><texture name="t" type="2d" builtin="flat" width="2000000000" height="2000000000"/></asset>',
        ),
    )
    yield case(
        "a huge replication",
        change(
            file, "</worldbody>", '<body><replicate count="2000000000"><geom size="1"/></replicate></body></worldbody>'
        ),
    )
    yield case(
        "a huge composite",
        change(
            file,
            '<geom type="box" size="0.05 0.05 0.01"/>',
            '<composite type="cable" count="2000000000 1 1" size="1"><geom size="1" type="capsule"/></composite>',
        ),
    )
    yield case(
        "a free body",
        change(file, '<joint name="left" type="slide" axis="0 1 0" range="0 0.04"/>', "<freejoint/>"),
        "joint equality",
    )
    yield case(
        "a ball joint",
        change(file, 'name="left" type="slide" axis="0 1 0" range="0 0.04"', 'name="left" type="ball"'),
        "Hand",
    )
    for value in ("0 0 0", "nan 0 0", "1", "a b c", "inf 0 0"):
        yield case(f"axis is {value!r}", change(file, "0 1 0", value), "")
    for value in ("nan 0.04", "0 nan", "1 0", "1", "-inf inf", "0 inf"):
        yield case(f"range is {value!r}", change(file, '"0 1 0" range="0 0.04"', f'"0 1 0" range="{value}"'), "")
    for value in ("nan 0 0", "1e400 0 0", "x"):
        yield case(f"pos is {value!r}", change(file, "0 -0.05 0.05", value), "")
    for value in ("0 0 0", "-1 1 1", "nan 1 1", ""):
        yield case(f"size is {value!r}", change(file, "0.01 0.005 0.025", value), "")
    for value in ("0 1 1 0 0", "0 nan 0 0 0", "inf 1 0 0 0", "x"):
        yield case(f"polycoef is {value!r}", change(file, "0 1 0 0 0", value), "")
    yield case("an equality with itself", change(file, 'joint2="left"', 'joint2="right"'), "")
    yield case("an equality with none", change(file, 'joint2="left"', 'joint2="none"'), "joint equality")
    yield case(
        "two equalities in a circle",
        change(file, "</equality>", '<joint joint1="left" joint2="right"/></equality>'),
        "in a circle",
    )
    yield case("two joints of one name", change(file, 'joint name="right"', 'joint name="left"'), "")
    yield case("a joint without a name", change(file, 'joint name="left"', "joint"), "joint equality")
    yield case("an unknown element", change(file, "<worldbody>", "<worldbody><magic/>"), "magic")
    yield case("an unknown attribute", change(file, '<body name="palm"', '<body name="palm" magic="1"'), "magic")
    yield case("an unknown class", change(file, '<body name="palm"', '<body name="palm" childclass="x"'), "x")
    yield case("an unknown mesh", change(file, 'mesh="finger"', 'mesh="thumb"'), "thumb")
    yield from _mjcf_kinds(case, file, parts)


def _mjcf_kinds(case: Callable[..., Case], file: str, parts: str) -> Iterator[Case]:
    """What asks for files, memory or time, or ties joints in ways that are no coupling."""
    include, out = '<include file="assets.xml"/>', outside(parts)
    asset = "<asset>{}</asset>"

    def adds(element: str) -> Spoil:
        return change(file, include, include + element)

    nested = put(parts, '<mujoco><include file="../assets.xml"/></mujoco>')
    yield case("a nested include of what is outside", both(out, nested), "points outside")
    yield case(
        "an include of a folder below that climbs back out",
        both(
            out,
            lambda folder: (folder / "below").mkdir(),
            put("below/parts.xml", '<mujoco><include file="../../assets.xml"/></mujoco>'),
            change(file, parts, "below/parts.xml"),
        ),
        "points outside",
    )
    for name, tag in [("a", 'include xmlns="urn:x"'), ("a prefixed", 'x:include xmlns:x="urn:x"')]:
        spoil = both(out, change(file, include, f'<{tag} file="../assets.xml"/>'))
        yield case(f"{name} namespace's include", spoil, "points outside" if name == "a" else "include")
    yield case(
        "an included model with a namespace",
        both(out, put(parts, '<x:mujoco xmlns:x="urn:x"><include file="../assets.xml"/></x:mujoco>')),
        "points outside",
    )

    def absolute(folder: Path) -> None:
        change(file, parts, str(folder.parent / parts))(folder)

    yield case("an include at an absolute path", both(out, absolute), "points outside")
    yield case(
        "an include with elements", change(file, include, f'<include file="{parts}"><asset/></include>'), "inside"
    )
    yield case("an include twice", adds(include), "twice")
    chain = [put(f"p{i}.xml", f'<mujoco><include file="p{i + 1}.xml"/></mujoco>') for i in range(300)]
    yield case("300 includes", both(*chain, change(file, parts, "p0.xml")), "200")
    yield case("an included document of another kind", put(parts, "<robot><link/></robot>"), "link")
    model = '<model name="m" file="../assets.xml"/>'
    yield case("a model of its own", both(out, adds(asset.format(model))), "<model> is not allowed")
    attach = '<attach model="m" body="palm" prefix="x"/>'
    yield case("an attached model", change(file, "</worldbody>", attach + "</worldbody>"), "<attach> is not allowed")
    outer = outside("finger.stl")
    for tag in ("hfield", "skin"):
        spoil = both(outer, adds(asset.format(f'<{tag} name="x" file="../finger.stl"/>')))
        yield case(f"a {tag} of what is outside", spoil, f"<{tag}> is not allowed")
    flex = '<flexcomp name="x" type="mesh" file="../finger.stl"/>'
    yield case("a flex of what is outside", change(file, "</worldbody>", flex + "</worldbody>"), "<flexcomp>")
    for side in ("file", "fileright", "filedown"):
        spoil = both(outer, adds(asset.format(f'<texture name="x" type="cube" {side}="../finger.stl"/>')))
        yield case(f"a texture's {side} of what is outside", spoil, "points outside")
    yield case(
        "a texture that is none", adds(asset.format('<texture name="x" type="2d" file="finger.stl"/>')), "finger.stl"
    )
    for folder in ("meshdir", "assetdir"):
        yield case(f"{folder} is outside", both(outer, adds(f'<compiler {folder}=".."/>')), "points outside")
    stripped = both(outer, adds('<compiler meshdir=".." strippath="true"/>'))
    yield case("a path that is stripped to outside", stripped, "points outside")
    png = _png(30_000, 30_000)
    bomb = both(put("bomb.png", png), adds(asset.format('<texture name="x" type="2d" file="bomb.png"/>')))
    yield case("a picture of 30000 x 30000", bomb, "bomb.png")
    large = both(
        put("large.png", _png(5000, 5000)), adds(asset.format('<texture name="x" type="2d" file="large.png"/>'))
    )
    yield case("a picture of 5000 x 5000", large, "texels")
    tiles = "".join(f'<texture name="t{i}" type="2d" builtin="flat" width="4000" height="4000"/>' for i in range(20))
    yield case("many large textures", adds(asset.format(tiles)), "texels")
    builtin = '<mesh name="x" builtin="supersphere" params="60000 1 1"/>'
    yield case("a mesh made of formulas", adds(asset.format(builtin)), "<mesh builtin='supersphere'> is not allowed")

    def bodies(n: int, content: str = '<geom size="0.01"/>') -> Spoil:
        many = "".join(f'<body name="x{i}">{content}</body>' for i in range(n))
        return change(file, '<body name="right"', many + '<body name="right"')

    yield case("20000 bodies", bodies(20_000), "20003 <body>")
    yield case("20000 geoms", bodies(1, '<geom size="0.01"/>' * 20_000), "<geom>")
    yield case("20000 sites", bodies(1, "<site/>" * 20_000), "<site>")
    motors = '<motor joint="left"/>' * 20_000
    yield case(
        "20000 motors", change(file, "</mujoco>", f"<actuator>{motors}</actuator></mujoco>"), "<actuator> has 20000"
    )
    yield case("2000 joints", bodies(900, "<joint/>" * 3 + '<geom size="0.01"/>'), "<joint>")
    included = put("many.xml", "<mujoco><worldbody>" + "<site/>" * 150_000 + "</worldbody></mujoco>")
    again = put("more.xml", "<mujoco><worldbody>" + "<site/>" * 150_000 + "</worldbody></mujoco>")
    both_in = '<include file="many.xml"/><include file="more.xml"/>'
    yield case("300000 elements by includes", both(included, again, adds(both_in)), "200000 elements")
    for tag in ("extension", "deformable"):
        yield case(f"an {tag}", adds(f"<{tag}/>"), f"<{tag}> is not allowed")
    yield case(
        "an sdf", change(file, '<geom type="box" size="0.05 0.05 0.01"/>', '<geom type="sdf" mesh="finger"/>'), ""
    )

    equality = '<joint joint1="right" joint2="left" polycoef="0 1 0 0 0"/>'
    tendon = '<tendon><fixed name="t"><joint joint="left" coef="1"/><joint joint="right" coef="1"/>{}</fixed></tendon>'

    def tied(constraint: str, more: str = "") -> Spoil:
        return both(change(file, equality, constraint), change(file, "<equality>", tendon.format(more) + "<equality>"))

    yield case("a joint that is held", change(file, 'joint2="left" ', ""), "holds joint 'right'")
    yield case(
        "a tendon of unequal powers", tied('<tendon tendon1="t" tendon2="t" polycoef="0 0 1 0 0"/>'), "not linear"
    )
    yield case("an unknown tendon", tied('<tendon tendon1="s"/>'), "'s'")
    third = change(
        file,
        '<body name="right"',
        '<body name="x"><joint name="x" range="0 1"/><geom size="0.01"/></body><body name="right"',
    )
    yield case(
        "a tendon of three joints",
        both(third, tied('<tendon tendon1="t"/>', '<joint joint="x" coef="1"/>')),
        "ties 3 joints (left, right, x)",
    )
    yield case("a tendon over coupled joints", tied(equality + '<tendon tendon1="t"/>'), "in a circle")
    spatial = '<tendon><spatial name="t"><site site="p"/><site site="q"/></spatial></tendon><equality>'
    sites = both(
        change(file, '<body name="left"', '<site name="p"/><body name="left"'),
        change(file, '<joint name="left"', '<site name="q"/><joint name="left"'),
    )
    cable = both(sites, change(file, equality, '<tendon tendon1="t"/>'), change(file, "<equality>", spatial))
    yield case("a cable that is held", cable, "holds a spatial tendon")
    loop = change(file, equality, '<connect body1="left" body2="right" anchor="0 0 0"/>')
    yield case("a loop that opens", loop, "links 'left' and 'right' are joined to a loop")


def _png(width: int, height: int) -> bytes:
    """A picture that says that it is large, and is not."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")


def _mesh() -> Iterator[Case]:
    file = "finger.stl"

    def case(name: str, content: bytes) -> Case:
        return Case("urdf", f"{file}: {name}", put(file, content), "Hand", "pads")

    def triangles(*corners: list) -> bytes:
        rows = b"".join(np.array([[0, 0, 0], *c], "<f4").tobytes() + b"\0\0" for c in corners)
        return b"\0" * 80 + np.uint32(len(corners)).tobytes() + rows

    for name, content in NO_TEXT.items():
        yield case(name, content)
    yield case("text", b"solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0")
    yield case("a huge count", b"\0" * 80 + np.uint32(2**32 - 1).tobytes() + b"\0" * 50)
    yield case("no triangles", triangles())
    yield case("a point", triangles(*[[[0, 0, 0]] * 3] * 4))
    yield case("a line", triangles(*[[[0, 0, 0], [1, 0, 0], [2, 0, 0]]] * 4))
    yield case("a plane", triangles([[0, 0, 0], [1, 0, 0], [0, 1, 0]]))
    yield case("nan", triangles(*[[[0, 0, 0], [1, 0, np.nan], [0, 1, 0]]] * 4))
    yield case("inf", triangles(*[[[0, 0, 0], [1, 0, np.inf], [0, 1, 0]]] * 4))
    yield case(
        "huge", triangles(*[[[0, 0, 0], [1e30, 0, 1e30], [0, 1e30, 0]], [[0, 0, 1e30], [1e30, 0, 0], [0, 1e30, 0]]] * 2)
    )
    yield from _mesh_formats()


def _mesh_formats() -> Iterator[Case]:
    """Meshes in formats that MuJoCo does not read."""

    def case(name: str, suffix: str, content: bytes, says: str) -> Case:
        mesh = f"finger.{suffix}"
        spoil = both(put(mesh, content), change("hand.urdf", "finger.stl", mesh))
        return Case("urdf", f"{mesh}: {name}", spoil, says, "pads")

    for suffix in ("obj", "ply", "off", "glb", "gltf", "dae", "msh"):
        for name, content in NO_TEXT.items():
            yield case(name, suffix, content, f"finger.{suffix}")
    yield case("faces of no vertices", "obj", b"f 1 2 3\nf 4 5 6\n", "finger.obj")
    yield case("faces of other vertices", "obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 9\nf 9 8 7\n", "")
    yield case("points alone", "obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "finger.obj")
    yield case("not finite", "obj", b"o a\nv nan 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\no b\nf 2 3 4\n", "finger.obj")
    head = b"ply\nformat %s 1.0\nelement vertex %d\nproperty float x\nproperty float y\nproperty float z\n"
    faces = b"element face %d\nproperty list uchar int vertex_indices\nend_header\n"
    for kind in (b"ascii", b"binary_little_endian"):
        claims = head % (kind, 10**12) + faces % 10**12 + b"0 0 0\n" * 4
        yield case(f"{kind.decode()} of 10^12 points", "ply", claims, "cut short")
    yield case("points alone", "ply", head % (b"ascii", 2) + b"end_header\n0 0 0\n1 1 1\n", "no triangle")
    yield case("10^12 points", "off", b"OFF\n1000000000000 1000000000000 0\n0 0 0\n", "finger.off")
    yield case("counts that are negative", "msh", np.array([-1, -1, -1, -1], "<i4").tobytes(), "finger.msh")
    yield case("counts that are huge", "msh", np.full(4, 2**31 - 1, "<i4").tobytes(), "finger.msh")
    for name, gltf, says in [
        (
            "an accessor of 10^12 numbers",
            {"accessors": [{"count": 10**12, "componentType": 5126, "type": "VEC3"}]},
            "claims",
        ),
        ("a buffer outside", _gltf("../secret.bin"), "points outside"),
        ("a buffer at an absolute path", _gltf("/etc/hostname"), "points outside"),
        ("a buffer that is missing", _gltf("none.bin"), "none.bin"),
        ("a buffer by http", _gltf("http://localhost:9/x.bin"), "finger.gltf"),
        ("a node that is its own child", _gltf("none.bin") | {"nodes": [{"mesh": 0, "children": [0]}]}, "finger.gltf"),
    ]:
        yield case(name, "gltf", json.dumps(gltf).encode(), says)
    yield case("an entity bomb", "dae", f"{BOMB}<COLLADA>&l8;</COLLADA>".encode(), "entities are not allowed")
    yield case("nothing in it", "dae", collada(""), "finger.dae")
    yield case("a unit of none", "dae", collada("", unit="far"), "its unit")
    nodes = (
        "".join(f'<node id="n{i}">' + f'<instance_node url="#n{i + 1}"/>' * 10 + "</node>" for i in range(12))
        + '<node id="n12"><instance_geometry url="#g"/></node>'
    )
    yield case("nodes of ten nodes of ten nodes", "dae", collada(nodes), "too often")
    yield case("a node in itself", "dae", collada('<node id="n"><instance_node url="#n"/></node>'), "too often")
    chain = "".join(f'<node id="n{i}"><instance_node url="#n{i + 1}"/></node>' for i in range(5000))
    yield case("a chain of 5000 nodes", "dae", collada(chain), "finger.dae")


def _gltf(uri: str) -> dict[str, Any]:
    """A triangle whose numbers are in another file."""
    return {
        "asset": {"version": "2.0"},
        "buffers": [{"uri": uri, "byteLength": 36}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
        "scene": 0,
    }


def collada(nodes: str, unit: str = "1") -> bytes:
    """A pyramid, placed by nodes."""
    points = "0 0 0 0.02 0 0 0 0.02 0 0 0 0.05"
    return f"""<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset><unit meter="{unit}"/></asset>
<library_geometries><geometry id="g"><mesh><source id="p"><float_array id="a" count="12">{points}</float_array>
<technique_common><accessor source="#a" count="4" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source><vertices id="v"><input semantic="POSITION" source="#p"/>
</vertices><triangles count="4"><input semantic="VERTEX" source="#v" offset="0"/><p>0 2 1 0 1 3 1 2 3 2 0 3</p></triangles></mesh>
</geometry></library_geometries><library_visual_scenes><visual_scene id="s">{nodes}</visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>""".encode()


NO_JSON = {
    **NO_TEXT,
    "a list": b"[]",
    "a number": b"5",
    "null": b"null",
    "text": b'"x"',
    "two objects": b"{} {}",
    "deep nesting": b'{"a":' + b"[" * 200_000 + b"]" * 200_000 + b"}",
    "a number of many digits": b'{"codebase_version": "v3.0", "fps": ' + b"9" * 10_000 + b"}",
}


def _calibration() -> Iterator[Case]:
    file = "cameras.yaml"

    def case(name: str, spoil: Spoil, says: str = file) -> Case:
        return Case("dataset", f"{file}: {name}", spoil, says, "calibrate")

    for name, content in NO_TEXT.items():
        yield case(name, put(file, content))
    yield case("missing", lambda folder: (folder / file).unlink())
    yield case("a folder", folder_at(file))
    yield case("a list", put(file, "[]"))
    yield case("python object", put(file, "!!python/object/apply:os.system ['touch pwned']"))
    yield case("billion laughs", put(file, LAUGHS + "cameras: *a9"))
    yield case(
        "billion laughs as a matrix",
        put(file, LAUGHS + "cameras: {front: {width: 64, height: 48, K: *a9, T_world_camera: *a9}}"),
    )
    yield case("deep nesting", put(file, "cameras: " + "[" * 20_000 + "]" * 20_000))
    yield case("a camera twice", put(file, "cameras: {front: {}, front: {}}"), "front")
    yield case("nothing", put(file, "{}"), "says nothing")
    yield case("cameras is empty", put(file, "cameras: {}"), "says nothing")
    yield case("all is null", put(file, "{cameras: null, workspace_world: null, T_world_base: null}"), "says nothing")
    yield case("a camera's name is a number", put(file, "cameras: {5: {}}"), "should be a name")
    for value in ([], "front", 5, True):
        yield case(f"cameras is {value}", has(file, "cameras", value=value), "cameras")
    yield case("an unknown field", has(file, "camera", value={}), "'camera'")
    for field in CAMERA:
        yield case(f"no {field}", lacks(file, "cameras", "front", field), field)
    for field in ("width", "height"):
        for value in (0, -1, 1.5, "wide", True, None, 10**30):
            yield case(
                f"{field} is {value}",
                has(file, "cameras", "front", field, value=value),
                field if type(value) is not int else "front",
            )
    for value in (
        [[1, 2], [3, 4]],
        "x",
        None,
        [[np.nan], [1.0]],
        {"fx": 1},
        {"fx": 0, "fy": 1, "cx": 0, "cy": 0},
        {"fx": "x", "fy": 1, "cx": 0, "cy": 0},
        [[1, 2, 3], [4, 5]],
    ):
        yield case(f"K is {value}", has(file, "cameras", "front", "K", value=value), "K")
    for value in (
        [[1, 2], [3, 4]],
        "x",
        None,
        {"position": [0, 0, 0]},
        {"position": [0, 0], "quaternion_wxyz": [1, 0, 0, 0]},
        {"position": [0, 0, 0], "quaternion_wxyz": [0, 0, 0, 0]},
        {"position": [np.inf, 0, 0], "quaternion_wxyz": [1, 0, 0, 0]},
        (2 * np.eye(4)).tolist(),
        np.diag([1.0, 1, -1, 1]).tolist(),
    ):
        yield case(
            f"T_world_camera is {value}", has(file, "cameras", "front", "T_world_camera", value=value), "T_world_camera"
        )
    for value in ([[1.0] * 3, [0.0] * 3], [[0.0] * 3], [[np.nan] * 3, [1.0] * 3], [[-np.inf] * 3, [np.inf] * 3], "box"):
        yield case(f"workspace_world is {value}", has(file, "workspace_world", value=value), "workspace_world")


def _info() -> Iterator[Case]:
    file = INFO

    def case(name: str, spoil: Spoil, says: str = file, through: str = "convert") -> Case:
        return Case("dataset", f"info.json: {name}", spoil, says, through)

    for name, content in NO_JSON.items():
        yield case(name, put(file, content))
    yield case("a folder", folder_at(file))
    yield case("a field twice", change(file, '"fps": 20', '"fps": 20, "fps": 30'), "fps")
    for field in ("codebase_version", "fps", "features", "total_episodes"):
        yield case(f"no {field}", lacks(file, field), field)
    for value in ("v2.1", "v9.0", "", None, 3, ["v3.0"], "v3.0\nerror: x"):
        yield case(
            f"codebase_version is {value!r}",
            has(file, "codebase_version", value=value),
            "has no meta/episodes.jsonl" if value == "v2.1" else "are read",
        )
    for value in (0, -20, "20", None, [20], {}, np.nan, np.inf, True, 1e308):
        yield case(f"fps is {value!r}", has(file, "fps", value=value), "fps")
    for value in (0, 1, 3, -1, "2", None, 2.5, 10**18, [2]):
        yield case(f"total_episodes is {value!r}", has(file, "total_episodes", value=value), "total_episodes")
    for value in ([], {}, "x", None, {"": {}}, {STATE: None}, {STATE: {}}, {STATE: {"dtype": "float32"}}):
        yield case(f"features is {value!r}", has(file, "features", value=value), "feature")
    for value in ([], [0], [-9], [8], [10], [9, 1], "9", None, [10**12], ["9"], [9.5], {"9": 9}):
        yield case(f"shape of state is {value!r}", has(file, "features", STATE, "shape", value=value), STATE)
    for value in ("string", "video", "image", "object", "", None, 5, ["float32"]):
        yield case(f"dtype of state is {value!r}", has(file, "features", STATE, "dtype", value=value), STATE)
    for value in (None, [], {}, "joint1", [1] * 9, {"a": "b"}, {"a": 5}, [None] * 9, 5, ["joint1.pos_rad"] * 9):
        yield case(f"names of state are {value!r}", has(file, "features", STATE, "names", value=value), STATE)
    yield case("no state", lacks(file, "features", STATE), STATE)
    yield case("no action", lacks(file, "features", ACTION), ACTION)
    for value in ([8, 4], [9, 3], [24], [0, 3], [8, 2], None, "x"):
        yield case(
            f"shape of the cloud is {value!r}", has(file, "features", CLOUD, "shape", value=value), CLOUD, "read"
        )
    for value in (
        None,
        [],
        {},
        "x",
        {"shape": None},
        {"shape": "x"},
        {"shape": [8]},
        {"shape": [6, 4]},
        {"shape": [8, 3.0]},
    ):
        yield case(f"info of a flat cloud is {value!r}", _flat_cloud(value), CLOUD, "read")
    for value in (
        {"shape": [-8, -3]},
        {"shape": [10**12, 3]},
        {"shape": [9, 3]},
        {"shape": {"8": 3}},
        {"shape": [[8], [3]]},
    ):
        yield case(f"info of a flat cloud is {value!r}", _flat_cloud(value), CLOUD, "read")
    for value in (None, 5, [], "x", {}, {"format_version": "2.0"}, {"format_version": "2.0", "embodiment": ROBOT}):
        yield case(f"essentials are {value!r}", _carried(value), "info.cei")
    for scene in (None, [], {"T_world_base": "here"}, {"T_world_base": np.eye(4).tolist(), "cameras": 5}):
        told = {"format_version": "2.0", "embodiment": ROBOT, "scene": scene}
        yield case(f"essentials with the scene {scene!r}", _carried(told), "scene")
    yield case("essentials that differ", _carried({"x": 1}, {"x": 2}), "differ")
    yield case("names of objects are a number", has(file, "features", OBJECTS, "names", value=5), OBJECTS, "read")
    yield case("names of objects are too few", has(file, "features", OBJECTS, "names", value=["x_m"]), OBJECTS, "read")
    for value in ([48, 64, 3], [1, 1, 1], [], None, "48", [48, 64]):
        yield case(f"shape of depth is {value!r}", has(file, "features", DEPTH_KEY, "shape", value=value), DEPTH_KEY)
    for value in (
        {"is_depth_map": True, "depth_unit": "ft"},
        {"is_depth_map": True, "depth_unit": 5},
        {"is_depth_map": True, "depth_unit": []},
        "depth",
        5,
    ):
        yield case(f"info of depth is {value!r}", has(file, "features", DEPTH_KEY, "info", value=value), DEPTH_KEY)
    yield case("depth is a number", has(file, "features", DEPTH_KEY, "dtype", value="float32"), DEPTH_KEY)
    data = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
    for value in (
        "../x/file.parquet",
        "{x}",
        "{chunk_index.__class__}",
        "{",
        "",
        None,
        5,
        [data],
        "data/\0.parquet",
        "data/{chunk_index:x>99999}",
        "{chunk_index!x}",
        "data/{chunk_index:999999999999d}",
    ):
        yield case(f"data_path is {value!r}", has(file, "data_path", value=value), "data_path")
    yield case(
        "data_path is outside",
        both(outside(DATA), has(file, "data_path", value="../file-{file_index:03d}.parquet")),
        "data_path",
    )

    def absolute(folder: Path) -> None:
        outside(DATA)(folder)
        has(file, "data_path", value=str(folder.parent / "file-000.parquet"))(folder)

    yield case("data_path is absolute", absolute, "data_path")
    for value in ("../x.mp4", "/etc/hostname", "{x}", "", None, 5, "videos/{video_key}", "a\0b"):
        yield case(f"video_path is {value!r}", has(file, "video_path", value=value), "video", "read")
    for field in ("chunks_size", "data_files_size_in_mb", "video_files_size_in_mb"):
        yield case(f"{field} is 0", has(file, field, value=0), field)
    yield case("chunks_size is text", has(file, "chunks_size", value="x"))


def _flat_cloud(info: object) -> Spoil:
    """The cloud's feature as if it was flat; its column is not."""
    feature = {"dtype": "float32", "shape": [24], "names": None, "info": info}
    return has(INFO, "features", CLOUD, value=feature)


def _carried(state: object, action: object = None) -> Spoil:
    """What `features` carry of `meta/cei.json`, which is gone."""

    def how(info: Any) -> None:
        info["features"][STATE]["info"] = {"cei": state}
        info["features"][ACTION]["info"] = {} if action is None else {"cei": action}

    return both(lambda folder: (folder / CEI).unlink(), edit(INFO, how))


def _cei() -> Iterator[Case]:
    file = CEI

    def case(name: str, spoil: Spoil, says: str = file, through: str = "convert") -> Case:
        return Case("dataset", f"cei.json: {name}", spoil, says, through)

    for name, content in NO_JSON.items():
        if name != "a number of many digits":
            yield case(name, put(file, content))
    yield case("a folder", folder_at(file))
    yield case("a field twice", change(file, '"embodiment":', '"embodiment": "x", "embodiment":'), "embodiment")
    yield case("an unknown field", has(file, "embodimentt", value="x"), "embodimentt")
    for field in ("embodiment", "scene"):
        yield case(f"no {field}", lacks(file, field), field)
    for value in (None, 5, [], "", "../../etc", "Panda", "Panda-PandaGriper", {"a": 1}):
        yield case(f"embodiment is {value!r}", has(file, "embodiment", value=value), "embodiment")
    for value in (None, "9.0", 3, "", []):
        yield case(f"format_version is {value!r}", has(file, "format_version", value=value), "format_version")
    yield case("scene is a list", has(file, "scene", value=[]), "scene")
    for field in ("T_world_base", "workspace_world", "cameras"):
        yield case(f"no {field}", lacks(file, "scene", field), field)
    poses = [
        None,
        "x",
        [],
        [1, 2],
        [[1.0] * 4] * 3,
        [[np.nan] * 4] * 4,
        np.zeros((4, 4)).tolist(),
        (2 * np.eye(4)).tolist(),
        np.diag([1.0, 1, -1, 1]).tolist(),
        [[1, 0, 0, 1e400], *np.eye(4)[1:].tolist()],
        [[1, 2], [3]],
        {"a": 1},
        [["1", "0", "0", "x"], *np.eye(4)[1:].tolist()],
        np.eye(5).tolist(),
    ]
    for i, value in enumerate(poses):
        yield case(f"T_world_base {i}", has(file, "scene", "T_world_base", value=value), "T_world_base")
        yield case(
            f"T_world_camera {i}", has(file, "scene", "cameras", 0, "T_world_camera", value=value), "T_world_camera"
        )
    for i, value in enumerate(
        [
            None,
            [],
            [[1, 2], [3, 4]],
            "x",
            [[0.0] * 3] * 3,
            [[np.nan] * 3] * 3,
            (-np.eye(3)).tolist(),
            np.ones((3, 3)).tolist(),
            [[1e400, 0, 0], [0, 1, 0], [0, 0, 1]],
        ]
    ):
        yield case(f"K {i}", has(file, "scene", "cameras", 0, "K", value=value), "K")
    for i, value in enumerate(
        [None, [], [[1.0] * 3, [0.0] * 3], [[0.0] * 3], [[np.nan] * 3] * 2, [[-np.inf] * 3, [np.inf] * 3], "x", 5]
    ):
        yield case(f"workspace_world {i}", has(file, "scene", "workspace_world", value=value), "workspace_world")
    for value in (None, "front", [5], [None]):
        yield case(f"cameras is {value!r}", has(file, "scene", "cameras", value=value), "cameras")
    yield case("cameras is {}", has(file, "scene", "cameras", value={}), "no camera is calibrated")
    for value in (None, 5, ["front"], "", "../front", "top"):
        yield case(
            f"name of the camera is {value!r}",
            has(file, "scene", "cameras", 0, "name", value=value),
            "name" if value is None else "front",
        )
    for field in ("width", "height"):
        for value in (None, 0, -64, "64px", 63, 1.5, 10**20):
            yield case(
                f"{field} is {value!r}",
                has(file, "scene", "cameras", 0, field, value=value),
                field if value is None or isinstance(value, (str, float)) else "front",
            )
    yield case(
        "a camera twice", edit(file, lambda c: c["scene"]["cameras"].append(c["scene"]["cameras"][0])), "share a name"
    )
    for value in (None, "x", {"kwargs": "x"}, {"x": 1}):
        yield case(
            f"environment is {value!r}",
            has(file, "environment", value=value),
            "environment" if value != {"x": 1} else "x",
        )

    def no_records(folder: Path) -> None:
        (folder / RECORDS).unlink()

    for value in (None, "x", [5], [None], ["x"], [[1]], {}):  # where format 1.0 has them
        yield case(f"episodes is {value!r}", both(no_records, has(file, "episodes", value=value)), "episodes")
    for value in (None, "x", {"source": 5}, {"source": {}}):
        yield case(f"provenance is {value!r}", has(file, "provenance", value=value), "provenance")


def _records() -> Iterator[Case]:
    file = RECORDS

    def case(name: str, spoil: Spoil, says: str = file) -> Case:
        return Case("dataset", f"records: {name}", spoil, says, "convert")

    for name, content in NO_JSON.items():
        if name != "empty":  # nothing is known of the episodes
            yield case(name, put(file, content))
    yield case("a folder", folder_at(file))
    yield case("a field twice", put(file, b'{"seed": 1, "seed": 2}\n{}\n'), "seed")
    yield case("the second is cut short", put(file, b'{"seed": 1}\n{"seed": '), "line 2")
    yield case("an empty line", put(file, b'{"seed": 1}\n\n{"seed": 2}\n'), "line 2")


def _tables() -> Iterator[Case]:
    def data(name: str, spoil: Spoil, says: str = DATA, through: str = "read") -> Case:
        return Case("dataset", f"data: {name}", spoil, says, through)

    def episodes(name: str, spoil: Spoil, says: str = "episode", through: str = "read") -> Case:
        return Case("dataset", f"episodes: {name}", spoil, says, through)

    for path in (DATA, EPISODES, TASKS):
        for name, content in NO_TEXT.items():
            yield Case("dataset", f"{path}: {name}", put(path, content), path if path != DATA else DATA, "convert")
        yield Case("dataset", f"{path}: a folder", folder_at(path), path, "convert")
        yield Case(
            "dataset",
            f"{path}: missing",
            lambda folder, path=path: (folder / path).unlink(),
            Path(path).parts[1],
            "convert",
        )
        yield Case("dataset", f"{path}: a link to itself", linked(path, Path(path).name), path, "convert")
    for path in (DATA, EPISODES):
        says = "episode 0" if path == DATA else "meta"
        yield Case("dataset", f"{path}: no rows", table(path, lambda t: t.slice(0, 0)), says, "convert")
    for key in (STATE, ACTION, "episode_index"):
        yield data(f"no {key}", table(DATA, lambda t, key=key: t.drop_columns([key])))
        yield data(
            f"{key} renamed",
            table(DATA, lambda t, key=key: t.rename_columns([f"{n}_" if n == key else n for n in t.column_names])),
        )
    yield data("state is text", column(DATA, STATE, lambda rows: ["x" for _ in rows]), STATE)
    yield data("state is lists of text", column(DATA, STATE, lambda rows: [["x"] * 9 for _ in rows]), STATE)
    yield data("state is a number", column(DATA, STATE, lambda rows: [1.0 for _ in rows]), STATE)
    yield data("state is yes and no", column(DATA, STATE, lambda rows: [[True] * 9 for _ in rows]), STATE)
    yield data("state is records", column(DATA, STATE, lambda rows: [{"a": 1.0, "b": 2.0} for _ in rows]), STATE)
    yield data("state is bytes", column(DATA, STATE, lambda rows: [b"x" for _ in rows]), STATE)
    yield data(
        "state is dates",
        column(DATA, STATE, lambda rows: [[np.datetime64("2020-01-01", "s").item()] * 9 for _ in rows]),
        STATE,
    )
    yield data("state is nothing", column(DATA, STATE, lambda rows: [None for _ in rows]), STATE)
    yield data("state is lists of nothing", column(DATA, STATE, lambda rows: [[None] * 9 for _ in rows]), STATE)
    yield data("a row of state is null", column(DATA, STATE, lambda rows: [None, *rows[1:]]), STATE)
    yield data("a value of state is null", column(DATA, STATE, lambda rows: [[None, *rows[0][1:]], *rows[1:]]), STATE)
    yield data("state is too short", column(DATA, STATE, lambda rows: [row[:-1] for row in rows]), STATE)
    yield data("state is too long", column(DATA, STATE, lambda rows: [[*row, 0.0] for row in rows]), STATE)
    yield data("state is ragged", column(DATA, STATE, lambda rows: [[*rows[0], 0.0], rows[1][:-1], *rows[2:]]), STATE)
    yield data("state is nested", column(DATA, STATE, lambda rows: [[[x, x] for x in row] for row in rows]), STATE)
    yield data("state is nan", column(DATA, STATE, lambda rows: [[np.nan] * 9 for _ in rows]), STATE)
    yield data("state is inf", column(DATA, STATE, lambda rows: [*rows[:-1], [np.inf] * 9]), STATE)
    yield data("state is huge", column(DATA, STATE, lambda rows: [[1e308] * 9 for _ in rows]), STATE)
    yield data("action is nan", column(DATA, ACTION, lambda rows: [*rows[:-1], [np.nan] * 9]), ACTION)
    yield data("cloud is text", column(DATA, CLOUD, lambda rows: [[["x"] * 3] * 8 for _ in rows]), CLOUD)
    yield data(
        "cloud is ragged", column(DATA, CLOUD, lambda rows: [[*rows[0], [0.0] * 3], rows[1][:-1], *rows[2:]]), CLOUD
    )
    yield data("cloud has a point less", column(DATA, CLOUD, lambda rows: [row[:-1] for row in rows]), CLOUD)
    yield data("objects are nan", column(DATA, OBJECTS, lambda rows: [[np.nan] * 2 for _ in rows]), "environment_state")
    yield data("objects are null", column(DATA, OBJECTS, lambda rows: [None, *rows[1:]]), OBJECTS)
    yield data("episode_index is text", column(DATA, "episode_index", lambda rows: [str(x) for x in rows]), DATA)
    yield data("episode_index is null", column(DATA, "episode_index", lambda rows: [None for _ in rows]), "episode 0")
    yield data(
        "episode_index is one too high", column(DATA, "episode_index", lambda rows: [x + 1 for x in rows]), "episode 0"
    )
    yield data(
        "all frames are of one episode", column(DATA, "episode_index", lambda rows: [0 for _ in rows]), "episode"
    )
    yield data("a frame is missing", table(DATA, lambda t: t.slice(0, len(t) - 1)), "episode 1")
    yield data("a frame too many", table(DATA, lambda t: pa.concat_tables([t, t.slice(len(t) - 1)])), "episode 1")
    yield data("timestamp is nan", column(DATA, "timestamp", lambda rows: [np.nan for _ in rows]), VIDEO)
    yield data("timestamp is text", column(DATA, "timestamp", lambda rows: ["x" for _ in rows]), "timestamp")
    yield data("timestamp is late", column(DATA, "timestamp", lambda rows: [1e9 for _ in rows]), VIDEO)
    yield data("timestamp is null", column(DATA, "timestamp", lambda rows: [None for _ in rows]), "timestamp")
    yield data("no timestamp", table(DATA, lambda t: t.drop_columns(["timestamp"])), "timestamp")

    def cells(how: Callable[[dict], object]) -> Callable[[list], list]:
        return lambda rows: [how(row) for row in rows]

    for key in (DEPTH_KEY, PICTURE_KEY):
        yield data(f"{key}: null", column(DATA, key, cells(lambda _: None)), key)
        yield data(f"{key}: no bytes", column(DATA, key, cells(lambda row: row | {"bytes": None})), key)
        yield data(f"{key}: empty", column(DATA, key, cells(lambda row: row | {"bytes": b""})), key)
        yield data(f"{key}: a number", column(DATA, key, cells(lambda _: 5)), key)
        yield data(f"{key}: a path alone", column(DATA, key, cells(lambda row: {"path": "/etc/hostname"})), key)
        yield data(
            f"{key}: a path in place of bytes",
            column(DATA, key, cells(lambda row: {"bytes": None, "path": "/etc/hostname"})),
            key,
        )
    yield data(
        "half a depth image",
        column(DATA, DEPTH_KEY, cells(lambda row: row | {"bytes": row["bytes"][: len(row["bytes"]) // 2]})),
        DEPTH_KEY,
    )
    yield data(
        "depth is a picture",
        table(DATA, lambda t: t.set_column(t.column_names.index(DEPTH_KEY), DEPTH_KEY, t[PICTURE_KEY])),
        DEPTH_KEY,
    )

    for key in (
        "episode_index",
        "length",
        "tasks",
        "data/chunk_index",
        "data/file_index",
        f"videos/{VIDEO_KEY}/chunk_index",
        f"videos/{VIDEO_KEY}/from_timestamp",
    ):
        said = key if not key.startswith("videos") else VIDEO_KEY
        yield episodes(f"no {key}", table(EPISODES, lambda t, key=key: t.drop_columns([key])), said)
        yield episodes(f"{key} is null", column(EPISODES, key, lambda rows: [None for _ in rows]), said)
        yield (
            episodes(f"{key} is text", column(EPISODES, key, lambda rows: ["../x" for _ in rows]), said)
            if key != "tasks"
            else episodes("tasks is a number", column(EPISODES, key, lambda rows: [5 for _ in rows]), said)
        )
    yield episodes("a length of 3", column(EPISODES, "length", lambda rows: [3 for _ in rows]), "episode 0")
    yield episodes("a negative length", column(EPISODES, "length", lambda rows: [-4 for _ in rows]), "episode 0")
    yield episodes("a huge length", column(EPISODES, "length", lambda rows: [2**60 for _ in rows]), "episode 0")
    for value in (7, -1, 2**60):
        yield episodes(
            f"data in chunk {value}",
            column(EPISODES, "data/chunk_index", lambda rows, value=value: [value for _ in rows]),
            "episode 0",
        )
    yield episodes(
        "data in chunk 0.5", column(EPISODES, "data/chunk_index", lambda rows: [0.5 for _ in rows]), "data/chunk_index"
    )
    climbing = both(
        outside(DATA),
        column(EPISODES, "data/chunk_index", lambda rows: ["../.." for _ in rows]),
        has(INFO, "data_path", value="data/{chunk_index}/file-{file_index:03d}.parquet"),
    )
    yield episodes("data in a chunk that climbs out", climbing, "data/chunk_index")
    climbing = both(
        outside(VIDEO),
        column(EPISODES, f"videos/{VIDEO_KEY}/chunk_index", lambda rows: ["../.." for _ in rows]),
        has(INFO, "video_path", value="videos/{chunk_index}/file-{file_index:03d}.mp4"),
    )
    yield episodes("a video in a chunk that climbs out", climbing, "leads out of the dataset")
    yield episodes("episodes in reverse", column(EPISODES, "episode_index", lambda rows: rows[::-1]), "episode_index")
    yield episodes("an episode twice", table(EPISODES, lambda t: pa.concat_tables([t, t])), "total_episodes")
    yield episodes("one is missing", table(EPISODES, lambda t: t.slice(0, 1)), "total_episodes")
    yield episodes("tasks are empty lists", column(EPISODES, "tasks", lambda rows: [[5] for _ in rows]), "tasks")
    for value in (np.nan, -1.0, 1e9):
        yield episodes(
            f"a video from {value} s",
            column(EPISODES, f"videos/{VIDEO_KEY}/from_timestamp", lambda rows, value=value: [value for _ in rows]),
            VIDEO if value == value else VIDEO_KEY,
        )
    yield episodes(
        "a video in chunk 9",
        column(EPISODES, f"videos/{VIDEO_KEY}/chunk_index", lambda rows: [9 for _ in rows]),
        "chunk-009",
    )
    yield episodes(
        "metadata in chunk 9",
        column(EPISODES, "meta/episodes/chunk_index", lambda rows: [9 for _ in rows]),
        "chunk-009",
    )
    yield episodes(
        "metadata in chunk ../..",
        column(EPISODES, "meta/episodes/chunk_index", lambda rows: ["../.." for _ in rows]),
        "meta/episodes",
    )
    yield episodes(
        "no statistics at all",
        both(
            table(
                EPISODES, lambda t: t.drop_columns([n for n in t.column_names if n.startswith(f"stats/{PICTURE_KEY}/")])
            ),
            edit(STATS, lambda s: s.pop(PICTURE_KEY)),
        ),
        PICTURE_KEY,
    )
    for value in (b"[]", b"5", b"{}x", b"\xff"):
        yield Case("dataset", f"stats.json: {value!r}", put(STATS, value), "meta", "convert")


def _video() -> Iterator[Case]:
    def case(name: str, spoil: Spoil, says: str = VIDEO, through: str = "convert") -> Case:
        return Case("dataset", f"video: {name}", spoil, says, through)

    for name, content in NO_TEXT.items():
        yield case(name, put(VIDEO, content))
    yield case("missing", lambda folder: (folder / VIDEO).unlink())
    yield case("a folder", folder_at(VIDEO))
    yield case("a link to itself", linked(VIDEO, "file-000.mp4"))
    yield case("only its head", lambda folder: (folder / VIDEO).write_bytes((folder / VIDEO).read_bytes()[:64]))
    yield case("a table", lambda folder: (folder / VIDEO).write_bytes((folder / DATA).read_bytes()))
    yield case("a script", put(VIDEO, "#EXTM3U\n#EXTINF:1,\n/etc/hostname\n"))
    yield case("a list of files", put(VIDEO, "ffconcat version 1.0\nfile /etc/hostname\n"))


def _replay() -> Iterator[Case]:
    def case(name: str, spoil: Spoil, says: str) -> Case:
        return Case("dataset", f"environment: {name}", spoil, says, "replay")

    yield case("an unknown id", has(CEI, "environment", "id", value="CEI-../x"), "'CEI-../x'")
    yield case("an id of others", has(CEI, "environment", "id", value="CartPole-v1"), "'CartPole-v1'")
    yield case("a module in the id", has(CEI, "environment", "id", value="antigravity:CEI-x"), "'antigravity:CEI-x'")
    yield case("an unknown argument", has(CEI, "environment", "kwargs", value={"x": 1}), "'x'")
    for name, value, says in [
        ("max_hold_ticks", 0, "max_hold_ticks"),
        ("max_hold_ticks", "x", "max_hold_ticks"),
        ("cameras", 5, "cameras"),
        ("cameras", ["x"], "camera 'x'"),
        ("image_width", "x", "image_width"),
        ("image_width", -1, "-1x120"),
        ("depth_noise", "../x", "depth noise '../x'"),
        ("depth_noise", {"x": 1}, "depth noise 'x'"),
        ("start_qpos", "x", "start_qpos"),
        ("start_qpos", [1.0], "start_qpos"),
        ("start_qpos", [[None]], "start_qpos"),
        ("max_episode_steps", "x", "max_episode_steps"),
    ]:
        yield case(f"{name} is {value!r}", has(CEI, "environment", "kwargs", value={name: value}), says)
