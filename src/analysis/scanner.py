"""The stochastic model of a terrestrial laser scanner, and the cofactors it gives the points.

A point is ``p = station + ρ b`` with range ρ and beam direction b. The errors of range and of the
two angles are independent, so with the unit vectors h (horizontal) and v (upwards) across the beam

    Q = σ_ρ² b bᵀ + ρ² (σ_h² h hᵀ + σ_v² v vᵀ),

which is the propagated ``J diag(σ_ρ², σ_φ², σ_η²) Jᵀ`` of polar coordinates. The range is less
certain the farther it is, and the more obliquely the beam meets the surface (incidence angle θ):

    σ_ρ(ρ, θ) = √(σ_1² + (k ρ)²) · cos(θ)^(−γ).

Sources: Soudarissanane, Lindenbergh, Menenti & Teunissen 2011, doi:10.1016/j.isprsjprs.2011.01.005
(range and incidence); Wu, Chen & Wang (weights from the incidence angle, the case γ = 1/2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .checks import check_positive, finite_array, point_array

ARC_SECOND = np.pi / 648_000  # rad


@dataclass(frozen=True)
class Scanner:
    """A scanner: stochastic model, beam and reach.

    Parameters
    ----------
    name : its name in tables
    range_sd : σ_1 in m, of a range at perpendicular incidence
    angle_sd : σ_α in rad, of the direction in either sense across the beam
    range_rate : k, the part of σ_ρ that grows with the range, m per m
    azimuth_sd : σ_φ in rad; where given, ``angle_sd`` is that of the elevation η alone and across
        the beam horizontally the direction has ``cos(η) σ_φ``: full polar form, which has no
        cofactor for the zenith
    incidence_exponent : γ ≥ 0. The default 1/2 makes the range variance proportional to 1/cos θ:
        noise that is inversely proportional to the power which a matt (Lambertian) surface returns,
        and the weights of Wu, Chen & Wang, there given to the coordinates. 0 leaves the incidence
        out.
    max_incidence : rad; beams that meet a surface more obliquely return nothing (assumed: 85°)
    beam_diameter : m, between the points of 1/e² of the intensity, where the beam leaves the
        scanner
    beam_divergence : rad, full angle by which that diameter grows. Without a diameter and a
        divergence the beam is a line and there are no mixed pixels.
    min_range, max_range : m, reach

    Raises
    ------
    ValueError : standard deviations that are not positive, numbers outside their range.

    Example
    -------
    >>> scanner = Scanner("example", range_sd=0.002, angle_sd=6e-5)
    >>> Q = scanner.cofactors([[0.0, 10.0, 0.0]])
    >>> np.round(1e6 * np.diagonal(Q[0]), 2)  # mm²: across, along the beam, across
    array([0.36, 4.  , 0.36])
    """

    name: str
    range_sd: float
    angle_sd: float
    range_rate: float = 0.0
    azimuth_sd: float | None = None
    incidence_exponent: float = 0.5
    max_incidence: float = np.deg2rad(85.0)
    beam_diameter: float = 0.0
    beam_divergence: float = 0.0
    min_range: float = 0.0
    max_range: float = np.inf

    def __post_init__(self):
        for name in ("range_sd", "angle_sd"):
            check_positive(getattr(self, name), name)
        if self.azimuth_sd is not None:
            check_positive(self.azimuth_sd, "azimuth_sd")
        for name in (
            "range_rate",
            "incidence_exponent",
            "beam_diameter",
            "beam_divergence",
            "min_range",
        ):
            value = float(finite_array(getattr(self, name), name))
            if value < 0:
                raise ValueError(f"{name}: expected a number not below 0, got {value:g}")
        if not 0 < self.max_incidence < 0.5 * np.pi:
            raise ValueError(
                "max_incidence: expected an angle between 0 and π/2 rad, "
                f"got {self.max_incidence!r}"
            )
        if not self.max_range > self.min_range:
            raise ValueError(
                f"max_range: expected more than min_range = {self.min_range:g} m, "
                f"got {self.max_range!r}"
            )

    def range_standard_deviation(self, ranges, cosines=1.0) -> np.ndarray:
        """σ_ρ in m for ranges in m and cosines of the incidence angle.

        Beyond ``max_incidence``, where the instrument returns nothing, σ_ρ stays what it is there.

        >>> cosines = np.cos(np.deg2rad([0.0, 60.0, 80.0]))
        >>> np.round(1e3 * LEICA_C10.range_standard_deviation(10.0, cosines), 2)
        array([2.  , 2.83, 4.8 ])
        """
        cosines = np.maximum(np.abs(cosines), np.cos(self.max_incidence))
        perpendicular = np.hypot(self.range_sd, self.range_rate * np.asarray(ranges))
        return perpendicular * cosines**-self.incidence_exponent

    def cofactors(self, points, station=(0.0, 0.0, 0.0), normals=None) -> np.ndarray:
        """Cofactors ``Q = σ_ρ² b bᵀ + ρ² (σ_h² h hᵀ + σ_v² v vᵀ)`` of scanned points.

        Parameters
        ----------
        points : (…, n, 3) in m.
        station : (3,) in m, where the scanner stood. The z axis is its vertical axis.
        normals : (…, n, 3) normals of the surface at the points, of any length and sense, or None
            for perpendicular incidence.

        Returns
        -------
        (…, n, 3, 3) absolute variances in m², symmetric and positive definite, as
        ``fit_sphere(points, cofactors=…)`` takes them.

        Raises
        ------
        ValueError : wrong shapes, NaN or infinity, a point in the station, a normal of length 0;
            with ``azimuth_sd`` a point in the vertical axis, where the azimuth is not defined.

        Example
        -------
        >>> LEICA_C10.cofactors(np.ones((5, 7, 3))).shape
        (5, 7, 3, 3)
        """
        vectors = point_array(points, 3, 1, "a cofactor") - vector(station, "station")
        ranges = np.linalg.norm(vectors, axis=-1)
        if not ranges.all():
            raise ValueError(
                "points: expected points away from the station, "
                f"got {np.count_nonzero(ranges == 0)} in it"
            )
        beams = vectors / ranges[..., None]
        roots = self.roots(beams, ranges, 1.0 if normals is None else _cosines(beams, normals))
        return roots @ roots.swapaxes(-1, -2)

    def roots(self, beams: np.ndarray, ranges: np.ndarray, cosines) -> np.ndarray:
        """Roots ``(σ_ρ b, ρ σ_h h, ρ σ_v v)`` (…, n, 3, 3) of the cofactors, ``Q = R Rᵀ``.

        ``R z`` with standard normal z is therefore an error of the point. Beams are unit vectors
        (…, n, 3).
        """
        roots = np.empty(beams.shape + (3,))
        horizontal, upwards = across(beams)
        cos_elevation = np.hypot(beams[..., 0], beams[..., 1])
        if self.azimuth_sd is None:
            sd_h = self.angle_sd * ranges
        elif cos_elevation.all():
            sd_h = self.azimuth_sd * cos_elevation * ranges
        else:
            raise ValueError(
                "points: expected points off the vertical axis of the station, "
                "where azimuth_sd means nothing, got some on it"
            )
        roots[..., 0] = self.range_standard_deviation(ranges, cosines)[..., None] * beams
        roots[..., 1] = sd_h[..., None] * horizontal
        roots[..., 2] = (self.angle_sd * ranges)[..., None] * upwards
        return roots


def across(beams: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors h and v across unit vectors (…, 3).

    h is horizontal, towards growing azimuth; v leads upwards.

    >>> [np.round(direction, 1) + 0.0 for direction in across(np.array([0.8, 0.0, 0.6]))]
    [array([0., 1., 0.]), array([-0.6,  0. ,  0.8])]
    """
    x, y, z = np.moveaxis(beams, -1, 0)
    cos_elevation = np.hypot(x, y)
    vertical = cos_elevation == 0  # any horizontal direction will do then
    scale = np.where(vertical, 1.0, cos_elevation)
    cos_azimuth, sin_azimuth = np.where(vertical, 1.0, x) / scale, y / scale
    horizontal = np.stack([-sin_azimuth, cos_azimuth, np.zeros_like(x)])
    upwards = np.stack([-z * cos_azimuth, -z * sin_azimuth, cos_elevation])
    return np.moveaxis(horizontal, 0, -1), np.moveaxis(upwards, 0, -1)


