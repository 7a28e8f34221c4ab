"""Outlines that are known exactly: ellipses with a covariance, and points on them."""

import numpy as np

from analysis.surfaces.ellipse import EllipseFit, polar

CIRCLE = np.array([0.02, -0.01, 2.70, 0.0, 0.0])
FLATTENED = np.array([0.022, -0.013, 2.701, 0.010, 0.002])  # 20 mm between the axes, sunk by 3 mm
POLE = np.array([0.05, 0.03])
REGISTRATION = np.array([[1.0, 0.3], [0.3, 0.5]]) * 1e-6


def known(x, covariance=None):
    """An ellipse (u0, v0, m, g, h) as a fit with this covariance of it."""
    x = np.asarray(x, dtype=float)
    covariance = np.zeros(x.shape + (5,)) if covariance is None else covariance
    return EllipseFit(
        "known",
        x,
        covariance,
        np.ones(x.shape[:-1])[()],
        None,
        None,
        0,
        True,
        "",
        regular=x,
        regular_cofactor=covariance,
    )


def outline_points(x, angles, pole=POLE):
    """Points (…, n, 2) of ellipses (…, 5) in directions from a pole."""
    return pole + polar(np.asarray(x), angles, pole)[0][..., None] * np.stack(
        [np.sin(angles), np.cos(angles)], axis=-1
    )
