"""The campaign: stations of both epochs, their targets and stickers, and the scans.

From Li et al. (2015, section 4.1 and 4.2.1): 130 m of tunnel, six stations in the first epoch and
four in the second, 4.5 million points per station, targets measured by scanner and total station,
stickers on the lining as a check, a Riegl VZ-400. They print five targets for the first epoch and
four for the second; here every station has as many, because its registration needs at least three.

Assumed, because it is not printed: where the stations are, chosen so that no section lies in the
part of the crown that the scanner cannot see; the net of control points, on consoles and marks that
do not move, whose errors of 1 mm per coordinate are common to both epochs; 1.5 mm per coordinate
for a target found in a scan; 1 mm and 1″ for the total station; the scanner's window from 40° below
to 60° above the horizon; a scanner levelled to 20″ that looks along the tunnel within 10°.

Each scan is in the frame of its instrument: origin where the laser leaves it, Z up, Y roughly along
the tunnel, X to the right. The pose of a station is stored as truth; an analysis finds it from the
targets.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from analysis.blocks import BLOCK, pieces
from analysis.checks import check_positive
from analysis.scanner import ARC_SECOND, RIEGL_VZ400, Scanner

from ..scenes import AngularGrid
from ..scenes.surfaces import dot
from .casting import cast
from .tunnel import NAMES, SECTIONS, Tunnel, default_tunnel

SEED = 2015  # of the tunnel study
FULL_DENSITY = 4_500_000  # beams per station
# chainages by epoch, m
STATIONS = ((8.0, 30.0, 50.0, 72.0, 98.0, 120.0), (20.0, 52.0, 72.0, 108.0))
TARGETS = (5, 4)  # per station, by epoch
ELEVATION = (np.deg2rad(-40.0), np.deg2rad(60.0))
INSTRUMENT_HEIGHT = 1.6  # m above the track bed
CENTRING = 0.2  # m, from the axis and from that height
HEADING = np.deg2rad(10.0)  # largest deviation of the Y axis from the tunnel
LEVELLING_SD = 20 * ARC_SECOND
NET_SD = 0.001  # m per coordinate, of the control points
TARGET_SD = 0.0015  # m per coordinate, of a target or a sticker found in a scan
TOTAL_STATION = Scanner(
    "total station", range_sd=0.001, angle_sd=ARC_SECOND, incidence_exponent=0.0
)
TOTAL_STATION_AT = (20.0, 65.0, 110.0)  # chainages, m
CONTROL_SPACING = 5.0  # m, between pairs of control points
# (u, v) in m, alternating along the tunnel
CONTROL_PAIRS = (((-2.1, 0.9), (1.3, -1.8)), ((-1.3, -1.8), (2.1, 0.6)))
BEST_TARGET_DISTANCE = 10.0  # m: near enough to be found, far enough to fix the heading
STICKERS = tuple(np.deg2rad((-60.0, -25.0, 25.0, 60.0, 100.0)))  # polar angles in every section
# of the incidence angle; below it a sticker is not found
STICKER_COSINE = np.cos(np.deg2rad(83.0))


@dataclass(frozen=True, eq=False)
class Pose:
    """Pose of an instrument: X = position + rotation · x from instrument to engineering."""

    rotation: np.ndarray
    position: np.ndarray

    def to_engineering(self, points: np.ndarray) -> np.ndarray:
        return self.position + points @ self.rotation.T

    def to_instrument(self, points: np.ndarray) -> np.ndarray:
        return (points - self.position) @ self.rotation


@dataclass(frozen=True, eq=False)
class Targets:
    """Targets of one station.

    names : of the control points, common to both epochs
    control : (m, 3) engineering coordinates, with the errors of the net
    scanned : (m, 3) instrument coordinates, with the errors of the scanner
    true : (m, 3) engineering coordinates
    """

    names: tuple[str, ...]
    control: np.ndarray
    scanned: np.ndarray
    true: np.ndarray


@dataclass(frozen=True, eq=False)
class Stickers:
    """Stickers on the lining in one epoch, each seen from a station.

    chainage, alpha : (m,) m and rad
    true : (m, 3) engineering coordinates in this epoch
    total_station : (m, 3) engineering coordinates, measured by total station
    station : (m,) place of the station that scanned it
    scanned : (m, 3) coordinates in the frame of that station's instrument
    """

    chainage: np.ndarray
    alpha: np.ndarray
    true: np.ndarray
    total_station: np.ndarray
    station: np.ndarray
    scanned: np.ndarray


@dataclass(frozen=True, eq=False)
class Setup:
    """A station before its scan: epoch, chainage (m), pose (truth), targets, seed of the noise."""

    epoch: int
    chainage: float
    pose: Pose
    targets: Targets
    seed: int


@dataclass(frozen=True, eq=False)
class ScannedStation:
    """A scanned station.

    setup : pose (truth), targets
    points : (n, 3) in m, in the frame of the instrument
    codes : (n,) uint8, places of the labels in ``NAMES`` (truth)
    """

    setup: Setup
    points: np.ndarray
    codes: np.ndarray

    @property
    def pose(self) -> Pose:
        return self.setup.pose

    @property
    def targets(self) -> Targets:
        return self.setup.targets

    def __len__(self) -> int:
        return len(self.points)

    def __repr__(self) -> str:
        counts = np.bincount(self.codes, minlength=len(NAMES))
        kinds = ", ".join(
            f"{count} {name}" for name, count in zip(NAMES, counts, strict=True) if count
        )
        place = f"epoch {self.setup.epoch}, chainage {self.setup.chainage:g} m"
        return f"ScannedStation({place}, {len(self)} points: {kinds})"


@dataclass(frozen=True, eq=False)
class Epoch:
    """One epoch: number, stations (before the scans, their set-ups), and stickers."""

    number: int
    stations: tuple
    stickers: Stickers


@dataclass(frozen=True, eq=False)
class Campaign:
    """A tunnel and two epochs of it."""

    tunnel: Tunnel
    epochs: tuple[Epoch, Epoch]


def simulate_campaign(
    density: float = FULL_DENSITY,
    seed: int = SEED,
    *,
    tunnel: Tunnel | None = None,
    scanner: Scanner = RIEGL_VZ400,
) -> Campaign:
    """Simulate the whole campaign.

    Parameters
    ----------
    density : beams per station, over 360° × 100°; 4.5 million are steps of 0.089°. Nine in ten or
        more come back.
    seed : of the study: poses, net, targets, stickers and noise. Poses, targets and stickers do not
        depend on the density.
    tunnel : default :func:`default_tunnel`.
    scanner : the instrument.

    Raises
    ------
    ValueError : a density below 100.

    Example
    -------
    >>> both = simulate_campaign(density=2000)
    >>> [len(epoch.stations) for epoch in both.epochs]
    [6, 4]
    """
    tunnel = default_tunnel() if tunnel is None else tunnel
    epochs = survey(tunnel, seed)
    return Campaign(
        tunnel,
        tuple(
            Epoch(
                epoch.number,
                tuple(scan_station(tunnel, setup, density, scanner) for setup in epoch.stations),
                epoch.stickers,
            )
            for epoch in epochs
        ),
    )


def survey(tunnel: Tunnel, seed: int = SEED, scanner: Scanner = RIEGL_VZ400) -> tuple[Epoch, Epoch]:
    """Simulate everything but the scans: both epochs with the set-ups of their stations.

    With :func:`scan_station` a campaign is scanned station by station, with one in memory.
    """
    net, *generators = (
        np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(3)
    )
    names, control = _control_points(tunnel)
    measured = control + NET_SD * net.standard_normal(control.shape)
    epochs = []
    for number, generator in zip((1, 2), generators, strict=True):
        setups = tuple(
            _setup(tunnel, number, chainage, names, control, measured, scanner, generator)
            for chainage in STATIONS[number - 1]
        )
        epochs.append(Epoch(number, setups, _stickers(tunnel, number, setups, scanner, generator)))
    return tuple(epochs)


def scan_station(
    tunnel: Tunnel, setup: Setup, density: float = FULL_DENSITY, scanner: Scanner = RIEGL_VZ400
) -> ScannedStation:
    """Scan one station.

    The time is proportional to the density; beams are cast in blocks, so beyond the result the
    memory does not grow.

    Example
    -------
    >>> tunnel = default_tunnel()
    >>> setup = survey(tunnel)[0].stations[2]
    >>> scan_station(tunnel, setup, density=5000).points.shape[1]
    3
    """
    grid = station_grid(density)
    generator = np.random.default_rng(setup.seed)
    points, codes = [], []
    for part in pieces(len(grid), BLOCK):
        beams, ranges, cosines, kinds = cast_beams(tunnel, setup, scanner, grid.beams(part))
        errors = np.einsum(
            "nij,nj->ni",
            scanner.roots(beams, ranges, cosines),
            generator.standard_normal(beams.shape),
        )
        points.append(ranges[:, None] * beams + errors)
        codes.append(kinds.astype(np.uint8))
    return ScannedStation(setup, np.concatenate(points), np.concatenate(codes))


def station_grid(density: float) -> AngularGrid:
    """Beams of a station: ``density`` of them over the full circle by 100°.

    Example
    -------
    >>> float(np.round(np.rad2deg(station_grid(FULL_DENSITY).step), 4))
    0.0894
    """
    if not check_positive(density, "density") >= 100:
        raise ValueError(f"density: expected at least 100 beams a station, got {density:g}")
    step = np.sqrt(2 * np.pi * (ELEVATION[1] - ELEVATION[0]) / density)
    return AngularGrid((-np.pi, np.pi), ELEVATION, step)


def cast_beams(
    tunnel: Tunnel, setup: Setup, scanner: Scanner, beams: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Cast beams (k, 3) in the frame of the instrument, without noise.

    Returns directions (m, 3), ranges, cosines and codes (m,) of those that come back.
    """
    back, ranges, cosines, codes = cast(
        tunnel, setup.epoch, scanner, setup.pose.position, beams @ setup.pose.rotation.T
    )
    return beams[back], ranges, cosines, codes


