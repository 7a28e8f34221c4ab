"""Where the equations, figures and tables of Ou & Liu (2017) are found here."""

from ..printed.comparison import counted
from ..printed.shown import Shown, table

TABLES, SCANS = "03_sphere_tables", "04_scanned_spheres"

SHOWN = (
    Shown(
        "sphere: figure 1, the simulated points",
        "01_simulated_sphere",
        "data/simulated",
        "drawn again: the authors' points are not published",
    ),
    Shown(
        "sphere: equations (1) to (18)",
        "02_sphere_methods",
        "src/analysis/adjustment/igg3.py",
        "as printed; what each misprint changes is shown",
    ),
    Shown("sphere: table 1, without gross errors", TABLES, table(TABLES, "table1"), counted),
    Shown("sphere: table 2, with five gross errors", TABLES, table(TABLES, "table2"), counted),
    Shown(
        "sphere: table 3, by simulated scans (its own are unpublished)",
        SCANS,
        table(SCANS, "table3_cleaned"),
        counted,
    ),
)
