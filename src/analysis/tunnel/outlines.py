"""Change of a section between two epochs: polar radii compared, with standard deviations.

    Δρ(α) = ρ₂(α) − ρ₁(α),   point (u, v) = pole + ρ (sin α, cos α)

α is 0 at the crown and positive to the right; u is to the right and v up, in the section's plane.
Both epochs are seen from one pole. Δρ is a linear function of what was estimated, the outline of
either epoch and the shift between the epochs' frames:

    var Δρ = g₁ᵀΣ₁g₁ + g₂ᵀΣ₂g₂ + sᵀΣₜs

with g the gradients of the radii and s that of a shift of the second outline. Neighbouring
directions are strongly correlated; everything derived from Δρ takes that along. An outline is an
ellipse: it does not follow a local dent.

Source: Li et al. (2015), section 3.4.3; the standard deviations are an addition.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.stats import norm

from ..adjustment.linalg import propagate
from ..checks import finite_array
from ..surfaces.ellipse import EllipseFit

# the track bed hides the rest (Li et al. 2015, section 4.2.2)
ANGLES = np.deg2rad(np.arange(-135.0, 136.0))
UNITS = {  # of the quantities of a section
    "horizontal convergence": "mm",
    "crown settlement": "mm",
    "vertical convergence": "mm",
    "ovality, first": "‰",
    "ovality, second": "‰",
}


@dataclass(frozen=True, eq=False)
class RadialChange:
    """Radial change of sections (…) between two epochs.

    angles : (K,) rad, 0 at the crown, positive to the right
    first, second, difference : (…, K) radii of the epochs and Δρ, m
    gradient : (…, K, P) of Δρ by all that was estimated; covariance : (…, P, P) of that, m² for
        lengths
    """

    angles: np.ndarray
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
        if not 0 < level < 1:
            raise ValueError(f"level: expected a probability between 0 and 1, got {level!r}")
        half = norm.ppf(0.5 + 0.5 * level) * self.standard_deviations
        return self.difference - half, self.difference + half

    def combination(self, weights) -> tuple[np.ndarray, np.ndarray]:
        """Values (…, F) of ``Σ weights Δρ``, weights (F, K), and their covariance (…, F, F)."""
        weights = np.asarray(weights, dtype=float)
        return self.difference @ weights.T, propagate(self.covariance, weights @ self.gradient)


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
    """
    angles = finite_array(angles, "angles")
    if angles.ndim != 1:
        raise ValueError(f"angles: expected shape (K,), got {angles.shape}")
    parts = [first.regular_covariance, second.regular_covariance]
    lead, other = (part.shape[:-2] for part in parts)
    if lead != other:
        raise ValueError(f"second: expected outlines of shape {lead} as the first, got {other}")
    pole = _of_each(first.center if pole is None else pole, lead, (2,), "pole")
    radii_1, gradient_1, _ = first.polar(angles, pole)
    radii_2, gradient_2, shift = second.polar(angles, pole)
    gradients = [-gradient_1, gradient_2]
    if registration is not None:
        gradients.append(shift)
        parts.append(_of_each(registration, lead, (2, 2), "registration"))
    gradient = np.concatenate(gradients, axis=-1)
    covariance = np.zeros(lead + 2 * gradient.shape[-1:])
    start = 0
    for part in parts:
        stop = start + part.shape[-1]
        covariance[..., start:stop, start:stop] = part
        start = stop
    return RadialChange(angles, radii_1, radii_2, radii_2 - radii_1, gradient, covariance)


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
    """
    directions = np.deg2rad([-90.0, 0.0, 90.0, 180.0])
    change = deformation(first, second, pole=pole, angles=directions, registration=registration)
    changes, covariance = change.combination([[1, 0, 1, 0], [0, -1, 0, 0], [0, 1, 0, 1]])
    sd = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    oval, oval_sd = np.stack([ovality(first), ovality(second)], axis=-1)
    values = np.concatenate([changes, oval], axis=-1)
    sections = values[..., 0].size
    names, units = list(UNITS), list(UNITS.values())
    return pd.DataFrame(
        {
            "section": np.repeat(np.arange(sections), len(UNITS)),
            "quantity": names * sections,
            "value": 1000 * values.ravel(),
            "standard_deviation": 1000 * np.concatenate([sd, oval_sd], axis=-1).ravel(),
            "unit": units * sections,
            "extrapolated": [name == "vertical convergence" for name in names] * sections,
        }
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


def _of_each(values, lead: tuple[int, ...], shape: tuple[int, ...], name: str) -> np.ndarray:
    """Finite values of ``shape`` for each section of a stack (lead), or one for all of them."""
    array = finite_array(values, name)
    if array.shape not in (shape, lead + shape):
        raise ValueError(f"{name}: expected shape {shape} or {lead + shape}, got {array.shape}")
    return np.broadcast_to(array, lead + shape)
