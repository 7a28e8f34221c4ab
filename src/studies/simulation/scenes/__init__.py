"""Scans of simple scenes by a terrestrial laser scanner.

    surfaces     spheres, rectangles, discs, cylinders, and labelled scenes of them
    scanning     an angular grid of beams cast into a scene; noise, mixed pixels, redraws
    targets      a sphere target on its mount before a wall

All coordinates are in m in one frame whose z axis is the scanner's vertical axis; angles in rad.
"""

from .scanning import MIXED, AngularGrid, Scan, redraw, scan
from .surfaces import Cylinder, Disc, Rectangle, Scene, SceneSurface, Sphere
from .targets import scan_sphere_target, sphere_target_scene

__all__ = [
    "MIXED",
    "AngularGrid",
    "Cylinder",
    "Disc",
    "Rectangle",
    "Scan",
    "Scene",
    "Sphere",
    "SceneSurface",
    "redraw",
    "scan",
    "scan_sphere_target",
    "sphere_target_scene",
]
