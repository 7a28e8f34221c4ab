"""Reliability: redundancy of each point, smallest error that is noticed, effect of one that is not.

All follows from the fit of distances ``d_i`` with normal matrix ``N = Σ ω J Jᵀ/v``, J = ∂d/∂x, v
the cofactor of the distance, ω the weight factor of the fit. With ``g_i = J_iᵀN⁻¹J_i/v_i``:

    r_i = 1 − ω_i g_i                                            redundancy number, Σ r = n − t
    q_i = 1 − 2 ω_i g_i + J_iᵀN⁻¹ (Σ ω² J Jᵀ/v) N⁻¹J_i/v_i       variance of d_i over σ²v_i
    u_i = d_i/(σ √(v_i q_i))                                     standardised residual
    MDB_i = δ0 σ √(v_i q_i)/r_i                                  minimal detectable bias, along n
    ∇x_i = −N⁻¹ J_i ω_i/v_i · MDB_i                              external reliability: effect on x

Where ω is 1, q = r and these are Baarda's; where ω is 0 the point has no part in the fit, q = 1 + g
is the variance of a prediction, and ∇x = 0. Everything is O(n), so that a million points take about
as long as fitting them.

References
----------
Baarda (1968), A testing procedure for use in geodetic networks, Neth. Geodetic Commission 2 (5).
Benjamini & Hochberg (1995), Journal of the Royal Statistical Society B 57, 289-300.
Pope (1976), The statistics of residuals and the detection of outliers, NOAA TR NOS 65 NGS 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from ..adjustment.linalg import solve
from ..blocks import point_pieces
from ..checks import check_one_of, check_positive, point_array
from ..result import Array, Fit
from .cloud import a_priori
from .gauss_helmert import linearised
from .observations import Observations

METHODS = ("eiv", "geometric", "robust")  # whose σ0 is that of the distances
CORRECTIONS = ("none", "bonferroni", "fdr")


@dataclass(frozen=True, eq=False)
class Reliability:
    """Reliability of each point of a fit; every field has the leading axes of a stack of fits.

    redundancy : (…, n) between 0 (nothing checks the point) and 1; the sum is n − t
    standardised : (…, n) residuals over their standard deviations, N(0, 1) for good points
    p_values : (…, n) probability of so large a standardised residual, either sign, for a good point
    minimal_bias : (…, n) m; the error along the normal that a test at level α0 finds with the given
        power
    external : (…, n, t) m; change of each parameter by an error of that size, outwards
    """

    redundancy: Array
    standardised: Array
    p_values: Array
    minimal_bias: Array
    external: Array

    def suspects(self, alpha: float = 0.05, correction: str = "bonferroni") -> np.ndarray:
        """(…, n) bool: points whose test fails on the final fit, all tested at once.

        Parameters
        ----------
        correction : for the number of tests, n of each fit:
            ``none``: every test at level alpha, so alpha·n good points fail;
            ``bonferroni``: any good point fails with probability alpha at most;
            ``fdr``: of the points that fail, a share of alpha is good on average (Benjamini &
            Hochberg 1995).

        >>> none, p = np.array([]), np.array([0.9, 0.02, 0.001, 0.3])
        >>> found = Reliability(none, none, p, none, none)
        >>> [int(found.suspects(0.05, correction).sum()) for correction in CORRECTIONS]
        [2, 1, 2]
        """
        alpha, p = _probability(alpha, "alpha"), self.p_values
        n = p.shape[-1]
        if check_one_of(correction, CORRECTIONS, "correction") == "fdr":
            ordered = np.sort(p, axis=-1)
            below = ordered <= alpha * np.arange(1, n + 1) / n
            return p <= np.max(np.where(below, ordered, -1.0), axis=-1, keepdims=True)
        return p <= (alpha / n if correction == "bonferroni" else alpha)


def reliability(
    fit: Fit,
    points,
    *,
    weights=None,
    cofactors=None,
    sigma=None,
    alpha0: float = 0.001,
    power: float = 0.8,
) -> Reliability:
    """Redundancy numbers, standardised residuals, minimal detectable biases, external reliability.

    Parameters
    ----------
    fit : by ``eiv``, ``geometric`` or ``robust``, radius free or fixed.
    points, weights, cofactors : as given to the fit.
    sigma : the standard deviation at cofactor 1 where it is known beforehand; then u is tested as
        N(0, 1). None takes 1 for a fit with ``absolute`` cofactors, and else the fit's σ0, so that
        u is tested as Pope's τ for a point in use, whose own residual is in σ0, and as Student's t
        for one that is not.
    alpha0, power : level of the single test and its power against the minimal bias.

    Raises
    ------
    ValueError for a fit by another method (its residuals are no distances), shapes that do not
    belong together, probabilities outside (0, 1) and a non-positive sigma.

    Example
    -------
    >>> from analysis.methods import fit_sphere
    >>> directions = np.random.default_rng(7).standard_normal((500, 3))
    >>> points = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    >>> points += 0.003 * np.random.default_rng(8).standard_normal((500, 3))
    >>> points[[11, 52]] *= 0.95
    >>> found = reliability(fit_sphere(points), points)
    >>> np.flatnonzero(found.suspects()).tolist()
    [11, 52]
    >>> print(f"{found.redundancy.sum():.6f} {found.minimal_bias.max():.3f}")
    496.000000 0.013

    Source: Baarda 1968; Pope 1976.
    """
    check_one_of(fit.method, METHODS, "method of the fit")
    model, x, derivative = fit.surface()
    t, count = model.degrees, len(x)
    lead, n = fit.distances.shape[:-1], fit.distances.shape[-1]
    array = point_array(points, model.dimension, n, "this fit")
    if array.shape[:-1] != lead + (n,):
        raise ValueError(
            f"points: expected those of the fit, of shape {lead + (n, model.dimension)}, "
            f"got {array.shape}"
        )
    delta = noncentrality(alpha0, power)
    if fit.absolute and sigma is None:
        sigma = 1.0
    sigma_0 = np.broadcast_to(
        fit.sigma_0 if sigma is None else check_positive(sigma, "sigma"), lead
    ).reshape(-1, 1)
    omega = fit.weights.reshape(-1, n)
    weights, cofactors = a_priori(weights, cofactors, array.shape)
    if cofactors is None:
        cofactors = np.ones((1, 1)) if weights is None else 1.0 / weights
    points = array.reshape((count,) + array.shape[-2:])
    origin, length = np.zeros((count, model.dimension)), np.ones(count)
    data = Observations.of(points, origin, length, cofactors)

    def blocks():
        """Weights, distances, Jacobian and variances of the distances, so many points at a time."""
        for piece in point_pieces(data.points):
            f, J, v = linearised(model, x, data.piece(piece))
            yield piece, omega[:, piece], f, J, np.broadcast_to(v, f.shape)

    N, M, g = np.zeros((count, t, t)), np.zeros((count, t, t)), np.zeros((count, t, 1))
    for _, w, f, J, v in blocks():
        N += (J * (w / v)[:, None]) @ J.swapaxes(-1, -2)
        M += (J * (w * w / v)[:, None]) @ J.swapaxes(-1, -2)
        g += (J * (w / v)[:, None]) @ f[..., None]
    # residuals are those at the minimum, off which a correction of the bias has moved the surface
    to_minimum = -solve(N, g)[..., 0]

    redundancy, standardised, minimal = np.empty((3, count, n))
    external = np.empty((count, n, derivative.shape[1]))
    for piece, w, f, J, v in blocks():
        NJ = solve(N, J)
        q = np.einsum("btn,btn->bn", J, NJ) / v
        redundancy[:, piece] = r = 1.0 - w * q
        sd = sigma_0 * np.sqrt(
            v * np.maximum(1.0 - 2.0 * w * q + np.einsum("btn,btn->bn", NJ, M @ NJ) / v, 0.0)
        )
        # a point that nothing checks: no residual, no finite bias
        with np.errstate(divide="ignore", invalid="ignore"):
            standardised[:, piece] = (f + np.einsum("bt,btn->bn", to_minimum, J)) / sd
            minimal[:, piece] = delta * sd / r
        external[:, piece] = -(derivative @ (NJ * (w / v * minimal[:, piece])[:, None])).swapaxes(
            -1, -2
        )
    p = (
        2.0 * norm.sf(np.abs(standardised))
        if sigma is not None
        else _p_values(standardised, omega > 0, t)
    )
    return Reliability(
        *(
            field.reshape(lead + field.shape[1:])
            for field in (redundancy, standardised, p, minimal, external)
        )
    )


def noncentrality(alpha0: float = 0.001, power: float = 0.8) -> float:
    """δ0 = ``Φ⁻¹(1 − α0/2) + Φ⁻¹(power)``, by which the minimal detectable bias shifts u.

    The chance to be found on the wrong side, Φ(−Φ⁻¹(1 − α0/2) − δ0), is left out: 10⁻¹³ at the
    defaults.

    >>> round(noncentrality(), 2)
    4.13
    """
    return float(
        norm.isf(0.5 * _probability(alpha0, "alpha0")) + norm.ppf(_probability(power, "power"))
    )


def data_snooping(
    points,
    refit: Callable[..., Fit],
    *,
    sigma=None,
    alpha0: float = 0.001,
    weights=None,
    cofactors=None,
) -> tuple[Fit, Array]:
    """Baarda's data snooping: leave out the point with the largest failing test, and fit again.

    Parameters
    ----------
    points : (n, dim), one cloud, few enough to be fitted once for every error in it
    refit : fits what is left, ``refit(points, weights=…)`` or ``cofactors=…`` where they are given
    sigma, alpha0 : as for :func:`reliability`; every test is at level alpha0
    weights, cofactors : (n,) or (n, dim, dim) of the points, or None

    Returns
    -------
    The last fit and (n,) bool, the points it was made from. Several errors that hide one another
    are not found; for those there is ``robust``.

    Example
    -------
    >>> from analysis.methods import fit_sphere
    >>> points = np.vstack([np.eye(3), -np.eye(3), [[0.6, 0.8, 0.001], [0, 0.6, -0.8]]])
    >>> points[4] *= 1.3
    >>> refit = lambda points, **given: fit_sphere(points, "geometric", **given)
    >>> data_snooping(points, refit, sigma=0.001)[1]
    array([ True,  True,  True,  True, False,  True,  True,  True])
    """
    points = point_array(points, np.shape(points)[-1], 1, "data snooping")
    kept = np.ones(len(points), dtype=bool)
    precision: dict[str, Any] = {
        name: np.asarray(values)
        for name, values in (("weights", weights), ("cofactors", cofactors))
        if values is not None
    }
    while True:
        given = {name: values[kept] for name, values in precision.items()}
        fit = refit(points[kept], **given)
        tested = reliability(fit, points[kept], sigma=sigma, **given)
        worst = np.nanargmin(tested.p_values)
        if (
            tested.p_values[worst] > alpha0
            or np.count_nonzero(kept) <= fit.surface().model.degrees + 1
        ):
            return fit, kept
        # Tiny probabilities are all 0; the residual tells them apart.
        kept[np.flatnonzero(kept)[np.nanargmax(np.abs(tested.standardised))]] = False


def _p_values(u: Array, in_use: np.ndarray, t: int) -> Array:
    """Two-sided, for u standardised by an estimated σ.

    ``u √((ν − 1)/(ν − u²))`` is Student's t with ν − 1 degrees of freedom for points in use.
    """
    nu = np.count_nonzero(in_use, axis=-1, keepdims=True) - t
    with np.errstate(divide="ignore", invalid="ignore"):
        tau = np.sqrt((nu - 1) / np.maximum(nu - u * u, 0.0))
    return 2.0 * student.sf(np.abs(u) * np.where(in_use, tau, 1.0), np.where(in_use, nu - 1, nu))


def _probability(value, name: str) -> float:
    if not 0 < (number := check_positive(value, name)) < 1:
        raise ValueError(f"{name}: expected a probability between 0 and 1, got {value!r}")
    return number
