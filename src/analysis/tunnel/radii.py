"""Radii of a section in given directions about its axis point.

Two readings stand side by side. :func:`equal_angles` takes, as printed, in each of three sub-planes
the one point nearest in angle. :func:`local_radii` adjusts a quadratic to all points around a
direction and says how precise it is. Neither extrapolates: where the points do not lie on both
sides of a direction there is a gap.

Source: Li et al. (2015), section on change detection, for the first; the second is an addition.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..adjustment.linalg import solve
from ..adjustment.weights import Bisquare
from ..checks import check_positive, finite_array
from .medians import median_scale
from .sections import Section

STEP = np.radians(1.0)  # between directions; not printed
# the range of Li et al. (2015); the track bed hides the rest
DIRECTIONS = np.radians(np.arange(-135, 136))
WIDEST = np.radians(10.0)  # to each side of a direction in which points are looked for
# points of a local adjustment, and how many single points it must be worth at least
FEWEST, LEAST_WORTH = 5, 1.0
ENOUGH, GOOD_WORTH = 8, 2.0  # with these, a neighbourhood need not grow for the sake of precision
COEFFICIENTS = 3  # of a quadratic
BISQUARE = Bisquare()
SMALLEST_SCALE = 1e-12  # m; below is rounding


@dataclass(frozen=True, eq=False)
class Radii:
    """Radii of a section in given directions; all arrays (J,), or (3, J) for three sub-planes.

    directions : (J,) rad
    radius : m, NaN at a gap
    sd : its standard deviation, m; NaN where it is not known, as for a single point
    freedom : degrees of freedom of that standard deviation
    count : effective number of points, the variance of a point over that of the radius
    interpolated : no point lies in the direction's own cell; the radius comes from both of its
        sides
    reach : rad to each side from which points have been used
    """

    directions: np.ndarray
    radius: np.ndarray
    sd: np.ndarray
    freedom: np.ndarray
    count: np.ndarray
    interpolated: np.ndarray
    reach: np.ndarray

    @property
    def gaps(self) -> np.ndarray:
        """Where nothing can be said, bool."""
        return np.isnan(self.radius)


def equal_angles(section: Section, directions=DIRECTIONS, step: float = STEP) -> Radii:
    """Radii in given directions as printed: the nearest point in each of three sub-planes.

    The sub-planes lie at w = −d/2, 0 and d/2; each takes the points within d/4 of it. A direction's
    point is the one nearest in angle within ``step``/2. Where there is none, a quadratic through
    the sub-plane's points within ``step``·2 to each side, growing to 10°, with at least 5 points on
    both sides, is read off; where they are not to be had there is a gap. What is nearest, the width
    of the sub-planes, the angle and the neighbourhood are not printed.

    Returns :class:`Radii` with arrays (3, J); the standard deviation of a single point is not
    known.
    """
    directions, step = _directions(directions), check_positive(step, "step")
    _require_points(section)
    rows = []
    for offset in (-0.5, 0.0, 0.5):
        near = np.abs(section.w - offset * section.thickness) <= 0.25 * section.thickness
        rows.append(_nearest(_by_angle(section.alpha[near], section.rho[near]), directions, step))
    return Radii(directions, *map(np.array, zip(*rows, strict=True)))


def local_radii(section: Section, directions=DIRECTIONS, step: float = STEP) -> Radii:
    """Radii in given directions by a robust quadratic through the points around each.

    ``ρ = c₀ + c₁ x + c₂ x²``, x = α − α_j.

    The points within ``step``/2 of a direction if they are 8 or more, on both sides, and so placed
    that c₀ is worth 2 of them; else those of the narrowest neighbourhood, growing by half steps to
    10°, of which that is true. At 10° 5 points worth 1 will do; what is worth less than a single
    point is extrapolated in all but name, and a gap. Bisquare weights; their scale is common to the
    section (MAD of the residuals of all directions), so that few points cannot pass for precise by
    chance. The variance of c₀ comes from the direction's own residuals:

        s² = Σωr²/(κ Σω) · m/(m − 3),   m = Σω/E[ω],   var c₀ = s² (N⁻¹)₀₀ · E[ω]E[ψ²]/E[ψ′]²

    Directions closer than their ``reach`` share points and are correlated.

    >>> from analysis.tunnel.axis import straight
    >>> from analysis.tunnel.sections import cut
    >>> turn = np.arange(4000) * 2.4
    >>> tube = np.stack([2.7 * np.sin(turn), np.full(4000, 5.0), 2.7 * np.cos(turn)], axis=-1)
    >>> axis = straight([0.0, 0.0, 0.0], [0.0, 10.0, 0.0])
    >>> section, = cut(tube[np.abs(tube[:, 0] - 2.5) > 0.5], axis, [5.0])
    >>> radii = local_radii(section, np.radians([0.0, 90.0]))
    >>> radii.radius.round(9), radii.gaps
    (array([2.7, nan]), array([False,  True]))
    """
    directions, step = _directions(directions), check_positive(step, "step")
    _require_points(section)
    around = _by_angle(section.alpha, section.rho)
    reach = _reach(around, directions, step, 0.5 * step, ENOUGH, GOOD_WORTH)
    local = _Local.of(around, directions, reach)
    residuals = local.least_absolute()
    for _ in range(2):  # the second scale is that of the M-estimate's residuals
        N, c, residuals, weights = _bisquare(local, residuals, _common_scale(local, residuals))
    total = local.sums(weights)
    equivalent = total / BISQUARE.mean_weight
    freedom = np.maximum(equivalent - COEFFICIENTS, 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        variance = (
            local.sums(weights * residuals**2)
            / (BISQUARE.consistency_factor * total)
            * equivalent
            / freedom
        )
    worth = _worth(N) / BISQUARE.covariance_factor
    known = (freedom > 0) & (worth >= LEAST_WORTH)
    radius, sd, freedom = (
        np.where(known, value, np.nan) for value in (c[:, 0], np.sqrt(variance / worth), freedom)
    )
    first, _, last = _bounds(around[0], directions, 0.5 * step)
    return Radii(
        directions, radius, sd, freedom, np.where(known, worth, 0.0), known & (first == last), reach
    )


def _directions(directions) -> np.ndarray:
    directions = finite_array(directions, "directions")
    if directions.ndim != 1 or directions.size == 0 or np.abs(directions).max() > np.pi + 1e-9:
        raise ValueError(
            "directions: expected shape (J,) in rad between −π and π, got shape "
            f"{directions.shape}, {directions}"
        )
    return directions


def _require_points(section: Section) -> None:
    if section.count < FEWEST:
        raise ValueError(
            f"section at chainage {section.chainage:.3f} m: expected at least {FEWEST} points, got "
            f"{section.count}; nothing was scanned there"
        )


def _by_angle(alpha: np.ndarray, rho: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angles, ascending, and radii, continued beyond ±π by the points from the other side."""
    order = np.argsort(alpha, kind="stable")
    alpha, rho = alpha[order], rho[order]
    low, high = np.searchsorted(alpha, [-np.pi + 2 * WIDEST, np.pi - 2 * WIDEST])
    return (
        np.concatenate([alpha[high:] - 2 * np.pi, alpha, alpha[:low] + 2 * np.pi]),
        np.concatenate([rho[high:], rho, rho[:low]]),
    )


