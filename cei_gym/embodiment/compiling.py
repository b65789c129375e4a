"""From an assembled `mujoco.MjSpec` to a model that holds for a robot: what is repaired, and what is refused."""

import re
from collections.abc import Iterable

import mujoco
import numpy as np

from cei_gym.arrays import Array
from cei_gym.embodiment.assets import Assets, check_compiled
from cei_gym.embodiment.names import END_EFFECTOR_PREFIX, public_name
from cei_gym.errors import CEIError, one_line

_LARGEST_M = 5.0  # no link is larger, nor farther from the one before
_MASSLESS_KG, _MASSLESS_KG_M2 = 1e-6, 1e-9
_SAME_LOOP_M = 0.003
_CLOSING = (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD)


def compile_spec(
    name: str, spec: mujoco.MjSpec, assets: list[Assets], held: Iterable[str] = ()
) -> tuple[mujoco.MjModel, list[str]]:
    """Compile an embodiment.

    A link without mass (a tool frame on a joint) gets next to none, a mesh without volume counts as a thin shell, and a base does not
    touch the links on its own joints: MuJoCo sees to that for a link that moves and not for one that is fixed to the world. A base
    stands still: its free joint is left out.

    Args:
        name: for messages.
        spec: all of it; changed.
        assets: of its descriptions.
        held: links whose joints were taken away, and which are no part of the base for that.

    Returns:
        The model, and sentences about what was assumed.

    Raises:
        CEIError: MuJoCo cannot compile it, or the result is not what the description shows.
    """
    notes = _without_free_bases(spec)
    _exclude_base_contacts(spec, set(held))
    spec.assets = {key: content for each in assets for key, content in each.contents.items()}
    for _ in range(1 + len(spec.bodies) + len(spec.meshes)):
        try:
            model = spec.compile()
        except ValueError as error:
            if not _repaired(spec, str(error), notes):
                raise CEIError(f"{name}: MuJoCo cannot compile it: {one_line(error)}") from error
        else:
            check_compiled(spec, model, assets)
            _check_sizes(name, model)
            return model, [*notes, *_weightless(model)]
    raise CEIError(f"{name}: MuJoCo cannot compile it.")


def _without_free_bases(spec: mujoco.MjSpec) -> list[str]:
    """Leave out the free joints of what stands on the world, or hangs on an arm, with their motors and what ties them to the world."""
    inside = END_EFFECTOR_PREFIX
    bases: list[mujoco.MjsBody] = [*spec.worldbody.bodies]
    bases += [
        body
        for parent in spec.bodies
        for body in parent.bodies
        if body.name.startswith(inside) and not parent.name.startswith(inside) and body not in bases
    ]
    free = [joint for body in bases for joint in body.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE]
    links = {joint.parent.name for joint in free}
    names = {joint.name for joint in free if joint.name}
    on_joints = [actuator for actuator in spec.actuators if actuator.target in names]
    to_world = [
        equality
        for equality in spec.equalities
        if equality.type in _CLOSING and {equality.name1, equality.name2} - links <= {"", "world"}
    ]
    for element in (*on_joints, *to_world, *free):
        spec.delete(element)
    return [f"the free joint of link {public_name(link)!r} is left out: a base stands still." for link in sorted(links)]


def _weightless(model: mujoco.MjModel) -> list[str]:
    """A sentence about an end-effector of which nothing has a mass."""
    mass_kg = [model.body_mass[i] for i in range(model.nbody) if model.body(i).name.startswith(END_EFFECTOR_PREFIX)]
    return ["the end-effector weighs nothing: none of its links has a mass."] if mass_kg and not sum(mass_kg) else []


def _repaired(spec: mujoco.MjSpec, message: str, notes: list[str]) -> bool:
    """Whether what MuJoCo says against a model could be mended."""
    found = re.search(r"\bid (\d+)", message)
    index = int(found[1]) if found else -1
    if "mass and inertia of moving bodies" in message:
        culprit = next((b for b in spec.bodies if b.id == index), None)
        if culprit is None or culprit.explicitinertial:
            return False
        moved = [b for b in spec.bodies if b.first_joint() and not b.first_geom() and not b.explicitinertial]
        for body in {b.id: b for b in (*moved, culprit)}.values():
            shown = body.name.rpartition("/")[2]
            notes.append(f"link {shown!r} has no mass; it gets next to none.")
            body.explicitinertial = True
            body.mass, body.inertia = _MASSLESS_KG, np.full(3, _MASSLESS_KG_M2)
        return True
    if "mesh volume is too small" in message or "inertia to shell" in message:
        mesh = next((m for m in spec.meshes if m.id == index), None)
        shell = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        if mesh is None or mesh.inertia == shell:
            return False
        mesh.inertia = shell
        return True
    return False


