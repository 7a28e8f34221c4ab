"""``python -m analysis tunnel EPOCH1 EPOCH2``: tables and figures of what has changed."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import pandas as pd
from tqdm import tqdm

from ..export import tables
from ..reading import read_points
from .comparison import REGISTRATION_SD, SPACING, STEPS, EpochComparison, compare
from .sections import THICKNESS
from .significance import LEVEL, LIMITS, SHARE

OUTPUT = "tunnel_comparison"
MEANING = (
    f"flagged: the change passes {1e3 * LIMITS[0]:.0f} mm in more than {100 * SHARE:.0f} % of the "
    "directions seen (Li et al. 2015)\n"
    "changed: so improbable by noise and registration error alone that such a thing happens in "
    f"{100 * LEVEL:.0f} % of quiet sections\n"
    "settlement: of the crown, positive downwards; convergence: of the horizontal diameter, "
    "positive where it widens"
)
EPILOG = f"""\
The epochs must be in one system, in m, with Z up; the tunnel may run in any horizontal direction.

written into DIR:
  sections.csv        the printed table, unrounded
  changes.*           the unrolled lining: where the change passes 6 and 12 mm, and where it is \
significant
  along.*             crown settlement and horizontal convergence along the tunnel
  section_CHAINAGE.*  outlines and radial change of each section that is flagged or changed
  (.png and .svg, and .csv with what they show)

{MEANING}

exit status: 0 a result, 1 a result with an axis or ellipse that did not converge, 2 no result"""

# Columns of the table that fit a line: short name -> column, decimals; ± is a standard deviation.
SHOWN = {
    "chainage/m": ("chainage_m", 2),
    "points 1": ("points_1", 0),
    "points 2": ("points_2", 0),
    "seen/%": ("seen_percent", 0),
    ">6mm/%": ("beyond_6_mm_percent", 0),
    "flagged": ("flagged", 0),
    "changed": ("changed", 0),
    "largest/mm": ("largest_change_mm", 1),
    "±largest/mm": ("largest_change_sd_mm", 1),
    "at/°": ("at_deg", 0),
    "settlement/mm": ("crown_settlement_mm", 1),
    "±settlement/mm": ("crown_settlement_sd_mm", 1),
    "convergence/mm": ("horizontal_convergence_mm", 1),
    "±convergence/mm": ("horizontal_convergence_sd_mm", 1),
}


def add_to(commands) -> None:
    """Add the command to those of a parser."""
    command = commands.add_parser(
        "tunnel",
        help="compare two epochs of a tunnel",
        description="Compare two epochs of a tunnel: sections, their deformation with standard "
        "deviations, and what of it is significant.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    for number in (1, 2):
        command.add_argument(
            f"epoch_{number}",
            metavar=f"EPOCH{number}",
            help="scan of the epoch (.xyz .txt .csv .pts .asc, or .las .laz .ply .e57)",
        )
    shift = "standard deviation in m of a section's shift between the epochs, a coordinate"
    for name, default, text in (
        ("spacing", SPACING, "between sections in m, from where both epochs begin"),
        ("thickness", THICKNESS, "of a section in m; more where the scan is thin"),
        ("registration", REGISTRATION_SD, shift),
    ):
        text += " (default: %(default)g)"
        command.add_argument(f"--{name}", type=float, metavar="M", default=default, help=text)
    command.add_argument(
        "--output",
        metavar="DIR",
        default=OUTPUT,
        help="folder for tables and figures (default: %(default)s)",
    )
    command.add_argument(
        "--json", action="store_true", help="print one JSON object for a program to read, unrounded"
    )
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Compare, write, print, and return the exit status.

    Raises ``OSError``, ``ValueError`` and ``ImportError``; a ``ValueError`` begins with the file to
    blame, if one is.
    """
    files = {"first": options.epoch_1, "second": options.epoch_2}
    with tqdm(
        total=len(files) + len(STEPS) + 1,
        bar_format="{desc} ({n} of {total}, {elapsed})",
        leave=False,
        disable=None,
    ) as bar:

        def begin(step: str) -> None:
            bar.set_description_str(step, refresh=False)
            bar.update()
            bar.refresh()

        epochs = []
        for file in files.values():
            begin(f"reading {file}")
            epochs.append(read_points(file))
        folder = Path(options.output)
        # what cannot be written is to be known before minutes of computing
        folder.mkdir(parents=True, exist_ok=True)
        values = {name: getattr(options, name) for name in ("spacing", "thickness", "registration")}
        try:
            result = compare(*epochs, **values, report=begin)
        except ValueError as error:
            blamed, colon, rest = str(error).partition(": ")
            raise ValueError(files.get(blamed, blamed) + colon + rest) from error
        begin("tables and figures")
        written = _write(result, folder)
    if options.json:
        print(json.dumps(record(result, files, written), allow_nan=False))
    else:
        print(report(result, files, options.registration, written))
    return 0 if result.converged else 1


