"""The study of the real scans, on made-up scans: half a sphere about a reference centre, and a
surface beside it.
"""

import numpy as np
import pandas as pd
import pytest

from analysis import SPHERE_METHODS, fit_sphere
from studies.ou_liu_2017 import real_spheres
from studies.ou_liu_2017.real_spheres import NOMINAL_RADIUS, REFERENCE_CENTERS, WHOLE

SCAN = "SPH103"
CENTER = np.array(REFERENCE_CENTERS[SCAN])
HALF_WIDTH = 0.003
SCALES = ("rms", "rms_in", "unit")


def half_sphere(n, noise, rng):
    """Points on the side of the sphere that the scanner in the origin sees."""
    directions = rng.standard_normal((n, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    directions *= np.where(directions @ CENTER > 0, -1.0, 1.0)[:, None]
    return CENTER + (NOMINAL_RADIUS + noise * rng.standard_normal(n))[:, None] * directions


def store(folder, points):
    np.savetxt(folder / f"{SCAN}.xyz", points, fmt="%.6f", delimiter="\t")


@pytest.fixture
def scans(tmp_path, monkeypatch):
    """Folder with a scan of 600 points on the sphere and 400 on a surface 10 to 40 mm outside of
    it.
    """
    rng = np.random.default_rng(4)
    away = CENTER / np.linalg.norm(CENTER)
    beside = np.cross(away, [0, 0, 1.0])
    across, up, back = (
        rng.uniform(0.07, 0.085, 400),
        rng.uniform(-0.03, 0.03, 400),
        rng.uniform(0.0, 0.01, 400),
    )
    surface = CENTER + across[:, None] * beside + up[:, None] * [0, 0, 1.0] + back[:, None] * away
    store(tmp_path, np.concatenate([half_sphere(600, 1e-4, rng), surface]))
    monkeypatch.setattr(real_spheres, "SCANS", tmp_path)
    return tmp_path


def test_a_missing_scan_names_the_command_that_fetches_it(tmp_path, monkeypatch):
    monkeypatch.setattr(real_spheres, "SCANS", tmp_path)
    with pytest.raises(
        FileNotFoundError,
        match=r"SPH103.xyz is not in data/scans: `make scans` fetches the real scans\.",
    ):
        real_spheres.methods([SCAN])


def test_a_scan_without_reference_is_refused(scans):
    with pytest.raises(ValueError, match="expected one of SPH101, .*got 'SPH104'"):
        real_spheres.read("SPH104")


def test_contents_counts_what_is_on_the_sphere(scans):
    row = real_spheres.contents([SCAN], HALF_WIDTH).iloc[0]
    assert (row["points"], row["on_sphere"]) == (1000, 600)
    assert row["off_sphere_percent"] == pytest.approx(40)
    assert row["inside_percent"] == 0
    assert row["rms_on_mm"] == pytest.approx(0.1, rel=0.1)
    assert row["range_m"] == pytest.approx(np.linalg.norm(CENTER))


def test_on_a_cut_scan_every_method_finds_the_reference(scans):
    table = real_spheres.methods([SCAN], [WHOLE, HALF_WIDTH])
    assert list(table["method"]) == 2 * list(SPHERE_METHODS)
    cut = table[table["half_width_mm"] == 1e3 * HALF_WIDTH]
    assert (cut["points"] == 600).all() and cut["converged"].all()
    assert (cut["center_error_mm"] < 0.05).all() and (cut["radius_error_mm"].abs() < 0.05).all()
    whole = table[table["half_width_mm"] == WHOLE].set_index("method")
    assert whole["center_error_mm"]["ls"] > 5


def test_a_row_is_what_the_fit_returns(scans):
    row = real_spheres.methods([SCAN]).set_index("method").loc["ls"]
    fit = fit_sphere(real_spheres.read(SCAN), "ls")
    assert row[["x_m", "y_m", "z_m", "r_m"]].tolist() == fit.parameters.tolist()
    assert row["center_error_mm"] == pytest.approx(1e3 * np.linalg.norm(fit.center - CENTER))
    assert row["sd_center_mm"] == pytest.approx(1e3 * np.sqrt(np.trace(fit.covariance[:3, :3])))
    assert row["radius_error_mm"] == pytest.approx(1e3 * (fit.radius - NOMINAL_RADIUS))


def test_a_fit_that_did_not_converge_has_no_numbers(scans):
    table = real_spheres.scale_readings([SCAN], SCALES).set_index(["scale", "cumulative"])
    failed = table.loc[("unit", True)]
    assert not failed["converged"] and failed["stop_reason"].startswith("not converged")
    assert failed[["x_m", "sd_r_mm", "sigma_s_mm", "center_error_mm", "iterations"]].isna().all()
    assert table.loc[("rms", True), "converged"] and table.loc[("rms", True), "center_error_mm"] > 5


def test_masking_a_root_mean_square_cannot_reject_more_than_its_bound(scans):
    row = real_spheres.masking([SCAN], HALF_WIDTH, 1.5, 2.5).iloc[0]
    # Of all points no more than 1/k1² lie beyond k1·rms; 40 % are off the sphere.
    assert row["reference_beyond_percent"] <= 100 / 2.5**2 / 0.4
    d = real_spheres.reference_distances(real_spheres.read(SCAN), SCAN)
    assert row["reference_k1_sigma_mm"] == pytest.approx(2.5e3 * np.sqrt(np.mean(d**2)))


def test_ranges(scans):
    ranges = real_spheres.ranges(real_spheres.methods([SCAN], [WHOLE, HALF_WIDTH]))
    assert len(ranges) == 2 * len(SPHERE_METHODS)
    assert (ranges["center_error_mm_min"] == ranges["center_error_mm_max"]).all()  # one scan


def test_robust_finds_the_sphere_whole_wherever_it_stands(scans):
    table = real_spheres.robust_fits([SCAN], (5e5, 4e6, 100.0)).set_index(["radius", "offset"])
    assert (table["center_error_mm"] < 0.05).all()
    assert table.loc[("free", "yes"), "center_error_mm"] == pytest.approx(
        table.loc[("free", "no"), "center_error_mm"], abs=1e-5
    )
    assert table.loc[("held", "no"), "radius_error_mm"] == pytest.approx(0, abs=1e-9)


def test_the_summary_is_over_the_scans():
    table = pd.DataFrame(
        {
            "radius": "free",
            "offset": "no",
            "center_error_mm": [0.1, 0.3],
            "radius_error_mm": [-0.2, 0.1],
            "sd_center_mm": [0.1, 0.1],
        }
    )
    row = real_spheres.over_the_scans(table).iloc[0]
    assert (row["center, median"], row["radius, largest"]) == (0.2, 0.2)
    assert row["error/stated"] == pytest.approx(np.sqrt(5.0))


def test_peers_see_the_same_points(scans):
    table = real_spheres.peer_fits([SCAN], 0.0003).set_index("method")
    ls = real_spheres.methods([SCAN]).set_index("method").loc["ls"]
    assert table.loc["scikit-spatial", "center_error_mm"] == pytest.approx(
        ls["center_error_mm"], rel=1e-6
    )
    assert len(table) == 5
    assert table.loc["scipy soft_l1", "center_error_mm"] > 1


def test_by_scan_keeps_the_order_of_the_table(scans):
    table = real_spheres.scale_readings([SCAN], SCALES)
    wide = real_spheres.by_scan(table, ["scale", "cumulative"], "in_use")
    assert list(wide.columns) == ["scale", "cumulative", SCAN]
    assert list(wide["scale"]) == ["rms", "rms", "rms_in", "rms_in", "unit", "unit"]
    assert wide[SCAN].tolist() == table["in_use"].tolist()


def test_the_section_is_a_slice_seen_from_above(scans):
    section = real_spheres.section(SCAN, 0.004, HALF_WIDTH)
    on, off = section[section["on_sphere"]], section[~section["on_sphere"]]
    assert (on["along_mm"] < 1).all()  # the side towards the scanner
    assert (off["across_mm"] < -60).all()  # the surface stands to the right
    assert np.hypot(on["along_mm"], on["across_mm"]).between(49.0, 50.5).all()


def test_a_circle_is_the_fitted_sphere_in_the_plane_of_the_section(scans):
    circle = real_spheres.section_circles(SCAN, WHOLE).set_index("method").loc["ls"]
    fit = fit_sphere(real_spheres.read(SCAN), "ls")
    angle = 1.0
    along, across = (circle[f"{axis}_mm"] / 1e3 for axis in ("along", "across"))
    along, across = (
        along + circle["radius_mm"] / 1e3 * np.cos(angle),
        across + circle["radius_mm"] / 1e3 * np.sin(angle),
    )
    sight = np.array([CENTER[0], CENTER[1], 0]) / np.hypot(*CENTER[:2])
    point = CENTER + along * sight + across * np.array([-sight[1], sight[0], 0])
    assert np.linalg.norm(point - fit.center) == pytest.approx(fit.radius, abs=1e-12)


def test_summary_takes_median_and_largest_without_sign():
    fits = pd.DataFrame(
        {
            "method": ["ls"] * 3,
            "center_error_mm": [1.0, 2.0, 9.0],
            "radius_error_mm": [-5.0, 1.0, 2.0],
        }
    )
    held = pd.DataFrame(
        {
            "radius": ["held", "held", "free"],
            "offset": ["no", "yes", "no"],
            "center_error_mm": [0.1, 7.0, 8.0],
        }
    )
    held["radius_error_mm"] = 0.0
    found = real_spheres.summary(fits, held, fits.assign(method="other")).set_index("method")
    assert found.loc["LS"].tolist() == found.loc["other"].tolist() == [2.0, 9.0, 2.0, 5.0]
    assert found.loc["robust, radius held at 50 mm"].tolist() == [0.1, 0.1, 0.0, 0.0]
