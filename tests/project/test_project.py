"""The project's own machinery: lock, Makefile, scans, notebooks, README, site."""

import functools
import hashlib
import http.server
import io
import json
import os
import re
import shutil
import subprocess
import sys
import threading
import tomllib
from pathlib import Path

import nbformat
import pytest
from nbclient.exceptions import CellExecutionError
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook, new_output
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from project import notebooks, readme, scans, site
from studies import paths

NOTEBOOKS = sorted(paths.NOTEBOOKS.glob("*.ipynb"))


# -------------------------------------------------------------------------------------- environment


def wanted():
    """The requirements of environment.in."""
    lines = (
        line.partition("#")[0].strip()
        for line in (paths.ROOT / "environment.in").read_text().splitlines()
    )
    return [Requirement(line) for line in lines if line]


def locked():
    """Pairs (requirement, its hashes) of environment.txt."""
    text = re.sub(
        r"^\s*#.*\n", "", (paths.ROOT / "environment.txt").read_text(), flags=re.MULTILINE
    )
    entries = [
        re.split(r"\s+--hash=", entry)
        for entry in text.replace("\\\n", " ").splitlines()
        if entry.strip()
    ]
    return [(Requirement(requirement), hashes) for requirement, *hashes in entries]


@pytest.mark.parametrize("requirement", wanted(), ids=str)
def test_lock_pins_what_is_wanted(requirement):
    pins = [
        pin
        for pin, _ in locked()
        if canonicalize_name(pin.name) == canonicalize_name(requirement.name)
    ]
    assert pins
    for pin in pins:
        (specifier,) = pin.specifier
        assert specifier.operator == "==" and requirement.specifier.contains(specifier.version)


def test_lock_pins_every_package_with_hashes():
    for pin, hashes in locked():
        assert re.fullmatch(r"==[^*,]+", str(pin.specifier)), pin
        assert hashes and all(
            re.fullmatch(r"sha256:[0-9a-f]{64}", digest.strip()) for digest in hashes
        ), pin


@pytest.mark.parametrize("name", ["environment.in", "environment.txt"])
def test_lock_holds_no_address(name):
    text = (paths.ROOT / name).read_text()
    options = re.findall(r"^\s*(-(?!-hash=).*)", text, re.MULTILINE)
    assert "://" not in text and options == []


def test_package_asks_for_no_more_than_the_environment_has():
    project = tomllib.loads((paths.ROOT / "pyproject.toml").read_text())["project"]
    assert {str(Requirement(text)) for text in project["dependencies"]} <= set(map(str, wanted()))


def test_the_tested_package_is_this_checkout():
    assert paths.ROOT == Path(__file__).resolve().parents[2]


def test_make_help_lists_every_target():
    if not shutil.which("make"):
        pytest.skip("make is not installed")
    makefile = (paths.ROOT / "Makefile").read_text()
    targets = set(re.search(r"^\.PHONY: (.*)$", makefile, re.MULTILINE)[1].split())
    targets -= {"notebooks", "compare"}  # steps of reproduce and of test
    shown = subprocess.run(
        ["make", "help"], cwd=paths.ROOT, capture_output=True, text=True, check=True
    ).stdout
    described = dict(re.findall(r"^make ([a-z]+) +(\S.*)$", shown, re.MULTILINE))
    assert set(described) == targets


# ------------------------------------------------------------------------------ committed notebooks


def code_cells(path):
    """The cells of a committed notebook that hold code."""
    cells = nbformat.read(path, as_version=4).cells
    return [cell for cell in cells if cell.cell_type == "code" and cell.source.strip()]


def as_text(output):
    """All an output says, without its pictures."""
    data = {
        kind: value
        for kind, value in output.get("data", {}).items()
        if not kind.startswith("image/png")
    }
    return json.dumps([data, output.get("text", "")], ensure_ascii=False)


each_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


@each_notebook
def test_notebook_was_executed_in_order(path):
    counts = [cell.execution_count for cell in code_cells(path)]
    assert counts == list(range(1, len(counts) + 1))


@each_notebook
def test_notebook_is_quiet(path):
    for cell in code_cells(path):
        for output in cell.outputs:
            assert output.output_type != "error" and output.get("name") != "stderr", cell.source


@each_notebook
def test_notebook_knows_no_machine(path):
    machine = re.compile(r"(?<![\w.])/(home|Users|root|tmp|usr|opt|var|work)/\w|\b[A-Z]:\\+Users")
    for cell in nbformat.read(path, as_version=4).cells:
        for text in [cell.source, *map(as_text, cell.get("outputs", []))]:
            assert not machine.search(text), machine.search(text)


