"""Beams cast into the tunnel: the first object that each of them meets.

The lining is found by Newton's method on ρ(t) = ρ_true(α(t), s(t)) along the beam, from the inside;
the furniture between the station and the lining likewise, each piece only for the beams that can
meet it. Casting is not random.

As in :mod:`studies.simulation.scenes.scanning`, a footprint that covers two ranges gives a mixed
pixel, with the mean range weighted by the power that comes back. Mixed pixels are sought at the
edges of the furniture. Joints, pockets and steps between segments are about as wide as the beam;
only its middle ray counts there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.scanner import Scanner

from ..scenes import MIXED
from ..scenes.scanning import disc_pattern, footprint_rays
from .alignment import Alignment, from_nearest
from .furniture import Catwalk, Person, Tube, WallBox
from .tunnel import CODES, Tunnel

# m from the design radius at which the search starts: more than ovality, steps and deformation
MARGIN = 0.04
NODES = 0.5 * 1.15 ** np.arange(42)  # m along a beam, up to 154 m
TOLERANCE = 1e-10  # m, of ρ − ρ_true
MAX_STEPS = 12
RINGS = 2  # of rays in the footprint of a mixed pixel, 19 rays
TURN = 2 * np.pi
# of a piece of furniture on the lining: where beams that meet it may end beside it
NEAR = np.deg2rad(4.0)


@dataclass(frozen=True, eq=False)
class Rays:
    """Rays with origins and unit directions (k, 3) in engineering coordinates."""

    alignment: Alignment
    origins: np.ndarray
    directions: np.ndarray

    def __getitem__(self, keep) -> Rays:
        return Rays(self.alignment, self.origins[keep], self.directions[keep])

    def inside(self, places: Places) -> np.ndarray:
        """(k,) bool: the places between both ends of the tunnel; beyond these a beam is lost."""
        return (places.chainage >= 0) & (places.chainage <= self.alignment.length)

    def at(self, ranges: np.ndarray) -> Places:
        """Places of the rays at ranges (k,), in the coordinates of the section there."""
        axis = self.alignment
        chainage, u, v = axis.section_coordinates(self.origins + ranges[:, None] * self.directions)
        heading = axis.heading(chainage)
        sin, cos = np.sin(heading), np.cos(heading)
        x, y, z = self.directions.T
        level = x * sin + y * cos
        sin_b, cos_b = np.sin(axis.slope), np.cos(axis.slope)
        return Places(
            ranges,
            chainage,
            u,
            v,
            x * cos - y * sin,
            level * cos_b + z * sin_b,
            z * cos_b - level * sin_b,
        )


@dataclass(frozen=True, eq=False)
class Places:
    """Points on rays: range, chainage, u, v in m; direction to the right, along and up."""

    ranges: np.ndarray
    chainage: np.ndarray
    u: np.ndarray
    v: np.ndarray
    right: np.ndarray
    along: np.ndarray
    up: np.ndarray

    def __getitem__(self, keep) -> Places:
        return Places(*(getattr(self, name)[keep] for name in self.__dataclass_fields__))

    @property
    def alpha(self) -> np.ndarray:
        return np.arctan2(self.u, self.v)

    @property
    def rho(self) -> np.ndarray:
        return np.hypot(self.u, self.v)

    @property
    def outwards(self) -> np.ndarray:
        """Component of the directions away from the axis."""
        return (self.u * self.right + self.v * self.up) / self.rho

    @property
    def around(self) -> np.ndarray:
        """Component of the directions towards growing polar angle."""
        return (self.v * self.right - self.u * self.up) / self.rho

    def to_circle(
        self, middle: tuple[float, float], radius: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Ranges (k,) from here to both crossings of a circle in the section.

        The tunnel is taken as straight; without a crossing both are the range to the nearest point.
        """
        u, v = self.u - middle[0], self.v - middle[1]
        squares = np.maximum(self.right**2 + self.up**2, 1e-9)
        nearest = -(u * self.right + v * self.up) / squares
        half = np.sqrt(np.maximum((radius**2 - u**2 - v**2) / squares + nearest**2, 0.0))
        return nearest - half, nearest + half


