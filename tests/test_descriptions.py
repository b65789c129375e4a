"""What robot descriptions say against what is built of them: meshes, folders, couplings, limits; and what is said of it."""

import json
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
import trimesh
import yaml
from scipy.spatial.transform import Rotation

from cei_converters import pads
from cei_gym.embodiment import (
    ARMS,
    END_EFFECTORS,
    ArmSpec,
    Coupling,
    Embodiment,
    EndEffectorSpec,
    build_embodiment,
    load_arm,
    load_end_effector,
    load_spec,
    use_package_path,
)
from cei_gym.embodiment.meshes import link_mesh
from cei_gym.embodiment.resources import PACKAGE_PATH
from cei_gym.errors import CEIError
from cei_gym.functional import sample_representation

SHARED = Path(__file__).parents[2] / "shared"
ROBOTS, CASES = SHARED / "robots", SHARED / "cases/robots"
needs_shared = pytest.mark.skipif(not CASES.is_dir(), reason=f"third-party robots and cases are not at {SHARED}")

INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
LIMIT = '<limit lower="0" upper="1" effort="1" velocity="1"/>'


def finger_urdf(geoms: str, joint: str = LIMIT, kind: str = "revolute", more: str = "") -> str:
    """A palm with one finger, whose joint is called `j`."""
    return f"""<robot name="r"><link name="palm">{INERTIAL}</link><link name="finger">{INERTIAL}{geoms}</link>
<joint name="j" type="{kind}"><parent link="palm"/><child link="finger"/><axis xyz="0 0 1"/>{joint}</joint>{more}</robot>"""


def mesh_tag(name: str, kind: str = "collision", scale: str = "") -> str:
    scale = f' scale="{scale}"' if scale else ""
    return f'<{kind}><geometry><mesh filename="{name}"{scale}/></geometry></{kind}>'


def hand_of(path: Path, text: str = "", **fields) -> Embodiment:
    """An end-effector of a description, by a YAML in the same folder."""
    if text:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    yaml_path = path.parent / "hand.yaml"
    yaml_path.write_text(yaml.safe_dump({"name": "Hand", "description": path.name, "pads": [], **fields}))
    return build_embodiment(None, load_spec(EndEffectorSpec, yaml_path))


def case(name: str) -> Embodiment:
    path = next((CASES / name).glob("hand.yaml"))
    return build_embodiment(None, load_spec(EndEffectorSpec, path))


def extents(embodiment: Embodiment, link: str, visual: bool = False) -> np.ndarray:
    """(2, 3) bounds of a link's collision or visual geoms in its frame, m."""
    model, body = embodiment.model, embodiment.body_id(link)
    touches = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    mesh = link_mesh(model, np.flatnonzero((model.geom_bodyid == body) & (touches != visual)))
    assert mesh is not None
    return mesh.bounds


def write_box(path: Path, size: tuple[float, float, float], at: tuple[float, float, float] = (0, 0, 0)) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    trimesh.creation.box(size, trimesh.transformations.translation_matrix(at)).export(path)


def refusal(call: Callable[[], object]) -> str:
    with pytest.raises(CEIError) as error:
        call()
    message = str(error.value)
    assert "\n" not in message
    return message


# -- meshes --------------------------------------------------------------------------------------------------


@needs_shared
def test_meshes_of_one_stem_are_two() -> None:
    hand = case("same_stem")
    np.testing.assert_allclose(extents(hand, "finger"), [[-0.01] * 3, [0.01] * 3], atol=1e-6)
    np.testing.assert_allclose(extents(hand, "finger", visual=True), [[-0.1] * 3, [0.1] * 3], atol=1e-6)
    points = sample_representation(hand, 64).points_link
    assert np.abs(points).max() <= 0.01 + 1e-6


@needs_shared
def test_all_objects_of_an_obj_are_there() -> None:
    expected = [[-0.01, -0.01, 0.0], [0.01, 0.01, 0.1]]
    np.testing.assert_allclose(extents(case("multi_object_obj"), "finger"), expected, atol=1e-6)


@needs_shared
def test_a_glb_is_read() -> None:
    theirs = trimesh.load(CASES / "dae/finger.glb", force="mesh")
    np.testing.assert_allclose(extents(case("dae"), "finger", visual=True), theirs.bounds, atol=1e-6)


@pytest.mark.parametrize("scales", [("1 1 1", "2 3 4"), ("-1 1 1", "1 1 -2"), ("0.5 0.5 0.5", "1 1 1")])
def test_each_use_of_a_mesh_has_its_own_scale(tmp_path: Path, scales: tuple[str, str]) -> None:
    write_box(tmp_path / "m.stl", (0.1, 0.2, 0.3), (0.05, 0.1, 0.15))
    geoms = mesh_tag("m.stl", "visual", scales[0]) + mesh_tag("m.stl", "collision", scales[1])
    hand = hand_of(tmp_path / "hand.urdf", finger_urdf(geoms))
    for visual, scale in zip((True, False), scales, strict=True):
        corners = np.array([[0, 0, 0], [0.1, 0.2, 0.3]]) * np.array(scale.split(), float)
        np.testing.assert_allclose(extents(hand, "finger", visual), np.sort(corners, axis=0), atol=1e-6)
    mirrored = link_mesh(hand.model, [0])
    assert mirrored is not None
    assert mirrored.volume > 0


def test_an_mjcfs_meshes_have_their_files_scales_and_default_classes(tmp_path: Path) -> None:
    write_box(tmp_path / "visual/m.stl", (0.4, 0.4, 0.4))
    write_box(tmp_path / "collision/m.obj", (0.1, 0.2, 0.3))
    hand = hand_of(
        tmp_path / "hand.xml",
        """<mujoco><default><default class="half"><mesh scale=".5 .5 .5"/></default></default><asset>
        <mesh name="seen" file="visual/m.stl" class="half"/><mesh name="felt" file="collision/m.obj" scale="1 -2 1"/>
        <mesh file="collision/m.obj"/></asset><worldbody><body name="palm"><body name="finger"><joint name="j" range="0 90"/>
        <geom type="mesh" mesh="seen" contype="0" conaffinity="0"/><geom type="mesh" mesh="felt"/>
        <body name="tip"><geom type="mesh" mesh="m"/></body></body></body></worldbody></mujoco>""",
    )
    np.testing.assert_allclose(np.ptp(extents(hand, "finger", visual=True), axis=0), [0.2, 0.2, 0.2], atol=1e-6)
    np.testing.assert_allclose(np.ptp(extents(hand, "finger"), axis=0), [0.1, 0.4, 0.3], atol=1e-6)
    np.testing.assert_allclose(np.ptp(extents(hand, "tip"), axis=0), [0.1, 0.2, 0.3], atol=1e-6)


def two_boxes() -> trimesh.Scene:
    boxes = [trimesh.creation.box((0.02, 0.03, 0.04)), trimesh.creation.box((0.01, 0.01, 0.01))]
    scene = trimesh.Scene()
    scene.add_geometry(boxes[0], transform=trimesh.transformations.rotation_matrix(0.3, (1, 2, 3)))
    scene.add_geometry(boxes[1], transform=trimesh.transformations.translation_matrix((0, 0, 0.1)))
    return scene


