"""The variants of the plane paper's methods, and the five numbers it prints of its simulation.

    σs = √(Σd²/n)            orthogonal distances d; averaged over ten runs, for LS, TLS and WTLS
    gain = 1 − σ0(WTLS)/σ0(LS or TLS)         of the unit-weight standard deviations, averaged over
    ten runs

Source: Wu, Chen & Wang, section 3 (the tables themselves are lost, the text states these five).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.methods import fit_plane
from analysis.result import ignore_convergence_warnings
from analysis.surfaces.plane import PlaneFit

from ..printed.numbers import statements
from .clouds import PLANE_RUNS


@dataclass(frozen=True)
class Variant:
    """A method with its options, and what tables and figures call it; ``true_weights`` if it is
    told the cosines of the true points.
    """

    method: str
    label: str
    options: Mapping = field(default_factory=dict)
    true_weights: bool = False


# The paper's quasi-Newton algorithm finds the same minimum (notebooks 07 and 08); Newton's takes
# half the time.
NEWTON = {"algorithm": "newton"}

VARIANTS: dict[str, Variant] = {
    "ls": Variant("ls", "LS"),
    "tls": Variant("tls", "TLS (pure SVD)"),
    "mixed_ls_tls": Variant("mixed_ls_tls", "mixed LS-TLS"),
    "wtls": Variant("wtls", "WTLS, raw cosines", NEWTON),
    "wtls, LS plane": Variant(
        "wtls", "WTLS, raw cosines on the LS plane", NEWTON | {"reweightings": 0}
    ),
    "wtls, projected": Variant(
        "wtls", "WTLS, projected cosines", NEWTON | {"cosine_at": "projected"}
    ),
    "wtls, true": Variant("eiv", "WTLS, true cosines", true_weights=True),
}

# The five numbers: column -> statement of the paper, its label, the variant it is of.
FIVE = {
    "sigma_s_ls_cm": ("sim_sigma_s_LS", "σs LS / cm", "ls"),
    "sigma_s_tls_cm": ("sim_sigma_s_TLS", "σs TLS / cm", "tls"),
    "sigma_s_wtls_cm": ("sim_sigma_s_WTLS", "σs WTLS / cm", "wtls"),
    "gain_vs_ls_percent": ("sim_sigma0_gain_vs_LS", "σ0: WTLS below LS / %", "ls"),
    "gain_vs_tls_percent": ("sim_sigma0_gain_vs_TLS", "σ0: WTLS below TLS / %", "tls"),
}


def printed(names: Mapping[str, tuple] = FIVE) -> pd.DataFrame:
    """The printed numbers: ``quantity``, ``label``, ``printed`` and ``half_unit`` of its last
    digit.

    >>> print(printed()[["quantity", "printed", "half_unit"]].to_string(index=False, header=False))
          sigma_s_ls_cm  5.9 0.05
         sigma_s_tls_cm  4.8 0.05
        sigma_s_wtls_cm  4.8 0.05
     gain_vs_ls_percent 83.0 0.50
    gain_vs_tls_percent 54.0 0.50
    """
    known = statements("wu_chen_wang")
    found = [
        (quantity, label, known[f"wu_chen_wang/{key}"])
        for quantity, (key, label, *_) in names.items()
    ]
    rows = [(quantity, label, one.value, one.half_unit) for quantity, label, one in found]
    return pd.DataFrame(rows, columns=["quantity", "label", "printed", "half_unit"])


def fitted(points: NDArray[np.float64], cosines: NDArray[np.float64], variant: str) -> PlaneFit:
    """The planes of a stack (B, n, 3) by a variant; who wants to know whether they converged asks
    the fit.

    cosines : (B, n) at the points without noise, for the variant that knows them.
    """
    chosen = VARIANTS[variant]
    with ignore_convergence_warnings():
        return fit_plane(
            points,
            chosen.method,
            cofactors=1.0 / cosines if chosen.true_weights else None,
            **chosen.options,
        )


def not_upright(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(B,) bool: the clouds whose plane differs from an upright one by at least 4 standard
    deviations of its normal.

    In the others, a few of thousands where the noise is large against the patch, z = a x + b y + c
    is not determined: methods that look for a, b and c refuse them or run off.
    """
    fit = fit_plane(points, "mixed_ls_tls")
    return fit.normal[..., 2] >= 4.0 * np.sqrt(fit.normal_covariance[..., 2, 2])


def five(
    fits: Mapping[str, PlaneFit], runs: NDArray[np.int_], tls: str = "tls", wtls: str = "wtls"
) -> NDArray[np.float64]:
    """The five numbers (E, 5) of E experiments.

    fits : variant -> planes of a stack (B,); runs : (E, 10) which of the stack each experiment
        averages; tls and wtls : which variants stand for the paper's.
    """
    sigma_s = [fits[name].sigma_s[runs].mean(axis=-1) for name in ("ls", tls, wtls)]
    sigma_0 = [fits[name].sigma_0[runs].mean(axis=-1) for name in ("ls", tls, wtls)]
    gains = [100.0 * (1.0 - sigma_0[2] / other) for other in sigma_0[:2]]
    return np.stack([*(100.0 * one for one in sigma_s), *gains], axis=-1)


def consecutive(count: int) -> NDArray[np.int_]:
    """(E, 10) runs 0 to 9, 10 to 19, … of ``count``: each run belongs to one experiment; a
    remainder is left over.

    >>> consecutive(25)[:, [0, -1]].tolist()
    [[0, 9], [10, 19]]
    """
    experiments = count // PLANE_RUNS
    return np.arange(experiments * PLANE_RUNS).reshape(experiments, PLANE_RUNS)


def against_print(experiments: NDArray[np.float64], ours: NDArray[np.float64]) -> pd.DataFrame:
    """The five printed numbers beside ours and the distribution over experiments.

    Parameters: experiments (E, 5); ours (5,), of the committed runs.

    Returns one row per number: `printed` and ``ours``, ``median``, ``lower``, ``upper`` (central 95
    %), ``percentile`` of the printed number, and ``inside``: whether what rounds to the printed
    number overlaps the central 95 %.
    """
    frame = printed()
    lower, median, upper = np.quantile(experiments, [0.025, 0.5, 0.975], axis=0)
    value, half = frame["printed"].to_numpy(), frame["half_unit"].to_numpy()
    percentile = 100.0 * np.mean((experiments < value) + 0.5 * (experiments == value), axis=0)
    inside = (value + half > lower) & (value - half < upper)
    return frame.assign(
        ours=ours, median=median, lower=lower, upper=upper, percentile=percentile, inside=inside
    )
