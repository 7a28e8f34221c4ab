"""Command line.

    python -m analysis fit sphere scan.xyz [--method NAME] [--radius R] [--json]
    python -m analysis fit plane scan.xyz [--method NAME] [--json]
    python -m analysis tunnel EPOCH1 EPOCH2 [--spacing M] [--thickness M] [--registration M]
                                            [--output DIR] [--json]

Exit status 0: a result. 1: a result that did not converge, or fails a check that makes it unusable.
2: no result, and one line on stderr says why.
"""

from __future__ import annotations

import argparse
import inspect
import io
import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from .methods import PLANE_METHODS, SPHERE_METHODS, Method, fit_plane, fit_sphere
from .reading import UNITS, Report, read_scan
from .result import Fit, ignore_convergence_warnings
from .surfaces.plane import PlaneFit
from .surfaces.sphere import SphereFit
from .trust import Check
from .tunnel import command as tunnel


@dataclass(frozen=True)
class Surface:
    """A surface that can be fitted, and how its results are told.

    quantities : their names in the result
    described : gives for a fit the label, value, unit, standard deviation and its unit of each
        quantity
    fixed : parameters, lengths in m, that can be given instead of estimated
    """

    fit: Callable[..., Fit]
    methods: Mapping[str, Method]
    quantities: tuple[str, ...]
    described: Callable[[Any], list[tuple[str, float, str, float, str]]]
    fixed: tuple[str, ...] = ()

    @property
    def default(self) -> str:
        return inspect.signature(self.fit).parameters["method"].default


def _sphere(fit: SphereFit) -> list[tuple[str, float, str, float, str]]:
    labels = ("centre x", "centre y", "centre z", "radius")
    return [
        (label, value, "m", 1e3 * sd, "mm")
        for label, value, sd in zip(labels, fit.parameters, fit.standard_deviations, strict=True)
    ]


def _plane(fit: PlaneFit) -> list[tuple[str, float, str, float, str]]:
    deviations = 1e3 * np.sqrt(np.diagonal(fit.normal_covariance))
    rows = [
        (f"normal {axis}", value, "", sd, "mrad")
        for axis, value, sd in zip("xyz", fit.normal, deviations[:3], strict=True)
    ]
    rows.append(("offset", fit.offset, "m", deviations[3], "mm"))
    units = (("", "mm/m"), ("", "mm/m"), ("m", "mm"))
    slopes = zip(("a", "b", "c"), fit.parameters, fit.standard_deviations, units, strict=True)
    return rows + [
        (f"{label} of z = a x + b y + c", value, unit, 1e3 * sd, of_sd)
        for label, value, sd, (unit, of_sd) in slopes
    ]


SURFACES = {
    "sphere": Surface(fit_sphere, SPHERE_METHODS, ("center", "radius"), _sphere, ("radius",)),
    "plane": Surface(fit_plane, PLANE_METHODS, ("normal", "offset", "normal_covariance"), _plane),
}


def main(arguments: list[str] | None = None) -> int:
    """Run the command line and return the exit status."""
    options = _parser().parse_args(arguments)
    try:
        return options.run(options)
    except (OSError, ValueError, ImportError) as error:
        print(f"analysis: {_one_line(error)}", file=sys.stderr)
        return 2


def _fit(options: argparse.Namespace) -> int:
    surface = SURFACES[options.surface]
    fixed = {name: getattr(options, name) for name in surface.fixed}
    try:
        with ignore_convergence_warnings():  # the report says it
            points, reading = read_scan(options.file, columns=options.columns, unit=options.unit)
            fit = surface.fit(points, options.method, **fixed)
    except ValueError as error:
        raise ValueError(_after(options.file, str(error))) from error
    checks = fit.checks()
    if options.json:
        print(json.dumps(record(fit, checks, surface, options.file, reading), allow_nan=False))
    else:
        print(report(fit, checks, surface, options.file, reading))
    unusable = any(check.decisive and not check.passed for check in checks)
    return 1 if unusable or not fit.converged else 0


def report(fit: Fit, checks: Sequence[Check], surface: Surface, file: str, reading: Report) -> str:
    """The result for a reader: aligned plain text with units, a dash for what is not defined."""
    method = surface.methods[fit.method]
    rows = [
        (label, f"{_number(value, '.5f')} {unit}", f"± {_number(deviation, '.3f')} {of_deviation}")
        for label, value, unit, deviation, of_deviation in surface.described(fit)
    ]
    rows += [
        (
            "σ0",
            f"{_number(fit.sigma_0, '.4g')} {method.sigma_0_unit}",
            "unit-weight standard deviation",
        ),
        ("σs", f"{_number(1e3 * fit.sigma_s, '.3f')} mm", "RMS distance of all points"),
        (
            "",
            f"{_number(1e3 * fit.sigma_s_inliers, '.3f')} mm",
            "RMS distance of the points in use",
        ),
        ("points", f"{np.count_nonzero(fit.inliers)} of {len(fit.weights)}", "in use"),
        ("iterations", f"{fit.iterations}", str(fit.stop_reason)),
    ]
    width, indent = (max(len(row[column]) for row in rows) for column in (1, 0))
    lines = [f"{file}: {reading}", f"{method.label} ({method.citation})", ""]
    lines += [f"{name:<{indent}}  {value:>{width}}  {remark}" for name, value, remark in rows]
    spoken = [str(check) for check in checks if not check.passed]
    return "\n".join([*lines, "", *spoken] if spoken else lines)


