"""The reader knows which columns it took and why, and refuses what can be read in two ways."""

import numpy as np
import pytest

from analysis import read_points, read_scan
from analysis.reading.report import UNITS

POINTS = np.random.default_rng(11).uniform([5, 15, 1], [14, 24, 9], (30, 3)).round(4)


def rows(form, points=POINTS, comma=False):
    """One line per point; in the form stand i, x, y and z."""
    lines = [form.format(i=i, x=x, y=y, z=z) for i, (x, y, z) in enumerate(points.tolist(), 1)]
    text = "\n".join(lines) + "\n"
    return text.replace(".", ",") if comma else text


X_Y_Z = "{x:.4f} {y:.4f} {z:.4f}"
I_X_Y_Z = "{i} " + X_Y_Z
READ = {  # name: text, encoding, columns
    "east north height": ("Nr E N H\n" + rows(I_X_Y_Z), "utf-8", (2, 3, 4)),
    "English": ("id,Easting,Northing,Elevation\n" + rows("{i},{x},{y},{z}"), "utf-8", (2, 3, 4)),
    "German": ("Punkt;Rechtswert;Hochwert;Höhe\n" + rows("{i};{x};{y};{z}"), "latin-1", (2, 3, 4)),
    "north first": ("Northing Easting Height\n" + rows("{y} {x} {z}"), "utf-8", (2, 1, 3)),
    "surveyor": ("Nr Y X Z\n" + rows("{i} {y} {x} {z}"), "utf-8", (3, 2, 4)),
    "French": ("Est;Nord;Altitude\n" + rows("{x};{y};{z}"), "utf-8", (1, 2, 3)),
    "Chinese": ("点号 东 北 高\n" + rows(I_X_Y_Z), "gb18030", (2, 3, 4)),
    "UTF-16": ("编号 北 东 高程\n" + rows("{i} {y} {x} {z}"), "utf-16", (3, 2, 4)),
    "UTF-16 without mark": ("X Y Z\n" + rows(X_Y_Z), "utf-16-le", (1, 2, 3)),
    "words beside": ("id x_coord pos.y Z-Koordinate\n" + rows(I_X_Y_Z), "utf-8", (2, 3, 4)),
    "row and column": ("row column X Y Z\n" + rows("1 {i} " + X_Y_Z), "utf-8", (3, 4, 5)),
    "normals": ("nx ny nz x y z\n" + rows("0.1 0.2 0.97 " + X_Y_Z), "utf-8", (4, 5, 6)),
    "N is a number": ("N X Y Z\n" + rows(I_X_Y_Z), "utf-8", (2, 3, 4)),
    "number in a heading": ("Station 1\nX Y Z\n" + rows(X_Y_Z), "utf-8", (1, 2, 3)),
    "names of points": (rows("P{i} " + X_Y_Z), "utf-8", (2, 3, 4)),
    "comma and semicolon": (rows("{x:.4f};{y:.4f};{z:.4f}", comma=True), "utf-8", (1, 2, 3)),
    "comma and tab": (rows("{x:.4f}\t{y:.4f}\t{z:.4f}", comma=True), "utf-8", (1, 2, 3)),
    "comma and blank": (rows(X_Y_Z, comma=True), "utf-8", (1, 2, 3)),
    "comma in quotes": (
        rows('"{x:.4f}"|"{y:.4f}"|"{z:.4f}"', comma=True).replace("|", ","),
        "utf-8",
        (1, 2, 3),
    ),
    "line ends of CR": (("X Y Z\n\n" + rows(X_Y_Z)).replace("\n", "\r"), "utf-8", (1, 2, 3)),
    "empty CR line first": (("\n" + rows(X_Y_Z)).replace("\n", "\r"), "utf-8", (1, 2, 3)),
}


@pytest.mark.parametrize("name", READ)
def test_the_right_columns_are_taken_and_named(tmp_path, name):
    text, encoding, columns = READ[name]
    path = tmp_path / "scan.txt"
    path.write_bytes(text.encode(encoding))
    points, report = read_scan(path)
    np.testing.assert_array_equal(points, POINTS)
    assert report.columns == columns and f"columns {','.join(map(str, columns))}" in str(report)


