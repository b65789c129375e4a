"""Xacro: what it stands for, against the package `xacro`; and that a stranger's runs nothing, reads nothing outside and comes to an end."""

import os
import subprocess
import sys
from pathlib import Path
from xml.etree.ElementTree import Element

import pytest
import trimesh
import xacro as reference
import yaml

from cei_gym.embodiment import (
    ArmSpec,
    Embodiment,
    EndEffectorSpec,
    build_embodiment,
    fingerprint,
    load_spec,
    use_package_path,
)
from cei_gym.embodiment.description import load_description
from cei_gym.embodiment.resources import PACKAGE_PATH, Place, locate
from cei_gym.embodiment.xacro import expand
from cei_gym.errors import CEIError
from cei_gym.untrusted_xml import load_xml

NS = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'

HAND = f"""<robot {NS} name="hand">
  <xacro:include filename="$(find my_hand)/urdf/finger.xacro"/>
  <xacro:arg name="fingers" default="2"/>
  <xacro:arg name="length" default="0.05"/>
  <xacro:property name="sizes" value="${{xacro.load_yaml('$(find my_hand)/config/sizes.yaml')}}"/>
  <link name="palm">{INERTIAL}</link>
  <xacro:finger name="left" side="-1" length="$(arg length)" limits="${{sizes['limits']}}">
    <origin xyz="0 ${{sizes.palm.width_m / 2}} 0"/>
  </xacro:finger>
  <xacro:if value="${{$(arg fingers) > 1}}">
    <xacro:finger name="right" side="1" length="${{2 * $(arg length)}}" limits="${{sizes['limits']}}"><origin xyz="0 0 0"/></xacro:finger>
  </xacro:if>
  <gazebo><plugin filename="$(env NOT_READ)"/></gazebo>
</robot>"""
FINGER = f"""<robot {NS}>
  <xacro:macro name="finger" params="name side length limits *origin">
    <link name="${{name}}">{INERTIAL}
      <visual><geometry><mesh filename="file://$(find my_hand)/meshes/finger.stl"/></geometry></visual>
      <collision><geometry><box size="0.01 0.01 ${{length}}"/></geometry></collision></link>
    <joint name="${{name}}_joint" type="revolute"><parent link="palm"/><child link="${{name}}"/>
      <xacro:insert_block name="origin"/><axis xyz="${{side}} 0 0"/>
      <limit lower="0" upper="${{limits['upper']}}" effort="1" velocity="${{limits.speed}}"/></joint>
  </xacro:macro>
</robot>"""
SIZES = "palm: {width_m: 0.08}\nlimits: {upper: !degrees 90, speed: 2}\n"


def write_package(folder: Path, text: str = HAND) -> Path:
    """A ROS package `my_hand` in a folder of another name; returns its xacro."""
    for name, content in {
        "package.xml": "<package><name>my_hand</name></package>",
        "urdf/hand.urdf.xacro": text,
        "urdf/finger.xacro": FINGER,
        "config/sizes.yaml": SIZES,
    }.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(content)
    (folder / "meshes").mkdir()
    trimesh.creation.box((0.01, 0.02, 0.05)).export(folder / "meshes/finger.stl")
    return folder / "urdf/hand.urdf.xacro"


def hand(path: Path, folder: Path | None = None, **fields: object) -> Embodiment:
    """An end-effector by a YAML; `folder` is the YAML's, else the description's."""
    folder = folder or path.parent
    yaml_path = folder / "hand.yaml"
    description = os.path.relpath(path, folder)
    yaml_path.write_text(yaml.safe_dump({"name": "Hand", "description": description, "pads": [], **fields}))
    return build_embodiment(None, load_spec(EndEffectorSpec, yaml_path))


def expanded(path: Path, **arguments: object) -> Element:
    return expand(load_xml(path.read_bytes()), locate(str(path), Path()), arguments)[0]


