"""The elliptic cylinder: a straight axis in any direction and an elliptic section normal to it.

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
from ..orthogonal.cloud import Cloud
from ..orthogonal.contracts import GeometricModel, Start
from ..orthogonal.observations import Points
from ..result import Adjustment, Array, FittedSurface
from .conic import axes_of
from .cylinder_start import fit_majority
from .ellipse import EllipseModel, EllipticFit

PARAMETERS = 7
# The numbers x that describe a cylinder: a point on its axis, the rows e1, e2, t of an orthonormal
# frame, and m, g, h.
POINT, FRAME, SHAPE = slice(0, 3), slice(3, 12), slice(12, 15)
IN_SECTION = [0, 1, 4, 5, 6]  # of the free parameters
SUBSET = 1000  # points by which the start of a least-squares adjustment is found
VERTICAL = np.cos(np.radians(1.0))


class CylinderModel(GeometricModel):
    """The elliptic cylinder as a geometric model, x (…, 15).

    Free are offsets and tilts along e1 and e2, m, g and h.
    """

    dimension = 3
    degrees = PARAMETERS
    least_half_angle = 75.0

    @staticmethod
    def in_frame(x: Array, origin: Array, length: Array) -> tuple[CylinderModel, Array]:
        length = length[:, None]
        point = (x[:, POINT] - origin) / length
        return CylinderModel(), np.concatenate([point, x[:, FRAME], x[:, SHAPE] / length], axis=-1)

    @staticmethod
    def update(x: Array, step: Array) -> Array:
        """The section moves as an ellipse does, and t tilts about the point without turning."""
        frame = _frame(x)
        section = EllipseModel.update(_section(x), step[..., IN_SECTION])
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
    def distances(x: Array, D: Array) -> Array:
        """Distances of first order from the section."""
        coordinates = _coordinates(x, D[:, None])
        in_section = coordinates[..., :2, :].swapaxes(-1, -2)
        flat = in_section.reshape((-1,) + in_section.shape[-2:])
        return EllipseModel.distances(_section(x).reshape(-1, 1, 5), flat)[:, 0].reshape(
            in_section.shape[:-1]
        )

    @staticmethod
    def linearised(x: Array, D: Array) -> tuple[Array, Array]:
        """Orthogonal distances and their Jacobian (…, 7, n)."""
        coordinates = _coordinates(x, D)
        d, of_ellipse = EllipseModel.linearised(
            _section(x), coordinates[..., :2, :].swapaxes(-1, -2)
        )
        tilts = coordinates[..., 2:, :] * of_ellipse[..., :2, :]
        return d, np.concatenate([of_ellipse[..., :2, :], tilts, of_ellipse[..., 2:, :]], axis=-2)

    @staticmethod
    def normals(x: Array, D: Array) -> Array:
        """Unit normals at the feet, outwards."""
        in_section = _coordinates(x, D)[..., :2, :].swapaxes(-1, -2)
        return EllipseModel.normals(_section(x), in_section) @ _frame(x)[..., :2, :]

    @staticmethod
    def curvature(x: Array, D: Array) -> Array:
        """That of the section, across the axis."""
        in_section = _coordinates(x, D)[..., :2, :].swapaxes(-1, -2)
        across = _frame(x)[..., None, :2, :]
        return across.swapaxes(-1, -2) @ EllipseModel.curvature(_section(x), in_section) @ across

    @staticmethod
    def foot_points(x: Array, points: Points) -> Array:
        """In the section in the metric of its part Q₂ of Q, for along the axis nothing is known.

        The error along the axis is the one that belongs to the error in the section,
        ``Q_w2 Q₂⁻¹ e₂``.
        """
        assert points.axes is not None
        frame = _frame(x)
        axes = frame[:, None] @ points.axes
        Q = (axes * points.variances[..., None, :]) @ axes.swapaxes(-1, -2)
        section = Points.of(_coordinates(x, points.D)[:, :2].swapaxes(-1, -2), Q[..., :2, :2])
        error = section.D - EllipseModel.foot_points(_section(x), section)
        along = Q[..., 2:, :2] @ solve(Q[..., :2, :2], error[..., None])
        return points.D - np.concatenate([error, along[..., 0]], axis=-1) @ frame


def _frame(x: Array) -> Array:
    """Rows e1, e2, t, (…, 3, 3)."""
    return x[..., FRAME].reshape(x.shape[:-1] + (3, 3))


def _section(x: Array) -> Array:
    """(0, 0, m, g, h), (…, 5): the section as an ellipse about the axis."""
    return np.concatenate([np.zeros(x.shape[:-1] + (2,)), x[..., SHAPE]], axis=-1)


def _coordinates(x: Array, points: Array) -> Array:
    """Coordinates (…, 3, n) of points (…, n, 3) along e1, e2 and t from the point on the axis."""
    frame = _frame(x)
    coordinates = frame @ points.swapaxes(-1, -2)
    coordinates -= frame @ x[..., POINT, None]
    return coordinates


def section_axes(direction: Array) -> Array:
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


def _above(direction: Array) -> Array:
    return np.where(np.abs(direction[..., 2:]) > VERTICAL, [0.0, 1.0, 0.0], [0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class CylinderFit(EllipticFit):
    """A fitted elliptic cylinder, ``parameters`` (…, 9): direction, point, a ≥ b in m, φ in rad.

    Seven of them are free, and the covariance has rank 7: where along the axis the point lies is a
    convention without variance.

    regular : (…, 15) the same cylinder as its point, the unit vectors right, up and along, and m,
        g, h
    regular_cofactor : (…, 7, 7) of offsets of the axis to the right and up at the point (m), tilts
        of its direction to the right and up (rad), m, g, h (m)
    """

    NAMES = ("t_x", "t_y", "t_z", "x", "y", "z", "a", "b", "phi")
    SIZES = slice(6, 8)

    @property
    def direction(self) -> Array:
        """(…, 3) unit vector t along the axis; its component largest in magnitude is positive."""
        return self.parameters[..., :3]

    @property
    def point(self) -> Array:
        """(…, 3) in m: the point of the axis nearest to the centroid of the points."""
        return self.parameters[..., 3:6]

    @property
    def semi_axes(self) -> Array:
        """(…, 2) in m, the major one first."""
        return self.parameters[..., 6:8]

    @property
    def angle(self):
        """(…) of the major axis, in [0, π) rad from right towards up (:func:`section_axes`)."""
        return self.parameters[..., 8]

    def surface(self) -> FittedSurface:
        x = self.regular.reshape(-1, SHAPE.stop)
        return FittedSurface(CylinderModel(), x, _describe(x)[1])


def _describe(x: Array) -> tuple[Array, Array]:
    """The nine parameters of x (B, 15) in the frame right, up, along; their Jacobian (B, 9, 7)."""
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


def _orient(x: Array) -> tuple[Array, Array]:
    """Take the axis' point nearest to the origin, and the frame right, up, along.

    Returns x (B, 15), and the Jacobian (B, 7, 7) of its free parameters by those of the given x.
    """
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

    axis : (3,) unit vector near all their axes, or None where it is to be looked for
    """

    axis: Array | None = None

    surface = "an elliptic cylinder"
    model = CylinderModel()

    def start(self) -> Array:
        """Near the cylinder that fits all points best."""
        D = self.observations().subsample(SUBSET, 0).all().D
        return fit_majority(self.model, D, self.axis, None).x

    def robust_start(self, D: Array, seed: int, keep: slice) -> Start:
        """Of seven points a sample would seldom be clean: see ``cylinder_start``."""
        return fit_majority(self.model, D, self.axis, seed)

    def require_surface(self) -> None:
        """Refuse points in a plane."""
        extents = np.linalg.svd(self.factor_of(_rows)[..., 1:, 1:], compute_uv=False)
        self.require_dimensions(extents * self.length[:, None], 3)

    def fit(self, method: str, adjustment: Adjustment) -> CylinderFit:
        """The result in m of an adjustment in the frame."""
        x, J = _orient(adjustment.x)
        scale = np.broadcast_to(self.length[:, None], (len(x), PARAMETERS)).copy()
        scale[:, 2:4] = 1.0
        cofactor = propagate(adjustment.cofactor, scale[..., None] * J)
        x[:, POINT] *= self.length[:, None]
        x[:, SHAPE] *= self.length[:, None]
        centred = x.copy()  # about the centroid, where no digits are lost
        x[:, POINT] += self.origin
        parameters, of_free = _describe(x)
        return self.result(
            CylinderFit,
            method,
            adjustment,
            lambda points: self.model.linearised(centred, points - self.origin[:, None])[0],
            parameters=parameters,
            cofactor=propagate(cofactor, of_free),
            regular=x,
            regular_cofactor=cofactor,
        )


def _rows(points: Array, origin: Array, length: Array) -> Array:
    rows = np.ones((len(points), 4, points.shape[-2]))
    rows[:, 1:] = (points.swapaxes(-1, -2) - origin[..., None]) / length[:, None, None]
    return rows
