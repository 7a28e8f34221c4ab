"""Change of a section between two epochs: polar radii compared, with standard deviations.

    Δρ(α) = ρ₂(α) − ρ₁(α),   point (u, v) = pole + ρ (sin α, cos α)                     (Li et al.
    2015, section 3.4.3)

α is 0 at the crown and positive to the right; u is to the right and v up, in the section's plane.
Both epochs are seen from one pole. Δρ is a linear function of what was estimated, the outline of
either epoch and the shift between the epochs' frames:

    var Δρ = g₁ᵀΣ₁g₁ + g₂ᵀΣ₂g₂ + sᵀΣₜs

with g the gradients of the radii and s that of a shift of the second outline. Neighbouring
directions are strongly correlated; everything derived from Δρ takes that along.

An outline is an ellipse (:class:`~analysis.surfaces.ellipse.EllipseFit`). It does not follow a
local dent; what it leaves is in the residuals (:func:`residual_profile`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.stats import norm

from ..adjustment.linalg import cofactor_from_factor, propagate
from ..checks import check_positive, check_whole_number, finite_array, point_array
from ..surfaces.ellipse import EllipseFit

# the track bed hides the rest (Li et al. 2015, section 4.2.2)
ANGLES = np.deg2rad(np.arange(-135.0, 136.0))
ORDER = 4  # of Fourier series: an ellipse with 22 mm between its axes is one to 0.001 mm
TWO_SIDED = 1.96  # standard deviations to either side that hold 95 % at the normal law


@dataclass(frozen=True, eq=False)
class RadialChange:
    """Radial change of sections (…) between two epochs.

    angles : (K,) rad, 0 at the crown, positive to the right
    pole : (…, 2) m, from which both epochs are seen
    first, second, difference : (…, K) radii of the epochs and Δρ, m
    gradient : (…, K, P) of Δρ by all that was estimated; covariance : (…, P, P) of that, m² for
        lengths
    """

    angles: np.ndarray
    pole: np.ndarray
    first: np.ndarray
    second: np.ndarray
    difference: np.ndarray
    gradient: np.ndarray
    covariance: np.ndarray

    @property
    def standard_deviations(self) -> np.ndarray:
        """(…, K) of Δρ in m."""
        return np.sqrt(
            np.einsum("...kp,...pq,...kq->...k", self.gradient, self.covariance, self.gradient)
        )

    def interval(self, level: float = 0.95) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bound (…, K) in m that hold a true Δρ with probability ``level``.

        Each direction by itself.
        """
        half = norm.ppf(0.5 + 0.5 * _probability(level, "level")) * self.standard_deviations
        return self.difference - half, self.difference + half

    def combination(self, weights) -> tuple[np.ndarray, np.ndarray]:
        """Values (…, F) of ``Σ weights Δρ``, weights (F, K), and their covariance (…, F, F)."""
        weights = np.asarray(weights, dtype=float)
        return self.difference @ weights.T, propagate(self.covariance, weights @ self.gradient)

    def table(self) -> pd.DataFrame:
        """A row per section and direction: radii in m, difference and standard deviation in mm.

        Columns `section`, `angle_deg`, `first_m`, `second_m`, `difference_mm`,
        `standard_deviation_mm`.
        """
        count = len(self.angles)
        sections = self.difference.size // count
        return pd.DataFrame(
            {
                "section": np.repeat(np.arange(sections), count),
                "angle_deg": np.tile(np.rad2deg(self.angles), sections),
                "first_m": self.first.ravel(),
                "second_m": self.second.ravel(),
                "difference_mm": 1000.0 * self.difference.ravel(),
                "standard_deviation_mm": 1000.0 * self.standard_deviations.ravel(),
            }
        )


