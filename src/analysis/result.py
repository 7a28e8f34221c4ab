"""The result of a fit: frozen, with the same fields for every geometry and method."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

from .adjustment.iteration import Convergence

if TYPE_CHECKING:
    from .trust import Check

Array: TypeAlias = npt.NDArray[np.float64]


class ConvergenceWarning(UserWarning):
    """A fit stopped before it had converged; its ``stop_reason`` says why."""


@contextmanager
def ignore_convergence_warnings() -> Iterator[None]:
    """Context in which fits give no :class:`ConvergenceWarning`; ``converged`` still tells."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        yield


def rms(distances, where=None):
    """Root mean square over the last axis, ``σs = √(Σ d² / n)``, where a mask is true if given.

    Source: Ou & Liu 2017, eq. (18), right (there over all n points, rejected ones included).

    >>> float(rms([3.0, -4.0, 0.0, 0.0]))
    2.5
    >>> float(rms([3.0, -4.0, 100.0], where=[True, True, False])) == 12.5 ** 0.5
    True
    """
    distances = np.asarray(distances, dtype=float)
    if where is None:
        return np.sqrt(np.einsum("...i,...i->...", distances, distances) / distances.shape[-1])
    where = np.asarray(where, dtype=bool)
    count = np.count_nonzero(where, axis=-1)
    squares = np.einsum("...i,...i->...", distances, np.where(where, distances, 0.0))
    return np.sqrt(squares / np.where(count, count, np.nan))


@dataclass(frozen=True, eq=False)
class Iteration:
    """One iteration of a reweighted fit: the parameters, and the scale and weights from them."""

    parameters: Array
    scale: Array
    weights: Array


@dataclass(frozen=True)
class Adjustment:
    """Solution of a stack of B clouds in their own frames, from which a :class:`Fit` is made.

    x (B, s) numbers that describe the surfaces; cofactor (B, t, t) of the free parameters; sigma
    (B,) at cofactor 1; weights (B, n), or None for ones; convergence; history of the iterations.
    """

    x: Array
    cofactor: Array
    sigma: Array
    weights: Array | None
    convergence: Convergence
    history: tuple[Iteration, ...] = ()

    @classmethod
    def closed_form(cls, x: Array, cofactor: Array, sigma: Array) -> Adjustment:
        """One that took no iteration."""
        return cls(x, cofactor, sigma, None, Convergence.closed_form(len(x)))

    def replaced(self, where: np.ndarray, by: Adjustment) -> Adjustment:
        """This one with other solutions for the clouds (B,) of a mask."""

        def filled(name: str, ours: Any, theirs: Any) -> np.ndarray:
            new = getattr(ours, name).copy()
            new[where] = getattr(theirs, name)
            return new

        ours, theirs = self.convergence, by.convergence
        ended = {name: filled(name, ours, theirs) for name in vars(ours)}
        arrays: dict[str, Any] = {
            name: filled(name, self, by) for name in ("x", "cofactor", "sigma", "weights")
        }
        return replace(self, **arrays, convergence=Convergence(**ended))


class FittedSurface(NamedTuple):
    """Surfaces as their geometric model describes them, and the derivatives of their parameters."""

    model: Any  # GeometricModel
    x: Array  # (B, s) in the caller's frame
    jacobian: Array  # (B, P, t) ∂(parameters)/∂(free parameters)


@dataclass(frozen=True, eq=False)
class Given:
    """What a fit was made from, by reference.

    points : (…, n, dim) in m; weights (…, n), or None for ones; matrices (…, n, dim, dim) are full
        cofactors, or None; station (dim,) in m is where the scanner stood, or None
    """

    points: Array
    weights: Array | None = None
    matrices: Array | None = None
    station: Array | None = None

    @classmethod
    def of_stack(
        cls, points: Array, weights: Array | None, matrices: Array | None, station: Array | None
    ) -> Given:
        """From weights (B, n) and matrices (B, n, dim, dim) of the flattened stack."""
        lead = points.shape[:-2]
        if weights is not None:
            weights = weights.reshape(lead + weights.shape[1:])
        if matrices is not None:
            matrices = matrices.reshape(lead + matrices.shape[1:])
        return cls(points, weights, matrices, station)

    def __getitem__(self, index) -> Given:
        """Some clouds of the stack."""
        weights = None if self.weights is None else self.weights[index]
        matrices = None if self.matrices is None else self.matrices[index]
        return Given(self.points[index], weights, matrices, self.station)


