"""Deformation of simulated sections beside the truth: one campaign in the paper's tables, and many.

The tables have the form of tables 1 and 2 of Li et al. (2015), whose numbers are lost but for the
three maxima; the truth, which the paper could not have, stands beside every number.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from analysis.methods import fit_ellipse
from analysis.result import rms
from analysis.surfaces.ellipse import EllipseFit
from analysis.tunnel.outlines import ovality, quantities
from analysis.tunnel.radii import equal_angles
from analysis.tunnel.significance import LIMITS, classes, differences, share_beyond

from ..simulation.tunnel import EPOCHS
from .hidden_deformation import hidden_deformation, residual_profile
from .motion_and_shape import split
from .simulated_sections import (
    ALL,
    POLE,
    SimulatedChange,
    SimulatedSection,
    compare_epochs,
    true_split,
)

WITHIN = 0.001  # m, in which a maximum counts as recovered


# -------------------------------------------------------------------- one campaign, as in the paper


def registrations(cases: Mapping[str, Sequence[SimulatedSection]]) -> pd.DataFrame:
    """Standard deviations of the shift between the epochs that registration leaves.

    Parameters
    ----------
    cases : words -> sections.

    Returns
    -------
    DataFrame, a row per case and section: ``case``, ``chainage_m``, ``right_sd_mm``, ``up_sd_mm``.
    """
    rows = []
    for words, sections in cases.items():
        for section in sections:
            right, up = 1e3 * np.sqrt(np.diagonal(section.registration))
            rows.append(
                {
                    "case": words,
                    "chainage_m": section.chainage,
                    "right_sd_mm": right,
                    "up_sd_mm": up,
                }
            )
    return pd.DataFrame(rows)


def outlines(of: Sequence[SimulatedChange]) -> pd.DataFrame:
    """Ellipses of both epochs of one campaign, and the largest change: the form of table 1.

    Returns
    -------
    DataFrame, a row per section: ``chainage_m``; ``points_1``, ``points_2``; ``a_1_m``, ``b_1_m``,
    ``a_2_m``, ``b_2_m``, semi-axes; ``largest_mm``, ``sd_mm``, ``at_deg`` of Δρ with its sign;
    ``true_mm``, ``true_at_deg``.
    """
    rows = []
    for one in of:
        delta, truth = one.change.difference[0], one.truth
        at, true_at = int(np.argmax(np.abs(delta))), int(np.argmax(np.abs(truth)))
        (a_1, b_1), (a_2, b_2) = (fit.semi_axes[0] for fit in one.ellipses)
        rows.append(
            {
                "chainage_m": one.section.chainage,
                "points_1": one.points[0].shape[1],
                "points_2": one.points[1].shape[1],
                "a_1_m": a_1,
                "b_1_m": b_1,
                "a_2_m": a_2,
                "b_2_m": b_2,
                "largest_mm": 1e3 * delta[at],
                "sd_mm": 1e3 * one.change.standard_deviations[0, at],
                "at_deg": np.degrees(one.change.angles[at]),
                "true_mm": 1e3 * truth[true_at],
                "true_at_deg": np.degrees(one.change.angles[true_at]),
            }
        )
    return pd.DataFrame(rows)


def directions(of: Sequence[SimulatedChange], step: int = 1) -> pd.DataFrame:
    """Change Δρ by direction in one campaign: the form of table 2.

    Returns
    -------
    DataFrame, a row per direction, every ``step``-th: ``angle_deg``; for every section
    ``<chainage>_mm``, ``<chainage>_sd_mm``, ``<chainage>_true_mm``, Δρ, its standard deviation and
    the truth.
    """
    table = {"angle_deg": np.degrees(of[0].change.angles[::step])}
    for one in of:
        name = f"{one.section.chainage:g}"
        table[f"{name}_mm"] = 1e3 * one.change.difference[0, ::step]
        table[f"{name}_sd_mm"] = 1e3 * one.change.standard_deviations[0, ::step]
        table[f"{name}_true_mm"] = 1e3 * one.truth[::step]
    return pd.DataFrame(table)


def section_quantities(of: Sequence[SimulatedChange]) -> pd.DataFrame:
    """Convergence, settlement and ovality of one campaign beside the truth.

    True ovality is that of the ellipse through the true outline: segments that stand before others
    change it by up to a few millimetres.

    Returns
    -------
    DataFrame, a row per section and quantity: columns of
    :func:`~analysis.tunnel.outlines.quantities` with ``chainage_m`` for the number of the section,
    and ``true``.
    """
    frames = []
    for one in of:
        right, crown, left, invert = 1e3 * one.section.truth(np.deg2rad([90.0, 0.0, -90.0, 180.0]))
        ovalities = [1e3 * float(ovality(_true_ellipse(one, epoch))[0]) for epoch in EPOCHS]
        table = quantities(*one.ellipses, pole=POLE, registration=one.section.registration)
        table.insert(0, "chainage_m", one.section.chainage)
        table.insert(4, "true", [right + left, -crown, crown + invert, *ovalities])
        frames.append(table.drop(columns="section"))
    return pd.concat(frames, ignore_index=True)


def _true_ellipse(one: SimulatedChange, epoch: int) -> EllipseFit:
    """Best ellipse through the true outline in the compared directions."""
    angles = one.change.angles
    radii = one.section.tunnel.true_radius(angles, one.section.chainage, epoch)
    return fit_ellipse(
        np.column_stack([radii * np.sin(angles), radii * np.cos(angles)]), "geometric"
    )


def single_points(section: SimulatedSection, points: tuple[np.ndarray, np.ndarray]) -> pd.DataFrame:
    """Differences of single points as printed: nearest to each direction in three sub-planes.

    Parameters
    ----------
    points : (n, 3) of both epochs, as drawn in one campaign.

    Returns
    -------
    DataFrame, a row per sub-plane and direction: ``chainage_m``, ``plane`` (−1, 0, 1),
    ``angle_deg``, ``difference_mm`` (NaN in a gap), ``class``, ``radius_m`` of the first epoch.
    """
    first, second = (equal_angles(section.section(epoch)) for epoch in points)
    delta = differences(first, second)
    return pd.DataFrame(
        {
            "chainage_m": section.chainage,
            "plane": np.repeat([-1, 0, 1], delta.shape[1]),
            "angle_deg": np.tile(np.degrees(first.directions), 3),
            "difference_mm": 1e3 * delta.ravel(),
            "class": classes(delta).ravel(),
            "radius_m": first.radius.ravel(),
        }
    )


def class_shares(differences_of: pd.DataFrame) -> pd.DataFrame:
    """Shares of the classes in :func:`single_points` of several sections.

    Returns
    -------
    DataFrame, a row per section: ``chainage_m``, ``seen_percent``, and of the seen directions
    ``blue_percent`` and ``red_percent``.
    """
    rows = []
    for chainage, section in differences_of.groupby("chainage_m", sort=False):
        delta = 1e-3 * section["difference_mm"].to_numpy()
        beyond = [100.0 * share_beyond(delta, limit) for limit in LIMITS]
        shares = {
            "seen_percent": 100.0 * np.mean(~np.isnan(delta)),
            "blue_percent": beyond[0] - beyond[1],
            "red_percent": beyond[1],
        }
        rows.append({"chainage_m": chainage, **shares})
    return pd.DataFrame(rows)


# --------------------------------------------------------------------------------- many campaigns


def recovery(
    cases: Mapping[str, Sequence[SimulatedSection]], campaigns: int, seed: int
) -> pd.DataFrame:
    """Errors of the largest change, and of Δρ in all directions, over many campaigns.

    Parameters
    ----------
    cases : words -> sections, with all points of the scans.

    Returns
    -------
    DataFrame, a row per case and section, and one for all sections together:

    * ``case``, ``section``; ``true_mm``, size of the largest true change;
    * ``largest_mm``, size of the largest Δρ, mean over the campaigns; ``largest_rms_mm``,
      ``largest_worst_mm``, its errors; ``within_percent`` of the campaigns with an error up to
      1 mm, and its binomial standard error ``within_se_percent``;
    * ``rmse_mm`` of Δρ over directions and campaigns;
    * of Δρ less its rigid part ``rmse_within_mm``, and ``within_worst_mm``, the worst error in the
      direction with the largest true change.
    """
    rows = []
    for words, sections in cases.items():
        found = [compare_epochs(section, campaigns, seed) for section in sections]
        names = [f"{section.chainage:g} m" for section in sections]
        rows += [_recovery_row(words, name, [one]) for name, one in zip(names, found, strict=True)]
        rows.append(_recovery_row(words, ALL, found))
    return pd.DataFrame(rows)


def _recovery_row(words: str, name: str, of: Sequence[SimulatedChange]) -> dict:
    """Row of :func:`recovery`; of several sections together the largest change has no meaning."""
    true = np.array([np.abs(one.truth).max() for one in of])
    largest = np.array([np.abs(one.change.difference).max(axis=-1) for one in of])
    error = largest - true[:, None]
    within = np.mean(np.abs(error) <= WITHIN)
    at_largest = [one.errors_within[:, np.argmax(np.abs(one.truth))] for one in of]
    return {
        "case": words,
        "section": name,
        "true_mm": 1e3 * true[0] if len(of) == 1 else np.nan,
        "largest_mm": 1e3 * largest.mean() if len(of) == 1 else np.nan,
        "largest_rms_mm": 1e3 * rms(error.ravel()),
        "largest_worst_mm": 1e3 * np.abs(error).max(),
        "within_percent": 100.0 * within,
        "within_se_percent": 100.0 * np.sqrt(within * (1.0 - within) / error.size),
        "rmse_mm": 1e3 * rms(np.array([one.errors for one in of]).ravel()),
        "rmse_within_mm": 1e3 * rms(np.array([one.errors_within for one in of]).ravel()),
        "within_worst_mm": 1e3 * np.abs(at_largest).max(),
    }


# ------------------------------------------------------------------ what moved, and what is hidden


def parts(of: Sequence[SimulatedChange]) -> pd.DataFrame:
    """Rigid part and shape part of Δρ in one campaign, beside the truth.

    Returns
    -------
    DataFrame, a row per section: ``chainage_m``; ``mean_mm``, ``right_mm``, ``up_mm``, mean change
    of the radius and motion of the ring; ``shape_mm``, the largest change of shape; each again with
    ``true_`` in front; ``right_sd_mm``, ``up_sd_mm``.
    """
    rows = []
    for one in of:
        found, true = split(one.change), true_split(one.change.angles, one.truth)
        row = {"chainage_m": one.section.chainage}
        right_sd, up_sd = 1e3 * np.sqrt(np.diagonal(found.translation_covariance[0]))
        for prefix, mean, motion, shape in (
            ("", found.mean[0], found.translation[0], found.shape[0]),
            ("true_", true.mean, true.translation, true.shape),
        ):
            row |= {
                f"{prefix}mean_mm": 1e3 * mean,
                f"{prefix}right_mm": 1e3 * motion[0],
                f"{prefix}up_mm": 1e3 * motion[1],
            }
            row[f"{prefix}shape_mm"] = 1e3 * np.abs(shape).max()
        rows.append(row | {"right_sd_mm": right_sd, "up_sd_mm": up_sd})
    return pd.DataFrame(rows)


def shares(one: SimulatedChange) -> pd.DataFrame:
    """Δρ of one campaign divided into its rigid part and its shape part, by direction.

    Returns
    -------
    DataFrame, a row per direction: ``chainage_m``, ``angle_deg``; ``difference_mm``, ``rigid_mm``,
    ``shape_mm`` (with the mean); each again with ``true_`` in front.
    """
    found, true = split(one.change), true_split(one.change.angles, one.truth)
    columns = {
        "difference": one.change.difference[0],
        "rigid": found.rigid[0],
        "shape": (found.mean[..., None] + found.shape)[0],
    }
    columns |= {
        "true_difference": one.truth,
        "true_rigid": true.rigid,
        "true_shape": true.mean + true.shape,
    }
    table = {f"{name}_mm": 1e3 * values for name, values in columns.items()}
    return pd.DataFrame(
        {"chainage_m": one.section.chainage, "angle_deg": np.degrees(one.change.angles)} | table
    )


def hidden(one: SimulatedChange) -> pd.DataFrame:
    """Change that the ellipses of one campaign show, and change that their residuals hide.

    Returns
    -------
    DataFrame, a row per direction: ``angle_deg``; ``ellipse_mm``, ``ellipse_sd_mm``, the change of
    the ellipses; ``hidden_mm``, ``hidden_sd_mm``, the change of their residuals; ``together_mm``,
    the sum of both; ``true_mm``.
    """
    profiles = []
    for points, fit in zip(one.points, one.ellipses, strict=True):
        plane = points[0, :, :2]
        profiles.append(
            residual_profile(plane, fit_ellipse(plane, fit.method), POLE, angles=one.change.angles)
        )
    rest = hidden_deformation(*profiles)
    ellipse = 1e3 * one.change.difference[0]
    return pd.DataFrame(
        {
            "angle_deg": np.degrees(one.change.angles),
            "ellipse_mm": ellipse,
            "ellipse_sd_mm": 1e3 * one.change.standard_deviations[0],
            "hidden_mm": rest["hidden_mm"],
            "hidden_sd_mm": rest["standard_deviation_mm"],
            "together_mm": ellipse + rest["hidden_mm"],
            "true_mm": 1e3 * one.truth,
        }
    )
