"""The printed numbers are those of the paper, and the verdict on them follows one rule."""

from dataclasses import FrozenInstanceError, replace

import numpy as np
import pandas as pd
import pytest

from analysis.export import tables
from studies import papers, paths, publish, verdicts
from studies.ou_liu_2017 import causes, comparison, headline
from studies.ou_liu_2017.printed_tables import SYMBOLS, printed_numbers
from studies.paths import PUBLISHED, RESULTS
from studies.printed.comparison import INSIDE, OUTSIDE, REPRODUCED, compare, verdict
from studies.printed.judgement import NOT_CHECKABLE, from_interval, setting
from studies.printed.numbers import PrintedNumber, read_table


def printed(text, decimals):
    """A printed number with everything else fixed."""
    return PrintedNumber("ou_liu_2017", 1, "", "ls", "sigma_s_m", text, decimals, "m")


def find(table, method, quantity, sample=""):
    """The one printed number of that place."""
    (number,) = (
        number
        for number in printed_numbers(table)
        if (number.method, number.quantity, number.sample) == (method, quantity, sample)
    )
    return number


@pytest.mark.parametrize(("table", "count"), [(1, 18), (2, 18), (3, 42)])
def test_every_number_of_a_table_is_there_once(table, count):
    numbers = printed_numbers(table)
    places = {(number.sample, number.method, number.quantity) for number in numbers}
    assert len(numbers) == len(places) == count
    assert {number.table for number in numbers} == {table}


def test_the_quantities_of_the_simulations():
    for table in (1, 2):
        assert {(number.method, number.quantity) for number in printed_numbers(table)} == {
            (method, quantity) for method in ("ls", "tls", "igg3_wtls") for quantity in SYMBOLS
        }


@pytest.mark.parametrize(
    ("place", "text", "value", "decimals", "digits"),
    [
        ((1, "ls", "abs_delta_b_m"), "0", 0.0, 4, 1),  # 0 stands for 0.0000
        ((1, "igg3_wtls", "abs_delta_c_m"), "0", 0.0, 4, 1),
        ((1, "ls", "sigma_0"), "0.08004", 0.08004, 5, 4),
        ((2, "ls", "abs_delta_a_m"), "0.0670", 0.0670, 4, 3),  # the last zero is information
        ((2, "tls", "sigma_0"), "34.33430", 34.3343, 5, 7),
        ((3, "ls", "sigma_0", "I"), "7.7080e-5", 7.708e-5, 9, 5),
        ((3, "igg3_wtls", "sigma_s_m", "II"), "7.0619e-4", 7.0619e-4, 8, 5),
        ((3, "tls", "b_m", "I"), "5.8443", 5.8443, 4, 5),
    ],
)
def test_numbers_are_known_to_their_last_printed_digit(place, text, value, decimals, digits):
    number = find(*place)
    assert (number.text, number.value) == (text, value)
    assert (number.decimals, number.significant_digits) == (decimals, digits)
    assert number.half_unit == pytest.approx(0.5 * 10**-decimals, rel=1e-12)


def test_sigma_0_of_ls_and_tls_is_an_area():
    units = {
        (number.method, number.quantity): number.unit
        for table in (1, 2, 3)
        for number in printed_numbers(table)
    }
    areas = {place for place, unit in units.items() if unit == "m²"}
    assert areas == {("ls", "sigma_0"), ("tls", "sigma_0")}
    assert set(units.values()) == {"m", "m²"}


def test_another_table_is_refused():
    with pytest.raises(ValueError, match="expected table 1, 2 or 3, got 4"):
        printed_numbers(4)
    with pytest.raises(ValueError, match="expected table 1 or 2"):
        comparison.comparison_table(3, {}, {})


def test_a_printed_number_cannot_be_changed():
    with pytest.raises(FrozenInstanceError):
        printed_numbers(1)[0].text = "0.0003"


