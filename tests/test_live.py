"""Contact carried over live: what whole trajectories do with all frames at hand, frame by frame."""

import numpy as np
import pytest
from problems import problem_of
from test_grasp import CONTACT, DT_S, FRAMES, HELD, OPTIONS, SOURCE, TARGETS, followed, source_qpos, with_pads

from cei_gym.alignment.contact.live import LiveGrasp
from cei_gym.alignment.contact.refine import GraspRefiner
from cei_gym.demonstration import Demonstration, Scene
from cei_gym.embodiment import load_embodiment
from cei_gym.transfer import Transfer

WORKSPACE = np.array([[0.2, -0.5, 0.0], [0.9, 0.5, 0.6]])


@pytest.mark.parametrize("name", TARGETS)
def test_frame_by_frame_it_is_the_trajectory(name: str) -> None:
    motion, free = followed(name)
    refiner = GraspRefiner(problem_of(name), OPTIONS, CONTACT)
    whole = refiner.refine(motion, free)
    live = LiveGrasp(refiner, (motion, free), DT_S)
    for _ in range(2):
        before = free.u[[0, *range(FRAMES - 1)]]
        grips = [motion.grip.at(np.array([t])) for t in range(FRAMES)]
        u = [live(*frame) for frame in zip(grips, before, free.u, strict=True)]
        np.testing.assert_allclose(u, whole.u, atol=1e-9)
        live.reset()


@pytest.fixture(scope="module")
def demonstration() -> Demonstration:
    """A Panda that closes on 36 mm and carries it, told to close all the way."""
    qpos = source_qpos()
    action = qpos.copy()
    action[HELD - 3 :, 7:] = 0.0
    return Demonstration(SOURCE, 1 / DT_S, qpos, action, Scene(np.eye(4), (), WORKSPACE))


def test_a_stream_that_is_told_what_the_source_is_told_holds_as_the_source_does(demonstration: Demonstration) -> None:
    transfer = Transfer(load_embodiment(SOURCE), load_embodiment("UR5e-FourierRight"))
    transfer.fit([demonstration])
    whole, _ = transfer(demonstration, clouds=False)
    live = transfer.stream(dt_s=DT_S)
    told = np.array([live(q, a) for q, a in zip(demonstration.qpos, demonstration.action, strict=True)])
    live.reset()
    untold = np.array([live(q) for q in demonstration.qpos])
    hand = transfer.target.n_arm
    # fingers that hold stay as they are, and as those of the whole trajectory; of what nobody tells, nothing is known to be held
    carried = slice(HELD + 2, FRAMES)
    assert np.ptp(told[carried, hand:], axis=0).max() < 0.02
    assert np.ptp(told[carried, hand:], axis=0).max() < 0.5 * np.ptp(untold[carried, hand:], axis=0).max()
    assert np.abs(told - whole.qpos)[carried].max() < 0.1


def test_a_target_whose_pads_do_not_close_on_each_other_follows_them(demonstration: Demonstration) -> None:
    one_sided = with_pads("IIWA-Inspire", [1, 2]).embodiment  # two fingers without their thumb
    transfer = Transfer(load_embodiment(SOURCE), one_sided)
    transfer.fit([demonstration])
    live = transfer.stream(dt_s=DT_S)
    told = np.array([live(q, a) for q, a in zip(demonstration.qpos[:6], demonstration.action, strict=False)])
    live.reset()
    np.testing.assert_array_equal(told, [live(q) for q in demonstration.qpos[:6]])
