"""Two epochs of a tunnel compared, from their scans to the deformation of every section.

    axis of the first epoch → lining of each epoch → sections at equal chainages
        → radii by direction → significance
        → ellipses → Δρ(α), convergence, settlement

Both epochs are in one system and both are cut with the axis of the first, as in Li et al. (2015),
section 4.2.2. What is left to the user is how well the second epoch is registered to the first:
that error does not average out and decides what is significant.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import pandas as pd

from ..checks import check_positive, finite_array
from ..methods import fit_ellipse
from ..result import ignore_convergence_warnings
from ..surfaces.ellipse import EllipseFit
from .axis import Axis, tunnel_points
from .axis_estimation import robust_axis
from .filter import FilteredLining, filter_lining
from .outlines import RadialChange, deformation, quantities
from .radii import DIRECTIONS, Radii, local_radii
from .radii import FEWEST as FEWEST_RADII
from .sections import THICKNESS, Section, cut
from .significance import Significance, classes, differences, flagged, share_beyond, significance

EPOCHS = ("first", "second")
SPACING = 10.0  # m between sections (Li et al. 2015, section 4.1)
REGISTRATION_SD = 0.001  # m, of a section's shift between the epochs, in each coordinate
FEWEST = 50  # points of a section in each epoch for an ellipse
LEAST_SEEN = 0.5  # of the directions in both epochs, for an ellipse
# at most so many times the other's median distance from the axis, for two epochs of one tunnel
ALIKE = 1.5
LOOKED_AT = 100_000  # points that tell where an epoch lies
STEPS = (  # as ``compare`` reports them
    "axis of the first epoch",
    "lining of the first epoch",
    "lining of the second epoch",
    "sections of the first epoch",
    "sections of the second epoch",
    "radii, ellipses and what has changed",
)
UNKNOWN = {  # what a row says of a section of which nothing can be said
    "beyond_6_mm_percent": np.nan,
    "flagged": False,
    "significant_percent": np.nan,
    "p_motion": np.nan,
    "p_shape": np.nan,
    "p_value": np.nan,
    "changed": False,
    "largest_change_mm": np.nan,
    "largest_change_sd_mm": np.nan,
    "at_deg": np.nan,
    "crown_settlement_mm": np.nan,
    "crown_settlement_sd_mm": np.nan,
    "horizontal_convergence_mm": np.nan,
    "horizontal_convergence_sd_mm": np.nan,
}


@dataclass(frozen=True, eq=False)
class ComparedSection:
    """One section in both epochs.

    sections, radii : of the first and the second epoch; points of the lining only, their `index` in
        the epoch's points
    significance : of the differences of the radii, direction by direction and together; None where
        no direction is seen twice
    ellipses : robust ellipse of each epoch; None where too little is seen
    change : Δρ(α) of the ellipses about the axis of the first epoch; None without ellipses or where
        one has not converged
    registration : (2, 2) m², covariance of the section's shift (right, up) between the epochs
    note : why there is no change, in words; empty where there is one
    """

    sections: tuple[Section, Section]
    radii: tuple[Radii, Radii]
    significance: Significance | None
    ellipses: tuple[EllipseFit, EllipseFit] | None
    change: RadialChange | None
    registration: np.ndarray
    note: str

    @property
    def chainage(self) -> float:
        """In m, along the axis of the first epoch."""
        return self.sections[0].chainage

    @property
    def difference(self) -> np.ndarray:
        """(J,) m, of the radii by direction, positive outwards; NaN where an epoch has a gap."""
        return differences(*self.radii)

    @property
    def converged(self) -> bool:
        """Whether every ellipse that was fitted has converged."""
        return self.ellipses is None or all(bool(ellipse.converged) for ellipse in self.ellipses)

    def row(self) -> dict:
        """The line of the section in :meth:`EpochComparison.table`."""
        seen = ~np.isnan(self.difference)
        row = {
            "chainage_m": self.chainage,
            "points_1": self.sections[0].count,
            "points_2": self.sections[1].count,
            "seen_percent": 100.0 * float(np.mean(seen)),
            **UNKNOWN,
            "note": self.note,
        }
        if (found := self.significance) is not None:
            row["beyond_6_mm_percent"] = 100.0 * share_beyond(found.delta)
            row["flagged"] = flagged(found.delta)
            row["significant_percent"] = 100.0 * float(np.mean(found.significant[seen]))
            for name in ("p_motion", "p_shape", "p_value", "changed"):
                row[name] = getattr(found, name)
        if self.change is not None and self.ellipses is not None:
            # Where nothing is seen the ellipses differ, too, but nobody has measured that.
            largest = int(np.nanargmax(np.where(seen, np.abs(self.change.difference), np.nan)))
            row["largest_change_mm"] = 1e3 * float(self.change.difference[largest])
            row["largest_change_sd_mm"] = 1e3 * float(self.change.standard_deviations[largest])
            row["at_deg"] = float(np.degrees(self.change.angles[largest]))
            read_off = quantities(
                *self.ellipses, pole=np.zeros(2), registration=self.registration
            ).set_index("quantity")
            for name in ("crown settlement", "horizontal convergence"):
                column = name.replace(" ", "_")
                row[f"{column}_mm"] = float(read_off["value"][name])
                row[f"{column}_sd_mm"] = float(read_off["standard_deviation"][name])
        return row

    def by_direction(self) -> pd.DataFrame:
        """The section's rows of :meth:`EpochComparison.by_direction`."""
        found, change = self.significance, self.change
        return pd.DataFrame(
            {
                "chainage_m": self.chainage,
                "angle_deg": np.degrees(self.radii[0].directions),
                "class": classes(self.difference),
                "difference_mm": 1e3 * self.difference,
                "detectable_mm": np.nan if found is None else 1e3 * found.limit,
                "significant": False if found is None else found.significant,
                "ellipse_difference_mm": np.nan if change is None else 1e3 * change.difference,
                "ellipse_sd_mm": np.nan if change is None else 1e3 * change.standard_deviations,
            }
        )