# The rule. Whole numbers and halves are exact in binary, so the borders are exact too.


@pytest.mark.parametrize(
    ("median", "lower", "upper", "expected"),
    [
        (3.0, 0.0, 9.0, REPRODUCED),
        (3.49, 0.0, 9.0, REPRODUCED),  # rounds to 3
        (2.51, 0.0, 9.0, REPRODUCED),
        (3.51, 0.0, 9.0, INSIDE),  # rounds to 4
        (2.49, 0.0, 9.0, INSIDE),
        (5.0, 3.5, 9.0, INSIDE),  # touches what rounds to 3 from above
        (5.0, 3.501, 9.0, OUTSIDE),
        (1.0, 0.0, 2.5, INSIDE),  # and from below
        (1.0, 0.0, 2.499, OUTSIDE),
    ],
)
def test_verdict_at_its_borders(median, lower, upper, expected):
    assert verdict(printed("3", 0), median, lower, upper) == expected


def test_more_printed_digits_make_reproduction_harder():
    assert verdict(printed("0.003", 3), 0.00285, 0.0027, 0.0030) == REPRODUCED
    assert verdict(printed("0.00300", 5), 0.00285, 0.0027, 0.0030) == INSIDE


def test_a_printed_zero_is_compared_with_four_decimals():
    zero = find(1, "ls", "abs_delta_b_m")
    assert verdict(zero, 0.00004, 0.0, 0.0006) == REPRODUCED
    assert verdict(zero, 0.00021, 0.00004, 0.0006) == INSIDE
    assert verdict(zero, 0.00021, 0.00006, 0.0006) == OUTSIDE


def test_compare_gives_the_central_95_percent_and_the_percentile():
    redraws = np.random.default_rng(0).permutation(np.arange(1001.0))
    result = compare(printed("900", 0), 800.0, redraws)
    assert (result.lower, result.median, result.upper) == (25.0, 500.0, 975.0)
    assert result.percentile == pytest.approx(100 * 900.5 / 1001)  # 900 below, one equal
    assert (result.ours, result.redraws, result.no_sphere) == (800.0, 1001, 0)
    assert result.verdict == INSIDE
    assert compare(printed("976", 0), 800.0, redraws).verdict == OUTSIDE
    assert compare(printed("500", 0), 800.0, redraws).verdict == REPRODUCED


def test_the_percentile_counts_half_of_what_rounds_to_the_printed_number():
    # 0.2 is all that is printed of 0.18, 0.2 and 0.24: their order is not known.
    result = compare(printed("0.2", 1), 0.0, [0.1, 0.18, 0.2, 0.24, 0.3, 0.4, 0.5, 0.6])
    assert result.percentile == pytest.approx(100 * (1 + 1.5) / 8)


def test_redraws_without_a_sphere_are_counted_and_left_out():
    with_gaps = compare(printed("3", 0), 3.0, [1.0, np.nan, 3.0, np.nan, 5.0])
    without = compare(printed("3", 0), 3.0, [1.0, 3.0, 5.0])
    assert (with_gaps.redraws, with_gaps.no_sphere) == (3, 2)
    assert replace(with_gaps, no_sphere=0) == without


def test_redraws_must_be_a_list_of_numbers_with_a_sphere():
    with pytest.raises(ValueError, match="at least one redraw with a sphere for sigma_s_m of ls"):
        compare(printed("3", 0), 3.0, [np.nan, np.nan])
    with pytest.raises(ValueError, match=r"shape \(B,\), got \(2, 2\)"):
        compare(printed("3", 0), 3.0, np.ones((2, 2)))


