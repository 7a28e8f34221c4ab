"""Agreement of results with the committed ones, by number and not by byte.

Linear algebra differs between processors in the last bits of every sum, and iterations that stop at
a threshold enlarge that. So tables and printed text are compared by tolerance, and a figure by the
table of what it shows. :func:`settle` puts what a notebook wrote into the tree: as it is committed
where it agrees, as it was written where it does not.

``python -m project.agreement`` says how many tables and figures of the tree agree.
"""

import re
import subprocess
import sys
from io import BytesIO
from itertools import zip_longest
from pathlib import Path

import nbformat
import numpy as np
import pandas as pd

from analysis.export import files
from studies import paths

from . import scans

RTOL, ATOL = 1e-6, 1e-9
FIGURES = (".png", ".svg")

NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


# ---------------------------------------------------------------------------------------- comparing


def table_differences(found, expected):
    """Lines that name where two tables of text cells differ beyond the tolerance; none when they
    agree.
    """
    if list(found.columns) != list(expected.columns):
        return [f"columns {list(found.columns)} instead of {list(expected.columns)}"]
    if len(found) != len(expected):
        return [f"{len(found)} rows instead of {len(expected)}"]
    lines = []
    for name in expected:
        numbers = [
            pd.to_numeric(table[name], errors="coerce").to_numpy(float)
            for table in (found, expected)
        ]
        close = np.isclose(*numbers, rtol=RTOL, atol=ATOL)
        agree = (found[name] == expected[name]).to_numpy() | close
        lines += [
            f"row {row}, {name}: {found[name][row]} instead of {expected[name][row]}"
            for row in np.flatnonzero(~agree)
        ]
    return lines


def read_table(content):
    """A table of text cells from the bytes of a CSV file."""
    return pd.read_csv(BytesIO(content), dtype=str, keep_default_na=False)


def tables_agree(found, expected):
    """Whether the bytes of two CSV files are the same table within the tolerance."""
    return found == expected or not table_differences(read_table(found), read_table(expected))


def texts_agree(found, expected):
    """Whether two printed texts are the same but for the last printed digit of their numbers.

    Blanks do not count, for a column grows with its widest number. A number without a decimal point
    counts something and must be equal.
    """
    if NUMBER.sub("#", found).split() != NUMBER.sub("#", expected).split():
        return False
    pairs = zip(NUMBER.findall(found), NUMBER.findall(expected), strict=True)
    return all(one == other or _close(one, other) for one, other in pairs)


def _close(one, other):
    if one.isdecimal() or other.isdecimal():
        return False
    return abs(float(one) - float(other)) <= 1.01 * max(_last_digit(one), _last_digit(other))


def _last_digit(number):
    """The value of one unit of the last printed digit."""
    mantissa, _, exponent = number.lower().partition("e")
    return 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))


def notebooks_agree(found, expected):
    """Whether two notebooks (their bytes) have the same cells and agree in what they print."""
    return cells(found) == cells(expected) and all(
        mine is not None and theirs is not None and _outputs_agree(mine, theirs)
        for mine, theirs in zip_longest(*map(_outputs, (found, expected)))
    )


def cells(content):
    """The cells of a notebook (its bytes) without their outputs."""
    return [
        (cell.id, cell.cell_type, cell.source, cell.get("execution_count"))
        for cell in nbformat.reads(content.decode(), as_version=4).cells
    ]


def _outputs(content):
    book = nbformat.reads(content.decode(), as_version=4)
    return [output for cell in book.cells for output in cell.get("outputs", [])]


def _outputs_agree(one, other):
    """Whether two outputs of a cell say the same; what a picture shows is compared as a table."""
    texts = [
        [output.output_type, output.get("text", ""), *map(str, _shown(output))]
        for output in (one, other)
    ]
    return len(texts[0]) == len(texts[1]) and all(map(texts_agree, *texts))


def _shown(output):
    """The kinds of an output, and the content of each that is no picture."""
    for kind, content in sorted(output.get("data", {}).items()):
        yield kind
        if not kind.startswith("image/"):
            yield content


# ---------------------------------------------------------------------------------------- committed


def git(*arguments):
    """The answer of git about the tree, bytes; None where it fails or the tree is no checkout."""
    if not (paths.ROOT / ".git").exists():
        return None
    try:
        done = subprocess.run(["git", *arguments], cwd=paths.ROOT, capture_output=True)
    except FileNotFoundError:  # no git on this machine
        return None
    return done.stdout if done.returncode == 0 else None


