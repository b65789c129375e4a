"""Malformed sources of other formats: HDF5, zarr, joint maps, and what Parquet may hold; see `malformed`."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import yaml
from malformed import (
    DATA,
    EPISODES,
    LAUGHS,
    NO_TEXT,
    ROBOT,
    STATE,
    TASKS,
    Case,
    Spoil,
    column,
    edit,
    has,
    lacks,
    put,
    table,
)

from cei_gym.embodiment import load_embodiment

FILE, MAP, ZARR = "demo.hdf5", "map.yaml", "demo.zarr"
JOINTS, GRIPPER, ACTIONS = (
    "data/demo_0/obs/robot0_joint_pos",
    "data/demo_0/obs/robot0_gripper_qpos",
    "data/demo_0/actions",
)
FRAMES = 6
ZARR_MAP: dict[str, Any] = {
    "embodiment": ROBOT,
    "fps": 10.0,
    "joints": [
        {"joints": "arm", "columns": {"start": 0, "end": 7}, "sign": 1, "offset": 0.0},
        {
            "joints": ["finger_joint1"],
            "columns": ["7"],
            "unit": "normalised",
            "range": [0.0, 1.0],
            "limits": [0.0, 0.04],
        },
    ],
    "fixed": {},
    "ignore": ["8"],
}


def write_hdf5(folder: Path) -> None:
    """Two demonstrations as robomimic has them."""
    folder.mkdir(parents=True)
    qpos = np.tile(load_embodiment(ROBOT).home, (FRAMES, 1))
    with h5py.File(folder / FILE, "w") as file:
        data = file.create_group("data")
        data.attrs["env_args"] = json.dumps({"env_name": "Lift", "env_kwargs": {"control_freq": 20, "robots": "Panda"}})
        for name in ("demo_0", "demo_1"):
            obs = data.create_group(f"{name}/obs")
            obs["robot0_joint_pos"], obs["robot0_gripper_qpos"] = qpos[:, :7], qpos[:, 7:]
            obs["object"], obs["point_cloud"] = np.zeros((FRAMES, 3)), np.zeros((FRAMES, 5, 3), np.float32)
            data[f"{name}/actions"] = np.zeros((FRAMES, 7))
            data[f"{name}/rewards"] = np.zeros(FRAMES)


def write_zarr(folder: Path) -> None:
    """Two demonstrations as DP3 has them, and their joint map."""
    import zarr

    group = zarr.open_group(folder / ZARR, mode="w", zarr_format=2)
    state = np.tile(np.append(load_embodiment(ROBOT).home[:7], [0.5, 1.0]), (FRAMES, 1))
    group.create_array("data/state", data=state, compressors=None)
    group.create_array("data/point_cloud", data=np.ones((FRAMES, 5, 3), np.float32))
    group.create_array("meta/episode_ends", data=np.array([4, FRAMES]))
    # in one flow, as in `malformed`
    (folder / MAP).write_text(yaml.safe_dump(ZARR_MAP, default_flow_style=True, width=10_000, sort_keys=False).strip())


def cases() -> list[Case]:
    return [*_hdf5(), *_links(), *_zarr(), *_joint_map(), *_yaml_values(), *_parquet()]


# -- HDF5 -----------------------------------------------------------------------------------------------------


def within(how: Callable[[h5py.File], object]) -> Spoil:
    """Edit an HDF5 file."""

    def spoil(folder: Path) -> None:
        with h5py.File(folder / FILE, "a") as file:
            how(file)

    return spoil


def _put(name: str, value: Any) -> Spoil:
    """Another dataset in place of one."""

    def how(file: h5py.File) -> None:
        if name in file:
            del file[name]
        file[name] = value

    return within(how)


def _declared(name: str, shape: tuple[int, ...], dtype: str = "f4") -> Spoil:
    """A dataset that says it is huge, in a file of a few kilobytes."""

    def how(file: h5py.File) -> None:
        if name in file:
            del file[name]
        file.create_dataset(name, shape, dtype, chunks=tuple(min(side, 16) for side in shape))

    return within(how)


def _attribute(value: Any) -> Spoil:
    return within(lambda file: file["data"].attrs.__setitem__("env_args", value))


def _hdf5() -> Iterator[Case]:
    def case(name: str, spoil: Spoil, says: str = FILE) -> Case:
        return Case("hdf5", f"HDF5: {name}", spoil, says, "hdf5")

    for name, content in NO_TEXT.items():
        yield case(name, put(FILE, content))
    yield case("cut short", lambda folder: (folder / FILE).write_bytes((folder / FILE).read_bytes()[:3000]))
    no_rate = "does not say how many frames a second"
    for name, value in {
        "nested": "[" * 100_000 + "]" * 100_000,
        "a list": "[]",
        "text": '"x"',
        "no JSON": "{",
        "bytes": b"\xff\xfe",
        "a number": 5,
        "an array": np.zeros(3),
        "nothing": h5py.Empty("S1"),
        "many digits": '{"env_kwargs": {"control_freq": ' + "9" * 400 + "}}",
        "kwargs of text": '{"env_kwargs": "x"}',
        "no rate": '{"env_kwargs": {}}',
        "a rate of text": '{"env_kwargs": {"control_freq": "20"}}',
        "a rate of true": '{"env_kwargs": {"control_freq": true}}',
        "a rate of nan": '{"env_kwargs": {"control_freq": NaN}}',
        "a rate of 0": '{"env_kwargs": {"control_freq": 0}}',
    }.items():
        yield case(f"env_args is {name}", _attribute(value), no_rate)
    rate = '{"env_kwargs": {"control_freq": 20, %s}}'
    for name, text, says in [
        ("two robots", '"robots": ["Panda", "Panda"]', "they are those of 2 robots"),
        ("an unknown controller", '"controller_configs": {"type": "MAGIC"}', "'MAGIC'"),
        ("a controller's type a list", '"controller_configs": {"type": []}', "is unknown"),
        ("an unknown impedance", '"controller_configs": {"type": "OSC_POSE", "impedance_mode": "x"}', "'x'"),
        ("positions alone", '"controller_configs": {"type": "OSC_POSITION"}', "takes 3, which leaves 4"),
        ("joints", '"controller_configs": {"type": "JOINT_POSITION"}', "takes 7, which leaves 0"),
    ]:
        yield case(f"controllers: {name}", _attribute(rate % text), says)
    for name in (JOINTS, GRIPPER):
        yield case(f"{name} is missing", within(lambda file, name=name: file.__delitem__(name)), name[12:])
        for what, value in {
            "ragged": np.zeros((FRAMES - 1, 7 if name == JOINTS else 2)),
            "wider": np.zeros((FRAMES, 8)),
            "one number": np.float64(0),
            "flat": np.zeros(FRAMES),
            "a cube": np.zeros((FRAMES, 2, 2)),
            "text": np.full((FRAMES, 2), b"x"),
            "complex": np.zeros((FRAMES, 7), complex),
            "records": np.zeros(FRAMES, [("a", "f4")]),
            "yes and no": np.zeros((FRAMES, 7), bool),
            "empty": np.zeros((0, 7 if name == JOINTS else 2)),
            "nan": np.full((FRAMES, 7 if name == JOINTS else 2), np.nan),
        }.items():
            yield case(f"{name} is {what}", _put(name, value), "")
    yield case("joints are objects", within(_objects), "robot0_joint_pos")
    yield case("joints are references", within(_references), "robot0_joint_pos")
    yield case("joints are a group", within(_as_group), "robot0_joint_pos")
    for shape in ((10**12, 7), (10**9, 7), (2**62, 7)):
        yield case(f"joints of shape {shape}", _declared(JOINTS, shape), "robot0_joint_pos" if shape[0] < 2**60 else "")
    yield case("all of 10^12 rows", _all_huge, "too large for an episode")
    yield case("a cloud of 10^12 rows", _declared("data/demo_0/obs/point_cloud", (10**12, 5, 3)), "point_cloud")
    yield case("objects of 10^12 rows", _declared("data/demo_0/obs/object", (10**12, 3)), "object")
    yield case("rewards of 10^12 rows", _declared("data/demo_0/rewards", (10**12,)), "rewards")
    second = JOINTS.replace("demo_0", "demo_1")
    yield case(
        "the second has no joints", within(lambda file: file.__delitem__(second)), "demo_1 lacks obs/robot0_joint_pos"
    )
    yield case("the second is ragged", _put(second, np.zeros((FRAMES - 1, 7))), "demo_1 has")
    yield case("the second is wider", _put(second, np.zeros((FRAMES, 8))), "demo_1")
    yield case(
        "the second has no obs", within(lambda file: file.__delitem__("data/demo_1/obs")), "demo_1, has no observations"
    )
    yield case("the second has no actions", within(lambda file: file.__delitem__("data/demo_1/actions")), "demo_1")
    yield case("the second's actions are wider", _put("data/demo_1/actions", np.zeros((FRAMES, 8))), "demo_1")
    yield case("the second has fewer rewards", _put("data/demo_1/rewards", np.zeros(FRAMES - 1)), "demo_1")
    yield case("no actions", within(lambda file: file.__delitem__(ACTIONS)), "has no actions")
    for what, value in {
        "fewer": np.zeros((FRAMES - 2, 7)),
        "of 9 entries": np.zeros((FRAMES, 9)),
        "flat": np.zeros(FRAMES),
        "text": np.full((FRAMES, 7), b"x"),
        "nan": np.full((FRAMES, 7), np.nan),
    }.items():
        yield case(f"actions are {what}", _put(ACTIONS, value), "actions" if what != "fewer" else "demo_0 has")
    yield case("no data", within(lambda file: file.__delitem__("data")), "has no episodes")
    yield case("data is a dataset", _put("data", 5), "has no episodes")
    yield case(
        "data is empty",
        within(lambda file: [file["data"].__delitem__(name) for name in list(file["data"])]),
        "no episodes",
    )


def _objects(file: h5py.File) -> None:
    del file[JOINTS]
    file.create_dataset(JOINTS, (FRAMES, 7), h5py.special_dtype(vlen=np.float64))


def _references(file: h5py.File) -> None:
    del file[JOINTS]
    file.create_dataset(JOINTS, (FRAMES, 7), h5py.ref_dtype)


def _as_group(file: h5py.File) -> None:
    del file[JOINTS]
    file.create_group(JOINTS)


def _all_huge(folder: Path) -> None:
    for name, columns in ((JOINTS, 7), (GRIPPER, 2), (ACTIONS, 7)):
        _declared(name, (10**12, columns))(folder)


def _links() -> Iterator[Case]:
    """What leads out of the file, to one that is there and whole."""

    def case(name: str, how: Callable[[h5py.File], object], says: str = "") -> Case:
        def spoil(folder: Path) -> None:
            (folder.parent / "out.hdf5").write_bytes((folder / FILE).read_bytes())
            np.zeros((FRAMES, 7)).tofile(folder.parent / "raw.bin")
            within(how)(folder)

        return Case("hdf5", f"HDF5: {name}", spoil, says or "link", "hdf5")

    def linked(name: str, link: Any) -> Callable[[h5py.File], None]:
        def how(file: h5py.File) -> None:
            del file[name]
            file[name] = link

        return how

    for name in ("data", "data/demo_0", "data/demo_0/obs", JOINTS, ACTIONS, "data/demo_1", "data/demo_1/obs"):
        yield case(f"{name} is a link to another file", linked(name, h5py.ExternalLink("../out.hdf5", name)))
    yield case("data is a link to a missing file", linked("data", h5py.ExternalLink("none.hdf5", "data")))
    yield case("data is a link to itself", linked("data", h5py.SoftLink("/data")))
    yield case("an episode is a link in the file", linked("data/demo_0", h5py.SoftLink("/data/demo_1")))

    def by_way(file: h5py.File) -> None:
        file["way"] = h5py.ExternalLink("../out.hdf5", "data")
        del file["data/demo_0/obs"]
        file["data/demo_0/obs"] = h5py.SoftLink("/way/demo_0/obs")

    yield case("a link by way of another", by_way)

    def virtual(file: h5py.File) -> None:
        del file[JOINTS]
        layout = h5py.VirtualLayout((FRAMES, 7), "f8")
        layout[:] = h5py.VirtualSource("../out.hdf5", JOINTS, (FRAMES, 7))
        file.create_virtual_dataset(JOINTS, layout)

    yield case("a virtual dataset", virtual, "virtual")

    def external(name: str) -> Callable[[h5py.File], None]:
        def how(file: h5py.File) -> None:
            del file[name]
            file.create_dataset(name, (FRAMES, 7), "f8", external=[("../raw.bin", 0, FRAMES * 7 * 8)])

        return how

    yield case("values in another file", external(JOINTS), "stored in another file")
    yield case("actions in another file", external(ACTIONS), "stored in another file")


# -- zarr -----------------------------------------------------------------------------------------------------


def _zarr() -> Iterator[Case]:
    state, ends = f"{ZARR}/data/state/.zarray", f"{ZARR}/meta/episode_ends/.zarray"

    def case(name: str, spoil: Spoil, says: str = ZARR) -> Case:
        return Case("zarr", f"zarr: {name}", spoil, says, "zarr")

    def described(path: str, **values: Any) -> Spoil:
        def spoil(folder: Path) -> None:
            old = json.loads((folder / path).read_text())
            (folder / path).write_text(json.dumps(old | values))

        return spoil

    for name, content in NO_TEXT.items():
        yield case(f"state is {name}", put(state, content))
    for name, value in {
        "10^12 rows": [10**12, 9],
        "400 digits": [10**399, 9],
        "none": None,
        "negative": [-1, 9],
        "text": ["x", 9],
        "a list": [[6], 9],
        "flat": [6],
    }.items():
        yield case(f"shape is {name}", described(state, shape=value), "state")
    yield case("chunks of 10^12", described(state, chunks=[10**12, 9]), "state")
    yield case("chunks of 0", described(state, chunks=[0, 9]), "")
    for name, value in {
        "objects": "|O",
        "text": "<U5",
        "records": [["a", "<f4"]],
        "complex": "<c16",
        "junk": "x",
    }.items():
        yield case(f"dtype is {name}", described(state, dtype=value), "state")
    for codec in ("pickle", "msgpack2", "json2", "vlen-bytes"):
        yield case(f"a filter is {codec}", described(state, filters=[{"id": codec}]), f"'{codec}'")
        yield case(f"the compressor is {codec}", described(state, compressor={"id": codec}), f"'{codec}'")
    yield case(
        "a filter and pickle",
        described(state, filters=[{"id": "shuffle", "elementsize": 8}, {"id": "pickle"}]),
        "'pickle'",
    )
    yield case(
        "an unknown codec", described(state, compressor={"id": "magic"}), "'magic', which is no codec of numbers"
    )
    yield case(
        "a codec without a name", described(state, compressor={"level": 3}), "'None', which is no codec of numbers"
    )
    yield case(
        "chunks that are no blosc",
        described(state, compressor={"id": "blosc", "cname": "lz4", "clevel": 5, "shuffle": 1}),
    )
    yield case("ends of 10^12", described(ends, shape=[10**12]), "episode_ends")
    yield case("no ends", lambda folder: (folder / ends).unlink(), "meta/episode_ends")
    yield case("no state", lambda folder: (folder / state).unlink(), "data/state")
    for name, values in {"falling": [4, 2], "too far": [4, 9], "negative": [-4, 6], "none": []}.items():
        yield case(
            f"ends are {name}",
            lambda folder, values=values: _array(folder / ZARR, "meta/episode_ends", np.array(values, int)),
        )
    yield case("ends are nan", lambda folder: _array(folder / ZARR, "meta/episode_ends", np.array([np.nan, 6.0])))
    yield case(
        "state is nan", lambda folder: _array(folder / ZARR, "data/state", np.full((FRAMES, 9), np.nan)), "episode 0"
    )
    yield case(
        "a cloud of four columns",
        lambda folder: _array(folder / ZARR, "data/point_cloud", np.zeros((FRAMES, 5, 4))),
        "point clouds",
    )


def _array(root: Path, name: str, values: np.ndarray) -> None:
    import zarr

    zarr.open_group(root, mode="a", zarr_format=2).create_array(name, data=values, overwrite=True)


# -- joint maps -----------------------------------------------------------------------------------------------


def _joint_map() -> Iterator[Case]:
    def case(name: str, spoil: Spoil, says: str = MAP) -> Case:
        return Case("zarr", f"{MAP}: {name}", spoil, says, "zarr")

    for name, content in NO_TEXT.items():
        yield case(name, put(MAP, content))
    yield case("missing", lambda folder: (folder / MAP).unlink())
    yield case("billion laughs", put(MAP, LAUGHS + "embodiment: x\njoints: *a9"))
    yield case("deep nesting", put(MAP, "joints: " + "[" * 20_000 + "]" * 20_000))
    yield case("an unknown field", has(MAP, "joint", value=[]), "joint")
    yield case("no fps", lacks(MAP, "fps"), "fps")
    yield case("no embodiment", lacks(MAP, "embodiment"), "--source")
    yield case("no joints", lacks(MAP, "joints"), "joint1")
    yield case("an unknown embodiment", has(MAP, "embodiment", value="../x"), "'../x'")
    for key in ("joints", "state", "fixed", "ignore"):
        yield case(f"{key} is null", has(MAP, key, value=None), f"`{key}` is null")
    for key in ("joints", "columns", "unit", "sign", "offset"):
        yield case(f"{key} of a group is null", has(MAP, "joints", 0, key, value=None), f"joints.{key}` is null")
    for value in ([None], {"a": None}, [1, None]):
        yield case(f"offset is {value}", has(MAP, "joints", 0, "offset", value=value), "offset")
    yield case("a group is null", edit(MAP, lambda raw: raw["joints"].append(None)), "`joints` is null")
    for value in (True, False, "x", [], np.inf, np.nan, -1.0, 0, 1e9):
        yield case(f"fps is {value}", has(MAP, "fps", value=value), "fps")
    yield case("sign is true", _text(MAP, "sign: 1", "sign: true"), "sign")
    for value in ("x", np.nan, 0, 2, [1, 1], [1] * 6 + [True]):
        yield case(f"sign is {value}", has(MAP, "joints", 0, "sign", value=value), "sign")
    for value in (True, "x", np.inf, [0.0] * 6 + [np.nan]):
        yield case(f"offset is {value}", has(MAP, "joints", 0, "offset", value=value), "offset")
    for value in ([0, 0], [1], [np.nan, 1], [0, np.inf], ["a", "b"], [True, False], {"a": 1}):
        yield case(f"range is {value}", has(MAP, "joints", 1, "range", value=value), "range")
    for value in (
        {"start": 0},
        {"start": -1, "end": 6},
        {"start": 0, "end": 10**30},
        ["9" * 400],
        [[0]],
        ["x"],
        5,
        {"start": "a", "end": 7},
    ):
        yield case(f"columns are {str(value)[:40]}", has(MAP, "joints", 0, "columns", value=value), "")
    for value in (np.inf, True, "x", None):
        yield case(f"a joint is fixed at {value}", has(MAP, "fixed", value={"joint1": value}), "fixed")
    for value, says in [
        (5, "action"),
        (True, "action"),
        ([], "action"),
        ({"kind": "magic"}, "'magic'"),
        ({"kin": "delta"}, "kin"),
        ({"feature": "x"}, "'x'"),
        ({"joints": [{"joints": "arm", "kind": "next_state"}]}, "finger_joint1"),
        ({"joints": [{"joints": "arm"}]}, "say which columns"),
        ({"joints": [{"joints": "arm", "kind": "next_state", "columns": ["0"]}]}, "needs no columns"),
        ({"joints": [{"joints": "arm", "columns": ["0"], "kind": "open_close"}]}, "the same pose open"),
        ({"joints": [{"joints": "end_effector", "kind": "open_close"}]}, "needs one column"),
        ({"joints": [{"joints": "end_effector", "columns": ["0"], "kind": "open_close", "range": [1, 1]}]}, "range"),
        (
            {"joints": [{"joints": "end_effector", "columns": ["0"], "kind": "open_close", "unit": "deg"}]},
            "columns and range only",
        ),
        (
            {"joints": [{"joints": "arm", "columns": {"start": 0, "end": 7}, "kind": "delta", "offset": 1.0}]},
            "offset is for absolute",
        ),
    ]:
        yield case(f"action is {value}", has_action(value), says)


def has_action(value: Any) -> Spoil:
    """A map whose action is that, and a zarr that has actions."""

    def spoil(folder: Path) -> None:
        _array(folder / ZARR, "data/action", np.zeros((FRAMES, 9)))
        has(MAP, "action", value=value)(folder)

    return spoil


def _yaml_values() -> Iterator[Case]:
    """What YAML 1.1 takes for something else, and what is no plain value, where numbers should be."""
    values = {
        "a date": "2024-01-01",
        "a timestamp": "!!timestamp 2024-01-01",
        "bytes": "!!binary aGVsbG8=",
        "a set": "!!set {a, b}",
        "an ordered map": "!!omap [a: 1]",
        "pairs": "!!pairs [a: 1]",
        "python": "!!python/name:os.system",
        "base 60": "1:30",
        "octal": "010",
        "hexadecimal": "0x10",
        "400 digits": "9" * 400,
        "400 decimals": "0." + "3" * 400,
        "out of range": "1e400",
        "a value": "=",
        "true": "true",
        "yes": "yes",
        "an unknown tag": "!x 1",
        "an odd bool": "!!bool maybe",
        "an odd int": "!!int ''",
        "an odd float": "!!float x",
        "a merge of a number": "{<<: 5}",
    }
    for name, text in values.items():
        yield Case("zarr", f"{MAP}: offset is {name}", _text(MAP, "offset: 0.0", f"offset: {text}"), "map", "zarr")
        yield Case("zarr", f"{MAP}: range has {name}", _text(MAP, "[0.0, 1.0]", f"[{text}, 1.0]"), "map", "zarr")
        yield Case(
            "dataset",
            f"cameras.yaml: fx is {name}",
            _text("cameras.yaml", "fx: 60.0", f"fx: {text}"),
            "cameras.yaml",
            "calibrate",
        )
        if name not in ("400 digits",):
            yield Case(
                "dataset",
                f"cameras.yaml: a position is {name}",
                _text("cameras.yaml", "[0.5, 0.0, 2.0]", f"[{text}, 0.0, 2.0]"),
                "cameras.yaml",
                "calibrate",
            )


def _text(path: str, old: str, new: str) -> Spoil:
    def spoil(folder: Path) -> None:
        text = (folder / path).read_text()
        assert old in text, f"{path} has no {old!r}"
        (folder / path).write_text(text.replace(old, new, 1))

    return spoil


# -- Parquet --------------------------------------------------------------------------------------------------


def typed(path: str, key: str, kind: pa.DataType | None, how: Callable[[Any], Any]) -> Spoil:
    """Other values of a type in a column of a Parquet file; dictionary-encoded without a type."""

    def values(rows: list) -> pa.Array:
        found = [how(row) for row in rows]
        return pa.array(found).dictionary_encode() if kind is None else pa.array(found, kind)

    return column(path, key, values)


def _parquet() -> Iterator[Case]:
    numbers = pa.map_(pa.string(), pa.float64())

    def data(name: str, spoil: Spoil, says: str) -> Case:
        return Case("dataset", f"data: {name}", spoil, says, "read")

    for key in (STATE, "episode_index", "timestamp", "task_index"):
        yield data(f"{key} is a map", typed(DATA, key, numbers, lambda row: [("a", 1.0)]), key)
    yield data("state is lists of maps", typed(DATA, STATE, pa.list_(numbers), lambda row: [[("a", 1.0)]] * 9), STATE)
    yield data("state is dictionary-encoded text", typed(DATA, STATE, None, lambda row: "x"), STATE)
    for name, kind, how in [
        ("halves", pa.float64(), lambda row: row + 0.5),
        ("nan", pa.float64(), lambda row: np.nan),
        ("negative", pa.int64(), lambda row: -row - 1),
        ("text in a dictionary", None, str),
        ("lists", pa.list_(pa.int64()), lambda row: [row]),
        ("records", pa.struct([("a", pa.int64())]), lambda row: {"a": row}),
        ("yes and no", pa.bool_(), bool),
        ("dates", pa.date32(), lambda row: row),
        ("decimals", pa.decimal128(30, 2), lambda row: row),
        ("too large", pa.uint64(), lambda row: 2**63 + row),
    ]:
        yield data(f"episode_index is {name}", typed(DATA, "episode_index", kind, how), "episode 0")
    twice = table(DATA, lambda t: t.append_column("episode_index", t["episode_index"]))
    yield data("episode_index is there twice", twice, "episode_index")
    for name, kind, how in [
        ("of no task", pa.int64(), lambda row: 99),
        ("text", pa.string(), str),
        ("null", pa.int64(), lambda row: None),
    ]:
        yield data(f"task_index is {name}", typed(DATA, "task_index", kind, how), "episode 0, frame 0: task_index")
    for name, kind, how in [
        ("a map", numbers, lambda row: [("a", 1.0)]),
        ("text", pa.string(), str),
        ("nan", pa.float64(), lambda row: np.nan),
    ]:
        yield data(f"tasks: task_index is {name}", typed(TASKS, "task_index", kind, how), TASKS)
    yield data("tasks: no task_index", table(TASKS, lambda t: t.drop_columns(["task_index"])), TASKS)
    for key in ("episode_index", "length", "tasks"):
        yield data(f"episodes: {key} is a map", typed(EPISODES, key, numbers, lambda row: [("a", 1.0)]), "meta")
    yield data(
        "episodes: one is there twice", typed(EPISODES, "episode_index", pa.int64(), lambda row: 0), "episode_index"
    )
    yield data("episodes: negative", typed(EPISODES, "episode_index", pa.int64(), lambda row: -row), "episode_index")
    yield data("episodes: halves", typed(EPISODES, "episode_index", pa.float64(), lambda row: row / 2), "episode_index")