@pytest.mark.parametrize(
    ("text", "decimals", "ours", "digits"),
    [
        ("0.08004", 5, 0.0800449, 4),  # all that are printed
        ("0.08004", 5, 0.0801, 3),
        ("0.08004", 5, 0.0816, 1),
        ("0.08004", 5, 0.3, 0),
        ("0.1000", 4, 0.0999, 2),  # no digit in common, yet one in a thousand apart
        ("0.0670", 4, 0.06704, 3),
        ("0", 4, 0.00004, 1),
        ("0", 4, 0.0002, 0),
        ("0.08004", 5, np.nan, 0),
    ],
)
def test_matching_digits(text, decimals, ours, digits):
    assert compare(printed(text, decimals), ours, [1.0]).matching_digits == digits


@pytest.fixture
def comparisons():
    """Tables 1 and 2 against a world in which the paper is right but for one number."""
    frames = []
    for table in (1, 2):
        numbers = printed_numbers(table)
        ours = {(number.method, number.quantity): number.value for number in numbers}
        redraws = {key: value * np.linspace(0.9, 1.1, 101) for key, value in ours.items()}
        frames.append((table, ours, redraws))
    frames[0][2]["igg3_wtls", "sigma_0"] = np.linspace(0.002, 0.003, 101)
    frames[1][2]["tls", "abs_delta_c_m"] = np.where(np.arange(101) < 7, np.nan, 11.1511)
    return [comparison.comparison_table(*frame) for frame in frames]


def test_comparison_table_has_a_row_a_printed_number(comparisons):
    for table, frame in zip((1, 2), comparisons, strict=True):
        numbers = printed_numbers(table)
        assert frame["printed"].tolist() == [number.value for number in numbers]
        assert frame["quantity"].tolist() == [number.quantity for number in numbers]
        assert frame["method"].tolist() == [number.method for number in numbers]
        np.testing.assert_array_equal(frame["ours"], frame["printed"])
    wrong = comparisons[0].query("verdict != @REPRODUCED")
    assert wrong[["method", "quantity", "verdict"]].values.tolist() == [
        ["igg3_wtls", "sigma_0", OUTSIDE]
    ]
    assert comparisons[1]["no_sphere"].sum() == 7


def test_a_missing_value_is_named():
    with pytest.raises(KeyError, match="abs_delta_a_m"):
        comparison.comparison_table(1, {}, {})


def test_headline_shows_every_number_as_printed(comparisons):
    shown = headline.text(comparisons)
    assert max(map(len, shown.splitlines())) <= 110
    rows = [line for line in shown.splitlines() if any(f" {s} " in line for s in ("m", "m²"))]
    assert len(rows) == 36
    numbers = [number for table in (1, 2) for number in printed_numbers(table)]
    for row, number in zip(rows, numbers, strict=True):
        assert (number.text if number.text != "0" else "0.0000") in row.split()
        assert SYMBOLS[number.quantity] in row.split()
    assert sum(row.endswith("outside") for row in rows) == 1
    assert "36 printed numbers: 35 reproduced to the printed digits, 0 inside" in shown
    assert "Table 2, tls: 7 redraws without a real sphere left out." in shown


def test_headline_is_the_same_from_the_files(comparisons, tmp_path, monkeypatch):
    monkeypatch.setenv("ANALYSIS_OUTPUT", str(tmp_path))
    again = [
        tables.read(publish.write(frame, RESULTS / f"comparison_{i}.csv"))
        for i, frame in enumerate(comparisons)
    ]
    assert headline.text(again) == headline.text(comparisons)


def test_headline_markdown_is_a_table_for_each_table(comparisons):
    lines = headline.markdown(comparisons).splitlines()
    rows = [line.replace(r"\|", "") for line in lines if line.startswith("|")]
    assert len(rows) == 2 * (2 + 18)
    assert len({row.count("|") for row in rows}) == 1
    assert sum("0.0670" in row for row in rows) == 1


# ----------------------------------------------------------------- the registry