def committed(path):
    """Content of the file at a relative path as it was committed, bytes; None if it was not.

    Of a tree without git: as it was before it was first replaced.
    """
    if git("rev-parse", "HEAD") is not None:
        return git("show", f"HEAD:{path.as_posix()}")
    for home in (_kept(path), paths.ROOT / path):
        if home.is_file():
            return home.read_bytes()
    return None


def _kept(path):
    """Place for the first content of a file of a tree without git."""
    return paths.ROOT / "build" / "committed" / path


# ----------------------------------------------------------------------------------------- settling


def settle(written, notebook, executed):
    """Put into the tree what a notebook has written, and the executed notebook itself.

    A file stays as it is committed where it agrees: a table by number, a figure if its table does,
    the notebook if it is the same, its text agrees, and so do all its tables. While the notebook or
    src has changes that are not committed, figures and notebook get in as they are, so that a new
    look is seen.

    Parameters
    ----------
    written : folder in which the notebook wrote, laid out as the tree.
    notebook : path of the notebook in the tree, relative.
    executed : bytes of the executed notebook.

    Returns
    -------
    list of the relative paths of the tables that do not agree.
    """
    found = sorted(path.relative_to(written) for path in written.rglob("*") if path.is_file())
    content = {path: (written / path).read_bytes() for path in found} | {notebook: executed}
    before = {path: committed(path) for path in content}
    differing = [
        path
        for path in found
        if path.suffix == ".csv"
        and (before[path] is None or not tables_agree(content[path], before[path]))
    ]
    stems = {path.stem for path in differing}
    same_code = (
        before[notebook] is not None
        and cells(before[notebook]) == cells(executed)
        and not git("status", "--porcelain", "--", "src")
    )
    for path in found:
        shown = path.suffix == ".csv" or same_code
        agrees = before[path] is not None and path.stem not in stems and shown
        _replace(path, before[path] if agrees else content[path])
    agrees = same_code and not differing and notebooks_agree(executed, before[notebook])
    _replace(notebook, before[notebook] if agrees else executed)
    return differing


def _replace(path, content):
    """Make the content of a file in the tree this one, in one step, unless it is already."""
    target = paths.ROOT / path
    now = target.read_bytes() if target.is_file() else None
    if now == content:
        return
    if now is not None and not _kept(path).exists() and git("rev-parse", "HEAD") is None:
        _write(_kept(path), now)
    _write(target, content)


def _write(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    with files.replacing(path) as part:
        part.write_bytes(content)


# ---------------------------------------------------------------------------------------- reporting


def report():
    """How many tables and figures of the tree agree with the committed ones, as lines for a person;
    those that do not are named.

    A notebook that cannot be run here has made none: this is said, and its files do not count.
    """
    skipped = scans.skip_reason(scans.NOTEBOOK)
    made = [path for path in _results() if not (skipped and path.stem.startswith(scans.NOTEBOOK))]
    tables = [path for path in made if path.suffix == ".csv"]
    differing = [path for path in tables if not _agrees(path)]
    stems = {path.stem for path in differing}
    figures = {path.stem for path in made if path.suffix in FIGURES}
    undrawn = {
        path.stem
        for path in made
        if path.suffix in FIGURES and (path.stem in stems or not (paths.ROOT / path).is_file())
    }
    lines = [skipped] if skipped else []
    lines += [f"does not agree: {path.as_posix()}" for path in differing]
    lines += [f"does not agree: the figure {stem}" for stem in sorted(undrawn)]
    lines.append(
        f"{len(tables) - len(differing)} of {len(tables)} tables and "
        f"{len(figures) - len(undrawn)} of {len(figures)} figures agree with the committed ones"
    )
    return lines


def _results():
    """Relative paths of all tables and figures, committed or in the tree."""
    folders = (paths.RESULTS, paths.SIMULATED, paths.FIGURES)
    found = {path.relative_to(paths.ROOT) for folder in folders for path in folder.glob("*.*")}
    names = [folder.relative_to(paths.ROOT).as_posix() for folder in folders]
    listed = git("ls-tree", "-r", "--name-only", "HEAD", "--", *names) or b""
    found |= {Path(name) for name in listed.decode().splitlines()}
    return sorted(path for path in found if path.suffix in (".csv", *FIGURES))


def _agrees(path):
    home, expected = paths.ROOT / path, committed(path)
    return home.is_file() and expected is not None and tables_agree(home.read_bytes(), expected)


def main():
    """Command line."""
    print("\n".join(report()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
