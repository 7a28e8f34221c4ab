"""Single sections of the simulated campaign in both epochs, drawn many times, beside the truth.

A section is what the stations of the campaign see in its slab
(:mod:`studies.simulation.tunnel.slab`). Its frame is that of the design axis: u to the right, v up,
w along; leaving w away is the projection of the slab onto the plane of the section. How well an
axis is found from scans is another matter; a wrong pole moves both epochs alike.

A station that is off by a registration error shifts its points in the plane of the section, all
alike. The errors of all stations of both epochs are drawn together, from the covariance that their
registration states (:mod:`analysis.tunnel.block_adjustment`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from analysis.methods import fit_ellipse
from analysis.surfaces.ellipse import EllipseFit
from analysis.tunnel.block_adjustment import Block
from analysis.tunnel.outlines import ANGLES, RadialChange, deformation
from analysis.tunnel.sections import THICKNESS, Section

from .. import parallel
from ..simulation.tunnel import (
    CODES,
    FULL_DENSITY,
    SectionScan,
    Tunnel,
    section_points,
    section_scan,
    survey,
)
from .motion_and_shape import Split, split

POLE = np.zeros(2)  # the axis point
ALL = "all"  # in tables, of all sections together
BOTH = 0  # in place of the number of an epoch, for the draws that both have in common


@dataclass(frozen=True, eq=False)
class SimulatedSection:
    """One section as the stations of both epochs see it, without noise.

    tunnel : with the truth
    chainage : m
    scans : of the first and the second epoch
    stations : their number in each epoch
    shifts : (2K, 2K) covariance in m² of the shifts (right, up) of all K stations by registration,
        those of the first epoch first; zeros without registration errors
    """

    tunnel: Tunnel
    chainage: float
    scans: tuple[SectionScan, SectionScan]
    stations: tuple[int, int]
    shifts: np.ndarray

    def truth(self, angles=ANGLES) -> np.ndarray:
        """True δ (K,) in m, positive outwards, in directions (K,) in rad."""
        return self.tunnel.deformation(np.asarray(angles), self.chainage)

    def lining(self) -> SimulatedSection:
        """The section with the points of the lining alone, as a perfect filter would leave it."""
        kept = tuple(scan[scan.codes == CODES["lining"]] for scan in self.scans)
        return replace(self, scans=kept)

    def with_registration(self, block: Block) -> SimulatedSection:
        """The section with the registration errors that a block of all stations states.

        Parameters
        ----------
        block : the stations of both epochs, those of the first epoch first.

        Raises
        ------
        ValueError : another number of stations.
        """
        if len(block.stations) != sum(self.stations):
            both = f"{sum(self.stations)} stations, those of both epochs"
            raise ValueError(f"block: expected {both}, got {len(block.stations)}")
        axis = self.tunnel.alignment
        directions = axis.frame(self.chainage)[[0, 2]]
        return replace(self, shifts=block.shifts(axis.position(self.chainage), directions))

    @property
    def registration(self) -> np.ndarray:
        """Covariance (2, 2) in m² of the section's shift (right, up) between the epochs.

        An epoch is shifted by ``Σ (n_k/n) s_k``, n_k of its n points being of station k, which is
        off by s_k.
        """
        parts = [
            np.bincount(scan.stations, minlength=count) / len(scan)
            for scan, count in zip(self.scans, self.stations, strict=True)
        ]
        A = np.kron(np.concatenate([-parts[0], parts[1]]), np.eye(2))
        return A @ self.shifts @ A.T

    def draw(
        self, campaigns: int, seed: int, *, n_points: int | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Draw the points of both epochs in B campaigns.

        The draws differ between sections and epochs; those of campaign i do not depend on B.

        Parameters
        ----------
        campaigns : B.
        n_points : points of the section in each campaign, others in every campaign; default all.

        Returns
        -------
        (B, n, 3) of each epoch: right, up and along from the axis point, m.
        """
        shifts = np.split(self._shifts(campaigns, seed), [self.stations[0]], axis=1)
        return tuple(
            self._draw(scan, campaigns, seed, of_epoch, n_points)
            for scan, of_epoch in zip(self.scans, shifts, strict=True)
        )

    def _children(self, campaigns: int, seed: int, part: int) -> list[np.random.SeedSequence]:
        return np.random.SeedSequence((seed, round(1000 * self.chainage), part)).spawn(campaigns)

    def _shifts(self, campaigns: int, seed: int) -> np.ndarray:
        """Shifts (right, up) of all stations in every campaign, (B, K, 2) in m."""
        values, vectors = np.linalg.eigh(self.shifts)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        children = self._children(campaigns, seed, BOTH)
        generators = map(np.random.default_rng, children)
        drawn = np.array([generator.standard_normal(len(root)) for generator in generators])
        return (drawn @ root.T).reshape(campaigns, -1, 2)

    def _draw(
        self, scan: SectionScan, campaigns: int, seed: int, shifts: np.ndarray, n_points: int | None
    ) -> np.ndarray:
        """Points (B, n, 3) of one epoch, whose stations have the shifts (B, K, 2)."""
        axis, clouds = self.tunnel.alignment, []
        origin, turn = axis.position(self.chainage), axis.frame(self.chainage)[[0, 2, 1]].T
        children = self._children(campaigns, seed, scan.epoch)
        for child, of_stations in zip(children, shifts, strict=True):
            which, noise = child.generate_state(2).tolist()
            seen = scan if n_points is None else scan.sample(n_points, which)
            cloud = (section_points(seen, 1, noise)[0] - origin) @ turn
            cloud[:, :2] += of_stations[seen.stations]
            clouds.append(cloud)
        return np.stack(clouds)

    def section(self, points: np.ndarray) -> Section:
        """Drawn points (n, 3) of one epoch in the form of a section cut from a scan."""
        axis = self.tunnel.alignment
        right, along, up = axis.frame(self.chainage)
        frame = axis.position(self.chainage), right, up, along
        return Section(self.chainage, *frame, THICKNESS, np.arange(len(points)), *points.T)