@each_notebook
def test_notebook_has_short_cells(path):
    for cell in code_cells(path):
        assert len(cell.source.splitlines()) <= 25, (
            f"does this belong in src/analysis?\n{cell.source}"
        )


@each_notebook
def test_notebook_is_stored_as_the_runner_stores_it(path):
    notebook = nbformat.read(path, as_version=4)
    assert notebook.metadata == notebooks.METADATA
    assert nbformat.writes(notebook) + "\n" == path.read_text(encoding="utf-8")


# -------------------------------------------------------------------------------- running notebooks


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder in the place of notebooks/, in a tree without git."""
    monkeypatch.setattr(paths, "ROOT", tmp_path)
    monkeypatch.setattr(paths, "NOTEBOOKS", tmp_path / "notebooks")
    paths.NOTEBOOKS.mkdir()
    return paths.NOTEBOOKS


def write(path, *sources):
    """A notebook of code cells under one heading."""
    notebook = new_notebook(
        cells=[new_markdown_cell("# A title\n\nSome *text*."), *map(new_code_cell, sources)]
    )
    nbformat.write(notebook, path)
    return path


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_runner_executes_and_repeats_to_the_byte(folder):
    path = write(folder / "01_sum.ipynb", "import os\nprint(os.listdir())", "1 + 1")
    progress = io.StringIO()
    notebooks.run(path, progress)
    first, changed = path.read_bytes(), path.stat().st_mtime_ns
    cells = code_cells(path)
    assert [cell.execution_count for cell in cells] == [1, 2]
    assert cells[0].outputs[0].text == "['01_sum.ipynb']\n"  # run in its own folder
    assert cells[1].outputs[0].data["text/plain"] == "2"
    assert re.search(
        r"^01_sum  cell 2 of 2  A title  \d+\.\d s$", progress.getvalue(), re.MULTILINE
    )

    terminal = Terminal()
    notebooks.run(path, terminal)
    assert path.read_bytes() == first and path.stat().st_mtime_ns == changed
    assert (
        terminal.getvalue().count("\n") == 1
        and "\r\033[K01_sum  cell 1 of 2  A title" in terminal.getvalue()
    )


def test_runner_leaves_a_failing_notebook_alone(folder, capsys):
    path = write(folder / "02_fails.ipynb", "1 + 1", "raise ValueError('the reason')")
    before = path.read_bytes()
    with pytest.raises(CellExecutionError, match="the reason"):
        notebooks.run(path, io.StringIO())
    assert notebooks.main(["run", "02_fails"]) == 1
    assert "ValueError: the reason" in capsys.readouterr().err
    assert path.read_bytes() == before and list(folder.iterdir()) == [path]


def test_runner_skips_the_scans_notebook_without_scans(folder, monkeypatch, capsys):
    monkeypatch.setattr(paths, "SCANS", folder / "scans")
    path = write(folder / f"{scans.NOTEBOOK}.ipynb", "1 + 1")
    before = path.read_bytes()
    assert notebooks.main(["run", scans.NOTEBOOK]) == 0
    assert "make scans" in capsys.readouterr().out
    assert path.read_bytes() == before


# ---------------------------------------------------------------- notebooks compared by `make test`

WRITE = """import os
from pathlib import Path
table = Path(os.environ["ANALYSIS_OUTPUT"], "data", "results", "{stem}_radius.csv")
table.parent.mkdir(parents=True, exist_ok=True)
_ = table.write_text("radius_m\\n{radius}\\n")
print({radius})"""


def stand_in(root, stem, radius, committed):
    """A tiny notebook of that name, stored as executed, and its committed table."""
    cell = new_code_cell(
        WRITE.format(stem=stem, radius=radius),
        execution_count=1,
        outputs=[new_output("stream", name="stdout", text=f"{radius}\n")],
    )
    nbformat.write(new_notebook(cells=[cell]), root / "notebooks" / f"{stem}.ipynb")
    (root / "data" / "results" / f"{stem}_radius.csv").write_text(f"radius_m\n{committed}\n")


def compare(root, *variables):
    """The step of `make test` that runs the notebooks again, in a copy of the project."""
    if not shutil.which("make"):
        pytest.skip("make is not installed")
    words = [
        "make",
        "-o",
        ".venv/environment.stamp",
        f"IN_VENV='{sys.executable}'",
        "compare",
        *variables,
    ]
    clean = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(("PYTEST", "MAKE", "ANALYSIS_OUTPUT", "NO_NOTEBOOKS", "MFLAGS"))
    }
    return subprocess.run(words, cwd=root, env=clean, capture_output=True, text=True)


@pytest.fixture
def copied(tmp_path):
    """The project without data, notebooks and scans, in a folder with blanks in its name."""
    root = tmp_path / "a new user"
    ignored = shutil.ignore_patterns("__pycache__", "*.egg-info")
    shutil.copytree(paths.ROOT / "src", root / "src", ignore=ignored)
    for name in ("Makefile", "conftest.py", "pyproject.toml", "tests/project/test_results.py"):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(paths.ROOT / name, root / name)
    (root / "notebooks").mkdir()
    (root / "data" / "results").mkdir(parents=True)
    stand_in(root, "01_simulated_sphere", 0.25, 0.25)
    return root


def test_without_scans_the_notebooks_pass_and_one_sentence_says_what_is_left_out(copied):
    stand_in(copied, scans.NOTEBOOK, 1 / 3, 0.5)  # would fail if it were run
    done = compare(copied)
    assert done.returncode == 0, done.stdout + done.stderr
    first = done.stdout.partition("test_results.py")[0]
    assert first.count(f"{scans.NOTEBOOK} is not run") == 1 and "1 passed" in first


def test_a_table_that_is_not_written_again_fails(copied):
    stand_in(copied, "02_sphere_methods", 0.25, 0.26)
    done = compare(copied, "TOGETHER=")  # in one process
    assert done.returncode != 0 and "0.25 instead of 0.26" in done.stdout


# -------------------------------------------------------------------------------------------- scans


@pytest.fixture
def server(tmp_path, monkeypatch):
    """Address of a local server with one good scan and one with other content than its hash says; a
    third name has no file.
    """
    source = tmp_path / "server"
    source.mkdir()
    (source / "good.xyz").write_text("1\t2\t3\n")
    (source / "bad.xyz").write_text("truncat")
    hashes = {
        "good.xyz": hashlib.sha256(b"1\t2\t3\n").hexdigest(),
        "bad.xyz": "0" * 64,
        "absent.xyz": "1" * 64,
    }
    monkeypatch.setattr(scans, "SHA256", hashes)
    monkeypatch.setenv("no_proxy", "127.0.0.1")

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *arguments):
            pass

    with http.server.ThreadingHTTPServer(
        ("127.0.0.1", 0), functools.partial(Quiet, directory=source)
    ) as httpd:
        threading.Thread(target=httpd.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{httpd.server_port}/"
        httpd.shutdown()


def test_scans_are_downloaded_once(server, tmp_path, capsys):
    target = tmp_path / "scans"
    scans.fetch(["good.xyz"], target, server)
    assert (target / "good.xyz").read_bytes() == b"1\t2\t3\n"
    scans.fetch(["good.xyz"], target, "http://127.0.0.1:1/")  # nobody answers there
    assert "1 of 1 scans are there" in capsys.readouterr().out


def test_scan_with_wrong_hash_is_not_kept(server, tmp_path):
    target = tmp_path / "scans"
    found = hashlib.sha256(b"truncat").hexdigest()
    with pytest.raises(
        scans.ScanError, match=f"bad.xyz.*expected SHA-256 {'0' * 64}, found {found}"
    ):
        scans.fetch(["bad.xyz"], target, server)
    assert not target.exists() or list(target.iterdir()) == []


def test_scan_that_is_not_there_is_named(server, tmp_path):
    with pytest.raises(scans.ScanError, match="absent.xyz could not be downloaded"):
        scans.fetch(["absent.xyz"], tmp_path / "scans", server)


def test_scans_are_taken_from_a_folder(server, tmp_path, capsys):
    source, target = tmp_path / "server", tmp_path / "scans"
    scans.copy(source, ["good.xyz", "absent.xyz"], target)
    assert [path.name for path in target.iterdir()] == ["good.xyz"]
    assert "Not in" in (said := capsys.readouterr().out) and "absent.xyz" in said
    with pytest.raises(scans.ScanError, match="bad.xyz is not the expected file"):
        scans.copy(source, ["bad.xyz"], target)
    with pytest.raises(scans.ScanError, match="holds none of"):
        scans.copy(tmp_path, ["good.xyz"], target)


def test_missing_scans_are_told(tmp_path, monkeypatch):
    monkeypatch.setattr(paths, "SCANS", tmp_path)
    assert scans.missing() == list(scans.NOTEBOOK_SCANS)
    for name in scans.NOTEBOOK_SCANS[1:]:
        (tmp_path / name).touch()
    assert scans.missing() == [scans.NOTEBOOK_SCANS[0]]
    assert scans.NOTEBOOK_SCANS[0] in scans.skip_reason(scans.NOTEBOOK)
    assert scans.skip_reason("01_simulated_sphere") is None
    (tmp_path / scans.NOTEBOOK_SCANS[0]).touch()
    assert scans.skip_reason(scans.NOTEBOOK) is None


def test_needed_scans_are_known():
    assert len(scans.SHA256) == 11 and set(scans.NOTEBOOK_SCANS) <= set(scans.SHA256)


# ------------------------------------------------------------------------------------------- README

TEXT = "before\n<!-- begin generated: one -->\nold\n<!-- end generated: one -->\nafter\n"


def test_readme_sections_are_renewed(tmp_path, capsys):
    path = tmp_path / "README.md"
    path.write_text(TEXT)
    sections = {"one": lambda: "| new |"}
    assert readme.main(["--check"], path, sections) == 1
    assert path.read_text() == TEXT and "make readme" in capsys.readouterr().err
    assert readme.main([], path, sections) == 0
    assert path.read_text() == TEXT.replace("old", "\n| new |\n")
    assert readme.main(["--check"], path, sections) == 0
    readme.main(["--show", "one"], path, sections)
    assert capsys.readouterr().out.endswith("| new |\n")


@pytest.mark.parametrize(
    ("text", "sections", "message"),
    [
        (TEXT, {}, "with a function: \\[\\]"),
        (TEXT, {"one": str, "two": str}, "with a function: .*two"),
        (TEXT.replace("<!-- end generated: one -->", ""), {"one": str}, "without its end line"),
    ],
)
def test_readme_mistakes_are_named(text, sections, message):
    with pytest.raises(ValueError, match=message):
        readme.generate(text, sections)


def test_readme_is_up_to_date():
    assert readme.main(["--check"]) == 0


def test_the_counts_of_the_headline_are_those_of_the_audit():
    headline = readme.PATTERN.search(readme.README.read_text(encoding="utf-8"))
    assert headline["name"] == "headline"
    audited = readme.audited()
    for text in (headline[0], " ".join(readme.TERMINAL["headline"]().split())):
        assert f"{len(audited)} printed numbers and claims: " in text
        for verdict, count in audited["verdict"].value_counts().items():
            assert f"{count} {verdict}" in text


@pytest.mark.parametrize("name", ["README.md", "CONTRIBUTING.md", "data/README.md"])
def test_files_that_are_named_are_there(name):
    """Paths between backticks and in links; scans are fetched."""
    text = (paths.ROOT / name).read_text(encoding="utf-8")
    folders = "src|data|tests|notebooks|figures"
    for one in re.findall(rf"(?:`|\]\()((?:{folders})/[\w/.-]+)[`)]", text):
        assert one.startswith("data/scans") or (paths.ROOT / one).exists(), one


# --------------------------------------------------------------------------------------------- site


def test_site_has_a_page_for_each_notebook(tmp_path):
    source = tmp_path / "notebooks"
    source.mkdir()
    path = write(source / "01_first.ipynb", "1 + 1")
    notebook = nbformat.read(path, as_version=4)
    notebook.cells.append(new_markdown_cell("[next](02_second.ipynb)"))
    nbformat.write(notebook, path)
    write(source / "02_second.ipynb", "2 + 2")
    index = site.build(source, tmp_path / "site").read_text(encoding="utf-8")
    assert index.index('href="01_first.html">A title') < index.index(
        'href="02_second.html">A title'
    )
    assert "Some <em>text</em>" in index
    assert 'href="02_second.html"' in (tmp_path / "site" / "01_first.html").read_text(
        encoding="utf-8"
    )


def test_every_exported_table_is_described():
    """data/README.md names it in full, or after one of the same notebook as `…_rest`."""
    text = (paths.ROOT / "data" / "README.md").read_text(encoding="utf-8")
    notebooks = [path.stem for path in paths.NOTEBOOKS.glob("*.ipynb")]
    for table in paths.RESULTS.glob("*.csv"):
        (notebook,) = (name for name in notebooks if table.stem.startswith(name))
        rest = table.stem.removeprefix(notebook)
        described = [
            line
            for line in text.splitlines()
            if f"`{notebook}" in line and (f"`{table.stem}`" in line or f"`…{rest}`" in line)
        ]
        assert described, f"{table.name} is not described in data/README.md"
