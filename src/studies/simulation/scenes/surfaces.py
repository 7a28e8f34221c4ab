"""Surfaces that a beam can hit, and scenes made of them.

A surface has two methods: ``intersect(origins, directions)`` gives the range at which each ray
first meets it, ``normals(points)`` a unit normal at each of its points. Any object with both can
stand in a :class:`Scene`. Rays start at ``origins`` (…, 3) and run along unit vectors
``directions`` (…, 3); they meet only surfaces in front of their origins.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from analysis.checks import check_positive
from analysis.scanner import vector


class SceneSurface(Protocol):
    """Contract of the surfaces of a scene."""

    # ranges (…), inf where none
    def intersect(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray: ...

    def normals(self, points: np.ndarray) -> np.ndarray: ...  # unit normals (…, 3), in either sense


@dataclass(frozen=True, eq=False)
class Sphere:
    """Sphere by ``center`` (3,) and ``radius`` in m.

    >>> sphere = Sphere((0.0, 5.0, 0.0), 1.0)
    >>> sphere.intersect(np.zeros(3), np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]))
    array([ 4., inf])
    """

    center: np.ndarray
    radius: float

    def __post_init__(self):
        _set(
            self, center=vector(self.center, "center"), radius=check_positive(self.radius, "radius")
        )

    def intersect(self, origins, directions):
        to_center = self.center - origins
        along = dot(to_center, directions)
        # The ray's distance from the centre, not a difference of squares, which loses digits.
        aside = along[..., None] * directions - to_center
        half_chord = np.sqrt(np.maximum(self.radius**2 - dot(aside, aside), 0.0))
        return np.where(half_chord > 0, _first(along - half_chord, along + half_chord), np.inf)

    def normals(self, points):
        return (points - self.center) / self.radius


@dataclass(frozen=True, eq=False)
class Rectangle:
    """Rectangle by its ``center`` (3,) and two perpendicular half sides, ``right`` and ``up`` (3,),
    in m.

    >>> wall = Rectangle((0.0, 5.0, 0.0), right=(2.0, 0.0, 0.0), up=(0.0, 0.0, 1.0))
    >>> wall.intersect(np.zeros(3), np.array([[0.0, 1.0, 0.0], [0.0, 0.6, 0.8]]))
    array([ 5., inf])
    """

    center: np.ndarray
    right: np.ndarray
    up: np.ndarray

    def __post_init__(self):
        right, up = _with_length(self.right, "right"), _with_length(self.up, "up")
        if abs(right @ up) > 1e-9 * np.linalg.norm(right) * np.linalg.norm(up):
            raise ValueError(f"up: expected a half side perpendicular to right = {right}, got {up}")
        _set(self, center=vector(self.center, "center"), right=right, up=up)

    @property
    def normal(self) -> np.ndarray:
        return _unit(np.cross(self.right, self.up))

    def intersect(self, origins, directions):
        ranges = _plane_ranges(self.center, self.normal, origins, directions)
        offsets = _at(origins, directions, ranges) - self.center
        within = (np.abs(dot(offsets, self.right)) <= self.right @ self.right) & (
            np.abs(dot(offsets, self.up)) <= self.up @ self.up
        )
        return np.where(within, ranges, np.inf)

    def normals(self, points):
        return np.broadcast_to(self.normal, points.shape)


@dataclass(frozen=True, eq=False)
class Disc:
    """Disc by its ``center`` (3,), ``axis`` (3,) of any length, and ``radius`` in m.

    >>> disc = Disc((0.0, 5.0, 0.0), axis=(0.0, 1.0, 0.0), radius=1.0)
    >>> disc.intersect(np.zeros(3), np.array([0.0, 1.0, 0.0]))
    array(5.)
    """

    center: np.ndarray
    axis: np.ndarray
    radius: float

    def __post_init__(self):
        axis = _unit(_with_length(self.axis, "axis"))
        _set(
            self,
            center=vector(self.center, "center"),
            axis=axis,
            radius=check_positive(self.radius, "radius"),
        )

    def intersect(self, origins, directions):
        ranges = _plane_ranges(self.center, self.axis, origins, directions)
        offsets = _at(origins, directions, ranges) - self.center
        return np.where(dot(offsets, offsets) <= self.radius**2, ranges, np.inf)

    def normals(self, points):
        return np.broadcast_to(self.axis, points.shape)


@dataclass(frozen=True, eq=False)
class Cylinder:
    """Open tube from ``start`` to ``end`` (3,) with ``radius``, in m: a pole, a cable, a pipe.

    >>> pole = Cylinder((0.0, 5.0, -1.0), (0.0, 5.0, 1.0), 0.5)
    >>> pole.intersect(np.zeros(3), np.array([[0.0, 1.0, 0.0], [0.0, 0.6, 0.8]]))
    array([4.5, inf])
    """

    start: np.ndarray
    end: np.ndarray
    radius: float

    def __post_init__(self):
        start, end = vector(self.start, "start"), vector(self.end, "end")
        if not np.linalg.norm(end - start) > 0:
            raise ValueError(f"end: expected a point away from start, got {end} twice")
        _set(self, start=start, end=end, radius=check_positive(self.radius, "radius"))

    @property
    def axis(self) -> np.ndarray:
        return _unit(self.end - self.start)

    def intersect(self, origins, directions):
        axis, length = self.axis, np.linalg.norm(self.end - self.start)
        to_start = self.start - origins
        # along the axis: height of the origin, and gain of height per m of range
        heights, slopes = -dot(to_start, axis), dot(directions, axis)
        common = np.cross(directions, axis)  # perpendicular to ray and axis
        squares = dot(common, common)
        oblique = squares > 1e-24  # a ray along the axis meets no wall
        squares = np.where(oblique, squares, 1.0)
        nearest = (dot(to_start, directions) + heights * slopes) / squares
        half_chord = np.sqrt(
            np.maximum(self.radius**2 - dot(to_start, common) ** 2 / squares, 0.0) / squares
        )
        hits = []
        for ranges in (nearest - half_chord, nearest + half_chord):
            height = heights + ranges * slopes
            hits.append(np.where((height >= 0) & (height <= length), ranges, np.inf))
        return np.where(oblique & (half_chord > 0), _first(*hits), np.inf)

    def normals(self, points):
        offsets = points - self.start
        return _unit(offsets - dot(offsets, self.axis)[..., None] * self.axis)


@dataclass(frozen=True)
class Scene:
    """Labelled surfaces, of which a ray meets the nearest; those behind it are hidden.

    surfaces : pairs (label, surface); several surfaces may have one label

    >>> wall = Rectangle((0, 8, 0), (4, 0, 0), (0, 0, 4))
    >>> scene = Scene([("ball", Sphere((0, 5, 0), 1.0)), ("wall", wall)])
    >>> rays = np.array([[0.0, 1.0, 0.0], [0.6, 0.8, 0.0], [-1.0, 0.0, 0.0]])
    >>> scene.first_hit(np.zeros(3), rays)
    (array([ 4., inf, inf]), array([ 0, -1, -1]))
    """

    surfaces: Iterable[tuple[str, SceneSurface]]

    def __post_init__(self):
        surfaces = tuple((label, surface) for label, surface in self.surfaces)
        if not surfaces:
            raise ValueError("surfaces: expected at least one pair (label, surface), got none")
        for label, surface in surfaces:
            hittable = hasattr(surface, "intersect") and hasattr(surface, "normals")
            if not isinstance(label, str) or not hittable:
                pair = f"({label!r}, {type(surface).__name__})"
                raise ValueError(f"surfaces: expected pairs (text, surface), got {pair}")
        object.__setattr__(self, "surfaces", surfaces)

    @property
    def labels(self) -> tuple[str, ...]:
        """The different labels in the order of the surfaces."""
        return tuple(dict.fromkeys(label for label, _ in self.surfaces))

    def first_hit(
        self, origins: np.ndarray, directions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Range (…) and place (…) of the nearest surface along each ray; inf and −1 if none."""
        nearest = np.full(np.broadcast_shapes(origins.shape, directions.shape)[:-1], np.inf)
        hit = np.full(nearest.shape, -1)
        for place, (_, surface) in enumerate(self.surfaces):
            ranges = surface.intersect(origins, directions)
            closer = ranges < nearest
            nearest = np.where(closer, ranges, nearest)
            hit[closer] = place
        return nearest, hit

    def normals(self, points: np.ndarray, hit: np.ndarray) -> np.ndarray:
        """Unit normals (n, 3) at points of the surfaces at the places ``hit`` (n,)."""
        normals = np.empty_like(points)  # in the same order in memory
        for place in np.unique(hit):
            on = hit == place
            normals[on] = self.surfaces[place][1].normals(points[on])
        return normals


