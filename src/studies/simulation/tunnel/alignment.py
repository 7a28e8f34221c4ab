"""The design axis of the tunnel, and coordinates along and across it.

The axis is a circle in plan with a constant grade; its chainage is its arc length. Engineering
coordinates: Z up, Y along the tunnel, X to the right. At chainage s the axis has the unit tangent
t and the section frame

    e_v = (e_Z − t (tᵀe_Z))/|·|  upwards,    e_u = t × e_v  to the right.

A point P with the foot point C(s) on the axis has the section coordinates

    u = e_uᵀ(P − C),  v = e_vᵀ(P − C),    or    ρ = √(u² + v²),  α = atan2(u, v):

α is 0 at the crown and positive to the right.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.checks import check_positive, finite_array


def from_nearest(value, period: float) -> np.ndarray:
    """Signed distance of a value from the nearest multiple of the period.

    With the period 2π it is an angle from −π to π.

    >>> from_nearest(np.array([0.1, 1.1, 1.3]), 1.2)
    array([ 0.1, -0.1,  0.1])
    """
    return value - period * np.round(value / period)


@dataclass(frozen=True)
class Alignment:
    """Design axis: a curve to the right with ``radius``, climbing by ``grade``, over ``length``.

    radius : of the curve in plan, m
    grade : rise over plan length
    length : m, of the axis; chainage runs from 0 to it
    middle : (3,) engineering coordinates of half the length, where the axis runs along Y in plan

    >>> axis = Alignment()
    >>> np.round(axis.position([0.0, 65.0, 130.0]), 2)
    array([[  5.27,   0.29,  -0.52],
           [  0.  ,  65.  ,   0.  ],
           [  5.27, 129.71,   0.52]])
    """

    radius: float = 400.0
    grade: float = 0.008
    length: float = 130.0
    middle: tuple[float, float, float] = (0.0, 65.0, 0.0)

    def __post_init__(self):
        check_positive(self.radius, "radius")
        check_positive(self.length, "length")
        finite_array(self.grade, "grade")

    @property
    def slope(self) -> float:
        """Angle β of the grade, rad."""
        return float(np.arctan(self.grade))

    @property
    def curvature(self) -> float:
        """Curvature of the axis in space, cos²β/radius, in 1/m."""
        return float(np.cos(self.slope) ** 2 / self.radius)

    def heading(self, chainage) -> np.ndarray:
        """Direction in plan, rad from Y towards X."""
        return (np.asarray(chainage) - 0.5 * self.length) * np.cos(self.slope) / self.radius

    def position(self, chainage) -> np.ndarray:
        """(…, 3) points of the axis, m."""
        heading = self.heading(chainage)
        x = self.radius * (1 - np.cos(heading))
        return (
            np.stack(
                [x, self.radius * np.sin(heading), self.grade * self.radius * heading], axis=-1
            )
            + self.middle
        )

    def frame(self, chainage) -> np.ndarray:
        """(…, 3, 3) unit vectors e_u (right), t (along) and e_v (up), one per row.

        >>> np.abs(Alignment(grade=0.0).frame(65.0))
        array([[1., 0., 0.],
               [0., 1., 0.],
               [0., 0., 1.]])
        """
        heading = self.heading(chainage)
        sin, cos, zero = np.sin(heading), np.cos(heading), np.zeros_like(heading)
        sin_b, cos_b = np.sin(self.slope), np.cos(self.slope)
        right = np.stack([cos, -sin, zero], axis=-1)
        along = np.stack([sin * cos_b, cos * cos_b, zero + sin_b], axis=-1)
        up = np.stack([-sin * sin_b, -cos * sin_b, zero + cos_b], axis=-1)
        return np.stack([right, along, up], axis=-2)

    def tangent(self, chainage) -> np.ndarray:
        """(…, 3) unit tangents."""
        return self.frame(chainage)[..., 1, :]

    def points(self, chainage, u, v) -> np.ndarray:
        """(…, 3) engineering coordinates of section coordinates, m."""
        chainage, u, v = np.broadcast_arrays(chainage, u, v)
        frame = self.frame(chainage)
        return (
            self.position(chainage)
            + u[..., None] * frame[..., 0, :]
            + v[..., None] * frame[..., 2, :]
        )

    def polar_points(self, chainage, alpha, rho) -> np.ndarray:
        """(…, 3) engineering coordinates of chainage, polar angle (rad) and radius."""
        return self.points(chainage, rho * np.sin(alpha), rho * np.cos(alpha))

    def section_coordinates(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Chainage of the foot point, u and v (…) of points (…, 3), m.

        In the polar coordinates of the curve in plan, (r, φ), the foot point has the heading θ that
        solves r sin(φ − θ) = −tan β (z − z_C(θ)). The difference φ − θ is so small that two terms
        of the sine are enough.

        >>> axis = Alignment()
        >>> np.round(axis.section_coordinates(axis.points(20.0, 1.0, -2.0)), 9)
        array([20.,  1., -2.])
        """
        x, y, z = (points[..., axis] - self.middle[axis] for axis in range(3))
        r, phi = np.hypot(self.radius - x, y), np.arctan2(y, self.radius - x)
        height = z - self.grade * self.radius * phi
        rate = r + self.grade**2 * self.radius
        turn = -self.grade * height / rate  # φ − θ: of the order of grade · ρ / radius
        # the next term of the sine; the terms after it are below 1e-15
        turn += r * turn**3 / (6 * rate)
        height += self.grade * self.radius * turn
        chainage = 0.5 * self.length + self.radius * (phi - turn) / np.cos(self.slope)
        u = self.radius - r * (1 - 0.5 * turn**2)
        v = np.cos(self.slope) * height - np.sin(self.slope) * r * turn * (1 - turn**2 / 6)
        return chainage, u, v
