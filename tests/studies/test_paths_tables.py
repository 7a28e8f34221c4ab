"""Where files are written, that nothing is lost in writing, and that tables show what they hold."""

import numpy as np
import pandas as pd
import pytest

from analysis.export import tables
from analysis.export.files import replacing
from studies import publish
from studies.paths import RESULTS, ROOT, output


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    """A folder that takes all output."""
    monkeypatch.setenv("ANALYSIS_OUTPUT", str(tmp_path))
    return tmp_path


def test_root_is_the_repository():
    assert (ROOT / "src" / "studies" / "paths.py").is_file()
    assert (ROOT / "pyproject.toml").is_file()


def test_output_keeps_the_relative_place_and_makes_the_folder(elsewhere):
    target = output(RESULTS / "deeper" / "table.csv")
    assert target == elsewhere / "data" / "results" / "deeper" / "table.csv"
    assert target.parent.is_dir()


@pytest.mark.parametrize("value", [None, ""])
def test_output_is_the_path_itself_without_redirection(monkeypatch, value):
    if value is None:
        monkeypatch.delenv("ANALYSIS_OUTPUT", raising=False)
    else:
        monkeypatch.setenv("ANALYSIS_OUTPUT", value)
    assert output(ROOT / "table.csv") == ROOT / "table.csv"


def test_output_takes_a_relative_path_from_the_current_folder(elsewhere, monkeypatch):
    monkeypatch.chdir(ROOT / "tests")
    assert output("../data/table.csv") == elsewhere / "data" / "table.csv"


@pytest.mark.parametrize("path", ["/etc/table.csv", ROOT / ".." / "table.csv", ROOT.parent])
def test_output_refuses_a_path_outside_the_repository(elsewhere, path):
    with pytest.raises(ValueError, match="expected a path below"):
        output(path)
    assert not list(elsewhere.iterdir())


def test_replacing_puts_the_new_file_in_place_of_the_old(tmp_path):
    target = tmp_path / "figure.svg"
    target.write_text("old")
    with target.open() as reader:
        with replacing(target) as temporary:
            temporary.write_text("new")
        assert reader.read() == "old"  # renamed, not overwritten: a reader never sees a half
    with replacing(target) as temporary:
        temporary.write_text("newer")
        assert temporary.parent == target.parent  # a rename is atomic within one folder only
        assert temporary.suffix == ".svg"  # writers choose the format by it
        assert target.read_text() == "new"
    assert target.read_text() == "newer"
    assert list(tmp_path.iterdir()) == [target]


def test_replacing_keeps_the_old_file_when_the_writer_raises(tmp_path):
    target = tmp_path / "table.csv"
    target.write_text("old")
    with pytest.raises(RuntimeError, match="disk full"):
        with replacing(target) as temporary:
            temporary.write_text("half of the ne")
            raise RuntimeError("disk full")
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_a_table_that_cannot_be_written_leaves_the_old_one(elsewhere, monkeypatch):
    path = RESULTS / "table.csv"
    target = publish.write(pd.DataFrame({"a": [1]}), path)

    def fail(self, file, **options):
        file.write_text("half")
        raise OSError("disk full")

    monkeypatch.setattr(pd.DataFrame, "to_csv", fail)
    with pytest.raises(OSError, match="disk full"):
        publish.write(pd.DataFrame({"a": [2]}), path)
    assert target.read_text() == "a\n1\n"
    assert list(target.parent.iterdir()) == [target]


def test_write_hides_the_last_bits_and_read_gives_the_written_numbers(elsewhere):
    frame = pd.DataFrame(
        {
            "method": ["ls", "größte"],
            "n": [500, 495],
            "σ": [0.1 + 0.2, np.nan],
            "mixed": np.array([0.1 + 0.2, "none"], dtype=object),
        },
        index=[7, 8],
    )
    target = publish.write(frame, RESULTS / "table.csv")
    expected = "method,n,σ,mixed\nls,500,0.3,0.3\ngrößte,495,,none\n"
    assert target.read_bytes() == expected.encode("utf-8")
    assert frame["σ"][7] == 0.1 + 0.2  # the caller's table is as before

    values = np.random.default_rng(0).normal(size=1000) * 1e-3
    again = tables.read(publish.write(pd.DataFrame({"v": values}), RESULTS / "values.csv"))["v"]
    np.testing.assert_array_equal(again, [float(f"{value:.9g}") for value in values])


def test_text_aligns_numbers_at_the_point_and_shows_gaps():
    frame = pd.DataFrame(
        {
            "method": ["LS", "IGG III"],
            "Δc": [0.1754, -11.1511],
            "shift": [1e7, np.nan],
            "printed": ["0.0670", "12.5"],
            "n": [5, 500],
        }
    )
    shown = tables.text(frame, {"Δc": 2, "shift": ".1e"})
    assert shown.splitlines() == [
        "method       Δc    shift  printed    n",
        "LS         0.18  1.0e+07   0.0670    5",
        "IGG III  -11.15  –        12.5     500",
    ]


@pytest.mark.parametrize("noise", [1e-17, -1e-17])
def test_the_sign_of_noise_is_not_shown(noise):
    assert tables.text(pd.DataFrame({"v": [noise]}), 3).splitlines()[1].strip() == "0.000"


def test_a_float_column_needs_its_decimals():
    with pytest.raises(KeyError, match="shift"):
        tables.text(pd.DataFrame({"shift": [1.0]}), {"other": 2})


def test_markdown_has_one_cell_a_column_though_names_hold_bars():
    lines = tables.markdown(pd.DataFrame({"|Δa|": [0.067], "method": ["a|b"]}), 4).splitlines()
    assert lines == [r"| \|Δa\| | method |", "| ---: | --- |", r"| 0.0670 | a\|b |"]