def simulated_sections(
    tunnel: Tunnel,
    chainages: Sequence[float],
    density: float = FULL_DENSITY,
    *,
    workers: int | None = None,
) -> tuple[SimulatedSection, ...]:
    """Cast the sections at these chainages (m), without registration errors.

    Parameters
    ----------
    density : beams per station.
    workers : processes that share the work, which changes nothing.

    Example
    -------
    >>> from studies.simulation.tunnel import default_tunnel
    >>> section, = simulated_sections(default_tunnel(), [65.0], 50_000, workers=1)
    >>> print((1e3 * section.truth([0.0])).round(3))
    [-24.3]
    >>> len(section.lining().scans[0]) < len(section.scans[0])
    True
    """
    epochs = survey(tunnel)
    tasks = [(tunnel, epoch.stations, at, density) for at in chainages for epoch in epochs]
    scans = parallel.run(section_scan, tasks, workers)
    pairs = zip(scans[::2], scans[1::2], strict=True)
    stations = tuple(len(epoch.stations) for epoch in epochs)
    nothing = np.zeros((2 * sum(stations), 2 * sum(stations)))
    return tuple(
        SimulatedSection(tunnel, float(at), pair, stations, nothing)
        for at, pair in zip(chainages, pairs, strict=True)
    )


@dataclass(frozen=True, eq=False)
class SimulatedChange:
    """Change of a simulated section between the epochs in B campaigns, beside the truth.

    section : without noise
    points : (B, n, 3) of each epoch
    ellipses : of each epoch
    change : Δρ (B, K) about the axis point
    truth : δ (K,), m
    """

    section: SimulatedSection
    points: tuple[np.ndarray, np.ndarray]
    ellipses: tuple[EllipseFit, EllipseFit]
    change: RadialChange
    truth: np.ndarray

    @property
    def errors(self) -> np.ndarray:
        """(B, K) errors of Δρ, m."""
        return self.change.difference - self.truth

    @property
    def errors_within(self) -> np.ndarray:
        """(B, K) errors of Δρ less its rigid part, m; a shift of the section is not in them."""
        true = true_split(self.change.angles, self.truth)
        return self.errors - (split(self.change).rigid - true.rigid)


def compare_epochs(
    section: SimulatedSection,
    campaigns: int,
    seed: int,
    *,
    n_points: int | None = None,
    angles: np.ndarray = ANGLES,
    method: str = "robust",
) -> SimulatedChange:
    """Draw a section in B campaigns, fit ellipses to both epochs, and compare these by direction.

    Parameters
    ----------
    campaigns : B.
    n_points : points of the section in each campaign; default all.
    angles : directions (K,), rad.
    method : of :func:`analysis.fit_ellipse`.
    """
    points = section.draw(campaigns, seed, n_points=n_points)
    ellipses = tuple(fit_ellipse(epoch[..., :2], method) for epoch in points)
    change = deformation(*ellipses, pole=POLE, angles=angles, registration=section.registration)
    return SimulatedChange(section, points, ellipses, change, section.truth(angles))


def true_split(angles: np.ndarray, truth: np.ndarray) -> Split:
    """Divide a true δ (K,) as an estimated one."""
    nothing = np.zeros((len(angles), 1))
    return split(RadialChange(angles, truth, truth, truth, nothing, np.zeros((1, 1))))
