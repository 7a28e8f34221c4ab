"""``python -m analysis tunnel``: what it prints and writes, and the exit status."""

import json
import re
import sys
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from analysis import read_points
from analysis.__main__ import main
from analysis.export import tables
from analysis.tunnel import command
from analysis.tunnel.comparison import compare

RADIUS, LENGTH = 1.5, 6.0
OPTIONS = {"spacing": 2.5, "thickness": 0.4, "registration": 0.002}


def epoch(path, seed, settled):
    """A tunnel whose crown has ``settled`` (m) near its far end."""
    rng = np.random.default_rng(seed)
    alpha, y = rng.uniform(-2.5, 2.5, 6_000), rng.uniform(0.0, LENGTH, 6_000)
    rho = RADIUS + 0.002 * rng.standard_normal(6_000) - settled * np.cos(2 * alpha) * (y > 3.5)
    np.savetxt(
        path,
        np.column_stack([rho * np.sin(alpha), y, rho * np.cos(alpha)]) + [5e5, 4e6, 100.0],
        fmt="%.4f",
    )
    return str(path)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scans")
    return epoch(folder / "first.xyz", 1, 0.0), epoch(folder / "second.xyz", 2, 0.015)


@pytest.fixture(scope="module")
def result(files):
    return compare(*map(read_points, files), **OPTIONS)


@pytest.fixture
def quick(result, monkeypatch):
    """The comparison without its time."""

    def compared(first, second, *, report, **options):
        assert options == OPTIONS
        report("all")
        return result

    monkeypatch.setattr(command, "compare", compared)


def arguments(files, folder):
    given = [text for name, value in OPTIONS.items() for text in (f"--{name}", str(value))]
    return ["tunnel", *files, *given, "--output", str(folder)]


def test_text_tables_and_figures(files, result, quick, tmp_path, capsys):
    folder = tmp_path / "new" / "results"
    assert main(arguments(files, folder)) == 0
    printed = capsys.readouterr()
    assert printed.err == ""  # no progress where there is no terminal
    table = result.table()
    lines = printed.out.splitlines()
    assert lines[0].startswith(f"first epoch: {files[0]}, 6000 points, ") and lines[1].startswith(
        f"second epoch: {files[1]}, "
    )
    assert f"{result.axis.length:.2f} m" in lines[2] and lines[3].endswith("± 2 mm a coordinate")
    start = next(place for place, line in enumerate(lines) if line.startswith("chainage/m"))
    heads = re.split("  +", lines[start])
    assert len(set(heads)) == len(heads) == len(command.SHOWN)  # told apart not by blanks alone
    assert heads[-2:] == ["convergence/mm", "±convergence/mm"]
    for line, row in zip(lines[start + 1 :], table.itertuples(), strict=False):
        cells = line.split()
        assert cells[:3] == [f"{row.chainage_m:.2f}", str(row.points_1), str(row.points_2)]
        assert cells[5:7] == ["yes" if row.flagged else "-", "yes" if row.changed else "-"]
        assert cells[7:9] == [f"{row.largest_change_mm:.1f}", f"{row.largest_change_sd_mm:.1f}"]
        assert cells[-2:] == [
            f"{row.horizontal_convergence_mm:.1f}",
            f"{row.horizontal_convergence_sd_mm:.1f}",
        ]
    assert table["changed"].tolist() == [False, False, True]
    changed = table.loc[table["flagged"] | table["changed"], "chainage_m"]
    stems = ["changes", "along"] + [f"section_{chainage:.2f}" for chainage in changed]
    assert lines[-len(stems) :] == [f"  {folder / stem}" for stem in stems]
    expected = {f"{stem}.{kind}" for stem in stems for kind in ("png", "svg", "csv")} | {
        "sections.csv"
    }
    assert {path.name for path in folder.iterdir()} == expected
    assert all((folder / f"{stem}.png").stat().st_size > 10_000 for stem in stems)


def test_the_csv_is_the_table(files, result, quick, tmp_path, capsys):
    main(arguments(files, tmp_path))
    for found, expected in (("sections", result.table()), ("changes", result.by_direction())):
        found = tables.read(tmp_path / f"{found}.csv")
        if "note" in found:  # a column without a word is read as one of missing numbers
            found["note"] = found["note"].astype(object).fillna("")
        pd.testing.assert_frame_equal(found, expected, rtol=1e-8, check_dtype=False)


