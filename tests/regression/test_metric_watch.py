import math

import numpy as np
import pytest

from minitouch_bench.regression.differences import Discordance
from minitouch_bench.regression.metric_watch import (
    evidence_of_loss,
    evidence_of_no_loss,
    evidence_of_worsening,
    share_sequence,
)


def expected_wealth(evidence, rates, margin):
    """The mean wealth after one episode, over the three ways it can end."""
    lost, won = rates
    ways = ((lost, Discordance(1, 1, 0)), (won, Discordance(1, 0, 1)))
    total = (1 - lost - won) * math.exp(evidence(Discordance(1, 0, 0), margin))
    return total + sum(chance * math.exp(evidence(found, margin)) for chance, found in ways)


@pytest.mark.parametrize("margin", [0.0, 0.05, 0.2])
@pytest.mark.parametrize("differing", [0.25, 0.6])
def test_a_bet_is_fair_at_the_margin_and_loses_where_the_hypothesis_holds(margin, differing):
    at = ((differing + margin) / 2, (differing - margin) / 2)
    better, worse = (at[0] - 0.01, at[1] + 0.01), (at[0] + 0.01, at[1] - 0.01)
    for evidence, within in ((evidence_of_loss, better), (evidence_of_no_loss, worse)):
        assert expected_wealth(evidence, at, margin) == pytest.approx(1.0)
        assert expected_wealth(evidence, within, margin) < 1.0


def test_signs_are_a_fair_bet_whatever_the_sizes():
    sizes = np.array([3.0, 0.0, 80.0, 1.0, 20.0])
    choices = (np.arange(32)[:, None] >> np.arange(5) & 1) * 2 - 1
    wealth = [math.exp(evidence_of_worsening(signs * sizes)) for signs in choices]
    assert np.mean(wealth) == pytest.approx(1.0)
    assert max(wealth) == wealth[31] > 3


def test_nothing_seen_is_no_evidence():
    assert evidence_of_worsening(np.zeros(9)) == 0.0
    assert evidence_of_loss(Discordance(9, 0, 0)) == 0.0
    assert evidence_of_no_loss(Discordance(9, 0, 0), 0.1) > 0.0


def test_a_sequence_holds_the_difference_and_narrows():
    widths = []
    for n in (30, 100, 400):
        found = share_sequence(Discordance(n, n // 5, n // 10), 0.05)
        assert found.low < found.value < found.high
        assert found.value == pytest.approx(0.1)
        assert found.low >= -1
        assert found.high <= 1
        widths.append(found.high - found.low)
    assert widths == sorted(widths, reverse=True)


def test_the_ends_of_a_share_s_sequence_are_where_the_evidence_is_enough():
    found = Discordance(60, 20, 3)
    ends = share_sequence(found, 0.05)
    assert evidence_of_loss(found, ends.low) == pytest.approx(math.log(40), abs=1e-3)
    turned = Discordance(60, 3, 20)
    assert evidence_of_loss(turned, -ends.high) == pytest.approx(math.log(40), abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("rates", [(0.1, 0.1), (0.2, 0.05), (0.02, 0.02)])
def test_a_share_s_sequence_holds_at_every_look(rates):
    rng, trials, truth = np.random.default_rng(1), 400, rates[0] - rates[1]
    missed = 0
    for _ in range(trials):
        drawn = rng.choice([1, -1, 0], 100, p=(*rates, 1 - sum(rates)))
        lost, won = np.cumsum(drawn == 1), np.cumsum(drawn == -1)
        looks = (Discordance(n + 1, int(lost[n]), int(won[n])) for n in range(100))
        missed += any(
            max(
                evidence_of_loss(f, truth),
                evidence_of_loss(Discordance(f.n, f.won, f.lost), -truth),
            )
            >= math.log(40)
            for f in looks
        )
    print(f"{rates}: missed in {missed} of {trials}")
    assert missed / trials <= 0.05