def vector(value, name: str) -> np.ndarray:
    """``value`` as a finite (3,) vector."""
    array = finite_array(value, name)
    if array.shape != (3,):
        raise ValueError(f"{name}: expected shape (3,), got {array.shape}")
    return array


def _cosines(beams: np.ndarray, normals) -> np.ndarray:
    """Cosines of the incidence angle (…, n) of unit vectors and normals (…, n, 3)."""
    normals = finite_array(normals, "normals")
    if normals.ndim < 2 or normals.shape[-2:] != beams.shape[-2:]:
        raise ValueError(
            f"normals: expected shape {beams.shape} or {beams.shape[-2:]}, got {normals.shape}"
        )
    try:
        normals = np.broadcast_to(normals, beams.shape)
    except ValueError:
        raise ValueError(
            f"normals: expected shape {beams.shape} or {beams.shape[-2:]}, got {normals.shape}"
        ) from None
    lengths = np.linalg.norm(normals, axis=-1)
    if not lengths.all():
        raise ValueError(
            "normals: expected vectors with a direction, "
            f"got {np.count_nonzero(lengths == 0)} of length 0"
        )
    return np.abs(np.einsum("...i,...i->...", beams, normals)) / lengths


LEICA_C10 = Scanner(
    name="Leica ScanStation C10",
    range_sd=0.002,
    angle_sd=60e-6,
    beam_diameter=0.007,
    min_range=0.1,
    max_range=300.0,
)
"""A scanner like the Leica ScanStation C10, with which Ou & Liu (2017, section 2.2) scanned their
spheres.

The paper gives none of its numbers. These are nominal, from the manufacturer's data sheet as
remembered, not looked up: 12″ = 60 µrad per direction; beam of 7 mm (Gaussian) up to 50 m; reach
0.1 to 300 m. σ_1 is the 2 mm of its "modelled surface precision", because the errors of one
target's points differ by noise; the 4 mm of a single distance also contain what neighbouring points
have in common.
"""

RIEGL_VZ400 = Scanner(
    name="Riegl VZ-400",
    range_sd=0.003,
    angle_sd=7.5 * ARC_SECOND,
    beam_diameter=0.007,
    beam_divergence=0.0003,
    min_range=1.5,
    max_range=500.0,
)
"""A scanner like the Riegl VZ-400 of Li et al. (2015, section 4.1).

From the paper: the reach of 500 m. It prints ±2 mm for a single point at 100 m, which is
optimistic: σ_1 is the nominal precision of 3 mm of the manufacturer's data sheet, as remembered.
Divergence 0.3 mrad and least range 1.5 m as in the definition of this scanner in HELIOS++
(3dgeo-heidelberg/helios, data/scanners_tls.xml). Assumed: a direction of 7.5″ and a beam of 7 mm
where it leaves the scanner.
"""