def expanded_text(tmp_path: Path, inside: str, **arguments: object) -> Element:
    path = tmp_path / "r.urdf.xacro"
    path.write_text(f'<robot {NS} name="r">{inside}</robot>')
    return expanded(path, **arguments)


def plain(tree: Element) -> list:
    """Tags and attributes, for comparisons."""
    attributes = {name: value for name, value in tree.items() if not name.startswith("xmlns:")}
    return [tree.tag, attributes, [plain(child) for child in tree]]


def refusal(tmp_path: Path, inside: str, **arguments: object) -> str:
    with pytest.raises(CEIError) as error:
        expanded_text(tmp_path, inside, **arguments)
    message = str(error.value)
    assert "\n" not in message and len(message) < 500
    return message


# -- what it stands for ------------------------------------------------------------------------------------------------


def test_a_package_of_macros_arguments_includes_and_yaml_is_a_hand(tmp_path: Path) -> None:
    built = hand(write_package(tmp_path / "any_name"))
    assert built.joint_names == ("left_joint", "right_joint")
    assert built.upper == pytest.approx([1.5707963] * 2)
    assert built.max_velocity == pytest.approx([2.0, 2.0])
    assert built.model.body_pos[built.body_id("left")] == pytest.approx([0, 0.04, 0])


def test_arguments_are_the_yamls(tmp_path: Path) -> None:
    path = write_package(tmp_path / "p")
    one = hand(path, xacro_args={"fingers": 1, "length": 0.2})
    assert one.joint_names == ("left_joint",)
    box = next(g for g in range(one.model.ngeom) if one.model.geom_contype[g])
    assert one.model.geom_size[box][2] == pytest.approx(0.1)


def test_an_arms_arguments_too(tmp_path: Path) -> None:
    path = write_package(tmp_path / "p")
    (path.parent / "arm.yaml").write_text(
        yaml.safe_dump(
            {
                "name": "Arm",
                "description": path.name,
                "mount_body": "left",
                "home": {"left_joint": 0.1},
                "xacro_args": {"fingers": 1},
            }
        )
    )
    arm = build_embodiment(load_spec(ArmSpec, path.parent / "arm.yaml"), None)
    assert arm.joint_names == ("left_joint",)


def test_load_description_expands(tmp_path: Path) -> None:
    place = locate(str(write_package(tmp_path / "p")), Path())
    assert len(load_description(place).spec.joints) == 2
    assert len(load_description(place, xacro_args={"fingers": 1}).spec.joints) == 1


def test_arguments_that_come_with_a_place_are_over_defaults_and_under_given_ones(tmp_path: Path) -> None:
    place = locate(str(write_package(tmp_path / "p")), Path())
    place = Place(place.path, place.root, place.packages, {"fingers": "1"})
    assert len(load_description(place).spec.joints) == 1
    assert len(load_description(place, xacro_args={"fingers": 2}).spec.joints) == 2


def test_a_xacro_that_is_called_a_urdf_is_expanded(tmp_path: Path) -> None:
    path = write_package(tmp_path / "p")
    assert hand(path.rename(path.with_name("hand.urdf"))).joint_names == ("left_joint", "right_joint")


def test_what_it_is_does_not_depend_on_where_its_files_lie(tmp_path: Path) -> None:
    first, second = write_package(tmp_path / "a"), write_package(tmp_path / "deep/er/b_longer_name")
    assert fingerprint(hand(first)) == fingerprint(hand(second))
    assert fingerprint(hand(first)) != fingerprint(hand(first, xacro_args={"length": 0.07}))
    assert str(tmp_path) not in str(plain(expanded(second)))