@pytest.mark.parametrize("name", ["m.GLB", "m.gltf", "m.dae", "m.OBJ", "m.ply", "m.off", "m.stl", "text.stl"])
def test_formats(tmp_path: Path, name: str) -> None:
    scene = two_boxes()
    whole = scene.to_mesh()
    if name.endswith("gltf"):
        for file, content in scene.export(file_type="gltf").items():
            (tmp_path / file.replace("model", "m")).write_bytes(content)
    elif name == "m.dae":
        (tmp_path / name).write_bytes(trimesh.exchange.dae.export_collada(scene.dump()))
    elif name == "text.stl":
        (tmp_path / name).write_text(whole.export(file_type="stl_ascii"))
    else:
        exported = (scene if name == "m.GLB" else whole).export(file_type=name.partition(".")[2].lower())
        (tmp_path / name).write_bytes(exported.encode() if isinstance(exported, str) else exported)
    hand = hand_of(tmp_path / "hand.urdf", finger_urdf(mesh_tag(name, "visual") + mesh_tag(name)))
    for visual in (True, False):
        np.testing.assert_allclose(extents(hand, "finger", visual), whole.bounds, atol=1e-6)


@pytest.mark.parametrize(("unit", "size_m"), [("1", 0.05), ("0.001", 5e-5), ("0.0254", 0.05 * 0.0254)])
def test_a_collada_has_its_unit_and_instances(tmp_path: Path, unit: str, size_m: float) -> None:
    from malformed import collada  # the smallest that there is

    nodes = '<node id="n"><matrix>1 0 0 0 0 1 0 0 0 0 1 0.2 0 0 0 1</matrix><instance_geometry url="#g"/></node>'
    (tmp_path / "m.dae").write_bytes(collada(nodes, unit))
    scale = 0.05 / size_m
    hand = hand_of(tmp_path / "hand.urdf", finger_urdf(mesh_tag("m.dae", "visual", f"{scale} {scale} {scale}")))
    bounds = extents(hand, "finger", visual=True)
    np.testing.assert_allclose(bounds, [[0, 0, 0.2], [0.02, 0.02, 0.25]], atol=1e-6)


def test_points_that_belong_to_no_triangle_are_no_part_of_a_mesh(tmp_path: Path) -> None:
    write_box(tmp_path / "m.obj", (0.02, 0.02, 0.02))
    (tmp_path / "m.obj").write_text(
        "v 0 0 0.5\n" + (tmp_path / "m.obj").read_text().replace("f ", "f ").replace("v 0 0 0.5", "")
    )
    text = (tmp_path / "m.obj").read_text().splitlines()
    points = [line for line in text if line.startswith("v ")]
    faces = [line for line in text if line.startswith("f ")]
    (tmp_path / "m.obj").write_text("\n".join([*points[1:], "v 0 0 0.5", *faces]) + "\n")
    hand = hand_of(tmp_path / "hand.urdf", finger_urdf(mesh_tag("m.obj")))
    mesh = hand.model.mesh_vert
    assert np.ptp(mesh, axis=0).max() == pytest.approx(0.02, abs=1e-6)


def test_a_mesh_in_millimetres_is_refused_with_the_scale_that_would_be_right(tmp_path: Path) -> None:
    write_box(tmp_path / "m.stl", (10, 20, 60))
    message = refusal(lambda: hand_of(tmp_path / "hand.urdf", finger_urdf(mesh_tag("m.stl"))))
    assert message == (
        "hand.urdf: mesh 'm.stl' is 60 m long, which no link is; with scale=\"0.001 0.001 0.001\" (millimetres) it is 60 mm."
    )
    hand = hand_of(tmp_path / "hand.urdf", finger_urdf(mesh_tag("m.stl", scale="0.001 0.001 0.001")))
    np.testing.assert_allclose(np.ptp(extents(hand, "finger"), axis=0), [0.01, 0.02, 0.06], atol=1e-6)


def test_a_flat_mesh_is_seen_and_touches_nothing(tmp_path: Path) -> None:
    corners = [[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]]
    trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]]).export(tmp_path / "m.stl")
    for kind, notes in [
        ("visual", ()),
        ("collision", ("Hand: geom 'finger.0' is flat; it is seen, and touches nothing.",)),
    ]:
        hand = hand_of(tmp_path / "hand.urdf", finger_urdf(mesh_tag("m.stl", kind)))
        np.testing.assert_allclose(np.ptp(extents(hand, "finger", visual=True), axis=0), [0.1, 0.1, 0], atol=1e-6)
        assert hand.notes == notes


# -- third-party robots --------------------------------------------------------------------------------------

THIRD_PARTY = [
    "allegro_hand/allegro_hand_left.urdf",
    "allegro_hand/allegro_hand_right_glb.urdf",
    "allegro_hand/variation/allegro_hand_right_fsr.urdf",
    "dh_robotics_ag95_description/urdf/dh_robotics_ag95.urdf",
    "panda_gripper/panda_gripper_glb.urdf",
    "schunk_hand/schunk_svh_hand_left_glb.urdf",
    "schunk_hand/schunk_svh_hand_right.urdf",
    "shadow_hand/shadow_hand_left_glb.urdf",
    "shadow_hand/shadow_hand_right.urdf",
    "so101/so101_new_calib.urdf",
    "unitree_g1/g1_body29_hand14.urdf",
    "xarm7/xarm7.urdf",
    "xarm7/xarm7_glb.urdf",
    "xhand_right/xhand_right.urdf",
]


def shape(geometry: ElementTree.Element, folder: Path) -> trimesh.Trimesh:
    """A URDF's geometry, by trimesh alone."""
    element = geometry[0]
    numbers = {k: np.array(v.split(), float) for k, v in element.items() if k not in ("filename", "scale")}
    if element.tag == "box":
        return trimesh.creation.box(numbers["size"])
    if element.tag == "sphere":
        return trimesh.creation.icosphere(4, float(numbers["radius"][0]))
    if element.tag == "cylinder":
        return trimesh.creation.cylinder(float(numbers["radius"][0]), float(numbers["length"][0]))
    file = element.get("filename", "").removeprefix("package://dh_robotics_ag95_description/")
    path = next(p for p in (folder / file, folder.parent / file) if p.is_file())
    mesh = trimesh.load(path, force="mesh", process=False)
    return mesh.apply_scale(np.array(element.get("scale", "1 1 1").split(), float))


def link_bounds(link: ElementTree.Element, folder: Path) -> np.ndarray | None:
    """(2, 3) bounds of all of a URDF link's shapes in its frame."""
    points = []
    for geom in (*link.findall("visual"), *link.findall("collision")):
        T = np.eye(4)
        if (origin := geom.find("origin")) is not None:
            T[:3, :3] = Rotation.from_euler("xyz", np.array(origin.get("rpy", "0 0 0").split(), float)).as_matrix()
            T[:3, 3] = np.array(origin.get("xyz", "0 0 0").split(), float)
        mesh = shape(geom.find("geometry"), folder)
        points.append(trimesh.transform_points(mesh.vertices[np.unique(mesh.faces)], T))
    return np.stack([np.concatenate(points).min(0), np.concatenate(points).max(0)]) if points else None


