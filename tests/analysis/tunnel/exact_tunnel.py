"""A tunnel whose axis is known exactly, for tests."""

import numpy as np

RADIUS = 2.7
CURVE = 300.0  # m, radius of the horizontal arc
SITE = np.array([412_000.0, 3_518_000.0, 85.0])


def turned(heading):
    """Rotation about Z, degrees."""
    c, s = np.cos(np.radians(heading)), np.sin(np.radians(heading))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


class Tunnel:
    """A tunnel on a horizontal arc (or straight: ``curve`` infinite) with a constant grade,
    anywhere, in any direction.
    """

    def __init__(self, length=60.0, curve=CURVE, grade=0.015, heading=0.0, origin=(0.0, 0.0, 0.0)):
        self.length, self.curve, self.grade, self.turn, self.origin = (
            length,
            curve,
            grade,
            turned(heading),
            np.array(origin),
        )

    def axis(self, s):
        """Axis points and unit tangents at horizontal distances s, (n, 3)."""
        s = np.asarray(s, dtype=float)
        phi = (s - 0.5 * self.length) / self.curve
        across, ahead = np.sin(phi), np.cos(phi)
        straight_on = np.isinf(self.curve)
        x = np.zeros_like(s) if straight_on else self.curve * (1 - ahead)
        y = s - 0.5 * self.length if straight_on else self.curve * across
        tangent = np.stack([across, ahead, np.full_like(s, self.grade)], axis=-1) / np.hypot(
            1, self.grade
        )
        return np.stack(
            [x, y, self.grade * s], axis=-1
        ) @ self.turn.T + self.origin, tangent @ self.turn.T

    def points(self, n, rng, sigma=0.0, bed=0.0, cable=0.0, ovality=0.0):
        """n points of the lining; a track bed hides ``bed`` m of the invert, a cable hangs
        ``cable`` m before the right wall.
        """
        s, a = rng.uniform(0.0, self.length, n), rng.uniform(-np.pi, np.pi, n)
        r = RADIUS + ovality * np.cos(2 * a) + sigma * rng.standard_normal(n)
        u = r * np.sin(a) - cable * (np.abs(a - 0.5 * np.pi) < 0.1)
        v = np.maximum(r * np.cos(a), bed - RADIUS) if bed else r * np.cos(a)
        p, t = self.axis(s)
        right = np.cross(t, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right, axis=-1, keepdims=True)
        return p + u[:, None] * right + v[:, None] * np.cross(right, t)

    def errors(self, axis, margin=1.0):
        """Largest error of the axis in position (horizontal, up; m) and direction between the ends,
        less a margin.
        """
        p, t = self.axis(np.linspace(margin, self.length - margin, 300))
        y = axis.foot(p)
        d = axis.position(y) - p
        direction = np.linalg.norm(np.cross(axis.tangent(y), t), axis=-1)  # of either sense
        return np.hypot(d[:, 0], d[:, 1]).max(), np.abs(d[:, 2]).max(), direction.max()
