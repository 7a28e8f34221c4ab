"""The map of the README: for all that the papers show its place here and the verdict."""

from __future__ import annotations

import pandas as pd

from analysis.export import tables
from studies.paths import ROOT
from studies.printed.headline import counted


def _audited(frame: pd.DataFrame) -> str:
    """The verdicts of the audit, counted, in the order in which they occur."""
    return counted(frame, frame["verdict"].unique())


def _inside(frame: pd.DataFrame) -> str:
    """How many numbers of the plane paper's simulation are inside."""
    return f"{frame['inside'].sum()} of {len(frame)} inside; the gains are a change of unit"


def _ground_scan(frame: pd.DataFrame) -> str:
    """How many of the printed numbers a simulated ground scan has."""
    within = (frame["lower"] <= frame["printed"] + frame["half_unit"]) & (
        frame["printed"] - frame["half_unit"] <= frame["upper"]
    )
    return (
        f"{within.sum()} of {len(frame)} inside: "
        "the gains follow from where the scanner stands; σs has the right size"
    )


def _iterations(frame: pd.DataFrame) -> str:
    """Iterations of the quasi-Newton method and of Newton's on the plane."""
    count = frame.set_index("run")["plane"]
    ours, newton = count["BFGS"], count["Newton"]
    return f"ends where Newton's method does: {ours:.0f} iterations against {newton:.0f}"


def _joints(frame: pd.DataFrame) -> str:
    """How near neighbouring stations come to the printed 2 mm."""
    kept = frame["within_percent"].mean()
    return (
        f"2 mm is a standard deviation, not a limit: kept at {kept:.0f} % "
        "of the wall between stations"
    )


def _maxima(frame: pd.DataFrame) -> str:
    """How well the printed maxima, given to the simulated tunnel, are found again."""
    largest = frame.groupby("case")["largest_rms_mm"].max()
    scans, singly, jointly = (
        largest[case] for case in ("noise alone", "stations registered singly", "joint adjustment")
    )
    return (
        f"taken as truth: found again to {scans:.1f} mm; "
        f"with stations registered singly to {singly:.1f}, jointly to {jointly:.1f} mm"
    )


# Shown in a paper, notebook, file, and the verdict: words, or a function of the file's table.
RESULTS = "data/results/"
PAPER_TO_PROJECT = (
    (
        "every number and claim of the three papers",
        "11_audit",
        f"{RESULTS}11_audit_verdicts.csv",
        _audited,
    ),
    (
        "sphere: figure 1, the simulated points",
        "01_simulated_sphere",
        "data/simulated",
        "drawn again: the authors' points are not published",
    ),
    (
        "sphere: equations (1) to (18)",
        "02_sphere_methods",
        "src/analysis/adjustment/igg3.py",
        "as printed; what each misprint changes is shown",
    ),
    (
        "sphere: table 1, without gross errors",
        "03_sphere_tables",
        f"{RESULTS}03_sphere_tables_table1.csv",
        counted,
    ),
    (
        "sphere: table 2, with five gross errors",
        "03_sphere_tables",
        f"{RESULTS}03_sphere_tables_table2.csv",
        counted,
    ),
    (
        "sphere: table 3, by simulated scans (its own are unpublished)",
        "04_scanned_spheres",
        f"{RESULTS}04_scanned_spheres_table3_cleaned.csv",
        counted,
    ),
    (
        "plane: simulation, 83 %, 54 %, σs",
        "07_plane_simulation",
        f"{RESULTS}07_plane_simulation_five.csv",
        _inside,
    ),
    (
        "plane: ground scan, 76 %, 63 %, 1.09 mm",
        "08_plane_scan",
        f"{RESULTS}08_plane_scan_printed.csv",
        _ground_scan,
    ),
    (
        "plane: quasi-Newton algorithm",
        "08_plane_scan",
        f"{RESULTS}08_plane_scan_counts.csv",
        _iterations,
    ),
    (
        "tunnel: registration within 2 mm",
        "09_tunnel_campaign",
        f"{RESULTS}09_tunnel_campaign_joints.csv",
        _joints,
    ),
    (
        "tunnel: figure 2, the axis",
        "09_tunnel_campaign",
        "figures/09_tunnel_campaign_axis.png",
        "parallel to the tunnel, but lifted by the track bed",
    ),
    (
        "tunnel: figure 3, the filter",
        "09_tunnel_campaign",
        "figures/09_tunnel_campaign_filter.png",
        "drawn from the simulated campaign",
    ),
    (
        "tunnel: figure 6, both epochs",
        "09_tunnel_campaign",
        "figures/09_tunnel_campaign_epochs.png",
        "drawn from the simulated campaign",
    ),
    (
        "tunnel: figure 4, a section projected",
        "10_tunnel_deformation",
        "figures/10_tunnel_deformation_projection.png",
        "drawn from the simulated campaign",
    ),
    (
        "tunnel: figure 5, deformation by direction",
        "10_tunnel_deformation",
        "figures/10_tunnel_deformation_polar.png",
        "drawn from the simulated campaign",
    ),
    (
        "tunnel: figure 7, classes of 6 and 12 mm",
        "10_tunnel_deformation",
        "figures/10_tunnel_deformation_classes.png",
        "drawn from the simulated campaign",
    ),
    (
        "tunnel: table 1 and the largest deformations",
        "10_tunnel_deformation",
        f"{RESULTS}10_tunnel_deformation_recovery.csv",
        _maxima,
    ),
    (
        "tunnel: table 2, by direction",
        "10_tunnel_deformation",
        f"{RESULTS}10_tunnel_deformation_directions.csv",
        "its form, with standard deviations and the truth",
    ),
)


def map_markdown() -> str:
    """The map as a Markdown table."""
    rows = []
    for shown, notebook, file, words in PAPER_TO_PROJECT:
        rows.append(
            {
                "in the paper": shown,
                "notebook": f"[{notebook}](notebooks/{notebook}.ipynb)",
                "file": f"[{file}]({file})",
                "verdict": words if isinstance(words, str) else words(tables.read(ROOT / file)),
            }
        )
    return tables.markdown(pd.DataFrame(rows), 0)
