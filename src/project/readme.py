"""Generated sections of the README.

``python -m project.readme [--check | --show NAME]``

A section stands between ``<!-- begin generated: NAME -->`` and ``<!-- end generated: NAME -->``;
its text comes from the function of that name in `SECTIONS`, so no number in the README is typed by
hand.
"""

import argparse
import re
import sys

from analysis.export import files, tables
from studies import paths, verdicts
from studies.ou_liu_2017 import causes, headline, real_spheres
from studies.ou_liu_2017.printed_tables import TITLES

from . import paper_map

README = paths.ROOT / "README.md"


def comparisons():
    """The comparisons of tables 1 and 2 with the redraws, as notebook 03 wrote them."""
    return [tables.read(paths.RESULTS / f"03_sphere_tables_table{table}.csv") for table in TITLES]


def audited():
    """Every printed number with its verdict, as notebook 11 wrote them."""
    return tables.read(paths.RESULTS / "11_audit_verdicts.csv")


def scans():
    """The errors on the real scans by method, as notebook 05 wrote them."""
    results = (
        tables.read(paths.RESULTS / f"05_real_spheres_{name}.csv")
        for name in ("whole_scans", "robust", "peers")
    )
    return tables.markdown(real_spheres.summary(*results), 2)


# Section name -> function without arguments that returns its Markdown.
SECTIONS = {
    "headline": lambda: (
        f"{verdicts.headline_markdown(audited())}\n\n{headline.markdown(comparisons())}"
    ),
    "outside": lambda: tables.markdown(causes.outside(comparisons()), 1),
    "map": paper_map.map_markdown,
    "scans": scans,
}

# Sections with a form of their own for the screen; `make reproduce` shows "headline" at the end.
TERMINAL = {
    "headline": lambda: f"{verdicts.headline_text(audited())}\n\n\n{headline.text(comparisons())}"
}

PATTERN = re.compile(
    r"(<!-- begin generated: (?P<name>[\w-]+) -->\n).*?(<!-- end generated: (?P=name) -->)",
    re.DOTALL,
)


def generate(text, sections):
    """The text with every generated section renewed.

    Raises
    ------
    ValueError : a section of the text, complete or not, has no function, or a function no section.
    """
    begun = re.findall(r"<!-- begin generated: ([\w-]+) -->", text)
    complete = [match["name"] for match in PATTERN.finditer(text)]
    if sorted(begun) != sorted(complete):
        raise ValueError(
            f"a generated section without its end line: begun {begun}, complete {complete}"
        )
    if sorted(complete) != sorted(sections):
        raise ValueError(
            f"generated sections of the text: {sorted(complete)}; "
            f"with a function: {sorted(sections)}"
        )
    return PATTERN.sub(
        lambda match: f"{match[1]}\n{sections[match['name']]().strip()}\n\n{match[3]}", text
    )


def main(arguments=None, readme=README, sections=SECTIONS):
    """Command line; with --check the exit status is 1 when a section is stale."""
    parser = argparse.ArgumentParser(
        prog="python -m project.readme", description="Renew the generated sections of README.md."
    )
    choice = parser.add_mutually_exclusive_group()
    choice.add_argument(
        "--check", action="store_true", help="only tell whether they are up to date"
    )
    choice.add_argument(
        "--show", metavar="NAME", choices=sorted(sections), help="print one section instead"
    )
    options = parser.parse_args(arguments)
    if options.show:
        print(TERMINAL.get(options.show, sections[options.show])())
        return 0
    old = readme.read_text(encoding="utf-8")
    new = generate(old, sections)
    if new == old:
        return 0
    if options.check:
        print(f"{readme.name} is stale: `make readme` renews it.", file=sys.stderr)
        return 1
    with files.replacing(readme) as part:
        part.write_text(new, encoding="utf-8", newline="\n")
    print(f"{readme.name} renewed")
    return 0


if __name__ == "__main__":
    sys.exit(main())
