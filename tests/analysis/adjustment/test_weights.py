"""Every weight function: one loss, its slope, its weight, and its constants at the normal law."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.stats import norm

from analysis.adjustment.weights import (
    IGG1,
    IGG3,
    WEIGHT_FUNCTIONS,
    Bisquare,
    Danish,
    Hampel,
    Huber,
)

FUNCTIONS = [
    *WEIGHT_FUNCTIONS.values(),
    IGG3(1.5, 3.0),
    IGG3(1.1, 2.9, power=2),
    IGG3(2, 6, power=2),
    Hampel(1.5, 1.5, 2.5),
]
every_function = pytest.mark.parametrize("function", FUNCTIONS, ids=repr)

STEP = 1e-6


def away_from_kinks(function):
    """Residuals of both signs, inside and outside the support, none within 1e-4 of a kink."""
    u = np.linspace(-9.0, 9.0, 3001)
    distance = np.abs(np.abs(u)[:, None] - np.array(function.kinks))
    return u[distance.min(axis=1) > 1e-4]


def slope(f, u):
    return (f(u + STEP) - f(u - STEP)) / (2 * STEP)


def normal_mean(function, f):
    """E[f(u)] of an even f by Gauss-Legendre panels between the kinks: independent of the module's
    quadrature.
    """
    edges = np.unique([0.0, 1.0, 2.0, 4.0, 6.0, 9.0, 12.0, *function.kinks])
    nodes, weights = np.polynomial.legendre.leggauss(40)
    half = np.diff(edges)[:, None] / 2
    u = edges[:-1, None] + half * (1 + nodes)
    return 2 * np.sum(half * weights * f(u) * norm.pdf(u))


@every_function
def test_psi_is_the_slope_of_rho(function):
    u = away_from_kinks(function)
    np.testing.assert_allclose(function.psi(u), slope(function.rho, u), rtol=0, atol=2e-8)


@every_function
def test_weight_is_psi_over_u(function):
    u = away_from_kinks(function)
    u = u[u != 0]
    np.testing.assert_allclose(function.weight(u), function.psi(u) / u, rtol=1e-15, atol=0)


@every_function
def test_symmetry(function):
    u = np.append(away_from_kinks(function), function.kinks)
    for even in (function.rho, function.weight):
        np.testing.assert_array_equal(even(-u), even(u))
    np.testing.assert_array_equal(function.psi(-u), -function.psi(u))


@every_function
def test_weight_falls_from_one_and_loss_grows_from_zero(function):
    u = np.sort(
        np.concatenate(
            [np.linspace(0.0, 9.0, 9001), function.kinks, np.nextafter(function.kinks, 0)]
        )
    )
    weight, rho = function.weight(u), function.rho(u)
    assert weight[0] == 1 and rho[0] == 0
    assert np.all(np.diff(weight) <= 0) and np.all(weight >= 0)
    assert np.all(np.diff(rho) >= -1e-14)
    np.testing.assert_allclose(function.rho(1e-3), 0.5e-6, rtol=1e-6)


@every_function
def test_weight_ends_at_the_last_threshold_or_nowhere(function):
    if isinstance(function, Huber | Danish):
        assert function.weight(10.0) > 0
    else:
        last = function.kinks[-1]
        beyond = np.array([1.0, 1 + 1e-15, 2.0, 1e300, math.inf]) * last
        for f in (function.weight, function.psi):
            np.testing.assert_array_equal(f(np.concatenate([beyond, -beyond])), 0)
        np.testing.assert_array_equal(function.rho(beyond), function.rho(last))
        assert function.weight(last * (1 - 1e-7)) > 0
    assert function.weight(math.inf) == 0


@every_function
def test_rho_is_continuous_and_psi_jumps_only_in_igg1(function):
    for kink in function.kinks:
        below, above = kink - 1e-9, kink + 1e-9
        assert abs(function.rho(above) - function.rho(below)) < 1e-8
        jump = function.psi(above) - function.psi(below)
        expected = -function.k0 if isinstance(function, IGG1) and kink == function.k1 else 0.0
        assert jump == pytest.approx(expected, abs=1e-7)


@every_function
def test_shapes_types_and_extremes_without_a_warning_and_without_a_change(function):
    u = np.array([[0.0, -0.0, 1.0, 5e-324], [math.inf, -math.inf, 1e300, math.nan]])
    before = u.copy()
    with np.errstate(all="raise", under="ignore"):
        for f in (function.rho, function.psi, function.weight):
            value = f(u)
            assert value.shape == u.shape
            np.testing.assert_array_equal(np.isnan(value), np.isnan(u))
            np.testing.assert_array_equal(f([0, 1, -2]), f(np.array([0.0, 1.0, -2.0])))
            np.testing.assert_array_equal(f(np.float32([1.75, 2.25])), f(np.array([1.75, 2.25])))
            assert isinstance(f(1.75), float) and f(1.75) == f(np.array([1.75]))[0]
            assert f(np.empty((0, 3))).shape == (0, 3)
    np.testing.assert_array_equal(u, before)


@every_function
def test_constants_by_another_quadrature(function):
    exact = dict(rel=1e-10, abs=1e-10)
    assert function.mean_weight == pytest.approx(normal_mean(function, function.weight), **exact)
    assert function.mean_psi_squared == pytest.approx(
        normal_mean(function, lambda u: function.psi(u) ** 2), **exact
    )
    # Stein's lemma: E[uψ] is the mean slope together with the jumps, at +k and at −k.
    assert function.mean_psi_prime == pytest.approx(
        normal_mean(function, lambda u: u * function.psi(u)), **exact
    )
    assert function.efficiency == pytest.approx(
        function.mean_psi_prime**2 / function.mean_psi_squared
    )
    assert function.efficiency < 1


@every_function
def test_consistency_factor_recovers_the_variance(function):
    errors = 0.003 * np.random.default_rng(20170526).standard_normal(400_000)
    weight = function.weight(errors / 0.003)
    variance = np.sum(weight * errors**2) / np.sum(weight)
    assert variance / function.consistency_factor == pytest.approx(0.003**2, rel=0.01)
    assert variance < 0.99 * 0.003**2


@pytest.mark.parametrize(
    (
        "function",
        "mean_weight",
        "mean_psi_prime",
        "mean_psi_squared",
        "efficiency",
        "consistency_factor",
    ),
    [
        (IGG3(1.5, 2.5, 1), 0.9351, 0.6846, 0.6121, 0.766, 0.7321),
        (IGG3(1.5, 2.5, 2), 0.9197, 0.6294, 0.5689, 0.696, 0.6843),
        (IGG3(1.5, 3.0, 1), 0.9467, 0.7355, 0.6479, 0.835, 0.7768),
        (IGG3(2.0, 3.0, 1), 0.9810, 0.8689, 0.8292, 0.910, 0.8857),
        (IGG3(2.0, 6.0, 2), 0.9875, 0.9132, 0.8674, 0.962, 0.9248),
        (IGG3(2.5, 5.0, 1), 0.9974, 0.9752, 0.9599, 0.991, 0.9777),
    ],
)
def test_tabulated_constants_of_igg3(
    function, mean_weight, mean_psi_prime, mean_psi_squared, efficiency, consistency_factor
):
    assert round(function.mean_weight, 4) == mean_weight
    assert round(function.mean_psi_prime, 4) == mean_psi_prime
    assert round(function.mean_psi_squared, 4) == mean_psi_squared
    assert round(function.efficiency, 3) == efficiency
    assert round(function.consistency_factor, 4) == consistency_factor


def test_constants_of_huber_in_closed_form():
    for c in (0.01, 1.345, 3.0):
        huber, inside = Huber(c), 2 * norm.cdf(c) - 1
        assert huber.mean_psi_prime == pytest.approx(inside, abs=1e-12)
        assert huber.mean_psi_squared == pytest.approx(
            inside - 2 * c * norm.pdf(c) + 2 * c**2 * norm.sf(c), abs=1e-12
        )


def test_published_efficiencies_and_limits():
    assert Huber(1.345).efficiency == pytest.approx(0.95, abs=1e-5)
    assert Bisquare(4.685).efficiency == pytest.approx(0.95, abs=1e-5)
    assert Huber(1e-6).efficiency == pytest.approx(2 / math.pi, rel=1e-5)  # the median
    # least squares
    for wide in (
        IGG3(50, 90),
        IGG1(50, 90),
        Huber(1e3),
        Hampel(50, 60, 90),
        Bisquare(1e6),
        Danish(1e3),
    ):
        assert wide.efficiency == pytest.approx(1, abs=1e-10)
        assert wide.consistency_factor == pytest.approx(1, abs=1e-10)


@pytest.mark.parametrize("power", [1, 2])
def test_igg3_is_exact_at_its_thresholds(power):
    """No rounding blurs who is untouched and who is rejected, whatever the thresholds."""
    random = np.random.default_rng(1)
    for k0, width in random.uniform(0.1, 3.0, (200, 2)):
        igg3 = IGG3(k0, k0 + width, power)
        assert igg3.weight(k0) == igg3.weight(np.nextafter(k0, 0)) == 1
        assert igg3.weight(igg3.k1) == 0 < igg3.weight(np.nextafter(igg3.k1, 0))
        u = random.uniform(k0, igg3.k1, 50)
        np.testing.assert_allclose(
            igg3.weight(u), k0 / u * ((igg3.k1 - u) / (igg3.k1 - k0)) ** power, rtol=1e-12
        )


def test_relatives():
    """As printed, IGG III is Hampel's function with a = b; IGG I is Huber's up to its rejection
    point.
    """
    u = np.linspace(-4, 4, 801)
    for name in ("rho", "psi", "weight"):
        printed, hampel = (
            getattr(IGG3(1.5, 2.5, 1), name)(u),
            getattr(Hampel(1.5, 1.5, 2.5), name)(u),
        )
        np.testing.assert_allclose(printed, hampel, rtol=0, atol=1e-14)
        inside = u[np.abs(u) < 2.5]
        np.testing.assert_allclose(
            getattr(IGG1(1.5, 2.5), name)(inside),
            getattr(Huber(1.5), name)(inside),
            rtol=0,
            atol=1e-14,
        )


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf, -math.inf])
@every_function
def test_every_bad_threshold_is_refused(function, value):
    for field in dataclasses.fields(function):
        if field.name == "power":
            continue
        with pytest.raises(
            ValueError,
            match=rf"expected 0 < .*, got {type(function).__name__}\(.*{field.name}={value}",
        ):
            dataclasses.replace(function, **{field.name: value})


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: IGG3(2.5, 1.5),
            r"expected 0 < k0 < k1 < ∞ and power 1 or 2, got IGG3\(k0=2.5, k1=1.5, power=1\)",
        ),
        (lambda: IGG3(2.5, 2.5), r"k0 < k1 .* got IGG3\(k0=2.5, k1=2.5"),
        (lambda: IGG3(power=3), r"power 1 or 2, got .*power=3"),
        (lambda: IGG3(power=1.5), r"power 1 or 2, got .*power=1.5"),
        (lambda: IGG1(2.5, 2.5), r"k0 < k1 .* got IGG1\(k0=2.5, k1=2.5"),
        (lambda: Hampel(3, 2, 5), r"a ≤ b < c .* got Hampel\(a=3, b=2, c=5"),
        (lambda: Hampel(1, 2, 2), r"a ≤ b < c .* got Hampel\(a=1, b=2, c=2"),
    ],
)
def test_thresholds_out_of_order_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