@dataclass(frozen=True, eq=False)
class EpochComparison:
    """Two epochs of a tunnel compared.

    axis : of the first epoch
    linings : what the filter found in each epoch
    sections : one :class:`ComparedSection` a chainage
    """

    axis: Axis
    linings: tuple[FilteredLining, FilteredLining]
    sections: tuple[ComparedSection, ...]

    @property
    def converged(self) -> bool:
        """Whether the axis and every ellipse that was fitted have converged."""
        return self.axis.converged and all(section.converged for section in self.sections)

    def table(self) -> pd.DataFrame:
        """A row per section.

        - `chainage_m`: of the section, along the axis of the first epoch
        - `points_1`, `points_2`: of the lining in each epoch
        - `seen_percent`: of the directions, in both epochs
        - `beyond_6_mm_percent`, `flagged`: of the directions seen, |δ| > 6 mm; more than 30 % of
          them (Li et al. 2015)
        - `significant_percent`: of the directions seen, |δ| beyond its own level of detection
        - `p_motion`, `p_shape`: probability, without deformation, of so large a motion of the
          section, and of such differences beside any motion
        - `p_value`, `changed`: of the section as a whole, from both; whether it is below 5 %
        - `largest_change_mm`, `…_sd_mm`, `at_deg`: of the ellipses, + outwards, over the directions
          seen; 0° crown, + right
        - `crown_settlement_mm`, `…_sd_mm`: −Δρ(0°) of the ellipses, + downwards
        - `horizontal_convergence_mm`, `…_sd_mm`: Δρ(90°) + Δρ(−90°) of the ellipses, + where the
          section widens
        - `note`: why there are no ellipses

        Standard deviations hold the noise of both epochs and the registration. NaN where nothing
        can be said; such a section is neither flagged nor changed.
        """
        return pd.DataFrame([section.row() for section in self.sections])

    def by_direction(self) -> pd.DataFrame:
        """A row per section and direction: `chainage_m`, `angle_deg` (0° crown, + right) and

        - `class`, `difference_mm`: measured in the direction itself, + outwards; black, blue, red
          or gap;
        - `detectable_mm`, `significant`: its level of detection, and whether it is beyond that;
        - `ellipse_difference_mm`, `ellipse_sd_mm`: of the ellipses, which say something in gaps,
          too.
        """
        return pd.concat([section.by_direction() for section in self.sections], ignore_index=True)


