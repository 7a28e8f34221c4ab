"""Significance of the change of a section: differences of radii, classed as printed and tested.

Both epochs are read off in the same directions about the same axis, that of the first epoch. A
difference is positive where the lining has moved outwards.

References
----------
Krishnamoorthy & Yu (2004), Statistics & Probability Letters 66, 161-169 (means of several
components, variances unknown). Lague, Brodu & Leroux (2013), ISPRS Journal of Photogrammetry and
Remote Sensing 82, 10-26 (level of detection). Welch (1947), Biometrika 34, 28-35. Winiwarter,
Anders & Höfle (2021), ISPRS Journal of Photogrammetry and Remote Sensing 178, 240-258 (registration
as a covariance).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, norm
from scipy.stats import f as fisher
from scipy.stats import t as student

from ..adjustment.linalg import solve
from ..checks import check_positive, finite_array, real_array
from .radii import Radii

LIMITS = (0.006, 0.012)  # m, between the classes
CLASSES = ("black", "blue", "red")
GAP = "gap"
SHARE = 0.30  # of a section's directions beyond the first limit; not printed
LEAST_SEEN = 0.25  # of the directions, for a section to be flagged
LEVEL = 0.05
ROUNDING = 1e-9  # m; a standard deviation below is rounding
# of the largest singular value; below, components of a motion are the same in all directions seen
SMALLEST_SINGULAR = 1e-6
LARGEST_NORMAL = 37.0  # standard deviations; beyond, probabilities are below the smallest number


# --------------------------------------------------------------------------------- as printed


def differences(first: Radii, second: Radii) -> np.ndarray:
    """``δ_j = ρ_j(second epoch) − ρ_j(first epoch)``, m; NaN where either epoch has a gap.

    Of the shape of the radii. Raises ``ValueError`` when the directions differ.

    Source: Li et al. (2015), section on change detection.
    """
    shapes = first.radius.shape, second.radius.shape
    if shapes[0] != shapes[1] or not np.array_equal(first.directions, second.directions):
        angles = " at other angles" if shapes[0] == shapes[1] else ""
        raise ValueError(
            "second: expected radii in the same directions as in the first epoch, got shape "
            f"{shapes[1]} beside {shapes[0]}{angles}"
        )
    return second.radius - first.radius


def classes(delta) -> np.ndarray:
    """Class of each difference: black, blue, red, or gap.

    black ``|δ| ≤ 6 mm``, blue ``6 mm < |δ| ≤ 12 mm``, red ``|δ| > 12 mm``.

    The text puts 12 mm exactly into both blue and red; here it is blue.

    Source: Li et al. (2015), section 4.2.2.

    >>> classes([0.006, -0.0061, 0.012, -0.0212, np.nan]).tolist()
    ['black', 'blue', 'blue', 'red', 'gap']
    """
    delta = real_array(delta, "delta")
    names = np.array(CLASSES)[np.searchsorted(LIMITS, np.abs(np.nan_to_num(delta)))]
    return np.where(np.isnan(delta), GAP, names)


def share_beyond(delta, limit: float = LIMITS[0]) -> float:
    """Share of the directions seen in both epochs with ``|δ| > limit``.

    Raises ``ValueError`` when there are none.

    >>> share_beyond([0.001, -0.008, np.nan, 0.02, 0.0])
    0.5
    """
    delta = real_array(delta, "delta")
    seen = ~np.isnan(delta)
    if not seen.any():
        raise ValueError(
            f"delta: expected directions that are seen in both epochs, got {delta.size} gaps"
        )
    return float(np.mean(np.abs(delta[seen]) > check_positive(limit, "limit")))


def flagged(delta) -> bool:
    """Whether a section is to be analysed further: more than 30 % of it is beyond 6 mm.

    Of the directions seen in both epochs; not where these are less than a quarter of all: of a
    handful the noise of single points makes any share. :func:`significance` knows how little few
    directions say and tests all sections.

    Source: Li et al. (2015), section on change detection; the shares are not printed.

    >>> flagged([0.001, -0.008, 0.02, 0.0]), flagged([0.001, -0.008, 0.002, 0.0])
    (True, False)
    >>> flagged([0.008, np.nan, np.nan, np.nan, np.nan])
    False
    """
    return share_beyond(delta) > SHARE and bool(np.mean(~np.isnan(delta)) >= LEAST_SEEN)


# --------------------------------------------------------------------------------- significance


@dataclass(frozen=True, eq=False)
class Significance:
    """Differences of one section and their significance; arrays (J,), NaN at gaps.

    The section as a whole is tested twice, at half the level each: for a motion, and for what is
    left without one.

    delta : m; sd : its standard deviation with that of the registration, m; freedom : its degrees
        of freedom
    limit : level of detection in each direction by itself, m
    significant : bool, |δ| > limit
    tested : bool, the directions of the tests of the whole section: those that share no points
    p_motion, p_shape : probabilities of statistics so large without deformation; of the shape 1 for
        so few directions that any of their differences could be a motion
    level : of significance, of each direction and of the section
    """

    delta: np.ndarray
    sd: np.ndarray
    freedom: np.ndarray
    limit: np.ndarray
    significant: np.ndarray
    tested: np.ndarray
    p_motion: float
    p_shape: float
    level: float

    @property
    def p_value(self) -> float:
        """``min(1, 2 min(p_motion, p_shape))`` (Bonferroni).

        Of a section without deformation it is below α at most as often as α.
        """
        return min(1.0, 2.0 * min(self.p_motion, self.p_shape))

    @property
    def changed(self) -> bool:
        """Whether the section as a whole has changed."""
        return self.p_value < self.level


def significance(
    first: Radii, second: Radii, *, registration=0.0, level: float = LEVEL
) -> Significance:
    """Tests differences of radii against the noise of the points and the error of the registration.

    The registration displaces a section as a whole: all of its differences share the error ``aᵀt``,
    t the shift to the right and up and, where the axis point is the centre of the ring, a = (sin α,
    cos α); elsewhere, with the slope of the ring,
    ``a = (sin α, cos α) − (dρ/dα)/ρ · (cos α, −sin α)``. A third element 1 goes with a common error
    of all radii, as of the scale or of the range. The error does not average out over points or
    directions:

        σ_j² = s₁²/n₁ + s₂²/n₂ + a_jᵀ Σ a_j,   LoD_j = q_j σ_j,   q_j Student's quantile with
        Welch's degrees of freedom

    (Lague et al. 2013 add the registration error to the standard deviation instead.) A direction by
    itself is significant when ``|δ_j| > LoD_j``: of J directions without deformation a share of
    ``level`` is so by chance.

    Whether the section as a whole has changed is asked of m directions that share no points, D the
    variances of the points' part. A *motion* (of p components, two or, with a common change of the
    radii, three) looks like a registration error, and must be too large for one:

        y = Q̃ᵀW^½δ,   S = Q̃ᵀW^½(D + A Σ Aᵀ)W^½Q̃,   T² = yᵀS⁻¹y,   W^½A = Q̃R̃,   1/w = 1/n₁ +
        1/n₂

    T² is Hotelling's with p components and ν degrees of freedom, ``T²(ν − p + 1)/(νp)`` an F(p, ν −
    p + 1). The weights come from the numbers of points: variances estimated from few points would
    choose the directions whose own variance is too small. The *shape* is what no motion explains,
    however large, so that no registration error can touch it:

        χ² = δᵀD⁻¹(δ − A t̂),   t̂ = (AᵀD⁻¹A)⁻¹AᵀD⁻¹δ,   m − p degrees of freedom,

    each variance enlarged to the normal deviate of the same probability as Student's. The section
    has changed when either is improbable by half the level, so that both together keep it.

    Parameters
    ----------
    first, second : radii of :func:`analysis.tunnel.radii.local_radii` in the same directions
        about the same axis.
    registration : of the second epoch relative to the first: standard deviation of the section's
        shift in each coordinate, m, or covariance matrix (2, 2) of (right, up) or (3, 3) of (right,
        up, radius), m².
    level : of significance.

    Raises
    ------
    ValueError : other directions, radii without standard deviations, no direction seen in both
        epochs, no covariance matrix.

    Source: Lague et al. (2013), eq. (1), in quadrature; Welch (1947); Winiwarter et al. (2021);
    Krishnamoorthy & Yu (2004), ν.

    >>> def radii(r):
    ...     J = np.ones(4)
    ...     directions = np.radians([-90.0, 0.0, 90.0, 180.0])
    ...     return Radii(directions, np.array(r), 0.001 * J, 20 * J, 20 * J, J > 1, 0.01 * J)
    >>> epochs = radii([2.7, 2.7, 2.7, 2.7]), radii([2.7, 2.695, 2.7, 2.705])  # sunk by 5 mm
    >>> [significance(*epochs, registration=sd).changed for sd in (0.0, 0.003)]
    [True, False]
    """
    delta = differences(first, second)
    if delta.ndim != 1:
        raise ValueError(
            f"first: expected one radius a direction, got shape {delta.shape}; "
            "local_radii gives them"
        )
    level = check_positive(level, "level")
    seen = ~np.isnan(delta)
    if not seen.any():
        raise ValueError(
            f"first, second: expected directions that are seen in both epochs, got {delta.size} "
            "gaps"
        )
    if not np.all(np.isfinite((first.sd + second.sd)[seen])):
        raise ValueError(
            "first, second: expected radii with standard deviations, got some without; local_radii "
            "gives them"
        )
    A, Sigma = _common_mode(first.directions, 0.5 * (first.radius + second.radius), registration)
    parts = [np.maximum(epoch.sd, ROUNDING) ** 2 for epoch in (first, second)]
    common = np.einsum("ji,ik,jk->j", A, Sigma, A)
    sd = np.sqrt(parts[0] + parts[1] + common)
    freedom = _welch(parts, (first.freedom, second.freedom), common)
    limit = student.isf(0.5 * level, np.where(seen, freedom, 1.0)) * sd
    sd, freedom, limit = (np.where(seen, values, np.nan) for values in (sd, freedom, limit))
    tested = _disjoint(first.directions, np.maximum(first.reach, second.reach), seen)
    variance, points = parts[0] + parts[1], _welch(parts, (first.freedom, second.freedom), 0.0)
    noise = variance[tested], points[tested]
    root = 1.0 / np.sqrt(1.0 / first.count[tested] + 1.0 / second.count[tested])
    p_motion = _motion(delta[tested], *noise, root, A[tested], Sigma)
    p_shape = _shape(delta[tested], *noise, _basis(A[tested]))
    return Significance(
        delta, sd, freedom, limit, seen & (np.abs(delta) > limit), tested, p_motion, p_shape, level
    )


def _common_mode(
    directions: np.ndarray, radius: np.ndarray, registration
) -> tuple[np.ndarray, np.ndarray]:
    """A (J, k) and Σ (k, k) of the registration error."""
    Sigma = finite_array(registration, "registration")
    if Sigma.ndim == 0 and Sigma >= 0:
        Sigma = Sigma**2 * np.eye(2)
    if Sigma.shape not in ((2, 2), (3, 3)):
        raise ValueError(
            "registration: expected a standard deviation, or a covariance matrix (2, 2) or (3, "
            f"3), got {registration!r}"
        )
    symmetric = np.allclose(Sigma, Sigma.T, rtol=1e-9, atol=0.0)
    if not symmetric or np.linalg.eigvalsh(Sigma)[0] < -1e-9 * np.trace(Sigma):
        raise ValueError(
            "registration: expected a symmetric covariance matrix without negative variances, got "
            f"{registration!r}"
        )
    sine, cosine, turn = np.sin(directions), np.cos(directions), _relative_slope(directions, radius)
    A = np.stack([sine - turn * cosine, cosine + turn * sine, np.ones_like(sine)], axis=-1)
    return A[:, : len(Sigma)], Sigma


def _relative_slope(a: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """(dρ/dα)/ρ (J,) of a smooth curve through the radii; 0 for too few radii.

    Their own slope is noise.
    """
    seen = ~np.isnan(radius)
    sine, cosine, sine_2, cosine_2 = np.sin(a), np.cos(a), np.sin(2 * a), np.cos(2 * a)
    curve = np.stack([np.ones_like(a), sine, cosine, sine_2, cosine_2], axis=-1)
    slope = np.stack([np.zeros_like(a), cosine, -sine, 2 * cosine_2, -2 * sine_2], axis=-1)
    if np.count_nonzero(seen) < 2 * curve.shape[-1]:
        return np.zeros_like(a)
    coefficients = np.linalg.lstsq(curve[seen], radius[seen], rcond=1e-6)[0]
    return slope @ coefficients / np.where(seen, curve @ coefficients, 1.0)


def _welch(variances, freedoms, exact) -> np.ndarray:
    """Welch's degrees of freedom of two estimated variances and an ``exact`` one."""
    total = variances[0] + variances[1] + exact
    return total**2 / (variances[0] ** 2 / freedoms[0] + variances[1] ** 2 / freedoms[1])


