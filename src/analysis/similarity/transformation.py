"""The result: a similarity transformation with its accuracy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ..adjustment.linalg import propagate
from ..checks import finite_array
from .pairs import cofactor_matrices


@dataclass(frozen=True, eq=False, repr=False)
class Similarity:
    """``X = translation + scale · rotation @ x`` with its accuracy; a stack has leading axes ``…``.

    scale : (…) μ; rotation : (…, 3, 3) R, det +1
    centre : (…, 3) the point of the source frame about which it was solved; image : (…, 3) where it
        comes to lie
    central_cofactor : (…, 7, 7) cofactor of (image, ω, μ), which hardly depend on one another;
        zeros for a scale fixed at 1
    sigma_0 : (…) unit-weight standard deviation, in m where no cofactors were given
    residuals : (…, n, 3) misclosures ``r = X − t − μ R x`` in m, in the target frame
    weights : (…, n) weight of each pair relative to its a-priori one; 0 is exactly 0
    redundancy : (…) three for each pair in use, less the parameters
    iterations, converged, stop_reason : (…) how it ended
    absolute : the cofactors were variances in m², so that the covariance is not scaled by σ0
    """

    method: str
    scale: np.ndarray
    rotation: np.ndarray
    centre: np.ndarray
    image: np.ndarray
    central_cofactor: np.ndarray
    sigma_0: np.ndarray
    residuals: np.ndarray
    weights: np.ndarray
    redundancy: np.ndarray
    iterations: np.ndarray
    converged: np.ndarray
    stop_reason: np.ndarray
    absolute: bool = False

    @property
    def translation(self) -> np.ndarray:
        """(…, 3) t in m, the image of the source frame's origin."""
        return self.transform(np.zeros(np.shape(self.scale) + (1, 3)))[..., 0, :]

    @property
    def rotation_vector(self) -> np.ndarray:
        """(…, 3) axis times angle of the rotation in rad, in the target frame."""
        vectors = Rotation.from_matrix(self.rotation.reshape(-1, 3, 3)).as_rotvec()
        return vectors.reshape(np.shape(self.scale) + (3,))

    @property
    def cofactor(self) -> np.ndarray:
        """(…, 7, 7) cofactor of (t, ω, μ): m, rad about the target axes, and 1."""
        J = np.broadcast_to(np.eye(7), self.central_cofactor.shape).copy()
        J[..., :3, :] = self._jacobian(np.zeros(np.shape(self.scale) + (1, 3)))[..., 0, :, :]
        return propagate(self.central_cofactor, J)

    @property
    def covariance(self) -> np.ndarray:
        """(…, 7, 7) of (t, ω, μ): ``sigma_0² · cofactor``, or the cofactor where it is absolute."""
        return self._variance_factor * self.cofactor

    @property
    def standard_deviations(self) -> np.ndarray:
        """(…, 7) of (t, ω, μ)."""
        return np.sqrt(np.diagonal(self.covariance, axis1=-2, axis2=-1))

    @property
    def inliers(self) -> np.ndarray:
        """(…, n) bool: the pairs that are in use."""
        return self.weights > 0

    @property
    def scale_test(self) -> np.ndarray:
        """``|μ − 1| / σ_μ``; above 2 the scale is not 1. NaN where it was fixed at 1."""
        sd = np.sqrt(self._variance_factor[..., 0, 0] * self.central_cofactor[..., 6, 6])
        return np.abs(self.scale - 1.0) / np.where(sd > 0, sd, np.nan)

    @property
    def _variance_factor(self) -> np.ndarray:
        if self.absolute:
            return np.ones(np.shape(self.scale) + (1, 1))
        return np.asarray(self.sigma_0)[..., None, None] ** 2

    def transform(self, points) -> np.ndarray:
        """Points (n, 3), (…, n, 3) or one (3,) of the source frame, in the target frame.

        >>> from analysis import fit_similarity
        >>> corner = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
        >>> turned = fit_similarity(corner, [[5, 5, 5], [5, 7, 5], [3, 5, 5]])
        >>> turned.transform([1, 1, 1]).round(12)
        array([3., 7., 7.])
        """
        points = _points(points)
        if points.ndim == 1:
            return self.transform(points[None])[..., 0, :]
        return self.image[..., None, :] + self._turned(points)

    def _turned(self, points: np.ndarray) -> np.ndarray:
        """``μ R (x − centre)``, (…, n, 3)."""
        scaled = np.asarray(self.scale)[..., None, None] * self.rotation
        return (points - self.centre[..., None, :]) @ scaled.mT

    def _jacobian(self, points: np.ndarray) -> np.ndarray:
        """∂X/∂(image, ω, μ) of points of the source frame, (…, n, 3, 7)."""
        turned = self._turned(points)
        return design(turned, turned / np.asarray(self.scale)[..., None, None])

    def common_errors(self, points) -> np.ndarray:
        """Errors (…, n, 3, 7) in m of points (…, n, 3) that the transformation causes.

        Column k holds the displacements of all points by one standard deviation of the k-th of
        seven independent sources, so with A_i of point i the points i and j have the covariance
        ``A_i A_jᵀ``, which does not average out over them. ValueError where σ0 is not known.

        Source: propagation of the parameters' covariance, F Σ Fᵀ, as in Li et al. 2015.
        """
        covariance = self._variance_factor * self.central_cofactor
        if unknown := np.count_nonzero(~np.isfinite(covariance).all(axis=(-1, -2))):
            raise ValueError(
                "similarity: expected a finite covariance, which takes more pairs than determine "
                f"it, or absolute cofactors, got NaN in {unknown} of {np.size(self.scale)}"
            )
        values, vectors = np.linalg.eigh(covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]
        return self._jacobian(_points(points)) @ root[..., None, :, :]

    def transformed_covariance(self, points, cofactors=None) -> np.ndarray:
        """Covariance of each transformed point, ``F Σ Fᵀ + μ² R D Rᵀ``, (…, n, 3, 3) in m².

        points : (n, 3) or (…, n, 3) in the source frame
        cofactors : (n,) variances or (n, 3, 3) covariances D of the points in m²; None for none
        """
        points = _points(points)
        if points.ndim == 1:
            raise ValueError(f"points: expected shape (n, 3) or (…, n, 3), got {points.shape}")
        common = self.common_errors(points)
        total = common @ common.mT
        if cofactors is None:
            return total
        R = np.asarray(self.scale)[..., None, None, None] * self.rotation[..., None, :, :]
        return total + propagate(cofactor_matrices(cofactors, points.shape[:-1], "cofactors"), R)

    def inverse(self) -> Similarity:
        """The transformation from the target to the source frame; its residuals are ``−Rᵀ r/μ``."""
        scale = np.asarray(self.scale)[..., None, None]
        back = self.rotation.mT
        J = np.zeros(np.shape(self.scale) + (7, 7))
        J[..., :3, :3] = -back / scale
        J[..., 3:6, 3:6] = -back
        J[..., 6, 6] = -1.0 / np.asarray(self.scale) ** 2
        return frozen(
            **{
                **vars(self),
                "scale": 1.0 / self.scale,
                "rotation": back,
                "centre": self.image,
                "image": self.centre,
                "central_cofactor": propagate(self.central_cofactor, J),
                "residuals": -(self.residuals @ self.rotation) / scale,
            }
        )

    def __repr__(self) -> str:
        if shape := np.shape(self.scale):
            converged = np.count_nonzero(self.converged)
            fit = f"stack of shape {shape}, {converged} converged"
        else:
            used = f"{np.count_nonzero(self.inliers)} of {len(self.weights)} pairs in use"
            fit = f"scale={self.scale:.9g}, {used}; {self.stop_reason}"
        return f"Similarity(method={self.method!r}, {fit})"


def frozen(**fields) -> Similarity:
    """A similarity whose arrays are read-only."""
    for value in fields.values():
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
    return Similarity(**fields)


def _points(points) -> np.ndarray:
    points = finite_array(points, "points")
    if points.ndim == 0 or points.shape[-1] != 3:
        raise ValueError(f"points: expected shape (…, 3), got {points.shape}")
    return points


def design(turned: np.ndarray, per_scale: np.ndarray) -> np.ndarray:
    """∂(T + exp([ω]×) μ R x)/∂(T, ω, μ) = [I, −[μRx]×, Rx], (…, n, 3, 7)."""
    J = np.zeros(turned.shape + (7,))
    J[..., [0, 1, 2], [0, 1, 2]] = 1.0
    a, b, c = np.moveaxis(turned, -1, 0)
    J[..., 0, 4], J[..., 0, 5] = c, -b
    J[..., 1, 3], J[..., 1, 5] = -c, a
    J[..., 2, 3], J[..., 2, 4] = b, -a
    J[..., 6] = per_scale
    return J
