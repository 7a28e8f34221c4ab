"""Table 3 of Ou & Liu (2017) under other settings: noise, cleaning and readings of IGG III-WTLS.

The scans are those of :mod:`.table3`; LS and IGG III-WTLS are set beside the printed row.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.scanner import LEICA_C10

from ..montecarlo import EVERY_METHOD, sphere_study
from ..simulation.scenes import Scan, redraw
from .printed_tables import values as printed_values
from .table3 import scans, truths
from .table3_relations import RADIUS, SAMPLES


def within(target: Scan, center: NDArray[np.float64], half_width: float) -> NDArray[np.bool_]:
    """(n,) the points whose true place is no farther than ``half_width`` (m) from the sphere; for 0
    those whose beam lay wholly on it.
    """
    if half_width == 0:
        return target.on("sphere")
    return np.abs(np.linalg.norm(target.true_points - center, axis=-1) - RADIUS) <= half_width


def cleanings(
    range_sds: Sequence[float], half_widths: Sequence[float], trials: int, seed: int, **assumed
) -> pd.DataFrame:
    """LS and IGG III-WTLS against the precision of the scanner and how clean its scan is: medians
    over redraws, a row per setting.

    ``range_sds``: σ of a range, m; ``half_widths``: as in :func:`within`; ``assumed``: as in
    :func:`.table3.scans`. Columns: sphere, range_sd_mm, half_width_mm, points; radius errors and σs
    (of IGG III-WTLS in use) of both in mm, and ``ratio``, of these σs.
    """
    rows = []
    for range_sd in range_sds:
        for sample, target in scans(seed, replace(LEICA_C10, range_sd=range_sd), **assumed).items():
            truth, points = truths()[sample], redraw(target, trials, seed)
            for half_width in half_widths:
                keep = within(target, truth[:3], half_width)
                frames = sphere_study(
                    points[:, keep],
                    truth,
                    {name: EVERY_METHOD[name] for name in ("ls", "igg3_wtls")},
                )
                setting = {
                    "sphere": sample,
                    "range_sd_mm": 1e3 * range_sd,
                    "half_width_mm": 1e3 * half_width,
                }
                setting["points"] = np.count_nonzero(keep)
                rows.append(setting | _both(frames["ls"], frames["igg3_wtls"]))
    return pd.DataFrame(rows)


def readings(
    targets: Mapping[str, Scan],
    half_widths: Sequence[float],
    scales: Sequence[str],
    trials: int,
    seed: int,
) -> pd.DataFrame:
    """Results for every reading of σ in V/σ of eq. (13), weights cumulative or not.

    Also ``used``, the points in use, and ``sigma_0`` of IGG III-WTLS in m, both medians.
    """
    variants = {
        (scale, cumulative): {"scale": scale, "cumulative": cumulative}
        for scale in scales
        for cumulative in (True, False)
    }
    asked = {"ls": {"method": "ls"}} | {
        key: {"method": "igg3_wtls"} | options for key, options in variants.items()
    }
    rows = []
    for half_width in half_widths:
        for sample, target in targets.items():
            truth, points = truths()[sample], redraw(target, trials, seed)
            points = points[:, within(target, truth[:3], half_width)]
            frames = sphere_study(points, truth, asked)
            for key, options in variants.items():
                igg = frames[key]
                n = points.shape[1]
                setting = (
                    {"sphere": sample, "half_width_mm": 1e3 * half_width} | options | {"points": n}
                )
                setting |= {
                    "used": n - igg["rejected"].median(),
                    "sigma_0": igg["sigma_0"].median(),
                }
                rows.append(setting | _both(frames["ls"], igg))
    return pd.DataFrame(rows)


def printed_settings() -> pd.DataFrame:
    """The printed row to be set beside :func:`cleanings` and :func:`readings`; σ0 as printed."""
    rows = []
    for sample in SAMPLES:
        ls, igg = (printed_values(3, method, sample) for method in ("ls", "igg3_wtls"))
        one = {"sphere": sample, "sigma_0": igg["sigma_0"]}
        one |= {
            "ls_radius_mm": 1e3 * (ls["r_m"] - RADIUS),
            "igg3_radius_mm": 1e3 * (igg["r_m"] - RADIUS),
        }
        one |= {"ls_sigma_s_mm": 1e3 * ls["sigma_s_m"], "igg3_sigma_s_mm": 1e3 * igg["sigma_s_m"]}
        rows.append(one | {"ratio": ls["sigma_s_m"] / igg["sigma_s_m"]})
    return pd.DataFrame(rows)


def _both(ls: pd.DataFrame, igg: pd.DataFrame) -> dict[str, float]:
    """Medians over the redraws that a setting is judged by."""
    return {
        "ls_radius_mm": 1e3 * ls["delta_r_m"].median(),
        "igg3_radius_mm": 1e3 * igg["delta_r_m"].median(),
        "ls_sigma_s_mm": 1e3 * ls["sigma_s_m"].median(),
        "igg3_sigma_s_mm": 1e3 * igg["sigma_s_inliers_m"].median(),
        "ratio": (ls["sigma_s_m"] / igg["sigma_s_inliers_m"]).median(),
    }