@dataclass(eq=False)
class Hits:
    """First hits so far: ranges (k,) in m, codes (k,), cosines of incidence (k,)."""

    ranges: np.ndarray
    codes: np.ndarray
    cosines: np.ndarray

    def copy(self) -> Hits:
        return Hits(self.ranges.copy(), self.codes.copy(), self.cosines.copy())

    def nearer(self, where: np.ndarray, ranges, cosines, label: str) -> None:
        """Enter hits of the rays with the numbers ``where`` that are nearer than those so far."""
        closer = (ranges < self.ranges[where]) & (ranges > 0)
        where = where[closer]
        self.ranges[where], self.cosines[where], self.codes[where] = (
            ranges[closer],
            cosines[closer],
            CODES[label],
        )


def cast(
    tunnel: Tunnel, epoch: int, scanner: Scanner, station: np.ndarray, beams: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Cast beams (k, 3), unit vectors, from a station (3,).

    Returns
    -------
    places : (m,) numbers of the beams that come back
    ranges : (m,) in m
    cosines : (m,) of the incidence angle; of a mixed pixel the mean over its footprint
    codes : (m,) places of the labels in ``NAMES``
    """
    rays = Rays(tunnel.alignment, np.broadcast_to(station, beams.shape), beams)
    wall, flank = _lining(tunnel, epoch, rays)
    bare = _bare_hits(tunnel, rays, wall)
    hits = _first_hits(tunnel, epoch, rays, wall, bare)
    width = scanner.beam_diameter + scanner.beam_divergence * np.where(
        np.isfinite(hits.ranges), hits.ranges, 0.0
    )
    _mix(
        tunnel,
        epoch,
        scanner,
        station,
        beams,
        hits,
        width,
        _at_edges(tunnel, epoch, rays, wall, bare, width),
    )
    on_lining = hits.codes == CODES["lining"]
    _into_recesses(tunnel, hits, wall, np.flatnonzero(on_lining))
    hits.codes[on_lining & flank] = CODES["joint"]
    back = np.isfinite(hits.ranges) & (hits.cosines >= np.cos(scanner.max_incidence))
    back &= (hits.ranges >= scanner.min_range) & (hits.ranges <= scanner.max_range)
    return np.flatnonzero(back), hits.ranges[back], hits.cosines[back], hits.codes[back]


# ------------------------------------------------------------------------- the lining


def _lining(tunnel: Tunnel, epoch: int, rays: Rays) -> tuple[Places, np.ndarray]:
    """Places where rays meet the inner face, and (k,) bool: those on the flank of a step."""
    ranges = _before_the_lining(tunnel, rays)
    places = rays.at(ranges)
    left = np.arange(len(ranges))
    for _ in range(MAX_STEPS):
        here = places[left]
        gap = here.rho - tunnel.true_radius(here.alpha, here.chainage, epoch)
        open_ = np.abs(gap) > TOLERANCE
        left, here, gap = left[open_], here[open_], gap[open_]
        if not left.size:
            break
        moved = rays[left].at(here.ranges - gap / np.maximum(here.outwards, 0.01))
        for name in Places.__dataclass_fields__:
            getattr(places, name)[left] = getattr(moved, name)
    flank = np.zeros(len(ranges), dtype=bool)
    flank[left] = True  # between two segments Newton's method alternates
    return places, flank


def _before_the_lining(tunnel: Tunnel, rays: Rays) -> np.ndarray:
    """Ranges (k,) a little before the lining; the last of the nodes for rays that go farther.

    The axis is taken as a parabola: along a ray

        u = u₀ + a t − κ(c t)²/2,    v = v₀ + b t.

    Nodes find the first interval in which √(u² + v²) passes the design radius less ``MARGIN``;
    regula falsi refines it.
    """
    start = rays.at(np.zeros(len(rays.directions)))
    bend = -0.5 * tunnel.alignment.curvature * start.along**2
    squared = (tunnel.lining.radius - MARGIN) ** 2

    def beyond(which, t):
        return (
            (start.u[which] + (start.right[which] + bend[which] * t) * t) ** 2
            + (start.v[which] + start.up[which] * t) ** 2
            - squared
        )

    inside, outside = np.full(len(bend), NODES[-1]), np.full(len(bend), np.inf)
    left = np.arange(len(bend))
    for before, node in zip(np.r_[0.0, NODES[:-1]], NODES, strict=True):
        passed = beyond(left, node) > 0
        inside[left[passed]], outside[left[passed]] = before, node
        left = left[~passed]
        if not left.size:
            break
    crossing = np.flatnonzero(np.isfinite(outside))
    a, b = inside[crossing], outside[crossing]
    at_a, at_b = beyond(crossing, a), beyond(crossing, b)
    for _ in range(3):
        t = a - at_a * (b - a) / (at_b - at_a)
        at_t = beyond(crossing, t)
        within = at_t < 0
        a, at_a = np.where(within, t, a), np.where(within, at_t, at_a)
        b, at_b = np.where(within, b, t), np.where(within, at_b, at_t)
    inside[crossing] = a
    return inside


def _into_recesses(tunnel: Tunnel, hits: Hits, wall: Places, where: np.ndarray) -> None:
    """Extend rays that cross the mouth of a recess to its walls."""
    here = wall[where]
    which, extra, cosines = tunnel.lining.recess(
        here.alpha, here.chainage, here.rho, here.along, here.around, here.outwards
    )
    sunk = which >= 0
    where = where[sunk]
    hits.ranges[where] += extra[sunk]
    hits.cosines[where] = cosines[sunk]
    hits.codes[where] = CODES["lining"] + 1 + which[sunk]


# ---------------------------------------------------------------------- the furniture


def _bare_hits(tunnel: Tunnel, rays: Rays, wall: Places) -> Hits:
    """Hits of rays on lining and track bed alone."""
    ranges = np.where(rays.inside(wall), wall.ranges, np.inf)
    hits = Hits(ranges, np.full(len(ranges), CODES["lining"]), np.maximum(wall.outwards, 0.0))
    below = np.flatnonzero(wall.v < tunnel.furniture.bed)
    _bed(hits, below, rays[below], wall[below], tunnel.furniture.bed)
    return hits


def _first_hits(tunnel: Tunnel, epoch: int, rays: Rays, wall: Places, bare: Hits, grow=0.0) -> Hits:
    """First hits of rays; ``grow`` (k,) in m makes the furniture larger for a ray."""
    grow = np.broadcast_to(grow, wall.ranges.shape)
    alpha, furniture = wall.alpha, tunnel.furniture
    hits = bare.copy()
    walk = furniture.catwalk
    # largest distance of the curved axis from its chord along the beam
    bow = 0.125 * tunnel.alignment.curvature * wall.ranges**2
    below = np.flatnonzero(
        (wall.v < walk.top + 0.05) & (np.maximum(wall.u, 0.5 * walk.edge) + bow > walk.edge - 0.1)
    )
    _catwalk(hits, below, rays[below], wall[below], walk, grow[below])
    for tube in furniture.tubes:
        near = np.flatnonzero(
            np.abs(from_nearest(alpha - tube.alpha, TURN)) < tube.radius / tube.rho + NEAR
        )
        _tube(hits, near, rays[near], wall[near], tube, grow[near])
    for box in furniture.boxes:
        middle, half = 0.5 * (box.alpha[0] + box.alpha[1]), 0.5 * (box.alpha[1] - box.alpha[0])
        near = np.flatnonzero(np.abs(from_nearest(alpha - middle, TURN)) < half + NEAR)
        _wall_box(hits, near, rays[near], wall[near], alpha[near], box, grow[near])
    for person in furniture.people[epoch - 1]:
        _person(tunnel, hits, rays, person, grow)
    return hits


def _bed(hits: Hits, where, rays: Rays, wall: Places, height: float) -> None:
    """Hits on the track bed, of rays that end below it on the lining."""
    here = wall
    for _ in range(3):
        here = rays.at(here.ranges + (height - here.v) / np.minimum(here.up, -1e-3))
    met = rays.inside(here)
    hits.nearer(where[met], here.ranges[met], -here.up[met], "track bed")


def _catwalk(hits: Hits, where, rays: Rays, wall: Places, walk: Catwalk, grow) -> None:
    """Hits on the top of the catwalk, or else on its edge; the station is above it."""
    top = wall
    for _ in range(3):
        top = rays.at(
            np.maximum(top.ranges + (walk.top + grow - top.v) / np.minimum(top.up, -1e-3), 0.0)
        )
    on_top = top.u >= walk.edge - grow
    met = on_top & rays.inside(top)
    hits.nearer(where[met], top.ranges[met], -top.up[met], walk.label)
    edge = top
    for _ in range(3):
        edge = rays.at(
            np.maximum(
                edge.ranges + (walk.edge - grow - edge.u) / np.maximum(edge.right, 1e-3), 0.0
            )
        )
    met = (
        ~on_top
        & (np.abs(edge.u - walk.edge + grow) < 1e-6)
        & (edge.v >= walk.bottom - grow)
        & (edge.v <= walk.top + grow)
    )
    met &= rays.inside(edge)
    hits.nearer(where[met], edge.ranges[met], np.abs(edge.right[met]), walk.label)


def _tube(hits: Hits, where, rays: Rays, wall: Places, tube: Tube, grow) -> None:
    """Hits on a cable or pipe."""
    radius = tube.radius + grow
    thick = radius > 0
    where, rays, here, radius = where[thick], rays[thick], wall[thick], radius[thick]
    for _ in range(4):
        here = rays.at(here.ranges + here.to_circle(tube.middle, radius)[0])
    u, v = here.u - tube.middle[0], here.v - tube.middle[1]
    met = (np.abs(np.hypot(u, v) - radius) < 1e-6) & rays.inside(here)
    cosines = -(u * here.right + v * here.up) / radius
    hits.nearer(where[met], here.ranges[met], np.maximum(cosines[met], 0.0), tube.label)


def _wall_box(hits: Hits, where, rays: Rays, wall: Places, wall_alpha, box: WallBox, grow) -> None:
    """Hits on boxes.

    Chainage and polar angle are taken as linear from where a ray passes the radius of the inner
    face to the lining. A ray that passes that radius twice before it ends on the lining misses the
    box; that takes a sight of more than 40 m along the inside of the curve.
    """
    face = wall
    for _ in range(3):
        face = rays.at(face.ranges + face.to_circle((0.0, 0.0), box.rho - grow)[1])
    alpha = from_nearest(face.alpha - box.alpha[0], TURN)
    enters, leaves = np.zeros(len(where)), np.ones(len(where))
    first, last = _next_box(box, face.chainage, wall.chainage - face.chainage, grow)
    turn = grow / box.rho
    widths = (
        (face.chainage, wall.chainage, first, last),
        (
            alpha,
            alpha + from_nearest(wall_alpha - face.alpha, TURN),
            -turn,
            box.alpha[1] - box.alpha[0] + turn,
        ),
    )
    entered = np.zeros(len(where), dtype=int)
    for side, (begin, end, low, high) in enumerate(widths, start=1):
        step = np.where(end == begin, 1e-300, end - begin)
        with np.errstate(over="ignore"):
            at_low, at_high = (low - begin) / step, (high - begin) / step
        enter = np.minimum(at_low, at_high)
        entered[enter > enters] = side
        enters, leaves = np.maximum(enters, enter), np.minimum(leaves, np.maximum(at_low, at_high))
    met = enters < leaves
    ranges = face.ranges[met] + enters[met] * (wall.ranges - face.ranges)[met]
    cosines = np.choose(entered, [face.outwards, np.abs(face.along), np.abs(face.around)])
    hits.nearer(where[met], ranges, cosines[met], box.label)


def _next_box(box: WallBox, chainage, step, grow) -> tuple[np.ndarray, np.ndarray]:
    """Both ends of the box at a chainage, else of the next in the direction of the step.

    Where there is none, of the last.
    """
    starts = np.array(box.starts)
    forwards = np.searchsorted(starts + box.length, chainage - grow)
    backwards = np.searchsorted(starts, chainage + grow) - 1
    chosen = np.clip(np.where(step > 0, forwards, backwards), 0, len(starts) - 1)
    return starts[chosen] - grow, starts[chosen] + box.length + grow


def _person(tunnel: Tunnel, hits: Hits, rays: Rays, person: Person, grow) -> None:
    """Hits on an upright tube: in plan a ray passes its middle at the distance aside/√plan."""
    foot = tunnel.alignment.points(person.chainage, person.u, tunnel.furniture.bed)
    x, y, z = rays.directions.T
    east, north, up = (foot - rays.origins).T
    plan, ahead, aside = x**2 + y**2, east * x + north * y, east * y - north * x
    radius = person.radius + grow
    where = np.flatnonzero((aside**2 < radius**2 * plan) & (ahead > 0))
    half_chord = np.sqrt(radius[where] ** 2 * plan[where] - aside[where] ** 2)
    ranges = (ahead[where] - half_chord) / plan[where]
    height = ranges * z[where] - up[where]
    met = (height > 0) & (height < person.height)
    hits.nearer(where[met], ranges[met], half_chord[met] / radius[where][met], person.label)


# ----------------------------------------------------------------------- mixed pixels


def _at_edges(
    tunnel: Tunnel, epoch: int, rays: Rays, wall: Places, bare: Hits, width: np.ndarray
) -> np.ndarray:
    """Numbers of the rays within a footprint of an edge.

    Furniture larger by half a footprint meets them, furniture smaller by as much does not.
    """
    larger, smaller = (
        _first_hits(tunnel, epoch, rays, wall, bare, grow) for grow in (0.5 * width, -0.5 * width)
    )
    return np.flatnonzero(larger.codes != smaller.codes)


def _mix(tunnel, epoch, scanner, station, beams, hits: Hits, width, edges: np.ndarray) -> None:
    """Set the mean range of those beams at edges whose footprint covers two ranges."""
    edges = edges[np.isfinite(hits.ranges[edges])]
    at, codes, _ = _footprint_hits(tunnel, epoch, scanner, station, beams[edges], 1)
    other = (
        (codes != hits.codes[edges])
        & np.isfinite(at)
        & (np.abs(at - hits.ranges[edges]) > width[edges])
    )
    edges = edges[other.any(axis=0)]
    at, codes, cosines = _footprint_hits(tunnel, epoch, scanner, station, beams[edges], RINGS)
    gauss = np.exp(-2.0 * np.sum(disc_pattern(RINGS) ** 2, axis=-1))[:, None] * np.isfinite(at)
    at = np.where(np.isfinite(at), at, 1.0)
    power = gauss * cosines / at**2
    hits.ranges[edges] = np.sum(power * at, axis=0) / np.sum(power, axis=0)
    hits.cosines[edges] = np.sum(gauss * cosines, axis=0) / np.sum(gauss, axis=0)
    hits.codes[edges] = CODES[MIXED]


def _footprint_hits(tunnel, epoch, scanner, station, beams, rings: int) -> tuple[np.ndarray, ...]:
    """Ranges, codes and cosines (s, k) of rays spread over the footprints of beams (k, 3)."""
    origins, directions = footprint_rays(scanner, station, beams, disc_pattern(rings))
    shape = directions.shape[:-1]
    rays = Rays(tunnel.alignment, origins.reshape(-1, 3), directions.reshape(-1, 3))
    wall, _ = _lining(tunnel, epoch, rays)
    hits = _first_hits(tunnel, epoch, rays, wall, _bare_hits(tunnel, rays, wall))
    return hits.ranges.reshape(shape), hits.codes.reshape(shape), hits.cosines.reshape(shape)
