"""A cable tray pulls the plain ellipses and not the robust ones."""

import pytest

from analysis.methods import ELLIPSE_METHODS
from studies.li_2015.cable_tray import tray_study


def test_a_tray_over_5_percent_of_the_arc():
    study = tray_study([0.0, 0.05], trials=5)
    worst = study.set_index(["share_percent", "method"])["worst_mm"]
    assert set(study["method"]) == set(ELLIPSE_METHODS)
    for method in ELLIPSE_METHODS:
        assert worst[0.0, method] < 0.7  # nothing there: all are good
    for method in ("robust", "robust_direct"):
        assert worst[5.0, method] < 0.5
    for method in ("direct", "geometric"):
        assert 20 < worst[5.0, method] < 40


def test_without_noise_and_tray_the_radii_are_exact(monkeypatch):
    monkeypatch.setattr("studies.li_2015.cable_tray.NOISE", 0.0)
    study = tray_study([0.0], trials=1, n=200)
    assert study["worst_mm"].to_numpy() == pytest.approx(0.0, abs=1e-6)
