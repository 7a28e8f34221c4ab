"""The elliptic cylinder in space: a straight axis in any direction and an elliptic section normal
to it.

    p = point + w t + (e1, e2) S e,   |e| = 1,   S = [m + g, h; h, m − g]

with the section's m = (a + b)/2 and (g, h) = (a − b)/2 · (cos 2φ, sin 2φ) as for the ellipse
(:mod:`analysis.surfaces.ellipse`), so that a circular cylinder is nothing special. Seven parameters
are free: two offsets of the axis along e1 and e2, two tilts of its direction t towards them, and m,
g, h. Distances are those of the section, and w along the axis enters their derivatives once:

    ∂d/∂offset = −N,   ∂d/∂tilt = −w N,   ∂d/∂(m, g, h) as for the ellipse

where N is the unit normal in the section. Source: Li et al. 2015, step 4, whose noise filter
adjusts elliptic cylinders; the derivatives follow from turning the frame about the point on the
axis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..adjustment.linalg import propagate, solve
from ..checks import finite_array
from ..orthogonal.cloud import Cloud, Points, frame_of
from ..orthogonal.least_trimmed_squares import SUBSET
from ..result import Fit
from .conic import axes_of
from .cylinder_start import started
from .ellipse import EllipseModel

PARAMETERS = 7
# The numbers x that describe a cylinder: a point on its axis, the rows e1, e2, t of an orthonormal
# frame, and m, g, h.
POINT, FRAME, SHAPE = slice(0, 3), slice(3, 12), slice(12, 15)
IN_SECTION = [0, 1, 4, 5, 6]  # of the free parameters
VERTICAL = np.cos(np.radians(1.0))


class CylinderModel:
    """The elliptic cylinder as a geometric model, x (…, 15); free are offsets and tilts along e1
    and e2, m, g and h.
    """

    dimension = 3
    degrees = PARAMETERS
    sample = 7
    holds = False

    @staticmethod
    def moved(x: np.ndarray, step: np.ndarray) -> np.ndarray:
        """x after a step (…, 7): the section moves as an ellipse does, and t tilts about the point
        by a rotation without a turn about t.
        """
        frame = _frame(x)
        section = EllipseModel.moved(_section(x), step[..., IN_SECTION])
        point = x[..., POINT] + np.einsum("...i,...ij->...j", section[..., :2], frame[..., :2, :])
        tilt = step[..., 2:4]
        angle = np.sqrt(np.einsum("...i,...i->...", tilt, tilt))[..., None]
        sine = np.sinc(angle / np.pi)  # sin(angle)/angle
        bend = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2  # (1 − cos(angle))/angle²
        along, towards = frame[..., 2, :], np.einsum("...i,...ij->...j", tilt, frame[..., :2, :])
        turned = np.empty_like(frame)
        turned[..., 2, :] = np.cos(angle) * along + sine * towards
        turned[..., :2, :] = (
            frame[..., :2, :] - tilt[..., None] * (sine * along + bend * towards)[..., None, :]
        )
        return np.concatenate(
            [point, turned.reshape(turned.shape[:-2] + (9,)), section[..., 2:]], axis=-1
        )

    @staticmethod
    def distances(x: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Distances of first order of points (B, n, 3) from K cylinders each, x (B, K, 15) → (B, K,
        n).
        """
        coordinates = _coordinates(x, points[:, None])
        in_section = coordinates[..., :2, :].swapaxes(-1, -2)
        flat = in_section.reshape((-1,) + in_section.shape[-2:])
        return EllipseModel.distances(_section(x).reshape(-1, 1, 5), flat)[:, 0].reshape(
            in_section.shape[:-1]
        )

    @staticmethod
    def linearised(x: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Orthogonal distances (…, n) of points (…, n, 3) from x (…, 15), and their Jacobian (…, 7,
        n).
        """
        coordinates = _coordinates(x, points)
        d, of_ellipse = EllipseModel.linearised(
            _section(x), coordinates[..., :2, :].swapaxes(-1, -2)
        )
        tilts = coordinates[..., 2:, :] * of_ellipse[..., :2, :]
        return d, np.concatenate([of_ellipse[..., :2, :], tilts, of_ellipse[..., 2:, :]], axis=-2)

    @staticmethod
    def normals(x: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Unit normals at the feet of points (…, n, 3), outwards."""
        in_section = _coordinates(x, points)[..., :2, :].swapaxes(-1, -2)
        return EllipseModel.normals(_section(x), in_section) @ _frame(x)[..., :2, :]

    @staticmethod
    def adjusted(x: np.ndarray, points: Points) -> np.ndarray:
        """The places on the cylinder nearest to the points in the metric of Q⁻¹, (B, n, 3).

        Nothing is prescribed along the axis. So in the section the metric is the inverse of that
        part Q₂ of Q, and the error along the axis is the one that belongs to the error in the
        section, ``Q_w2 Q₂⁻¹ e₂``.
        """
        frame = _frame(x)
        axes = frame[:, None] @ points.axes
        Q = (axes * points.variances[..., None, :]) @ axes.swapaxes(-1, -2)
        section = Points.of(_coordinates(x, points.D)[:, :2].swapaxes(-1, -2), Q[..., :2, :2])
        error = section.D - EllipseModel.adjusted(_section(x), section)
        along = Q[..., 2:, :2] @ solve(Q[..., :2, :2], error[..., None])
        return points.D - np.concatenate([error, along[..., 0]], axis=-1) @ frame


def _frame(x: np.ndarray) -> np.ndarray:
    """Rows e1, e2, t, (…, 3, 3)."""
    return x[..., FRAME].reshape(x.shape[:-1] + (3, 3))


def _section(x: np.ndarray) -> np.ndarray:
    """(0, 0, m, g, h), (…, 5): the section as an ellipse about the axis."""
    return np.concatenate([np.zeros(x.shape[:-1] + (2,)), x[..., SHAPE]], axis=-1)


def _coordinates(x: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Coordinates (…, 3, n) of points (…, n, 3) along e1, e2 and t from the point on the axis."""
    frame = _frame(x)
    coordinates = frame @ points.swapaxes(-1, -2)
    coordinates -= frame @ x[..., POINT, None]
    return coordinates


def section_axes(direction: np.ndarray) -> np.ndarray:
    """Unit vectors right and up, (…, 2, 3), in the sections normal to directions t (…, 3).

        up ∝ e_Z − t (tᵀe_Z),   right = t × up

    For a direction within 1° of the vertical, which has no such up, e_Y stands for e_Z.

    >>> section_axes(np.array([0.0, 1.0, 0.0]))
    array([[1., 0., 0.],
           [0., 0., 1.]])
    """
    above = _above(direction)
    up = above - np.einsum("...i,...i->...", direction, above)[..., None] * direction
    up /= np.sqrt(np.einsum("...i,...i->...", up, up))[..., None]
    return np.stack([np.cross(direction, up), up], axis=-2)


def _above(direction: np.ndarray) -> np.ndarray:
    return np.where(np.abs(direction[..., 2:]) > VERTICAL, [0.0, 1.0, 0.0], [0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False, repr=False)
class CylinderFit(Fit):
    """A fitted elliptic cylinder; ``parameters`` (…, 9) are its direction, a point in m, the
    semi-axes a ≥ b in m and φ in rad.

    Seven of them are free, and the covariance has rank 7: where along the axis the point lies is a
    convention without variance.

    regular : (…, 15) the same cylinder as its point, the unit vectors right, up and along, and m,
        g, h: m = (a + b)/2, (g, h) = (a − b)/2 · (cos 2φ, sin 2φ)
    regular_cofactor : (…, 7, 7) of offsets of the axis to the right and up at the point (m), tilts
        of its direction to the right and up (rad), m, g, h (m). Where a − b is not many times its
        standard deviation, φ and a − b are far from normally distributed and their entries in
        ``cofactor`` say little (of a circle: nothing); these hold at any shape.
    """

    regular: np.ndarray | None = None
    regular_cofactor: np.ndarray | None = None

    NAMES = ("t_x", "t_y", "t_z", "x", "y", "z", "a", "b", "phi")
    PER_STACK = (*Fit.PER_STACK, "regular", "regular_cofactor")

    @property
    def direction(self) -> np.ndarray:
        """(…, 3) unit vector t along the axis; the component that is largest in magnitude is
        positive.
        """
        return self.parameters[..., :3]

    @property
    def point(self) -> np.ndarray:
        """(…, 3) in m: the point of the axis nearest to the centroid of the points."""
        return self.parameters[..., 3:6]

    @property
    def semi_axes(self) -> np.ndarray:
        """(…, 2) in m, the major one first."""
        return self.parameters[..., 6:8]

    @property
    def angle(self):
        """(…) direction of the major axis, in [0, π) rad from right towards up
        (:func:`section_axes`).
        """
        return self.parameters[..., 8]

    @property
    def regular_covariance(self) -> np.ndarray:
        """(…, 7, 7) covariance of the free parameters."""
        if self.absolute:
            return self.regular_cofactor
        return np.asarray(self.sigma_0)[..., None, None] ** 2 * self.regular_cofactor

    def surface(self) -> tuple[CylinderModel, np.ndarray, np.ndarray]:
        x = self.regular.reshape(-1, FRAME.stop + 3)
        return CylinderModel(), x, _described(x)[1]


def _described(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The nine parameters of x (B, 15) in the frame right, up, along, and their Jacobian by the
    free ones, (B, 9, 7).
    """
    frame = _frame(x)
    t = frame[:, 2]
    ellipse, of_ellipse = axes_of(_section(x))
    J = np.zeros((len(x), 9, PARAMETERS))
    J[:, :3, 2:4] = J[:, 3:6, :2] = frame[:, :2].swapaxes(-1, -2)
    J[:, 6:, 4:] = of_ellipse[:, 2:, 2:]
    # When t swings to the right, "right" stays level and so turns about t, the more the steeper t
    # is; φ is counted from it.
    sine = np.einsum("bi,bi->b", t, _above(t))
    J[:, 8, 2] = -sine / np.sqrt(1.0 - sine * sine)
    return np.concatenate([t, x[:, POINT], ellipse[:, 2:]], axis=-1), J


def _oriented(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same cylinders with the axis' point nearest to the origin and the frame right, up, along;
    and the Jacobian, (B, 7, 7), of their free parameters by those of x (B, 15)."""
    frame = _frame(x)
    t = frame[:, 2]
    sign = np.sign(np.take_along_axis(t, np.argmax(np.abs(t), axis=-1)[:, None], axis=-1))
    axes = section_axes(sign * t)
    along = -np.einsum("bi,bi->b", x[:, POINT], t)[:, None]
    turn = axes @ frame[:, :2].swapaxes(-1, -2)  # orthogonal, from (e1, e2) to right and up
    c, s = turn[:, 0, 0], turn[:, 1, 0]
    reflected = np.linalg.det(turn)
    cosine, sine = c * c - s * s, 2.0 * c * s  # S turns with it: (g, h) by twice the angle
    J = np.zeros((len(x), PARAMETERS, PARAMETERS))
    J[:, :2, :2] = turn
    J[:, :2, 2:4] = along[..., None] * turn
    J[:, 2:4, 2:4] = sign[..., None] * turn
    J[:, 4, 4] = 1.0
    J[:, 5:, 5] = np.stack([cosine, sine], axis=-1)
    J[:, 5:, 6] = np.stack([-sine, cosine], axis=-1) * reflected[:, None]
    shape = np.einsum("bij,bj->bi", J[:, 4:, 4:], x[:, SHAPE])
    return np.concatenate(
        [x[:, POINT] + along * t, axes.reshape(-1, 6), sign * t, shape], axis=-1
    ), J


@dataclass(frozen=True, eq=False)
class CylinderCloud(Cloud):
    """A stack of clouds around cylinders.

    axis : (3,) approximate direction of all their axes, or None where it is to be looked for
    """

    axis: np.ndarray | None

    @property
    def model(self) -> CylinderModel:
        return CylinderModel()

    def start(self) -> np.ndarray:
        """(B, 15) near the cylinder that fits all points best."""
        return started(self.model, self.observations().drawn(SUBSET, 0).all().D, self.axis, None)[0]

    def trimmed_start(self, model, D: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """Of seven points a sample would seldom be clean, and no closed form gives a cylinder from
        them: see ``cylinder_start``.
        """
        return started(model, D, self.axis, seed)

    def bias(self, x: np.ndarray, sigma_0: np.ndarray) -> np.ndarray:
        raise ValueError(
            "bias_correction: expected False, which is all there is for an elliptic cylinder, got True"
        )

    def fit(self, method: str, adjusted) -> CylinderFit:
        """The result in m of an adjustment  in the cloud's frame."""
        x, J = _oriented(adjusted.x)
        scale = np.broadcast_to(self.length[:, None], (len(x), PARAMETERS)).copy()
        scale[:, 2:4] = 1.0
        cofactor = propagate(adjusted.cofactor, scale[..., None] * J)
        x[:, POINT] *= self.length[:, None]
        x[:, SHAPE] *= self.length[:, None]
        distances = np.empty(self.points.shape[:2])
        for piece in self.pieces():  # about the centroid, where no digits are lost
            distances[:, piece] = self.model.linearised(
                x, self.points[:, piece] - self.origin[:, None]
            )[0]
        x[:, POINT] += self.origin
        parameters, of_free = _described(x)
        return CylinderFit(
            method=method,
            parameters=parameters,
            cofactor=propagate(cofactor, of_free),
            sigma_0=adjusted.sigma,
            distances=distances,
            weights=np.broadcast_to(1.0, distances.shape)
            if adjusted.weights is None
            else adjusted.weights,
            iterations=adjusted.convergence.iterations,
            converged=adjusted.convergence.converged,
            stop_reason=adjusted.convergence.stop_reason,
            regular=x,
            regular_cofactor=cofactor,
        )


def reduce(
    points: np.ndarray, weights=None, cofactors=None, first: int | None = None, *, axis=None
) -> CylinderCloud:
    """Centre and scale a stack ``(B, n, 3)``; axis (3,) the approximate direction of all axes or
    None, the others as in :class:`Cloud`.

    Raises ``ValueError`` when the points of a cloud lie in a plane as far as their coordinates can
    tell, and for an axis without direction.
    """
    if axis is not None:
        axis = finite_array(axis, "axis")
        if axis.shape != (3,) or not axis.any():
            raise ValueError(
                f"axis: expected three numbers that are not all 0, got {axis.tolist()}"
            )
        axis = axis / np.linalg.norm(axis)
    cloud = CylinderCloud(points, weights, cofactors, first, *frame_of(points), axis=axis)
    factor = cloud.factor_of(_rows)
    extents = np.linalg.svd(factor[..., 1:, 1:], compute_uv=False) * cloud.length[:, None]
    if bad := cloud.degenerate(extents, 3):
        shape = ("all at one place", "on one line", "in one plane")[bad[1]]
        raise ValueError(
            f"points: expected points that determine an elliptic cylinder, got points {shape}{cloud.name(bad[0])}"
        )
    return cloud


def _rows(points: np.ndarray, origin: np.ndarray, length: np.ndarray) -> np.ndarray:
    rows = np.ones((len(points), 4, points.shape[-2]))
    rows[:, 1:] = (points.swapaxes(-1, -2) - origin[..., None]) / length[:, None, None]
    return rows
