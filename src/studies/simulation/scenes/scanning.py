"""Scans: beams of an angular grid cast into a scene, and their recorded points.

Each beam is cast as a ray. Around it lies a footprint, over which the instrument averages: where
the footprint covers two ranges, at an edge, the recorded range is the mean of the ranges in it,
weighted by the power that comes back, Gaussian over the beam and Lambertian from the surface,
``exp(−2u²) cos(θ)/ρ²``. Such a *mixed pixel* lies on no surface, but between two. All other beams
record the range of their centre. Where the centre of a beam meets nothing, nothing is recorded.

Casting is not random. Noise is added to its result by the scanner's stochastic model, once by
:func:`scan`, or as often as needed by :func:`redraw`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from analysis.blocks import BLOCK, pieces
from analysis.checks import check_positive, finite_array
from analysis.scanner import Scanner, across, vector

from .surfaces import Scene, dot

MIXED = "mixed"  # the label of mixed pixels
CAST = BLOCK // 8  # beams cast together: each has six rays at the rim of its footprint
RINGS = 4  # of rays around a mixed beam, the outermost at the rim of the footprint: 61 rays


@dataclass(frozen=True)
class AngularGrid:
    """Beams at constant steps of azimuth and elevation.

    azimuth, elevation : (from, to) in rad; azimuths count from the x axis towards the y axis
    step : rad, of both angles

    Both ends belong to the grid where the step allows it; a full circle has no beam twice.

    Example
    -------
    >>> grid = AngularGrid((0.0, 2 * np.pi), (-0.5, 0.5), step=0.25 * np.pi)
    >>> len(grid), grid.elevations
    (16, array([-0.5       ,  0.28539816]))
    """

    azimuth: tuple[float, float]
    elevation: tuple[float, float]
    step: float

    def __post_init__(self):
        check_positive(self.step, "step")
        for name in ("azimuth", "elevation"):
            window = finite_array(getattr(self, name), name)
            if window.shape != (2,) or not window[0] <= window[1]:
                raise ValueError(
                    f"{name}: expected (from, to) with from ≤ to, got {getattr(self, name)}"
                )
        if self.azimuth[1] - self.azimuth[0] > 2 * np.pi + 1e-9:
            raise ValueError(f"azimuth: expected a window of at most 2π rad, got {self.azimuth}")
        if max(np.abs(self.elevation)) > 0.5 * np.pi + 1e-9:
            raise ValueError(
                f"elevation: expected angles from -π/2 to π/2 rad, got {self.elevation}"
            )

    @classmethod
    def around(cls, target, radius: float, step: float, station=(0.0, 0.0, 0.0)) -> AngularGrid:
        """The smallest window that shows a ball around a target.

        Parameters
        ----------
        target, station : (3,) middle of the ball, and place of the scanner, m.
        radius : of the ball, m.
        step : of the grid, rad.

        Raises
        ------
        ValueError : a station inside the ball, or a window with its vertical axis.

        Example
        -------
        >>> grid = AngularGrid.around((0.0, 10.0, 0.0), radius=0.1, step=0.001)
        >>> len(grid), np.round(grid.azimuth, 3)
        (441, array([1.561, 1.581]))
        """
        offset = vector(target, "target") - vector(station, "station")
        distance = np.linalg.norm(offset)
        if not check_positive(radius, "radius") < distance:
            less = f"less than the distance of the target, {distance:g} m"
            raise ValueError(f"radius: expected {less}, got {radius!r}")
        half = np.arcsin(radius / distance)
        elevation = np.arcsin(offset[2] / distance)
        if np.abs(elevation) + half >= 0.5 * np.pi:
            raise ValueError(
                f"target: expected a window without the vertical axis of the station, "
                f"got {target} with radius {radius:g}"
            )
        half_azimuth = np.arcsin(np.sin(half) / np.cos(elevation))
        azimuth = np.arctan2(offset[1], offset[0])
        return cls(
            (azimuth - half_azimuth, azimuth + half_azimuth),
            (elevation - half, elevation + half),
            step,
        )

    @property
    def azimuths(self) -> np.ndarray:
        """Azimuths of the columns, rad."""
        circle = int(np.ceil(2 * np.pi / self.step - 1e-9))
        return self.azimuth[0] + self.step * np.arange(min(_steps(self.azimuth, self.step), circle))

    @property
    def elevations(self) -> np.ndarray:
        """Elevations in a column, rad."""
        return self.elevation[0] + self.step * np.arange(_steps(self.elevation, self.step))

    def __len__(self) -> int:
        return len(self.azimuths) * len(self.elevations)

    def beams(self, part: slice) -> np.ndarray:
        """Unit vectors (k, 3) of some of the beams, counted column by column."""
        azimuths, elevations = self.azimuths, self.elevations
        columns, rows = np.divmod(np.arange(*part.indices(len(self))), len(elevations))
        azimuth, elevation = azimuths[columns], elevations[rows]
        plan = np.cos(elevation)
        # One coordinate after the other in memory; arrays computed from the beams inherit this.
        return np.stack([plan * np.cos(azimuth), plan * np.sin(azimuth), np.sin(elevation)]).T


@dataclass(frozen=True, eq=False)
class Scan:
    """Recorded points with the truth behind them, one point per beam that came back.

    scanner, station : the instrument and where it stood, (3,) in m
    points : (n, 3) in m, in the frame of the scene
    codes : (n,) the place of each point's label in ``names``
    names : the labels of the scene, then ``"mixed"``
    beams : (n, 3) unit vectors from the station, without noise
    true_ranges : (n,) in m, without noise: of the surface, or mixed
    cosines : (n,) of the incidence angle; of a mixed pixel the mean over its footprint
    normals : (n, 3) unit normals, towards the scanner, of the surface that the centre of the beam
        meets

    A mask or a slice selects points: ``scan[scan.on("wall")]``.
    """

    scanner: Scanner
    station: np.ndarray
    names: tuple[str, ...]
    points: np.ndarray
    codes: np.ndarray
    beams: np.ndarray
    true_ranges: np.ndarray
    cosines: np.ndarray
    normals: np.ndarray

    WHOLE = ("scanner", "station", "names")  # of the scan, not of a point

    @property
    def labels(self) -> np.ndarray:
        """(n,) label of each point, as text."""
        return np.array(self.names)[self.codes]

    @property
    def true_points(self) -> np.ndarray:
        """(n, 3) in m, without noise."""
        return self.station + self.true_ranges[:, None] * self.beams

    @property
    def ranges(self) -> np.ndarray:
        """(n,) in m, as recorded."""
        return np.linalg.norm(self.points - self.station, axis=-1)

    @property
    def incidence(self) -> np.ndarray:
        """(n,) incidence angles, rad."""
        return np.arccos(np.minimum(self.cosines, 1.0))

    def on(self, *labels: str) -> np.ndarray:
        """(n,) bool: the points with one of the labels.

        Raises
        ------
        ValueError : a label that is not among ``names``.
        """
        unknown = [label for label in labels if label not in self.names]
        if unknown:
            raise ValueError(
                f"labels: expected some of {', '.join(self.names)}; got {unknown[0]!r}"
            )
        return np.isin(self.codes, [self.names.index(label) for label in labels])

    def __len__(self) -> int:
        return len(self.codes)

    def __getitem__(self, keep) -> Scan:
        arrays = [field.name for field in fields(self) if field.name not in self.WHOLE]
        return replace(self, **{name: getattr(self, name)[keep] for name in arrays})

    def __repr__(self) -> str:
        counts = ", ".join(f"{np.count_nonzero(self.on(name))} {name}" for name in self.names)
        return f"Scan({self.scanner.name}, {len(self)} points: {counts})"


def scan(
    scene: Scene,
    grid: AngularGrid,
    scanner: Scanner,
    generator: np.random.Generator,
    station=(0.0, 0.0, 0.0),
) -> Scan:
    """Scan a scene.

    Parameters
    ----------
    scene : the labelled surfaces. The label "mixed" is taken.
    grid : the beams.
    scanner : its stochastic model, beam and reach.
    generator : source of 3 standard normal numbers per recorded point.
    station : (3,) where the scanner stands, m; its vertical axis is the z axis of the scene.

    Returns
    -------
    Scan. The time is proportional to beams times surfaces; beams are cast in blocks, so beyond the
    result itself the memory does not grow with the grid.

    Raises
    ------
    ValueError : a wrong station, a generator that is none, a scene with a label "mixed".

    Example
    -------
    >>> from analysis.scanner import LEICA_C10
    >>> from studies.simulation.scenes import Sphere
    >>> ball = Scene([("ball", Sphere((0.0, 6.0, 0.0), 0.1))])
    >>> grid = AngularGrid.around((0.0, 6.0, 0.0), radius=0.1, step=0.002)
    >>> scan(ball, grid, LEICA_C10, np.random.default_rng(0)).points.shape
    (214, 3)
    """
    if not isinstance(generator, np.random.Generator):
        raise ValueError(
            f"generator: expected a numpy.random.Generator, got {type(generator).__name__}"
        )
    if MIXED in scene.labels:
        raise ValueError(
            f"scene: expected labels other than {MIXED!r}, which is that of mixed pixels; "
            f"got {', '.join(scene.labels)}"
        )
    station = vector(station, "station")
    parts = [_cast(scene, scanner, station, grid.beams(part)) for part in pieces(len(grid), CAST)]
    cast = Scan(
        scanner,
        station,
        scene.labels + (MIXED,),
        *(np.concatenate(arrays) for arrays in zip(*parts, strict=True)),
    )
    for part in pieces(len(cast)):
        cast.points[part] += _errors(
            cast[part], generator.standard_normal((part.stop - part.start, 3))
        )
    return cast


def redraw(scan: Scan, n_trials: int, seed: int) -> np.ndarray:
    """Draw the noise of a scan many times, with unchanged beams on an unchanged scene.

    Trial i draws from the i-th child of ``SeedSequence(seed)``, so it stays unchanged when the
    number of trials grows. Mixed pixels keep the mixture that scene and beam give them, and get
    noise as all points do.

    Parameters
    ----------
    scan : a scan, or a part of it.
    n_trials : number of redraws, B.
    seed : seed of the study.

    Returns
    -------
    (B, n, 3) points, m.

    Raises
    ------
    ValueError : a number of trials below 1.

    Example
    -------
    >>> from studies.simulation.scenes import scan_sphere_target
    >>> target = scan_sphere_target((0.0, 6.0, -1.6), 0.0725, np.random.default_rng(0))
    >>> bool(np.all(redraw(target, 3, seed=1)[:2] == redraw(target, 2, seed=1)))
    True
    """
    if not isinstance(n_trials, (int, np.integer)) or n_trials < 1:
        raise ValueError(f"n_trials: expected a whole number of at least 1, got {n_trials!r}")
    roots = _roots(scan)
    redraws = np.empty((n_trials,) + scan.points.shape)
    for points, child in zip(redraws, np.random.SeedSequence(seed).spawn(n_trials), strict=True):
        np.einsum(
            "nij,nj->ni",
            roots,
            np.random.default_rng(child).standard_normal(points.shape),
            out=points,
        )
    redraws += scan.true_points
    return redraws


def _roots(scan: Scan) -> np.ndarray:
    """(n, 3, 3) roots of the points' true cofactors.

    Errors across the beam lie in its tangent plane; this leaves the sphere of constant range by
    ρσ²/2, 10⁻⁸ m at 6 m and 60 µrad.
    """
    return scan.scanner.roots(scan.beams, scan.true_ranges, scan.cosines)


def _errors(scan: Scan, numbers: np.ndarray) -> np.ndarray:
    """(n, 3) errors of points in m from standard normal numbers (n, 3).

    The numbers are those along the beam, horizontal, and upwards.
    """
    return np.einsum("nij,nj->ni", _roots(scan), numbers)


def _steps(window: tuple[float, float], step: float) -> int:
    return int(np.floor((window[1] - window[0]) / step + 1e-9)) + 1


def _cast(
    scene: Scene, scanner: Scanner, station: np.ndarray, beams: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Arrays of a :class:`Scan` of beams (k, 3) without noise, one element per returning beam."""
    ranges, hit = scene.first_hit(station, beams)
    met = hit >= 0
    beams, ranges, hit = beams[met], ranges[met], hit[met]
    normals = scene.normals(station + ranges[:, None] * beams, hit)
    slopes = dot(beams, normals)
    normals *= -np.sign(slopes)[:, None]
    cosines = np.abs(slopes)
    codes = np.array([scene.labels.index(label) for label, _ in scene.surfaces], dtype=np.int16)[
        hit
    ]
    if scanner.beam_diameter > 0 or scanner.beam_divergence > 0:
        mixed = _covers_two_ranges(scene, scanner, station, beams, ranges, normals)
        ranges[mixed], cosines[mixed] = _mixture(scene, scanner, station, beams[mixed])
        codes[mixed] = len(scene.labels)
    back = (
        (cosines >= np.cos(scanner.max_incidence))
        & (ranges >= scanner.min_range)
        & (ranges <= scanner.max_range)
    )
    beams, ranges = beams[back], ranges[back]
    return (
        station + ranges[:, None] * beams,
        codes[back],
        beams,
        ranges,
        cosines[back],
        normals[back],
    )