def test_packages_of_the_package_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PACKAGE_PATH, "")
    write_package(tmp_path / "workspace/my_hand")
    path = tmp_path / "elsewhere/robot.urdf.xacro"
    path.parent.mkdir()
    path.write_text(HAND)
    with pytest.raises(CEIError, match=r"package 'my_hand'.*--package_path"):
        hand(path)
    use_package_path([tmp_path / "workspace"])
    assert hand(path).joint_names == ("left_joint", "right_joint")
    known = fingerprint(hand(path))
    (tmp_path / "workspace").rename(tmp_path / "moved")
    use_package_path([tmp_path / "moved/my_hand"])
    assert fingerprint(hand(path)) == known


COMPARED = {
    "properties": """<xacro:property name="a" value="2"/><xacro:property name="b" value="${a * 3}"/><xacro:property name="a" value="5"/>
        <x v="${b}" w="${a}" text="a${a}b" t="$${a} $$(arg a) $5 5$" q="${1 if a > 4 else 0}"/>""",
    "types": """<xacro:property name="i" value="3"/><xacro:property name="f" value="1e-3"/><xacro:property name="s" value="'3'"/>
        <xacro:property name="t" value="true"/><xacro:property name="u" value="1_0"/>
        <x i="${i / 2}" f="${f}" s="${s}" t="${t}" u="${u}" n="${-i}" p="${i ** 2}" m="${7 % i} ${7 // i}"/>""",
    "functions": """<x a="${sin(pi / 6)}" b="${radians(90)}" c="${math.degrees(pi)}" d="${max(1, 2, 3)}" e="${min([3, 1])}" f="${len('abc')}"
        g="${int(2.7)} ${float('2')} ${str(4)} ${bool(0)} ${round(2.567, 2)} ${abs(-2) if False else 2}" h="${atan2(1, 1)} ${hypot(3, 4)}"/>""",
    "logic": """<xacro:property name="a" value="x"/><x v="${a == 'x' and not a == 'y'}" w="${1 &lt; 2 &lt; 3}" u="${'b' in 'abc' or False}"
        i="${[1, 2, 3][-1]} ${dict(a=4)['a']} ${'abcd'[1:3]} ${list((1, 2))[0]} ${{}} "/>""".replace("${{}} ", ""),
    "conditions": """<xacro:property name="on" value="true"/><xacro:if value="${on}"><a/></xacro:if><xacro:unless value="${on}"><b/></xacro:unless>
        <xacro:if value="0"><c/></xacro:if><xacro:if value="1"><d/></xacro:if><xacro:unless value="${'a' == 'b'}"><e/></xacro:unless>
        <xacro:if value="true"><xacro:if value="${not on}"><f/></xacro:if><g/></xacro:if>""",
    "macros": """<xacro:macro name="m" params="a b:=2 c:='x y' d:=${1 + 2} e:=''"><x a="${a}" b="${b}" c="${c}" d="${d}" e="${e}"/></xacro:macro>
        <xacro:m a="1"/><xacro:m a="z" b="${1.5}" c="q" d="" e="k"/>""",
    "forwarded": """<xacro:property name="a" value="7"/><xacro:macro name="m" params="a:=^ b:=^|9 c:=^|'w w'"><x a="${a}" b="${b}" c="${c}"/></xacro:macro>
        <xacro:macro name="n" params="b"><xacro:m/></xacro:macro><xacro:m/><xacro:m a="1"/><xacro:n b="3"/>""",
    "blocks": """<xacro:macro name="m" params="a *one **many"><o v="${a}"><xacro:insert_block name="one"/><xacro:insert_block name="many"/>
        <xacro:insert_block name="one"/></o></xacro:macro><xacro:property name="p" value="5"/>
        <xacro:m a="1"><b v="${p}"/><c><d v="${p + 1}"/><e/></c></xacro:m>""",
    "property blocks": """<xacro:property name="b"><x v="${v}"/><y/></xacro:property><xacro:property name="v" value="1"/>
        <xacro:insert_block name="b"/><xacro:property name="v" value="2"/><z><xacro:insert_block name="b"/></z>""",
    "blocks that are macros": """<xacro:macro name="i"><in/></xacro:macro><xacro:macro name="m" params="*b"><o><xacro:insert_block name="b"/></o></xacro:macro>
        <xacro:m><xacro:i/></xacro:m>""",
    "scopes": """<xacro:property name="a" value="1"/><xacro:macro name="m" params=""><xacro:property name="a" value="2"/>
        <xacro:property name="b" value="3" scope="parent"/><xacro:property name="c" value="${a}" scope="global"/><x a="${a}"/></xacro:macro>
        <xacro:macro name="n"><xacro:m/><y b="${b}"/></xacro:macro><xacro:n/><x a="${a}" c="${c}"/>""",
    "defaults and removal": """<xacro:property name="a" default="1"/><xacro:property name="a" default="2"/><x a="${a}"/>
        <xacro:property name="a" remove="true"/><xacro:property name="a" default="3"/><x a="${a}"/>
        <xacro:property name="l" value="${a}" lazy_eval="false"/><xacro:property name="a" value="4"/><x l="${l}"/>""",
    "names that are computed": """<xacro:property name="${'p' + 'q'}" value="3"/><x v="${pq}"/><xacro:macro name="m_a"><a/></xacro:macro>
        <xacro:call macro="m_${'a'}"/><xacro:element xacro:name="el${1}" k="${2}"><i/></xacro:element>
        <w><xacro:attribute name="at" value="v${3}"/></w>""",
    "arguments": """<xacro:arg name="a" default="4"/><xacro:arg name="b" default="$(arg a)5"/><x a="$(arg a)" b="$(arg b)" c="${$(arg a) + 1}"
        d="$(eval a * 2)" e="${xacro.arg('a')}"/><xacro:arg name="a" default="9"/><x a="$(arg a)"/>""",
    "macros in macros": """<xacro:macro name="o" params="n"><xacro:macro name="i" params="k"><x v="${n}${k}"/></xacro:macro><xacro:i k="1"/></xacro:macro>
        <xacro:o n="a"/><xacro:o n="b"/>""",
    "includes": """<xacro:include filename="other.xacro"/><xacro:include filename="missing.xacro" optional="true"/>
        <xacro:include filename="other.xacro" ns="o"/><xacro:other v="2"/><xacro:o.other v="3"/><x p="${o.known}"/>""",
    "yaml": """<xacro:property name="c" value="${xacro.load_yaml('c.yaml')}"/><x a="${c['a']['b']}" b="${c.a.b}" l="${c.l[1]}" n="${len(c.l)}"
        r="${c.r}" m="${c.m}" k="${'a' in c}" g="${c.get('z', 3)}"/>""",
    "own names for xacro's": """<xacro:property name="pi" value="3"/><x v="${pi}"/>""",
    "tokens": """<x v="${xacro.tokenize('0 0 1')[2]}"/>""",
}


