"""Surfaces fitted to laser-scan points: the papers' methods as printed, and beside them what is right.

>>> import analysis
>>> sorted(analysis.SPHERE_METHODS)
['eiv', 'geometric', 'igg3_wtls', 'ls', 'mixed_ls_tls', 'robust', 'tls', 'wtls']
"""

from .algorithms import ALGORITHMS
from .cylinder import CylinderFit
from .ellipse import EllipseFit
from .fit import ConvergenceWarning, Fit
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
from .plane import PlaneFit
from .points import read_points
from .reliability import Reliability, data_snooping, reliability
from .similarity import Similarity, fit_similarity
from .sphere import SphereFit
from .wtls import Estimate, ls, mixed_ls_tls, tls, wtls

__all__ = [
    "ALGORITHMS",
    "CYLINDER_METHODS",
    "ELLIPSE_METHODS",
    "PLANE_METHODS",
    "SPHERE_METHODS",
    "ConvergenceWarning",
    "CylinderFit",
    "EllipseFit",
    "Estimate",
    "Fit",
    "PlaneFit",
    "Reliability",
    "Similarity",
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
    "reliability",
    "tls",
    "wtls",
]