def _covers_two_ranges(scene, scanner, station, beams, ranges, normals) -> np.ndarray:
    """(k,) bool: some ray at the rim of the footprint ends on another surface than the centre.

    The surface of the centre is taken as its tangent plane; a ray ends elsewhere if it ends farther
    from that plane along the ray than the beam is wide.
    """
    origins, directions = footprint_rays(scanner, station, beams, disc_pattern(1)[1:])
    rim, _ = scene.first_hit(origins, directions)
    # a ray parallel to the plane never meets it: the distance is infinite, so it ends elsewhere
    with np.errstate(divide="ignore", invalid="ignore"):
        feet = station + ranges[:, None] * beams
        plane = dot(feet - origins, normals) / dot(directions, normals)
        width = scanner.beam_diameter + scanner.beam_divergence * ranges
        return (np.isfinite(rim) & ~(np.abs(rim - plane) <= width)).any(axis=0)


def _mixture(scene, scanner, station, beams) -> tuple[np.ndarray, np.ndarray]:
    """Recorded ranges (k,) of beams over an edge, and mean cosines in their footprints."""
    ranges, cosines = np.empty(len(beams)), np.empty(len(beams))
    pattern = disc_pattern(RINGS)
    gauss = np.exp(-2.0 * np.sum(pattern**2, axis=-1))[:, None]
    for part in pieces(len(beams), BLOCK // len(pattern)):
        origins, directions = footprint_rays(scanner, station, beams[part], pattern)
        at, hit = scene.first_hit(origins, directions)
        met = hit >= 0
        at = np.where(met, at, 1.0)
        slopes = np.zeros(at.shape)
        normals = scene.normals((origins + at[..., None] * directions)[met], hit[met])
        slopes[met] = np.abs(dot(normals, directions[met]))
        power = gauss * slopes / at**2
        ranges[part] = np.sum(power * at, axis=0) / np.sum(power, axis=0)
        cosines[part] = np.sum(gauss * slopes, axis=0) / np.sum(gauss * met, axis=0)
    return ranges, cosines


def footprint_rays(scanner: Scanner, station, beams, pattern) -> tuple[np.ndarray, np.ndarray]:
    """Origins and unit directions (s, k, 3) of the rays of beams (k, 3) at a pattern (s, 2)."""
    horizontal, upwards = across(beams)
    aside = pattern[:, 0, None, None] * horizontal + pattern[:, 1, None, None] * upwards
    directions = beams + 0.5 * scanner.beam_divergence * aside
    directions /= np.sqrt(dot(directions, directions))[..., None]
    return station + 0.5 * scanner.beam_diameter * aside, directions


def disc_pattern(rings: int) -> np.ndarray:
    """Points (1 + 3·rings·(rings + 1), 2) evenly over the unit disc: the centre, then rings."""
    points = [np.zeros((1, 2))]
    for ring in range(1, rings + 1):
        angles = 2 * np.pi * np.arange(6 * ring) / (6 * ring)
        points.append(ring / rings * np.stack([np.cos(angles), np.sin(angles)], axis=-1))
    return np.concatenate(points)