@pytest.mark.parametrize("name", COMPARED)
def test_it_is_what_the_package_xacro_makes_of_it(tmp_path: Path, name: str) -> None:
    (tmp_path / "other.xacro").write_text(
        f'<robot {NS}><xacro:property name="known" value="8"/><xacro:macro name="other" params="v"><y v="${{v}}" k="${{known}}"/></xacro:macro></robot>'
    )
    (tmp_path / "c.yaml").write_text("a: {b: 1.5}\nl: [1, 2, 3]\nr: !degrees 180\nm: !millimeters 3\n")
    path = tmp_path / "r.xacro"
    path.write_text(f'<robot {NS} name="r">{COMPARED[name]}</robot>')
    theirs = load_xml(reference.process_file(str(path)).toxml().encode())
    assert plain(expanded(path)) == plain(theirs)
    assert len(plain(theirs)[2]) > 0


def test_robosuites_panda_is_what_the_package_xacro_makes_of_it() -> None:
    robosuite = pytest.importorskip("robosuite")
    folder = Path(robosuite.__file__).parent / "models/assets/bullet_data/panda_description/urdf"
    path = folder / "panda_arm_hand.urdf.xacro"
    theirs = load_xml(reference.process_file(str(path)).toxml().encode())
    assert plain(expanded(path)) == plain(theirs)
    assert len(theirs.findall("joint")) == 10