@needs_shared
@pytest.mark.parametrize("name", THIRD_PARTY)
def test_links_of_third_party_robots_have_the_extents_of_their_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setenv(PACKAGE_PATH, str(ROBOTS))
    path = ROBOTS / name
    links = ElementTree.parse(path).getroot().findall("link")
    file = tmp_path / "robot.yaml"
    if name.startswith(("so101", "unitree", "xarm")):
        arm = {"name": "Robot", "description": str(path), "mount_body": links[-1].get("name"), "home": {}}
        file.write_text(yaml.safe_dump(arm))
        robot = build_embodiment(load_spec(ArmSpec, file), None)
    else:
        file.write_text(yaml.safe_dump({"name": "Robot", "description": str(path), "pads": []}))
        robot = build_embodiment(None, load_spec(EndEffectorSpec, file))
    compared = 0
    for link in links:
        expected = link_bounds(link, path.parent)
        if expected is not None:
            body = robot.body_id(link.get("name", "")) if link.get("name") != "world" else 0
            mesh = link_mesh(robot.model, np.flatnonzero(robot.model.geom_bodyid == body))
            np.testing.assert_allclose(mesh.bounds, expected, atol=1e-3, err_msg=link.get("name", ""))
            compared += 1
    assert compared >= 3


@needs_shared
def test_the_mjcf_of_an_so101_is_what_mujoco_makes_of_it() -> None:
    path = ROBOTS / "so101/so101_new_calib.xml"
    theirs = mujoco.MjModel.from_xml_path(str(path))
    ours = build_embodiment(ArmSpec("SO101", str(path), "gripper", {}), None).model
    for name in (
        "body_pos",
        "body_mass",
        "body_inertia",
        "geom_pos",
        "geom_quat",
        "geom_size",
        "mesh_vert",
        "jnt_range",
    ):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name), err_msg=name)


@pytest.mark.parametrize("name", [*ARMS, *END_EFFECTORS])
def test_what_ships_is_what_mujoco_makes_of_it(name: str) -> None:
    """Reading files ourselves changes no mesh, mass or inertia of those that MuJoCo reads right."""
    import robosuite

    spec = load_arm(name) if name in ARMS else load_end_effector(name)
    path = Path(robosuite.__path__[0]) / spec.description.removeprefix("package://robosuite/")
    parsed = mujoco.MjSpec.from_file(str(path))
    if spec.angle:
        parsed.compiler.degree = spec.angle == "degree"
    parsed.compiler.inertiagrouprange = spec.inertia_groups
    theirs = parsed.compile()
    ours = build_embodiment(spec, None) if isinstance(spec, ArmSpec) else build_embodiment(None, spec)
    prefix = "" if isinstance(spec, ArmSpec) else "ee/"
    for mesh in range(theirs.nmesh):
        mine = ours.model.mesh(prefix + theirs.mesh(mesh).name).id
        one, other = (
            model.mesh_vert[model.mesh_vertadr[i] :][: model.mesh_vertnum[i]]
            for model, i in ((theirs, mesh), (ours.model, mine))
        )
        np.testing.assert_array_equal(one, other)
    heavy = name == "FourierRight"  # whose YAML changes masses
    for body in range(1, theirs.nbody):
        if mine := theirs.body(body).name:
            found = ours.model.body(prefix + mine)
            np.testing.assert_array_equal(
                found.inertia[0] * 0 if heavy else found.inertia, theirs.body(body).inertia * (not heavy)
            )
            assert heavy or found.mass == theirs.body(body).mass


# -- folders and packages ------------------------------------------------------------------------------------


@needs_shared
def test_urdf_beside_meshes_with_a_yaml_above() -> None:
    assert np.isfinite(extents(case("updir"), "finger", visual=True)).all()


@pytest.mark.parametrize("where", ["", "urdf", "config"])
@pytest.mark.parametrize("uri", ["../meshes/m.stl", "package://my_robot/meshes/m.stl", "model://my_robot/meshes/m.stl"])
def test_a_package_may_lie_anywhere_and_be_called_anything(tmp_path: Path, where: str, uri: str) -> None:
    package = tmp_path / "renamed-main"
    write_box(package / "meshes/m.stl", (0.1, 0.1, 0.1))
    (package / "package.xml").write_text('<?xml version="1.0"?><package format="3"><name> my_robot </name></package>')
    (package / "urdf").mkdir()
    (package / "urdf/robot.urdf").write_text(finger_urdf(mesh_tag(uri)))
    file = package / where / "hand.yaml"
    file.parent.mkdir(exist_ok=True)
    description = {"": "urdf/robot.urdf", "urdf": "robot.urdf", "config": "../urdf/robot.urdf"}[where]
    file.write_text(yaml.safe_dump({"name": "Hand", "description": description, "pads": []}))
    hand = build_embodiment(None, load_spec(EndEffectorSpec, file))
    np.testing.assert_allclose(np.ptp(extents(hand, "finger"), axis=0), [0.1] * 3, atol=1e-6)


def test_urdf_beside_meshes_is_a_package_without_a_package_xml(tmp_path: Path) -> None:
    write_box(tmp_path / "my_robot/meshes/m.stl", (0.1, 0.1, 0.1))
    for uri in ("../meshes/m.stl", "package://my_robot/meshes/m.stl"):
        hand_of(tmp_path / "my_robot/urdf/robot.urdf", finger_urdf(mesh_tag(uri)))
    write_box(tmp_path / "secret/m.stl", (0.1, 0.1, 0.1))
    for uri in ("../../secret/m.stl", "package://my_robot/../secret/m.stl"):
        text = finger_urdf(mesh_tag(uri))
        message = refusal(lambda text=text: hand_of(tmp_path / "my_robot/urdf/robot.urdf", text))
        assert "points outside its folder 'my_robot'" in message