@dataclass(frozen=True, eq=False, repr=False)
class Fit:
    """A fitted surface; of a stack of clouds ``(…, n, 3)`` every array has the leading axes ``…``.

    method : name of the method
    parameters : (…, t)
    cofactor : (…, t, t) unscaled covariance of the parameters;
        ``covariance = sigma_0² · cofactor``, or the cofactor itself where the cofactors of the
        points were ``absolute`` variances
    sigma_0 : (…) unit-weight standard deviation in the unit of the method's own residuals, so
        comparable only within a method
    distances : (…, n) signed orthogonal distances of the points in m, positive outside
    weights : (…, n) weight of each point in the last adjustment relative to its a-priori one; 0 is
        exactly 0
    iterations, converged, stop_reason : (…) how it ended
    history : the iterations, where the method was asked to keep them
    given : the points and what was said of them, for :meth:`checks`
    """

    method: str
    parameters: Array
    cofactor: Array
    sigma_0: Array
    distances: Array
    weights: Array
    iterations: npt.NDArray[np.int_]
    converged: npt.NDArray[np.bool_]
    stop_reason: npt.NDArray[np.object_]
    history: tuple[Iteration, ...] = ()
    absolute: bool = False
    given: Given | None = None

    NAMES: ClassVar[tuple[str, ...]] = ()  # of the parameters, set by each geometry
    SIZES: ClassVar[slice] = slice(0, 0)  # of the parameters that are lengths of the surface

    def scaled(self, cofactor: Array) -> Array:
        """``sigma_0² · cofactor`` (…, k, k); the cofactor itself where it is absolute."""
        if self.absolute:
            return cofactor
        return np.asarray(self.sigma_0)[..., None, None] ** 2 * cofactor

    @property
    def covariance(self) -> Array:
        """(…, t, t) of the parameters: ``sigma_0² · cofactor``, or the cofactor if absolute."""
        return self.scaled(self.cofactor)

    @property
    def standard_deviations(self) -> Array:
        """Square roots of the diagonal of the covariance, (…, t)."""
        return np.sqrt(np.diagonal(self.covariance, axis1=-2, axis2=-1))

    @property
    def inliers(self) -> npt.NDArray[np.bool_]:
        """(…, n) bool: the points that are in use, weight above 0."""
        return self.weights > 0

    @property
    def sigma_s(self):
        """RMS distance over all points, in m."""
        return rms(self.distances)

    @property
    def sigma_s_inliers(self):
        """RMS distance over the points in use, in m."""
        return rms(self.distances, where=self.inliers)

    def surface(self) -> FittedSurface:
        """The fitted surfaces as their geometric model describes them."""
        raise NotImplementedError

    def sizes(self) -> tuple[Array, Array]:
        """Lengths (…, k) of the surface and their standard deviations, 0 of a fixed one."""
        return self.parameters[..., self.SIZES], self.standard_deviations[..., self.SIZES]

    def checks(self) -> tuple[Check, ...] | tuple[Any, ...]:
        """How far the fit can be trusted; for a stack one such tuple per cloud.

        Computed when asked for. Those that do not apply are left out.

        >>> import analysis
        >>> fit = analysis.fit_plane([[0, 0, 1], [1, 0, 2], [0, 1, 4], [1, 1, 5.0]])
        >>> [check.name for check in fit.checks() if not check.passed]
        ['redundancy']
        """
        if np.ndim(self.sigma_0):
            return tuple(self[index].checks() for index in range(len(self.sigma_0)))
        from .trust import checks_of  # which imports the solvers, and they this module

        return checks_of(self)

    def __getitem__(self, index) -> Self:
        """The fits of some clouds of a stack.

        >>> import analysis
        >>> square = np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1.0]])
        >>> analysis.fit_plane([square, 2 * square])[1].parameters.round(9) + 0.0
        array([0., 0., 2.])
        """
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        indexed: dict[str, Any] = {
            name: value[index]
            for name, value in values.items()
            if isinstance(value, np.ndarray | Given)
        }
        return replace(self, **indexed)

    def __repr__(self) -> str:
        shape = np.shape(self.sigma_0)
        if shape:
            values = f"stack of shape {shape}, {np.count_nonzero(self.converged)} converged"
        else:
            named = zip(self.NAMES, self.parameters, strict=True)
            values = ", ".join(f"{name}={value:.6g}" for name, value in named)
            used = f"{np.count_nonzero(self.inliers)} of {len(self.weights)} points in use"
            values += f", {used}; {self.stop_reason}"
        return f"{type(self).__name__}(method={self.method!r}, {values})"


F = TypeVar("F", bound=Fit)


def join(fits: Sequence[F], lead: tuple[int, ...], given: Given | None = None) -> F:
    """Join fits of consecutive parts of a flattened stack into one with leading axes ``lead``.

    Its arrays are read-only.
    """
    if lead and fits[0].history:
        raise ValueError("history: expected a single cloud, got a stack")
    arrays: dict[str, Any] = {}
    for field in fields(fits[0]):
        parts = [getattr(fit, field.name) for fit in fits]
        if isinstance(parts[0], np.ndarray):
            array = parts[0] if len(parts) == 1 else np.concatenate(parts)
            array = array.reshape(lead + array.shape[1:])
            array.flags.writeable = False
            arrays[field.name] = array[()]
    return replace(fits[0], given=given, **arrays)


def warn_if_not_converged(fit) -> None:
    """Give a :class:`ConvergenceWarning` with the number of failed fits and their first reason."""
    failed = ~np.atleast_1d(fit.converged).ravel()
    if failed.any():
        reason = np.atleast_1d(fit.stop_reason).ravel()[failed][0]
        count = "" if failed.size == 1 else f"{failed.sum()} of {failed.size} fits: "
        warnings.warn(f"{fit.method}: {count}{reason}", ConvergenceWarning, stacklevel=4)