def compare(
    first,
    second,
    *,
    spacing: float = SPACING,
    chainages=None,
    thickness: float = THICKNESS,
    registration=REGISTRATION_SD,
    axis: Axis | None = None,
    report: Callable[[str], None] = lambda step: None,
) -> EpochComparison:
    """Compare two epochs of a tunnel.

    Parameters
    ----------
    first, second : (n, 3) points of the epochs in m, in one system, Z up; the tunnel may run in any
        horizontal direction.
    spacing : between the sections in m, from where both epochs begin; or give their ``chainages``
        (K,) along the axis, m.
    thickness : of the sections, m.
    registration : of the second epoch relative to the first: standard deviation in m of a section's
        shift in each coordinate, or its covariance (2, 2) of (right, up) in m², or one a section,
        (K, 2, 2).
    axis : to cut with; None finds it from the first epoch.
    report : is told each of ``STEPS`` as it begins.

    Returns
    -------
    EpochComparison. A section of which an epoch shows too little has no ellipses and no change,
    and says so. Memory beyond the points is some 40 bytes per point and does not grow with the
    number of sections.

    Raises
    ------
    ValueError : for points that are no tunnel, epochs that do not overlap or are not of one size
        and place, and values of the wrong shape or sign. The message begins with ``first:`` or
        ``second:`` where an epoch is to blame.

    Source: Li et al. 2015, sections 3 and 4.2; the tests and the standard deviations are additions.

    >>> y, turn = np.arange(20_000) * 5e-4, np.arange(20_000) * 2.4
    >>> def epoch(a, b):
    ...     return np.stack([a * np.sin(turn), y, b * np.cos(turn)], axis=-1)
    >>> result = compare(epoch(2.7, 2.7), epoch(2.71, 2.69), chainages=[4.0, 5.0], thickness=0.2)
    >>> result.table()[["crown_settlement_mm", "horizontal_convergence_mm"]].round(1).to_numpy()
    array([[10., 20.],
           [10., 20.]])
    """
    spacing, thickness = check_positive(spacing, "spacing"), check_positive(thickness, "thickness")
    epochs, linings, cuts = [], [], []
    for name, points in zip(EPOCHS, (first, second), strict=True):
        with _blamed(name):
            epochs.append(tunnel_points(points, "a tunnel"))
    if axis is None:
        report(STEPS[0])
        with _blamed("first"):
            axis = robust_axis(epochs[0])
    start, stop = _overlap(axis, *epochs)
    if chainages is None:
        chainages = np.arange(start, stop, spacing)
    chainages = np.atleast_1d(finite_array(chainages, "chainages"))
    registrations = _registrations(registration, len(chainages))
    for name, points in zip(EPOCHS, epochs, strict=True):
        report(f"lining of the {name} epoch")
        with _blamed(name):
            linings.append(filter_lining(points, axis))
    for name, points, filtered in zip(EPOCHS, epochs, linings, strict=True):
        report(f"sections of the {name} epoch")
        found, keep = cut(points, axis, chainages, thickness), filtered.lining
        cuts.append([section.only(keep[section.index]) for section in found])
    report(STEPS[-1])
    sections = tuple(_compared(*pair) for pair in zip(*cuts, registrations, strict=True))
    return EpochComparison(axis, (linings[0], linings[1]), sections)


# ---------------------------------------------------------------------------------- a section


def _compared(first: Section, second: Section, registration: np.ndarray) -> ComparedSection:
    pair = (first, second)
    before, after = (
        local_radii(section) if section.count >= FEWEST_RADII else _nothing() for section in pair
    )
    seen = ~np.isnan(differences(before, after))
    found = significance(before, after, registration=registration) if seen.any() else None
    ellipses = change = None
    note = _too_little(pair, float(seen.mean()))
    if not note:
        ellipses, note = _ellipses(pair)
    if ellipses is not None and not note:
        change = deformation(
            *ellipses, pole=np.zeros(2), angles=before.directions, registration=registration
        )
        if not np.isfinite(change.difference[seen]).all():
            change, note = None, "the axis lies outside an ellipse"
    return ComparedSection(pair, (before, after), found, ellipses, change, registration, note)