@pytest.mark.parametrize("how", ["yaml", "option", "environment"])
def test_a_package_of_the_package_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: str) -> None:
    monkeypatch.setenv(PACKAGE_PATH, "")
    write_box(tmp_path / "ws/group/arm_meshes-1.0/m.stl", (0.1, 0.2, 0.3))
    (tmp_path / "ws/group/arm_meshes-1.0/package.xml").write_text("<package><name>arm_meshes</name></package>")
    (tmp_path / "ws/tool_meshes").mkdir()
    shutil.copy(tmp_path / "ws/group/arm_meshes-1.0/m.stl", tmp_path / "ws/tool_meshes/m.stl")
    below = tmp_path if how == "yaml" else tmp_path / "elsewhere"
    geoms = mesh_tag("package://arm_meshes/m.stl", "visual") + mesh_tag("package://tool_meshes/m.stl")
    (below / "robot").mkdir(parents=True)
    (below / "robot/robot.urdf").write_text(finger_urdf(geoms))
    file = below / "hand.yaml"
    fields = {"package_path": ["ws"]} if how == "yaml" else {}
    file.write_text(
        yaml.safe_dump({"name": "Hand", "description": "robot/robot.urdf", "pads": [{"body": "finger"}]} | fields)
        + "closed: {j: 1.0}\n"
    )
    out = tmp_path / "out.png"
    if how == "environment":
        monkeypatch.setenv(PACKAGE_PATH, f"{tmp_path / 'ws'}")
    option = [f"--package_path={tmp_path / 'elsewhere'}:{tmp_path / 'ws'}"] if how == "option" else []
    if how == "option":
        message = refusal(lambda: build_embodiment(None, load_spec(EndEffectorSpec, file)))
        assert "no enclosing folder is named 'arm_meshes'" in message
        assert "--package_path" in message
    pads.main([f"--end_effector={file}", f"--output={out}", *option])
    assert out.exists() or how != "option"
    hand = build_embodiment(None, load_spec(EndEffectorSpec, file))
    for visual in (True, False):
        np.testing.assert_allclose(np.ptp(extents(hand, "finger", visual), axis=0), [0.1, 0.2, 0.3], atol=1e-6)


def test_a_yaml_trusts_no_folder_but_its_own(tmp_path: Path) -> None:
    message = refusal(lambda: hand_of(tmp_path / "a/hand.urdf", finger_urdf(""), package_path=[".."]))
    assert "package_path: '..' is not below the YAML's own folder" in message
    assert "unknown field `folder`" in refusal(lambda: hand_of(tmp_path / "a/hand.urdf", finger_urdf(""), folder="/"))
    with pytest.raises(CEIError, match="--package_path: no such folder: nowhere"):
        use_package_path(["nowhere"])


def test_includes_are_found_as_mujoco_finds_them(tmp_path: Path) -> None:
    """Relative to the main file, else to the including one; meshes likewise."""
    write_box(tmp_path / "parts/m.stl", (0.1, 0.1, 0.1))
    (tmp_path / "parts/assets.xml").write_text('<mujoco><asset><mesh file="m.stl"/></asset></mujoco>')
    (tmp_path / "parts/all.xml").write_text(
        '<mujoco><include file="assets.xml"/><worldbody><body name="palm"><include file="finger.xml"/></body></worldbody></mujoco>'
    )
    body = '<x><body name="{}"><joint name="j" range="0 90"/><geom type="mesh" mesh="m"/></body></x>'
    (tmp_path / "parts/finger.xml").write_text(body.format("beside"))
    path = tmp_path / "hand.xml"
    path.write_text('<mujoco><include file="parts/all.xml"/></mujoco>')
    for expected in ("beside", "main"):
        theirs = mujoco.MjModel.from_xml_path(str(path))
        hand = hand_of(path)
        assert [name.removeprefix("ee/") for name in hand.body_names] == ["world", "palm", expected]
        assert [theirs.body(i).name for i in range(3)] == ["world", "palm", expected]
        np.testing.assert_array_equal(hand.model.mesh_vert, theirs.mesh_vert)
        (tmp_path / "finger.xml").write_text(body.format("main"))


@needs_shared
def test_what_other_programs_write_into_a_urdf_is_not_read() -> None:
    assert case("prefix").joint_names == ("j",)


@needs_shared
def test_a_xacro_whose_property_is_missing_is_refused() -> None:
    assert "${mass}: 'mass' is not defined" in refusal(lambda: case("xacro"))


# -- joints that follow others -------------------------------------------------------------------------------

HAND = """<mujoco><compiler angle="radian"/><worldbody><body name="palm"><geom size=".02"/>
<body name="a"><joint name="a" range="-1 1" ref="{ref}"/><geom size=".01"/></body>
<body name="b"><joint name="b" range="-2 2"/><geom size=".01"/></body>
<body name="c"><joint name="c" range="-2 2"/><geom size=".01"/></body></body></worldbody>{more}</mujoco>"""
TENDONS = """<tendon><fixed name="ab"><joint joint="a" coef="{a}"/><joint joint="b" coef="{b}"/></fixed>
<fixed name="c"><joint joint="c" coef="2"/></fixed></tendon>"""


def tied(tmp_path: Path, more: str, ref: float = 0.0, **fields) -> Embodiment:
    return hand_of(tmp_path / "hand.xml", HAND.format(ref=ref, more=more), **fields)


def residual(embodiment: Embodiment, u: np.ndarray) -> float:
    """Largest violation of a model's equalities with joints as coupled, by MuJoCo."""
    model, data = embodiment.model, mujoco.MjData(embodiment.model)
    data.qpos[:] = embodiment.coupled.expand(u)
    mujoco.mj_fwdPosition(model, data)
    rows = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
    assert rows.any()
    return float(np.abs(data.efc_pos[rows]).max())


@needs_shared
def test_a_tendon_couples_fingers() -> None:
    hand = case("tendon")
    np.testing.assert_array_equal(hand.coupled.A, [[1], [-1]])
    np.testing.assert_allclose(hand.closed, [0.05, -0.05])
    assert hand.notes == ()


@pytest.mark.parametrize(
    "more",
    [
        TENDONS.format(a=1, b=1) + '<equality><tendon tendon1="ab"/></equality>',
        TENDONS.format(a=0.5, b=-2) + '<equality><tendon tendon1="ab" polycoef="0.1 0 0 0 0"/></equality>',
        TENDONS.format(a=0, b=1) + '<equality><tendon tendon1="ab" tendon2="c" polycoef="0.1 0.4 0 0 0"/></equality>',
        '<equality><joint joint1="b" joint2="a" polycoef="0.2 -0.5 0 0 0"/></equality>',
        TENDONS.format(a=1, b=1)
        + '<equality><joint joint1="b" joint2="a" polycoef="0 -1 0 0 0"/><tendon tendon1="ab"/></equality>',
    ],
    ids=["sum", "weights and offset", "two tendons", "joints", "said twice"],
)
@pytest.mark.parametrize("ref", [0.0, 0.3])
def test_couplings_are_what_mujocos_equalities_say(tmp_path: Path, more: str, ref: float) -> None:
    hand = tied(tmp_path, more, ref)
    assert len(hand.coupled.independent) == 2
    lower, upper = hand.independent_limits
    for u in np.random.default_rng(0).uniform(lower, upper, (5, 2)):
        assert residual(hand, u) < 1e-9


def test_the_joint_that_is_driven_leads(tmp_path: Path) -> None:
    more = TENDONS.format(a=1, b=1) + '<equality><tendon tendon1="ab"/></equality>'
    for driven in ("a", "b"):
        hand = tied(tmp_path, more + f'<actuator><position joint="{driven}" ctrlrange="-1 1"/></actuator>')
        assert [hand.joint_names[i] for i in hand.coupled.independent] == [driven, "c"]


