"""Monte Carlo studies: methods over many redrawn clouds, spread over the processor's cores.

A study is a function of its points alone: the clouds are drawn beforehand (`simulate`), each is
fitted by itself, and how they are shared out among the cores changes no result beyond rounding.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import joblib
import numpy as np
import pandas as pd
from tqdm import tqdm

from analysis.blocks import pieces
from analysis.checks import check_positive, point_array, real_array
from analysis.methods import SPHERE_METHODS, fit_sphere
from analysis.result import ignore_convergence_warnings
from analysis.surfaces.sphere import SphereFit

# Clouds a task: enough to pay for sending them to a worker, few enough that no worker is left alone
# with the last ones.
CHUNK = 250

# label -> keyword arguments of fit_sphere
EVERY_METHOD: dict[str, dict] = {name: {"method": name} for name in SPHERE_METHODS}


def sphere_study(
    points,
    truth: Sequence[float],
    variants: Mapping[str, Mapping] = EVERY_METHOD,
    *,
    workers: int | None = None,
    chunk: int = CHUNK,
) -> dict[str, pd.DataFrame]:
    """Fit a sphere to every cloud of a stack by every variant and say how far each is from the
    truth.

    Parameters
    ----------
    points : (B, n, 3) clouds, m.
    truth : true (a, b, c, r), m.
    variants : label -> keyword arguments of `fit_sphere`,
        ``{"squared": {"method": "igg3_wtls", "power": 2}}``. Every method with its defaults, unless
        given.
    workers : processes that share the work; as many as there are cores, unless given.
    chunk : clouds sent to a worker at a time.

    Returns
    -------
    label -> frame with one row per cloud, in order:

    - ``delta_a_m`` … ``delta_r_m`` estimate less truth; NaN where there is no real sphere
    - ``sigma_0`` in the unit of the method, ``sigma_s_m`` over all points, ``sigma_s_inliers_m``
      over those in use
    - ``rejected`` points of weight 0, ``converged``, ``iterations``

    Distances and weights are not kept. Fits that did not converge are told by ``converged``, not by
    warnings.

    Raises
    ------
    ValueError : `points` is not a stack of clouds, `truth` is not four numbers, or what
        `fit_sphere` refuses.

    Example
    -------
    >>> from studies.ou_liu_2017.clouds import SPHERE, sphere_redraws
    >>> study = sphere_study(sphere_redraws(2), SPHERE, {"LS": {"method": "ls"}})
    >>> study["LS"]["delta_c_m"].round(4).tolist()
    [0.0006, -0.0002]
    """
    points = point_array(points, 3, 4, "a sphere")
    if points.ndim != 3:
        raise ValueError(f"points: expected a stack of clouds (B, n, 3), got shape {points.shape}")
    truth = real_array(truth, "truth")
    if truth.shape != (4,):
        raise ValueError(f"truth: expected (a, b, c, r), got shape {truth.shape}")
    tasks = pieces(len(points), int(check_positive(chunk, "chunk")))
    workers = min(
        len(tasks),
        joblib.cpu_count() if workers is None else int(check_positive(workers, "workers")),
    )
    # One BLAS thread a worker: the matrices are tiny, and the cores are busy with other clouds.
    with joblib.parallel_config("loky", n_jobs=workers, inner_max_num_threads=1):
        # max_nbytes: send the points through the pipe rather than leave them in temporary files.
        parallel = joblib.Parallel(return_as="generator", max_nbytes=None)
        done = parallel(
            joblib.delayed(_fit_chunk)(points[task], truth, dict(variants)) for task in tasks
        )
        # disable=None: silent where nobody watches, that is, when stderr is no terminal.
        parts = list(
            tqdm(done, total=len(tasks), desc="redraws", unit="chunk", disable=None, leave=False)
        )
    return {
        label: pd.concat([part[label] for part in parts], ignore_index=True) for label in variants
    }


def printed_quantities(study: Mapping[str, pd.DataFrame]) -> dict[tuple[str, str], np.ndarray]:
    """(label, quantity) -> (B,) values of what tables 1 and 2 of Ou & Liu (2017) print: errors
    without sign, σ0, σs.
    """
    found = {}
    for label, trials in study.items():
        for name in SphereFit.NAMES:
            found[label, f"abs_delta_{name}_m"] = trials[f"delta_{name}_m"].abs().to_numpy()
        for quantity in ("sigma_0", "sigma_s_m"):
            found[label, quantity] = trials[quantity].to_numpy()
    return found


def spread(study: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Standard deviations of a, b, c, r over the redraws in mm, one row per variant.

    Columns: variant; ``sd_a_mm`` … ``sd_r_mm``; ``mean_c_mm`` and ``mean_r_mm``, the mean errors;
    ``rejected``, the mean number of points of weight 0; ``converged_percent``.
    """
    rows = []
    for label, trials in study.items():
        errors = 1e3 * trials[[f"delta_{name}_m" for name in SphereFit.NAMES]]
        row = {"variant": label} | {
            f"sd_{name}_mm": errors[f"delta_{name}_m"].std() for name in SphereFit.NAMES
        }
        row |= {f"mean_{name}_mm": errors[f"delta_{name}_m"].mean() for name in "cr"}
        rows.append(
            row
            | {
                "rejected": trials["rejected"].mean(),
                "converged_percent": 100 * trials["converged"].mean(),
            }
        )
    return pd.DataFrame(rows)


def _fit_chunk(
    points: np.ndarray, truth: np.ndarray, variants: dict[str, Mapping]
) -> dict[str, pd.DataFrame]:
    """The frames of one chunk of clouds."""
    frames = {}
    with ignore_convergence_warnings():
        for label, options in variants.items():
            frames[label] = _trial_frame(fit_sphere(points, **options), truth)
    return frames


def _trial_frame(fit: SphereFit, truth: np.ndarray) -> pd.DataFrame:
    """Rows of a study from the fits of a stack, one row per cloud."""
    frame = pd.DataFrame(fit.parameters - truth, columns=[f"delta_{name}_m" for name in fit.NAMES])
    return frame.assign(
        sigma_0=fit.sigma_0,
        sigma_s_m=fit.sigma_s,
        sigma_s_inliers_m=fit.sigma_s_inliers,
        rejected=np.count_nonzero(~fit.inliers, axis=-1),
        converged=fit.converged,
        iterations=fit.iterations,
    )
