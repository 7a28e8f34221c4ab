"""Points found and lost are counted, and a removed deformation is seen."""

import numpy as np
import pytest

from analysis.tunnel.filter import INSIDE, LINING, FilteredLining
from studies.li_2015 import filter_accuracy
from studies.li_2015.epoch_cloud import EpochCloud
from studies.simulation.tunnel import CODES, ZONE

from . import TUNNEL


def perfect_cloud(epoch, n, seed):
    """Lining points of the zone without noise, and a few cables."""
    generator = np.random.default_rng(seed)
    chainage, alpha = generator.uniform(*ZONE, n), generator.uniform(-2.2, 2.2, n)
    codes = np.where(np.arange(n) % 10, CODES["lining"], CODES["cable"])
    rho = TUNNEL.true_radius(alpha, chainage, epoch) - 0.1 * (codes == CODES["cable"])
    return EpochCloud(
        TUNNEL.alignment.polar_points(chainage, alpha, rho), codes, np.zeros(n, dtype=int)
    )


def flagged(flags):
    nothing = np.full(len(flags), np.nan)
    return FilteredLining(flags, nothing, nothing, np.zeros(len(flags), dtype=int), ())


@pytest.fixture(scope="module")
def perfect():
    return tuple(perfect_cloud(epoch, 60_000, epoch) for epoch in (1, 2))


def test_effects_count_what_is_found_and_lost(perfect):
    right = [
        flagged(np.where(cloud.of("cable"), INSIDE, LINING).astype(np.int8)) for cloud in perfect
    ]
    blind = [flagged(np.zeros(len(cloud), dtype=np.int8)) for cloud in perfect]
    table = filter_accuracy.effects(perfect, {"right": right, "blind": blind}, TUNNEL).set_index(
        ["rule", "epoch"]
    )
    assert table.loc[("right", 1), ["found_percent", "lost_percent"]].tolist() == [100, 0]
    assert table.loc[("blind", 2), ["found_percent", "lost_percent"]].tolist() == [0, 0]
    assert table.loc[("right", 2), "kept_of_all_percent"] == pytest.approx(90)
    assert table.loc[("right", 1), "attachments"] == 6000


def test_cells_show_the_deformation_that_a_filter_takes_off(perfect):
    right, eaten, emptied = [], [], []
    for cloud in perfect:
        good = cloud.of("lining")
        chainage, u, v = TUNNEL.alignment.section_coordinates(cloud.points)
        alpha = np.arctan2(u, v)
        crown = (np.abs(alpha) < 0.3) & (np.abs(chainage - 65) < 3)
        inner = crown & (np.hypot(u, v) < np.median(np.hypot(u, v)[crown & good]))
        for kept, results in ((good, right), (good & ~inner, eaten), (good & ~crown, emptied)):
            results.append(flagged(np.where(kept, LINING, INSIDE).astype(np.int8)))
    rules = {"right": right, "eaten": [right[0], eaten[1]], "emptied": [right[0], emptied[1]]}
    table = filter_accuracy.cells(perfect, rules, TUNNEL)
    of = dict(iter(table.groupby("rule")))
    assert of["right"]["change_mm"].abs().max() == 0 and of["right"]["kept_percent"].min() == 100
    # Means of two clouds differ from the mean of the difference by the lining's own steps, which
    # points sample.
    assert np.abs(of["right"]["before_mm"] - of["right"]["true_mm"]).max() < 1.5
    assert of["eaten"]["change_mm"].max() > 0.2 and of["eaten"]["kept_percent"].min() < 80
    summary = filter_accuracy.summary(table).set_index("rule")
    assert summary.loc["right", "emptied"] == 0 < summary.loc["emptied", "emptied"]
    assert summary.loc["eaten", "largest_change_mm"] == of["eaten"]["change_mm"].abs().max()
