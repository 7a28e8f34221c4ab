"""A sphere target as surveyors set it up: on a mount, in front of a wall."""

from __future__ import annotations

import numpy as np

from analysis.checks import check_positive
from analysis.scanner import LEICA_C10, Scanner, vector

from .scanning import AngularGrid, Scan, scan
from .surfaces import Cylinder, Rectangle, Scene, Sphere

WALL = 2.0  # m, half sides of the wall


def sphere_target_scene(
    center,
    radius: float,
    *,
    mount_radius: float = 0.012,
    mount_length: float = 0.3,
    wall_distance: float = 0.12,
    station=(0.0, 0.0, 0.0),
) -> Scene:
    """A sphere on a vertical rod in front of a wall; labels sphere, mount, wall.

    Parameters
    ----------
    center, radius : of the sphere, (3,) and m.
    mount_radius, mount_length : of the rod below the sphere, m (assumed: 12 mm, 0.3 m).
    wall_distance : m, of the wall behind the centre of the sphere, along the horizontal line of
        sight; more than the radius (assumed: 0.12 m. In a cut-out of twice the radius about 40 % of
        the points are then not of a sphere of table 3, as in real scans of targets, where it is 35
        to 45 %).
    station : (3,) of the scanner, m.

    The wall is vertical and faces the station.

    Raises
    ------
    ValueError : a length that is not positive, a wall through the sphere, or a sphere above or
        below the station, which has no horizontal line of sight.

    Example
    -------
    >>> sphere_target_scene((0.0063, 5.8454, -1.6357), 0.0725).labels
    ('sphere', 'mount', 'wall')
    """
    center, radius = vector(center, "center"), check_positive(radius, "radius")
    if not check_positive(wall_distance, "wall_distance") > radius:
        raise ValueError(
            f"wall_distance: expected more than the radius of {radius:g} m, got {wall_distance:g}"
        )
    sight = (center - vector(station, "station")) * (1.0, 1.0, 0.0)
    if not np.linalg.norm(sight) > radius:
        raise ValueError(
            f"center: expected a sphere beside the vertical axis of the station, got {center}"
        )
    sight /= np.linalg.norm(sight)
    down = np.array([0.0, 0.0, -1.0])
    foot = center + (radius + check_positive(mount_length, "mount_length")) * down
    return Scene(
        [
            ("sphere", Sphere(center, radius)),
            # The rod begins inside the sphere, so that there is no gap.
            ("mount", Cylinder(center, foot, check_positive(mount_radius, "mount_radius"))),
            (
                "wall",
                Rectangle(
                    center + wall_distance * sight,
                    right=WALL * np.cross(sight, down),
                    up=-WALL * down,
                ),
            ),
        ]
    )


def scan_sphere_target(
    center,
    radius: float,
    generator: np.random.Generator,
    *,
    scanner: Scanner = LEICA_C10,
    step: float = 1e-3,
    cut: float = 2.0,
    station=(0.0, 0.0, 0.0),
    **scene_options,
) -> Scan:
    """Scan a sphere target and cut it out as a user does, by a ball around it.

    The two spheres of Ou & Liu (2017, section 2.2, table 3) have a radius of 0.0725 m and centres
    near (0.0063, 5.8454, −1.6357) and (1.3963, 3.7694, −1.6247) m in the frame of the scanner, a
    Leica ScanStation C10. Not printed, so assumed: the step, the objects around the spheres, and
    how the spheres were cut out.

    Parameters
    ----------
    center, radius : of the sphere, (3,) and m.
    generator : source of the noise.
    scanner : the instrument.
    step : rad, of the angular grid; 0.1 m at 100 m, about 450 points on a sphere of table 3 at 6 m.
    cut : radius of the ball, in radii of the sphere. It is applied to the points without noise, so
        every redraw has the same points.
    station : (3,) of the scanner, m.
    scene_options : keywords of :func:`sphere_target_scene`.

    Raises
    ------
    ValueError : a cut below 1, and as that function and :class:`AngularGrid`.

    Example
    -------
    >>> scan_sphere_target((0.0063, 5.8454, -1.6357), 0.0725, np.random.default_rng(0)).names
    ('sphere', 'mount', 'wall', 'mixed')
    """
    if not check_positive(cut, "cut") >= 1:
        raise ValueError(f"cut: expected at least 1 radius, got {cut:g}")
    scene = sphere_target_scene(center, radius, station=station, **scene_options)
    grid = AngularGrid.around(center, cut * radius, step, station)
    whole = scan(scene, grid, scanner, generator, station)
    return whole[np.linalg.norm(whole.true_points - np.asarray(center), axis=-1) <= cut * radius]
