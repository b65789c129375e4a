"""Robot descriptions (MJCF or URDF) to `mujoco.MjSpec`, through MuJoCo's own parser, as untrusted input."""

from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from xml.etree.ElementTree import Element, tostring

import defusedxml.ElementTree as safe_xml
import mujoco
from defusedxml.common import DefusedXmlException

from cei_gym.embodiment.resources import within
from cei_gym.embodiment.spec import Coupling
from cei_gym.errors import CEIError, one_line, unknown

_MAX_DEPTH = 200
_MAX_NUMBER = 1e10  # MuJoCo's mjMAXVAL
_MULTIPLIERS = ("replicate", "composite", "flexcomp", "hfield")  # a few bytes that ask for any amount of memory
_MAY_BE_INFINITE = ("velocity", "effort")  # where exporters write infinity for "not known"


@dataclass(frozen=True)
class Description:
    """A parsed description: an editable model, and what its file declares that MuJoCo's parser drops.

    Attributes:
        couplings: follower -> coupling.
        max_velocity: joint -> the speed limit of a URDF, rad/s or m/s (MJCF has none).
    """

    spec: mujoco.MjSpec
    couplings: dict[str, Coupling]
    max_velocity: dict[str, float] = field(default_factory=dict)


def load_description(path: Path, root: Path) -> Description:
    """Parse an MJCF or URDF file.

    Args:
        path: the file.
        root: folder that every mesh and include must stay inside.

    Raises:
        CEIError: not XML, XML entities, numbers not finite, a mesh outside `root`, or a model that MuJoCo refuses.
    """
    tree = _parse(path)
    try:
        if tree.tag == "robot":
            return _load_urdf(tree, path, root)
        if tree.tag == "mujoco":
            return _load_mjcf(tree, path, root)
    except CEIError:
        raise
    except (ValueError, OSError, RuntimeError) as error:  # the last where MuJoCo's parser runs out of memory
        raise CEIError(f"{path.name}: MuJoCo refuses it: {one_line(error)}") from error
    raise CEIError(f"{path.name}: root element <{tree.tag}> is neither <mujoco> (MJCF) nor <robot> (URDF).")


def _parse(path: Path) -> Element:
    try:
        tree = safe_xml.parse(path).getroot()
    except DefusedXmlException:
        raise CEIError(f"{path.name}: XML entities are not allowed in a robot description.") from None
    except (safe_xml.ParseError, LookupError, ValueError) as error:  # the latter two of encodings
        raise CEIError(f"{path.name}: not well-formed XML: {one_line(error)}.") from None
    if tree is None:
        raise CEIError(f"{path.name}: no XML element in it.")
    _check_elements(tree, path)
    return tree


def _check_elements(tree: Element, path: Path) -> None:
    """Refuse what MuJoCo's parser would choke on, or read without a word."""
    level = [tree]
    for _ in range(_MAX_DEPTH):
        level = [child for element in level for child in element]
    if level:
        raise CEIError(f"{path.name}: elements are nested more than {_MAX_DEPTH} deep.")
    for element in tree.iter():
        if element.tag in _MULTIPLIERS:
            raise CEIError(f"{path.name}: <{element.tag}> is not allowed in a robot description.")
        for name, text in element.items():
            if name not in _MAY_BE_INFINITE and not _reasonable(text):
                raise CEIError(f"{path.name}: <{element.tag} {name}={text[:60]!r}> is not within {_MAX_NUMBER:g}.")


def _reasonable(text: str) -> bool:
    """Whether numbers, if the text is numbers, are ones that MuJoCo can work with."""
    try:
        return all(abs(float(part)) <= _MAX_NUMBER for part in text.split())
    except ValueError:
        return True


def _load_mjcf(tree: Element, path: Path, root: Path) -> Description:
    _refuse_files_outside(tree, path, root)
    spec = mujoco.MjSpec.from_file(str(path))
    return Description(spec, _equality_couplings(spec))