def test_json(files, result, quick, tmp_path, capsys):
    assert main([*arguments(files, tmp_path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (
        found["files"] == list(files)
        and found["points"] == [6000, 6000]
        and found["converged"] is True
    )
    assert found["axis_length_m"] == result.axis.length
    assert [
        {k: np.nan if v is None else v for k, v in row.items()} for row in found["sections"]
    ] == [s.row() for s in result.sections]
    assert found["written"][0] == str(tmp_path / "sections.csv")


def test_what_is_not_defined_is_a_dash_or_null(files, result, monkeypatch, tmp_path, capsys):
    blank = replace(
        result.sections[0], significance=None, ellipses=None, change=None, note="nothing to be seen"
    )
    monkeypatch.setattr(command, "compare", lambda *_, **__: replace(result, sections=(blank,)))
    assert main(arguments(files, tmp_path)) == 0
    text = capsys.readouterr().out
    assert f"{blank.chainage:.2f} m: nothing to be seen" in text and re.search(
        r"-\s+-\s+–\s+–\s+–\s+–", text
    )
    assert main([*arguments(files, tmp_path), "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)["sections"]
    assert row["p_value"] is None and row["crown_settlement_mm"] is None and row["changed"] is False


def test_a_result_that_did_not_converge_has_status_1(files, result, monkeypatch, tmp_path, capsys):
    axis = replace(result.axis, converged=False, stop_reason="not converged: it still moved")
    monkeypatch.setattr(command, "compare", lambda *_, **__: replace(result, axis=axis))
    assert main(arguments(files, tmp_path)) == 1
    assert "not converged: it still moved" in capsys.readouterr().out


def fail(capsys, *arguments):
    """Run what must fail with status 2, and return the one line on stderr."""
    assert main([*arguments]) == 2
    printed = capsys.readouterr()
    assert printed.out == "" and printed.err.count("\n") == 1 and printed.err.endswith("\n")
    return printed.err.rstrip()


def test_bad_files(files, tmp_path, capsys):
    missing, output = str(tmp_path / "no.xyz"), ["--output", str(tmp_path / "out")]
    assert (
        fail(capsys, "tunnel", files[0], missing, *output)
        == f"analysis: {missing}: No such file or directory"
    )
    assert not (tmp_path / "out").exists()
    assert (
        fail(capsys, "tunnel", *files, "--output", files[0]) == f"analysis: {files[0]}: File exists"
    )
    millimetres = tmp_path / "mm.xyz"
    np.savetxt(millimetres, 1000 * (read_points(files[1]) - [5e5, 4e6, 100.0]), fmt="%.1f")
    message = fail(capsys, "tunnel", str(millimetres), files[1], *output)
    assert (
        message.startswith(f"analysis: {millimetres}: points: expected at least 3 slabs")
        and "are these metres" in message
    )
    message = fail(capsys, "tunnel", files[0], str(millimetres), *output)
    assert message.startswith(
        f"analysis: {millimetres}: expected an epoch in the unit (m) and system of the first"
    )


def test_bad_values(files, tmp_path, capsys):
    output = ["--output", str(tmp_path)]
    assert fail(capsys, "tunnel", *files, "--spacing", "0", *output).startswith(
        "analysis: spacing: expected a positive"
    )
    assert fail(capsys, "tunnel", *files, "--registration", "-1", *output).startswith(
        "analysis: registration: expected"
    )
    with pytest.raises(SystemExit) as ended:
        main(["tunnel", files[0]])
    assert ended.value.code == 2


def test_help_says_what_is_written(capsys):
    with pytest.raises(SystemExit):
        main(["tunnel", "--help"])
    text = capsys.readouterr().out
    assert (
        "sections.csv" in text
        and "exit status" in text
        and "in more than 30 % of the directions" in text
        and "%%" not in text
    )


def test_progress_is_shown_on_a_terminal(files, quick, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    assert main(arguments(files, tmp_path)) == 0
    shown = capsys.readouterr().err
    assert f"reading {files[0]} (1 of " in shown and "tables and figures (" in shown
