"""A scan gives the same points in every format; a bad file gives one clear line."""

import sys

import numpy as np
import pytest

from analysis.reading import read_points
from studies.ou_liu_2017 import clouds

POINTS = np.random.default_rng(5).uniform([-9.0, 99.0, 5.4e6], [9.0, 101.0, 5.5e6], (40, 3))


def table(separator, *extra, order=(0, 1, 2), points=POINTS):
    """The points as lines of text that hold every bit, with extra cells after x, y, z."""
    rows = [[*(repr(float(point[i])) for i in order), *extra] for point in points]
    return "".join(separator.join(row) + "\n" for row in rows)


def mixed_in(line, text, at=20):
    """Text with another line in the middle."""
    lines = text.splitlines(keepends=True)
    return "".join([*lines[:at], line, *lines[at:]])


DIALECTS = {
    "blanks.xyz": table(" "),
    "tabs.xyz": table("\t"),
    "commas.csv": table(","),
    "semicolons.txt": table(";"),
    "comma and blank.csv": table(", "),
    "blank and tab.xyz": table(" \t"),
    "blank or tab.xyz": table(" ").replace(" ", "\t", 1),
    "aligned.asc": "".join(f"   {line}  \n" for line in table("   ").splitlines()),
    "trailing separator.txt": table(";", ""),
    "UPPER.XYZ": table(" "),
    "intensity and colour.pts": "40\n" + table(" ", "-871", "12", "13", "14"),
    "count in blanks.pts": " 40 \n" + table(" "),
    "words after the numbers.csv": table(",", "mast", "1.5 m"),
    "heading.csv": "x,y,z\n" + table(","),
    "heading quoted.csv": '"X","Y","Z"\n' + table(","),
    "quoted.csv": "".join(f'"{line}"\n' for line in table('","').splitlines()),
    "heading with units.csv": "z_m,x_m,y_m,i\n" + table(",", "7", order=(2, 0, 1)),
    "heading in brackets.txt": "Y [m]; X [m]; Z [m]\n" + table(";", order=(1, 0, 2)),
    "heading in blanks.txt": "z y x\n" + table("\t", order=(2, 1, 0)),
    "heading with other names.csv": "east,north,height\n" + table(","),
    "heading as comment.asc": "//Z Y X\n" + table(" ", order=(2, 1, 0)),
    "several headings.txt": "Leica\nz y x\nm m m\n" + table(" ", order=(2, 1, 0)),
    "several comments.asc": "# Leica\n//Z Y X\n# end\n" + table(" ", order=(2, 1, 0)),
    "name of two words.txt": "point name\tX\tY\tZ\n"
    + "".join(f"7\t{line}\n" for line in table("\t").splitlines()),
    "prose in comments.xyz": "# z y x were surveyed in 2017\n" + table(" "),
    "lone quotes.txt": '"five inch target\n' + table(" ", 'inch"'),
    "comments among points.xyz": mixed_in("# moved\n", mixed_in("// moved\n", table(" "))),
    "comments after points.xyz": table(" ").replace("\n", " # fine\n"),
    "ragged colours.xyz": mixed_in(table(" ", "1", "2", points=POINTS[20:21]), table(" ")),
    "blank lines.xyz": "\n\n" + mixed_in("\n  \n", table(" ")) + "\n\n",
    "crlf.csv": table(",").replace("\n", "\r\n"),
    "byte order mark.csv": "\ufeff" + table(","),
    "byte order mark and heading.csv": "\ufeffz,y,x\n" + table(",", order=(2, 1, 0)),
    "no last newline.xyz": table(" ").rstrip("\n"),
}
# The ragged file has its 21st point twice: once with colours, once without.
EXPECTED = {"ragged colours.xyz": np.insert(POINTS, 20, POINTS[20], axis=0)}