def test_the_registry_holds_every_number_and_statement_once():
    registry = papers.registry()
    numbers = [number for table in (1, 2, 3) for number in printed_numbers(table)]
    assert len(numbers) == 78
    assert [number.id for number in numbers] == list(registry)[:78]
    assert all(registry[number.id] == number for number in numbers)
    assert not any(isinstance(entry, PrintedNumber) for entry in list(registry.values())[78:])
    assert all(name == entry.id for name, entry in registry.items())
    assert {name.partition("/")[0] for name in registry} == {
        "ou_liu_2017",
        "wu_chen_wang",
        "li_2015",
    }


def test_every_line_of_the_files_is_a_statement_with_its_digits():
    lines = {}
    for path in sorted(PUBLISHED.glob("*statements.csv")):
        frame = pd.read_csv(path, dtype=str, keep_default_na=False)
        names = (
            frame["paper"]
            if "paper" in frame
            else [path.stem.removesuffix("_statements")] * len(frame)
        )
        lines |= {
            f"{paper}/{key}": text
            for paper, key, text in zip(names, frame["id"], frame["value"], strict=True)
        }
    registry = papers.registry()
    assert {name: registry[name].text for name in lines} == lines
    assert len(registry) == 78 + len(lines)
    percentage = registry["ou_liu_2017/rel_radius_II_IGG"]
    assert (percentage.text, percentage.value, percentage.half_unit, percentage.unit) == (
        "1.10",
        1.1,
        0.005,
        "percent",
    )


def test_a_claim_has_words_and_no_value():
    claim = papers.registry()["ou_liu_2017/claim_table2_tls_worst"]
    assert claim.text == "claim" and "TLS" in claim.quantity
    with pytest.raises(ValueError):
        _ = claim.value


def test_two_statements_of_one_name_are_refused(monkeypatch, tmp_path):
    for path in PUBLISHED.glob("*statements.csv"):
        text = path.read_text(encoding="utf-8")
        (tmp_path / path.name).write_text(
            text + text.splitlines()[1] + "\n" if path.stem.startswith("li") else text,
            encoding="utf-8",
        )
    monkeypatch.setattr(paths, "PUBLISHED", tmp_path)
    with pytest.raises(ValueError, match="li_2015/tunnel_length twice"):
        papers.registry()


def test_no_number_is_left_unexplained():
    assert all(":" in cause and "unexplained" not in cause for cause in causes.CAUSES.values())


def test_a_fourth_paper_is_its_files_and_one_entry(monkeypatch, tmp_path):
    """Nothing else has to be touched for its numbers to get verdicts and its title a row."""
    header = "id,where,quantity,value,unit,note\n"
    (tmp_path / "fourth_2026_statements.csv").write_text(
        header + "noise,section 2,noise of a point,2.0,mm,\n", encoding="utf-8"
    )
    (tmp_path / "fourth_2026_table1.csv").write_text(
        "method,radius_m\nours,0.0725\n", encoding="utf-8"
    )
    (tmp_path / "further_statements.csv").write_text("paper," + header, encoding="utf-8")
    monkeypatch.setattr(paths, "PUBLISHED", tmp_path)

    def table():
        read = read_table("fourth_2026", 1, {"ours": "robust"}, lambda column, _: (column, "m"))
        return {number.id: number for number in read}

    def judges():
        return {
            "fourth_2026/table1/robust/radius_m": lambda number, _: from_interval(
                number, 0.07251, 0.072, 0.073, "", "12_cylinder"
            ),
            "fourth_2026/noise": setting("12_cylinder"),
        }

    fourth = papers.Paper("Fourth (2026)", judges, numbers=table)
    monkeypatch.setattr(papers, "PAPERS", {"fourth_2026": fourth})
    monkeypatch.setattr(verdicts, "PAPERS", papers.PAPERS)
    frame = verdicts.verdicts()
    assert frame["verdict"].tolist() == [REPRODUCED.split()[0], NOT_CHECKABLE]
    assert frame["place"].tolist() == ["table 1, robust", "section 2"]
    assert verdicts.counts(frame).set_index("paper").loc["Fourth (2026)", "numbers"] == 2