# ------------------------------------------------------- poses, targets and stickers


def _setup(tunnel, epoch, chainage, names, control, measured, scanner, generator) -> Setup:
    pose = _pose(tunnel, chainage, generator)
    seen = np.flatnonzero(_sees(tunnel, epoch, pose, control, scanner, 0.0))
    distances = np.linalg.norm(control[seen] - pose.position, axis=-1)
    chosen = np.sort(
        seen[np.argsort(np.abs(distances - BEST_TARGET_DISTANCE))[: TARGETS[epoch - 1]]]
    )
    true = control[chosen]
    scanned = pose.to_instrument(true) + TARGET_SD * generator.standard_normal(true.shape)
    targets = Targets(tuple(names[index] for index in chosen), measured[chosen], scanned, true)
    return Setup(epoch, chainage, pose, targets, int(generator.integers(2**63)))


def _pose(tunnel: Tunnel, chainage: float, generator: np.random.Generator) -> Pose:
    u, v = generator.uniform(-CENTRING, CENTRING, 2)
    turn = tunnel.alignment.heading(chainage) + generator.uniform(-HEADING, HEADING)
    tilt = LEVELLING_SD * generator.standard_normal(2)
    rotation = Rotation.from_rotvec([0.0, 0.0, -turn]) * Rotation.from_rotvec([*tilt, 0.0])
    return Pose(
        rotation.as_matrix(),
        tunnel.alignment.points(chainage, u, tunnel.furniture.bed + INSTRUMENT_HEIGHT + v),
    )