def _disjoint(directions: np.ndarray, reach: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Directions whose neighbourhoods do not overlap, as many as possible."""
    chosen = np.zeros(len(directions), dtype=bool)
    start, end = directions - reach - 1e-9, directions + reach
    free, once_around = -np.inf, np.inf
    for j in np.argsort(end, kind="stable"):
        if seen[j] and start[j] + 2e-9 >= free and end[j] <= once_around:
            chosen[j], free = True, end[j]
            once_around = min(once_around, start[j] + 2.0 * np.pi + 2e-9)
    return chosen


def _basis(A: np.ndarray) -> np.ndarray:
    """(m, p) orthonormal columns that span those of A, p its rank."""
    U, singular, _ = np.linalg.svd(A, full_matrices=False)
    return U[:, singular > SMALLEST_SINGULAR * singular[0]]


def _motion(delta, variance, freedom, root, A, Sigma) -> float:
    """Probability of so large a motion by noise and registration error."""
    Q = _basis(root[:, None] * A)
    y, common = Q.T @ (root * delta), Q.T @ (root[:, None] * A)
    components = Q * (root * np.sqrt(variance))[:, None]
    S = components.T @ components + common @ Sigma @ common.T
    p = len(S)
    # Of the estimated parts of S, each of rank one, in units of S.
    parts = np.sum(components * solve(S, components.T).T, axis=-1)
    nu = 0.5 * (p + p**2) / np.sum(parts**2 / freedom)
    T2 = float(y @ solve(S, y[:, None])[:, 0])
    return float(fisher.sf(T2 * (nu - p + 1) / (nu * p), p, nu - p + 1)) if nu > p - 1 else 1.0


def _shape(delta, variance, freedom, basis) -> float:
    """Probability of so large differences beside any motion, which ``basis`` (m, p) spans.

    D depends on the residuals after t̂, so both are updated alternately.
    """
    redundancy = len(delta) - basis.shape[1]
    if redundancy == 0:
        return 1.0
    D = variance
    for _ in range(100):
        root = np.sqrt(D)
        motion = np.linalg.lstsq(basis / root[:, None], delta / root, rcond=None)[0]
        residual = delta - basis @ motion
        D, before = variance * _enlargement(residual / np.sqrt(variance), freedom), D
        if np.allclose(D, before, rtol=1e-6, atol=0.0):
            break
    return float(chi2.sf(np.sum(residual**2 / before), redundancy))


def _enlargement(t: np.ndarray, freedom: np.ndarray) -> np.ndarray:
    """``(t/z)²`` where the normal deviate z is exceeded as often as Student's t."""
    t = np.maximum(np.abs(t), 1e-3)  # below, the ratio does not change any more
    z = np.minimum(norm.isf(student.sf(t, freedom)), LARGEST_NORMAL)
    return (t / z) ** 2
