"""The figures of notebook 01 show, and export, what was computed."""

import numpy as np
from matplotlib import pyplot

from studies.figures import simulated_sphere
from studies.ou_liu_2017 import clouds, evidence

from . import exported


def test_the_cloud_is_exported_with_its_gross_errors():
    points = clouds.read_sphere_cloud(gross=True)
    simulated_sphere.cloud(points)
    data = exported("01_simulated_sphere_cloud")
    np.testing.assert_allclose(data[["x_m", "y_m", "z_m"]], points)
    np.testing.assert_allclose(data["distance_m"], evidence.true_distances(points), atol=1e-9)
    assert data.loc[data["gross"] == 1, "number"].tolist() == list(clouds.GROSS_POINTS)


def test_the_cloud_is_drawn_with_its_gross_errors_numbered():
    points = clouds.read_sphere_cloud(gross=True)
    simulated_sphere.cloud(points)
    data = exported("01_simulated_sphere_cloud")
    right, space = pyplot.gcf().axes
    good, gross = (collection.get_offsets() for collection in right.collections)
    np.testing.assert_allclose(gross, data.loc[data["gross"] == 1, ["number", "distance_m"]])
    assert len(good) == 495
    for axes in (right, space):
        assert {text.get_text().strip() for text in axes.texts} >= {
            str(number) for number in clouds.GROSS_POINTS
        }


def test_the_noise_is_drawn_and_exported():
    histogram = evidence.distance_histogram(clouds.read_sphere_cloud(gross=False))
    simulated_sphere.noise(histogram)
    (axes,) = pyplot.gcf().axes
    assert [bar.get_height() for bar in axes.patches] == histogram["count"].tolist()
    np.testing.assert_allclose(axes.lines[0].get_ydata(), histogram["expected"])
    np.testing.assert_allclose(exported("01_simulated_sphere_noise"), histogram, atol=1e-9)
