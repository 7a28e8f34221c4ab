"""Real scans of sphere targets: fetched on demand, checked by hash, never committed.

``python -m project.scans [--needed] [--from FOLDER]``

Source: National Institute of Standards and Technology, repository usnistgov/DMG_SphereFitting, at
one commit; not subject to copyright in the United States.
"""

import argparse
import hashlib
import sys
import urllib.error
import urllib.request
from pathlib import Path

from analysis.export import files
from studies import paths
from studies.ou_liu_2017.real_spheres import REFERENCE_CENTERS

COMMIT = "025fbce0fb5b19c0ea6916b3f981ee405563ea5a"
BASE_URL = f"https://raw.githubusercontent.com/usnistgov/DMG_SphereFitting/{COMMIT}/DATA/"

SHA256 = {
    "SPH101.xyz": "fece24c8901c1b46b2bce88eaa49df3e2499698c72112515533d6efb6a8b8eb0",
    "SPH102.xyz": "75af45f03a87f7a8ded8c2dfc078bf8c6a652c24fb3d0213b7f529daf38a62dc",
    "SPH103.xyz": "dd9909d60a49a5d1bee89dcfa0e6975a5eaa6dc15e09f7e3ca2fc22958139478",
    "SPH104.xyz": "f7396760045d5edaa1eac4cf37e1396f9cf10d338b4919feb10fa39ddb7e5502",
    "SPH105.xyz": "dc407b56100c133e15bddfa7ff35714c82c69e35a3fc58d5d7fdcee6a06c3c76",
    "SPH106.xyz": "413026cefb63d5d2cd0b7f1c0d871058f6cd54add11b7e8333babe08997a1c62",
    "SPH107.xyz": "1fb1b4a70bf056b560215d4752f23d1ba957d6959a16968fd0865c21aff6be55",
    "SPH108.xyz": "ad280cafa7e5a70177a5af0e248ed06470b0d6e5636f455975668d79503a3fd6",
    "SPH109.xyz": "7f2d5f18ba6f6fe788ceb27ba347a217a3d4d43247fdb90cd89538cea90a86f2",
    "SPH110.xyz": "969f2e67de8bb50ab18922914221bc1fad015082e0077b1a717a4f7fbd626b20",
    "SPH111.xyz": "22d401150af5fbe698d9731008e16461c99ba765b9b2816e36470c75477402c3",
}

NOTEBOOK = "05_real_spheres"  # the one notebook that reads scans

NOTEBOOK_SCANS = tuple(f"{scan}.xyz" for scan in REFERENCE_CENTERS)  # those it reads
TIMEOUT = 20  # s without an answer, after which a download is given up


class ScanError(Exception):
    """A scan that could not be had, as one sentence for the user."""


def missing():
    """Names of the scans a notebook reads that are not in data/scans."""
    return [name for name in NOTEBOOK_SCANS if not (paths.SCANS / name).is_file()]


def skip_reason(notebook):
    """The reason why a notebook (its stem) cannot be run here, a sentence; None when it can."""
    if notebook != NOTEBOOK or not (absent := missing()):
        return None
    return (
        f"{notebook} is not run and keeps its stored output: "
        f"{', '.join(absent)} not in data/scans (`make scans` fetches them)."
    )


def store(name, content, folder):
    """Write the bytes of a scan to a folder, if they have its SHA-256; complete or not at all.

    Raises
    ------
    ScanError : they have another; it names both.
    """
    found = hashlib.sha256(content).hexdigest()
    if found != SHA256[name]:
        raise ScanError(
            f"{name} is not the expected file and was not kept: "
            f"expected SHA-256 {SHA256[name]}, found {found}"
        )
    folder.mkdir(parents=True, exist_ok=True)
    with files.replacing(folder / name) as part:
        part.write_bytes(content)


def download(name, base_url=BASE_URL):
    """The bytes of a scan at base_url; a ScanError when there is no answer."""
    try:
        with urllib.request.urlopen(base_url + name, timeout=TIMEOUT) as response:
            return response.read()
    except (urllib.error.URLError, OSError) as error:
        raise ScanError(
            f"{name} could not be downloaded: {getattr(error, 'reason', error)}"
        ) from error


def fetch(names=tuple(SHA256), folder=paths.SCANS, base_url=BASE_URL):
    """Download the named scans that are not in the folder yet.

    Raises
    ------
    ScanError : at the first that cannot be had.
    """
    absent = [name for name in names if not (folder / name).is_file()]
    print(
        f"{len(names) - len(absent)} of {len(names)} scans are there"
        + (f"; downloading from {base_url}" if absent else ""),
        flush=True,
    )
    for number, name in enumerate(absent, start=1):
        content = download(name, base_url)
        store(name, content, folder)
        print(
            f"{name} ({number} of {len(absent)}): {len(content) / 1000:.0f} kB, "
            "SHA-256 as expected",
            flush=True,
        )


def copy(source, names=tuple(SHA256), folder=paths.SCANS):
    """Take the named scans that are in the source folder, and say which are not.

    Raises
    ------
    ScanError : there is none at all.
    """
    present = [name for name in names if (source / name).is_file()]
    if not present:
        raise ScanError(f"{source} holds none of {', '.join(names)}")
    for name in present:
        store(name, (source / name).read_bytes(), folder)
        print(f"{name}: taken, SHA-256 as expected")
    if absent := [name for name in names if name not in present]:
        print(f"Not in {source}: {', '.join(absent)}")


def main(arguments=None):
    """Command line; the exit status is 1 when a scan could not be had."""
    parser = argparse.ArgumentParser(
        prog="python -m project.scans", description="Fetch the real scans into data/scans."
    )
    parser.add_argument(
        "--needed",
        action="store_true",
        help=f"only the {len(NOTEBOOK_SCANS)} that a notebook reads, of {len(SHA256)}",
    )
    parser.add_argument(
        "--from",
        dest="source",
        type=Path,
        metavar="FOLDER",
        help="take those in this folder instead of downloading",
    )
    options = parser.parse_args(arguments)
    names = NOTEBOOK_SCANS if options.needed else tuple(SHA256)
    try:
        if options.source:
            copy(options.source, names)
        else:
            fetch(names)
    except ScanError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