# -- what is refused ---------------------------------------------------------------------------------------------------


def test_an_argument_without_a_default_is_asked_for(tmp_path: Path) -> None:
    declared = '<xacro:arg name="ur_type"/>'
    assert plain(expanded_text(tmp_path, declared))[2] == []  # as long as nothing needs it
    message = refusal(tmp_path, declared + '<x v="$(arg ur_type)"/>')
    assert "'ur_type'" in message and "xacro_args: {ur_type: ...}" in message
    assert plain(expanded_text(tmp_path, declared + '<x v="$(arg ur_type)"/>', ur_type="ur5e"))[2][0][1] == {
        "v": "ur5e"
    }


def test_a_truth_of_the_yaml_is_xacros(tmp_path: Path) -> None:
    inside = """<xacro:arg name="on" default="true"/><xacro:if value="$(arg on)"><a/></xacro:if><x v="${'$(arg on)' == 'false'}"/>"""
    assert plain(expanded_text(tmp_path, inside, on=False))[2] == [["x", {"v": "True"}, []]]


def test_an_argument_that_nothing_asks_for_is_refused_with_the_valid_ones(tmp_path: Path) -> None:
    message = refusal(tmp_path, '<xacro:arg name="hand" default="1"/>', hnd=2)
    assert "'hnd'" in message and "xacro_args" in message and "Did you mean 'hand'" in message


def test_arguments_of_what_is_no_xacro_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "r.urdf"
    path.write_text(f'<robot name="r"><link name="palm">{INERTIAL}</link></robot>')
    with pytest.raises(CEIError, match=r"xacro_args.*no xacro"):
        hand(path, xacro_args={"a": 1})


@pytest.mark.parametrize("value", [[1], {"a": 1}, None])
def test_an_argument_is_one_value(tmp_path: Path, value: object) -> None:
    with pytest.raises(CEIError, match="xacro_args"):
        hand(write_package(tmp_path / "p"), xacro_args={"fingers": value})


ESCAPES = [
    "().__class__",
    "().__class__.__bases__[0].__subclasses__()",
    "''.join(['a'])",
    "'{0.__class__}'.format(1)",
    "f'{1}'",
    "f'{().__class__}'",
    "'%s' % 1",
    "'%0999999999d' % 1",
    "__import__('os').system('touch pwned')",
    "open('/etc/passwd')",
    "eval('1')",
    "exec('1')",
    "globals()",
    "vars()",
    "type(1)",
    "python.type(1)",
    "getattr(1, 'real')",
    "math.__dict__",
    "math.__loader__",
    "xacro.load_yaml.__globals__",
    "sin.__self__",
    "sin",
    "[x for x in [1]]",
    "(lambda: 1)()",
    "(x := 1)",
    "{1, 2}",
    "1j",
    "b'a'",
    "...",
    "(-1) ** 0.5",
    "9**9**9",
    "9**999999",
    "2.0**99999",
    "'a' * 10**9",
    "[0] * 10**9",
    "10**300 * 10**300",
    "range(10**9)",
    "python.range(10**9)",
    "round(1, -10**9)",
    "factorial(10**6)",
    "math.factorial(10**6)",
    "1/0",
    "[][0]",
    "{}['a']",
    "1 +",
    "not_there",
    "1(2)",
    "'a' - 'b'",
    "dict(**{})",
    "print('x')",
    "+".join(["1"] * 5001),
    "(" * 300 + "1" + ")" * 300,
    "-" * 9000 + "1",
    "not " * 2400 + "1",
    "xacro.load_yaml(5)",
    "xacro.fatal('no such robot')",
    "xacro.abs_filename('x')",
]


