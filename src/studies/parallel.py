"""Work shared out over processes, each with one thread of linear algebra."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import joblib

from analysis.checks import check_positive


def run(function: Callable, tasks: Iterable[tuple], workers: int | None = None) -> list:
    """Return ``function(*task)`` of every task, in their order, computed by several processes.

    Parameters
    ----------
    function : importable by name, without side effects; so the number of processes changes nothing.
    tasks : arguments of each call.
    workers : processes; as many as there are cores, unless given.

    Raises
    ------
    ValueError : a number of workers that is not positive.

    Example
    -------
    >>> run(pow, [(2, 3), (3, 2)], workers=1)
    [8, 9]
    """
    tasks = list(tasks)
    workers = joblib.cpu_count() if workers is None else int(check_positive(workers, "workers"))
    with joblib.parallel_config("loky", n_jobs=min(len(tasks), workers), inner_max_num_threads=1):
        # max_nbytes: arrays go through the pipe, not into temporary files.
        return joblib.Parallel(max_nbytes=None)(joblib.delayed(function)(*task) for task in tasks)
