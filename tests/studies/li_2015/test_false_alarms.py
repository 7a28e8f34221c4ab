"""False alarms of the printed limits follow from the normal law."""

import numpy as np
import pytest

from studies.li_2015.false_alarms import false_alarms


def test_false_alarms_of_the_printed_limits_are_as_theory_says():
    table = false_alarms(draws=40_000, seed=5)
    assert np.all(
        np.abs(table["simulated"] - table["theory"]) <= 4 * table["standard_error"] + 1e-12
    )
    theory = table.set_index(["sigma_mm", "limit_mm"])["theory"]
    assert (100 * theory.xs(6.0, level="limit_mm")).round(1).tolist() == [3.4, 15.7, 39.6]
    assert np.allclose(100 * theory.xs(12.0, level="limit_mm"), [0.0022, 0.47, 9.0], rtol=0.02)


def test_bad_input_is_refused():
    with pytest.raises(ValueError, match="sigmas: expected a positive"):
        false_alarms((0.0,), draws=10)