def test_the_yaml_says_otherwise(tmp_path: Path) -> None:
    more = TENDONS.format(a=1, b=1) + '<equality><tendon tendon1="ab"/></equality>'
    hand = tied(tmp_path, more, couplings={"a": {"joint": "c", "scale": 0.25}, "b": {"joint": "c", "scale": -0.25}})
    np.testing.assert_array_equal(hand.coupled.A, [[0.25], [-0.25], [1]])
    curved = '<equality><joint joint1="b" joint2="a" polycoef="0 0 1 0 0"/></equality>'
    assert "is not linear" in refusal(lambda: tied(tmp_path, curved))
    assert len(tied(tmp_path, curved, couplings={"b": {"joint": "a"}}).coupled.independent) == 2


def test_a_tendon_that_holds_nothing_is_said(tmp_path: Path) -> None:
    hand = tied(tmp_path, TENDONS.format(a=1, b=1) + '<actuator><position tendon="ab" ctrlrange="0 1"/></actuator>')
    assert len(hand.coupled.independent) == 3
    (note,) = hand.notes
    assert "tendon 'ab' over a, b is not kept" in note


FOUR_BAR = """<mujoco><compiler angle="radian"/><worldbody><body name="palm"><geom size=".01"/>
<body name="crank" pos="0 0 0"><joint name="crank" axis="0 1 0" range="-1 1"/><geom size=".005"/>
  <body name="rod" pos="0 0 0.1"><joint name="rod" axis="0 1 0" range="-2 2"/><geom size=".005"/></body></body>
<body name="rocker" pos="0.05 0 0"><joint name="rocker" axis="0 1 0" range="-2 2"/><geom size=".005"/></body>
</body></worldbody><equality><connect body1="rod" body2="rocker" anchor="0.05 0 0"/></equality></mujoco>"""


def test_a_loop_stays_closed_or_is_refused(tmp_path: Path) -> None:
    """A parallelogram: the rocker turns as the crank does, the rod the other way."""
    right = {"rod": {"joint": "crank", "scale": -1}, "rocker": {"joint": "crank"}}
    hand = hand_of(tmp_path / "hand.xml", FOUR_BAR, closed={"crank": 0.8}, couplings=right)
    assert hand.coupled.A.T.tolist() == [[1, -1, 1]]
    message = refusal(lambda: hand_of(tmp_path / "hand.xml", FOUR_BAR, closed={"crank": 0.8}))
    assert "links 'rod' and 'rocker' are joined to a loop, which is" in message
    assert "`couplings`" in message
    wrong = {"rod": {"joint": "crank"}, "rocker": {"joint": "crank"}}
    assert "mm open at" in refusal(
        lambda: hand_of(tmp_path / "hand.xml", FOUR_BAR, closed={"crank": 0.8}, couplings=wrong)
    )


def test_joints_that_a_coupling_leaves_no_room_are_refused(tmp_path: Path) -> None:
    more = '<equality><joint joint1="b" joint2="a" polycoef="2 1 0 0 0"/></equality>'
    couplings = {"b": {"joint": "a", "offset": 5}}
    message = refusal(lambda: tied(tmp_path, more, couplings=couplings))
    assert "the limits of a, b, which follow each other, leave no position for a" in message
    notes = tied(tmp_path, more, couplings={"b": {"joint": "a", "offset": 3}}).notes
    assert "leave a no room to move" in notes[0]


def test_an_arm_has_couplings_and_an_angle_too(tmp_path: Path) -> None:
    path = tmp_path / "arm.xml"
    path.write_text(HAND.format(ref=0, more="").replace(' angle="radian"', ""))
    arm = ArmSpec("Arm", str(path), "a", {}, angle="radian", couplings={"b": Coupling("a", -1)})
    built = build_embodiment(arm, None)
    assert [built.joint_names[i] for i in built.coupled.independent] == ["a", "c"]
    np.testing.assert_allclose(built.upper, [1, 2, 2])
    assert built.notes == ()


def test_joints_that_are_held_take_their_tendons_with_them(tmp_path: Path) -> None:
    path = tmp_path / "arm.xml"
    path.write_text(HAND.format(ref=0, more=TENDONS.format(a=1, b=1) + '<equality><tendon tendon1="ab"/></equality>'))
    arm = build_embodiment(ArmSpec("Arm", str(path), "c", {}, joints=["a", "c"]), None)
    assert arm.joint_names == ("a", "c")
    assert len(arm.coupled.independent) == 2


@needs_shared
def test_one_file_may_describe_arm_and_hand() -> None:
    path = str(ROBOTS / "so101/so101_new_calib.urdf")
    joints = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"]
    arm = ArmSpec("SO101", path, "gripper_link", {}, joints=joints)
    jaw = EndEffectorSpec("Jaw", path, pads=[], root_body="moving_jaw_so101_v1_link")
    robot = build_embodiment(arm, jaw)
    assert robot.joint_names == (*joints, "gripper")
    assert sum("moving_jaw" in name for name in robot.body_names) == 1
    whole = build_embodiment(ArmSpec("SO101", path, "gripper_link", {}), None)
    qpos = np.random.default_rng(0).uniform(-0.1, 0.1, 6)
    poses = []
    for each, link in ((robot, "moving_jaw_so101_v1_link"), (whole, "moving_jaw_so101_v1_link")):
        data = mujoco.MjData(each.model)
        data.qpos[:] = qpos[[whole.joint_names.index(name) for name in each.joint_names]]
        mujoco.mj_kinematics(each.model, data)
        poses.append(data.xpos[each.body_id(link)].copy())
    np.testing.assert_allclose(poses[0], poses[1], atol=1e-12)


# -- limits, units, poses ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "limit", "expected", "said"),
    [
        ("revolute", '<limit lower="-1" upper="1"/>', (-1, 1), ""),
        ("revolute", '<limit upper="1"/>', (0, 1), ""),
        ("revolute", '<limit lower="-1"/>', (-1, 0), ""),
        ("revolute", '<limit effort="1"/>', (-2 * np.pi, 2 * np.pi), "has no limits"),
        ("revolute", "", (-2 * np.pi, 2 * np.pi), "has no limits"),
        ("revolute", '<limit lower="-1e16" upper="1e16"/>', (-2 * np.pi, 2 * np.pi), "has no limits"),
        ("continuous", "", (-2 * np.pi, 2 * np.pi), ""),
        ("continuous", '<limit lower="-1e16" upper="1e16"/>', (-2 * np.pi, 2 * np.pi), ""),
        (
            "continuous",
            '<limit lower="-1" upper="1"/>',
            (-2 * np.pi, 2 * np.pi),
            "its limits of -1 to 1 rad do not hold",
        ),
        ("prismatic", '<limit upper="0.1"/>', (0, 0.1), ""),
        ("revolute", '<limit lower="-90" upper="90"/>', (-90, 90), "are these degrees?"),
        ("prismatic", '<limit lower="0" upper="40"/>', (0, 40), "are these millimetres?"),
        (
            "revolute",
            '<limit lower="-1" upper="1"/><safety_controller soft_lower_limit="-0.9" soft_upper_limit="0.8" k_velocity="1"/>',
            (-1, 1),
            "<safety_controller> keeps to -0.9 to 0.8 rad",
        ),
    ],
)
def test_limits_of_a_urdf(tmp_path: Path, kind: str, limit: str, expected: tuple[float, float], said: str) -> None:
    box = '<collision><geometry><box size="0.01 0.01 0.01"/></geometry></collision>'
    hand = hand_of(tmp_path / "hand.urdf", finger_urdf(box, limit, kind))
    np.testing.assert_allclose([hand.lower[0], hand.upper[0]], expected)
    assert len(hand.notes) == bool(said)
    assert said in "".join(hand.notes)
    assert all("'j'" in note for note in hand.notes)


