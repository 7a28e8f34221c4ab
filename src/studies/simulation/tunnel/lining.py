"""The lining: its radius in each epoch, its rings and segments, and the recesses in them.

Assumed as usual for metro tunnels of this kind, because Li et al. (2015) print nothing of it:
inner radius 2.70 m; rings of 1.2 m, each of six equal segments, every other ring turned by half a
segment; joints 8 mm wide and 22 mm deep; ovality a − b between 5 and 15 mm, changing along the
tunnel; segments up to 2.5 mm before or behind the ellipse, so that two neighbours differ by up to
5 mm; four bolt pockets at each longitudinal joint and one grouting hole in the middle of each
segment. In each pocket sits a bolt with its nut, which ends 30 mm behind the inner face.

A radius counts from the design axis, ρ(α, s), in the plane of the section (:mod:`.alignment`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.checks import check_one_of

from .alignment import from_nearest
from .deformation import TrueDeformation

EPOCHS = (1, 2)
SEGMENTS = 6
SEGMENT = 2 * np.pi / SEGMENTS  # rad


@dataclass(frozen=True)
class Recess:
    """A box sunk into the lining: half sides along the tunnel and around it, and depth, m.

    A side without end is inf.
    """

    label: str
    half_length: float
    half_width: float
    depth: float


RING_JOINT = Recess("joint", 0.004, np.inf, 0.022)
SEGMENT_JOINT = Recess("joint", np.inf, 0.004, 0.022)
POCKET = Recess("bolt pocket", 0.08, 0.05, 0.06)
GROUTING_HOLE = Recess("grouting hole", 0.025, 0.025, 0.06)
# m: its half sides, and how far it stands up from the bottom of its pocket
BOLT, BOLT_HALF_WIDTH, BOLT_HEIGHT = "bolt", 0.02, 0.03
POCKET_FROM_RING_JOINT = 0.24  # m, of the middle of a pocket
POCKET_FROM_SEGMENT_JOINT = 0.20  # m


@dataclass(frozen=True, eq=False)
class Lining:
    """The lining's inner face in both epochs.

    steps : (rings, 6) offsets of the segments, m, outwards
    radius : design radius, m
    ring_width : m
    ovality : (mean, amplitude) of a − b in m, horizontal less vertical semi-axis
    ovality_period : m, of its change along the tunnel
    deformation : between the epochs
    """

    steps: np.ndarray
    radius: float = 2.70
    ring_width: float = 1.2
    ovality: tuple[float, float] = (0.010, 0.004)
    ovality_period: float = 70.0
    deformation: TrueDeformation = TrueDeformation()

    @classmethod
    def with_random_steps(
        cls,
        length: float,
        generator: np.random.Generator,
        *,
        largest_step: float = 0.0025,
        **options,
    ) -> Lining:
        """A lining over ``length`` (m) with segments up to ``largest_step`` (m) off the ellipse."""
        rings = int(np.ceil(length / options.get("ring_width", cls.ring_width) - 1e-9))
        return cls(generator.uniform(-largest_step, largest_step, (rings, SEGMENTS)), **options)

    def __post_init__(self):
        if self.steps.ndim != 2 or self.steps.shape[1] != SEGMENTS:
            raise ValueError(f"steps: expected shape (rings, {SEGMENTS}), got {self.steps.shape}")
        steps = self.steps.copy()
        steps.flags.writeable = False
        object.__setattr__(self, "steps", steps)

    def semi_axes(self, chainage, epoch: int) -> tuple[np.ndarray, np.ndarray]:
        """Horizontal and vertical semi-axis (…) of the ellipse, m.

        Steps, dent and moved rings are not in it.
        """
        ovality = self.ovality[0] + self.ovality[1] * np.sin(
            2 * np.pi * np.asarray(chainage) / self.ovality_period
        )
        settlement, spread = 0.0, self.deformation.squat.spread
        if check_one_of(epoch, EPOCHS, "epoch") == 2:
            settlement = self.deformation.squat.settlement(chainage)
        return (
            self.radius + 0.5 * ovality + spread * settlement,
            self.radius - 0.5 * ovality - settlement,
        )

    def true_radius(self, alpha, chainage, epoch: int) -> np.ndarray:
        """ρ (…) in m of the inner face at polar angles (rad) and chainages (m), without recesses.

        ρ = ab/√(a² cos²α + b² sin²α) + step of the segment, and in epoch 2 dent and movement of the
        ring.

        >>> lining = Lining(np.zeros((109, 6)))
        >>> np.round(lining.true_radius(np.deg2rad([0.0, 90.0]), 55.0, 1), 4)
        array([2.6969, 2.7031])
        """
        alpha, chainage = np.asarray(alpha, dtype=float), np.asarray(chainage, dtype=float)
        a, b = self.semi_axes(chainage, epoch)
        rho = a * b / np.hypot(a * np.cos(alpha), b * np.sin(alpha))
        rho = rho + self.steps[self.ring(chainage), self.segment(alpha, chainage)]
        return rho if epoch == 1 else rho + self._movement(alpha, chainage)

    def true_deformation(self, alpha, chainage) -> np.ndarray:
        """δ = ρ₂ − ρ₁ (…) in m, positive outwards.

        >>> lining = Lining(np.zeros((109, 6)))
        >>> at = [[45.0], [55.0], [65.0], [90.0]]
        >>> np.round(1e3 * lining.true_deformation(np.deg2rad([0.0, 90.0]), at), 3)
        array([[-10.9  ,   4.905],
               [-21.2  ,   9.54 ],
               [-24.3  ,  10.935],
               [  0.   ,   0.   ]])
        """
        return self.true_radius(alpha, chainage, 2) - self.true_radius(alpha, chainage, 1)

    def _movement(self, alpha, chainage) -> np.ndarray:
        """(…) change of the radius by the dent and the moved rings, m."""
        moved = self.deformation.dent.radial(alpha, chainage)
        ring = self.ring(chainage)
        for movement in self.deformation.rings:
            index = self.ring(movement.chainage)
            along = chainage - (index + 0.5) * self.ring_width
            moved = moved + np.where(ring == index, movement.radial(alpha, along), 0.0)
        return moved

    def ring(self, chainage) -> np.ndarray:
        """(…) number of the ring; beyond the ends, of the first and the last."""
        return np.clip(
            np.floor(np.asarray(chainage) / self.ring_width).astype(int), 0, len(self.steps) - 1
        )

    def segment(self, alpha, chainage) -> np.ndarray:
        """(…) number of the segment in its ring."""
        return (np.floor((alpha - self._first_joint(chainage)) / SEGMENT) % SEGMENTS).astype(int)

    def _first_joint(self, chainage) -> np.ndarray:
        """(…) polar angle of a longitudinal joint, a quarter of a segment off the crown, rad."""
        return SEGMENT * np.where(self.ring(chainage) % 2, -0.25, 0.25)

    def recess(
        self, alpha, chainage, rho, along, around, outwards
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Follow rays that cross the face at (α, s) into a recess.

        Parameters
        ----------
        alpha, chainage, rho : (k,) of the crossings.
        along, around, outwards : (k,) components of the unit directions.

        Returns
        -------
        which : (k,) place in ``RECESSES``, −1 for the plain face.
        extra : (k,) m to the first of bottom and side walls, or to the bolt.
        cosines : (k,) of the incidence angle there; 0 for the plain face. Nut and thread have edges
            all around: for a bolt it is that of the side turned most to the ray.
        """
        which, extra, cosines = np.full(len(alpha), -1), np.zeros(len(alpha)), np.zeros(len(alpha))
        for recess, ds, dt in self._offsets(alpha, chainage, rho):
            within = (
                (np.abs(ds) < recess.half_length) & (np.abs(dt) < recess.half_width) & (which < 0)
            )
            if not within.any():
                continue
            which[within] = RECESSES.index(recess.label)
            rays = ds[within], dt[within], along[within], around[within], outwards[within]
            extra[within], cosines[within] = _to_the_walls(recess, *rays)
            if recess is POCKET:
                to_bolt = _to_the_bolt(*rays)
                met = np.isfinite(to_bolt)
                where = np.flatnonzero(within)[met]
                which[where], extra[where] = RECESSES.index(BOLT), to_bolt[met]
                cosines[where] = np.abs(rays[2:]).max(axis=0)[met]
        return which, extra, cosines

    def _offsets(self, alpha, chainage, rho):
        """Each kind of recess, with distances (k,) along and around from the nearest one, m."""
        in_ring = chainage - self.ring_width * self.ring(chainage)
        ring_joint = from_nearest(chainage, self.ring_width)
        segment_joint = rho * from_nearest(alpha - self._first_joint(chainage), SEGMENT)
        yield RING_JOINT, ring_joint, np.zeros_like(chainage)
        yield SEGMENT_JOINT, np.zeros_like(chainage), segment_joint
        from_joint = np.abs(segment_joint) - POCKET_FROM_SEGMENT_JOINT
        from_ring = np.minimum(in_ring, self.ring_width - in_ring) - POCKET_FROM_RING_JOINT
        # Pockets are mirrored about the middle of their ring and about their joint, and so are the
        # distances from them.
        yield (
            POCKET,
            np.where(in_ring < 0.5 * self.ring_width, 1, -1) * from_ring,
            np.sign(segment_joint) * from_joint,
        )
        middle = rho * from_nearest(alpha - self._first_joint(chainage) - 0.5 * SEGMENT, SEGMENT)
        yield GROUTING_HOLE, in_ring - 0.5 * self.ring_width, middle


