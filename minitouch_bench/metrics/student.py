"""Two-sided p-values of Student's t, without a statistics package."""

import math

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

MAX_TERMS = 300
PRECISION = 1e-12
TINY = 1e-300
"""Stands for 0 in a denominator of the continued fraction."""


def student_two_sided(t: Floats, df: Floats) -> Floats:
    """Return P(|T| >= |t|) of Student's distribution with ``df`` degrees of freedom, elementwise.

    t infinite gives 0; df infinite is treated as 1e9, where it is the normal distribution.

    Source: M. Abramowitz and I. A. Stegun, "Handbook of mathematical functions" (1964), 26.7.1
    with 26.5.1: the incomplete beta function I_x(df/2, 1/2) at x = df / (df + t²).
    """
    freedom = np.minimum(df, 1e9)
    with np.errstate(over="ignore"):
        x = np.where(np.isinf(t), 0.0, freedom / (freedom + t * t))
    return incomplete_beta(freedom / 2, 0.5, x)


def incomplete_beta(a: Floats, b: float, x: Floats) -> Floats:
    """Return the regularised incomplete beta function I_x(a, b), elementwise, to 1e-10.

    Source: Abramowitz and Stegun 26.5.8, a continued fraction, evaluated by the method of
    W. J. Lentz, Appl. Opt. 15 (1976); the symmetry 26.5.2 keeps it where it converges fast.
    """
    a, x = np.broadcast_arrays(np.asarray(a, np.float64), np.asarray(x, np.float64))
    ends = (x <= 0) | (x >= 1)
    inner = np.where(ends, 0.5, x)
    swapped = inner > (a + 1) / (a + b + 2)
    one, other = np.where(swapped, b, a), np.where(swapped, a, b)
    at = np.where(swapped, 1 - inner, inner)
    gamma = np.vectorize(math.lgamma, otypes=[np.float64])
    front = np.exp(
        gamma(a + b) - gamma(a) - math.lgamma(b) + one * np.log(at) + other * np.log1p(-at)
    )
    value = front * _fraction(one, other, at) / one
    value = np.where(swapped, 1 - value, value)
    return np.where(ends, np.clip(x, 0.0, 1.0), np.clip(value, 0.0, 1.0))


def _fraction(a: Floats, b: Floats, x: Floats) -> Floats:
    """Evaluate the continued fraction of the incomplete beta function."""
    c, d = np.ones_like(x), _reciprocal(1 - (a + b) * x / (a + 1))
    value = d.copy()
    for m in range(1, MAX_TERMS):
        even = m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m))
        odd = -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1))
        for step in (even, odd):
            d, c = _reciprocal(1 + step * d), _away(1 + step / c)
            change = c * d
            value *= change
        if np.all(np.abs(change - 1) < PRECISION):
            break
    return value


def _away(value: Floats) -> Floats:
    return np.where(np.abs(value) < TINY, TINY, value)


def _reciprocal(value: Floats) -> Floats:
    return 1 / _away(value)
