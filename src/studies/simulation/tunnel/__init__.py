"""The campaign of Li et al. (2015), simulated in a tunnel whose truth is known.

Their scans are not published.

    alignment    the design axis, and coordinates along and across it
    deformation  squat, dent, moved rings between the epochs
    lining       the radius in each epoch; rings, segments, joints and pockets
    furniture    bed, catwalk, cables, lamps, people: they hide the lining
    tunnel       all of these together, and the labels of points
    casting      beams cast into the tunnel
    campaign     stations, targets, control net, stickers, scans
    slab         one section alone, drawn many times with new noise

Engineering coordinates in m: Z up, Y along the tunnel, X to the right. Polar angles in rad: 0 at
the crown, positive to the right, looking along the tunnel.
"""

from .alignment import Alignment
from .campaign import (
    FULL_DENSITY,
    SEED,
    Campaign,
    Epoch,
    Pose,
    ScannedStation,
    Setup,
    Stickers,
    Targets,
    scan_station,
    simulate_campaign,
    survey,
)
from .deformation import QUIET_ZONE
from .lining import EPOCHS, Lining
from .slab import SectionScan, section_points, section_scan
from .tunnel import (
    ATTACHMENTS,
    CODES,
    FLAGGED_SECTIONS,
    NAMES,
    SECTIONS,
    ZONE,
    Tunnel,
    default_tunnel,
)

__all__ = [
    "ATTACHMENTS",
    "CODES",
    "EPOCHS",
    "FLAGGED_SECTIONS",
    "FULL_DENSITY",
    "NAMES",
    "QUIET_ZONE",
    "SECTIONS",
    "SEED",
    "ZONE",
    "Alignment",
    "Campaign",
    "Epoch",
    "Lining",
    "Pose",
    "SectionScan",
    "Setup",
    "ScannedStation",
    "Stickers",
    "Targets",
    "Tunnel",
    "simulate_campaign",
    "default_tunnel",
    "scan_station",
    "section_points",
    "section_scan",
    "survey",
]
