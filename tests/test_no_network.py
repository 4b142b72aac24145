"""Once set up nothing needs a network: stages, notebooks, batch runner, gallery."""

from __future__ import annotations

import nbformat
import pytest
from pipeline_toys import ARTIFACTS

from cassie_lib import artifacts, paths


def test_everything_runs_without_a_network(offline_run, monkeypatch):
    assert offline_run.code == 0, offline_run.output
    book = nbformat.read(offline_run.cache / "smoke-executed" / "01_offline.ipynb", 4)
    text = "".join(o.get("text", "") for cell in book.cells for o in cell.get("outputs", ()))
    assert "there is no network" in text, "the kernel was cut off"
    assert text.rstrip().endswith("built")
    # Nothing but the notebook's own trial as much as looked for a host.
    assert [line.split()[1] for line in offline_run.reached_for] == ["192.0.2.1"]
    pages = offline_run.cache / "smoke-figures" / "gallery"
    assert (pages / "01_offline.html").exists()
    monkeypatch.setattr(paths, "CACHE", offline_run.cache)
    stages = {folder.name.rsplit("-", 1)[0] for folder in artifacts.stored()}
    assert stages >= set(ARTIFACTS) - {"wide"}


@pytest.mark.parametrize("name", ["index.html", "01_offline.html"])
def test_the_gallery_names_no_script_or_picture_elsewhere(offline_run, name):
    page = (offline_run.cache / "smoke-figures" / "gallery" / name).read_text()
    for start in ('src="http', "src='http", 'src="//', "@import", "url(http"):
        assert start not in page
