"""The result of a fit: frozen, the same for every geometry and method."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import numpy as np


class ConvergenceWarning(UserWarning):
    """A fit stopped before it had converged; its ``stop_reason`` says why."""


def rms(distances, where=None):
    """Root mean square over the last axis, ``σs = √(Σ d² / n)``, optionally ``where`` a mask holds.

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
    """One iteration of a reweighted fit: parameters after it, the scale and the weights found from
    them.
    """

    parameters: np.ndarray
    scale: np.ndarray
    weights: np.ndarray


@dataclass(frozen=True, eq=False, repr=False)
class Fit:
    """A fitted surface. With a stack of clouds ``(…, n, 3)`` every field has its leading axes
    ``…``.

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
    """

    method: str
    parameters: np.ndarray
    cofactor: np.ndarray
    sigma_0: np.ndarray
    distances: np.ndarray
    weights: np.ndarray
    iterations: int | np.ndarray
    converged: bool | np.ndarray
    stop_reason: str | np.ndarray
    history: tuple[Iteration, ...] = ()
    absolute: bool = False

    NAMES = ()  # of the parameters, set by each geometry
    PER_STACK = (
        "parameters",
        "cofactor",
        "sigma_0",
        "distances",
        "weights",
        "iterations",
        "converged",
        "stop_reason",
    )

    @property
    def covariance(self) -> np.ndarray:
        """``sigma_0² · cofactor``, (…, t, t); the cofactor itself where it is absolute."""
        return (
            self.cofactor
            if self.absolute
            else np.asarray(self.sigma_0)[..., None, None] ** 2 * self.cofactor
        )

    @property
    def standard_deviations(self) -> np.ndarray:
        """Square roots of the diagonal of the covariance, (…, t)."""
        return np.sqrt(np.diagonal(self.covariance, axis1=-2, axis2=-1))

    @property
    def inliers(self) -> np.ndarray:
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

    def surface(self):
        """The fitted surfaces as their geometric model has them: the model, x (B, s), and
        ∂(parameters)/∂(free parameters), (B, P, t).
        """
        raise NotImplementedError

    def __repr__(self) -> str:
        shape = np.shape(self.sigma_0)
        if shape:
            return f"{type(self).__name__}(method={self.method!r}, stack of shape {shape}, {np.count_nonzero(self.converged)} converged)"
        values = ", ".join(
            f"{name}={value:.6g}" for name, value in zip(self.NAMES, self.parameters, strict=True)
        )
        used = f"{np.count_nonzero(self.inliers)} of {len(self.weights)} points in use"
        return (
            f"{type(self).__name__}(method={self.method!r}, {values}, {used}; {self.stop_reason})"
        )


def joined(fits: list[Fit], lead: tuple[int, ...], absolute: bool = False) -> Fit:
    """Fits of consecutive parts of a flattened stack as one fit with leading axes ``lead``, its
    arrays read-only.
    """
    arrays = {}
    for name in fits[0].PER_STACK:
        parts = [getattr(fit, name) for fit in fits]
        array = parts[0] if len(parts) == 1 else np.concatenate(parts)
        array = array.reshape(lead + array.shape[1:])
        array.flags.writeable = False
        arrays[name] = array[()]
    return replace(fits[0], absolute=absolute, **arrays)


def warn_if_not_converged(fit: Fit) -> None:
    """Give a :class:`ConvergenceWarning` that counts the fits that did not converge and quotes the
    first reason.
    """
    failed = ~np.atleast_1d(fit.converged).ravel()
    if failed.any():
        reason = np.atleast_1d(fit.stop_reason).ravel()[failed][0]
        count = "" if failed.size == 1 else f"{failed.sum()} of {failed.size} fits: "
        warnings.warn(f"{fit.method}: {count}{reason}", ConvergenceWarning, stacklevel=4)
