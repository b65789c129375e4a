"""A robot of one's own whose pads are the ends of long links: contact is at the pads, and what touches what is said by name."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from cei_gym.alignment import ClearanceOptions
from cei_gym.alignment.contact.observed import source_grip
from cei_gym.alignment.contact.pads import opposing_sides
from cei_gym.alignment.judge.clearance import Clearance
from cei_gym.embodiment import ArmSpec, Embodiment, EndEffectorSpec, Pad, build_embodiment
from cei_gym.errors import CEIError
from cei_gym.functional import sample_representation
from cei_gym.functional.palmar import extent_mask, within_extent
from cei_gym.kinematics import KinematicTree

INERTIAL = '<inertial><mass value="0.1"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial>'
# a fixed jaw that stands on a wide palm, and one that turns about its root: both 80 mm long, their pads at the ends
JAW = f"""<robot name="jaw">
  <link name="palm">{INERTIAL}
    <collision><origin xyz="0.01 0 -0.02"/><geometry><box size="0.06 0.04 0.04"/></geometry></collision>
    <collision><origin xyz="-0.015 0 0.04"/><geometry><box size="0.01 0.02 0.08"/></geometry></collision></link>
  <link name="moving">{INERTIAL}
    <collision><origin xyz="0.005 0 0.04"/><geometry><box size="0.01 0.02 0.08"/></geometry></collision></link>
  <joint name="grip" type="revolute"><parent link="palm"/><child link="moving"/><axis xyz="0 1 0"/>
    <limit lower="-0.1" upper="1.7" effort="5" velocity="5"/></joint>
</robot>"""
PADS = [Pad("palm", extent=[0.8, 1.0], palmar=[1.0, 0.0, 0.0]), Pad("moving", extent=[0.7, 1.0])]
# two upright columns on a base, the second able to lean over
ARM = f"""<robot name="arm">
  <link name="base">{INERTIAL}<collision><origin xyz="0.5 0 0.1"/><geometry><box size="0.1 0.1 0.2"/></geometry></collision></link>
  <link name="post">{INERTIAL}<collision><origin xyz="0 0 0.05"/><geometry><box size="0.02 0.02 0.1"/></geometry></collision></link>
  <link name="beam">{INERTIAL}<collision><origin xyz="0 0 0.3"/><geometry><box size="0.02 0.02 0.5"/></geometry></collision></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="post"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="5" velocity="5"/></joint>
  <joint name="lean" type="revolute"><origin xyz="0 0 0.15"/><parent link="post"/><child link="beam"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="5" velocity="5"/></joint>
</robot>"""


@pytest.fixture
def jaw(tmp_path: Path) -> Embodiment:
    (tmp_path / "jaw.urdf").write_text(JAW)
    spec = EndEffectorSpec("Jaw", "jaw.urdf", PADS, home={"grip": 1.2}, closed={"grip": 0.0})
    return build_embodiment(None, spec, tmp_path)


@pytest.fixture
def arm(tmp_path: Path) -> Embodiment:
    (tmp_path / "arm.urdf").write_text(ARM)
    return build_embodiment(ArmSpec("Arm", "arm.urdf", "beam", {}), None, tmp_path)


def test_contacts_are_on_the_pads_and_not_elsewhere_on_their_links(jaw: Embodiment) -> None:
    """Pads are known boxes: of the palm's length (-40 to 80 mm) the last fifth, of the moving jaw's (0 to 80 mm) the last 30 %."""
    tree, representation = KinematicTree(jaw), sample_representation(jaw, 64)
    sides = opposing_sides(representation, tree)
    assert sides is not None
    for share in (0.7, 0.85, 1.0):
        T_links = tree.forward((1 - share) * jaw.home + share * jaw.closed)[None]
        contacts = source_grip(representation, sides, 1, T_links, np.zeros(1, bool)).contacts[0]
        for link, surface in (("palm", -0.01), ("moving", 0.0)):
            body = jaw.body_id(link)
            T = T_links[0, body]
            x, y, z = T[:3, :3].T @ (contacts[sides[representation.body == body][0]] - T[:3, 3])
            assert abs(x - surface) < 0.003 and abs(y) < 0.01 and 0.056 - 0.003 <= z <= 0.08 + 0.003, (
                share,
                link,
                x,
                y,
                z,
            )


def test_which_end_is_the_tip_is_not_guessed() -> None:
    box = trimesh.creation.box((0.02, 0.01, 0.1))
    with pytest.raises(CEIError, match=r"does not say which is the tip; name the pad's `geoms` instead"):
        within_extent(box, [0.5, 1.0])
    np.testing.assert_allclose(within_extent(box, [0.2, 0.8]).bounds[:, 2], [-0.03, 0.03], atol=1e-12)
    box.apply_translation([0, 0, -0.02])  # from -70 to 30 mm
    np.testing.assert_allclose(within_extent(box, [0.5, 1.0]).bounds[:, 2], [-0.07, -0.02], atol=1e-12)


def test_an_extent_cuts_a_mesh_where_it_says() -> None:
    box = trimesh.creation.box((0.02, 0.01, 0.1))
    box.apply_translation([0, 0, 0.05])
    part = within_extent(box, [0.25, 0.6])
    np.testing.assert_allclose(part.bounds, [[-0.01, -0.005, 0.025], [0.01, 0.005, 0.06]], atol=1e-12)
    assert within_extent(box, [0.0, 1.0]) is box
    points = np.array([[0, 0, z] for z in (0.02, 0.026, 0.059, 0.061)])
    np.testing.assert_array_equal(extent_mask(box, [0.25, 0.6], points), [False, True, True, False])


def test_what_penetrates_what_is_named(arm: Embodiment) -> None:
    """The beam leans into the base's column, hangs below the table, or into what the arm stands on."""
    clearance = Clearance(arm)
    upright, leaning, hanging = np.zeros(2), np.array([0.0, 1.5]), np.array([np.pi / 2, 2.0])
    found = clearance.penetration(np.stack([upright, leaning]), -10.0)
    assert found.depth_m[0] == 0 and found.between[0] == ()
    assert found.depth_m[1] > 0.01 and set(found.between[1]) == {"base", "beam"}
    below = clearance.penetration(hanging[None], -0.05)  # its end is 0.15 + 0.55 cos(2) = -0.079 m high
    assert below.between[0] == ("beam", "the support surface")
    in_stand = clearance.penetration(np.array([[0.0, 3.0]]), -10.0)  # hangs down beside the post, into what carries it
    assert in_stand.between[0] == ("beam", "its stand")


@pytest.mark.parametrize("margin_m", [0.0, 0.02, 0.05])
def test_the_judge_counts_the_margin_that_was_asked_for(arm: Embodiment, margin_m: float) -> None:
    """The post's foot is at the surface's height, and what an arm lacks of its margin is penetration."""
    clearance = Clearance(arm, ClearanceOptions(arm_margin_m=margin_m))
    depth_m = clearance.penetration(np.zeros((1, 2)), 0.0).depth_m
    np.testing.assert_allclose(depth_m, margin_m, atol=1e-6)