@pytest.mark.parametrize(
    ("servo", "expected"),
    [
        ('<position joint="j" ctrlrange="-1 1"/>', (-1, 1)),
        ('<position joint="j" ctrlrange="-1 1" gear="2"/>', (-0.5, 0.5)),
        ('<position joint="j" ctrlrange="-1 0.5" gear="-1"/>', (-0.5, 1)),
        (
            '<general joint="j" ctrlrange="-1 1" ctrllimited="true" gainprm="3" biastype="affine" biasprm="0 -2 0"/>',
            (-1.5, 1.5),
        ),
        ('<motor joint="j" ctrlrange="-1 1"/>', (-2, 2)),
        ('<velocity joint="j" ctrlrange="-1 1"/>', (-2, 2)),
    ],
)
def test_a_servo_goes_no_farther_than_it_can_be_told(tmp_path: Path, servo: str, expected: tuple[float, float]) -> None:
    hand = hand_of(
        tmp_path / "hand.xml",
        f"""<mujoco><compiler angle="radian"/><worldbody><body name="palm"><body name="f"><joint name="j" range="-2 2"/>
        <geom size=".01"/></body></body></worldbody><actuator>{servo}</actuator></mujoco>""",
    )
    np.testing.assert_allclose([hand.lower[0], hand.upper[0]], expected)


@needs_shared
def test_a_range_that_looks_like_radians_is_said() -> None:
    (note,) = case("degrees").notes
    assert "no hinge turns by more than 1.5 degrees" in note
    assert "`angle: radian`" in note


def test_a_pose_that_is_in_another_unit_is_refused_with_what_looks_wrong(tmp_path: Path) -> None:
    text = HAND.format(ref=0, more="").replace(' angle="radian"', "")
    message = refusal(lambda: hand_of(tmp_path / "hand.xml", text, closed={"b": 1.0}))
    assert "closed puts b at 1, outside [-0.03491, 0.03491] rad" in message
    assert "`angle: radian`" in message
    assert hand_of(tmp_path / "hand.xml", text, closed={"b": 1.0}, angle="radian").notes == ()


@needs_shared
def test_a_home_that_nobody_gave_is_inside_the_limits() -> None:
    hand = case("home_limits")
    np.testing.assert_array_equal(hand.home, [0.26])
    np.testing.assert_array_equal(hand.closed, [1.0])
    assert hand.notes == (
        "hand: no `home` is given for 'j', and 0 is outside its range of 0.26 to 1.4 rad; it rests at 0.26.",
    )


def test_a_home_that_was_given_is_not_moved(tmp_path: Path) -> None:
    limit = '<limit lower="0.26" upper="1.4"/>'
    message = refusal(lambda: hand_of(tmp_path / "hand.urdf", finger_urdf("", limit), home={"j": 0.0}))
    assert "home puts j at 0, outside [0.26, 1.4] rad" in message


# -- links, geoms, mass --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "inertial", ["", '<inertial><mass value="0"/><inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial>']
)
def test_a_link_without_mass_has_that_of_water_in_what_touches_and_it_is_said(tmp_path: Path, inertial: str) -> None:
    box, larger = (f'<geometry><box size="{size}"/></geometry>' for size in ("0.1 0.1 0.2", "0.3 0.3 0.3"))
    (tmp_path / "arm.urdf").write_text(
        f"""<robot name="r"><link name="base"><visual>{larger}</visual></link>
        <link name="moved">{inertial}<visual>{larger}</visual><collision>{box}</collision></link>
        <link name="seen">{inertial}<visual>{box}</visual></link>
        <joint name="j" type="revolute"><parent link="base"/><child link="moved"/><limit lower="-1" upper="1"/></joint>
        <joint name="k" type="revolute"><parent link="moved"/><child link="seen"/><limit lower="-1" upper="1"/></joint></robot>"""
    )
    arm = build_embodiment(ArmSpec("Arm", str(tmp_path / "arm.urdf"), "seen", {}), None)
    assert [arm.model.body_mass[arm.body_id(name)] for name in ("moved", "seen")] == pytest.approx([2.0, 2.0])
    assert arm.notes == ("Arm: no mass is given for 'moved', 'seen'; it is that of water in their shapes.",)


@needs_shared
def test_a_frame_without_mass_may_move() -> None:
    hand = case("massless")
    assert hand.joint_names == ("j", "jt")
    assert hand.model.body_mass[hand.body_id("tip")] < 1e-5
    assert hand.notes == ("hand: link 'tip' has no mass; it gets next to none.",)


def test_an_inertia_that_no_body_has_is_mended_and_said(tmp_path: Path) -> None:
    text = finger_urdf("").replace('ixx="1" iyy="1"', 'ixx="1" iyy="-0.1"')
    hand = hand_of(tmp_path / "hand.urdf", text)
    assert hand.notes == ("Hand: no body has the inertia of 'palm', 'finger'; the nearest possible one is taken.",)
    assert (hand.model.body_inertia[hand.body_id("finger")] > 0).all()


@needs_shared
def test_geoms_without_names_go_by_link_and_number(tmp_path: Path) -> None:
    shutil.copy(CASES / "unnamed/robot.xml", tmp_path / "robot.xml")
    for geom, z in [("finger.0", (-0.01, 0.01)), ("finger.1", (0.02, 0.08))]:
        hand = hand_of(tmp_path / "robot.xml", closed={"j": 0.1}, pads=[{"body": "finger", "geoms": [geom]}])
        points = sample_representation(hand, 64).points_link
        assert z[0] <= points[:, 2].min() < points[:, 2].max() <= z[1]
    message = refusal(lambda: sample_representation(case("unnamed")))
    assert message.endswith("Valid: finger.0, finger.1.")


def test_a_urdfs_geoms_have_names_of_their_own(tmp_path: Path) -> None:
    box = '<{} name="same"><geometry><box size="0.01 0.01 {}"/></geometry></{}>'
    geoms = box.format("visual", 0.01, "visual") + box.format("collision", 0.02, "collision")
    own = '<collision name="own"><geometry><box size="0.01 0.01 0.03"/></geometry></collision>'
    more = '<collision><geometry><box size="0.01 0.01 0.04"/></geometry></collision>'
    model = hand_of(tmp_path / "hand.urdf", finger_urdf(geoms + own + more)).model
    sizes = {model.geom(i).name: round(2 * model.geom_size[i, 2], 3) for i in range(model.ngeom)}
    assert sizes == {"ee/finger.0": 0.01, "ee/finger.1": 0.02, "ee/own": 0.03, "ee/finger.3": 0.04}


