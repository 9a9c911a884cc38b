import math

import numpy as np
import pytest

from minitouch_bench.metrics.student import incomplete_beta, student_two_sided


@pytest.mark.parametrize(
    ("df", "quantile", "tail"),
    [
        (1, 12.7062047364, 0.05),  # tables of Student's t
        (2, 4.30265272991, 0.05),
        (10, 2.22813885196, 0.05),
        (99, 1.98421695159, 0.05),
        (5, 6.86882663, 0.001),
        (30, 2.74999565, 0.01),
    ],
)
def test_quantiles_of_the_tables(df, quantile, tail):
    found = student_two_sided(np.array([quantile, -quantile]), np.array([df, df], float))
    assert found == pytest.approx(tail, abs=1e-8)


def test_the_ends():
    t, df = np.array([0.0, np.inf, -np.inf]), np.array([3.0, 3.0, 1.0])
    assert student_two_sided(t, df).tolist() == [1.0, 0.0, 0.0]


def test_many_degrees_of_freedom_are_the_normal_distribution():
    found = student_two_sided(np.array([1.959963984540054]), np.array([np.inf]))
    assert found == pytest.approx(0.05, abs=1e-7)


def test_one_degree_of_freedom_is_the_cauchy_distribution():
    t = np.linspace(0.01, 50, 200)
    expected = 1 - 2 / np.pi * np.arctan(t)
    assert student_two_sided(t, np.ones_like(t)) == pytest.approx(expected, abs=1e-10)


@pytest.mark.parametrize("x", [0.001, 0.2, 0.5, 0.83, 0.9999])
def test_the_incomplete_beta_function_where_it_has_a_closed_form(x):
    arcsine = 2 / math.pi * math.asin(math.sqrt(x))
    assert incomplete_beta(np.array([0.5]), 0.5, np.array([x]))[0] == pytest.approx(arcsine)
    power = 1 - (1 - x) ** 3.7
    assert incomplete_beta(np.array([1.0]), 3.7, np.array([x]))[0] == pytest.approx(power)
    binomial = sum(math.comb(41, j) * x**j * (1 - x) ** (41 - j) for j in range(40, 42))
    assert incomplete_beta(np.array([40.0]), 2.0, np.array([x]))[0] == pytest.approx(binomial)
