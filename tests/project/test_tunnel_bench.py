"""The tunnel's benchmark on campaigns of a few thousand points. Speed itself is no test: it is read
from ``make bench``.
"""

import numpy as np
import pandas as pd
import pytest

from project import bench, tunnel_bench
from studies.li_2015 import epoch_cloud, register_campaign
from studies.simulation.tunnel import default_tunnel, simulate_campaign, survey

BEAMS = 10_000


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("stations")
    tunnel_bench.scan_all(folder, BEAMS)
    return folder


def test_stations_are_those_of_the_campaign(folder):
    whole = simulate_campaign(BEAMS / 10)
    for place, epoch in enumerate(survey(default_tunnel())):
        scanned = whole.epochs[place]
        expected = epoch_cloud.join_scans(scanned, register_campaign.register(scanned)).points
        # Single precision leaves half a unit in the 24th binary place of a coordinate below 128 m.
        np.testing.assert_allclose(tunnel_bench.joined(epoch, folder), expected, rtol=0, atol=2e-5)


def test_a_campaign_is_measured(folder):
    found = tunnel_bench.fresh(tunnel_bench.measured, folder)
    assert found["points"] == pytest.approx(BEAMS, rel=0.05)
    assert found["sections"] == 0  # too few points for an ellipse in 50 mm
    assert found["wall, s"] > 0 and found["CPU, s"] > 0
    assert 0.1 < found["peak, GB"] < 0.5  # Python and its libraries


def test_growing_campaigns(monkeypatch):
    """Time as n², memory as √n."""
    scanned = []
    monkeypatch.setattr(tunnel_bench, "scan_all", lambda folder, beams: scanned.append(beams))
    monkeypatch.setattr(
        tunnel_bench,
        "fresh",
        lambda *_: {
            "points": int(scanned[-1]),
            "CPU, s": scanned[-1] ** 2,
            "peak, GB": scanned[-1] ** 0.5,
        },
    )
    table = tunnel_bench.growing((0.01, 0.02, 0.1))
    assert scanned == pytest.approx([1e4, 2e4, 1e5])
    assert table["campaign"].tolist() == ["0.01 million", "0.02 million", "0.1 million"]
    np.testing.assert_allclose(table["exponent of time"], [np.nan, 2.0, 2.0], rtol=1e-3)
    np.testing.assert_allclose(table["exponent of memory"], [np.nan, 0.5, 0.5], rtol=1e-3)


def test_memory_is_that_of_the_process_alone():
    held = np.ones(100_000_000)
    found = tunnel_bench.fresh(_peak_with, 30_000_000)
    assert 0.24 < found < 0.24 + 0.3 < 1e-9 * held.nbytes


def _peak_with(count):
    np.ones(count)
    return tunnel_bench.peak()


def test_verdicts():
    row = {"wall, s": 500.0, "peak, GB": 3.0, "exponent of time": 0.9, "exponent of memory": 0.9}
    table = pd.DataFrame([{"campaign": "1.4 million"} | row, {"campaign": "45 million"} | row])
    table.loc[0, "exponent of time"] = np.nan  # of the smallest
    assert bench.with_verdicts(table, tunnel_bench.LIMITS)["verdict"].tolist() == ["ok", "ok"]
    for name, value in (
        ("wall, s", 601.0),
        ("peak, GB", 8.1),
        ("exponent of time", 1.2),
        ("exponent of memory", 1.2),
    ):
        verdicts = bench.with_verdicts(table.assign(**{name: value}), tunnel_bench.LIMITS)[
            "verdict"
        ]
        assert verdicts[1] == "short"


def test_command(monkeypatch, tmp_path, capsys):
    rows = [
        ("0.45 million", 450_000, 1, 8.0, 7.0, 0.27, 4.0, np.nan, np.nan),
        ("1.4 million", 1_400_000, 3, 11.0, 10.0, 0.33, 8.0, 0.3, 0.2),
    ]
    columns = ["campaign", "points", "sections", *tunnel_bench.DECIMALS]
    asked = []
    monkeypatch.setattr(
        tunnel_bench,
        "growing",
        lambda sizes: asked.extend(sizes) or pd.DataFrame(rows, columns=columns),
    )
    monkeypatch.setenv("ANALYSIS_OUTPUT", str(tmp_path))
    assert tunnel_bench.main(["--largest", "1.4"]) == 0
    assert asked == [0.45, 1.4]
    printed = capsys.readouterr().out
    assert "Limits" in printed and printed.count("  ok\n") == 2
    assert {path.name for path in (tmp_path / "build" / "bench").iterdir()} == {
        "tunnel.png",
        "tunnel.svg",
        "tunnel.csv",
    }