def _write(result: EpochComparison, folder: Path) -> list[Path]:
    """Tables and figures; returns the tables, beside each of which but the first a figure lies."""
    # takes its time to load, which the other commands need not wait for
    from ..export import tunnel_figures as figures
    from ..export.figures import into

    publish = into(folder)
    table = result.table()
    tables.save(table, folder / "sections.csv")
    figures.changes(result, "changes", publish=publish)
    figures.along(result, "along", publish=publish)
    stems = ["sections", "changes", "along"]
    for section, noticed in zip(result.sections, table["flagged"] | table["changed"], strict=True):
        if noticed:
            stems.append(f"section_{section.chainage:.2f}")
            figures.section(section, stems[-1], publish=publish)
    return [folder / f"{stem}.csv" for stem in stems]


def report(
    result: EpochComparison, files: dict[str, str], registration: float, written: list[Path]
) -> str:
    """The result for a reader: aligned plain text with units; what is not defined is a dash."""
    axis, table = result.axis, result.table()
    start, end = (" ".join(f"{value:.3f}" for value in axis.position(y)) for y in axis.y_range)
    lines = [
        f"{name} epoch: {file}, {len(lining.flags)} points, {100 * lining.lining.mean():.1f} % of "
        "them lining"
        for (name, file), lining in zip(files.items(), result.linings, strict=True)
    ]
    shown = pd.DataFrame({short: table[name] for short, (name, _) in SHOWN.items()})
    for name in ("flagged", "changed"):
        shown[name] = np.where(table[name], "yes", "-")
    lines += [
        f"axis of the first epoch: {axis.length:.2f} m, from ({start}) to ({end}); "
        f"{axis.stop_reason}",
        f"registration of the second to the first: ± {1e3 * registration:g} mm a coordinate",
        "",
        tables.text(shown, {short: decimals for short, (_, decimals) in SHOWN.items()}),
        "",
        *(f"{row.chainage_m:.2f} m: {row.note}" for row in table.itertuples() if row.note),
        MEANING,
        "±: standard deviation, with the registration error in it",
        "",
        f"{written[0]} and figures with their data:",
        *(f"  {path.with_suffix('')}" for path in written[1:]),
    ]
    return "\n".join(lines)


def record(result: EpochComparison, files: dict[str, str], written: list[Path]) -> dict:
    """The result for a program, nothing rounded; null for what is not defined."""
    rows = (section.row() for section in result.sections)
    return {
        "files": list(files.values()),
        "points": [len(lining.flags) for lining in result.linings],
        "lining": [int(np.count_nonzero(lining.lining)) for lining in result.linings],
        "axis_length_m": result.axis.length,
        "axis_ends_m": [result.axis.position(y).tolist() for y in result.axis.y_range],
        "converged": bool(result.converged),
        "sections": [
            {name: None if value != value else value for name, value in row.items()} for row in rows
        ],
        "written": [str(path) for path in written],
    }
