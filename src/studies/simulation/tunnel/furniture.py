"""Furniture that hides the lining: bed, catwalk, pipe, cables, brackets, lamps, cabinet, people.

All of it is described in the section (:mod:`.alignment`) and follows the curve: tubes run along the
whole tunnel, boxes stand on the lining between two polar angles, the bed and the catwalk are level.
Li et al. (2015) name bolt holes, nuts, grouting holes, cables and lamps; where they are, and how
large, is assumed. Everything stands out by 2 cm or more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Tube:
    """Cable or pipe along the tunnel: polar angle (rad), distance ρ of its middle, radius, m."""

    label: str
    alpha: float
    rho: float
    radius: float

    @property
    def middle(self) -> tuple[float, float]:
        """Middle (u, v) of the tube in the section, m."""
        return self.rho * np.sin(self.alpha), self.rho * np.cos(self.alpha)


@dataclass(frozen=True)
class WallBox:
    """Boxes on the lining.

    alpha : from polar angle to polar angle, rad
    rho : of the inner face, m
    length : of each box from its start, m
    starts : chainages, m
    """

    label: str
    alpha: tuple[float, float]
    rho: float
    length: float
    starts: tuple[float, ...]


@dataclass(frozen=True)
class Catwalk:
    """A level slab on the right, from ``edge`` (u) to the lining, ``bottom`` to ``top`` (v), m."""

    label: str = "catwalk"
    edge: float = 1.60
    bottom: float = -1.05
    top: float = -0.95


@dataclass(frozen=True)
class Person:
    """Someone, or a tripod, on the bed: an upright tube at a chainage and u, m."""

    chainage: float
    u: float
    label: str = "person"
    radius: float = 0.15
    height: float = 1.70


def _tubes() -> tuple[Tube, ...]:
    cables = [
        Tube("cable", np.deg2rad(alpha), 2.60, radius)
        for alpha, radius in ((-90, 0.030), (-84, 0.025), (-78, 0.025), (-72, 0.020))
    ]
    signal = Tube("cable", np.deg2rad(42.0), 2.67, 0.015)
    pipe = Tube("pipe", np.deg2rad(-116.0), 2.55, 0.075)
    return (*cables, signal, pipe)


def _boxes() -> tuple[WallBox, ...]:
    def every(spacing: float, first: float) -> tuple[float, ...]:
        return tuple(np.arange(first, 129.0, spacing))

    return (
        WallBox("bracket", (np.deg2rad(-93.0), np.deg2rad(-70.0)), 2.62, 0.04, every(1.2, 0.58)),
        WallBox("bracket", (np.deg2rad(-119.0), np.deg2rad(-113.0)), 2.60, 0.05, every(2.4, 0.98)),
        WallBox("lamp", (np.deg2rad(52.0), np.deg2rad(55.0)), 2.58, 0.60, every(7.5, 4.80)),
        # 12° over 10 m: nothing of the section at 65 m is seen behind it.
        WallBox("cabinet", (np.deg2rad(64.0), np.deg2rad(76.0)), 2.45, 10.0, (60.0,)),
    )


@dataclass(frozen=True)
class Furniture:
    """Everything in the tunnel but the lining.

    bed : height v of the track bed, m. The default hides the lining beyond ±138°
    people : in each epoch
    """

    bed: float = -2.0
    catwalk: Catwalk = Catwalk()
    tubes: tuple[Tube, ...] = _tubes()
    boxes: tuple[WallBox, ...] = _boxes()
    people: tuple[tuple[Person, ...], tuple[Person, ...]] = (
        (Person(11.5, 0.6), Person(46.6, -0.7), Person(75.4, 0.7)),
        (Person(48.4, 0.7), Person(104.6, -0.6)),
    )
