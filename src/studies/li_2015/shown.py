"""Where the figures and tables of Li et al. (2015) are found here."""

import pandas as pd

from ..printed.shown import Shown, figure, table

CAMPAIGN, CHANGE = "09_tunnel_campaign", "10_tunnel_deformation"
DRAWN = "drawn from the simulated campaign"


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


SHOWN = (
    Shown("tunnel: registration within 2 mm", CAMPAIGN, table(CAMPAIGN, "joints"), _joints),
    Shown(
        "tunnel: figure 2, the axis",
        CAMPAIGN,
        figure(CAMPAIGN, "axis"),
        "parallel to the tunnel, but lifted by the track bed",
    ),
    Shown("tunnel: figure 3, the filter", CAMPAIGN, figure(CAMPAIGN, "filter"), DRAWN),
    Shown("tunnel: figure 6, both epochs", CAMPAIGN, figure(CAMPAIGN, "epochs"), DRAWN),
    Shown("tunnel: figure 4, a section projected", CHANGE, figure(CHANGE, "projection"), DRAWN),
    Shown("tunnel: figure 5, deformation by direction", CHANGE, figure(CHANGE, "polar"), DRAWN),
    Shown("tunnel: figure 7, classes of 6 and 12 mm", CHANGE, figure(CHANGE, "classes"), DRAWN),
    Shown(
        "tunnel: table 1 and the largest deformations", CHANGE, table(CHANGE, "recovery"), _maxima
    ),
    Shown(
        "tunnel: table 2, by direction",
        CHANGE,
        table(CHANGE, "directions"),
        "its form, with standard deviations and the truth",
    ),
)
