"""Surfaces fitted to laser-scan points, by the papers' methods and by those one should use.

>>> import analysis
>>> sorted(analysis.SPHERE_METHODS)
['eiv', 'geometric', 'igg3_wtls', 'ls', 'mixed_ls_tls', 'robust', 'tls', 'wtls']
"""

from .adjustment.algorithms import ALGORITHMS
from .adjustment.wtls import Estimate, ls, mixed_ls_tls, tls, wtls
from .methods import (
    CYLINDER_METHODS,
    ELLIPSE_METHODS,
    PLANE_METHODS,
    SPHERE_METHODS,
    fit_ellipse,
    fit_elliptic_cylinder,
    fit_plane,
    fit_sphere,
)
from .orthogonal.reliability import Reliability, data_snooping, reliability
from .reading import Scan, read_points, read_scan
from .result import ConvergenceWarning, Fit
from .similarity import Similarity, fit_similarity
from .surfaces.cylinder import CylinderFit
from .surfaces.ellipse import EllipseFit
from .surfaces.plane import PlaneFit
from .surfaces.sphere import SphereFit
from .trust import Check

__version__ = "0.1.0"

__all__ = [
    "ALGORITHMS",
    "CYLINDER_METHODS",
    "ELLIPSE_METHODS",
    "PLANE_METHODS",
    "SPHERE_METHODS",
    "Check",
    "ConvergenceWarning",
    "CylinderFit",
    "EllipseFit",
    "Estimate",
    "Fit",
    "PlaneFit",
    "Reliability",
    "Similarity",
    "Scan",
    "SphereFit",
    "data_snooping",
    "fit_ellipse",
    "fit_elliptic_cylinder",
    "fit_plane",
    "fit_similarity",
    "fit_sphere",
    "ls",
    "mixed_ls_tls",
    "read_points",
    "read_scan",
    "reliability",
    "tls",
    "wtls",
]
