"""How far a fit can be trusted: checks that are computed when they are asked for.

Each looks at the fit on at most 2000 points, which do not depend on the order of the points. On
right data (points of one surface with independent normal errors) all together speak in at most one
of fifty fits.
"""

from __future__ import annotations

import numpy as np

from ..result import Fit
from .check import DECISIVE, Check
from .coordinates import coordinate_checks
from .examined import examine
from .others import other_checks
from .residuals import residual_checks
from .surface import surface_checks

__all__ = ["DECISIVE", "Check", "checks_of"]

NOTHING = Check(
    "determined", False, np.nan, np.nan, "No surface was found: look at the points, and fit again."
)


def checks_of(fit: Fit) -> tuple[Check, ...]:
    """The checks of the fit of one cloud."""
    e = examine(fit)
    if e is None:
        return (NOTHING,)
    return (*surface_checks(e), *residual_checks(e), *coordinate_checks(e), *other_checks(e))
