"""Which sphere methods give the moved sphere for moved points, and which do not, with the reason.

Exact points would hide it: there every method gives the truth. The points here are a cap of unit
radius with 2 % noise, near enough to the origin for its place to matter.
"""

import warnings

import numpy as np
import pytest

import analysis
from analysis.result import ConvergenceWarning

SAME = 1e-9  # relative to the size of the parameters
CLEARLY_DIFFERENT = 1e-6

ROTATION = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
SHIFT = np.array([3.0, -2.0, 1.0])
FACTOR = 3.7
ORDER = np.random.default_rng(2).permutation(80)


def rotated(points):
    return points @ ROTATION.T


# How each motion moves the points (n, 3), and how it moves a sphere (a, b, c, r).
MOTIONS = {
    "translation": (lambda p: p + SHIFT, lambda k, r: (k + SHIFT, r)),
    "rotation about the origin": (rotated, lambda k, r: (rotated(k), r)),
    "rotation about elsewhere": (
        lambda p: rotated(p - SHIFT) + SHIFT,
        lambda k, r: (rotated(k - SHIFT) + SHIFT, r),
    ),
    "scale": (lambda p: FACTOR * p, lambda k, r: (FACTOR * k, FACTOR * r)),
    "permutation": (lambda p: p[ORDER], lambda k, r: (k, r)),
}

EVERYTHING = tuple(MOTIONS)
ABOUT_THE_ORIGIN = ("rotation about the origin", "permutation")
# What each method has, and why it has nothing more.
INVARIANCES = {
    "ls": (EVERYTHING, "r = |p − k|² − R² knows no frame, and a new unit multiplies all r alike"),
    "tls": (
        ABOUT_THE_ORIGIN,
        "Σr²/(1 + |X|²) holds |k| from the origin, δ, and numbers in m beside numbers in m²",
    ),
    "mixed_ls_tls": (
        ABOUT_THE_ORIGIN,
        "Σr²/(1 + |k|²) holds |k| from the origin, and adds the number 1 to m²",
    ),
    "wtls": (
        (*ABOUT_THE_ORIGIN, "scale"),
        "the weights 1/(|p|² + |k|²) hold distances from the origin, all in m²",
    ),
    "igg3_wtls": (
        (*ABOUT_THE_ORIGIN, "scale"),
        "as wtls; its tolerance, in m and m², is absolute, so scale holds to the tolerance",
    ),
    "eiv": (EVERYTHING, "its weights 1/|p − k|² hold distances from the centre"),
    "geometric": (EVERYTHING, "it holds distances from the surface"),
    "robust": (
        EVERYTHING,
        "it takes distances from the surface, and its samples do not depend on the points' order",
    ),
}
OPTIONS = {"igg3_wtls": {"tolerance": 1e-11}}


def cloud():
    generator = np.random.default_rng(3)
    z, angle = generator.uniform(0.2, 1.0, 80), generator.uniform(0, 2 * np.pi, 80)
    radial = np.column_stack(
        [np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z]
    )
    return np.array([1.0, 0.5, 0.2]) + (1 + 0.02 * generator.standard_normal((80, 1))) * radial


def parameters(points, method):
    """(a, b, c, r) of a fit.

    With so low a tolerance ``igg3_wtls`` goes on at rounding level, which does not matter here.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        return analysis.fit_sphere(points, method, **OPTIONS.get(method, {})).parameters


def test_every_method_has_its_line():
    assert set(INVARIANCES) >= set(analysis.SPHERE_METHODS)


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("method", analysis.SPHERE_METHODS)
def test_moved_points_give_the_moved_sphere(method, motion):
    """Where the table says so; and where it does not, clearly another."""
    move, carry = MOTIONS[motion]
    before, after = parameters(cloud(), method), parameters(move(cloud()), method)
    expected = np.append(*carry(before[:3], before[3]))
    change = np.abs(after - expected).max() / np.abs(expected).max()
    if motion in INVARIANCES[method][0]:
        assert change < SAME
    else:
        assert change > CLEARLY_DIFFERENT