def _set(surface, **fields) -> None:
    """Set checked values of a frozen surface."""
    for name, value in fields.items():
        if isinstance(value, np.ndarray):
            value = value.copy()
            value.flags.writeable = False
        object.__setattr__(surface, name, value)


def _with_length(value, name: str) -> np.ndarray:
    array = vector(value, name)
    if not np.linalg.norm(array) > 0:
        raise ValueError(f"{name}: expected a vector with a direction, got length 0")
    return array


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar products (…) of vectors (…, 3).

    By components, which is fastest for arrays with one coordinate after the other in memory.
    """
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


def _at(origins, directions, ranges) -> np.ndarray:
    """Points at the ranges; for an infinite range a finite point beyond every surface."""
    return origins + np.where(np.isfinite(ranges), ranges, 1e100)[..., None] * directions


def _first(near, far) -> np.ndarray:
    """The smaller positive one of two ranges; inf if there is none."""
    return np.minimum(np.where(near > 0, near, np.inf), np.where(far > 0, far, np.inf))


def _plane_ranges(center, normal, origins, directions) -> np.ndarray:
    """Ranges at which rays meet a plane in front of them."""
    towards = dot(directions, normal)
    parallel = towards == 0
    ranges = dot(center - origins, normal) / np.where(parallel, 1.0, towards)
    return np.where(~parallel & (ranges > 0), ranges, np.inf)
