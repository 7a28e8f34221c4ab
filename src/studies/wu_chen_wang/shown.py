"""Where the experiments of Wu, Chen & Wang are found here."""

import pandas as pd

from ..printed.shown import Shown, table

SIMULATION, SCAN = "07_plane_simulation", "08_plane_scan"


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


SHOWN = (
    Shown("plane: simulation, 83 %, 54 %, σs", SIMULATION, table(SIMULATION, "five"), _inside),
    Shown("plane: ground scan, 76 %, 63 %, 1.09 mm", SCAN, table(SCAN, "printed"), _ground_scan),
    Shown("plane: quasi-Newton algorithm", SCAN, table(SCAN, "counts"), _iterations),
)