def _too_little(sections: tuple[Section, Section], seen: float) -> str:
    """Reason why ellipses cannot be fitted; empty where they can."""
    for name, section in zip(EPOCHS, sections, strict=True):
        if section.count < FEWEST:
            return f"{section.count} points of lining in the {name} epoch, {FEWEST} are needed"
    if seen < LEAST_SEEN:
        needed = f"{100 * LEAST_SEEN:.0f} % are needed"
        return f"{100 * seen:.0f} % of the directions seen in both epochs, {needed}"
    return ""


def _ellipses(
    sections: tuple[Section, Section],
) -> tuple[tuple[EllipseFit, EllipseFit] | None, str]:
    """Robust ellipses of both epochs, and what is wrong with them."""
    try:
        with ignore_convergence_warnings():  # the note says it
            before, after = (
                fit_ellipse(np.column_stack([section.u, section.v])) for section in sections
            )
    except ValueError as error:
        return None, f"no ellipse: {error}"
    stopped = [str(ellipse.stop_reason) for ellipse in (before, after) if not ellipse.converged]
    return (before, after), stopped[0] if stopped else ""


def _nothing() -> Radii:
    """Gaps in all directions."""
    nan, none = np.full(len(DIRECTIONS), np.nan), np.zeros(len(DIRECTIONS))
    return Radii(DIRECTIONS, nan, nan, nan, none, none > 0, nan)


# ---------------------------------------------------------------------------------- both epochs


@contextmanager
def _blamed(name: str) -> Iterator[None]:
    """Puts the epoch in front of a message."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from error


def _overlap(axis: Axis, first: np.ndarray, second: np.ndarray) -> tuple[float, float]:
    """Chainages between which both epochs lie, after a look at whether they are of one tunnel."""
    (ends_1, distance_1), (ends_2, distance_2) = _place(axis, first), _place(axis, second)
    start, stop = np.clip([max(ends_1[0], ends_2[0]), min(ends_1[1], ends_2[1])], 0.0, axis.length)
    if not start < stop:
        raise ValueError(
            "second: expected an epoch in the unit (m) and system of the first that overlaps with "
            f"it, got {ends_2[0]:.1f} to {ends_2[1]:.1f} m along its axis, beside "
            f"{ends_1[0]:.1f} to {ends_1[1]:.1f} m"
        )
    if not distance_1 / ALIKE < distance_2 < distance_1 * ALIKE:
        raise ValueError(
            "second: expected an epoch in the unit (m) and system of the first, half of whose "
            f"points lie within {distance_1:.4g} m of its axis; got {distance_2:.4g} m"
        )
    return float(start), float(stop)


def _place(axis: Axis, points: np.ndarray) -> tuple[np.ndarray, float]:
    """Chainages between which nearly all points lie, and their median distance from the axis.

    A thousandth lies beyond either chainage; the distance is that of the points beside the axis.
    """
    y, radius, _ = axis.polar(points[:: max(1, len(points) // LOOKED_AT)])
    # beyond its ends a straight continuation is no axis of the tunnel
    beside = (y >= axis.y_range[0]) & (y <= axis.y_range[1])
    distance = float(np.median(radius[beside])) if beside.any() else np.nan
    return axis.chainage(np.quantile(y, [0.001, 0.999])), distance


def _registrations(registration, count: int) -> np.ndarray:
    """(K, 2, 2) covariances in m²."""
    array = finite_array(registration, "registration")
    if array.ndim == 0:
        if array < 0:
            raise ValueError(
                f"registration: expected a standard deviation not below 0, got {array:g}"
            )
        array = array**2 * np.eye(2)
    if array.shape not in ((2, 2), (count, 2, 2)):
        raise ValueError(
            "registration: expected a standard deviation or covariances of shape (2, 2) or "
            f"({count}, 2, 2), got {array.shape}"
        )
    return np.broadcast_to(array, (count, 2, 2))