@pytest.mark.parametrize("expression", ESCAPES, ids=lambda text: text[:40])
def test_an_expression_that_is_not_allowed_is_named(tmp_path: Path, expression: str) -> None:
    quoted = expression.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
    message = refusal(tmp_path, f'<x v="${{{quoted}}}"/>')
    if "}" not in expression:  # where it ends, in xacro
        assert f"${{{expression[:30].rstrip()}" in message
    assert not (Path.cwd() / "pwned").exists()


def test_a_namespace_is_no_value(tmp_path: Path) -> None:
    (tmp_path / "o.xacro").write_text(f"<robot {NS}/>")
    inside = '<xacro:include filename="o.xacro" ns="o"/>'
    for expression in ("o", "str(o)", "list(o)", "o.evaluate", "o.parent", "o._values", "o == o"):
        assert "${o" in (message := refusal(tmp_path, f'{inside}<x v="${{{expression}}}"/>')) or expression in message


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("$(env HOME)", "$(env HOME): the environment is not read"),
        ("$(cwd)", "$(cwd) is not allowed"),
        ("$(dirname)", "$(dirname) is not allowed"),
        ("$(eval __import__)", "not defined"),
        ("$(eval env)", "not defined"),
        ("$(anon x)", "not allowed"),
        ("${open", "is not closed"),
    ],
)
def test_a_substitution_that_is_not_allowed(tmp_path: Path, text: str, said: str) -> None:
    assert said in refusal(tmp_path, f'<x v="{text}"/>')


@pytest.mark.parametrize("name", ["x/><mesh", "a b", "", "1a", 'a="b"', "${'x>'}", "a\u00e9", "xml:a:b", "a&gt;"])
def test_a_name_that_is_made_is_nothing_but_a_name(tmp_path: Path, name: str) -> None:
    quoted = name.replace('"', "&quot;").replace("<", "&lt;")
    assert "no name of" in refusal(tmp_path, f'<xacro:element xacro:name="{quoted}"/>')
    assert "no name of" in refusal(tmp_path, f'<a><xacro:attribute name="{quoted}" value="1"/></a>')


@pytest.mark.parametrize("text", [r"\x00", r"\x07", r"\ud800", r"\ufffe"])
def test_a_value_that_no_xml_has_is_refused(tmp_path: Path, text: str) -> None:
    assert "no XML has" in refusal(tmp_path, f"""<x v="${{'{text}'}}"/>""")


def test_an_expression_warns_nobody(tmp_path: Path, recwarn: pytest.WarningsRecorder) -> None:
    expanded_text(tmp_path, r"""<x v="${'\d' if 1else 2}"/>""")
    assert not recwarn.list


def test_an_optional_variable_has_its_default_and_it_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MY_ROBOT", "secret")
    path = tmp_path / "r.xacro"
    path.write_text(f'<robot {NS} name="r"><link name="$(optenv MY_ROBOT palm)">{INERTIAL}</link></robot>')
    built = hand(path)
    assert any("$(optenv MY_ROBOT)" in note and "'palm'" in note for note in built.notes)
    assert b"secret" not in built.model.names and b"palm" in built.model.names


# -- files -------------------------------------------------------------------------------------------------------------


def outside(tmp_path: Path) -> Path:
    """A secret beside the folder that a description is trusted with."""
    (tmp_path / "secret.xml").write_text(f'<robot {NS}><link name="secret"/></robot>')
    (tmp_path / "secret.yaml").write_text("secret: 1\n")
    inside = tmp_path / "inside"
    inside.mkdir(exist_ok=True)
    (inside / "link.xml").symlink_to(tmp_path / "secret.xml")
    (inside / "link.yaml").symlink_to(tmp_path / "secret.yaml")
    (inside / "link").symlink_to(tmp_path)
    return inside


