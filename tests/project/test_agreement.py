"""Results that agree with the committed ones leave the tree alone; what differs gets in."""

import subprocess
from pathlib import Path

import nbformat
import pandas as pd
import pytest
from nbformat.v4 import new_code_cell, new_notebook, new_output

from project import agreement, scans
from studies import paths

TABLE = "method,radius_m\nls,0.202300001\ntls,nan\n"
NOISE = TABLE.replace("0.202300001", "0.202300002")
OTHER = TABLE.replace("0.202300001", "0.202400001")


def test_differences_are_seen():
    table = pd.DataFrame({"method": ["ls", "tls"], "radius": ["0.2023", "nan"]})
    noise = pd.DataFrame({"method": ["ls", "tls"], "radius": ["0.20230000001", "nan"]})
    other = pd.DataFrame({"method": ["ls", "wtls"], "radius": ["0.2024", "0.1"]})
    assert agreement.table_differences(noise, table) == []
    assert agreement.table_differences(other, table) == [
        "row 1, method: wtls instead of tls",
        "row 0, radius: 0.2024 instead of 0.2023",
        "row 1, radius: 0.1 instead of nan",
    ]
    assert agreement.table_differences(table[:1], table) == ["1 rows instead of 2"]
    assert agreement.table_differences(table[["radius"]], table)[0].startswith("columns")


@pytest.mark.parametrize(
    ("found", "expected", "agree"),
    [
        ("r = 0.2023 m", "r = 0.2023 m", True),
        ("r = 0.2024 m", "r = 0.2023 m", True),
        ("r = 0.2025 m", "r = 0.2023 m", False),
        ("  9.99", " 10.00", True),
        ("6.70e-02", "6.71e-02", True),
        ("6.70e-02", "6.70e-03", False),
        ("7 points", "8 points", False),
        ("-0.3", "0.3", False),
        ("ls  0.3", "tls  0.3", False),
        ("0.3  0.4", "0.3", False),
    ],
)
def test_printed_numbers_may_differ_in_their_last_digit(found, expected, agree):
    assert agreement.texts_agree(found, expected) is agree


def notebook(printed, source="print(r)", picture="one"):
    """Bytes of an executed notebook that prints a text and shows a picture."""
    shown = new_output("display_data", {"text/plain": "<Figure>", "image/png": picture})
    outputs = [new_output("stream", name="stdout", text=printed), shown]
    cell = new_code_cell(source, id="cell-01", execution_count=1, outputs=outputs)
    return f"{nbformat.writes(new_notebook(cells=[cell]))}\n".encode()


def test_notebooks_agree_by_their_cells_and_texts():
    committed = notebook("0.2023")
    assert agreement.notebooks_agree(notebook("0.2024", picture="other"), committed)
    assert not agreement.notebooks_agree(notebook("0.2030"), committed)
    assert not agreement.notebooks_agree(notebook("0.2023", "print(s)"), committed)


FILES = {
    "data/results/01_sum_radius.csv": TABLE.encode(),
    "figures/01_sum_radius.png": b"picture",
    "figures/01_sum_radius.svg": b"drawing",
    "notebooks/01_sum.ipynb": notebook("0.2023"),
    "src/analysis/sum.py": b"r = 1\n",
}
NOTEBOOK = "notebooks/01_sum.ipynb"


@pytest.fixture(params=["git", "no git"])
def tree(tmp_path, monkeypatch, request):
    """A small tree whose files are committed, or that has no git."""
    root = tmp_path / "a tree"
    for name, folder in (("RESULTS", "data/results"), ("SIMULATED", "data/simulated")):
        monkeypatch.setattr(paths, name, root / folder)
    for name, folder in (("ROOT", ""), ("FIGURES", "figures"), ("SCANS", "data/scans")):
        monkeypatch.setattr(paths, name, root / folder)
    monkeypatch.setattr(scans, "skip_reason", lambda notebook: None)
    fill(root, FILES)
    if request.param == "git":
        who = ["-c", "user.name=a", "-c", "user.email=a@b"]
        for words in (["init"], ["add", "."], [*who, "commit", "-m", "all"]):
            subprocess.run(["git", *words], cwd=root, check=True, capture_output=True)
    return root


def fill(folder, contents):
    for name, content in contents.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


def settle(tmp_path, table=TABLE, printed="0.2023", picture=b"picture"):
    """Settle a run of the notebook that wrote these."""
    names = list(FILES)[:3]
    written = tmp_path / "written"
    fill(written, dict(zip(names, [table.encode(), picture, picture], strict=True)))
    return agreement.settle(written, Path(NOTEBOOK), notebook(printed))


def content(root):
    return {name: (root / name).read_bytes() for name in FILES}


def test_noise_leaves_the_tree_alone(tree, tmp_path):
    assert settle(tmp_path, NOISE, "0.2024", b"other bytes") == []
    assert content(tree) == FILES
    assert agreement.report() == ["1 of 1 tables and 1 of 1 figures agree with the committed ones"]


def test_what_differs_gets_in_and_is_named(tree, tmp_path):
    assert [path.name for path in settle(tmp_path, OTHER, "0.2024", b"new")] == [
        "01_sum_radius.csv"
    ]
    found = content(tree)
    assert found["data/results/01_sum_radius.csv"] == OTHER.encode()
    assert found["figures/01_sum_radius.png"] == b"new"
    assert found[NOTEBOOK] == notebook("0.2024")
    assert agreement.report() == [
        "does not agree: data/results/01_sum_radius.csv",
        "does not agree: the figure 01_sum_radius",
        "0 of 1 tables and 0 of 1 figures agree with the committed ones",
    ]
    settle(tmp_path, NOISE, "0.2023", b"as before")
    assert content(tree) == FILES


def test_a_lost_figure_comes_back(tree, tmp_path):
    (tree / "figures" / "01_sum_radius.svg").unlink()
    settle(tmp_path)
    assert (tree / "figures" / "01_sum_radius.svg").is_file()


def test_a_new_look_gets_in_while_the_code_has_changes(tree, tmp_path):
    if not (tree / ".git").exists():
        pytest.skip("only git knows what has changed")
    (tree / "src" / "analysis" / "sum.py").write_text("r = 2\n")
    settle(tmp_path, NOISE, picture=b"new")
    assert content(tree)["figures/01_sum_radius.png"] == b"new"
    assert content(tree)["data/results/01_sum_radius.csv"] == TABLE.encode()


def test_files_of_a_skipped_notebook_do_not_count(tree, monkeypatch):
    monkeypatch.setattr(scans, "NOTEBOOK", "01_sum")
    monkeypatch.setattr(scans, "skip_reason", lambda notebook: "01_sum is not run.")
    assert agreement.report() == [
        "01_sum is not run.",
        "0 of 0 tables and 0 of 0 figures agree with the committed ones",
    ]
