"""Whatever comes as a file: the points that were written, or one line that says why not."""

import gzip
import os
import struct
import warnings

import numpy as np
import pytest

from analysis import read_points, read_scan

FILES = 300


def written(points, more=""):
    return "".join(f"{x:.4f} {y:.4f} {z:.4f}{more}\n" for x, y, z in points)


def table(rng, points):
    """A good table of points in a dialect drawn at random, and the suffix of its file."""
    separator, comma = [(" ", False), ("\t", False), (";", False), (",", False), (";", True)][
        rng.integers(5)
    ]
    number, extra = rng.integers(2), rng.integers(3)
    heading = number or rng.integers(2)
    rows = []
    for i, point in enumerate(points, 1):
        cells = [str(i)] * number + [f"{value:.4f}" for value in point] + ["77"] * extra
        line = separator.join(cells)
        rows.append(line.replace(".", ",") if comma else line)
    names = ["Nr"] * number + list("XYZ") + [f"i{k}" for k in range(extra)]
    text = "\n".join([separator.join(names)] * int(heading) + rows) + "\n"
    end = ["\n", "\r\n", "\r"][rng.integers(3)]
    encoding = ["utf-8", "utf-8-sig", "utf-16", "latin-1"][rng.integers(4)]
    return text.replace("\n", end).encode(encoding), ".txt"


def ply(rng, points):
    head = "ply\nformat {} 1.0\nelement vertex {}\n" + "property double {}\n" * 3 + "end_header\n"
    form = ["ascii", "binary_little_endian", "binary_big_endian"][rng.integers(3)]
    text = head.format(form, len(points), *"xyz").encode()
    if form == "ascii":
        return text + written(points).encode(), ".ply"
    return text + points.astype("<f8" if "little" in form else ">f8").tobytes(), ".ply"


def pcd(rng, points):
    form = ["ascii", "binary"][rng.integers(2)]
    head = f"VERSION .7\nFIELDS x y z\nSIZE 8 8 8\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {len(points)}\n"
    head += f"HEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\nDATA {form}\n"
    rows = written(points).encode()
    return head.encode() + (rows if form == "ascii" else points.astype("<f8").tobytes()), ".pcd"


def ptx(rng, points):
    frame = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"
    rows = written(points, " 0.5")
    return f"1\n{len(points)}\n{frame}{rows}".encode(), ".ptx"


def las(rng, points):
    """LAS 1.2 of point format 0, written by hand: its step is 0.1 mm."""
    head = bytearray(227)
    head[:4], head[24:26] = b"LASF", bytes([1, 2])
    struct.pack_into("<HII", head, 94, 227, 227, 0)
    struct.pack_into("<BHI", head, 104, 0, 20, len(points))
    struct.pack_into("<6d", head, 131, 1e-4, 1e-4, 1e-4, 0, 0, 0)
    whole = np.rint(points * 1e4).astype(int).tolist()
    return bytes(head) + b"".join(struct.pack("<3i8x", *p) for p in whole), ".las"


def damaged(rng, content, kind):
    """The content of a file after one kind of damage; what is left may still be whole."""
    place = int(rng.integers(1, len(content)))
    lines = content.splitlines(keepends=True)
    line = int(rng.integers(len(lines)))
    words = [b"1,5,2,5,3,5\n", b"nan nan nan\n", b"one two three\n", b"1.0|2.0|3.0\n", b"* * *\n"]
    words += [b"\0\0\0\n", b"9" * 20_000 + b"\n", b"0x10 1 2\n", b"1e400 1 2\n", b"1 2\n", b'"\n']
    return {
        "none": content,
        "cut": content[:place],
        "line lost": b"".join(lines[:line] + lines[line + 1 :]),
        "line put in": b"".join([*lines[:line], words[rng.integers(len(words))], *lines[line:]]),
        "random bytes": rng.bytes(place),
        "NUL": content[:place] + bytes(300) + content[place:],
        "packed": gzip.compress(content),
    }[kind]


KINDS = ("none", "cut", "line lost", "line put in", "random bytes", "NUL", "packed")


