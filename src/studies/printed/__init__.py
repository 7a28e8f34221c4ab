"""The printed numbers of the three papers and their comparison with ours.

Ou & Liu (2017) print two simulated experiments (tables 1 and 2, without and with gross errors) and
one with real scans (table 3). The simulated points were never published: a printed number belongs
to one draw of the authors', ours to another. So it is compared with the distribution over many
redraws of the simulation, and the last printed digit says how exactly it is known.

Of the other two papers the texts survive, and with them what they state in words and numbers;
`registry` holds all of it.

Sources: Ou J., Liu W. (2017): Fitting of sphere point clouds by weighted total least squares based
on IGG III scheme. Laser Technology 41(5), 749-753, doi:10.7510/jgjs.issn.1001-3806.2017.05.026.
Wu L., Chen H., Wang L.: plane fitting of point clouds by weighted total least squares with a
quasi-Newton method. Li C., Lu X., Zhu N. and others (2015): monitoring of tunnel sections by laser
scanning.
"""

from .comparison import (
    INSIDE,
    OUTSIDE,
    REPRODUCED,
    VERDICTS,
    Comparison,
    compare,
    comparison_table,
    side_by_side,
    verdict,
)
from .numbers import (
    METHODS,
    SYMBOLS,
    TITLES,
    PrintedNumber,
    Statement,
    printed_numbers,
    registry,
    statements,
)

__all__ = [
    "INSIDE",
    "METHODS",
    "OUTSIDE",
    "REPRODUCED",
    "SYMBOLS",
    "TITLES",
    "VERDICTS",
    "Comparison",
    "PrintedNumber",
    "Statement",
    "compare",
    "comparison_table",
    "printed_numbers",
    "registry",
    "side_by_side",
    "statements",
    "verdict",
]
