"""The clouds are those of the papers: the sphere, the range, the rounding, the gross errors; the
plane, the noise, the runs.
"""

import numpy as np
import pytest

from analysis.export import tables
from studies.ou_liu_2017 import clouds
from studies.ou_liu_2017.clouds import GROSS_POINTS, SPHERE_CENTER, SPHERE_RADIUS
from studies.paths import output
from studies.wu_chen_wang import clouds as clouds_module

ROWS = np.array(GROSS_POINTS) - 1


def heights(points):
    """Signed distances from the true sphere, m."""
    return np.linalg.norm(points - SPHERE_CENTER, axis=-1) - SPHERE_RADIUS


def test_the_sphere_is_that_of_equation_19():
    assert SPHERE_CENTER == (10, 10, 1)
    assert SPHERE_RADIUS**2 == pytest.approx(200)
    assert GROSS_POINTS == (12, 15, 53, 67, 465)


def test_points_lie_on_the_upper_cap_above_the_square(clean):
    assert clean.shape == (300, 500, 3)
    assert clean[..., :2].min() == 0.0 and clean[..., :2].max() == 20.0
    assert clean[..., 2].min() >= 1.0
    plan = clean[..., :2].reshape(-1, 2)
    # Uniform in plan: mean 10, variance 20²/12, x and y independent; 150 000 points.
    np.testing.assert_allclose(plan.mean(axis=0), 10.0, atol=0.06)
    np.testing.assert_allclose(np.cov(plan.T), np.eye(2) * 400 / 12, atol=0.4)


def test_without_rounding_the_points_are_on_the_sphere():
    exact = clouds.sphere_cloud(np.random.default_rng(1), decimals=13)
    np.testing.assert_allclose(heights(exact), 0.0, atol=1e-11)


def test_rounding_is_the_only_noise(clean):
    # Uniform ± 5 mm in every coordinate is 0.01 m / √12 = 2.887 mm in the radial direction.
    assert np.sqrt(np.mean(heights(clean) ** 2)) == pytest.approx(0.01 / np.sqrt(12), rel=0.005)
    assert np.abs(heights(clean)).max() <= 0.005 * np.sqrt(3) + 1e-12
    np.testing.assert_array_equal(clean, np.round(clean, 2))


def test_the_first_points_stay_when_the_cloud_grows():
    few = clouds.sphere_cloud(np.random.default_rng(3), n=20)
    many = clouds.sphere_cloud(np.random.default_rng(3), n=50)
    np.testing.assert_array_equal(few, many[:20])


def test_trials_differ_and_stay_when_their_number_grows(clean, gross):
    np.testing.assert_array_equal(clouds.sphere_redraws(7), clean[:7])
    np.testing.assert_array_equal(clouds.sphere_redraws(7, gross=True), gross[:7])
    assert len(np.unique(clean[:, 0, 0])) > 250
    assert not np.any(clouds.sphere_redraws(1, seed=clouds.SEED + 1)[0] == clean[0], 0).all()


def test_a_trial_is_the_single_cloud_of_its_generator(clean):
    child = np.random.SeedSequence(clouds.SEED).spawn(5)[4]
    generator = np.random.default_rng(child)
    cloud = clouds.sphere_cloud(generator)
    np.testing.assert_array_equal(cloud, clean[4])


def test_gross_redraws_share_the_clean_points(clean, gross):
    moved = np.any(gross != clean, axis=-1)
    assert np.all(moved[:, ROWS])
    assert moved.sum() == 300 * 5


def test_gross_points_are_moved_inside_along_the_radius(clean, gross):
    step = gross[:, ROWS] - clean[:, ROWS]
    inward = SPHERE_CENTER - clean[:, ROWS]
    inward /= np.linalg.norm(inward, axis=-1, keepdims=True)
    depth = np.sum(step * inward, axis=-1)
    rounding = 0.005 * np.sqrt(3)
    assert depth.min() >= 1.5 - rounding and depth.max() <= 2.6 + rounding
    assert depth.min() < 1.52 and depth.max() > 2.58  # the whole range is used
    assert depth.mean() == pytest.approx(2.05, abs=0.03)  # 1500 depths of sd 0.32
    aside = np.linalg.norm(step - depth[..., None] * inward, axis=-1)
    assert aside.max() <= rounding
    np.testing.assert_array_equal(gross, np.round(gross, 2))


