"""The house: project → studies → analysis, imports go this way only; inside analysis no circle."""

import ast
import functools
import json
import re
from pathlib import Path

import pytest

from studies import paths

SRC = paths.ROOT / "src"
BELOW = {"analysis": {"analysis"}, "studies": {"analysis", "studies"}}
BELOW["project"] = {"analysis", "studies", "project"}
# The files and folders of analysis from the ground up: each imports what lies below it. The result
# of a fit and the adjustment are one room: igg3 returns a fit, a fit says how its iteration ended.
FLOORS = (
    ("blocks", "export", "reading"),
    ("checks",),
    ("adjustment and result", "scanner"),
    ("orthogonal", "similarity"),
    ("surfaces", "trust"),
    ("methods",),
    ("tunnel", "the public names"),
    ("__main__",),
)
ONE_ROOM = dict.fromkeys(("adjustment", "result"), "adjustment and result")


def name_of(path):
    """Dotted name of the module in a file."""
    parts = path.relative_to(SRC).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


PAPERS = ("ou_liu_2017", "wu_chen_wang", "li_2015")
MODULES = {name_of(path): path for path in sorted(SRC.rglob("*.py"))}


def imports(tree, module="", package=""):
    """Names of modules of src that the statements of a syntax tree import."""
    found = set()
    for node in tree:
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            home = package.split(".")[: len(package.split(".")) - node.level + 1]
            base = ".".join(
                [*(home if node.level else []), *([node.module] if node.module else [])]
            )
            found |= {
                inner if (inner := f"{base}.{alias.name}") in MODULES else base
                for alias in node.names
            }
    return {name for name in found if name.partition(".")[0] in BELOW and name != module}


def imports_of(name, statements):
    path = MODULES[name]
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    return imports(statements(ast.parse(path.read_text(encoding="utf-8"))), name, package)


def at_import(tree):
    """The statements that run when a module is imported: not those inside functions, nor those for
    a type checker alone.
    """
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            continue
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        yield node
        yield from at_import(node)


@pytest.mark.parametrize("name", MODULES)
def test_imports_go_down_only(name):
    allowed = BELOW[name.partition(".")[0]]
    used = {other.partition(".")[0] for other in imports_of(name, ast.walk)}
    assert used <= allowed, f"{name} imports {used - allowed}"


@pytest.mark.parametrize("paper", PAPERS)
def test_no_paper_imports_from_another(paper):
    own = [name for name in MODULES if name.startswith(f"studies.{paper}.")]
    assert own
    others = tuple(f"studies.{other}" for other in PAPERS if other != paper)
    assert not [
        (name, used)
        for name in own
        for used in imports_of(name, ast.walk)
        if used.startswith(others)
    ]


def solvers():
    """Module of analysis -> the modules of analysis that it imports when it is imported."""
    return {
        name: {other for other in imports_of(name, at_import) if other.startswith("analysis")}
        for name in MODULES
        if name.startswith("analysis")
    }


def test_analysis_has_no_circle():
    graph, way = solvers(), []

    @functools.cache
    def follow(name):
        assert name not in way, f"a circle: {' → '.join([*way, name])}"
        way.append(name)
        for other in graph[name]:
            follow(other)
        way.pop()

    for name in graph:
        follow(name)


def room(name):
    """The file or folder of analysis in which a module lies."""
    first = (name.split(".") + ["the public names"])[1]
    return ONE_ROOM.get(first, first)


def test_rooms_of_analysis_import_what_lies_below():
    floor = {one: height for height, rooms in enumerate(FLOORS) for one in rooms}
    assert set(map(room, solvers())) == set(floor)
    for name, others in solvers().items():
        for other in others:
            assert room(name) == room(other) or floor[room(other)] < floor[room(name)], (
                f"{name} imports {other}"
            )


def test_analysis_knows_no_data_of_the_papers():
    words = re.compile(r"data/(published|simulated|results|scans)|notebooks/|\bnotebook \d")
    for name in solvers():
        found = words.search(MODULES[name].read_text(encoding="utf-8"))
        assert not found, f"{name}: {found[0]}"


@pytest.mark.parametrize(
    "path", sorted(paths.NOTEBOOKS.glob("*.ipynb")), ids=lambda path: path.stem
)
def test_notebooks_import_solvers_and_studies(path):
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    code = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    used = {name.partition(".")[0] for name in imports(ast.walk(ast.parse(code)))}
    assert used <= {"analysis", "studies"}


def test_the_layers_are_all_of_src():
    found = {path.name for path in Path(SRC).iterdir() if (path / "__init__.py").is_file()}
    assert found == set(BELOW)