def contacts(model: mujoco.MjModel) -> set[frozenset[str]]:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return {frozenset(model.body(model.geom_bodyid[g]).name for g in pair) for pair in data.contact.geom}


@needs_shared
def test_a_base_does_not_touch_the_link_on_its_joint() -> None:
    path = CASES / "adjacent_base/arms/a.yaml"
    assert contacts(build_embodiment(load_spec(ArmSpec, path), None).model) == set()


def test_a_base_of_several_links_still_touches_those_farther_on(tmp_path: Path) -> None:
    """As MuJoCo has it where the same links hang on one that moves."""
    ball = '<geom size=".1"/>'
    links = f"""<body name="base">{ball}<body name="cover">{ball}</body><body name="mount">
      <body name="one"><joint name="one"/>{ball}<body name="fixed to one">{ball}</body>
        <body name="two"><joint name="two" axis="0 1 0"/>{ball}</body></body></body></body>"""
    path = tmp_path / "arm.xml"
    path.write_text(f'<mujoco><compiler angle="radian"/><worldbody>{links}</worldbody></mujoco>')
    ours = contacts(build_embodiment(ArmSpec("Arm", str(path), "two", {}), None).model)
    moving = f'<mujoco><worldbody><body name="car"><freejoint/>{ball}{links}</body></worldbody></mujoco>'
    theirs = {pair for pair in contacts(mujoco.MjModel.from_xml_string(moving)) if "car" not in pair}
    assert ours == theirs == {frozenset(("base", "two")), frozenset(("cover", "two"))}


def test_a_torso_whose_joint_is_held_is_no_part_of_the_base(tmp_path: Path) -> None:
    ball = '<geom size=".1"/>'
    path = tmp_path / "arm.xml"
    path.write_text(
        f"""<mujoco><compiler angle="radian"/><worldbody><body name="legs">{ball}<body name="torso"><joint name="waist"/>{ball}
        <body name="arm"><joint name="shoulder"/>{ball}</body></body></body></worldbody></mujoco>"""
    )
    arm = build_embodiment(ArmSpec("Arm", str(path), "arm", {}, joints=["shoulder"]), None)
    assert contacts(arm.model) == {frozenset(("legs", "arm"))}


def test_floors_and_what_hangs_elsewhere_are_left_out_and_said(tmp_path: Path) -> None:
    hand = hand_of(
        tmp_path / "hand.xml",
        """<mujoco><compiler angle="radian"/><default><default class="floor"><geom type="plane" size="1 1 1"/></default></default>
        <worldbody><geom name="floor" class="floor"/><geom name="table" size="0.1"/><body name="palm"><body name="f">
        <joint name="j" range="0 1"/><geom size=".01"/></body></body><body name="cube"><freejoint/><geom size=".01"/></body>
        </worldbody></mujoco>""",
    )
    assert [name.removeprefix("ee/") for name in hand.body_names] == ["world", "palm", "f"]
    assert hand.notes == (
        "Hand: plane 'floor' is left out: it is no part of a robot.",
        "Hand: link 'cube', geom 'table' do not hang on 'palm', the first link, and are left out.",
    )


FREE = """<mujoco><compiler angle="radian"/><worldbody><body name="palm">{free}<geom size=".02"/>
<body name="f"><joint name="j" range="0 1"/><geom size=".01"/></body></body></worldbody>{more}</mujoco>"""
FLOATING = f"""<robot name="r"><link name="world"/><link name="palm">{INERTIAL}</link><link name="f">{INERTIAL}</link>
<joint name="base" type="floating"><parent link="world"/><child link="palm"/></joint>
<joint name="j" type="revolute"><parent link="palm"/><child link="f"/><axis xyz="0 0 1"/>{LIMIT}</joint></robot>"""


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("hand.xml", FREE.format(free="<freejoint/>", more="")),
        (
            "hand.xml",
            FREE.format(
                free='<joint name="free" type="free"/>',
                more='<actuator><motor joint="free" gear="1 0 0 0 0 0"/></actuator>'
                '<equality><weld body1="palm" name="held"/></equality>',
            ),
        ),
        ("hand.urdf", FLOATING),
    ],
)
def test_a_base_that_floats_stands_still_and_it_is_said(tmp_path: Path, name: str, text: str) -> None:
    hand = hand_of(tmp_path / name, text)
    arm = build_embodiment(ArmSpec("Arm", str(tmp_path / name), "f", {}), None)
    both = build_embodiment(load_arm("Panda"), load_spec(EndEffectorSpec, tmp_path / "hand.yaml"))
    for built in (hand, arm, both):
        assert built.joint_names[-1] == "j" and "free" not in built.joint_names
        assert any("the free joint of link 'palm' is left out" in note for note in built.notes)
    assert (len(hand.joint_names), len(arm.joint_names), len(both.joint_names)) == (1, 1, 8)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        (
            "tool.xml",
            '<mujoco><worldbody><body name="tool"><body name="tcp" pos="0 0 0.1"/></body></worldbody></mujoco>',
        ),
        ("tool.urdf", '<robot name="r"><link name="tool"/></robot>'),
        (
            "tool.urdf",
            '<robot name="r"><link name="tool"><visual><geometry><sphere radius="0.1"/></geometry></visual></link></robot>',
        ),
    ],
)
def test_a_tool_without_inertia_is_one_and_it_is_said(tmp_path: Path, name: str, text: str) -> None:
    tool = hand_of(tmp_path / name, text)
    held = build_embodiment(load_arm("Panda"), load_spec(EndEffectorSpec, tmp_path / "hand.yaml"))
    for built in (tool, held):
        assert any("weighs nothing" in note for note in built.notes)
    assert len(held.joint_names) == 7
    weighed = hand_of(tmp_path / "heavy.urdf", f'<robot name="r"><link name="tool">{INERTIAL}</link></robot>')
    assert not any("weighs nothing" in note for note in weighed.notes)


MIMICKED = f"""<robot name="r"><link name="palm">{INERTIAL}</link><link name="crank">{INERTIAL}</link><link name="rocker">{INERTIAL}</link>
<link name="coupler">{INERTIAL}</link>
<joint name="a" type="revolute"><parent link="palm"/><child link="crank"/><axis xyz="0 0 1"/>{LIMIT}</joint>
<joint name="c" type="revolute"><parent link="palm"/><child link="rocker"/><origin xyz="0.03 0 0"/><axis xyz="0 0 1"/>{LIMIT}
<mimic joint="a"/></joint>
<joint name="b" type="revolute"><parent link="crank"/><child link="coupler"/><origin xyz="0 0.05 0"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="0" effort="1" velocity="1"/><mimic joint="a" multiplier="-1"/></joint>{{}}</robot>"""