def _refuse_files_outside(tree: Element, path: Path, root: Path) -> None:
    """Refuse an MJCF file if it, or a file that it includes, names a file outside `root`."""
    documents, read = [tree], {path.resolve()}
    for document in documents:  # grows as includes are found
        for element in document.iter():
            if element.tag in ("include", "model") and (file := element.get("file")):
                inside = within(root, path.parent / file, file)
                if inside.is_file() and inside not in read:
                    read.add(inside)
                    documents.append(_parse(inside))
    compilers = [c for document in documents for c in document.iter("compiler")]
    folders = [path.parent / c.get(d, "") for c in compilers for d in ("assetdir", "meshdir", "texturedir")]
    for document in documents:
        for element in document.iter():
            for file in (value for key, value in element.items() if key.startswith("file")):
                places = [folder / file for folder in [path.parent, *folders]]
                # Which folder counts depends on the element; one that has no such file does not.
                for place in [p for p in places if p.is_file()] or places:
                    within(root, place, file)


def _equality_couplings(spec: mujoco.MjSpec) -> dict[str, Coupling]:
    """Joint equalities that are linear: `y - y0 = a0 + a1 (x - x0)` with y0, x0 the joints' references."""
    couplings = {}
    for equality in spec.equalities:
        if equality.type != mujoco.mjtEq.mjEQ_JOINT or not equality.name2:
            continue
        a0, a1, *rest = equality.data[:5]
        if any(rest):
            raise CEIError(f"joint equality {equality.name!r} is not linear; only q = a u + b is supported.")
        for joint in (equality.name1, equality.name2):
            if spec.joint(joint) is None:
                raise unknown("joint in a joint equality", joint, [j.name for j in spec.joints if j.name])
        y0, x0 = spec.joint(equality.name1).ref, spec.joint(equality.name2).ref
        couplings[equality.name1] = Coupling(equality.name2, float(a1), float(y0 + a0 - a1 * x0))
    return couplings


def _load_urdf(tree: Element, path: Path, root: Path) -> Description:
    couplings, max_velocity = {}, {}
    for joint in tree.iter("joint"):
        # MuJoCo drops <mimic> and velocity limits without a word.
        name = joint.get("name", "")
        if (mimic := joint.find("mimic")) is not None:
            scale, offset = _number(mimic, "multiplier", 1.0, path), _number(mimic, "offset", 0.0, path)
            couplings[name] = Coupling(mimic.get("joint", ""), scale, offset)
        if (limit := joint.find("limit")) is not None and joint.get("type") != "continuous":
            lower, upper = (_number(limit, bound, 0.0, path) for bound in ("lower", "upper"))
            if lower > upper:
                raise CEIError(f"{path.name}: joint {name!r}: its lower limit {lower:g} is above its upper {upper:g}.")
        # Exporters write 0 or infinity for "not known".
        if (limit := joint.find("limit")) is not None and 0 < (speed := _number(limit, "velocity", 0.0, path)) < inf:
            max_velocity[name] = speed
    for mesh in tree.iter("mesh"):
        mesh.set("filename", str(_urdf_mesh(mesh.get("filename", ""), path, root)))
    for extension in tree.findall("mujoco"):
        tree.remove(extension)
    extension = Element("mujoco")
    options = {
        "strippath": "false",
        "discardvisual": "false",
        "fusestatic": "false",
        "balanceinertia": "true",
    }
    extension.append(Element("compiler", options))
    tree.insert(0, extension)
    return Description(mujoco.MjSpec.from_string(tostring(tree, encoding="unicode")), couplings, max_velocity)


def _number(element: Element, attribute: str, default: float, path: Path) -> float:
    text = element.get(attribute, default)
    try:
        return float(text)
    except ValueError:
        raise CEIError(f"{path.name}: <{element.tag} {attribute}={text!r}> is not a number.") from None


def _urdf_mesh(uri: str, path: Path, root: Path) -> Path:
    """A mesh named relative to the URDF, or by `package://<ROS package>/...` (an enclosing folder of that name)."""
    if not uri.startswith("package://"):
        return within(root, path.parent / uri.removeprefix("file://"), uri)
    package, _, inside = uri.removeprefix("package://").partition("/")
    folder = next((p for p in path.resolve().parents if p.name == package), None)
    if folder is None:
        raise CEIError(f"{path.name}: mesh {uri!r}: no enclosing folder is named {package!r}.")
    return within(folder, folder / inside, uri)
