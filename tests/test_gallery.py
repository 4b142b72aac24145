"""Gallery pages stand alone: no network, formulas as MathML, pictures embedded."""

from __future__ import annotations

import base64
import io
import re

import nbformat
import pytest
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook, new_output
from PIL import Image

from cassie_lib import gallery, paths


@pytest.fixture
def page(tmp_path, monkeypatch):
    monkeypatch.setattr(paths, "CACHE", tmp_path)
    buffer = io.BytesIO()
    Image.new("RGB", (900, 300), "teal").save(buffer, "PNG")
    data = {"image/png": base64.b64encode(buffer.getvalue()).decode(), "text/plain": "figure"}
    cells = [
        new_markdown_cell(
            "# Planning & control\n\nReward $r_t * \\gamma^t$ and `$HOME`, costs $5."
        ),
        new_markdown_cell("$$\\sum_{t=0}^{\\tau} \\gamma^t r_t$$"),
        new_code_cell("print('<b>')", outputs=[new_output("stream", text="<b>\n")]),
        new_code_cell("plot()", outputs=[new_output("display_data", data=data)]),
    ]
    folder = paths.executed_folder("smoke")
    folder.mkdir(parents=True)
    nbformat.write(new_notebook(cells=cells), folder / "06_cem.ipynb")
    index = gallery.build_gallery("smoke")
    return index, (index.parent / "06_cem.html").read_text(encoding="utf-8")


def test_pages_load_nothing_from_anywhere(page):
    index, text = page
    for content in (index.read_text(encoding="utf-8"), text):
        loaded = re.findall(r"""(?:src|href)=["']([^"']+)""", content)
        assert all(item.startswith(("data:", "#")) or "://" not in item for item in loaded)
        assert "<script" not in content
        assert "@import" not in content
        assert "url(" not in content


def test_formulas_pictures_and_code_are_shown(page):
    index, text = page
    assert text.count("<math") == 2
    assert 'display="block"' in text
    assert "<em>" not in text, "underscores and stars in a formula are not emphasis"
    assert "$HOME" in text
    assert "costs $5" in text
    assert "&lt;b&gt;" in text
    assert "data:image/png;base64," in text
    assert "mean nothing" in text
    overview = index.read_text(encoding="utf-8")
    assert 'href="06_cem.html"' in overview
    assert "Planning &amp; control" in overview
    embedded = re.search(r"data:image/png;base64,([^\"]+)", overview)[1]
    assert Image.open(io.BytesIO(base64.b64decode(embedded))).width == 420
