"""A dent that ellipses do not follow is in the change of their residuals."""

import numpy as np
import pytest

import analysis
from analysis.tunnel.outlines import ANGLES, deformation
from studies.li_2015.hidden_deformation import hidden_deformation, residual_profile

from ...analysis.tunnel.exact_outlines import CIRCLE, POLE, outline_points


def test_what_the_ellipse_hides():
    """A dent of 24.3 mm in 20° of the crown beside a cable tray that stands in both epochs."""
    rng, n = np.random.default_rng(5), 5400
    angles = rng.uniform(-0.75 * np.pi, 0.75 * np.pi, (2, n))
    outwards = np.stack([np.sin(angles), np.cos(angles)], axis=-1)
    tray = np.where(np.abs(angles - 1.5) < 0.05, -0.13, 0.0)
    dent = -0.0243 * np.exp(-0.5 * (angles / np.deg2rad(5.0)) ** 2) * np.array([[0.0], [1.0]])
    points = (
        np.stack([outline_points(CIRCLE, epoch) for epoch in angles])
        + (tray + dent)[..., None] * outwards
    )
    points += 0.003 * rng.standard_normal((2, n, 2))
    fits = [analysis.fit_ellipse(epoch) for epoch in points]
    change = deformation(*fits, pole=POLE)
    assert np.abs(change.difference).max() < 0.002  # the ellipses see next to nothing
    hidden = hidden_deformation(
        *(residual_profile(p, fit, POLE) for p, fit in zip(points, fits, strict=True))
    )
    crown = hidden["angle_deg"].abs().idxmin()
    total = hidden["hidden_mm"][crown] + 1000 * change.difference[crown]
    sd = hidden["standard_deviation_mm"]
    assert (
        abs(total - np.median(-24.3 * np.exp(-0.5 * (np.linspace(-2, 2, 101) / 5) ** 2)))
        < 2.5 * sd[crown]
    )
    assert sd[crown] < 1.0
    assert hidden["hidden_mm"][crown] < 0.8 * total
    # At the edges of the tray the middle of a cell is now lining, now tray: the standard deviation
    # says so.
    quiet = hidden[(hidden["angle_deg"].abs() > 25) & (sd < 2)]
    assert len(quiet) > 205
    assert quiet["hidden_mm"].abs().max() < 3.5
    assert (quiet["hidden_mm"].abs() > 1.96 * sd[quiet.index]).mean() < 0.12
    assert hidden["hidden_mm"].notna().all()


def test_profile_has_gaps_where_there_is_nothing():
    angles = np.linspace(-2, 1, 1000)
    points = outline_points(CIRCLE, angles)
    profile = residual_profile(points, analysis.fit_ellipse(points, "geometric"), POLE)
    assert profile["residual_mm"].isna().equals(profile["points"] < 5)
    assert profile["residual_mm"][profile["angle_deg"] > 65].isna().all()
    assert profile["residual_mm"][profile["angle_deg"].abs() < 50].notna().all()


def test_points_of_another_fit_are_refused():
    points = outline_points(CIRCLE, ANGLES)
    fit, before = analysis.fit_ellipse(points, "geometric"), points.copy()
    residual_profile(points, fit, POLE)
    np.testing.assert_array_equal(points, before)  # and those of its own are not changed
    with pytest.raises(ValueError, match="points: expected those of the fit"):
        residual_profile(points[:3], fit, POLE)
