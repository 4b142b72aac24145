"""HTML pages of the executed notebooks that need nothing from the network.

``python -m cassie_lib.gallery --preset laptop`` writes ``figures/gallery/index.html`` and a page
for each executed notebook.  Pictures and videos are embedded, formulas are MathML.
"""

from __future__ import annotations

import argparse
import base64
import html
import io
import re
import sys
from pathlib import Path
from typing import Any

from cassie_lib import paths
from cassie_lib.errors import CassieError, DataError
from cassie_lib.files import write_text
from cassie_lib.presets import resolve

# Code keeps its dollar signs; display formulas come before inline ones.
_MATH = re.compile(
    r"(```.*?```|`[^`\n]*`)|\$\$(.+?)\$\$|(?<![\\\w$])\$([^\s$](?:[^$]*?[^\s$])?)\$", re.S
)
_CSS = """
body { margin: 0 auto; max-width: 56rem; padding: 1rem 1.2rem 4rem; color: #1a1a1a;
  font: 16px/1.55 system-ui, sans-serif; background: #fff; }
a { color: #0072b2; } nav { font-size: .9rem; margin-bottom: 1rem; }
img, video { max-width: 100%; height: auto; } h1 { line-height: 1.2; }
pre { overflow-x: auto; font-size: .82rem; line-height: 1.4; margin: .3rem 0; }
.jp-CodeCell .highlight, .highlight { background: #f6f8fa; border-radius: 4px;
  padding: .1rem .7rem; }
.anchor-link, .jp-InputPrompt, .jp-OutputPrompt { display: none; }
table { border-collapse: collapse; font-size: .85rem; display: block; overflow-x: auto; }
th, td { border-bottom: 1px solid #ddd; padding: .2rem .6rem; text-align: left; }
ul.cards { list-style: none; padding: 0; display: grid; gap: 1rem;
  grid-template-columns: repeat(auto-fill, minmax(15rem, 1fr)); }
ul.cards li { border: 1px solid #ddd; border-radius: 6px; padding: .8rem; }
.smoke { background: #fff3cd; padding: .5rem .8rem; border-radius: 4px; }
"""


def _mathml(found: re.Match[str]) -> str:
    from latex2mathml.converter import convert

    code, display, inline = found.groups()
    if code is not None:
        return code
    kind = "block" if display is not None else "inline"
    formula = convert(" ".join((display or inline).split()), display=kind)
    # HTML needs no name space, and in a heading the converter would turn it into a prefix.
    formula = re.sub(r' xmlns="[^"]*"', "", formula)
    # Markdown must not read these inside the formula as emphasis.
    return formula.replace("*", "&#42;").replace("_", "&#95;")


def formulas_to_mathml(markdown: str) -> str:
    """Replace ``$...$`` and ``$$...$$`` outside code by MathML, which browsers draw themselves."""
    return _MATH.sub(_mathml, markdown)


def _page(title: str, body: str, preset: str) -> str:
    from pygments.formatters import HtmlFormatter

    css = _CSS + HtmlFormatter(style="default").get_style_defs(".highlight")
    label = ""
    if preset == "smoke":
        label = '<p class="smoke">Smoke preset: a test run, its numbers mean nothing.</p>'
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(title)}</title><style>{css}</style></head>\n"
        f"<body>{label}{body}</body></html>\n"
    )


def _title(book: Any, fallback: str) -> str:
    for cell in book.cells:
        if cell.cell_type == "markdown":
            heading = re.search(r"^#\s+(.+)$", cell.source, re.M)
            if heading:
                return heading[1].strip().replace("$", "")
    return fallback


def _thumbnail(book: Any, width: int = 420) -> str:
    """First PNG of a notebook, scaled down, as an ``<img>``: the headline figure comes first."""
    from PIL import Image

    outputs = [output for cell in book.cells for output in cell.get("outputs", ())]
    pictures = [o["data"]["image/png"] for o in outputs if "image/png" in o.get("data", {})]
    if not pictures:
        return ""
    image = Image.open(io.BytesIO(base64.b64decode(pictures[0]))).convert("RGB")
    image.thumbnail((width, width))
    buffer = io.BytesIO()
    image.save(buffer, "PNG", optimize=True)
    text = base64.b64encode(buffer.getvalue()).decode()
    return f'<img alt="" src="data:image/png;base64,{text}">'


def notebook_page(notebook: Path, preset: str) -> tuple[str, str, str]:
    """Convert one executed notebook.

    Returns:
        Title, whole HTML page, ``<img>`` of its headline figure (or nothing).

    Raises:
        DataError: If the notebook cannot be read.
    """
    import nbformat
    from nbconvert import HTMLExporter

    try:
        book = nbformat.read(notebook, as_version=4)
    except (OSError, ValueError, AttributeError):
        raise DataError(f"{notebook.name} cannot be read: expected an executed notebook") from None
    title = _title(book, notebook.stem)
    for cell in book.cells:
        if cell.cell_type == "markdown":
            cell.source = formulas_to_mathml(cell.source)
    exporter = HTMLExporter(template_name="basic", embed_images=True)
    body, _ = exporter.from_notebook_node(book)
    nav = '<nav><a href="index.html">All notebooks</a></nav>'
    return title, _page(title, nav + body, preset), _thumbnail(book)


def build_gallery(preset: str = "laptop") -> Path:
    """Write the gallery of a preset's executed notebooks.

    Returns:
        The index page.

    Raises:
        DataError: If there is no executed notebook or one cannot be read.
    """
    folder = paths.gallery_folder(preset)
    notebooks = sorted(paths.executed_folder(preset).glob("[0-9][0-9]_*.ipynb"))
    if not notebooks:
        raise DataError(f"no executed notebook of preset {preset}: run make figures first")
    cards = []
    for notebook in notebooks:
        title, page, picture = notebook_page(notebook, preset)
        write_text(folder / f"{notebook.stem}.html", page)
        link = f'<a href="{notebook.stem}.html">{picture}<br>{html.escape(title)}</a>'
        cards.append(f"<li>{link}</li>")
    heading = "Model-based reinforcement learning for bipedal robots: companion notebooks"
    body = f'<h1>{heading}</h1><ul class="cards">{"".join(cards)}</ul>'
    write_text(folder / "index.html", _page(heading, body, preset))
    return folder / "index.html"


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m cassie_lib.gallery", description=__doc__)
    parser.add_argument("--preset", default="laptop")
    try:
        preset = resolve(parser.parse_args(arguments).preset).name
        print(f"gallery: {build_gallery(preset)}")
    except CassieError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
