"""The Directional Chamfer Distance against a brute-force oracle; sampling the pads of every end-effector."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cei_gym.embodiment import (
    END_EFFECTORS,
    Embodiment,
    EndEffectorSpec,
    Pad,
    build_embodiment,
    load_arm,
    load_end_effector,
)
from cei_gym.errors import CEIError
from cei_gym.functional import VARIANTS, directional_chamfer_distance, sample_representation
from cei_gym.functional.picture import draw_representation
from cei_gym.functional.representation import pad_mesh
from cei_gym.kinematics import KinematicTree
from cei_gym.pointcloud.distance import square_distance

Set = tuple[np.ndarray, np.ndarray]
LAMBDAS = st.sampled_from([0.0, 0.05, 0.5])
SEEDS = st.integers(0, 2**31)


def random_set(n: int, rng: np.random.Generator) -> Set:
    normals = rng.normal(size=(n, 3))
    return rng.uniform(-0.1, 0.1, (n, 3)), normals / np.linalg.norm(normals, axis=1, keepdims=True)


def brute_force(one: Set, other: Set, lambda_m: float) -> float:
    """Equation (1), pair by pair."""

    def towards(one: Set, other: Set) -> float:
        total = 0.0
        for p, n in zip(*one, strict=True):
            costs = [np.sqrt(sum((p - q) ** 2)) - lambda_m * sum(n * m) for q, m in zip(*other, strict=True)]
            total += min(costs)
        return total / len(one[0])

    return towards(one, other) + towards(other, one)


# -- distance ------------------------------------------------------------------------------------------------


@settings(max_examples=40, deadline=None)
@given(seed=SEEDS, n=st.integers(1, 12), m=st.integers(1, 12), lambda_m=LAMBDAS)
def test_dcd_agrees_with_the_double_loop_and_torch(seed: int, n: int, m: int, lambda_m: float) -> None:
    rng = np.random.default_rng(seed)
    one, other = random_set(n, rng), random_set(m, rng)
    expected = brute_force(one, other, lambda_m)
    assert directional_chamfer_distance(*one, *other, lambda_m) == pytest.approx(expected, abs=1e-12)
    tensors = [torch.tensor(x) for x in (*one, *other)]
    assert directional_chamfer_distance(*tensors, lambda_m).item() == pytest.approx(expected, abs=1e-12)


@settings(max_examples=20, deadline=None)
@given(seed=SEEDS, n=st.integers(1, 20), lambda_m=LAMBDAS)
def test_identical_and_opposite_sets_are_the_extremes(seed: int, n: int, lambda_m: float) -> None:
    points, normals = random_set(n, np.random.default_rng(seed))
    identical = directional_chamfer_distance(points, normals, points, normals, lambda_m)
    assert identical == pytest.approx(-2 * lambda_m, abs=1e-12)
    # Far enough apart that no normal is worth going to another point for.
    points = 10 * np.arange(n)[:, None] * np.ones(3)
    opposite = directional_chamfer_distance(points, normals, points, -normals, lambda_m)
    assert opposite == pytest.approx(2 * lambda_m, abs=1e-12)


@settings(max_examples=30, deadline=None)
@given(seed=SEEDS, lambda_m=LAMBDAS)
def test_dcd_is_symmetric_bounded_and_blind_to_the_frame_and_the_order(seed: int, lambda_m: float) -> None:
    rng = np.random.default_rng(seed)
    one, other = random_set(9, rng), random_set(7, rng)
    value = directional_chamfer_distance(*one, *other, lambda_m)
    assert directional_chamfer_distance(*other, *one, lambda_m) == pytest.approx(value, abs=1e-12)
    assert value >= -2 * lambda_m
    R, t, order = Rotation.random(rng=rng).as_matrix(), rng.normal(size=3), rng.permutation(9)
    moved = [(p @ R.T + t, n @ R.T) for p, n in (one, other)]
    assert directional_chamfer_distance(*moved[0], *moved[1], lambda_m) == pytest.approx(value, abs=1e-12)
    shuffled = directional_chamfer_distance(*(x[order] for x in one), *other, lambda_m)
    assert shuffled == pytest.approx(value, abs=1e-12)


@settings(max_examples=10, deadline=None)
@given(seed=SEEDS)
def test_without_direction_it_is_the_chamfer_distance(seed: int) -> None:
    from scipy.spatial import cKDTree

    rng = np.random.default_rng(seed)
    (p, n), (q, m) = random_set(30, rng), random_set(20, rng)
    expected = cKDTree(q).query(p)[0].mean() + cKDTree(p).query(q)[0].mean()
    assert directional_chamfer_distance(p, n, q, m, 0.0) == pytest.approx(expected, abs=1e-12)


def test_direction_decides_between_points_at_one_distance() -> None:
    up, down = np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 0.0, -1.0]])
    origin = np.zeros((1, 3))
    two, facing = np.array([[0.01, 0, 0], [-0.01, 0, 0]]), np.concatenate([down, up])
    # There: 0.01 - lambda. Back: (0.01 + lambda + 0.01 - lambda) / 2.
    assert directional_chamfer_distance(origin, up, two, facing, 0.05) == pytest.approx(0.02 - 0.05)


def test_dcd_is_batched() -> None:
    rng = np.random.default_rng(0)
    ones, others = ([random_set(n, rng) for _ in range(4)] for n in (6, 5))
    stacked = [np.stack(x) for x in (*zip(*ones, strict=True), *zip(*others, strict=True))]
    expected = [brute_force(a, b, 0.05) for a, b in zip(ones, others, strict=True)]
    np.testing.assert_allclose(directional_chamfer_distance(*stacked, 0.05), expected, atol=1e-12)


@settings(max_examples=10, deadline=None)
@given(seed=SEEDS, lambda_m=LAMBDAS)
def test_gradient_of_dcd_is_its_finite_difference(seed: int, lambda_m: float) -> None:
    rng = np.random.default_rng(seed)
    one, other = random_set(6, rng), random_set(5, rng)
    tensors = [torch.tensor(x, requires_grad=True) for x in (*one, *other)]
    directional_chamfer_distance(*tensors, lambda_m).backward()
    h = 1e-7
    for i, tensor in enumerate(tensors):
        gradient = tensor.grad.numpy()
        for entry in np.ndindex(gradient.shape):
            ends = []
            for step in (h, -h):
                arrays = [x.copy() for x in (*one, *other)]
                arrays[i][entry] += step
                ends.append(directional_chamfer_distance(*arrays, lambda_m))
            assert gradient[entry] == pytest.approx((ends[0] - ends[1]) / (2 * h), abs=1e-6)


def test_gradient_is_finite_where_points_coincide() -> None:
    points, normals = random_set(5, np.random.default_rng(0))
    moving = torch.tensor(points, requires_grad=True)
    fixed = [torch.tensor(x) for x in (normals, points, normals)]
    directional_chamfer_distance(moving, *fixed, 0.05).backward()
    assert torch.equal(moving.grad, torch.zeros_like(moving.grad))


# -- sampling ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def hand() -> Callable[[str], Embodiment]:
    built: dict[str, Embodiment] = {}

    def build(name: str) -> Embodiment:
        return built.setdefault(name, build_embodiment(None, load_end_effector(name)))

    return build


def with_pads(name: str, *pads: Pad) -> Embodiment:
    return build_embodiment(None, replace(load_end_effector(name), pads=list(pads)))


@pytest.mark.parametrize("name", END_EFFECTORS)
def test_points_lie_on_the_pads_and_normals_point_outward(hand: Callable, name: str) -> None:
    embodiment = hand(name)
    representation = sample_representation(embodiment, 64)
    np.testing.assert_allclose(np.linalg.norm(representation.normals_link, axis=1), 1, atol=1e-9)
    for pad in embodiment.end_effector.pads:
        mine = representation.body == embodiment.body_id(pad.body)
        points, normals = representation.points_link[mine], representation.normals_link[mine]
        mesh = pad_mesh(embodiment, pad)
        # trimesh's own closest_point is off by up to 0.14 mm on these meshes.
        triangles = np.ascontiguousarray(mesh.triangles)
        for point, normal in zip(points, normals, strict=True):
            squares = np.array([square_distance(*point, triangles, i) for i in range(len(triangles))])
            near = squares < 1e-12
            assert near.any()
            assert (mesh.face_normals[near] @ normal).max() > 0.999
        assert mesh.convex_hull.contains(points - 0.0005 * normals).mean() > 0.95


@pytest.mark.parametrize("name", END_EFFECTORS)
def test_points_are_not_on_walls_inside_the_finger(hand: Callable, name: str) -> None:
    """Finger meshes are shells: the inside of a finger's back has a palmar normal too, 12 mm too deep."""
    embodiment = hand(name)
    representation = sample_representation(embodiment, 64)
    for pad in embodiment.end_effector.pads:
        mine = representation.body == embodiment.body_id(pad.body)
        points, normals = representation.points_link[mine], representation.normals_link[mine]
        covered = pad_mesh(embodiment, pad).ray.intersects_any(points + 1e-5 * normals, normals)
        assert covered.mean() < 0.05, pad.body


