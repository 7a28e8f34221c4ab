"""The figures of notebook 03 show what is exported, and that is what the studies returned."""

import numpy as np
import pytest
from matplotlib import pyplot
from scipy.special import ndtri

from analysis import SPHERE_METHODS, fit_sphere
from studies.figures import sphere_tables as figures
from studies.montecarlo import printed_quantities, sphere_study
from studies.ou_liu_2017 import clouds as simulate
from studies.ou_liu_2017.clouds import GROSS_POINTS, SPHERE_CENTER, SPHERE_RADIUS
from studies.ou_liu_2017.comparison import comparison_table
from studies.printed.comparison import OUTSIDE

from . import exported

ROWS = np.array(GROSS_POINTS) - 1


@pytest.fixture(scope="module")
def clouds():
    return {table: simulate.read_sphere_cloud(gross=table == 2) for table in (1, 2)}


@pytest.fixture(scope="module")
def studies():
    variants = {method.label: {"method": name} for name, method in SPHERE_METHODS.items()}
    truth = [*SPHERE_CENTER, SPHERE_RADIUS]
    points = {table: simulate.sphere_redraws(30, gross=table == 2) for table in (1, 2)}
    return {table: sphere_study(points[table], truth, variants, workers=1) for table in points}


def test_every_method_has_its_marker():
    assert list(figures.MARKERS) == list(SPHERE_METHODS)
    assert len(set(figures.MARKERS.values())) == len(SPHERE_METHODS)


def test_errors(studies):
    figures.errors(studies, {method.label: name for name, method in SPHERE_METHODS.items()})
    data = exported("03_sphere_tables_errors")
    assert len(data) == 2 * 4 * len(SPHERE_METHODS)
    line = data[(data["table"] == 2) & (data["parameter"] == "c") & (data["method"] == "tls")].iloc[
        0
    ]
    size = 1e3 * studies[2][SPHERE_METHODS["tls"].label]["delta_c_m"].abs()
    np.testing.assert_allclose(
        line[["q025_mm", "q25_mm", "q50_mm", "q75_mm", "q975_mm"]].astype(float),
        size.quantile(figures.QUANTILES),
    )
    assert line["printed_mm"] == pytest.approx(11151.1)
    assert data.loc[data["method"] == "mixed_ls_tls", "printed_mm"].isna().all()
    axes = np.reshape(pyplot.gcf().axes, (4, 2))
    shown = data[(data["table"] == 1) & (data["parameter"] == "b")]
    medians = [
        drawn.get_xdata()[0]
        for drawn in axes[1, 0].lines
        if drawn.get_marker() in figures.MARKERS.values()
    ]
    np.testing.assert_allclose(medians, shown["q50_mm"])


def test_printed_errors_stand_beside_the_default_only(studies):
    label = SPHERE_METHODS["igg3_wtls"].label
    both = {
        table: {label: study[label], "another reading": study[label]}
        for table, study in studies.items()
    }
    figures.errors(both, {label: "igg3_wtls", "another reading": "igg3_wtls"})
    data = exported("03_sphere_tables_errors")
    assert data.groupby("variant")["printed_mm"].count().to_dict() == {
        label: 8,
        "another reading": 0,
    }


def test_positions(studies):
    comparisons = []
    for table, study in studies.items():
        redraws = printed_quantities(
            {name: study[method.label] for name, method in SPHERE_METHODS.items()}
        )
        comparisons.append(
            comparison_table(table, {key: values[0] for key, values in redraws.items()}, redraws)
        )
    figures.positions(comparisons)
    data = exported("03_sphere_tables_positions")
    assert len(data) == 36
    for ax, frame in zip(pyplot.gcf().axes, comparisons, strict=True):
        points = [line for line in ax.lines if line.get_marker() in figures.MARKERS.values()]
        inner = frame["percentile"].between(0.01, 99.99).to_numpy()
        drawn = np.array([line.get_xdata()[0] for line in points])
        np.testing.assert_allclose(drawn[inner], ndtri(frame["percentile"] / 100)[inner])
        hollow = [line.get_markerfacecolor() == "white" for line in points]
        assert hollow == (frame["verdict"] == OUTSIDE).tolist()


def test_maps(clouds):
    fits = {
        "ls gross": fit_sphere(clouds[2], "ls"),
        "igg gross": fit_sphere(clouds[2], "igg3_wtls"),
        "igg clean": fit_sphere(clouds[1], "igg3_wtls"),
    }
    figures.maps(clouds[1], clouds[2], fits)
    data = exported("03_sphere_tables_maps")
    panels = [panel for _, panel in data.groupby("panel", sort=False)]
    values = [
        1e3 * fits["ls gross"].distances,
        1e3 * fits["igg gross"].distances,
        fits["igg gross"].weights,
        fits["igg clean"].weights,
    ]
    for panel, points, value in zip(panels, [clouds[2]] * 3 + [clouds[1]], values, strict=True):
        np.testing.assert_array_equal(panel[["x_m", "y_m"]], points[:, :2])
        np.testing.assert_allclose(panel["value"], value)
    for ax in pyplot.gcf().axes[:4]:
        drawn = {tuple(place) for marks in ax.collections for place in marks.get_offsets().tolist()}
        assert (
            len(drawn) == len({tuple(place) for place in clouds[2][:, :2].tolist()})
            or ax is pyplot.gcf().axes[3]
        )
    assert "5 lost" in panels[2]["panel"].iloc[0]


def test_weights(clouds):
    fit = fit_sphere(clouds[2], "igg3_wtls", history=True)
    depths = np.array([2.5, 0.012, 2, 2, 2])
    figures.weights({"one": (depths, fit), "two": (depths, fit)})
    data = exported("03_sphere_tables_weights")
    found = (
        data[data["case"] == "two"]
        .pivot(index="iteration", columns="number", values="weight")
        .to_numpy()
    )
    np.testing.assert_allclose(found, [step.weights[ROWS] for step in fit.history[:10]])
    assert (found[0] == 1).all() and (found[1:] == 0).all()
    labels = [text.get_text() for text in pyplot.gcf().axes[0].get_legend().get_texts()]
    assert labels[:2] == ["12: 2.5 m", "15: 12 mm"]