def test_the_committed_clouds_are_regenerated(tmp_path, monkeypatch, clean, gross):
    monkeypatch.setenv("ANALYSIS_OUTPUT", str(tmp_path))
    written = clouds.write_sphere_clouds()
    assert written == [output(path) for path in clouds.SPHERE_FILES.values()]
    for new, committed in zip(written, clouds.SPHERE_FILES.values(), strict=True):
        assert tmp_path in new.parents
        # Rounding hides the last bits of √, so the text itself is the same on every processor.
        assert new.read_text() == committed.read_text()
    np.testing.assert_array_equal(clouds.read_sphere_cloud(gross=False), clean[0])
    np.testing.assert_array_equal(clouds.read_sphere_cloud(gross=True), gross[0])


@pytest.mark.parametrize(("gross", "marked"), [(False, []), (True, list(GROSS_POINTS))])
def test_the_committed_files_number_the_points_and_mark_the_gross_errors(gross, marked):
    frame = tables.read(clouds.SPHERE_FILES[gross])
    assert frame["number"].tolist() == list(range(1, 501))
    assert frame.loc[frame["gross"] == 1, "number"].tolist() == marked
    assert set(frame["gross"]) <= {0, 1}
    inside = heights(frame[["x_m", "y_m", "z_m"]].to_numpy()) < -1.0
    assert (np.flatnonzero(inside) + 1).tolist() == marked


# --------------------------------------------------------------------------------------------- the
# plane


@pytest.fixture(scope="module")
def plane_trials():
    """Points (400, 100, 3) and cosines (400, 100) at the recovered setting."""
    return clouds_module.plane_clouds(clouds_module.plane_draws(400))


def test_the_plane_is_that_of_section_3():
    assert clouds_module.PLANE == (1, 3, 1)
    assert (clouds_module.PLANE_POINTS, clouds_module.PLANE_RUNS) == (100, 10)
    assert clouds_module.PLANE_SIGMA**2 == pytest.approx(0.0005)


def test_without_noise_the_points_are_on_the_plane_and_the_patch():
    points, _ = clouds_module.plane_clouds(clouds_module.plane_draws(50), sigma=1e-12)
    x, y, z = np.moveaxis(points, -1, 0)
    np.testing.assert_allclose(z, x + 3 * y + 1, atol=3e-6)
    assert (
        x.min() >= 0
        and x.max() <= clouds_module.PLANE_SIDE
        and y.min() >= 0
        and y.max() <= clouds_module.PLANE_SIDE
    )
    np.testing.assert_allclose([x.mean(), y.mean()], 0.1, atol=0.003)


def test_the_noise_is_isotropic_with_variance_over_the_cosine(plane_trials):
    points, cosines = plane_trials
    exact, same = clouds_module.plane_clouds(clouds_module.plane_draws(400), sigma=1e-12)
    np.testing.assert_array_equal(cosines, same)  # they are those of the points without noise
    ranges = np.linalg.norm(exact, axis=-1)
    np.testing.assert_allclose(cosines, 1 / np.sqrt(11) / ranges, rtol=1e-5)
    scaled = (points - exact) * np.sqrt(cosines)[..., None] / clouds_module.PLANE_SIGMA
    np.testing.assert_allclose(np.cov(scaled.reshape(-1, 3).T), np.eye(3), atol=0.02)


def test_layouts_have_the_same_spread_about_their_centres():
    draws = clouds_module.plane_draws(200)
    for name, centre in zip(clouds_module.PLANE_LAYOUTS, (0.5, 0.0, 0.0, 0.5), strict=True):
        points, _ = clouds_module.plane_clouds(draws, side=1.0, sigma=1e-12, layout=name)
        plan = points[..., :2].reshape(-1, 2)
        np.testing.assert_allclose(plan.mean(axis=0), centre, atol=0.01)
        np.testing.assert_allclose(plan.std(axis=0), 12**-0.5, rtol=0.02)


def test_plane_trials_stay_when_their_number_grows(plane_trials):
    few, _ = clouds_module.plane_clouds(clouds_module.plane_draws(3))
    np.testing.assert_array_equal(few, plane_trials[0][:3])
    other, _ = clouds_module.plane_clouds(
        clouds_module.plane_draws(3, seed=clouds_module.PLANE_SEED + 1)
    )
    assert not np.any(other == few)


def test_the_committed_runs_are_regenerated(tmp_path, monkeypatch, plane_trials):
    monkeypatch.setenv("ANALYSIS_OUTPUT", str(tmp_path))
    written = clouds_module.write_plane_runs()
    assert written == output(clouds_module.PLANE_FILE) and tmp_path in written.parents
    assert written.read_text() == clouds_module.PLANE_FILE.read_text()
    np.testing.assert_array_equal(clouds_module.read_plane_runs(), plane_trials[0][:10])
    frame = tables.read(clouds_module.PLANE_FILE)
    assert frame["run"].tolist() == np.repeat(np.arange(1, 11), 100).tolist()
    assert frame["number"].tolist() == list(range(1, 101)) * 10
