"""The notebooks as a static site: a page for each, and an index of titles and first paragraphs.

``python -m project.site`` writes build/site; images are inside the pages, formulas are drawn by
MathJax from the network.
"""

import html
import re
import sys

import nbformat
from nbconvert import HTMLExporter
from nbconvert.filters import markdown2html

from studies import paths

SITE = paths.ROOT / "build" / "site"

INDEX = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
body {{ font: 1rem/1.5 sans-serif; max-width: 45rem; margin: 2rem auto; padding: 0 1rem }}
</style>
</head>
<body>
<h1>{title}</h1>
{entries}
</body>
</html>
"""


def head(notebook):
    """Title and first paragraph of a notebook, both Markdown."""
    text = "\n\n".join(cell.source for cell in notebook.cells if cell.cell_type == "markdown")
    blocks = [block.strip() for block in re.split(r"\n\s*\n", text) if block.strip()]
    title = next(
        (block.splitlines()[0].strip("# ") for block in blocks if block.startswith("#")), ""
    )
    paragraph = next((block for block in blocks if not block.startswith("#")), "")
    return title, paragraph


def page(path):
    """The notebook at path as HTML; links to other notebooks lead to their pages."""
    notebook = nbformat.read(path, as_version=4)
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            cell.source = re.sub(r"\]\((\w+)\.ipynb", r"](\1.html", cell.source)
    resources = {"metadata": {"name": head(notebook)[0] or path.stem, "path": str(path.parent)}}
    return HTMLExporter(embed_images=True).from_notebook_node(notebook, resources)[0]


def build(notebooks=paths.NOTEBOOKS, site=SITE, title="Laser-scan surface fits"):
    """Write the site of all notebooks of a folder; returns the path of its index page."""
    site.mkdir(parents=True, exist_ok=True)
    entries = []
    for path in sorted(notebooks.glob("*.ipynb")):
        name, paragraph = head(nbformat.read(path, as_version=4))
        (site / f"{path.stem}.html").write_text(page(path), encoding="utf-8")
        entries.append(
            f'<h2><a href="{path.stem}.html">{html.escape(name or path.stem)}</a></h2>\n'
            f"{markdown2html(paragraph)}"
        )
    index = site / "index.html"
    index.write_text(
        INDEX.format(title=html.escape(title), entries="\n".join(entries)), encoding="utf-8"
    )
    return index


def main():
    """Command line."""
    print(f"Written: {build().relative_to(paths.ROOT)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