@pytest.mark.parametrize("name", END_EFFECTORS)
@pytest.mark.parametrize("points", [7, 64])
def test_counts_follow_shares(hand: Callable, name: str, points: int) -> None:
    embodiment = hand(name)
    pads = embodiment.end_effector.pads
    representation = sample_representation(embodiment, points)
    assert len(representation) == points
    whole = sum(pad.share for pad in pads)
    for pad in pads:
        count = np.sum(representation.body == embodiment.body_id(pad.body))
        assert abs(count - points * pad.share / whole) <= 1


def test_sampling_is_decided_by_its_seed(hand: Callable) -> None:
    embodiment = hand("Inspire")
    first, again, other = (sample_representation(embodiment, 32, seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.points_link, again.points_link)
    np.testing.assert_array_equal(first.normals_link, again.normals_link)
    assert not np.isclose(first.points_link, other.points_link).any()


def test_sampling_does_not_depend_on_the_arm(hand: Callable) -> None:
    embodiment = build_embodiment(load_arm("UR5e"), load_end_effector("Inspire"))
    on_arm, alone = sample_representation(embodiment, 32), sample_representation(hand("Inspire"), 32)
    # MuJoCo keeps meshes in single precision.
    np.testing.assert_allclose(on_arm.points_link, alone.points_link, atol=1e-6)


def test_sampling_is_uniform_over_a_pads_area(hand: Callable) -> None:
    embodiment = hand("PandaGripper")
    representation = sample_representation(embodiment, 4096)
    for pad in embodiment.end_effector.pads:
        points = representation.points_link[representation.body == embodiment.body_id(pad.body)]
        mesh = pad_mesh(embodiment, pad)
        face = np.ptp(points, axis=0)
        assert (face < 1e-9).sum() == 1  # one face of the box: the palmar one
        across = face > 1e-9
        np.testing.assert_allclose(face[across], mesh.extents[across], rtol=0.02)
        cells = ((points - mesh.bounds[0]) / mesh.extents * 4)[:, across].astype(int).clip(0, 3)
        counts = np.bincount(cells @ [4, 1], minlength=16)
        chi_squared = ((counts - len(points) / 16) ** 2 / (len(points) / 16)).sum()
        assert chi_squared < 45  # 15 degrees of freedom: 1 in 10 000


def test_sampling_is_uniform_over_triangles_of_any_size(tmp_path: Path) -> None:
    """A plate whose right half has 256 times as many triangles as its left."""
    left = trimesh.creation.box(extents=(0.1, 0.1, 0.1))
    left.apply_translation((-0.05, 0, 0))
    right = left.copy().apply_translation((0.1, 0, 0)).subdivide().subdivide().subdivide().subdivide()
    trimesh.util.concatenate([left, right]).export(tmp_path / "plate.stl")
    path = tmp_path / "plate.xml"
    path.write_text(
        '<mujoco><asset><mesh name="plate" file="plate.stl" inertia="shell"/></asset><worldbody>'
        '<body name="plate"><joint name="slide" type="slide" axis="0 0 1" range="0 1"/><geom type="mesh" mesh="plate"/></body>'
        "</worldbody></mujoco>"
    )
    spec = EndEffectorSpec("Plate", str(path), [Pad("plate")], closed={"slide": 0.5})
    representation = sample_representation(build_embodiment(None, spec), 2000)
    np.testing.assert_allclose(representation.normals_link, np.tile([0, 0, 1], (2000, 1)), atol=1e-6)
    assert np.mean(representation.points_link[:, 0] > 0) == pytest.approx(0.5, abs=0.05)


# -- variants ------------------------------------------------------------------------------------------------


def by_pad(embodiment: Embodiment, points: int, seed: int, variant: str) -> list[np.ndarray]:
    """Each pad's points and normals, (n, 6)."""
    r = sample_representation(embodiment, points, seed, variant)
    pairs = np.concatenate([r.points_link, r.normals_link], axis=1)
    return [pairs[r.body == embodiment.body_id(pad.body)] for pad in embodiment.end_effector.pads]


@pytest.mark.parametrize("name", END_EFFECTORS)
def test_reduced_points_crowd_around_a_pads_centroid(hand: Callable, name: str) -> None:
    embodiment = hand(name)
    whole, middle = by_pad(embodiment, 2048, 0, "standard"), by_pad(embodiment, 512, 1, "reduced")
    for standard, reduced in zip(whole, middle, strict=True):
        assert 4 * len(reduced) == len(standard)
        points, centroid = standard[:, :3], standard[:, :3].mean(0)
        far, near = (np.linalg.norm(x[:, :3] - centroid, axis=1) for x in (standard, reduced))
        # A quarter of the area: as far as the quarter of the standard's points that is nearest.
        for part in (0.5, 0.9):
            assert np.quantile(near, part) == pytest.approx(np.quantile(far, 0.25 * part), abs=2e-3)
        assert near.max() < 0.65 * far.max()
        # On the pad itself: each has a standard point, with the same normal, beside it.
        apart = np.linalg.norm(reduced[:, None, :3] - points, axis=2)
        assert apart.min(axis=1).max() < 4e-3
        assert ((reduced[:, 3:] * standard[apart.argmin(axis=1), 3:]).sum(1) > 0.7).mean() > 0.95


@settings(max_examples=15, deadline=None)
@given(name=st.sampled_from(["RobotiqThreeFinger", "PandaGripper"]), points=st.integers(4, 40), seed=SEEDS)
def test_dropped_points_are_half_of_each_pads_standard_points(name: str, points: int, seed: int) -> None:
    embodiment = build_embodiment(None, load_end_effector(name))
    whole, half = (by_pad(embodiment, points, seed, variant) for variant in ("standard", "dropped"))
    for standard, dropped in zip(whole, half, strict=True):
        assert 2 * len(dropped) in (len(standard), len(standard) + 1)
        assert len(dropped) > 0
        kept = {tuple(row) for row in dropped}
        assert len(kept) == len(dropped)
        assert kept <= {tuple(row) for row in standard}


@pytest.mark.parametrize("variant", VARIANTS)
def test_variants_are_decided_by_their_seed(hand: Callable, variant: str) -> None:
    embodiment = hand("RobotiqThreeFinger")
    first, again, other = (sample_representation(embodiment, 32, seed, variant).points_link for seed in (3, 3, 4))
    np.testing.assert_array_equal(first, again)
    assert not np.isclose(first, other).any()


def test_the_dropped_points_are_drawn_at_random(hand: Callable) -> None:
    """Not the first half: over seeds, any position in the standard's order is kept as often as any other."""
    embodiment, kept = hand("PandaGripper"), np.zeros(16)
    for seed in range(60):
        whole, half = (by_pad(embodiment, 32, seed, variant)[0] for variant in ("standard", "dropped"))
        kept += (whole[:, None] == half).all(axis=2).any(axis=1)
    assert kept.sum() == 60 * 8
    assert kept.min() > 12
    assert kept.max() < 48


def test_an_unknown_variant_lists_the_valid_ones(hand: Callable) -> None:
    with pytest.raises(CEIError) as error:
        sample_representation(hand("PandaGripper"), 8, 0, "reduce")
    assert "Did you mean 'reduced'? Valid: standard, reduced, dropped." in str(error.value)


@pytest.mark.parametrize("name", END_EFFECTORS)
def test_pads_face_each_other(hand: Callable, name: str) -> None:
    embodiment = hand(name)
    tree, pads = KinematicTree(embodiment), embodiment.end_effector.pads
    representation = sample_representation(embodiment, 64)
    leads = max(pads, key=lambda pad: pad.share)  # the thumb, or one of two equal pads
    thumb = representation.body == embodiment.body_id(leads.body)
    sides = []
    for s in np.linspace(0, 0.9, 10):  # a hand's fingers pass its thumb at the end
        points, normals = representation.place(tree.forward((1 - s) * embodiment.home + s * embodiment.closed))
        mean = [normals[side].mean(0) for side in (thumb, ~thumb)]
        a, b = (n / np.linalg.norm(n) for n in mean)
        apart = points[~thumb].mean(0) - points[thumb].mean(0)
        gap = np.linalg.norm(apart)
        sides.append((a @ b, a @ apart / gap, -b @ apart / gap, gap))
    facing, thumb_towards, fingers_towards, gap = np.array(sides).T
    # Open, each side looks towards the other; on the way they look each other in the face, ever nearer.
    assert thumb_towards[0] > 0.6
    assert fingers_towards[0] > 0.6
    best = facing.argmin()
    assert facing[best] < -0.95
    assert thumb_towards[best] > 0.9
    assert fingers_towards[best] > 0.9
    assert (np.diff(gap)[:7] < 0).all()


def test_the_palmar_direction_can_be_given(hand: Callable) -> None:
    stock = next(p for p in hand("Inspire").end_effector.pads if p.body == "r_index_distal")
    auto = sample_representation(with_pads("Inspire", stock), 64).normals_link.mean(0)
    back = replace(stock, palmar=list(-3 * auto), palmar_cosine=0.9)
    given_back = sample_representation(with_pads("Inspire", back), 64).normals_link
    cosine = given_back @ (-auto / np.linalg.norm(auto))
    assert (cosine > 0.9).all()


def test_extent_keeps_a_part_of_the_length() -> None:
    pad = Pad("r_index_distal", ["r_index_distal_col"])
    whole = pad_mesh(with_pads("Inspire", pad), pad).bounds[:, 1]  # the finger lies along y
    along = {
        extent: sample_representation(with_pads("Inspire", replace(pad, extent=list(extent))), 512).points_link[:, 1]
        for extent in ((0.0, 1.0), (0.0, 0.5), (0.5, 1.0))
    }
    length = whole[1] - whole[0]
    assert np.ptp(along[0.0, 1.0]) > 0.8 * length
    near, far = np.abs(along[0.0, 0.5]), np.abs(along[0.5, 1.0])  # from the joint, wherever the tip points
    assert np.median(far) > np.median(near) + 0.25 * length
    for half in ((0.0, 0.5), (0.5, 1.0)):
        assert np.ptp(along[half]) < 0.6 * length


def test_place_moves_pairs_with_their_links(hand: Callable) -> None:
    embodiment = hand("RobotiqThreeFinger")
    representation, tree = sample_representation(embodiment, 16), KinematicTree(embodiment)
    qpos = np.stack([embodiment.home, embodiment.closed])
    points, normals = representation.place(tree.forward(qpos))
    for t in range(2):
        T = tree.forward(qpos[t])
        for i, body in enumerate(representation.body):
            R, p = T[body, :3, :3], T[body, :3, 3]
            np.testing.assert_allclose(points[t, i], R @ representation.points_link[i] + p, atol=1e-12)
            np.testing.assert_allclose(normals[t, i], R @ representation.normals_link[i], atol=1e-12)


@pytest.mark.parametrize(
    ("pads", "message"),
    [
        ([], "has no finger pads"),
        ([Pad("r_index_tip")], "unknown link of Inspire 'r_index_tip'"),
        ([Pad("r_index_distal", ["nail"])], "unknown geom of pad 'r_index_distal' of Inspire 'nail'"),
        ([Pad("r_palm")], "no joint that moves it differs between `home` and `closed`"),
        ([Pad("r_ring_distal")], "no joint that moves it differs between `home` and `closed`"),
        ([Pad("r_index_distal", extent=[0.5, 0.5])], "`extent` must be"),
        ([Pad("r_index_distal", extent=[-0.1, 0.5])], "`extent` must be"),
        ([Pad("r_index_distal", palmar=[0.0, 0.0, 0.0])], "`palmar` is 'auto' or a direction"),
        ([Pad("r_index_distal", palmar=[1.0, 0.0])], "`palmar` is 'auto' or a direction"),
        ([Pad("r_index_distal", palmar_cosine=1.0)], "almost no surface faces its palmar side"),
    ],
)
def test_pads_that_cannot_be_sampled(pads: list[Pad], message: str) -> None:
    with pytest.raises(CEIError) as error:
        sample_representation(with_pads("Inspire", *pads), 8)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_an_arm_alone_has_no_pads() -> None:
    with pytest.raises(CEIError, match="no finger pads"):
        sample_representation(build_embodiment(load_arm("Panda"), None), 8)


def test_pads_of_a_hand_nobody_catalogued(tmp_path: Path) -> None:
    """Two paddles that close like a book: palmar sides are known by construction."""
    paddle = """<body name="{name}" pos="0 {y} 0"><joint name="{name}" axis="1 0 0" range="-1.5 1.5"/>
      <geom type="box" size="0.01 0.002 0.03" pos="0 0 0.05"/></body>"""
    path = tmp_path / "book.xml"
    path.write_text(
        '<mujoco><compiler angle="radian"/><worldbody><body name="root"><geom size="0.01"/>'
        f"{paddle.format(name='left', y=-0.05)}{paddle.format(name='right', y=0.05)}"
        "</body></worldbody></mujoco>"
    )
    spec = EndEffectorSpec("Book", str(path), [Pad("left"), Pad("right")], closed={"left": -0.5, "right": 0.5})
    representation = sample_representation(build_embodiment(None, spec), 40)
    # Turning by -0.5 about x moves the left paddle's points (z > 0) towards +y.
    side = np.where(representation.body == representation.body[0], 1.0, -1.0)
    np.testing.assert_allclose(representation.normals_link, side[:, None] * [0, 1, 0], atol=1e-9)
    np.testing.assert_allclose(representation.points_link[:, 1], 0.002 * side, atol=1e-9)


@pytest.mark.parametrize("end_effector", END_EFFECTORS)
@pytest.mark.parametrize("frames", [False, True])
def test_the_picture_of_pads_has_all_of_the_hand(end_effector: str, frames: bool) -> None:
    embodiment = build_embodiment(None, load_end_effector(end_effector))
    representation = sample_representation(embodiment, 16)
    for qpos in (embodiment.home, embodiment.closed):
        picture = draw_representation(representation, qpos, frames).astype(int)
        drawn = np.abs(picture - picture[0, 0]).max(axis=2) > 12
        reach = []
        for view in np.split(drawn, 3, axis=1):
            assert not (view[[0, -1]].any() or view[:, [0, -1]].any())
            rows, columns = np.nonzero(view)
            reach.append(max(np.ptp(rows) / view.shape[0], np.ptp(columns) / view.shape[1]))
        assert max(reach) > 0.8  # and nothing much beside it