@pytest.mark.parametrize(
    "how", ["../secret", "{0}/secret", "link", "link/secret", "file://{0}/secret", "a/../../secret"]
)
def test_nothing_outside_is_read(tmp_path: Path, how: str) -> None:
    folder = outside(tmp_path)
    name = how.format(tmp_path)
    message = refusal(folder, f'<xacro:include filename="{name}.xml"/>')
    assert "outside" in message
    assert "outside" in refusal(folder, f"""<x v="${{xacro.load_yaml('{name}.yaml')}}"/>""")
    assert "outside" in refusal(folder, f'<xacro:include filename="{name}.xml" optional="true"/>')


def test_etc_passwd_is_not_read(tmp_path: Path) -> None:
    for name in ("/etc/passwd", "../" * 20 + "etc/passwd", "file:///etc/passwd"):
        assert "outside" in refusal(tmp_path, f'<xacro:include filename="{name}"/>')
        assert "outside" in refusal(tmp_path, f"""<x v="${{load_yaml('{name}')}}"/>""")


@pytest.mark.parametrize("package", ["..", ".", "/", "/etc", "../inside", "nowhere", ""])
def test_a_package_is_no_way_out(tmp_path: Path, package: str) -> None:
    folder = outside(tmp_path)
    refusal(folder, f'<xacro:include filename="$(find {package})/secret.xml"/>')
    refusal(folder, f'<xacro:include filename="package://{package}/secret.xml"/>')


def test_a_package_that_is_not_there_is_named_unless_it_is_optional(tmp_path: Path) -> None:
    include = '<xacro:include filename="$(find nowhere)/x.xacro"'
    assert "package 'nowhere'" in (message := refusal(tmp_path, include + "/>")) and "--package_path" in message
    assert plain(expanded_text(tmp_path, include + ' optional="true"/>'))[2] == []


def test_a_missing_include_is_named_with_what_is_there(tmp_path: Path) -> None:
    (tmp_path / "finger.xacro").write_text("<robot/>")
    message = refusal(tmp_path, '<xacro:include filename="fingers.xacro"/>')
    assert "'fingers.xacro'" in message and "Did you mean 'finger.xacro'" in message


def test_an_error_says_in_which_file_and_macro_it_is(tmp_path: Path) -> None:
    (tmp_path / "o.xacro").write_text(
        f'<robot {NS}><xacro:macro name="m"><x v="${{gone}}"/></xacro:macro><xacro:m/></robot>'
    )
    assert refusal(tmp_path, '<xacro:include filename="o.xacro"/>').startswith("o.xacro, macro 'm': ${gone}: 'gone'")


def test_entities_are_not_expanded_here_or_in_includes(tmp_path: Path) -> None:
    bomb = '<!DOCTYPE r [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]><robot><x v="&b;"/></robot>'
    (tmp_path / "bomb.xacro").write_text(bomb)
    assert "entities" in refusal(tmp_path, '<xacro:include filename="bomb.xacro"/>')
    with pytest.raises(CEIError, match="entities"):
        hand(tmp_path / "bomb.xacro")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("&a [*a]", ""),
        ("a: !!python/object/apply:os.system ['touch pwned']", "tag"),
        ("a: &a [1,1,1,1,1,1,1,1]\n" + "\n".join(f"{'abcdefghij'[i]}: &{'abcdefghij'[i]} [{', '.join(['*' + 'abcdefghij'[i - 1]] * 9)}]" for i in range(1, 8)), "aliases"),
        ("a: !degrees 9**9**9", "too large"),
        ("a: !degrees open('x')", "not allowed"),
        ("a: [", ""),
    ],
)  # fmt: skip
def test_yaml_is_read_as_a_strangers(tmp_path: Path, content: str, said: str) -> None:
    (tmp_path / "c.yaml").write_text(content)
    message = refusal(tmp_path, """<x v="${xacro.load_yaml('c.yaml')}"/>""")
    assert "c.yaml" in message and said in message
    assert not (Path.cwd() / "pwned").exists()


# -- an end ------------------------------------------------------------------------------------------------------------

