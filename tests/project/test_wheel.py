"""A wheel of the project holds the solvers alone, and they work with nothing around them."""

import os
import re
import shutil
import subprocess
import sys
import zipfile

import pytest
from packaging.requirements import Requirement

import analysis
from studies import paths
from studies.ou_liu_2017.clouds import SPHERE_FILES


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel, built by the locked setuptools from a copy of what it needs."""
    copy, built = tmp_path_factory.mktemp("copy"), tmp_path_factory.mktemp("built")
    ignored = shutil.ignore_patterns("__pycache__", "*.egg-info")
    shutil.copytree(paths.ROOT / "src", copy / "src", ignore=ignored)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(paths.ROOT / name, copy)
    pip("wheel", "--no-build-isolation", "--wheel-dir", built, copy)
    (wheel,) = built.iterdir()
    return wheel


def pip(command, *arguments):
    words = [sys.executable, "-m", "pip", command, "--quiet", "--no-index", "--no-deps"]
    subprocess.run([*words, *arguments], check=True)


def test_it_holds_analysis_alone_and_brings_four_libraries(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    (metadata,) = (name for name in names if name.endswith(".dist-info/METADATA"))
    assert {name.partition("/")[0] for name in names} == {"analysis", metadata.partition("/")[0]}
    assert "analysis/py.typed" in names
    text = zipfile.ZipFile(wheel).read(metadata).decode()
    asked = [Requirement(line) for line in re.findall(r"^Requires-Dist: (.*)$", text, re.MULTILINE)]
    brought = {
        one.name for one in asked if one.marker is None or one.marker.evaluate({"extra": ""})
    }
    assert brought == {"numpy", "scipy", "pandas", "tqdm"}
    assert f"\nVersion: {analysis.__version__}\n" in text


def test_scanfit_works_in_an_empty_folder(wheel, tmp_path):
    pip("install", "--target", tmp_path / "site", wheel)
    empty = tmp_path / "empty"
    empty.mkdir()
    cloud = shutil.copy(SPHERE_FILES[False], tmp_path / "cloud.csv")
    command = [tmp_path / "site" / "bin" / "scanfit", "fit", "sphere", cloud, "--json"]
    environment = os.environ | {"PYTHONPATH": str(tmp_path / "site")}
    done = subprocess.run(command, cwd=empty, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert '"radius' in done.stdout and list(empty.iterdir()) == []


def test_the_citation_has_its_version():
    text = (paths.ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {analysis.__version__}\n" in text
