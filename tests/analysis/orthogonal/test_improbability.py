"""The number of false alarms of a band of points around a surface."""

from math import comb, log

import numpy as np
import pytest

from analysis.orthogonal.improbability import least_log_nfa, spread


@pytest.mark.parametrize(("n", "m"), [(6, 4), (12, 3), (40, 5)])
def test_formula(n, m):
    d = np.sort(np.random.default_rng(n).uniform(0.0, 2.0, n))
    nfa = [
        (n - m) * comb(n, k) * comb(k, m) * min(1.0, d[k - 1] / 1.5) ** (k - m)
        for k in range(m + 2, n + 1)
    ]
    L, k = least_log_nfa(d, m, 1.5)
    np.testing.assert_allclose(L, log(min(nfa)), atol=1e-9)
    assert k == m + 2 + np.argmin(nfa)


@pytest.mark.parametrize("n", [6, 30, 200])
def test_chance_makes_no_more_bands_than_stated(n):
    """Points on a circle of length 2: the distances from each are even on (0, 1), and m = 1."""
    draws = 400
    x = np.random.default_rng([1, n]).uniform(0.0, 2.0, (draws, n))
    apart = np.abs(x[:, :, None] - x[:, None, :])
    d = np.sort(np.minimum(apart, 2.0 - apart), axis=-1)
    L, _ = least_log_nfa(d, 1, 1.0)
    for nfa in (1.0, 0.1):
        found = np.count_nonzero(np.log(nfa) >= L, axis=-1)
        assert found.mean() <= nfa + 3 * found.std() / np.sqrt(draws)


def test_the_band_holds_the_points_on_the_surface():
    rng = np.random.default_rng(3)
    for share in (0.1, 0.3, 0.6, 0.9):
        on = round(1000 * share)
        d = np.r_[1e-3 * np.abs(rng.standard_normal(on)), rng.uniform(0.0, 1.0, 1000 - on)]
        L, k = least_log_nfa(np.sort(d), 4, 1.0)
        assert L < -100 and abs(k - on) < 0.15 * on


def test_without_surface():
    L, _ = least_log_nfa(np.array([[np.nan] * 10, np.linspace(0.0, 1.0, 10)]), 4, np.ones(2))
    assert L[0] == np.inf and np.isfinite(L[1])
    L, _ = least_log_nfa(np.zeros(20), 4, 1.0)  # exact points
    assert np.isfinite(L) and L < -300


def test_stack_and_scale():
    d = np.sort(np.random.default_rng(5).exponential(size=(3, 2, 30)), axis=-1)
    scale = np.array([1.0, 2.0, 3.0])
    L, k = least_log_nfa(d, 3, scale[:, None])
    for i in range(3):
        for j in range(2):
            one, its_k = least_log_nfa(1e3 * d[i, j], 3, 1e3 * scale[i])
            np.testing.assert_allclose(L[i, j], one)
            assert k[i, j] == its_k


def test_spread_of_a_cloud():
    rng = np.random.default_rng(7)
    D = rng.standard_normal((2, 501, 3))
    np.testing.assert_allclose(spread(10 + 4 * D), 4 * spread(D))
    D[:, :200] += 1e6  # two fifths far away
    assert (spread(D) < 5).all()