def deformation(
    first: EllipseFit, second: EllipseFit, *, pole=None, angles=ANGLES, registration=None
) -> RadialChange:
    """Δρ(α) of the outlines of two epochs, in one frame, with everything needed for its covariance.

    Parameters
    ----------
    first, second : of the same section or stack of sections (…), independent of each other.
    pole : (2,) or (…, 2) in m inside both, such as the first epoch's axis. None takes the centre of
        the first ellipse. It is a given place, without error: another pole is another Δρ. Where an
        outline does not go round it, Δρ is NaN.
    angles : (K,) rad.
    registration : (2, 2) or (…, 2, 2) covariance in m² of the shift in (u, v) between the epochs'
        frames at the section; None for none.

    Raises ``ValueError`` for stacks that do not belong together, wrong shapes, and outlines without
    a centre where no pole is given.

    >>> from analysis.surfaces.ellipse import EllipseFit
    >>> def known(a, b):
    ...     x = np.array([0.0, 0.0, (a + b) / 2, (a - b) / 2, 0.0])
    ...     exact = {"regular": x, "regular_cofactor": np.zeros((5, 5))}
    ...     return EllipseFit("known", x, None, 0.0, None, None, 0, True, "", **exact)
    >>> options = {"angles": np.deg2rad([0.0, 90.0]), "registration": 1e-6 * np.eye(2)}
    >>> change = deformation(known(2.7, 2.7), known(2.71, 2.69), **options)
    >>> (1000 * change.difference).round(6), (1000 * change.standard_deviations).round(6)
    (array([-10.,  10.]), array([1., 1.]))

    Source: Li et al. 2015, section 3.4.3.
    """
    angles = finite_array(angles, "angles")
    if angles.ndim != 1:
        raise ValueError(f"angles: expected shape (K,), got {angles.shape}")
    if pole is None:
        pole = first.center
    parts = [first.regular_covariance, second.regular_covariance]
    if parts[0].shape[:-2] != parts[1].shape[:-2]:
        raise ValueError(
            f"second: expected outlines of shape {parts[0].shape[:-2]} as the first, got "
            f"{parts[1].shape[:-2]}"
        )
    lead = parts[0].shape[:-2]
    pole = np.broadcast_to(_of_shape(pole, lead, (2,), "pole"), lead + (2,))
    radii_1, gradient_1, _ = first.polar(angles, pole)
    radii_2, gradient_2, shift = second.polar(angles, pole)
    gradients = [-gradient_1, gradient_2]
    if registration is not None:
        gradients.append(shift)
        parts.append(
            np.broadcast_to(_of_shape(registration, lead, (2, 2), "registration"), lead + (2, 2))
        )
    gradient = np.concatenate(gradients, axis=-1)
    covariance = np.zeros(lead + 2 * gradient.shape[-1:])
    start = 0
    for part in parts:
        stop = start + part.shape[-1]
        covariance[..., start:stop, start:stop] = part
        start = stop
    return RadialChange(angles, pole, radii_1, radii_2, radii_2 - radii_1, gradient, covariance)


# ------------------------------------------------------------------------ what is read from it


def quantities(
    first: EllipseFit, second: EllipseFit, *, pole=None, registration=None
) -> pd.DataFrame:
    """Convergences, settlement and ovality, with standard deviations.

    - ``horizontal convergence`` ΔH = Δρ(90°) + Δρ(−90°), positive when the section widens;
    - ``crown settlement`` −Δρ(0°), positive downwards;
    - ``vertical convergence`` ΔV = Δρ(0°) + Δρ(180°): the invert is not seen, so this is the
      ellipse's word alone, `extrapolated`;
    - ``ovality, first`` and ``second``: (a − b)/r̄ with r̄ = (a + b)/2. Near a circle it is biased
      upwards and not normally distributed.

    Arguments as for :func:`deformation`. Columns `section`, `quantity`, `value`,
    `standard_deviation`, `unit`, `extrapolated`.

    Source: Li et al. 2015, section 3.4.3.
    """
    change = deformation(
        first,
        second,
        pole=pole,
        angles=np.deg2rad([-90.0, 0.0, 90.0, 180.0]),
        registration=registration,
    )
    values, covariance = change.combination([[1, 0, 1, 0], [0, -1, 0, 0], [0, 1, 0, 1]])
    sd = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    before, after = ovality(first), ovality(second)
    columns = [
        ("horizontal convergence", 1000 * values[..., 0], 1000 * sd[..., 0], "mm", False),
        ("crown settlement", 1000 * values[..., 1], 1000 * sd[..., 1], "mm", False),
        ("vertical convergence", 1000 * values[..., 2], 1000 * sd[..., 2], "mm", True),
        ("ovality, first", 1000 * before[0], 1000 * before[1], "‰", False),
        ("ovality, second", 1000 * after[0], 1000 * after[1], "‰", False),
    ]
    rows = [
        (section, name, np.ravel(value)[section], np.ravel(deviation)[section], unit, extrapolated)
        for section in range(max(1, int(np.prod(change.difference.shape[:-1]))))
        for name, value, deviation, unit, extrapolated in columns
    ]
    return pd.DataFrame(
        rows, columns=["section", "quantity", "value", "standard_deviation", "unit", "extrapolated"]
    )


