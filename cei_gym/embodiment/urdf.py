"""URDF to `mujoco.MjSpec`: what describes a robot is kept, in the way that MuJoCo's parser reads right."""

from collections import Counter
from math import inf, isnan, nan, pi
from pathlib import Path, PurePosixPath
from xml.etree.ElementTree import Element, SubElement, tostring

import mujoco
import numpy as np

from cei_gym.embodiment.assets import Assets
from cei_gym.embodiment.elements import check_numbers
from cei_gym.embodiment.resources import within
from cei_gym.embodiment.spec import Coupling
from cei_gym.errors import CEIError

_KEPT = {
    "robot": ("link", "joint", "material"),
    "link": ("inertial", "visual", "collision"),
    "joint": ("origin", "parent", "child", "axis", "limit", "dynamics", "mimic", "safety_controller"),
    "material": ("color",),
}
"""Element -> those in it that are read. A URDF is open to what other programs add (gazebo, ros2_control, transmissions)."""

_ALMOST_A_TURN, _ENDLESS, _LEAST_MOMENT_KG_M2 = 1.98 * pi, 1e6, 1e-12
_WATER_KG_M3 = 1000.0
_SCHEMES = ("package://", "model://")
_COMPILER = {"strippath": "false", "discardvisual": "false", "fusestatic": "false", "balanceinertia": "true"}


class UrdfReader:
    """What a URDF says, and what MuJoCo's parser does not read of it.

    Args:
        tree: its root element; changed.
        assets: what its meshes are put into.

    Attributes:
        spec: the parsed model.
        couplings: follower -> coupling, of `<mimic>`.
        max_velocity: joint -> speed limit, rad/s or m/s.
        notes: sentences about what was assumed or left out.

    Raises:
        CEIError: it cannot be used.
    """

    def __init__(self, tree: Element, assets: Assets) -> None:
        self._assets = assets
        self._meshdir = next((c.get("meshdir", "") for c in tree.iterfind("mujoco/compiler")), "")
        self.couplings: dict[str, Coupling] = {}
        self.max_velocity: dict[str, float] = {}
        self.notes: list[str] = []
        _strip(tree)
        check_numbers(tree, may_be_infinite=("velocity", "effort", "lower", "upper"))  # for "not known"
        for joint in tree.iterfind("joint"):
            self._read_joint(joint)
        mended = [link.get("name", "") for link in tree.iterfind("link") if _mend_inertial(link)]
        if mended:
            names = ", ".join(map(repr, mended))
            self.notes.append(f"no body has the inertia of {names}; the nearest possible one is taken.")
        _check_one_root(tree)
        for mesh in tree.iter("mesh"):
            self._read_mesh(mesh)
        _name_geoms(tree)
        extension = Element("mujoco")
        SubElement(extension, "compiler", _COMPILER)
        tree.insert(0, extension)
        self.spec = mujoco.MjSpec.from_string(tostring(tree, encoding="unicode"), assets=assets.contents)
        self._estimate_masses(tree)

    def _estimate_masses(self, tree: Element) -> None:
        """Links on a joint that say no mass have that of their shapes: MuJoCo takes those that touch, where there are any; else it is what is seen."""
        on_joint = {child.get("link", "") for child in tree.iterfind("joint/child")}
        estimated: list[str] = []
        for link in tree.iterfind("link"):
            name, body = link.get("name", ""), self.spec.body(link.get("name", ""))
            if name not in on_joint or link.find("inertial/mass") is not None or body is None or not body.geoms:
                continue
            estimated.append(name)
            if not any(geom.contype or geom.conaffinity for geom in body.geoms):
                shown: list[mujoco.MjsGeom] = list(body.geoms)
                for geom in shown:
                    geom.mass, geom.density = nan, _WATER_KG_M3
        if estimated:
            names = ", ".join(map(repr, estimated))
            self.notes.append(f"no mass is given for {names}; it is that of water in their shapes.")

    def _read_joint(self, joint: Element) -> None:
        name, kind = joint.get("name", ""), joint.get("type", "")
        if kind == "planar":
            raise CEIError(
                f"joint {name!r} is planar; write it as two prismatic joints and a revolute one, with limits."
            )
        if (mimic := joint.find("mimic")) is not None:
            coupling = Coupling(
                mimic.get("joint", ""), _number(mimic, "multiplier", 1.0), _number(mimic, "offset", 0.0)
            )
            if kind != "fixed":
                self.couplings[name] = coupling
        limit = joint.find("limit")
        lower, upper = (0.0 if limit is None else _number(limit, end, 0.0) for end in ("lower", "upper"))
        if limit is not None and 0 < (speed := _number(limit, "velocity", 0.0)) < inf:
            self.max_velocity[name] = speed  # exporters write 0 or infinity for "not known"
        if limit is not None and (kind == "continuous" or not max(abs(lower), abs(upper)) <= _ENDLESS):
            for end in ("lower", "upper"):
                limit.attrib.pop(end, None)
        if kind == "continuous":
            if 0 < upper - lower < _ALMOST_A_TURN:
                self.notes.append(
                    f"joint {name!r} is continuous: as URDF has it, its limits of {lower:g} to {upper:g} rad do not hold; make it"
                    " revolute if they should."
                )
        elif kind in ("revolute", "prismatic"):
            self._read_limits(joint, name, lower, upper)
        for tag in ("mimic", "safety_controller"):
            for element in joint.findall(tag):
                joint.remove(element)

    def _read_limits(self, joint: Element, name: str, lower: float, upper: float) -> None:
        unit = "rad" if joint.get("type") == "revolute" else "m"
        if endless := [end for end, value in (("lower", lower), ("upper", upper)) if not abs(value) <= _ENDLESS]:
            if unit == "m" or isnan(lower) or isnan(upper):
                raise CEIError(f"joint {name!r}: its {' and '.join(endless)} limit is not within {_ENDLESS:g} {unit}.")
            lower = upper = 0.0
        if lower > upper:
            raise CEIError(f"joint {name!r}: its lower limit {lower:g} is above its upper {upper:g}.")
        if lower == upper != 0:
            raise CEIError(f"joint {name!r}: both its limits are {lower:g} {unit}; make it fixed, or give it a range.")
        if lower == upper:
            if unit == "rad":
                self.notes.append(
                    f"joint {name!r} has no limits (none are given, 0 to 0, or endless ones): a whole turn to either side is taken."
                )
            return
        limit = joint.find("limit")
        assert limit is not None
        limit.attrib |= {"lower": repr(lower), "upper": repr(upper)}  # MuJoCo wants both; URDF has 0 for one not given
        if (soft := joint.find("safety_controller")) is not None:
            ends = _number(soft, "soft_lower_limit", lower), _number(soft, "soft_upper_limit", upper)
            if lower < upper and ends[0] < ends[1] and (ends[0] > lower + 1e-6 or ends[1] < upper - 1e-6):
                self.notes.append(
                    f"joint {name!r}: its <safety_controller> keeps to {ends[0]:g} to {ends[1]:g} {unit}; its limits of {lower:g} to"
                    f" {upper:g} {unit} are taken."
                )

    def _read_mesh(self, mesh: Element) -> None:
        uri = mesh.get("filename", "")
        path = self._find(uri.replace("\\", "/"))
        mesh.set("filename", self._assets.mesh(path, uri, mesh.get("scale", "")))

    def _find(self, uri: str) -> Path:
        """A mesh relative to the URDF, or by `package://<ROS package>/...`; or where a `<mujoco>` element says that they are."""
        place = self._assets.place
        beside = place.path.parent
        stripped = beside / self._meshdir / PurePosixPath(uri).name
        uri = uri.removeprefix("file://")  # before package://, too, where a xacro has $(find ...)
        scheme = next((s for s in _SCHEMES if uri.startswith(s)), None)
        if scheme is None:
            path = place.inside(beside / uri, uri)
            return place.inside(stripped, uri) if self._meshdir and not path.is_file() else path
        package, _, inside = uri.removeprefix(scheme).lstrip("/").partition("/")
        try:
            folder = place.package(package)
        except CEIError:
            if self._meshdir and (path := place.inside(stripped, uri)).is_file():
                return path
            raise
        return within(folder, folder / inside, uri)


