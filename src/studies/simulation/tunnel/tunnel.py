"""The tunnel: axis, lining and furniture, and the labels of the points on them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..scenes import MIXED
from .alignment import Alignment
from .furniture import Furniture
from .lining import RECESSES, Lining

NAMES = (
    "lining",
    *RECESSES,
    "track bed",
    "catwalk",
    "pipe",
    "cable",
    "bracket",
    "lamp",
    "cabinet",
    "person",
    MIXED,
)
CODES = {name: code for code, name in enumerate(NAMES)}
# Each stands out from the lining by 2 cm or more; ``Tunnel.distances`` gives that of a point.
ATTACHMENTS = ("catwalk", "pipe", "cable", "bracket", "lamp", "cabinet", "person")

# the 13 sections, chainages in m
SECTIONS = tuple(float(chainage) for chainage in range(5, 130, 10))
FLAGGED_SECTIONS = (45.0, 55.0, 65.0)  # with the largest deformations of 10.9, 21.2 and 24.3 mm
ZONE = (40.0, 85.0)  # m, the 45 m in which the paper cuts its sections


@dataclass(frozen=True, eq=False)
class Tunnel:
    """A tunnel whose truth is known.

    alignment : design axis; ``alignment.position(s)``, ``.tangent(s)``,
        ``.section_coordinates(points)``
    lining : ``lining.true_radius(alpha, s, epoch)``, ``lining.true_deformation(alpha, s)``
    furniture : everything that hides the lining

    >>> tunnel = default_tunnel()
    >>> on_lining = tunnel.alignment.polar_points(50.0, 0.3, tunnel.true_radius(0.3, 50.0, epoch=2))
    >>> bool(abs(tunnel.distances(on_lining, epoch=2)) < 1e-12)
    True
    """

    alignment: Alignment
    lining: Lining
    furniture: Furniture = field(default_factory=Furniture)

    def true_radius(self, alpha, chainage, epoch: int) -> np.ndarray:
        """Radius of the inner face: :meth:`.Lining.true_radius`."""
        return self.lining.true_radius(alpha, chainage, epoch)

    def deformation(self, alpha, chainage) -> np.ndarray:
        """Change of the radius: :meth:`.Lining.true_deformation`."""
        return self.lining.true_deformation(alpha, chainage)

    def distances(self, points: np.ndarray, epoch: int) -> np.ndarray:
        """Distances ρ − ρ_true(α, s) (…) of points (…, 3), m; positive behind the inner face."""
        chainage, u, v = self.alignment.section_coordinates(points)
        return np.hypot(u, v) - self.true_radius(np.arctan2(u, v), chainage, epoch)


def default_tunnel(seed: int = 2015) -> Tunnel:
    """The tunnel of the study; the seed draws the steps between its segments."""
    alignment = Alignment()
    return Tunnel(
        alignment, Lining.with_random_steps(alignment.length, np.random.default_rng(seed))
    )
