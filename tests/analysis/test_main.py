"""The command line: what it prints, and the exit status."""

import json
import subprocess
import sys

import numpy as np
import pytest

from analysis import SPHERE_METHODS, ConvergenceWarning, fit_plane, fit_sphere, read_points
from analysis.__main__ import SURFACES, main

CENTER, RADIUS = np.array([10.0, -20.0, 1.5]), 0.0725


@pytest.fixture
def scan(tmp_path):
    """A scan of 300 points, noise 1 mm."""
    rng = np.random.default_rng(8)
    directions = rng.standard_normal((300, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    path = tmp_path / "scan.xyz"
    np.savetxt(
        path, CENTER + RADIUS * directions + 1e-3 * rng.standard_normal((300, 3)), fmt="%.5f"
    )
    return str(path)


def fail(capsys, *arguments):
    """Run what must fail with status 2, and return the one line on stderr."""
    assert main([*arguments]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count("\n") == 1 and printed.err.endswith("\n")
    return printed.err.rstrip()


@pytest.mark.parametrize("method", SPHERE_METHODS)
def test_text(method, scan, capsys):
    assert main(["fit", "sphere", scan, "--method", method]) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    fit = fit_sphere(read_points(scan), method)
    lines = printed.out.splitlines()
    assert lines[0].startswith(f"{scan}: 300 points; ") and SPHERE_METHODS[method].label in lines[1]
    sd = 1e3 * fit.standard_deviations
    assert lines[3].split() == [
        "centre",
        "x",
        f"{fit.center[0]:.5f}",
        "m",
        "±",
        f"{sd[0]:.3f}",
        "mm",
    ]
    assert lines[6].split() == ["radius", f"{fit.radius:.5f}", "m", "±", f"{sd[3]:.3f}", "mm"]
    assert f"{1e3 * fit.sigma_s:.3f} mm  RMS distance of all points" in printed.out
    assert f"{np.count_nonzero(fit.inliers)} of 300  in use" in printed.out
    assert lines[-1].endswith(fit.stop_reason)


def test_the_unit_of_sigma_0(scan, capsys):
    for method, unit in {"ls": "m²", "tls": "m²", "wtls": "m", "igg3_wtls": "m"}.items():
        main(["fit", "sphere", scan, "--method", method])
        (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("σ0")]
        assert line.split()[2] == unit


def test_json(scan, capsys):
    assert main(["fit", "sphere", scan, "--method", "igg3_wtls", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    fit = fit_sphere(read_points(scan), "igg3_wtls")
    # to the last bit
    assert found["center"] == fit.center.tolist() and found["radius"] == fit.radius
    assert found["standard_deviations"] == fit.standard_deviations.tolist()
    assert found["covariance"] == fit.covariance.tolist()
    assert (found["method"], found["points"], found["inliers"]) == (
        "igg3_wtls",
        300,
        np.count_nonzero(fit.inliers),
    )
    assert (found["converged"], found["stop_reason"]) == (True, fit.stop_reason)


def test_the_default_method_is_that_of_the_function(scan, capsys):
    assert main(["fit", "sphere", scan, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["method"] == fit_sphere(read_points(scan)).method


def test_without_redundancy_the_standard_deviations_are_not_defined(tmp_path, capsys):
    path = tmp_path / "four.xyz"
    path.write_text("1 1 1\n2 1 1\n1 2 1\n1 1 2\n")
    assert main(["fit", "sphere", str(path), "--method", "ls"]) == 0
    assert "1.50000 m  ± – mm" in capsys.readouterr().out
    assert main(["fit", "sphere", str(path), "--method", "ls", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["standard_deviations"] == [None] * 4


def test_a_result_that_did_not_converge_is_printed_with_status_1(scan, monkeypatch, capsys):
    surface = SURFACES["sphere"]

    def stopped_early(points, method):
        return fit_sphere(points, method, max_iterations=2)

    monkeypatch.setitem(
        SURFACES,
        "sphere",
        type(surface)(stopped_early, surface.methods, surface.quantities, surface.described),
    )
    monkeypatch.setattr(type(surface), "default", "igg3_wtls")
    assert main(["fit", "sphere", scan]) == 1
    printed = capsys.readouterr()
    assert (
        "centre x" in printed.out
        and "not converged: " in printed.out.splitlines()[-1]
        and printed.err == ""
    )
    assert main(["fit", "sphere", scan, "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["converged"] is False
    with pytest.warns(ConvergenceWarning):
        stopped_early(read_points(scan), "igg3_wtls")


def test_bad_files(tmp_path, capsys):
    missing = str(tmp_path / "no.xyz")
    assert (
        fail(capsys, "fit", "sphere", missing) == f"analysis: {missing}: No such file or directory"
    )
    text = tmp_path / "bad.xyz"
    text.write_text("0 0 0\n1 one 0\n")
    assert fail(capsys, "fit", "sphere", str(text)).startswith(
        f"analysis: {text}: line 2: expected finite numbers x, y, z"
    )
    assert "expected a file ending in" in fail(capsys, "fit", "sphere", str(tmp_path))


def test_columns_and_unit_are_told_and_reported(tmp_path, scan, capsys):
    points = read_points(scan)
    path = tmp_path / "numbered.txt"
    np.savetxt(path, np.column_stack([np.arange(300), 1e3 * points]), fmt="%d %.2f %.2f %.2f")
    assert "--columns 2,3,4" in fail(capsys, "fit", "sphere", str(path))
    command = ["fit", "sphere", str(path), "--columns", "2,3,4", "--unit", "mm", "--json"]
    assert main(command) == 0
    found = json.loads(capsys.readouterr().out)
    np.testing.assert_allclose(found["center"], fit_sphere(points).center, rtol=0, atol=1e-9)
    assert found["reading"]["columns"] == [2, 3, 4] and found["reading"]["unit"] == "mm"
    assert main(command[:-1]) == 0
    assert "x y z in columns 2,3,4 (given); unit mm (given)" in capsys.readouterr().out


def test_bad_data(tmp_path, capsys):
    path = tmp_path / "flat.xyz"
    path.write_text("0 0 0\n1 0 0\n0 1 0\n")
    assert fail(capsys, "fit", "sphere", str(path)).startswith(
        f"analysis: {path}: points: expected at least 4 points"
    )
    path.write_text("0 0 0\n1 0 0\n0 1 0\n3 4 0\n1 1 0\n")
    assert "expected points that determine a sphere" in fail(capsys, "fit", "sphere", str(path))


def test_held_radius(scan, capsys):
    assert main(["fit", "sphere", scan, "--radius", "0.073", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["radius"] == 0.073 and result["standard_deviations"][3] == 0
    assert "eiv, geometric, robust" in fail(
        capsys, "fit", "sphere", scan, "--radius", "0.073", "--method", "ls"
    )
    assert "radius: expected a positive finite number" in fail(
        capsys, "fit", "sphere", scan, "--radius", "-1"
    )


@pytest.mark.parametrize(
    "arguments",
    [[], ["fit"], ["fit", "cube", "scan.xyz"], ["fit", "sphere", "scan.xyz", "--method", "best"]],
)
def test_bad_arguments_end_with_status_2(arguments, capsys):
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2


def test_help_lists_every_method(capsys):
    with pytest.raises(SystemExit):
        main(["fit", "sphere", "--help"])
    text = capsys.readouterr().out
    assert all(
        f"  {name} " in text and method.label in text for name, method in SPHERE_METHODS.items()
    )


def test_as_a_module_from_a_terminal_without_greek_letters(scan):
    command = [sys.executable, "-m", "analysis", "fit", "sphere", scan, "--method", "ls"]
    ended = subprocess.run(command, capture_output=True, env={"PYTHONIOENCODING": "ascii"})
    assert (ended.returncode, ended.stderr) == (0, b"")
    assert b"radius" in ended.stdout


LOADED = """
import sys
import analysis
from analysis.__main__ import main
assert main(["fit", "sphere", sys.argv[1]]) == 0
print(*sorted({module.partition(".")[0] for module in sys.modules}), file=sys.stderr)
"""


def test_a_fit_loads_nothing_for_pictures_studies_or_other_formats(scan, tmp_path):
    command = [sys.executable, "-c", LOADED, scan]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=True)
    loaded = set(done.stderr.split())
    assert {"analysis", "numpy"} <= loaded
    assert not loaded & {"matplotlib", "PIL", "joblib", "IPython", "nbformat", "nbclient"}
    assert not loaded & {"laspy", "pye57", "studies", "project"}


@pytest.fixture
def wall(tmp_path):
    """A scan of 200 points of a vertical plane, noise 1 mm."""
    rng = np.random.default_rng(9)
    u, v = rng.uniform(0, 2, (2, 200))
    path = tmp_path / "wall.xyz"
    np.savetxt(
        path,
        np.column_stack([3 + 0.6 * u, 0.8 * u, v]) + 1e-3 * rng.standard_normal((200, 3)),
        fmt="%.5f",
    )
    return str(path)


def test_plane(wall, capsys):
    assert main(["fit", "plane", wall]) == 0
    lines = capsys.readouterr().out.splitlines()
    fit = fit_plane(read_points(wall))
    sd = 1e3 * np.sqrt(np.diagonal(fit.normal_covariance))
    assert lines[3].split() == ["normal", "x", f"{fit.normal[0]:.5f}", "±", f"{sd[0]:.3f}", "mrad"]
    assert lines[6].split() == ["offset", f"{fit.offset:.5f}", "m", "±", f"{sd[3]:.3f}", "mm"]
    assert main(["fit", "plane", wall, "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert (
        record["normal"] == fit.normal.tolist() and record["parameters"] == fit.parameters.tolist()
    )
    assert "not vertical" in fail(capsys, "fit", "plane", wall, "--method", "ls")


def test_what_a_check_says_is_printed_and_in_json(tmp_path, capsys):
    rng = np.random.default_rng(9)
    wall = np.column_stack([rng.uniform(-0.3, 0.3, (200, 2)), 1e-3 * rng.standard_normal(200)])
    path = tmp_path / "wall.xyz"
    np.savetxt(path, wall, fmt="%.6f")
    assert main(["fit", "sphere", str(path)]) == 1
    printed = capsys.readouterr().out
    assert main(["fit", "sphere", str(path), "--json"]) == 1
    checks = json.loads(capsys.readouterr().out)["checks"]
    speaking = [check for check in checks if not check["passed"]]
    assert "seen" in {check["name"] for check in speaking} and len(speaking) < len(checks)
    for check in speaking:
        assert f"{check['name']}: {check['sentence']}" in printed


def test_a_check_that_makes_the_result_unusable_decides_the_exit_status(tmp_path, capsys):
    path = tmp_path / "clutter.xyz"
    np.savetxt(path, np.random.default_rng(10).uniform(-1.0, 1.0, (200, 3)), fmt="%.6f")
    assert main(["fit", "sphere", str(path), "--method", "geometric", "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["converged"] and "chance" in {
        c["name"] for c in found["checks"] if not c["passed"]
    }