def ovality(fit: EllipseFit) -> tuple[np.ndarray, np.ndarray]:
    """(a − b)/r̄, r̄ = (a + b)/2, and its standard deviation to first order, (…).

    Good where a − b is several times as large as that.
    """
    m, g, h = np.moveaxis(fit.regular[..., 2:], -1, 0)
    half = np.hypot(g, h)
    share = np.maximum(half, np.finfo(float).tiny)
    gradient = np.stack([-2.0 * half / m**2, 2.0 * g / (share * m), 2.0 * h / (share * m)], axis=-1)
    return 2.0 * half / m, np.sqrt(
        np.einsum("...i,...ij,...j->...", gradient, fit.regular_covariance[..., 2:, 2:], gradient)
    )


@dataclass(frozen=True, eq=False)
class Split:
    """Δρ(α) of sections (…) as a mean change, a motion of the ring, and a change of shape; m.

    mean : (…) mean change of the radius c0
    translation : (…, 2) motion of the ring (u, v) = (s1, c1), its `translation_covariance` (…, 2,
        2)
    rigid : (…, K) c1 cos α + s1 sin α;  shape : (…, K) Δρ − mean − rigid, and its
        `shape_standard_deviations` (…, K)
    """

    mean: np.ndarray
    translation: np.ndarray
    translation_covariance: np.ndarray
    rigid: np.ndarray
    shape: np.ndarray


def split(change: RadialChange, order: int = ORDER) -> Split:
    """Divide Δρ(α) into mean, rigid and shape part by a Fourier series over its directions.

    ``c0 + Σ_k (c_k cos kα + s_k sin kα)``, k ≤ order.

    Registration error is a motion, too: it is in the rigid part and its covariance, and hardly in
    the shape.

    Raises ``ValueError`` for fewer than 2·order + 1 directions, or when they leave so large a gap
    that they do not tell the terms apart.

    >>> wave = np.array([[0.001 + 0.002 * np.cos(ANGLES) + 0.003 * np.cos(2 * ANGLES)]]).reshape(-1)
    >>> nothing, exact = np.zeros((len(ANGLES), 1)), np.zeros((1, 1))
    >>> parts = split(RadialChange(ANGLES, np.zeros(2), wave, wave, wave, nothing, exact))
    >>> shown = parts.mean, parts.translation[1], parts.shape[135]
    >>> [round(1000 * float(part), 3) for part in shown]
    [1.0, 2.0, 3.0]
    """
    F = fourier_rows(change.angles, order)
    R = _factor(F)
    inverse = cofactor_from_factor(R) @ F.T  # of coefficients from Δρ
    coefficients, covariance = change.combination(inverse[:3])
    rigid = coefficients[..., 1:] @ F[:, 1:3].T
    return Split(
        coefficients[..., 0],
        coefficients[..., [2, 1]],
        covariance[..., [[2], [1]], [2, 1]],
        rigid,
        change.difference - coefficients[..., :1] - rigid,
    )


# ----------------------------------------------------------------------- the linear alternative


def fourier_rows(angles: np.ndarray, order: int = ORDER) -> np.ndarray:
    """Rows ``(1, cos α, sin α, cos 2α, sin 2α, …)``, (…, 2·order + 1).

    >>> fourier_rows(np.array([0.0, np.pi / 2]), 1).round(12)
    array([[1., 1., 0.],
           [1., 0., 1.]])
    """
    multiples = np.asarray(angles)[..., None] * np.arange(1, check_whole_number(order, "order") + 1)
    waves = np.stack([np.cos(multiples), np.sin(multiples)], axis=-1).reshape(
        multiples.shape[:-1] + (-1,)
    )
    return np.concatenate([np.ones(waves.shape[:-1] + (1,)), waves], axis=-1)


def _factor(rows: np.ndarray) -> np.ndarray:
    """Triangular factor (…, P, P) of rows (…, n, P), which must tell their columns apart."""
    if rows.shape[-2] < rows.shape[-1]:
        raise ValueError(
            f"directions: expected at least {rows.shape[-1]} for this order, got {rows.shape[-2]}"
        )
    R = np.asarray(np.linalg.qr(rows, mode="r"))
    extents = np.linalg.svd(R, compute_uv=False)
    share = np.min(extents[..., -1] / extents[..., 0])
    if not share > 1e-6:
        raise ValueError(
            "directions: expected some all around the section, got a condition number of "
            f"{1 / max(share, 1e-99):.0e}"
        )
    return R


