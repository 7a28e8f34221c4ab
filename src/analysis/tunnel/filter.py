"""Filter of the lining: elliptic cylinders by segments, and a surface that follows deformation.

The paper fits an elliptic cylinder and takes off what lies away from it. Around one cylinder for a
whole tunnel, and with a fixed limit, that takes off the deformation too. So here

1. the tunnel is straightened along its axis and cut in segments of at most 3 m, each epoch by
   itself;
2. an elliptic cylinder is fitted to each segment, robustly, to one point per pixel so that near and
   far parts count alike;
3. points farther from it than ``reach`` are no lining. Through the other points goes a smooth
   surface of residuals (:mod:`analysis.tunnel.lining_surface`), and a point is lining if it lies
   within ``threshold`` σ of that.

Points are flagged, never deleted. Source: Li et al. 2015, step 4, for the elliptic cylinder; the
limit of 3 σ from the median is a reading, because the paper does not print its own. The surface of
residuals is an addition.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import cast

import numpy as np

from ..blocks import pieces
from ..checks import check_one_of, check_positive, point_array
from ..orthogonal.robust import robust
from ..result import join
from ..surfaces.cylinder import CylinderCloud, CylinderFit, CylinderModel
from .axis import Axis
from .lining_surface import ROUGHNESS, PixelGrid, fitted
from .medians import median_scale

LINING, INSIDE, OUTSIDE, UNSUPPORTED = 0, -1, 1, 2
FEWEST = 100  # points in a segment
SMALLEST, LARGEST = 0.5, 20.0  # m, radius
# m, of a segment with a local surface, whose system grows with the cube of the length
LONGEST = 10.0
SURFACES = ("local", "cylinder")


@dataclass(frozen=True, eq=False)
class Segment:
    """One segment of the tunnel.

    start, end : chainage in m
    count : points in it
    center : (2,) of the section in its middle, right and up from the axis, m
    semi_axes (2,) in m, angle in rad from right towards up : of its elliptic cylinder
    sigma : m, from the median of the points within reach; limit : m, the largest distance of a
        lining point
    converged, stop_reason : how the adjustment of the cylinder ended
    """

    start: float
    end: float
    count: int
    center: np.ndarray
    semi_axes: np.ndarray
    angle: float
    sigma: float
    limit: float
    converged: bool
    stop_reason: str


@dataclass(frozen=True, eq=False)
class FilteredLining:
    """Result of :func:`filter_lining`, in the order of the points.

    flags : (n,) int8, 0 lining; −1 inside it: cables, lamps, bolts, track bed; +1 outside: pockets,
        joints, mixed pixels; 2 unsupported: too few points around to say
    distances : (n,) m, signed and positive outside, from the surface by which it was decided: the
        segment's elliptic cylinder plus, with the local surface, the residual surface. NaN where
        unsupported
    cylinder_distances : (n,) m, from the elliptic cylinder alone; they hold the deformation
    segment : (n,) number of the segment
    segments : the segments
    """

    flags: np.ndarray
    distances: np.ndarray
    cylinder_distances: np.ndarray
    segment: np.ndarray
    segments: tuple[Segment, ...]

    @property
    def lining(self) -> np.ndarray:
        """(n,) bool."""
        return self.flags == LINING


def filter_lining(
    points,
    axis: Axis,
    *,
    segment: float = 3.0,
    threshold: float = 3.0,
    surface: str = "local",
    reach: float = 0.06,
    seed: int = 0,
) -> FilteredLining:
    """Flag the points of one epoch that are not lining.

    Parameters
    ----------
    points : (n, 3) in m. Not changed.
    axis : of the tunnel.
    segment : largest length of a segment, m; with ``surface="cylinder"`` also infinity, for one
        cylinder around all.
    threshold : a point is lining up to this many σ, to either side; σ is 1.4826 times the median of
        the absolute distances of the segment's points within reach.
    surface : "local", the cylinder and a smooth surface of residuals, so that deformation is not
        taken off; "cylinder", the elliptic cylinder alone.
    reach : largest distance in m that the local surface may have from the cylinder.
    seed : of the robust adjustment.

    Returns
    -------
    FilteredLining. Attachments are found from about threshold σ on, if they are narrower than about
    0.3 m in one direction or stand off by more than ``reach``. What is no lining, with the track
    bed, may be up to about 45 % of a segment's surface. With fewer than about 500 points a metre
    the surface follows the noise a little, and up to 1 % of the lining is lost instead of 0.3 %.

    Raises ``ValueError`` for wrong shapes, NaN, non-positive lengths or an unknown surface, for
    what is no tunnel in metres around the axis, and when no segment can be adjusted.

    >>> from analysis.tunnel.axis import straight
    >>> generator = np.random.default_rng(0)
    >>> angle, y = generator.uniform(-2.4, 2.4, 20_000), generator.uniform(0, 6, 20_000)
    >>> radius = 2.7 + 0.003 * generator.standard_normal(20_000)
    >>> radius[:100] -= 0.1
    >>> points = np.column_stack([radius * np.sin(angle), y, radius * np.cos(angle)])
    >>> result = filter_lining(points, straight(np.zeros(3), np.array([0.0, 6.0, 0.0])))
    >>> bool((result.flags[:100] == -1).all()), bool(result.lining[100:].mean() > 0.995)
    (True, True)
    """
    points = point_array(points, 3, 1, "a tunnel")
    check_one_of(surface, SURFACES, "surface")
    segment = np.inf if segment == np.inf else check_positive(segment, "segment")
    if surface == "local" and segment > LONGEST:
        raise ValueError(
            f"segment: expected at most {LONGEST:g} m with a local surface, got {segment}"
        )
    threshold, reach = check_positive(threshold, "threshold"), check_positive(reach, "reach")
    along, radius, angle = axis.polar(points)
    for piece in pieces(len(points)):
        along[piece] = axis.chainage(along[piece])
    if not SMALLEST <= (typical := float(np.median(radius))) <= LARGEST:
        raise ValueError(
            f"points: expected a tunnel of {SMALLEST:g} to {LARGEST:g} m radius, in m, got "
            f"{typical:.4g} from the axis"
        )
    first, last = along.min(), along.max()
    edges = np.linspace(first, last, max(1, int(np.ceil((last - first) / segment))) + 1)
    number = np.searchsorted(edges[1:-1], along, side="right").astype(np.int32)
    order = np.argsort(number, kind="stable")
    bounds = np.searchsorted(number[order], np.arange(len(edges)))
    flags = np.full(len(points), UNSUPPORTED, dtype=np.int8)
    distances, from_cylinder = np.full(len(points), np.nan), np.full(len(points), np.nan)
    segments = []
    for ends, within in zip(pairwise(edges.tolist()), pairwise(bounds), strict=True):
        part = order[slice(*within)]
        polar = radius[part], angle[part], along[part]
        one, d, e = _segment(*polar, *ends, threshold, surface, reach, seed)
        segments.append(one)
        from_cylinder[part], distances[part] = d, e
        if one.converged:
            flags[part] = np.where(np.abs(e) <= one.limit, LINING, np.where(e < 0, INSIDE, OUTSIDE))
    if not any(one.converged for one in segments):
        raise ValueError(
            f"points: expected a segment that can be adjusted, got {len(segments)}, the first "
            f"{segments[0].stop_reason}"
        )
    return FilteredLining(flags, distances, from_cylinder, number, tuple(segments))


def _segment(
    rho, alpha, w, start, end, threshold, surface, reach, seed
) -> tuple[Segment, np.ndarray, np.ndarray]:
    """The segment, and distances of its points from the cylinder and from the deciding surface."""
    try:
        if len(rho) < FEWEST or end <= start:
            raise ValueError(
                f"expected at least {FEWEST} points along some length, got {len(rho)} along "
                f"{end - start:.3g} m"
            )
        grid = PixelGrid.of(float(np.median(rho)), start, end, len(rho))
        fit = _cylinder(rho, alpha, w, grid, seed)
        if not fit.converged:
            raise ValueError(fit.stop_reason)
    except ValueError as error:
        unknown, nothing = np.full(2, np.nan), np.full(len(rho), np.nan)
        size = unknown, unknown, np.nan, np.nan, np.nan
        reason = f"not adjusted: {error}"
        return Segment(start, end, len(rho), *size, False, reason), nothing, nothing
    d = _distances(fit, rho, alpha, w)
    near = np.abs(d) <= reach
    e = d
    if surface == "local":
        residual = fitted(grid, grid.pixels(alpha[near], w[near]), d[near])
        e = d.copy()
        for piece in pieces(len(d)):
            e[piece] -= grid.interpolated(residual, alpha[piece], w[piece])
    sigma = median_scale(e[near], ROUGHNESS)
    middle = fit.point + (0.5 * (start + end) - fit.point[1]) / fit.direction[1] * fit.direction
    segment = Segment(
        start,
        end,
        len(rho),
        center=middle[[0, 2]],
        semi_axes=fit.semi_axes,
        angle=float(fit.angle),
        sigma=sigma,
        limit=threshold * sigma,
        converged=True,
        stop_reason=str(fit.stop_reason),
    )
    return segment, d, e


def _one_a_pixel(pixel: np.ndarray, rho: np.ndarray) -> np.ndarray:
    """Indices of the points with the median radius of their pixels."""
    order = np.argsort(pixel + 0.5 * rho / rho.max())
    first = np.flatnonzero(np.diff(pixel[order], prepend=-1))
    last = np.append(first[1:], len(order))
    return order[(first + last) // 2]


def _cartesian(rho, alpha, w) -> np.ndarray:
    """Right, along, up, (n, 3): the straightened tunnel runs along y."""
    return np.stack([rho * np.sin(alpha), w, rho * np.cos(alpha)], axis=-1)


def _cylinder(rho, alpha, w, grid: PixelGrid, seed: int) -> CylinderFit:
    """Robust fit to one point a pixel."""
    chosen = _one_a_pixel(grid.pixels(alpha, w), rho)
    points = _cartesian(rho[chosen], alpha[chosen], w[chosen])
    cloud = CylinderCloud.reduce(points[None], axis=np.array([0.0, 1.0, 0.0]))
    return join([cast(CylinderFit, robust(cloud, seed=seed))], ())


def _distances(fit: CylinderFit, rho, alpha, w) -> np.ndarray:
    d = np.empty(len(rho))
    for piece in pieces(len(rho)):
        points = _cartesian(rho[piece], alpha[piece], w[piece])
        d[piece] = CylinderModel.distances(fit.regular[None, None], points[None])[0, 0]
    return d
