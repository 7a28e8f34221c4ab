"""The figures of a tunnel show what is exported, and that is what the comparison says."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from matplotlib import pyplot
from matplotlib.collections import QuadMesh

from analysis.export import tunnel_figures as figures
from analysis.export.figures import into
from analysis.tunnel.axis import straight
from analysis.tunnel.comparison import compare
from analysis.tunnel.significance import CLASSES


@pytest.fixture(scope="module")
def comparison():
    """The second section 15 mm oval, the third unseen in the second epoch."""
    epochs = []
    for seed, ovalised in ((1, 0.0), (2, 0.015)):
        rng = np.random.default_rng(seed)
        alpha, y = rng.uniform(-2.5, 2.5, 6_000), rng.uniform(0.0, 5.6, 6_000)
        rho = (
            2.0
            + 0.002 * rng.standard_normal(6_000)
            - ovalised * np.cos(2 * alpha) * np.exp(-((y - 3.0) ** 2))
        )
        epochs.append(
            np.column_stack([rho * np.sin(alpha), y, rho * np.cos(alpha)])[
                ~((seed == 2) & (y > 5.0))
            ]
        )
    return compare(
        *epochs,
        axis=straight([0.0, 0.0, 0.0], [0.0, 5.6, 0.0]),
        chainages=[0.5, 3.0, 5.4],
        thickness=0.3,
    )


class Published(dict):
    """Tables handed to `publish`: stem -> table."""

    def __call__(self, figure, stem, data):
        self[stem] = data


@pytest.fixture
def publish():
    yield Published()
    pyplot.close("all")


def test_every_class_has_its_look():
    for looks in (figures.CLASS_COLOURS, figures.CLASS_MARKS, figures.CLASS_NAMES):
        assert tuple(looks) == CLASSES


def assert_exported(found, expected):
    pd.testing.assert_frame_equal(
        found.reset_index(drop=True), expected.reset_index(drop=True), rtol=1e-8, check_dtype=False
    )


def test_changes(comparison, publish):
    figures.changes(comparison, "changes", publish=publish)
    data = comparison.by_direction()
    assert_exported(publish["changes"], data)
    above, below, _ = pyplot.gcf().axes
    classes = [mesh for mesh in above.collections if isinstance(mesh, QuadMesh)]
    meshes = [mesh for mesh in below.collections if isinstance(mesh, QuadMesh)]
    seen, changes = meshes[::2], meshes[1::2]
    for (chainage, rows), shown, grey, change in zip(
        data.groupby("chainage_m"), classes, seen, changes, strict=True
    ):
        names = np.append(list(CLASSES), "gap")
        numbers = shown.get_array().ravel().filled(len(CLASSES)).astype(int)
        assert names[numbers].tolist() == rows["class"].tolist()
        corners = shown.get_coordinates()
        assert corners[..., 0].min() < chainage < corners[..., 0].max()
        np.testing.assert_allclose(corners[:-1, 0, 1] + 0.5, rows["angle_deg"])
        np.testing.assert_allclose(
            change.get_array().ravel().filled(np.nan),
            rows["difference_mm"].where(rows["significant"]),
        )
        assert (
            ~np.ma.getmaskarray(grey.get_array()).ravel() == rows["difference_mm"].notna()
        ).all()
    assert classes[0].get_cmap()(classes[0].norm(2))[0] > 0.8  # red is red


def test_a_section(comparison, publish):
    compared = comparison.sections[1]
    angles = np.radians([-180.0, 0.0, 180.0])
    figures.section(
        compared, "section", truth=(angles, np.array([0.0, 0.018, 0.0])), publish=publish
    )
    data = compared.by_direction()
    truth = 18.0 * (1.0 - data["angle_deg"].abs() / 180.0)
    assert_exported(publish["section"], data.assign(truth_mm=truth))
    left, right = pyplot.gcf().axes
    curves = {line.get_label(): line for line in right.lines}
    np.testing.assert_allclose(
        curves["difference of the ellipses"].get_ydata(), data["ellipse_difference_mm"]
    )
    np.testing.assert_allclose(curves["true"].get_ydata(), truth)
    for name, text in figures.CLASS_NAMES.items():
        rows = data[data["class"] == name]
        assert curves[f"measured, {text}"].get_ydata().tolist() == rows["difference_mm"].tolist()
        assert curves[f"measured, {text}"].get_color() == figures.CLASS_COLOURS[name]
    (band,) = right.collections
    half = np.ptp(band.get_paths()[0].vertices[:, 1])
    assert half > 2 * 1.95 * data["ellipse_sd_mm"].min()
    # The second outline is the first one moved by the change, so many times larger.
    times = float(left.get_title(loc="left").split()[2])
    first, second = (np.hypot(*line.get_data()) for line in left.lines[:2])
    np.testing.assert_allclose(
        second - first, 1e-3 * times * data["ellipse_difference_mm"], atol=1e-9
    )
    assert 0.05 < np.abs(second / first - 1).max() < 0.25


def test_a_section_that_was_not_seen_is_drawn_empty(comparison, publish):
    figures.section(comparison.sections[2], "unseen", publish=publish)
    assert publish["unseen"]["ellipse_difference_mm"].isna().all()


def test_along(comparison, publish):
    truth = pd.DataFrame(
        {
            "chainage_m": [0.0, 5.6],
            "crown_settlement_mm": [1.0, 2.0],
            "horizontal_convergence_mm": [3.0, 4.0],
        }
    )
    figures.along(comparison, "along", truth=truth, publish=publish)
    data = publish["along"]
    table = comparison.table()
    measured = data[data["kind"] == "measured"]
    for name in (
        "chainage_m",
        "crown_settlement_mm",
        "crown_settlement_sd_mm",
        "horizontal_convergence_mm",
    ):
        np.testing.assert_allclose(measured[name], table[name], rtol=1e-8)
    (ax,) = pyplot.gcf().axes
    for bars, name in zip(ax.containers, figures.QUANTITIES, strict=True):
        np.testing.assert_allclose(bars.lines[0].get_ydata().astype(float), table[f"{name}_mm"])
        low, high = (line.get_ydata().astype(float) for line in bars.lines[1])
        np.testing.assert_allclose(high - low, 2 * 1.96 * table[f"{name}_sd_mm"])
    unseen = [line for line in ax.lines if line.get_label() == "too little seen"]
    assert unseen[0].get_xdata().tolist() == [5.4]
    lines = {line.get_label(): list(line.get_ydata()) for line in ax.lines}
    assert lines["crown settlement, true"] == [1.0, 2.0] and lines[
        "horizontal convergence, true"
    ] == [3.0, 4.0]


def test_into_a_folder(comparison, tmp_path):
    one = replace(comparison, sections=comparison.sections[:1])
    figures.changes(one, "changes", publish=into(tmp_path))
    assert {path.name for path in tmp_path.iterdir()} == {
        "changes.png",
        "changes.svg",
        "changes.csv",
    }
    assert not pyplot.get_fignums()


@pytest.mark.parametrize(
    "value, expected",
    [(0.3, 1), (1.0, 1), (1.9, 1), (2.1, 2), (5.0, 5), (37.0, 20), (99.0, 50), (100.0, 100)],
)
def test_round_numbers(value, expected):
    assert figures._round_number(value) == expected