DOUBLED = "".join(f'<xacro:macro name="m{i}">{f"<xacro:m{i - 1}/>" * 2}</xacro:macro>' for i in range(1, 60))


@pytest.mark.parametrize(
    ("inside", "said"),
    [
        ('<xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/>', "nested more than 100 deep"),
        ('<xacro:macro name="m"><a><xacro:m/></a><xacro:m/></xacro:macro><xacro:m/>', "nested more than 100 deep"),
        ('<xacro:property name="b"><xacro:insert_block name="b"/></xacro:property><xacro:insert_block name="b"/>', "deep"),
        ('<xacro:include filename="r.urdf.xacro"/>', "includes itself"),
        ('<xacro:property name="a" value="${b}"/><xacro:property name="b" value="${a}"/><x v="${a}"/>', "circle: a -> b -> a"),
        (f'<xacro:macro name="m0"><a/></xacro:macro>{DOUBLED}<xacro:m59/>', "more than 200000 elements"),
        (f'<xacro:macro name="m0"/>{DOUBLED}<xacro:m59/>', "more than 200000 elements"),
        ('<xacro:property name="p0" value="aaaaaaaaaa"/>' + "".join(f'<xacro:property name="p{i}" value="${{p{i - 1}}}${{p{i - 1}}}"/>' for i in range(1, 60)) + '<x v="${p59}"/>', "too long"),
        ('<xacro:property name="p0" value="${[1, 1]}"/>' + "".join(f'<xacro:property name="p{i}" value="${{[p{i - 1}, p{i - 1}]}}"/>' for i in range(1, 60)) + '<x v="${p59}"/>', "too large"),
        ('<xacro:property name="p0" value="99999"/>' + "".join(f'<xacro:property name="p{i}" value="${{p{i - 1} * p{i - 1}}}"/>' for i in range(1, 60)) + '<x v="${p59}"/>', "too large"),
        ("".join(f'<xacro:property name="p{i}" value="${{p{i + 1}}}"/>' for i in range(3000)) + '<x v="${p0}"/>', "nested too deeply"),
        ('<xacro:macro name="m" params="a:=' + "a" * 60_000 + '\'"/>', "no parameter"),
        ('<xacro:macro name="m" params="' + "a " * 300 + '"/>', "200 parameters"),
        ('<xacro:macro name="m"><x v="${sum(range(90000))}"/></xacro:macro>' + "<xacro:m/>" * 500, "too much work"),
        ('<xacro:property name="big" value="' + "a" * 90_000 + '"/>' + '<x v="${big}"/>' * 500, "16000000 letters"),
    ],
    ids=lambda text: text[:50],
)  # fmt: skip
def test_it_comes_to_an_end(tmp_path: Path, inside: str, said: str) -> None:
    assert said in refusal(tmp_path, inside)


def test_includes_that_include_each_other_are_refused(tmp_path: Path) -> None:
    for name, other in (("a", "b"), ("b", "a")):
        (tmp_path / f"{name}.xacro").write_text(f'<robot {NS}><xacro:include filename="{other}.xacro"/></robot>')
    assert "includes itself" in refusal(tmp_path, '<xacro:include filename="a.xacro"/>')


def test_includes_count_as_often_as_they_are_used(tmp_path: Path) -> None:
    (tmp_path / "o.xacro").write_text("<robot>" + "<a/>" * 50_000 + "</robot>")
    assert "200000 elements" in refusal(tmp_path, '<xacro:include filename="o.xacro"/>' * 10)


def test_the_package_xacro_is_not_needed(tmp_path: Path) -> None:
    path = write_package(tmp_path / "p")
    code = f"""import sys; sys.modules["xacro"] = None
from pathlib import Path
from cei_gym.embodiment.description import load_description
from cei_gym.embodiment.resources import locate
print(len(load_description(locate({str(path)!r}, Path())).spec.joints))"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout == "2\n", done.stderr
