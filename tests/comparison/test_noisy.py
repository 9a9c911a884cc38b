"""A policy made worse on purpose is caught in the real simulator; one that is not passes."""

import pytest

from minitouch_bench.comparison.gate import Decision
from tests.comparison.noisy import STRENGTHS, Variant, judged, play, report

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1500)]

EPISODES = 20
ENOUGH = 80
"""Episodes a task that exclude a loss of 5 points where no outcome changes: 73."""


@pytest.fixture(scope="module")
def baseline():
    return play(Variant(0.0), "scripted", EPISODES)


@pytest.mark.parametrize("noise", STRENGTHS)
def test_noise_on_the_actions_is_caught(baseline, noise):
    candidate = play(Variant(noise), f"noise {noise}", EPISODES)
    report(baseline, candidate)
    result = judged(baseline, candidate)
    assert (result.decision, result.exit_code) == (Decision.REGRESSION, 1)


def test_half_precision_is_no_regression():
    base, half = play(Variant(0.0), "scripted", ENOUGH), play(Variant(), "half", ENOUGH)
    report(base, half)
    assert base.digest != half.digest
    result = judged(base, half)
    assert result.exit_code == 0
    assert not result.identical


def test_no_noise_has_the_same_bits(baseline):
    result = judged(baseline, play(Variant(0.0), "again", EPISODES))
    assert result.identical
    assert result.exit_code == 0