def _exclude_base_contacts(spec: mujoco.MjSpec, held: set[str]) -> None:
    """Exclude contacts of the links on a joint of the base with all that is fixed to the base."""
    fixed: list[list[mujoco.MjsBody]] = [[spec.worldbody]]  # groups of links that are fixed to each other
    moved: list[tuple[mujoco.MjsBody, int]] = []  # links on a joint, and the group that it is on
    todo = [(spec.worldbody, 0)]
    while todo:
        body, group = todo.pop()
        for child in body.bodies:
            if child.joints:
                moved.append((child, group))
                continue
            if child.name in held:
                fixed.append([])
            child_group = len(fixed) - 1 if child.name in held else group
            fixed[child_group].append(child)
            todo.append((child, child_group))
    for body, group in moved:
        for link in filter(_touches, _fixed_to(body)):
            for other in filter(_touches, fixed[group]):
                spec.add_exclude(bodyname1=_name(link, spec), bodyname2=_name(other, spec))


def _fixed_to(body: mujoco.MjsBody) -> list[mujoco.MjsBody]:
    """A link and those that move with it."""
    links = [body]
    for link in links:  # grows
        links += [child for child in link.bodies if not child.joints]
    return links


def _touches(body: mujoco.MjsBody) -> bool:
    return any(geom.contype or geom.conaffinity for geom in body.geoms)


def _name(body: mujoco.MjsBody, spec: mujoco.MjSpec) -> str:
    if not body.name:
        names = {b.name for b in spec.bodies}
        body.name = next(name for i in range(len(names) + 1) if (name := f"unnamed_{i}") not in names)
    return body.name


def _check_sizes(name: str, model: mujoco.MjModel) -> None:
    for geom in np.flatnonzero((model.geom_rbound > _LARGEST_M) & (model.geom_bodyid > 0)):
        shown, size_m = model.geom(geom).name.rpartition("/")[2], 2 * model.geom_rbound[geom]
        raise CEIError(f"{name}: geom {shown!r} is {size_m:.3g} m long, which no link is; is it in millimetres?")
    for body in np.flatnonzero(np.linalg.norm(model.body_pos, axis=1) > _LARGEST_M):
        shown, away_m = model.body(body).name.rpartition("/")[2], np.linalg.norm(model.body_pos[body])
        raise CEIError(f"{name}: link {shown!r} is {away_m:.3g} m from the one before; are its origins in millimetres?")


def check_loops(name: str, model: mujoco.MjModel, poses: dict[str, Array]) -> None:
    """Check that loops of links, which connect and weld equalities close, stay closed as couplings move the joints.

    Args:
        name: for messages.
        model: the compiled model.
        poses: name -> (n,) joint positions.

    Raises:
        CEIError: one opens.
    """
    loops = np.flatnonzero(np.isin(model.eq_type, _CLOSING) & (model.eq_active0 != 0))
    data = mujoco.MjData(model)
    for pose, qpos in poses.items() if len(loops) else ():
        data.qpos[:] = qpos
        mujoco.mj_fwdPosition(model, data)
        for loop in loops:
            rows = (data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY) & (data.efc_id == loop)
            open_m = np.linalg.norm(data.efc_pos[rows][:3])
            if open_m > _SAME_LOOP_M:
                one, other = _ends(model, int(loop))
                raise CEIError(
                    f"{name}: links {one!r} and {other!r} are joined to a loop, which is {1000 * open_m:.1f} mm open at {pose}; say under"
                    " `couplings` how the joints in the loop follow each other."
                )


def _ends(model: mujoco.MjModel, loop: int) -> tuple[str, str]:
    ids = (int(model.eq_obj1id[loop]), int(model.eq_obj2id[loop]))
    if model.eq_objtype[loop] == mujoco.mjtObj.mjOBJ_SITE:
        ids = (int(model.site_bodyid[ids[0]]), int(model.site_bodyid[ids[1]]))
    one, other = (model.body(i).name.rpartition("/")[2] for i in ids)
    return one, other
