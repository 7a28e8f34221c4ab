"""Problems that others have published with their answers: each a TOML file beside this one, with
its source.

An answer given as text is right to its printed digits: ours may differ by half a unit of the last
one.
"""

import tomllib
from pathlib import Path

import numpy as np
import pytest

import analysis
from analysis.adjustment.algorithms import ALGORITHMS
from analysis.adjustment.cofactors import CONVENTIONS


def problem(name):
    """The problem's data as arrays, and all of the file."""
    content = tomllib.loads((Path(__file__).parent / f"{name}.toml").read_text(encoding="utf-8"))
    return {key: np.array(values, dtype=float) for key, values in content["data"].items()}, content


def assert_printed(ours, printed):
    """``ours`` is within half a unit of the last printed digit of each number."""
    texts = np.atleast_1d(printed)
    half_unit = [0.5 * 10.0 ** -len(text.partition(".")[2]) for text in texts]
    difference = np.abs(np.atleast_1d(ours) - texts.astype(float))
    assert np.all(difference <= half_unit), f"expected {printed}, got {ours}"


def ones_and(x):
    return np.column_stack([np.ones_like(x), x])


def test_total_least_squares_of_slicot():
    data, content = problem("slicot_mb02md")
    A, b = np.column_stack([data["a1"], data["a2"], data["a3"]]), data["b"]
    estimate = analysis.tls(A, b)
    assert_printed(estimate.x, content["answer"]["x"])
    # Φ of TLS is the square of the smallest singular value of [A | b]; the product of all four is
    # the volume |R|.
    singular = np.linalg.svd(np.column_stack([A, b]), compute_uv=False)
    assert_printed(singular, content["answer"]["singular_values"])
    np.testing.assert_allclose(estimate.objective, singular[-1] ** 2, rtol=1e-10)
    assert_printed(np.sqrt(estimate.objective), content["answer"]["singular_values"][-1])


def test_mixed_ls_tls_of_pearson():
    data, content = problem("pearson_york")
    a, b = analysis.mixed_ls_tls(ones_and(data["x"]), data["y"], exact_columns=[0]).x
    through = np.array(content["unweighted"]["through"], dtype=float)
    assert_printed(b, content["unweighted"]["slope"])
    np.testing.assert_allclose(a + b * through[0], through[1], rtol=0, atol=1e-12)
    np.testing.assert_allclose([data["x"].mean(), data["y"].mean()], through, rtol=0, atol=1e-12)


every_algorithm = pytest.mark.parametrize("algorithm", ALGORITHMS)


def line(data, Q_x, Q_y, **options):
    return analysis.wtls(
        ones_and(data["x"]), data["y"], Q_0=np.diag([0.0, 1.0]), Q_X=Q_x, Q_y=Q_y, **options
    )


def pearson_york(**options):
    data, content = problem("pearson_york")
    return line(data, 1 / data["weight_x"], 1 / data["weight_y"], **options), content["weighted"]


@every_algorithm
def test_weighted_line_of_pearson_and_york(algorithm):
    estimate, printed = pearson_york(algorithm=algorithm)
    assert_printed(estimate.x, [printed["a"], printed["b"]])
    assert_printed(estimate.objective / 8, printed["reduced_objective"])
    assert_printed(estimate.sigma_0**2, printed["reduced_objective"])


@pytest.mark.parametrize("accuracy", CONVENTIONS)
def test_standard_errors_of_pearson_and_york(accuracy):
    """The literature prints three of them for the same line: each is one convention's, and no
    other's.
    """
    estimate, printed = pearson_york(accuracy=accuracy)
    standard_errors = np.sqrt(np.diag(estimate.cofactor))
    assert_printed(standard_errors, printed[f"standard_errors_{accuracy}"])
    for other in set(CONVENTIONS) - {accuracy}:
        assert np.any(
            np.abs(standard_errors - np.array(printed[f"standard_errors_{other}"], dtype=float))
            > 2e-4
        )


@every_algorithm
def test_line_of_iso_28037(algorithm):
    data, content = problem("iso_28037_clause_7")
    estimate = line(data, data["u_x"] ** 2, data["u_y"] ** 2, algorithm=algorithm)
    printed = content["answer"]
    assert_printed(estimate.x, [printed["a"], printed["b"]])
    assert_printed(np.sqrt(np.diag(estimate.cofactor)), [printed["u_a"], printed["u_b"]])
    assert_printed(estimate.cofactor[0, 1], printed["cov_ab"])
    assert_printed(estimate.objective, printed["chi_squared"])


def test_iso_28037_states_gauss_newton_s_accuracy():
    data, content = problem("iso_28037_clause_7")
    printed = np.array([content["answer"]["u_a"], content["answer"]["u_b"]], dtype=float)
    for accuracy in ("inverse_hessian", "propagated"):
        cofactor = line(data, data["u_x"] ** 2, data["u_y"] ** 2, accuracy=accuracy).cofactor
        assert np.abs(np.sqrt(np.diag(cofactor)) - printed).max() > 1e-4


def test_algebraic_circle_of_gander_golub_and_strebel():
    data, content = problem("gander_circle")
    x, y = data["x"], data["y"]
    u, v, w = analysis.tls(np.column_stack([x, y, np.ones_like(x)]), x**2 + y**2).x
    assert_printed([u / 2, v / 2], content["answer"]["centre"])
    assert_printed(np.sqrt(w + (u**2 + v**2) / 4), content["answer"]["radius"])


def test_plane_of_scikit_spatial():
    data, content = problem("skspatial_plane")
    A = np.column_stack([data["x"], data["y"], np.ones(4)])
    estimate = analysis.mixed_ls_tls(A, data["z"], exact_columns=[2])
    np.testing.assert_allclose(
        estimate.x, [float(content["answer"][name]) for name in "abc"], rtol=0, atol=1e-14
    )
    np.testing.assert_allclose(
        estimate.objective, float(content["answer"]["sum_of_squares"]), rtol=0, atol=1e-14
    )


def pcl_sphere():
    data, content = problem("pcl_sphere")
    points, answer = np.column_stack([data["x"], data["y"], data["z"]]), content["answer"]
    return points, np.array([*answer["centre"], answer["radius"]], dtype=float), answer["inliers"]


def test_sphere_of_the_point_cloud_library():
    points, truth, inliers = pcl_sphere()
    fit = analysis.fit_sphere(points[:inliers], "ls")
    # The nine points lie within 0.0003 of the sphere, not on it.
    assert fit.sigma_s < 2e-4
    assert np.all(np.abs(fit.parameters - truth) < 3 * fit.standard_deviations)
    np.testing.assert_allclose(fit.parameters, truth, rtol=0, atol=3e-4)


def test_printed_method_keeps_the_gross_error_of_the_point_cloud_library():
    """One gross error in ten points masks itself in the root mean square: the method as printed
    rejects a good point.
    """
    points, truth, inliers = pcl_sphere()
    fit = analysis.fit_sphere(points, "igg3_wtls")
    assert fit.inliers[inliers] and not fit.inliers[:inliers].all()
    assert np.linalg.norm(fit.center - truth[:3]) > 1