@pytest.mark.parametrize("name", DIALECTS)
def test_every_dialect_gives_the_same_points_to_the_last_bit(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(DIALECTS[name].encode("utf-8"))
    points = read_points(path)
    np.testing.assert_array_equal(points, EXPECTED.get(name, POINTS))
    assert points.dtype == np.float64
    assert points.flags.c_contiguous


def test_a_single_point_and_a_string_path(tmp_path):
    (tmp_path / "one.xyz").write_text("1 2 3")
    np.testing.assert_array_equal(read_points(str(tmp_path / "one.xyz")), [[1.0, 2.0, 3.0]])


def test_the_committed_cloud_is_read_by_the_names_of_its_columns():
    # Its first column is the number of the point.
    np.testing.assert_array_equal(
        read_points(clouds.SPHERE_FILES[True]), clouds.read_sphere_cloud(gross=True)
    )


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("word.xyz", mixed_in("1.0 two 3.0\n", table(" ")), "line 21: expected .*'1.0 two 3.0'"),
        ("first.xyz", "1.0 two 3.0\n" + table(" "), "line 1: expected .*'1.0 two 3.0'"),
        ("last.xyz", table(" ") + "1.0 2.0 x\n", "line 41: expected .*columns 1, 2, 3"),
        ("short.xyz", mixed_in("1.0 2.0\n", table(" ")), "line 21: expected .*'1.0 2.0'"),
        ("two columns.csv", "1,2\n3,4\n", "line 1: expected"),
        ("gap.csv", mixed_in("1.0,,3.0\n", table(",")), "line 21: expected .*'1.0,,3.0'"),
        ("tab gap.xyz", mixed_in("1.0\t\t3.0\t4.0\n", table("\t", "7")), "line 21: expected"),
        ("inf.csv", mixed_in("1.0,2.0,-inf\n", table(",")), "line 21: expected finite"),
        ("NA.csv", mixed_in("1.0,NA,3.0\n", table(",")), "line 21: expected finite"),
        ("after comment.xyz", "# a\n\nx y z\n1 2 3\n1 2 three\n", "line 5: expected"),
        ("named.csv", "i,x,y,z\n1,2,3,4\n2,3,4\n", "line 3: expected .*columns 2, 3, 4"),
        ("other separator.csv", mixed_in("1.0;2.0;3.0\n", table(",")), "line 21: expected"),
        ("empty.xyz", "", "the file is empty"),
        ("blank.xyz", "\n  \n", "found none"),
        ("comments.xyz", "# x y z\n// none\n", "found none"),
        ("heading.csv", "x,y,z\n", "found none"),
        ("count.pts", "500\n", "found none"),
        ("noise.txt", "\x00\x01\x02\ufffd", "expected text"),
    ],
)
def test_bad_content_is_one_line_with_file_and_expectation(tmp_path, name, content, message):
    path = tmp_path / name
    path.write_text(content, encoding="utf-8")
    with pytest.raises(ValueError, match=message) as caught:
        read_points(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_a_long_bad_line_is_shortened(tmp_path):
    (tmp_path / "long.xyz").write_text("1 2 " + 10_000 * "z")
    with pytest.raises(ValueError, match="line 1") as caught:
        read_points(tmp_path / "long.xyz")
    assert len(str(caught.value)) < 300


def test_a_missing_file_and_an_unknown_format(tmp_path):
    for name in ("missing.xyz", "missing.las"):
        with pytest.raises(FileNotFoundError, match=name):
            read_points(tmp_path / name)
    with pytest.raises(ValueError, match=r"expected a file ending in one of .xyz .*, got '.dwg'"):
        read_points(tmp_path / "plan.dwg")


@pytest.mark.parametrize(
    ("suffix", "library", "package"),
    [
        (".las", "laspy", "laspy[lazrs]"),
        (".laz", "laspy", "laspy[lazrs]"),
        (".e57", "pye57", "pye57"),
    ],
)
def test_a_missing_library_says_what_to_install(tmp_path, monkeypatch, suffix, library, package):
    monkeypatch.setitem(sys.modules, library, None)
    path = tmp_path / f"scan{suffix}"
    path.write_bytes(b"anything")
    with pytest.raises(ImportError) as caught:
        read_points(path)
    assert f"needs {library}" in str(caught.value)
    assert "pip install" in str(caught.value) and package in str(caught.value)


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_las(tmp_path, suffix):
    laspy = pytest.importorskip("laspy", reason="laspy is an optional extra")
    if suffix == ".laz":
        pytest.importorskip("lazrs", reason="lazrs is an optional extra")
    header = laspy.LasHeader(point_format=3, version="1.2")
    header.scales, header.offsets = [1e-4] * 3, [0.0, 100.0, 5.45e6]
    scan = laspy.LasData(header)
    scan.x, scan.y, scan.z = POINTS.T
    scan.write(tmp_path / f"scan{suffix}")
    points = read_points(tmp_path / f"scan{suffix}")
    np.testing.assert_allclose(points, POINTS, rtol=0, atol=0.6e-4)  # the file's step
    assert points.dtype == np.float64


def test_ply_keeps_points_at_the_same_place(tmp_path):
    points = np.concatenate([POINTS, POINTS[:3]])
    head = "ply\nformat ascii 1.0\n" + f"element vertex {len(points)}\n"
    head += "".join(f"property double {axis}\n" for axis in "xyz")
    head += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    (tmp_path / "scan.PLY").write_text(head + table(" ", points=points) + "3 0 1 2\n")
    np.testing.assert_array_equal(read_points(tmp_path / "scan.PLY"), points)


def test_e57_scans_are_put_in_one_frame(tmp_path):
    pye57 = pytest.importorskip("pye57", reason="pye57 is an optional extra")
    # pye57 writes single precision: what it is given must be exact there.
    scan = (POINTS - [0.0, 0.0, 5.4e6]).astype(np.float32).astype(np.float64)
    turned = np.array([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])  # by 90 degrees about z
    file = pye57.E57(str(tmp_path / "scan.e57"), mode="w")
    for part, rotation, shift in [
        (scan[:25], np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3)),
        (scan[25:], turned, np.array([100.0, 0.0, 5.4e6])),
    ]:
        columns = dict(zip(["cartesianX", "cartesianY", "cartesianZ"], part.T, strict=True))
        file.write_scan_raw(columns, rotation=rotation, translation=shift)
    file.close()
    x, y, z = scan[25:].T
    expected = np.concatenate([scan[:25], np.column_stack([100.0 - y, x, 5.4e6 + z])])
    np.testing.assert_allclose(read_points(tmp_path / "scan.e57"), expected, rtol=0, atol=1e-8)


@pytest.mark.parametrize(
    ("suffix", "library"),
    [(".las", "laspy"), (".e57", "pye57"), (".ply", None), (".pcd", None), (".ptx", None)],
)
def test_a_broken_binary_file(tmp_path, suffix, library):
    if library:
        pytest.importorskip(library, reason=f"{library} is an optional extra")
    path = tmp_path / f"scan{suffix}"
    path.write_bytes(b"this is no scan at all, only words\n" * 50)
    with pytest.raises(
        ValueError, match=f"expected (a readable|the header of a) {suffix} (file|scan)"
    ):
        read_points(path)
