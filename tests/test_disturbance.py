"""Mistakes that the oracle is made to recover from."""

import numpy as np
import pytest

from envs.disturbance import BURST_SIZE, BURST_STEPS, Disturbance

LABEL = np.array([0.01, -0.02])


def disturbed(kind, steps=2000):
    disturbance = Disturbance(kind, 0.03, np.random.default_rng(0))
    executed, restarts = zip(*(disturbance(LABEL) for _ in range(steps)), strict=True)
    return np.array(executed), np.array(restarts)


def test_clean_demonstrations_execute_the_label():
    executed, restarts = disturbed("clean")
    assert (executed == LABEL).all() and not restarts.any()


def test_noise_hits_one_step_in_five_and_has_no_direction():
    executed, restarts = disturbed("noise")
    hit = (executed != LABEL).any(axis=1)
    assert hit.mean() == pytest.approx(0.2, abs=0.03)
    assert np.abs((executed - LABEL)[hit].mean(axis=0)).max() < 0.002
    assert not restarts.any()


@pytest.mark.parametrize("kind", ["bursts", "wide"])
def test_bursts_go_wrong_for_a_few_steps_and_no_farther_than_they_should(kind):
    executed, restarts = disturbed(kind)
    wrong = np.linalg.norm(executed - LABEL, axis=1)
    assert wrong.max() <= BURST_SIZE[1] + np.linalg.norm(LABEL) + 5 * 0.008
    assert 0.3 < restarts.sum() / (0.03 * 2000 / (1 + 0.03 * np.mean(BURST_STEPS))) < 1.1


def test_the_same_generator_gives_the_same_mistakes():
    assert np.array_equal(disturbed("bursts")[0], disturbed("bursts")[0])