REFUSED = {  # name: text
    "number of the point": rows(I_X_Y_Z),
    "row and column": rows("100 {i} " + X_Y_Z + " 120 130"),
    "whole numbers that grow": rows("{i} 700 800 900"),
    "a time": rows("4711.{i:03d} " + X_Y_Z),
    "two words for nothing": "id alpha beta gamma\n" + rows(I_X_Y_Z),
    "heading longer": "Scan position X Y Z Intensity\n" + rows(X_Y_Z + " 99"),
    "heading shorter": "x y z\n" + rows(I_X_Y_Z),
    "heading of another kind": "Format: X Y Z Intensity\n" + rows(X_Y_Z + " 99"),
    "units as words": "X m Y m Z m\n" + rows(X_Y_Z + " 1 2 3"),
    "comment that does not fit": "# x y z\n" + rows(I_X_Y_Z + " 7"),
    "twice": "x y z x y z\n" + rows(X_Y_Z + " " + X_Y_Z),
    "both systems": "x y z e n h\n" + rows(X_Y_Z + " " + X_Y_Z),
    "half a heading": "x y i\n" + rows(X_Y_Z),
    "two units": "x[m] y[m] z[mm]\n" + rows(X_Y_Z),
    "unit of an angle": "x[deg] y[deg] z[deg]\n" + rows(X_Y_Z),
    "decimal commas between commas": rows("{x},{y},{z}", comma=True),
    "decimal commas, comma and blank": rows("{x}, {y}, {z}", comma=True),
    "thousands": rows('"1,{i:03d}.5","2,{i:03d}.5","3,{i:03d}.5"'),
    "thousands or decimals": rows("1,{i:03d};2,{i:03d};3,{i:03d}"),
    "German thousands": rows("1.{i:03d},5,2.{i:03d},6,3.{i:03d},7"),
    "blanks as thousands": rows("1 {i:03d},5 2 {i:03d},6 3 {i:03d},7"),
    "both marks": rows("{x};{y};7,5"),
    "Fortran": "1D0 2D0 3D0\n" + rows(X_Y_Z),
    "minus of Unicode": "−1 −2 −3\n" + rows(X_Y_Z),
    "stars": "* * *\n" + rows(X_Y_Z),
    "numbers of columns": "1 2 3\n" + rows(X_Y_Z),
    "OFF": "OFF\n40 0 0\n" + rows(X_Y_Z),
    "underscore": rows(X_Y_Z) + "1_0 2.0 3.0\n",
    "grid of heights": "ncols 4\nnrows 30\n" + rows("{x} {y} {z} 1.5"),
    "faces": rows("v " + X_Y_Z) + "f 1 2 3\n",
    "another row": rows(X_Y_Z) + rows("{i} {x} {y} {z}"),
    "another row between commas": rows("{x},{y},{z}") + "1,5,2,5,3,5\n",
    "cut within a number": rows(X_Y_Z)[:-3],
    "cut within a row": rows(X_Y_Z + " 7.5")[:-9],
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_can_be_read_in_two_ways_is_refused(tmp_path, name):
    path = tmp_path / "scan.txt"
    path.write_text(REFUSED[name], encoding="utf-8")
    with pytest.raises(ValueError) as caught:
        read_points(path)
    assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)


def test_columns_that_are_told_are_taken(tmp_path):
    path = tmp_path / "scan.txt"
    path.write_text(rows("100 {i} " + X_Y_Z + " 120 130"))
    with pytest.raises(ValueError, match=r"3:'.*--columns 2,3,4"):
        read_points(path)
    np.testing.assert_array_equal(read_points(path, columns=(3, 4, 5)), POINTS)
    np.testing.assert_array_equal(read_points(path, columns=(5, 4, 3)), POINTS[:, ::-1])
    for wrong in ((1, 2), (0, 1, 2), (5, 6, 8), (3, 3, 4)):
        with pytest.raises(ValueError, match="expected three columns of 1 to 7"):
            read_points(path, columns=wrong)


@pytest.mark.parametrize("unit", UNITS)
def test_units_of_headings_and_units_given(tmp_path, unit):
    length = UNITS[unit][0] / UNITS[unit][1]
    for heading in (f"X[{unit}] Y [{unit}] Z({unit})", f"x_{unit} y_{unit} z_{unit}"):
        path = tmp_path / "scan.txt"
        path.write_text(heading + "\n" + rows(X_Y_Z))
        points, report = read_scan(path)
        np.testing.assert_allclose(points, POINTS * length, rtol=1e-15)
        assert (report.unit, report.unit_from) == (unit, "heading")
        np.testing.assert_array_equal(read_points(path, unit=unit), points)
        with pytest.raises(ValueError, match="the heading says"):
            read_points(path, unit="dm" if unit != "dm" else "mm")
    path.write_text(rows(X_Y_Z))
    np.testing.assert_allclose(read_points(path, unit=unit), POINTS * length, rtol=1e-15)
    with pytest.raises(ValueError, match="expected one of the units"):
        read_points(path, unit="inch")


def test_missing_returns_are_left_out_and_counted(tmp_path):
    path = tmp_path / "scan.xyz"
    path.write_text("nan nan nan\n" + rows(X_Y_Z) + "0 0 0\n1.0 NaN 2.0\n0.0000 0.0000 0.0000\n")
    points, report = read_scan(path)
    np.testing.assert_array_equal(points, POINTS)
    assert report.left_out == {"without a number": 2, "0 0 0": 2}
    path.write_text("0 0 0\n" * 9)
    with pytest.raises(ValueError, match="the file has none: 9 0 0 0"):
        read_points(path)


def test_blocks_of_pts_are_joined_and_wrong_counts_are_said(tmp_path):
    path = tmp_path / "scan.pts"
    path.write_text("10\n" + rows(X_Y_Z, POINTS[:10]) + "20\n" + rows(X_Y_Z, POINTS[10:]))
    points, report = read_scan(path)
    np.testing.assert_array_equal(points, POINTS)
    assert report.remarks == ("2 blocks",)
    path.write_text("29\n" + rows(X_Y_Z))
    points, report = read_scan(path)
    np.testing.assert_array_equal(points, POINTS)
    assert report.remarks == ("line 1 announces 29 points, 30 follow",)


def test_extents_like_millimetres_and_a_last_line_without_end_are_said(tmp_path):
    path = tmp_path / "scan.xyz"
    path.write_text(rows("{x} {y} {z}", 1000 * POINTS).rstrip("\n"))
    remarks = read_scan(path).report.remarks
    assert any("if the file is in mm" in remark for remark in remarks)
    assert any("no line end" in remark for remark in remarks)


def test_many_blocks_of_text_are_read_as_one(tmp_path, monkeypatch):
    monkeypatch.setattr("analysis.reading.lines.BLOCK", 1000)
    monkeypatch.setattr("analysis.reading.lines.HEAD", 1000)
    many = np.random.default_rng(2).uniform(1, 9, (3000, 3)).round(3)
    path = tmp_path / "scan.xyz"
    path.write_text(rows("{x} {y} {z}", many))
    np.testing.assert_array_equal(read_points(path), many)
    path.write_text(rows("{x} {y} {z}", many) + "1 2 x\n")
    with pytest.raises(ValueError, match="line 3001"):
        read_points(path)