def outcome(path, points):
    """ "right", "refused", "a part said" or what else happened with a file."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            found, report = read_scan(path)
        except (ValueError, OSError) as error:
            return "refused" if "\n" not in str(error) else f"two lines: {error}"
    if found.shape == points.shape and np.allclose(found, points, rtol=0, atol=1e-9):
        return "right"
    # Whole rows of the file, in order: a table from which lines were taken is a good table.
    places = [np.flatnonzero(np.all(np.abs(points - p) < 1e-9, axis=1)) for p in found]
    if all(len(place) == 1 for place in places) and np.all(np.diff(np.concatenate(places)) > 0):
        return "whole rows"
    return f"other numbers: {report}"


def sweep(folder, files, seed=0):
    """Counts of outcomes by format and damage, over files drawn at random."""
    counts = {}
    for i in range(files):
        rng = np.random.default_rng([seed, i])
        points = rng.uniform([5, 15, 1], [14, 24, 9], (int(rng.integers(12, 60)), 3)).round(4)
        content, suffix = (table, table, ply, pcd, ptx, las)[i % 6](rng, points)
        kind = KINDS[rng.integers(len(KINDS))]
        packed = ".gz" if kind == "packed" and suffix == ".txt" else ""
        path = folder / f"{i}{suffix}{packed}"
        path.write_bytes(damaged(rng, content, kind))
        key = (suffix, kind, outcome(path, points))
        counts[key] = counts.get(key, 0) + 1
    return counts


def test_right_points_or_one_line(tmp_path):
    pytest.importorskip("laspy", reason="laspy is an optional extra")
    counts = sweep(tmp_path, FILES)
    for (suffix, kind, result), count in counts.items():
        # Only a table has no header that says how many points there are.
        allowed = {"right", "refused"} | ({"whole rows"} if suffix == ".txt" else set())
        assert result in allowed, (suffix, kind, result, count)
        assert kind != "none" or result == "right", (suffix, kind, result, count)


@pytest.mark.parametrize("suffix", [".las", ".ply", ".pcd", ".ptx"])
def test_a_claimed_size_is_checked_before_memory_is_taken(tmp_path, suffix):
    pytest.importorskip("laspy", reason="laspy is an optional extra")
    rng, points = np.random.default_rng(4), np.full((40, 3), 1.5)
    content = {".las": las, ".ply": ply, ".pcd": pcd, ".ptx": ptx}[suffix](rng, points)[0]
    if suffix == ".las":
        content = content[:107] + struct.pack("<I", 2**31) + content[111:]
    else:
        content = content.replace(b"40", b"4000000000")
    path = tmp_path / f"scan{suffix}"
    path.write_bytes(content)
    with pytest.raises(ValueError, match="claims|missing"):
        read_points(path)


def test_las_of_random_bytes_ends_at_once(tmp_path):
    path = tmp_path / "scan.las"
    pytest.importorskip("laspy", reason="laspy is an optional extra")
    path.write_bytes(b"LASF" + np.random.default_rng(1).bytes(2000))
    with pytest.raises(ValueError, match="the header claims"):
        read_points(path)


def test_las_noise_and_withheld_points_are_left_out(tmp_path):
    laspy = pytest.importorskip("laspy", reason="laspy is an optional extra")
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = [1e-4] * 3, [0.0] * 3
    scan = laspy.LasData(header)
    scan.x, scan.y, scan.z = np.arange(1.0, 7.0), np.ones(6), np.ones(6)
    scan.classification = [2, 7, 18, 2, 2, 7]
    scan.withheld = [0, 0, 0, 1, 0, 1]
    scan.write(tmp_path / "scan.las")
    points, report = read_scan(tmp_path / "scan.las")
    np.testing.assert_allclose(points[:, 0], [1.0, 5.0])
    assert report.left_out == {"withheld": 2, "noise": 2}


def test_ptx_is_moved_by_its_matrix_and_cells_without_return_are_left_out(tmp_path):
    frame = "1 2 3\n1 0 0\n0 1 0\n0 0 1\n0 1 0 0\n-1 0 0 0\n0 0 1 0\n100 200 300 1\n"
    scan = f"2\n2\n{frame}1.0 2.0 3.0 0.5\n0 0 0 0.5\n4.0 5.0 6.0 0.5\n0 0 0 0.5\n"
    path = tmp_path / "scan.ptx"
    path.write_text(scan * 2)
    points, report = read_scan(path)
    # x y z 1 times the matrix: x to the new y, y to the new -x.
    np.testing.assert_allclose(points, [[98, 201, 303], [95, 204, 306]] * 2)
    assert report.left_out == {"0 0 0": 4}


def test_single_precision_is_said_and_compressed_pcd_is_refused(tmp_path):
    head = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 2\nHEIGHT 1\nPOINTS 2\nDATA {}\n"
    path = tmp_path / "scan.pcd"
    single = np.array([[1.5, 2.5, 3.5], [np.nan] * 3], "<f4")
    path.write_bytes(head.format("binary").encode() + single.tobytes())
    points, report = read_scan(path)
    np.testing.assert_array_equal(points, [[1.5, 2.5, 3.5]])
    assert report.left_out == {"without a number": 1} and "single precision" in str(report)
    path.write_bytes(head.format("binary_compressed").encode() + single.tobytes())
    with pytest.raises(ValueError, match="convert"):
        read_points(path)


def test_what_is_no_regular_file_or_no_text_ends_in_one_line(tmp_path):
    os.mkfifo(tmp_path / "pipe.xyz")
    (tmp_path / "zero.xyz").symlink_to("/dev/zero")
    (tmp_path / "folder.xyz").mkdir()
    for name in ("pipe.xyz", "zero.xyz", "folder.xyz"):
        with pytest.raises(ValueError, match="expected a regular file"):
            read_points(tmp_path / name)
    (tmp_path / "endless.xyz").write_bytes(b"1.0 " * 3_000_000)
    with pytest.raises(ValueError, match="without end"):
        read_points(tmp_path / "endless.xyz")
    (tmp_path / "picture.las.gz").write_bytes(b"anything")
    with pytest.raises(ValueError, match="expected a file ending in"):
        read_points(tmp_path / "picture.las.gz")
