"""Cross-sections normal to a tunnel's axis, cut from the points.

A section holds the points within half a thickness of the plane through an axis point, normal to the
axis. In its frame u points right, v up and w along the axis; polar coordinates about the axis point
are ρ and α in rad, 0 at the crown, positive to the right (clockwise when looking along the axis).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..blocks import pieces
from ..checks import check_positive, finite_array
from .axis import Axis, tunnel_points

THICKNESS = 0.05  # m (Li et al. 2015, section 4.2.2)


@dataclass(frozen=True, eq=False)
class Section:
    """One cross-section.

    chainage : arc length of its plane on the axis, m
    position : (3,) the axis point, m; right, up, along : (3,) unit vectors of its frame
    thickness : m, of the slab the points are from
    index : (n,) of its points in the cloud
    u, v, w : (n,) their coordinates in its frame, m; leaving w away is the projection onto its
        plane
    """

    chainage: float
    position: np.ndarray
    right: np.ndarray
    up: np.ndarray
    along: np.ndarray
    thickness: float
    index: np.ndarray
    u: np.ndarray
    v: np.ndarray
    w: np.ndarray

    @property
    def count(self) -> int:
        return len(self.index)

    def only(self, kept: np.ndarray) -> Section:
        """The section with those of its points for which ``kept`` (n,) is true."""
        arrays = {name: getattr(self, name)[kept] for name in ("index", "u", "v", "w")}
        return replace(self, **arrays)

    @property
    def rho(self) -> np.ndarray:
        """(n,) distances of the projected points from the axis point, m."""
        return np.hypot(self.u, self.v)

    @property
    def alpha(self) -> np.ndarray:
        """(n,) directions of the points, rad in (−π, π]: 0 crown, + right."""
        return np.arctan2(self.u, self.v)


def cut(points, axis: Axis, chainages, thickness: float = THICKNESS) -> list[Section]:
    """Sections of ``points`` (n, 3) at ``chainages`` (K,) of the axis.

    Each holds all points within ``thickness``/2 of its plane.

    One pass finds foot points, block by block; what lies near a section is sorted once by its foot
    point and each section takes its points from there by binary search: O(n + m log m), memory for
    the m points near sections only. A section without points comes back with none. Adjacent
    sections may share points.

    Raises ``ValueError`` for chainages beyond the axis, or a thickness that is not positive.

    Source: Li et al. (2015), eqs. (4)-(6); thickness 50 mm.

    >>> from analysis.tunnel.axis import straight
    >>> tube = straight([0.0, 0.0, 0.0], [0.0, 10.0, 0.0])
    >>> section, = cut(np.array([[0.0, 2.01, 3.0], [0.0, 2.5, 3.0], [3.0, 1.98, 0.0]]), tube, [2.0])
    >>> section.index.tolist(), np.degrees(section.alpha).tolist(), section.rho.tolist()
    ([2, 0], [90.0, 0.0], [3.0, 3.0])
    """
    points = tunnel_points(points, "sections", minimum=1)
    chainages = np.atleast_1d(finite_array(chainages, "chainages"))
    thickness = check_positive(thickness, "thickness")
    rounding = 1e-9 * (1.0 + axis.length)
    shown = f"{chainages.min():g} to {chainages.max():g} m" if chainages.size else "none"
    inside = (-rounding <= chainages) & (chainages <= axis.length + rounding)
    if chainages.ndim != 1 or not chainages.size or not inside.all():
        raise ValueError(
            f"chainages: expected shape (K,) between 0 and the axis' length of {axis.length:.3f} "
            f"m, got {shown}"
        )
    y = axis.at_chainage(chainages)
    # The foot points of a plane's points spread along a curve by up to 1/(1 − κρ): twice the
    # thickness is ample.
    index, feet = _near(points, axis, np.sort(y), thickness)
    right, up, along = axis.frame(y)
    position = axis.position(y)
    sections = []
    for k in range(len(y)):
        chosen = index[slice(*np.searchsorted(feet, [y[k] - thickness, y[k] + thickness]))]
        offset = points[chosen] - position[k]
        w = offset @ along[k]
        inside = np.abs(w) <= 0.5 * thickness
        offset, chosen, w = offset[inside], chosen[inside], w[inside]
        sections.append(
            Section(
                chainage=float(chainages[k]),
                position=position[k],
                right=right[k],
                up=up[k],
                along=along[k],
                thickness=thickness,
                index=chosen,
                u=offset @ right[k],
                v=offset @ up[k],
                w=w,
            )
        )
    return sections


def _near(
    points: np.ndarray, axis: Axis, y: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray]:
    """Indices and foot points, ascending, of the points near one of ``y``.

    Near: with the foot point within ``reach`` of it; ``y`` ascends.
    """
    indices, feet = [np.empty(0, dtype=np.int64)], [np.empty(0)]
    y = np.concatenate([[-np.inf], y, [np.inf]])
    for piece in pieces(len(points), 2**20):
        foot = axis.foot(points[piece])
        after = np.searchsorted(y[:-1], foot)
        near = np.flatnonzero(np.minimum(foot - y[after - 1], y[after] - foot) <= reach)
        indices.append(piece.start + near)
        feet.append(foot[near])
    index, ascending = np.concatenate(indices), np.concatenate(feet)
    order = np.argsort(ascending, kind="stable")
    return index[order], ascending[order]
