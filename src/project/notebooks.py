"""Run notebooks in place.

``python -m project.notebooks run NAME...`` with names as ``03_sphere_tables``. Notebooks, tables
and figures that agree with the committed ones stay as they are; so does everything of a notebook
that fails.
"""

import argparse
import os
import re
import shutil
import sys
import tempfile
import threading
import time
from pathlib import Path

import nbformat
from ipykernel.kernelspec import RESOURCES, get_kernel_dict
from jupyter_client import AsyncKernelManager
from jupyter_client.kernelspec import KernelSpec
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError, DeadKernelError

from studies import paths

from . import agreement, scans

# Of its kernel a notebook says nothing that depends on who ran it.
METADATA = {
    "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
    "language_info": {"name": "python"},
}


class ThisPython(AsyncKernelManager):
    """Kernels of the Python that runs this, whatever the user has installed under that name."""

    @property
    def kernel_spec(self):
        return KernelSpec(resource_dir=RESOURCES, **get_kernel_dict())


class Progress(threading.Thread):
    """Progress of a running notebook: name, code cell i of n, its section, seconds.

    On a terminal this is one line whose seconds count; elsewhere one line for each finished cell.
    """

    def __init__(self, name, notebook, stream):
        super().__init__(daemon=True)
        self.name_, self.stream = name, stream
        self.sections = sections(notebook)
        self.cell, self.begin, self.cell_begin = 0, time.monotonic(), time.monotonic()
        self.finished = threading.Event()

    def run(self):
        """Redraw the line every second until finished (a terminal only)."""
        while not self.finished.wait(1):
            self.draw()

    def draw(self):
        """Draw the line over itself."""
        text = f"{self.line()}  {time.monotonic() - self.begin:.0f} s"
        # Cut, because a line that wraps can't be drawn over.
        self.stream.write(f"\r\033[K{text[: shutil.get_terminal_size().columns - 1]}")
        self.stream.flush()

    def line(self):
        """Name, number and section of the present cell."""
        section = self.sections[self.cell - 1]
        return f"{self.name_}  cell {self.cell} of {len(self.sections)}  {section}"

    def start_cell(self, cell, cell_index):
        """Count the cell; called when a code cell begins."""
        self.cell, self.cell_begin = self.cell + 1, time.monotonic()
        if self.stream.isatty():
            self.draw()

    def end_cell(self, cell, cell_index, execute_reply):
        """Print the line of the cell; called when a code cell has run."""
        if not self.stream.isatty():
            print(
                f"{self.line()}  {time.monotonic() - self.cell_begin:.1f} s",
                file=self.stream,
                flush=True,
            )

    def __enter__(self):
        if self.stream.isatty():
            self.start()
        return self

    def __exit__(self, *error):
        self.finished.set()
        if self.stream.isatty():
            self.join()
            self.stream.write("\r\033[K")
        outcome = f"failed in cell {self.cell} of" if any(error) else "done,"
        seconds = time.monotonic() - self.begin
        print(
            f"{self.name_}  {outcome} {len(self.sections)} cells, {seconds:.1f} s",
            file=self.stream,
            flush=True,
        )


def sections(notebook):
    """The heading above each code cell that is not empty."""
    heading, found = "", []
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            heading = next(
                (line.strip("# ") for line in cell.source.splitlines() if line.startswith("#")),
                heading,
            )
        elif cell.cell_type == "code" and cell.source.strip():
            found.append(heading)
    return found


def run(path, stream=sys.stdout):
    """Execute the notebook at path, in its own folder, and put what differs into the tree.

    What agrees with the committed files stays as it is (:func:`project.agreement.settle`). The
    notebook writes into a temporary folder until every cell has succeeded, so that a run that fails
    or is interrupted changes nothing.

    Returns
    -------
    list of the tables that do not agree, as relative paths.

    Raises
    ------
    CellExecutionError, with the cell and its traceback, or DeadKernelError.
    """
    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory(prefix="analysis-") as written:
        with Progress(path.stem, notebook, stream) as progress:
            NotebookClient(
                notebook,
                timeout=None,
                kernel_manager_class=ThisPython,
                # else each kernel warns that it is not encrypted, on this very machine
                extra_arguments=["--log-level=ERROR"],
                resources={"metadata": {"path": str(path.parent)}},
                record_timing=False,  # times of day would make every run a change
                coalesce_streams=True,  # where printed text is cut into messages is chance
                on_cell_execute=progress.start_cell,
                on_cell_executed=progress.end_cell,
            ).execute(env=os.environ | {paths.OUTPUT_VARIABLE: written})
        notebook.metadata = METADATA
        executed = f"{nbformat.writes(notebook)}\n".encode()
        return agreement.settle(Path(written), path.relative_to(paths.ROOT), executed)


def main(arguments=None):
    """Command line; the exit status is 1 at the first notebook that fails."""
    parser = argparse.ArgumentParser(
        prog="python -m project.notebooks", description="Run notebooks in place."
    )
    command = parser.add_subparsers(required=True).add_parser("run", help="execute and write back")
    command.add_argument("names", nargs="+", metavar="NAME", help="stem of a file in notebooks/")
    for name in parser.parse_args(arguments).names:
        if reason := scans.skip_reason(name):
            print(reason)
            continue
        try:
            for table in run(paths.NOTEBOOKS / f"{name}.ipynb"):
                print(f"{name}: {table.as_posix()} does not agree with the committed one")
        except (CellExecutionError, DeadKernelError) as error:
            # colours only for a terminal
            text = str(error) if sys.stderr.isatty() else re.sub(r"\033\[[\d;]*m", "", str(error))
            print(f"{name}: {text}", file=sys.stderr)
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
