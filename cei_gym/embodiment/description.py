"""Robot descriptions (MJCF, URDF or xacro) to `mujoco.MjSpec`, through MuJoCo's own parser, as untrusted input.

MuJoCo parses text that was checked here, and compiles it from files in memory, so that nothing else can be opened.
"""

from collections import Counter, defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field

import mujoco
import numpy as np

from cei_gym.embodiment.assets import Assets
from cei_gym.embodiment.elements import check_counts
from cei_gym.embodiment.mjcf import read_mjcf
from cei_gym.embodiment.resources import Place, read_file
from cei_gym.embodiment.spec import Coupling
from cei_gym.embodiment.urdf import UrdfReader
from cei_gym.embodiment.xacro import expand, is_xacro
from cei_gym.errors import CEIError, one_line
from cei_gym.untrusted_xml import MAX_BYTES, load_xml


@dataclass(frozen=True)
class Description:
    """A parsed description: an editable model, and what its file declares that MuJoCo's parser drops.

    Attributes:
        spec: the model.
        assets: the files that it compiles from.
        mimics: follower -> coupling, of a URDF's `<mimic>`; those of an MJCF are in the model.
        max_velocity: joint -> the speed limit of a URDF, rad/s or m/s (MJCF has none).
        notes: sentences about what was assumed or left out.
    """

    spec: mujoco.MjSpec
    assets: Assets
    mimics: dict[str, Coupling] = field(default_factory=dict[str, Coupling])
    max_velocity: dict[str, float] = field(default_factory=dict[str, float])
    notes: list[str] = field(default_factory=list[str])


def load_description(
    place: Place, plain: bool = True, xacro_args: Mapping[str, str | float | bool] | None = None
) -> Description:
    """Parse an MJCF or URDF file, or a xacro, which is expanded first.

    Args:
        place: the file, and what it may read.
        plain: whether OBJ files that look as if MuJoCo read them right go to it as they are.
        xacro_args: arguments of a xacro.

    Raises:
        CEIError: not XML, XML entities, numbers not finite, too much of anything, a file outside the root, or a model that MuJoCo
            refuses.
    """
    name = place.path.name
    try:
        description = _load(place, Assets(place, plain), xacro_args or {})
        _check_names(description.spec)
        _check_shapes(description.spec)
        _name_geoms(description.spec)
        description.notes.extend(description.assets.prepare(description.spec))
    except CEIError as error:
        raise CEIError(f"{name}: {error}{'' if str(error).endswith(('.', '?')) else '.'}") from None
    except (ValueError, OSError, RuntimeError) as error:  # the last where MuJoCo's parser runs out of memory
        raise CEIError(f"{name}: MuJoCo refuses it: {one_line(error)}") from error
    spec = description.spec
    spec.compiler.LRopt.mode = 0  # no simulation for the lengths of muscles
    description.notes.extend(_without_planes(spec))
    return description


def _load(place: Place, assets: Assets, xacro_args: Mapping[str, str | float | bool]) -> Description:
    tree, notes = load_xml(read_file(place.path, place.path.name, MAX_BYTES)), list[str]()
    if place.path.suffix == ".xacro" or is_xacro(tree):
        tree, notes = expand(tree, place, xacro_args)
    elif xacro_args:
        raise CEIError("`xacro_args` are given, and it is no xacro; leave them out")
    if tree.tag == "mujoco":
        return Description(read_mjcf(tree, assets), assets, notes=notes)
    if tree.tag == "robot":
        check_counts(tree)
        urdf = UrdfReader(tree, assets)
        return Description(urdf.spec, assets, urdf.couplings, urdf.max_velocity, notes + urdf.notes)
    raise CEIError(f"root element <{tree.tag[:60]}> is neither <mujoco> (MJCF) nor <robot> (URDF)")


def _check_names(spec: mujoco.MjSpec) -> None:
    for kind, elements in (
        ("links", spec.bodies),
        ("joints", spec.joints),
        ("geoms", spec.geoms),
        ("meshes", spec.meshes),
    ):
        count = Counter(element.name for element in elements if element.name)
        if repeated := [name for name, n in count.items() if n > 1]:
            raise CEIError(f"two {kind} are called {repeated[0]!r}")


def _check_shapes(spec: mujoco.MjSpec) -> None:
    odd = {mujoco.mjtGeom.mjGEOM_HFIELD: "height field", mujoco.mjtGeom.mjGEOM_SDF: "signed distance field"}
    for geom in spec.geoms:
        if geom.type in odd:
            raise CEIError(f"geom {geom.name!r} is a {odd[geom.type]}; a robot's shapes are meshes and simple ones")


def _without_planes(spec: mujoco.MjSpec) -> list[str]:
    """Leave out floors and walls: endless planes are no part of a robot."""
    planes = [geom for geom in spec.geoms if geom.type == mujoco.mjtGeom.mjGEOM_PLANE]
    notes = [f"plane {geom.name!r} is left out: it is no part of a robot." for geom in planes]
    for geom in planes:
        spec.delete(geom)
    return notes


def _name_geoms(spec: mujoco.MjSpec) -> None:
    """A geom without a name goes by its link and its number there, from 0."""
    names = {geom.name for geom in spec.geoms}
    number: dict[str, int] = defaultdict(int)
    for geom in spec.geoms:
        body = geom.parent.name or "world"
        name = f"{body}.{number[body]}"
        number[body] += 1
        if not geom.name and name not in names:
            geom.name = name


def doubtful_units(spec: mujoco.MjSpec) -> list[str]:
    """Sentences about ranges of joints that look as if they were in another unit."""
    hinge, slide = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE
    ends = {kind: {j.name: np.abs(j.range).max() for j in spec.joints if j.type == kind} for kind in (hinge, slide)}
    notes = []
    largest = max(ends[hinge].values(), default=0.0)
    if spec.compiler.degree and 0 < largest <= 2 * np.pi:
        notes.append(
            f'no hinge turns by more than {largest:.3g} degrees; if these are radians, set angle="radian" in the MJCF\'s <compiler>, or'
            " `angle: radian` in the YAML."
        )
    for joint, end in ends[hinge].items():
        if not spec.compiler.degree and end > 4 * np.pi:
            notes.append(f"joint {joint!r} turns by up to {end:.4g} rad; are these degrees?")
    for joint, end in ends[slide].items():
        if end > 5.0:
            notes.append(f"joint {joint!r} slides by up to {end:.4g} m; are these millimetres?")
    return notes