def test_a_loop_that_mimics_keep_closed_stays_closed(tmp_path: Path) -> None:
    """A parallelogram: the coupler's end, 30 mm along it, is the rocker's, 50 mm along that."""
    hand = hand_of(tmp_path / "hand.urdf", MIMICKED.format(""))
    assert [hand.joint_names[q] for q in hand.coupled.independent] == ["a"]
    data = mujoco.MjData(hand.model)
    for u in (0.0, 0.4, 1.0):
        data.qpos[:] = hand.coupled.expand(np.array([u]))
        mujoco.mj_kinematics(hand.model, data)
        ends = [
            data.xpos[body] + data.xmat[body].reshape(3, 3) @ tip
            for body, tip in ((hand.body_id("coupler"), (0.03, 0, 0)), (hand.body_id("rocker"), (0, 0.05, 0)))
        ]
        np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)


def test_a_loop_that_a_urdf_cannot_have_is_refused_with_the_joints(tmp_path: Path) -> None:
    closing = '<joint name="d" type="fixed"><parent link="rocker"/><child link="coupler"/></joint>'
    message = refusal(lambda: hand_of(tmp_path / "hand.urdf", MIMICKED.format(closing)))
    assert "link 'coupler' hangs on 'b' and 'd'" in message and "<mimic>" in message


# -- what asks for time or memory ----------------------------------------------------------------------------


def test_what_a_simulation_would_set_aside_is_not_read(tmp_path: Path) -> None:
    """Gigabytes by a number, hours for the lengths of muscles, contacts and gravity off: of a simulation, not of a robot."""
    huge = "2000000000"
    simulation = f"""<size nkey="{huge}" nuser_body="{huge}" nuser_geom="{huge}" nuserdata="{huge}" njmax="{huge}" nconmax="{huge}"
      memory="900G"/><visual><global offwidth="{huge}" offheight="{huge}"/><quality shadowsize="{huge}" numquads="{huge}"/></visual>
      <option sdf_iterations="{huge}" gravity="0 0 0"><flag contact="disable"/></option><statistic extent="1e9"/>
      <custom><numeric name="x" size="{huge}" data="1"/></custom><keyframe><key qpos="1 2 3 4 5"/></keyframe>
      <sensor><jointpos joint="j" nsample="{huge}" interval="1"/></sensor>
      <actuator><motor joint="j" nsample="{huge}" delay="1"/><muscle joint="j"/>{MUSCLE * 500}</actuator>"""
    path = tmp_path / "arm.xml"
    path.write_text(
        f"""<mujoco><compiler angle="radian"><lengthrange inttotal="1e9" timestep="1e-9" mode="all"/></compiler>{simulation}
        <worldbody><body name="base"><geom size=".1" user="1 2"/><body name="f"><joint name="j" range="0 1"/><body name="g"><joint
        name="k" range="0 1"/><geom size=".1"/></body></body></body></worldbody></mujoco>"""
    )
    start = time.perf_counter()
    arm = build_embodiment(ArmSpec("Arm", str(path), "g", {}), None)
    assert time.perf_counter() - start < 10
    assert arm.notes == ("Arm: link 'f' has no mass; it gets next to none.",)
    model = arm.model
    assert (model.nkey, model.nsensor, model.nuser_body, model.nhistory) == (0, 0, 0, 0)
    np.testing.assert_array_equal(model.opt.gravity, [0, 0, -9.81])
    assert contacts(model) == {frozenset(("base", "g"))}


MUSCLE = """<general joint="j" gaintype="muscle" biastype="muscle" dyntype="muscle" gainprm="0.75 1.05 1000 200 0.5 1.6 1.5 1.3 1.2"
biasprm="0.75 1.05 1000 200 0.5 1.6 1.5 1.3 1.2"/>"""


def test_a_fine_collision_mesh_takes_no_minute(tmp_path: Path) -> None:
    """Its convex hull of 40,000 vertices, which took MuJoCo some ten seconds, is bounded, and as large."""
    trimesh.creation.icosphere(6, 0.1).export(tmp_path / "m.stl")
    hand = hand_of(tmp_path / "hand.urdf", finger_urdf(mesh_tag("m.stl")))
    vertices = hand.model.mesh_graph[0]
    assert vertices == 5000 < hand.model.mesh_vertnum[0]
    hull = hand.model.mesh_vert[hand.model.mesh_graph[2 + vertices :][:vertices]]
    np.testing.assert_allclose(np.ptp(hull, axis=0), [0.2] * 3, atol=2e-4)


def test_triangles_count_as_often_as_they_are_used(tmp_path: Path) -> None:
    trimesh.creation.icosphere(5, 0.1).export(tmp_path / "m.stl")  # 20480 triangles
    for text in (
        finger_urdf(mesh_tag("m.stl", "visual") * 200),
        finger_urdf("".join(mesh_tag("m.stl", "visual", f"1 1 1.{i:03}") for i in range(200))),
    ):
        message = refusal(lambda text=text: hand_of(tmp_path / "hand.urdf", text))
        assert "more than 4000000 triangles" in message
    uses = "".join(f'<mesh name="m{i}" file="m.stl"/>' for i in range(200))
    text = f'<mujoco><asset>{uses}</asset><worldbody><body name="palm"><geom size="0.1"/></body></worldbody></mujoco>'
    assert "more than 4000000 triangles" in refusal(lambda: hand_of(tmp_path / "hand.xml", text))


# -- what is said --------------------------------------------------------------------------------------------


def test_cei_pads_says_what_was_assumed(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    box = '<collision><geometry><box size="0.01 0.01 0.05"/></geometry></collision>'
    (tmp_path / "hand.urdf").write_text(finger_urdf(box.replace("<geometry>", '<origin xyz="0.1 0 0"/><geometry>'), ""))
    hand = {"name": "Hand", "description": "hand.urdf", "closed": {"j": 1.0}, "pads": [{"body": "finger"}]}
    (tmp_path / "hand.YAML").write_text(yaml.safe_dump(hand))
    (tmp_path / "out").mkdir()
    args = [f"--end_effector={tmp_path / 'hand.YAML'}", f"--output={tmp_path / 'out/hand.png'}"]
    assert pads.main([*args, f"--json={tmp_path / 'out/hand.json'}"]) == 0
    note = (
        "Hand: joint 'j' has no limits (none are given, 0 to 0, or endless ones): a whole turn to either side is taken."
    )
    assert f"note: {note}\n" in capsys.readouterr().out
    assert json.loads((tmp_path / "out/hand.json").read_text())["notes"] == [note]


def test_missing_files_name_what_is_there(tmp_path: Path) -> None:
    write_box(tmp_path / "Finger.STL", (0.1, 0.1, 0.1))
    message = refusal(lambda: hand_of(tmp_path / "hand.urdf", finger_urdf(mesh_tag("finger.stl"))))
    assert message == "hand.urdf: no such file: 'finger.stl'. Did you mean 'Finger.STL'?"
    hand = hand_of(tmp_path / "HAND.URDF", finger_urdf(mesh_tag("Finger.STL")))
    np.testing.assert_allclose(np.ptp(extents(hand, "finger"), axis=0), [0.1] * 3, atol=1e-6)
