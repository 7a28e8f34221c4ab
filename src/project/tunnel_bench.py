"""Time and memory of the comparison of two epochs of a tunnel, by the number of points.

From the scans of the stations to the table of the sections.
``python -m project.tunnel_bench [--largest 4.5]``; up to the 45 million points of Li et al. (2015)
it takes about six minutes on two cores, of which the simulation of the scans, which is not
measured, takes half. Numbers are of this machine at this moment: table and figure go to build/bench
and are not committed.
"""

import argparse
import multiprocessing
import resource
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import joblib
import numpy as np
import pandas as pd
from tqdm import tqdm

from analysis.blocks import pieces
from analysis.export.figures import into
from analysis.tunnel.comparison import compare
from studies import paths
from studies.li_2015.register_campaign import register, station_names
from studies.simulation.tunnel import default_tunnel, scan_station, survey

from . import tunnel_bench_figure as figures
from .bench import report, stated

SIZES = (0.45, 1.4, 4.5, 14.0, 45.0)  # million beams of a campaign
RUN = "tunnel, from the stations to the table"
SECONDS, GIGABYTES = 600.0, 8.0
# smaller ones take the time of the robust starts, which does not grow
LARGER = tuple(f"{size:g} million" for size in SIZES[-2:])
LIMITS = pd.DataFrame(
    [
        (RUN, "wall, s", "at most", SECONDS, None),
        (RUN, "peak, GB", "at most", GIGABYTES, None),
        (RUN, "exponent of time", "at most", 1.1, LARGER),
        (RUN, "exponent of memory", "at most", 1.1, LARGER),
    ],
    columns=["run", "quantity", "rule", "limit", "methods"],
)
DECIMALS = {
    "wall, s": 1,
    "CPU, s": 1,
    "peak, GB": 2,
    "simulated, s": 0,
    "exponent of time": 2,
    "exponent of memory": 2,
}
FOLDER = paths.ROOT / "build" / "bench"
MAXRSS = 1 if sys.platform == "darwin" else 1024  # bytes; the unit of ru_maxrss


def scan(file, tunnel, setup, density):
    """One simulated station into a file, in single precision: 4 µm at 50 m."""
    np.save(file, scan_station(tunnel, setup, density).points.astype(np.float32))


def scan_all(folder, beams):
    """Scan a campaign of so many beams into a folder, one file per station, on all cores."""
    tunnel = default_tunnel()
    setups = {
        name: setup
        for epoch in survey(tunnel)
        for name, setup in zip(station_names(epoch), epoch.stations, strict=True)
    }
    density = beams / len(setups)
    with joblib.parallel_config(
        "loky", n_jobs=min(joblib.cpu_count(), len(setups)), inner_max_num_threads=1
    ):
        scans = joblib.Parallel(return_as="generator_unordered")(
            joblib.delayed(scan)(folder / f"{name}.npy", tunnel, setup, density)
            for name, setup in setups.items()
        )
        for _ in tqdm(
            scans, f"scanning {beams:.3g} points", total=len(setups), leave=False, disable=None
        ):
            pass


def joined(epoch, folder):
    """All points (n, 3) of an epoch in one system, its stations registered by their targets.

    One scan at a time is in memory beside them.
    """
    stations = register(epoch)
    counts = [len(np.load(folder / f"{name}.npy", mmap_mode="r")) for name in stations]
    points = np.empty((sum(counts), 3))
    for part, (name, station) in zip(
        np.split(points, np.cumsum(counts)[:-1]), stations.items(), strict=True
    ):
        scanned = np.load(folder / f"{name}.npy")
        for piece in pieces(len(scanned)):
            part[piece] = station.similarity.transform(scanned[piece])
    return points


def measured(folder):
    """Points, sections, time and largest memory of the way from the stations to the table."""
    epochs = survey(default_tunnel())  # for their targets
    wall, cpu = time.perf_counter(), time.process_time()
    clouds = [joined(epoch, folder) for epoch in epochs]
    table = compare(*clouds).table()
    return {
        "points": sum(map(len, clouds)),
        "sections": int(table["largest_change_mm"].notna().sum()),
        "wall, s": time.perf_counter() - wall,
        "CPU, s": time.process_time() - cpu,
        "peak, GB": peak(),
    }


def peak():
    """Largest memory that this process has held, GB."""
    return 1e-9 * MAXRSS * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def fresh(function, *arguments):
    """The result of a function that is called in a process of its own.

    A child takes over the largest memory of the process that starts it, even if it runs another
    program. The small server that starts this one keeps it from that.
    """
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("forkserver")) as pool:
        return pool.submit(function, *arguments).result()


def growing(sizes):
    """One line per campaign of so many million beams, with the exponents of time and memory.

    The exponents are against the points, from each campaign to the next.
    """
    rows = []
    for size in sizes:
        with tempfile.TemporaryDirectory() as folder:
            began = time.perf_counter()
            scan_all(Path(folder), 1e6 * size)
            simulated = time.perf_counter() - began
            rows.append(
                {"campaign": f"{size:g} million"}
                | fresh(measured, Path(folder))
                | {"simulated, s": simulated}
            )
    table = pd.DataFrame(rows)
    for name, of in (("time", "CPU, s"), ("memory", "peak, GB")):
        table[f"exponent of {name}"] = np.log(table[of]).diff() / np.log(table["points"]).diff()
    return table


def main(arguments=None):
    """Command line."""
    parser = argparse.ArgumentParser(
        description="Time and memory of the comparison of two epochs of a tunnel, "
        "by the number of points."
    )
    parser.add_argument(
        "--largest",
        type=float,
        choices=SIZES,
        default=SIZES[-1],
        help="million points (default: %(default)g)",
    )
    largest = parser.parse_args(arguments).largest
    print(stated(LIMITS))
    table = growing([size for size in SIZES if size <= largest])
    print(report(RUN, table, DECIMALS, LIMITS))
    folder = paths.output(FOLDER / "tunnel.csv").parent
    figures.growth(table, "tunnel", seconds=SECONDS, gigabytes=GIGABYTES, publish=into(folder))
    print(f"{folder / 'tunnel'}.png, .svg and .csv")
    return 0


if __name__ == "__main__":
    sys.exit(main())
