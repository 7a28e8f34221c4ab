"""Registration of stations: named wrong targets, units and axes, the error that a station's points
share, check points.
"""

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from analysis.similarity import fit_similarity
from analysis.tunnel.registration import checks, register_stations, residual_table, station_table

SD = {"scanner_sd": 0.002, "control_sd": 0.001}
PLACES = {
    "T1": (-2.4, 5.0, -0.5),
    "T2": (2.4, 10.0, 1.0),
    "T3": (-2.0, 18.0, 1.8),
    "T4": (2.2, 25.0, -0.8),
    "T5": (-1.0, 31.0, 2.4),
    "T6": (2.4, 38.0, 0.2),
}
ORIGIN = np.array([5000.0, 7000.0, 30.0])
HEADING = Rotation.from_euler("zx", [172, 0.3], degrees=True).as_matrix()
STAND = np.array([0.2, 20.0, -1.2])


def control():
    return pd.DataFrame(np.array([*PLACES.values()]) + ORIGIN, columns=["x", "y", "z"]).assign(
        target=list(PLACES)
    )


def observed(station="S1", seed=0, sd=0.002, scale=1.0):
    """The targets as a scanner at STAND sees them, looking back along the tunnel."""
    true = control()[["x", "y", "z"]].to_numpy() - STAND - ORIGIN
    points = scale * true @ HEADING + sd * np.random.default_rng(seed).standard_normal(true.shape)
    return pd.DataFrame(points, columns=["x", "y", "z"]).assign(
        station=station, target=list(PLACES)
    )


def register(frame, net=None, **options):
    return register_stations(frame, control() if net is None else net, **{**SD, **options})


# ------------------------------------------------------------------ the truth, and what is wrong


def test_stations_find_where_they_stood():
    stations = register(pd.concat([observed("S1", sd=0.0), observed("S2", sd=0.0)]))
    assert list(stations) == ["S1", "S2"]
    for station in stations.values():
        np.testing.assert_allclose(station.similarity.rotation, HEADING, rtol=0, atol=1e-9)
        np.testing.assert_allclose(
            station.similarity.translation, STAND + ORIGIN, rtol=0, atol=1e-8
        )
        assert station.similarity.scale == 1 and station.rejected == ()
    assert checks(stations) == []


def test_good_stations_give_no_cause_for_a_check():
    said = [sentence for seed in range(100) for sentence in checks(register(observed(seed=seed)))]
    # 1 % for the misclosures, 5 % for the scale.
    assert len(said) <= 15 and all("misclosures" in one or "scale" in one for one in said)


def test_a_wrongly_paired_target_is_named():
    frame = observed()
    frame.loc[3, ["x", "y", "z"]] = observed(seed=1).loc[4, ["x", "y", "z"]]
    stations = register(frame)
    assert stations["S1"].rejected == ("T4",)
    (sentence,) = checks(stations)
    assert sentence.startswith("station S1: target T4 does not fit the others, by 7.")
    table = residual_table(stations).set_index("target")
    assert list(table.index[~table["in_use"]]) == ["T4"] and table.loc["T4", "weight"] == 0
    assert table.loc["T4", "d_mm"] > 5000 and table.drop("T4")["d_mm"].max() < 10


def test_residual_table_is_control_less_transformed():
    frame, table = observed(), residual_table(stations := register(observed()))
    expected = control()[["x", "y", "z"]].to_numpy() - stations["S1"].similarity.transform(
        frame[["x", "y", "z"]].to_numpy()
    )
    np.testing.assert_allclose(
        table[["dx_mm", "dy_mm", "dz_mm"]], 1e3 * expected, rtol=0, atol=1e-9
    )
    np.testing.assert_allclose(
        table["d_mm"], 1e3 * np.linalg.norm(expected, axis=1), rtol=0, atol=1e-9
    )


def test_scale_is_tested_and_can_be_estimated():
    frame = observed(scale=1.0 / 1.002)
    held, free = register(frame), register(frame, scale=True)
    (sentence,) = [one for one in checks(held) if "scale" in one]
    assert "differs from 1 by 19" in sentence and "ppm" in sentence
    np.testing.assert_allclose(free["S1"].similarity.scale, 1.002, rtol=0, atol=3e-4)
    table = station_table(held).iloc[0]
    np.testing.assert_allclose(
        table["scale_ppm"], 1e6 * (free["S1"].similarity.scale - 1), rtol=1e-9
    )
    assert table["scale_test"] > 2


def test_larger_errors_than_given_are_said():
    for seed in range(20):
        stations = register(observed(sd=0.02, seed=seed))
        # it is the standard deviations that are wrong, and not the targets
        assert stations["S1"].rejected == ()
        assert any("misclosures are" in sentence for sentence in checks(stations))


def test_misclosures_are_tested_by_their_variance():
    said = [
        checks(register(observed(sd=1.8 * np.hypot(0.002, 0.001), seed=seed))) for seed in range(40)
    ]
    # 0.45; the others have lost a target, which is said, too.
    assert np.mean([any("misclosures" in one for one in sentences) for sentences in said]) > 0.35
    assert np.mean([len(sentences) > 0 for sentences in said]) > 0.6


def test_a_blunder_of_a_kilometre_is_no_other_unit():
    frame = observed()
    frame.loc[1, "x"] += 1000.0
    assert register(frame)["S1"].rejected == ("T2",)


def test_three_targets_are_enough_but_not_to_find_a_wrong_one():
    stations = register(observed().iloc[:3])
    assert "station S1: with three targets a wrong one cannot be found" in checks(stations)