RECESSES = (RING_JOINT.label, POCKET.label, GROUTING_HOLE.label, BOLT)


def _to_the_walls(recess: Recess, ds, dt, along, around, outwards) -> tuple[np.ndarray, np.ndarray]:
    """Range from the mouth of a recess to the first wall, and the cosine of incidence there."""
    with np.errstate(divide="ignore"):
        to_wall = np.stack(
            [
                recess.depth / outwards,
                (recess.half_length - np.sign(along) * ds) / np.abs(along),
                (recess.half_width - np.sign(around) * dt) / np.abs(around),
            ]
        )
    first = np.argmin(to_wall, axis=0)
    return np.min(to_wall, axis=0), np.abs(np.choose(first, [outwards, along, around]))


def _to_the_bolt(ds, dt, along, around, outwards) -> np.ndarray:
    """Range from the mouth of a pocket to its bolt; inf where the ray passes by.

    The bolt stands in the middle, in front of all walls.
    """
    steps = np.stack([along, around, outwards])
    lows = np.stack(
        [-BOLT_HALF_WIDTH - ds, -BOLT_HALF_WIDTH - dt, np.full_like(ds, POCKET.depth - BOLT_HEIGHT)]
    )
    highs = np.stack([BOLT_HALF_WIDTH - ds, BOLT_HALF_WIDTH - dt, np.full_like(ds, POCKET.depth)])
    with np.errstate(divide="ignore"):
        at_low, at_high = lows / steps, highs / steps
    enters, leaves = (
        np.minimum(at_low, at_high).max(axis=0),
        np.maximum(at_low, at_high).min(axis=0),
    )
    return np.where(enters < leaves, enters, np.inf)
