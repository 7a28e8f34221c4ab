"""Tests of the studies of Li et al. (2015): exact measurements leave no error."""

from dataclasses import replace

import numpy as np

from studies.simulation.tunnel import default_tunnel

TUNNEL = default_tunnel()


def exact(epoch):
    """The epoch with exact scans of targets and stickers.

    The errors of the control net and of the total station stay.
    """
    stations = tuple(
        replace(
            one, targets=replace(one.targets, scanned=one.pose.to_instrument(one.targets.control))
        )
        for one in epoch.stations
    )
    found = epoch.stickers
    poses = [epoch.stations[place].pose for place in found.station]
    scanned = np.array(
        [pose.to_instrument(point) for pose, point in zip(poses, found.total_station, strict=True)]
    )
    return replace(epoch, stations=stations, stickers=replace(found, scanned=scanned))


def moved(epoch, place, shift):
    """The epoch with a station that has moved after its targets were measured."""
    stations = list(epoch.stations)
    pose = stations[place].pose
    stations[place] = replace(stations[place], pose=replace(pose, position=pose.position + shift))
    return replace(epoch, stations=tuple(stations))