def _number(element: Element, attribute: str, default: float) -> float:
    text = element.get(attribute, default)
    try:
        return float(text)
    except ValueError:
        raise CEIError(f"<{element.tag} {attribute}={text!r}> is not a number.") from None


def _strip(element: Element) -> None:
    kept = _KEPT.get(element.tag)
    for child in list(element):
        if kept is not None and child.tag not in kept:
            element.remove(child)
        else:
            _strip(child)


def _check_one_root(tree: Element) -> None:
    on: dict[str, list[str]] = {}
    for joint in tree.iterfind("joint"):
        for child in joint.iterfind("child"):
            on.setdefault(child.get("link", ""), []).append(joint.get("name", ""))
    for link, joints in on.items():
        if len(joints) > 1:
            raise CEIError(
                f"link {link!r} hangs on {' and '.join(map(repr, joints[:2]))}, a loop, which a URDF cannot have; leave one out, and let"
                " its joints follow each other by <mimic>, or by `couplings` in the YAML."
            )
    children = on.keys()
    roots = [name for link in tree.iterfind("link") if (name := link.get("name", "")) not in children]
    if len(roots) > 1:
        raise CEIError(f"links {', '.join(map(repr, roots[:5]))} hang on no joint; a robot has one base.")


def _name_geoms(tree: Element) -> None:
    """Give every geom a name of its own, `<link>.<number>` where it has none: MuJoCo's parser would go on with the one before."""
    links = {link: [geom for geom in link if geom.tag in ("visual", "collision")] for link in tree.iterfind("link")}
    count = Counter(geom.get("name", "") for geoms in links.values() for geom in geoms)
    for link, geoms in links.items():
        for number, geom in enumerate(geoms):
            if not geom.get("name") or count[geom.get("name", "")] > 1:
                geom.set("name", f"{link.get('name', '')}.{number}")


def _mend_inertial(link: Element) -> bool:
    """Leave out what is 0, and mend inertias that no body has: MuJoCo refuses both, and only holding torques depend
    on them. Returns whether it was mended."""
    inertial = link.find("inertial")
    mass, inertia = (None if inertial is None else inertial.find(tag) for tag in ("mass", "inertia"))
    if inertial is None or mass is None or inertia is None:
        return False
    keys = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    xx, yy, zz, xy, xz, yz = (_number(inertia, key, 0.0) for key in keys)
    weight_kg = _number(mass, "value", 0.0)
    if weight_kg == 0 and not any((xx, yy, zz, xy, xz, yz)):
        link.remove(inertial)
        return False
    moments, axes = np.linalg.eigh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if weight_kg > 0 and moments[0] < _LEAST_MOMENT_KG_M2:
        M = axes @ np.diag(np.maximum(moments, max(1e-4 * moments[2], _LEAST_MOMENT_KG_M2))) @ axes.T
        for key, at in zip(keys, ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)), strict=True):
            inertia.set(key, repr(float(M[at])))
        return True
    return False