def test_three_targets_have_no_mirror_image():
    for seed in range(10):
        net = pd.DataFrame(
            np.random.default_rng(seed).uniform(-5, 5, (3, 3)), columns=["x", "y", "z"]
        ).assign(target=list("abc"))
        stations = register(net.assign(station="S1"), net)
        np.testing.assert_allclose(
            stations["S1"].similarity.rotation, np.eye(3), rtol=0, atol=1e-12
        )


def test_weak_roll_is_said():
    frame, net = observed(), control()
    keep = frame["target"].isin(["T1", "T3", "T5"])  # all on the left
    said = checks(register(frame[keep], net))
    assert any("near a line" in sentence and "at 2.7 m" in sentence for sentence in said)


def test_a_target_that_is_not_in_the_net_is_left_out():
    stations = register(observed(), control().iloc[:5])
    assert stations["S1"].targets == ("T1", "T2", "T3", "T4", "T5")


# ------------------------------------------------------------------ bad input


def in_millimetres():
    return observed().assign(**1e3 * observed()[["x", "y", "z"]])


def on_a_line():
    return observed().assign(x=1.0, z=2.0)


BAD = {
    "millimetres": (in_millimetres, control, "station S1: .*1000 times those of the control net"),
    "swapped axes": (
        lambda: observed().rename(columns={"x": "y", "y": "x"}),
        control,
        "station S1: .*fit only mirrored.*two axes swapped",
    ),
    "swapped axes of the net": (
        observed,
        lambda: control().rename(columns={"x": "y", "y": "x"}),
        "station S1: .*fit only mirrored",
    ),
    "two targets": (
        lambda: observed().iloc[:2],
        control,
        "station S1: expected at least 3 targets of the control net, got 2",
    ),
    "unknown targets": (
        lambda: observed().assign(target=list("abcdef")),
        control,
        "station S1: expected at least 3 targets .* got 0",
    ),
    "line": (on_a_line, control, "station S1: source: .*points on a line"),
    "missing column": (
        lambda: observed().drop(columns="z"),
        control,
        "observed: expected columns .*; z missing",
    ),
    "missing column of the net": (
        observed,
        lambda: control().drop(columns="target"),
        "control: expected columns .*; target missing",
    ),
    "twice": (
        lambda: pd.concat([observed(), observed().iloc[:1]]),
        control,
        "observed: expected each target once, got S1 T1 twice",
    ),
    "twice in the net": (
        observed,
        lambda: pd.concat([control(), control().iloc[:1]]),
        "control: expected each target once, got T1 twice",
    ),
    "NaN": (lambda: observed().assign(x=np.nan), control, "station S1: expected finite numbers"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_refused_with_the_station_s_name(name):
    frame, net, message = BAD[name]
    with pytest.raises(ValueError, match=message):
        register(frame(), net())


def test_standard_deviations_must_be_positive():
    with pytest.raises(ValueError, match="scanner_sd: expected a positive"):
        register(observed(), scanner_sd=0.0)


# ------------------------------------------------------------------ the error its points share


def test_error_in_a_section_is_that_of_redrawn_targets_and_does_not_average_out():
    trials = 6000
    draw = np.random.default_rng(5)
    net = control()[["x", "y", "z"]].to_numpy() - ORIGIN
    true = (net - STAND) @ HEADING
    x = true + 0.002 * draw.standard_normal((trials, 6, 3))
    X = net + 0.001 * draw.standard_normal((trials, 6, 3))
    fits = fit_similarity(
        x, X, scale=False, source_cofactors=0.002**2, target_cofactors=0.001**2, absolute=True
    )
    angle = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    normals = np.column_stack([np.cos(angle), 0 * angle, np.sin(angle)])
    section = 2.7 * normals + [0, 30, 0]
    seen = (section - STAND) @ HEADING
    shifts = np.einsum("bni,ni->bn", fits.transform(seen) - section, normals)
    similarity = register(observed())["S1"].similarity
    G = np.einsum("ni,nik->nk", normals, similarity.common_errors(seen))
    assert G.shape == (200, 7)
    np.testing.assert_allclose(shifts.std(axis=0), np.linalg.norm(G, axis=1), rtol=0.04)
    # The section moved to the right as a whole, its crown, and its mean radius, which a rigid
    # motion leaves alone.
    for a in (2 * np.cos(angle) / 200, np.eye(200)[50], np.ones(200) / 200):
        np.testing.assert_allclose((shifts @ a).std(), np.linalg.norm(a @ G), rtol=0.04, atol=2e-6)
    right = np.linalg.norm(2 * np.cos(angle) / 200 @ G)
    assert right > 0.9 * np.linalg.norm(G[0])  # 200 points know it no better than one
    assert np.linalg.norm(np.ones(200) / 200 @ G) < 1e-3 * right


def test_station_table_states_what_the_redraws_show():
    sd = np.hypot(0.002, 0.001)
    table = station_table(register(observed(sd=0.0))).iloc[0]
    x = observed(sd=0.0)[["x", "y", "z"]].to_numpy() + sd * np.random.default_rng(
        1
    ).standard_normal((6000, 6, 3))
    X = np.broadcast_to(control()[["x", "y", "z"]].to_numpy(), x.shape)
    turns = (
        Rotation.from_matrix(fit_similarity(x, X, scale=False).rotation @ HEADING.T).as_rotvec()
        * np.degrees(1)
        * 3600
    )
    np.testing.assert_allclose(
        turns.std(axis=0),
        table[["rot_x_arcsec", "rot_y_arcsec", "rot_z_arcsec"]].astype(float),
        rtol=0.03,
    )
    np.testing.assert_allclose(
        table["wall_mm"], 2700 * np.radians(table["roll_arcsec"] / 3600), rtol=1e-12
    )
    assert table["roll_arcsec"] >= table["rot_y_arcsec"] > 3 * table["rot_z_arcsec"]
    assert (table["targets"], table["in_use"]) == (6, 6)