# ---------------------------------------------------------------------------- what it does not show


def residual_profile(
    points,
    fit: EllipseFit,
    pole,
    *,
    angles=ANGLES,
    half_width: float = np.deg2rad(2.0),
    minimum: int = 5,
) -> pd.DataFrame:
    """Residuals of one section from its ellipse: median signed distance by direction.

    points : (n, 2) m, those of the fit; pole : (2,); half_width : rad, of a cell; minimum : points,
        fewer make a gap (NaN)

    All points count, also those that a robust fit has thrown out: a dent is among them. Columns
    `angle_deg`, `points`, `residual_mm` (positive outside) and `standard_deviation_mm`, from the
    interval of ordered residuals that holds the true median with 95 %: it is large where a cell
    holds two things, such as lining and tray. Cells wider than the step share points.
    """
    points = point_array(points, 2, 1, "a profile")
    if points.ndim != 2 or fit.distances.shape != points.shape[:1]:
        raise ValueError(
            f"points: expected those of the fit, of shape {fit.distances.shape + (2,)}, got "
            f"{points.shape}"
        )
    u, v = np.moveaxis(points - _of_shape(pole, (), (2,), "pole"), -1, 0)
    alpha = np.arctan2(u, v)
    order = np.argsort(alpha)
    around = np.concatenate([alpha[order] - 2 * np.pi, alpha[order], alpha[order] + 2 * np.pi])
    distances = np.tile(fit.distances[order], 3)
    angles = finite_array(angles, "angles")
    half_width = check_positive(half_width, "half_width")
    first, last = (
        np.searchsorted(around, angles - half_width),
        np.searchsorted(around, angles + half_width, side="right"),
    )
    rows = []
    for angle, start, stop in zip(angles, first, last, strict=True):
        middle, deviation = (
            _median(distances[start:stop]) if stop - start >= minimum else (np.nan, np.nan)
        )
        rows.append((np.rad2deg(angle), stop - start, 1000 * middle, 1000 * deviation))
    return pd.DataFrame(
        rows, columns=["angle_deg", "points", "residual_mm", "standard_deviation_mm"]
    )


def _median(values: np.ndarray) -> tuple[float, float]:
    """Median and its standard deviation.

    How many of n values lie below the true one is binomial, with n/2 ± √n/2.
    """
    ordered, count = np.sort(values), len(values)
    half = 0.5 * TWO_SIDED * np.sqrt(count)
    low, high = (
        max(0, int(np.floor(0.5 * (count - 1) - half))),
        min(count - 1, int(np.ceil(0.5 * (count - 1) + half))),
    )
    return float(np.median(ordered)), float(ordered[high] - ordered[low]) / (2 * TWO_SIDED)


def hidden_deformation(first: pd.DataFrame, second: pd.DataFrame) -> pd.DataFrame:
    """Deformation that two ellipses hide: the change of the residual profiles between the epochs.

    first, second : of :func:`residual_profile` for the same directions. What stands in both epochs,
        such as a cable tray or a
    joint, drops out. Columns `angle_deg`, `hidden_mm`, `standard_deviation_mm`; NaN in a gap of
    either epoch.
    """
    if not np.array_equal(first["angle_deg"], second["angle_deg"]):
        raise ValueError(
            "second: expected a profile for the directions of the first, got other ones"
        )
    return pd.DataFrame(
        {
            "angle_deg": first["angle_deg"],
            "hidden_mm": second["residual_mm"] - first["residual_mm"],
            "standard_deviation_mm": np.hypot(
                first["standard_deviation_mm"], second["standard_deviation_mm"]
            ),
        }
    )


def _of_shape(values, lead: tuple[int, ...], shape: tuple[int, ...], name: str) -> np.ndarray:
    """Finite ``values`` of the given shape or with the leading axes ``lead`` as well."""
    array = finite_array(values, name)
    if array.shape not in (shape, lead + shape):
        raise ValueError(f"{name}: expected shape {shape} or {lead + shape}, got {array.shape}")
    return array


def _probability(value, name: str) -> float:
    if not 0 < (number := check_positive(value, name)) < 1:
        raise ValueError(f"{name}: expected a probability between 0 and 1, got {value!r}")
    return number