def record(fit: Fit, checks: Sequence[Check], surface: Surface, file: str, reading: Report) -> dict:
    """The result for a program: lengths in m, nothing rounded; null for what is not defined."""
    values = {
        "file": file,
        "reading": asdict(reading),
        "method": fit.method,
        **{name: getattr(fit, name) for name in surface.quantities},
        "parameters": fit.parameters,
        "standard_deviations": fit.standard_deviations,
        "covariance": fit.covariance,
        "sigma_0": fit.sigma_0,
        "sigma_0_unit": surface.methods[fit.method].sigma_0_unit,
        "sigma_s": fit.sigma_s,
        "sigma_s_inliers": fit.sigma_s_inliers,
        "points": len(fit.weights),
        "inliers": np.count_nonzero(fit.inliers),
        "iterations": fit.iterations,
        "converged": fit.converged,
        "stop_reason": fit.stop_reason,
        "checks": [asdict(check) for check in checks],
    }
    return {name: _plain(value) for name, value in values.items()}


def _parser() -> argparse.ArgumentParser:
    described = "Fit surfaces to the points of laser scans, and compare two scans of a tunnel."
    parser = argparse.ArgumentParser(prog="python -m analysis", description=described)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    fit = commands.add_parser(
        "fit", help="fit a surface to a scan", description="Fit a surface to the points of a scan."
    )
    surfaces = fit.add_subparsers(dest="surface", required=True, metavar="SURFACE")
    for name, surface in SURFACES.items():
        listed = "\n".join(
            f"  {key:<14} {method.label}; {method.citation}"
            for key, method in surface.methods.items()
        )
        command = surfaces.add_parser(
            name,
            help=f"fit a {name}",
            description=f"Fit a {name} to the points of a scan "
            "and print its parameters with their standard deviations.",
            epilog=f"methods:\n{listed}\n\nexit status: 0 a result, "
            "1 a result that did not converge or fails a check that makes it unusable, 2 no result",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        command.add_argument(
            "file",
            help="scan: x y z of one point per line (.xyz .txt .csv .pts .asc .dat .xyzi, "
            "also .gz), or .ptx .pcd .ply .las .laz .e57",
        )
        command.add_argument(
            "--columns",
            type=_columns,
            metavar="X,Y,Z",
            help="columns of x, y, z in a text file, counted from 1, for example 2,3,4 "
            "(default: by its heading, else the first three)",
        )
        command.add_argument(
            "--unit", choices=UNITS, help="unit of the file (default: as its heading says, else m)"
        )
        command.add_argument(
            "--method",
            metavar="NAME",
            choices=surface.methods,
            default=surface.default,
            help="one of the methods below (default: %(default)s)",
        )
        for parameter in surface.fixed:
            command.add_argument(
                f"--{parameter}",
                type=float,
                metavar="R",
                help=f"a known {parameter} in m, to be held (default: estimate it)",
            )
        command.add_argument(
            "--json",
            action="store_true",
            help="print one JSON object for a program to read: lengths in m, unrounded",
        )
        command.set_defaults(run=_fit)
    tunnel.add_to(commands)
    return parser


def _columns(text: str) -> tuple[int, ...]:
    return tuple(int(word) for word in text.split(","))


def _number(value, form: str) -> str:
    return format(float(value), form) if math.isfinite(value) else "–"


def _plain(value):
    """A value as JSON has it: lists for arrays, null for what is not finite."""
    if isinstance(value, dict):
        return {name: _plain(item) for name, item in value.items()}
    value = value.tolist() if isinstance(value, np.ndarray | np.generic) else value
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _one_line(error: Exception) -> str:
    """Message of an error, after the name of the file where the system knows it."""
    if isinstance(error, OSError) and error.strerror:
        return _after(str(error.filename), error.strerror) if error.filename else error.strerror
    return " ".join(str(error).split())


def _after(file: str, message: str) -> str:
    return message if message.startswith(file) else f"{file}: {message}"


if __name__ == "__main__":
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # for a terminal without Greek letters
    sys.exit(main())