def _control_points(tunnel: Tunnel) -> tuple[tuple[str, ...], np.ndarray]:
    chainages = np.arange(0.5 * CONTROL_SPACING, tunnel.alignment.length, CONTROL_SPACING)
    points = [
        tunnel.alignment.points(chainage, *place)
        for number, chainage in enumerate(chainages)
        for place in CONTROL_PAIRS[number % 2]
    ]
    return tuple(f"T{number:02d}" for number in range(1, len(points) + 1)), np.array(points)


def _stickers(
    tunnel: Tunnel, epoch: int, setups, scanner: Scanner, generator: np.random.Generator
) -> Stickers:
    chainage, alpha = (grid.ravel() for grid in np.meshgrid(SECTIONS, STICKERS, indexing="ij"))
    true = tunnel.alignment.polar_points(
        chainage, alpha, tunnel.true_radius(alpha, chainage, epoch)
    )
    distances = np.array([np.linalg.norm(true - setup.pose.position, axis=-1) for setup in setups])
    seen = np.array(
        [_sees(tunnel, epoch, setup.pose, true, scanner, STICKER_COSINE) for setup in setups]
    )
    station = np.argmin(np.where(seen, distances, np.inf), axis=0)
    found = seen.any(axis=0)
    chainage, alpha, true, station = chainage[found], alpha[found], true[found], station[found]
    poses = [setups[place].pose for place in station]
    scanned = np.array([pose.to_instrument(point) for pose, point in zip(poses, true, strict=True)])
    scanned += TARGET_SD * generator.standard_normal(true.shape)
    measured = true + _total_station_errors(tunnel, true, generator)
    return Stickers(chainage, alpha, true, measured, station, scanned)


def _total_station_errors(
    tunnel: Tunnel, true: np.ndarray, generator: np.random.Generator
) -> np.ndarray:
    """(m, 3) errors of points measured from the nearest set-up of the total station, m."""
    stands = tunnel.alignment.points(
        np.array(TOTAL_STATION_AT), 0.0, tunnel.furniture.bed + INSTRUMENT_HEIGHT
    )
    sights = true[:, None, :] - stands
    nearest = np.argmin(np.linalg.norm(sights, axis=-1), axis=1)
    sight = sights[np.arange(len(true)), nearest]
    ranges = np.linalg.norm(sight, axis=-1)
    roots = TOTAL_STATION.roots(sight / ranges[:, None], ranges, 1.0)
    return np.einsum("nij,nj->ni", roots, generator.standard_normal(true.shape))


def _sees(
    tunnel: Tunnel,
    epoch: int,
    pose: Pose,
    points: np.ndarray,
    scanner: Scanner,
    least_cosine: float,
) -> np.ndarray:
    """(m,) bool: points in the window of the instrument with nothing in between."""
    sight = pose.to_instrument(points)
    distances = np.sqrt(dot(sight, sight))
    elevation = np.arcsin(sight[:, 2] / distances)
    back, ranges, cosines, _ = cast(
        tunnel, epoch, scanner, pose.position, (points - pose.position) / distances[:, None]
    )
    free = np.zeros(len(points), dtype=bool)
    free[back] = (ranges > distances[back] - 1e-6) & (cosines > least_cosine)
    return free & (elevation > ELEVATION[0]) & (elevation < ELEVATION[1])
