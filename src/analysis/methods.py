"""The named methods, which tables and figures iterate over, and the ``fit_*`` that run them.

A new method is one function in its geometry's file and one line here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from .adjustment import igg3
from .blocks import BLOCK, pieces
from .checks import check_one_of, check_positive, finite_array, point_array
from .orthogonal.cloud import Cloud, DegenerateCloud, a_priori
from .orthogonal.gauss_helmert import geometric
from .orthogonal.robust import robust
from .result import Array, Fit, Given, join, warn_if_not_converged
from .surfaces import cylinder, ellipse, plane, plane_eiv, sphere, sphere_eiv

# Where the number of iterations varies much from cloud to cloud, more of them together: the slowest
# then run alone for a smaller part of the time.
LONG_BLOCK = 4 * BLOCK
WU_CHEN_WANG = "Wu, Chen & Wang, total least squares by a quasi-Newton method"
OU_LIU = "Ou & Liu 2017, doi:10.7510/jgjs.issn.1001-3806.2017.05.026"


@dataclass(frozen=True)
class Method:
    """A named method: its label in tables, its sources, its colour in figures, and its function.

    Clouds of a stack are solved together as many as make ``block`` points, so that what one step
    needs stays in the processor's cache. A ``consistent`` method takes full cofactors of the points
    and a fixed radius; the printed ones cannot. A ``seeded`` one draws random numbers.
    ``sigma_0_unit`` is the unit of σ0 without cofactors: m² where the residual is algebraic,
    |p − k|² − r².
    """

    label: str
    citation: str
    colour: str
    function: Callable[..., Fit]
    block: int = BLOCK
    consistent: bool = False
    seeded: bool = False
    sigma_0_unit: str = "m"


# Colours: Okabe & Ito's eight, which colour-blind readers can tell apart; a method has the same one
# for every surface.
GEOMETRIC = Method(
    "orthogonal distance", "Pope 1972; Neitzel 2010", "#999999", geometric, consistent=True
)
ROBUST = Method(
    "robust",
    "Rousseeuw & Van Driessen 2006; Yang, Song & Xu 2002",
    "#000000",
    robust,
    consistent=True,
    seeded=True,
)

SPHERE_METHODS: dict[str, Method] = {
    "ls": Method("LS", "Kåsa 1976; " + OU_LIU, "#0072B2", sphere_eiv.ls, sigma_0_unit="m²"),
    "tls": Method(
        "TLS (pure SVD)",
        "Golub & Van Loan 1980; " + OU_LIU,
        "#D55E00",
        sphere_eiv.tls,
        sigma_0_unit="m²",
    ),
    "mixed_ls_tls": Method(
        "mixed LS-TLS",
        "Van Huffel & Vandewalle 1991",
        "#CC79A7",
        sphere_eiv.mixed_ls_tls,
        sigma_0_unit="m²",
    ),
    "wtls": Method("WTLS", "Schaffrin & Wieser 2008; " + OU_LIU, "#E69F00", sphere_eiv.wtls),
    "igg3_wtls": Method(
        "IGG III-WTLS",
        OU_LIU,
        "#009E73",
        partial(igg3.igg3_wtls, printed_problem=sphere_eiv.printed_problem),
        LONG_BLOCK,
    ),
    "eiv": Method("EIV, full cofactors", "Fang 2013", "#56B4E9", sphere_eiv.eiv, consistent=True),
    "geometric": GEOMETRIC,
    "robust": ROBUST,
}

PLANE_METHODS: dict[str, Method] = {
    "ls": Method("LS", "Gauss-Markov model; " + WU_CHEN_WANG, "#0072B2", plane_eiv.ls),
    "tls": Method(
        "TLS (pure SVD)", "Golub & Van Loan 1980; " + WU_CHEN_WANG, "#D55E00", plane_eiv.tls
    ),
    "mixed_ls_tls": Method(
        "mixed LS-TLS", "Van Huffel & Vandewalle 1991", "#CC79A7", plane_eiv.mixed_ls_tls
    ),
    "wtls": Method("WTLS", "Malengo & Pennecchi 2013; " + WU_CHEN_WANG, "#E69F00", plane_eiv.wtls),
    "igg3_wtls": Method(
        "IGG III-WTLS",
        "the scheme of Ou & Liu 2017 with the weights of " + WU_CHEN_WANG,
        "#009E73",
        partial(igg3.igg3_wtls, printed_problem=plane_eiv.printed_problem),
        LONG_BLOCK,
    ),
    "eiv": Method("EIV, full cofactors", "Fang 2013", "#56B4E9", plane_eiv.eiv, consistent=True),
    "geometric": replace(
        GEOMETRIC, citation="Pearson 1901; Pope 1972", function=plane_eiv.geometric
    ),
    "robust": ROBUST,
}

ELLIPSE_METHODS: dict[str, Method] = {
    "direct": Method(
        "direct LS",
        "Fitzgibbon, Pilu & Fisher 1999; Halir & Flusser 1998",
        "#0072B2",
        ellipse.direct,
    ),
    "robust_direct": Method(
        "robust direct LS", "after Xu & Yao 2008", "#009E73", ellipse.robust_direct
    ),
    "geometric": replace(GEOMETRIC, citation="Gander, Golub & Strebel 1994; Pope 1972"),
    "robust": ROBUST,
}

CYLINDER_METHODS: dict[str, Method] = {"geometric": GEOMETRIC, "robust": ROBUST}


@dataclass(frozen=True)
class Geometry:
    """A kind of surface: the class of its clouds, its points, and its methods."""

    cloud: type[Cloud]
    dimension: int
    minimum: int  # number of points
    methods: dict[str, Method]


SPHERE = Geometry(sphere.SphereCloud, 3, 4, SPHERE_METHODS)
PLANE = Geometry(plane.PlaneCloud, 3, 3, PLANE_METHODS)
ELLIPSE = Geometry(ellipse.EllipseCloud, 2, 5, ELLIPSE_METHODS)
CYLINDER = Geometry(cylinder.CylinderCloud, 3, 7, CYLINDER_METHODS)


def fit_sphere(
    points,
    method: str = "robust",
    *,
    radius=None,
    cofactors=None,
    weights=None,
    absolute: bool = False,
    seed: int = 0,
    **method_options,
) -> sphere.SphereFit:
    """Fit a sphere to each cloud of a stack.

    Parameters
    ----------
    points : (n, 3) or (…, n, 3) coordinates in m, n ≥ 4. Not changed.
    method : a name from ``SPHERE_METHODS``.
    radius : a fixed radius in m, or None to estimate it (methods ``eiv``, ``geometric``,
        ``robust``).
    cofactors : (n,) or (…, n) variances of the points, each the same in x, y, z; or, for the same
        methods, (n, 3, 3) or (…, n, 3, 3) covariances. None for equal ones.
    weights : (n,) or (…, n) positive a-priori weights, the inverse of variances, or None for ones.
    absolute : True says that the cofactors are variances in m² and not only in proportion; the
        covariance is then not scaled by σ0 (same methods).
    seed : of the samples that ``robust`` starts from; the other methods draw nothing.
    method_options : options of the method, with their defaults:

        =============  ============================================================================
        ``wtls``       unit_weight=1, tolerance=1e-12, max_iterations=200
        ``igg3_wtls``  scale="rms" (or rms_in, rms_w, rms_wc, mad, unit), power=1 (or 2),
                       cumulative=True, unit_weight=1, k0=1.5, k1=2.5, start="Q_Y" (or "P_Y"),
                       tolerance=1e-6, max_iterations=1000, history=False
        ``eiv``        max_iterations=100
        ``geometric``  bias_correction=False (or True), max_iterations=100
        ``robust``     weight_function=None (or a name from ``WEIGHT_FUNCTIONS`` or an instance),
                       k0=2.5, k1=4 (of IGG III, in its place), bias_correction=True,
                       max_iterations=1000
        =============  ============================================================================

        ``help(SPHERE_METHODS["robust"].function)`` describes them.

    Returns
    -------
    SphereFit, its fields with the leading axes of ``points``: ``center`` (…, 3) and ``radius`` (…)
    in m, ``covariance`` (…, 4, 4) of (a, b, c, r), ``distances`` (…, n) in m, ``weights``,
    ``inliers``, σ0, σs and how the iteration ended. A fit that did not converge comes back with
    ``converged`` False, a ``stop_reason`` and a ``ConvergenceWarning``.

    Raises
    ------
    ValueError for wrong shapes, NaN or infinity, fewer than four points, points in a plane or on a
    circle, non-positive weights, an unknown method or option value, and what the method cannot
    take.

    Example
    -------
    >>> directions = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0.0]])
    >>> fit = fit_sphere([10, 10, 1] + 2 * directions, "ls")
    >>> fit.center.round(9), round(float(fit.radius), 9)
    (array([10., 10.,  1.]), 2.0)
    """
    own = {} if radius is None else {"fixed_radius": check_positive(radius, "radius")}
    return _fit(SPHERE, points, method, cofactors, weights, absolute, seed, method_options, own)


def fit_plane(
    points,
    method: str = "robust",
    *,
    station=(0.0, 0.0, 0.0),
    cofactors=None,
    weights=None,
    absolute: bool = False,
    seed: int = 0,
    **method_options,
) -> plane.PlaneFit:
    """Fit a plane to each cloud of a stack.

    Parameters
    ----------
    points : (n, 3) or (…, n, 3) coordinates in m, n ≥ 3. Not changed.
    method : a name from ``PLANE_METHODS``. ``ls``, ``tls``, ``wtls`` and ``igg3_wtls`` look for z =
        a x + b y + c and refuse a vertical plane; the others take any orientation.
    station : (3,) in m, where the scanner stood; ``wtls`` and ``igg3_wtls`` take their weights from
        the incidence angle.
    cofactors, weights, absolute, seed : as for :func:`fit_sphere`.
    method_options : options of the method, with their defaults:

        =============  ============================================================================
        ``wtls``       algorithm="bfgs" (or another of ``ALGORITHMS``), cosine_at="raw" (or
                       "projected"), reweightings=3, max_iterations=200
        ``eiv``        max_iterations=100
        ``geometric``  max_iterations=100
        others         as for :func:`fit_sphere`
        =============  ============================================================================

    Returns
    -------
    PlaneFit, its fields with the leading axes of ``points``: ``parameters`` (…, 3) a, b and c in m,
    ``normal`` (…, 3) and ``offset`` (…) in m, ``covariance`` (…, 3, 3) of (a, b, c),
    ``normal_covariance`` (…, 4, 4) of (normal, offset), ``distances`` (…, n) in m, and the rest as
    for a sphere.

    Raises
    ------
    ValueError as :func:`fit_sphere`; points on a line determine no plane.

    Example
    -------
    >>> fit = fit_plane([[0, 0, 1], [1, 0, 2], [0, 1, 4], [1, 1, 5.0]])
    >>> fit.parameters.round(9), fit.normal.round(4)
    (array([1., 3., 1.]), array([-0.3015, -0.9045,  0.3015]))
    """
    station = finite_array(station, "station")
    if station.shape != (3,):
        raise ValueError(f"station: expected shape (3,), got {station.shape}")
    own = {"station": station}
    return _fit(PLANE, points, method, cofactors, weights, absolute, seed, method_options, own)


def fit_ellipse(
    points,
    method: str = "robust",
    *,
    cofactors=None,
    weights=None,
    absolute: bool = False,
    seed: int = 0,
    **method_options,
) -> ellipse.EllipseFit:
    """Fit an ellipse to each plane cloud of a stack.

    Parameters
    ----------
    points : (n, 2) or (…, n, 2) coordinates in m, n ≥ 5. Not changed.
    method : a name from ``ELLIPSE_METHODS``.
    cofactors : (n,) or (…, n) variances of the points, or, for ``geometric`` and ``robust``, (n, 2,
        2) or (…, n, 2, 2) covariances.
    weights, absolute, seed : as for :func:`fit_sphere`.
    method_options : ``robust_direct`` takes k0=1.5, k1=2.5, max_iterations=200; the others as for
        :func:`fit_sphere`.

    Returns
    -------
    EllipseFit, its fields with the leading axes of ``points``: ``center`` (…, 2) and ``semi_axes``
    (…, 2) in m, the major one first, ``angle`` (…) of the major axis in [0, π) rad, ``covariance``
    (…, 5, 5) of (u0, v0, a, b, φ), and the rest as for a sphere.

    Raises
    ------
    ValueError as :func:`fit_sphere`; points on a line, or on more than one conic, determine no
    ellipse.

    Example
    -------
    >>> t = np.arange(12) * np.pi / 6
    >>> fit = fit_ellipse(np.column_stack([1 + 3 * np.cos(t), 2 + 2 * np.sin(t)]))
    >>> fit.center.round(9), fit.semi_axes.round(9)
    (array([1., 2.]), array([3., 2.]))
    """
    return _fit(ELLIPSE, points, method, cofactors, weights, absolute, seed, method_options, {})


def fit_elliptic_cylinder(
    points,
    method: str = "robust",
    *,
    axis=None,
    cofactors=None,
    weights=None,
    absolute: bool = False,
    seed: int = 0,
    **method_options,
) -> cylinder.CylinderFit:
    """Fit an elliptic cylinder to each cloud of a stack.

    Parameters
    ----------
    points : (n, 3) or (…, n, 3) coordinates in m, n ≥ 7. Not changed.
    method : a name from ``CYLINDER_METHODS``.
    axis : (3,) approximate direction of the axis, of either sign and any length, or None to look
        for it. It saves time and is only a start; it should be right to some degrees.
    cofactors, weights, absolute, seed, method_options : as for :func:`fit_sphere`.

    Returns
    -------
    CylinderFit, its fields with the leading axes of ``points``: ``direction`` (…, 3), ``point`` (…,
    3) and ``semi_axes`` (…, 2) in m, ``angle`` (…) in rad, ``covariance`` (…, 9, 9) of all of them,
    ``regular_covariance`` (…, 7, 7), which holds for a circular cylinder too, and the rest as for a
    sphere.

    Raises
    ------
    ValueError as :func:`fit_sphere`; points in a plane determine no elliptic cylinder.

    Example
    -------
    >>> turn, along = np.meshgrid(np.arange(12.0), [0.0, 1.0, 2.0])
    >>> points = np.stack([3 * np.cos(turn), along, 2 * np.sin(turn)], axis=-1).reshape(-1, 3)
    >>> fit = fit_elliptic_cylinder(points, "geometric")
    >>> fit.direction.round(9) + 0.0, fit.semi_axes.round(9), round(float(fit.angle), 9) % np.pi
    (array([0., 1., 0.]), array([3., 2.]), 0.0)
    """
    if axis is not None:
        axis = finite_array(axis, "axis")
        if axis.shape != (3,) or not axis.any():
            raise ValueError(
                f"axis: expected three numbers that are not all 0, got {axis.tolist()}"
            )
        axis = axis / np.linalg.norm(axis)
    own = {"axis": axis}
    return _fit(CYLINDER, points, method, cofactors, weights, absolute, seed, method_options, own)


def _fit(
    geometry: Geometry,
    points,
    method: str,
    cofactors,
    weights,
    absolute: bool,
    seed: int,
    options: dict[str, Any],
    own: dict[str, Any],
) -> Any:
    """Common part of every ``fit_*``: check, solve the stack a block at a time, join the fits."""
    chosen = geometry.methods[check_one_of(method, geometry.methods, "method")]
    points = point_array(points, geometry.dimension, geometry.minimum, geometry.cloud.surface)
    a_priori_weights, matrices = a_priori(weights, cofactors, points.shape)
    asked = {
        "full cofactors": matrices is not None,
        "absolute cofactors": absolute,
        "a held radius": "fixed_radius" in own,
    }
    if absolute and cofactors is None:
        raise ValueError("absolute: expected cofactors, which are to be absolute, got none")
    _require_able(geometry, method, [what for what, wanted in asked.items() if wanted])
    if chosen.seeded:
        options["seed"] = seed
    given = {"weights": a_priori_weights, "cofactors": matrices}
    reduce = partial(geometry.cloud.reduce, absolute=absolute, **own)
    fits = _solve(reduce, chosen, points, given, options)
    station = _known(own.get("station"))
    kept = Given.of_stack(points, a_priori_weights, matrices, station)
    fit = join(fits, points.shape[:-2], kept)
    warn_if_not_converged(fit)
    return fit


def _known(station: Array | None) -> Array | None:
    """A station, unless it is the origin that stands where none was given."""
    return station if station is not None and station.any() else None


def _require_able(geometry: Geometry, method: str, asked: list[str]) -> None:
    """Raise ``ValueError`` if something is asked of a method that only the consistent ones can."""
    if asked and not geometry.methods[method].consistent:
        able = ", ".join(name for name, one in geometry.methods.items() if one.consistent)
        raise ValueError(f"method: expected one of {able} with {asked[0]}, got {method!r}")


def _solve(
    reduce: Callable[..., Cloud],
    method: Method,
    points: Array,
    given: dict[str, Array | None],
    options: dict[str, Any],
) -> list[Fit]:
    """Fits of points (…, n, dim), as many clouds together as make a block of the method."""
    lead, (n, dim) = points.shape[:-2], points.shape[-2:]
    flat = points.reshape((-1, n, dim))
    fits = []
    for part in pieces(len(flat), max(1, method.block // n)):
        theirs = {name: None if array is None else array[part] for name, array in given.items()}
        try:
            fits.append(method.function(reduce(flat[part], **theirs), **options))
        except DegenerateCloud as error:
            which = f" in cloud {part.start + error.index} of the stack" if lead else ""
            raise ValueError(f"{error}{which}") from None
    return fits
