"""The deformation between the epochs, known exactly.

Five things happen along the tunnel, each at a measured section, and nothing in between:

    squat        the lining's ellipse is pressed down by A(s) at the crown and pushed out by
                 ``spread``·A(s) at the springline. A(s) is smooth and has exactly the three largest
                 deformations which Li et al. (2015, section 4.2.2) print, 10.9, 21.2 and 24.3 mm,
                 at three consecutive sections. They also say that the vertical change is the
                 larger; the ratio of the two is assumed.
    dent         a local bump inwards that no ellipse can follow
    shift        one ring moves as a whole, by 8 mm
    tilt         one ring turns about its horizontal diameter
    quiet zone   nothing moves

Shift and tilt enter the radius as d·e_ρ; the omitted |d|²/2R is 0.01 mm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .alignment import from_nearest

# chainage and A, m
SETTLEMENT = ((37.0, 0.0), (45.0, 0.0109), (55.0, 0.0212), (65.0, 0.0243), (80.0, 0.0))
QUIET_ZONE = (82.0, 100.0)  # m, with the sections at 85 and 95 m


@dataclass(frozen=True)
class Squat:
    """Ellipse pressed down by A(s): a quintic step between knots (chainage, A) in m.

    A is level at every knot.

    >>> 1e3 * Squat().settlement([40.0, 45.0, 55.0, 65.0, 80.0])
    array([ 2.99976196, 10.9       , 21.2       , 24.3       ,  0.        ])
    """

    knots: tuple[tuple[float, float], ...] = SETTLEMENT
    spread: float = 0.45

    def settlement(self, chainage) -> np.ndarray:
        """A (…) in m, twice continuously differentiable."""
        at, values = np.array(self.knots).T
        chainage = np.clip(chainage, at[0], at[-1])
        left = np.clip(np.searchsorted(at, chainage, side="right") - 1, 0, len(at) - 2)
        x = (chainage - at[left]) / np.diff(at)[left]
        return values[left] + np.diff(values)[left] * x**3 * (10 - 15 * x + 6 * x**2)


@dataclass(frozen=True)
class Dent:
    """Bump inwards, smooth at its edge.

        δ = −depth (1 − x²)³,    x² = (Δα/half_width)² + (Δs/half_length)² < 1

    chainage, half_length, depth in m; alpha, half_width in rad.
    """

    chainage: float = 25.0
    alpha: float = np.deg2rad(40.0)
    depth: float = 0.014
    half_length: float = 2.0
    half_width: float = np.deg2rad(20.0)

    def radial(self, alpha, chainage) -> np.ndarray:
        """δ (…) in m, positive outwards.

        >>> Dent().radial(np.deg2rad([40.0, 50.0, 61.0]), 25.0)
        array([-0.014     , -0.00590625, -0.        ])
        """
        aside = from_nearest(alpha - self.alpha, 2 * np.pi)
        squares = (aside / self.half_width) ** 2 + (
            (chainage - self.chainage) / self.half_length
        ) ** 2
        return -self.depth * np.maximum(1.0 - squares, 0.0) ** 3


@dataclass(frozen=True)
class RingMovement:
    """Motion of the ring at ``chainage``: ``shift`` (u, v) in m, and ``tilt`` in rad.

    It tilts about its horizontal diameter: a point at the distance w along the axis from the middle
    of the ring moves up by the shift in v and tilt · w.
    """

    chainage: float
    shift: tuple[float, float] = (0.0, 0.0)
    tilt: float = 0.0

    def radial(self, alpha, along) -> np.ndarray:
        """δ (…) in m at the distance ``along`` (m) from the middle of the ring."""
        return self.shift[0] * np.sin(alpha) + (self.shift[1] + self.tilt * along) * np.cos(alpha)


@dataclass(frozen=True)
class TrueDeformation:
    """All that happens between the epochs."""

    squat: Squat = Squat()
    dent: Dent = Dent()
    rings: tuple[RingMovement, ...] = (
        RingMovement(105.0, shift=(0.0064, -0.0048)),
        RingMovement(115.0, tilt=0.005),
    )
