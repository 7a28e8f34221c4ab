"""Joint adjustment of the stations of all epochs: targets, control net, level and lining.

A station registered singly has its own five or so targets and nothing else, and its error is in
every section it sees. In one adjustment of all stations

- neighbours of one epoch are held together by the lining: where both have points in a cell of the
  wall, its radius is one and the same. Never across epochs: the tunnel moves, which is what is
  looked for;
- a control point has one error for all stations that use it, in both epochs; as far as they share
  it, it drops out of their difference;
- the level of an instrument holds its inclination.

Unknown are a shift τ and a rotation ω of every station against its single registration, about the
image of its targets' centroid, and the errors e of the control points. With a = X − image, Z the
vertical axis of the instrument and e_Z plumb, up to errors of the standard deviations on the right:

    target        X_net − X = τ + ω × a + e          scanner_sd a coordinate
    control net           0 = e                      control_sd a coordinate
    level         e_Z − Z   = ω × Z                  level_sd, both horizontal components
    lining              ρ̄   = h − nᵀ(τ + ω × a)      σ √(1/n + 1/20) for the mean radius ρ̄ of n
                        points in a cell

Every cell has its own radius h, which is eliminated; what is solved has six unknowns a station and
three a control point. σ comes from the scatter of the lining's residuals. These have first the
weights 1/|v| and from there IGG III weights, because attachments are seen from two sides in two
ways. Corrections of millimetres and minutes of arc are so small that the equations are linear to
micrometres.

Cells are taken as independent. They are nearly so: in simulated campaigns what the ties alone
determine, to hundredths of a millimetre, is stated a tenth or two too well. In the place of a
section between stations that is nothing beside what targets and net leave; at the ends of a tunnel,
where it is carried on from cell to cell, true errors are larger than stated by one to three tenths.

References
----------
Grün & Akca (2005), ISPRS Journal of Photogrammetry and Remote Sensing 59, 151-174 (surfaces as
observations of a registration). Yang, Song & Xu (2002), Journal of Geodesy 76, 353-358 (IGG III).
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from ..adjustment.linalg import cofactor_from_normal, solve
from ..adjustment.weights import EFFICIENT_THRESHOLDS, IGG3
from ..checks import check_positive, finite_array
from ..result import ConvergenceWarning
from .lining_surface import POINTS_THAT_COUNT
from .medians import median_scale
from .registration import Station
from .surface_ties import Ties

WEIGHTS = IGG3(*EFFICIENT_THRESHOLDS)
# m, of a radius. Exact ties would have any weight; with 1e-9 m the normal matrix loses what targets
# and net say to rounding, and the covariance is off by a tenth.
SMALLEST_SD = 1e-6
STANDS_STILL = 1e-6  # m and rad
# With weights 1/|v|: IGG III would take all ties of two stations that are registered some
# millimetres apart for wrong.
FIRST_STEPS = 10
MAX_STEPS = 60


@dataclass(frozen=True, eq=False)
class Block:
    """Registered stations with their joint covariance.

    stations : by name, as :func:`.register_stations` gives them, with the transformations of the
        adjustment
    covariance : (6K, 6K) of (image, ω) of the K stations one after the other, m and rad
    sigma_0 : of targets, control net and level; 1 where their standard deviations are right
    tie_sd : σ in m: the mean radius of n points in a cell has the standard deviation σ √(1/n +
        1/20)
    tie_weights : (m,) weights of the ties, those of the first epoch first; 0 is exactly 0
    iterations, converged, stop_reason : how the adjustment ended
    """

    stations: dict[str, Station]
    covariance: np.ndarray
    sigma_0: float = np.nan
    tie_sd: float = np.nan
    tie_weights: np.ndarray = field(default_factory=lambda: np.empty(0))
    iterations: int = 0
    converged: bool = True
    stop_reason: str = "registered singly"

    def shifts(self, point, directions) -> np.ndarray:
        """Covariance (K d, K d) in m² of the stations' errors at a point (3,).

        In each of ``directions`` (d, 3). The d shifts of the first station are followed by those
        of the second and so on: ``J Σ Jᵀ`` with ``J = [dᵀ, (a × d)ᵀ]``.

        >>> from analysis.similarity import fit_similarity
        >>> x = np.array([[3.0, 0, 0], [-3, 0, 0], [0, 9, 0], [0, 0, 3]])
        >>> fit = fit_similarity(x, x, scale=False, target_cofactors=0.002**2, absolute=True)
        >>> block = singly({"S1": Station("S1", tuple("abcd"), x, x, fit, fit)})
        >>> np.sqrt(block.shifts(x.mean(axis=0), np.eye(3)).diagonal()).round(6)
        array([0.001, 0.001, 0.001])
        """
        directions = finite_array(directions, "directions")
        point = finite_array(point, "point")
        arms = (point - station.similarity.image for station in self.stations.values())
        J = block_diag(*(_rows(arm, directions) for arm in arms))
        return J @ self.covariance @ J.T


def singly(stations: Mapping[str, Station]) -> Block:
    """Stations as they are, each with its own covariance and none between them."""
    own = (station.similarity.central_cofactor[:6, :6] for station in stations.values())
    return Block(dict(stations), block_diag(*own))


def adjust_block(
    stations: Mapping[str, Station],
    ties: Sequence[Ties] = (),
    *,
    scanner_sd: float,
    control_sd: float,
    level_sd: float | None = None,
) -> Block:
    """Adjust all stations of all epochs together.

    Parameters
    ----------
    stations : by name, registered singly with the scale held at 1; pairs that this has found wrong
        stay out
    ties : of every epoch, from :func:`surface_ties`
    scanner_sd, control_sd : standard deviation of a coordinate of a target in the scans and in the
        control net, m
    level_sd : of the inclination of an instrument about either horizontal axis, rad, where the Z
        axes of the stations' frames are plumb to that; None for instruments without a level

    Returns
    -------
    Block. The equations are solved anew with new weights of the ties until the corrections stand
    still.

    Raises ``ValueError`` for no stations, standard deviations that are not positive, stations with
    a free scale or without absolute variances, a target that has other coordinates at another
    station, ties of unknown stations, and cells of a single one. Not converged:
    ``converged`` is False, ``stop_reason`` says why, and a ``ConvergenceWarning`` is given.

    >>> from analysis.similarity import fit_similarity
    >>> x = np.array([[3.0, 0, 0], [-3, 0, 0], [0, 9, 0], [0, 0, 3]])
    >>> X = x + [0, 50, 0]
    >>> fit = fit_similarity(x, X, scale=False, target_cofactors=0.002**2, absolute=True)
    >>> stations = {"1": Station("1", tuple("abcd"), x, X, fit, fit)}
    >>> block = adjust_block(stations, scanner_sd=0.002, control_sd=0.001)
    >>> block.stations["1"].similarity.translation.round(9) + 0, block.converged
    (array([ 0., 50.,  0.]), True)
    """
    scanner_sd = check_positive(scanner_sd, "scanner_sd")
    control_sd = check_positive(control_sd, "control_sd")
    A, y = _surveyed(stations, scanner_sd, control_sd, level_sd)
    lining = _Lining.of(ties, stations)
    count, own = len(stations), slice(6 * len(stations))
    x, weights = np.zeros(A.shape[1]), np.ones(len(lining.radii))
    for iterations in range(1, MAX_STEPS + 1):
        u = lining.standardised(x[own].reshape(count, 6), weights)
        sigma = median_scale(u, SMALLEST_SD) if len(u) else np.nan
        weights = (
            sigma / np.maximum(np.abs(u), sigma)
            if iterations <= FIRST_STEPS
            else WEIGHTS.weight(u / sigma)
        )
        N, right = A.T @ A, A.T @ y
        N_lining, right_lining = lining.normal(weights / sigma**2, count)
        N[own, own] += N_lining
        right[own] += right_lining
        x, before = solve(N, right[:, None])[:, 0], x
        change = float(np.abs(x - before).max())
        if iterations > FIRST_STEPS and not change > STANDS_STILL:
            break
    converged, stop_reason = change <= STANDS_STILL, "corrections stand still"
    if not converged:
        stop_reason = f"not converged: corrections still change by {change:.2g}"
        warnings.warn(stop_reason, ConvergenceWarning, stacklevel=2)
    cofactor = cofactor_from_normal(N)
    v, redundancy = y - A @ x, len(y) - np.sum(A @ cofactor * A)
    moved = {}
    for k, (name, station) in enumerate(stations.items()):
        of = slice(6 * k, 6 * k + 6)
        moved[name] = _moved(station, x[of], cofactor[of, of])
    return Block(
        moved,
        cofactor[own, own],
        sigma_0=float(np.sqrt(v @ v / redundancy)),
        tie_sd=sigma,
        tie_weights=weights,
        iterations=iterations,
        converged=converged,
        stop_reason=stop_reason,
    )


def _rows(arms: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """``dᵀ(τ + ω × a)`` as rows (…, 6) for (τ, ω), of arms and directions (…, 3)."""
    arms, directions = np.broadcast_arrays(arms, directions)
    return np.concatenate([directions, np.cross(arms, directions)], axis=-1)


def _surveyed(
    stations: Mapping[str, Station], scanner_sd: float, control_sd: float, level_sd: float | None
) -> tuple[np.ndarray, np.ndarray]:
    """Whitened rows A (r, 6K + 3M) and observations y (r,) of K stations and M control points.

    From targets, net and level.
    """
    net = _net(stations)
    count, points = 6 * len(stations), {name: place for place, name in enumerate(net)}
    unknowns = count + 3 * len(net)
    blocks = [np.eye(3 * len(net), unknowns, count) / control_sd]
    y = [np.zeros(3 * len(net))]
    for k, station in enumerate(stations.values()):
        fit, own = station.similarity, slice(6 * k, 6 * k + 6)
        seen = fit.transform(station.source)
        for name, root, X, X_net in zip(
            station.targets, np.sqrt(fit.weights), seen, station.target, strict=True
        ):
            if root > 0:
                rows = np.zeros((3, unknowns))
                rows[:, own] = _rows(X - fit.image, np.eye(3))
                rows[:, count + 3 * points[name] + np.arange(3)] = np.eye(3)
                blocks.append(rows * root / scanner_sd)
                y.append((X_net - X) * root / scanner_sd)
        if level_sd is not None:
            Z, rows = fit.rotation[:, 2], np.zeros((2, unknowns))
            rows[:, 6 * k + 3 : 6 * k + 6] = np.cross(Z, np.eye(3)[:2])
            blocks.append(rows / check_positive(level_sd, "level_sd"))
            y.append(-Z[:2] / level_sd)
    return np.concatenate(blocks), np.concatenate(y)


def _net(stations: Mapping[str, Station]) -> dict[str, np.ndarray]:
    """Control points in use and their coordinates."""
    if not stations:
        raise ValueError("stations: expected at least one, got none")
    net: dict[str, np.ndarray] = {}
    for name, station in stations.items():
        if not station.similarity.absolute or station.similarity.central_cofactor[6, 6] > 0:
            raise ValueError(
                f"station {name}: expected variances in m² and a scale held at 1, as "
                "register_stations gives them"
            )
        for target, X, used in zip(
            station.targets, station.target, station.similarity.inliers, strict=True
        ):
            if used and not np.array_equal(net.setdefault(target, X), X):
                raise ValueError(
                    f"station {name}: expected one place for target {target} at all stations, got "
                    "another one"
                )
    return net


@dataclass(frozen=True)
class _Lining:
    """Equations of the ties: rows J (m, 6) of stations (m,) in cells (m,).

    With radii (m,) less the mean of their cell and precisions (m,).
    """

    J: np.ndarray
    station: np.ndarray
    cell: np.ndarray
    radii: np.ndarray
    precision: np.ndarray

    @classmethod
    def of(cls, ties: Sequence[Ties], stations: Mapping[str, Station]) -> _Lining:
        of, images = Ties.join(ties), [station.similarity.image for station in stations.values()]
        if unknown := sorted(set(of.stations.tolist()) - set(stations)):
            raise ValueError(
                f"ties: expected those of the stations {', '.join(stations)}, got "
                f"{', '.join(unknown)}"
            )
        count = np.bincount(of.cells)
        if count.min(initial=2) < 2:
            raise ValueError(
                "ties: expected at least two stations in every cell, got cells with fewer"
            )
        names = {name: place for place, name in enumerate(stations)}
        place = np.array([names[name] for name in of.stations.tolist()], dtype=int)
        return cls(
            J=_rows(of.points - np.array(images)[place], of.normals),
            station=place,
            cell=of.cells,
            radii=of.radii - (np.bincount(of.cells, of.radii) / count)[of.cells],
            precision=1.0 / (1.0 / of.counts + 1.0 / POINTS_THAT_COUNT),
        )

    def normal(self, weights: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Normal matrix (6K, 6K) and right side (6K,); the radii of the cells are eliminated.

        weights (m,) over σ².
        """
        w, cells = weights * self.precision, int(self.cell.max(initial=0)) + 1
        squares, right = np.zeros((count, count, 6, 6)), np.zeros((count, 6))
        of_cell = np.zeros((cells, count, 6))
        wJ = w[:, None] * self.J
        np.add.at(squares, (self.station, self.station), wJ[:, :, None] * self.J[:, None, :])
        np.add.at(right, self.station, -wJ * self.radii[:, None])
        np.add.at(of_cell, (self.cell, self.station), wJ)
        sums, total = of_cell.reshape(cells, -1), np.bincount(self.cell, w, cells)
        total = np.where(total > 0, total, 1.0)
        of_radius = np.bincount(self.cell, w * self.radii, cells) / total
        N = squares.swapaxes(1, 2).reshape(6 * count, 6 * count) - sums.T @ (sums / total[:, None])
        return N, right.ravel() + sums.T @ of_radius

    def standardised(self, corrections: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Radii (m,) less the weighted mean of their cell, over its standard deviation for σ = 1.

        corrections (K, 6).

        With weights ω and precisions p the variance is ``1/p − 2ω/W + Σpω²/W²``, W = Σpω. A cell in
        which no two stations have kept a weight is judged by the plain mean.
        """
        v = self.radii + np.sum(self.J * corrections[self.station], axis=-1)
        kept = np.bincount(self.cell, weights > 0)[self.cell] >= 2
        weights = np.where(kept, weights, 1.0)
        w = weights * self.precision
        W = np.bincount(self.cell, w)[self.cell]
        mean = np.bincount(self.cell, w * v)[self.cell] / W
        variance = (
            1.0 / self.precision
            - 2.0 * weights / W
            + np.bincount(self.cell, w * weights)[self.cell] / W**2
        )
        return (v - mean) / np.sqrt(variance)


def _moved(station: Station, correction: np.ndarray, cofactor: np.ndarray) -> Station:
    fit = station.similarity
    central = np.zeros((7, 7))
    central[:6, :6] = cofactor
    moved = replace(
        fit,
        method="joint adjustment",
        image=fit.image + correction[:3],
        rotation=Rotation.from_rotvec(correction[3:]).as_matrix() @ fit.rotation,
        central_cofactor=central,
    )
    residuals = station.target - moved.transform(station.source)
    return replace(station, similarity=replace(moved, residuals=residuals))