def _reach(
    around, directions: np.ndarray, step: float, start: float, enough: int, good: float
) -> np.ndarray:
    """(J,) half width of the narrowest neighbourhood with ``enough`` points worth ``good`` points.

    They lie on both sides of the direction. The half width starts at ``start`` and grows by half
    steps; at the widest the fewest points and the least worth will do; else NaN.
    """
    reach = np.full(len(directions), np.nan)
    for half in np.append(np.arange(start, WIDEST - 1e-9, 0.5 * step), WIDEST):
        if half == WIDEST:
            enough, good = FEWEST, LEAST_WORTH
        left = np.flatnonzero(np.isnan(reach))
        first, middle, last = _bounds(around[0], directions[left], half)
        left = left[(last - first >= enough) & (first < middle) & (last > middle)]
        if left.size:
            local = _Local.of(around, directions[left], np.full(left.size, half))
            reach[left[_worth(local.adjusted(np.ones_like(local.rho))[0]) >= good]] = half
    return reach


def _bounds(
    alpha: np.ndarray, directions: np.ndarray, half
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """First point within ``half`` of each direction, first at or right of it, past the last."""
    return (
        np.searchsorted(alpha, directions - half),
        np.searchsorted(alpha, directions),
        np.searchsorted(alpha, directions + half, "right"),
    )


def _nearest(around, directions, step) -> tuple[np.ndarray, ...]:
    """Fields of :class:`Radii` after the directions, for one sub-plane."""
    alpha, rho = around
    reach = _reach(around, directions, step, 2.0 * step, FEWEST, LEAST_WORTH)
    usable = ~np.isnan(reach)
    local = _Local.of(around, directions, reach)
    N, c, _ = local.adjusted(np.ones_like(local.rho))
    radius, count = np.where(usable, c[:, 0], np.nan), np.where(usable, _worth(N), 0.0)
    found = np.zeros(len(directions), dtype=bool)
    if len(alpha):
        after = np.clip(np.searchsorted(alpha, directions), 1, max(len(alpha) - 1, 1))
        candidates = np.minimum(np.stack([after - 1, after]), len(alpha) - 1)
        away = np.abs(alpha[candidates] - directions)
        nearest = candidates[np.argmin(away, axis=0), np.arange(len(directions))]
        found = away.min(axis=0) <= 0.5 * step
        radius = np.where(found, rho[nearest], radius)
    unknown = np.full(len(directions), np.nan)
    reach = np.where(found, 0.5 * step, reach)
    return radius, unknown, unknown, np.where(found, 1.0, count), usable & ~found, reach


@dataclass(frozen=True, eq=False)
class _Local:
    """The points of all neighbourhoods one after the other: all directions are adjusted at once.

    owner : (m,) direction of each
    powers : (5, m) of its angle from there over the half width
    rho : (m,) m
    directions : their number
    """

    owner: np.ndarray
    powers: np.ndarray
    rho: np.ndarray
    directions: int

    @classmethod
    def of(cls, around, directions, reach) -> _Local:
        """From the neighbourhoods of half widths ``reach`` (J,); none where it is NaN."""
        alpha, rho = around
        first, _, last = _bounds(alpha, directions, reach)
        counts = np.where(np.isnan(reach), 0, last - first)
        owner = np.repeat(np.arange(len(directions)), counts)
        index = np.arange(len(owner)) + np.repeat(first - np.cumsum(counts) + counts, counts)
        x = (alpha[index] - directions[owner]) / reach[owner]
        powers = x ** np.arange(2 * COEFFICIENTS - 1)[:, None]
        return cls(owner, powers, rho[index], len(directions))

    def sums(self, values: np.ndarray) -> np.ndarray:
        """(J,) of values (m,)."""
        # without points NumPy gives whole numbers
        return np.bincount(self.owner, values, minlength=self.directions).astype(float, copy=False)

    @property
    def counts(self) -> np.ndarray:
        """(J,) points."""
        return np.bincount(self.owner, minlength=self.directions)

    def adjusted(self, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Normal matrices (J, 3, 3), quadratics (J, 3) and residuals (m,); NaN without points."""
        count = self.counts
        middle = self.sums(self.rho) / np.where(count > 0, count, np.nan)
        rho = self.rho - middle[self.owner]  # so that little is lost in the sums
        powers = self.powers * weights
        moments = np.array([self.sums(power) for power in powers])
        moments[:, count == 0] = np.nan
        k = np.arange(COEFFICIENTS)
        N = np.moveaxis(moments[k[:, None] + k], -1, 0)
        right = np.stack([self.sums(power * rho) for power in powers[:COEFFICIENTS]], axis=-1)
        c = solve(N, right[..., None])[..., 0]
        residuals = rho - np.einsum("km,mk->m", self.powers[:COEFFICIENTS], c[self.owner])
        c[:, 0] += middle
        return N, c, residuals

    def least_absolute(self) -> np.ndarray:
        """Residuals (m,) of least absolute deviations, by repeated weights 1/|residual|."""
        residuals = self.adjusted(np.ones_like(self.rho))[2]
        for _ in range(20):
            residuals = self.adjusted(1.0 / np.maximum(np.abs(residuals), 1e-5))[2]
        return residuals


def _bisquare(
    local: _Local, residuals: np.ndarray, scale: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Normal matrices, quadratics, residuals and weights of the M-estimate with a fixed scale.

    It begins with the residuals given.
    """
    weights = BISQUARE.weight(residuals / scale)
    for _ in range(50):
        N, c, residuals = local.adjusted(weights)
        weights, before = BISQUARE.weight(residuals / scale), weights
        if not np.any(np.abs(weights - before) > 1e-4):  # of what is far below the noise
            break
    return N, c, residuals, weights


def _worth(N: np.ndarray) -> np.ndarray:
    """Effective number of points (J,): the variance of a point over that of c₀; 0 for no points."""
    first = np.zeros((len(N), COEFFICIENTS, 1))
    first[:, 0] = 1.0
    cofactor = solve(N, first)[:, 0, 0]
    return np.where(cofactor > 0, 1.0 / np.where(cofactor > 0, cofactor, 1.0), 0.0)


def _common_scale(local: _Local, residuals: np.ndarray) -> float:
    """Standard deviation of a point from the residuals of all directions.

    Less the three smallest of each direction, which a quadratic can make 0.
    """
    size = np.abs(residuals)
    order = np.lexsort((size, local.owner))
    counts = local.counts
    rank = np.arange(len(order)) - np.repeat(np.cumsum(counts) - counts, counts)
    size = size[order][rank >= COEFFICIENTS]
    return median_scale(size[np.isfinite(size)], SMALLEST_SCALE)
