"""The only module that knows a folder.

``CASSIE_HOME`` names the repository when the package is not installed from it in place;
``CASSIE_CACHE`` moves the artifacts that regenerate (``data/cache`` by default).  Relative ones
are meant from the current folder and from the repository; an empty one counts as not set.
"""

from __future__ import annotations

import os
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent
ROOT = Path(os.environ.get("CASSIE_HOME") or PACKAGE.parent).expanduser().resolve()
NOTEBOOKS = ROOT / "notebooks"
FIGURES = ROOT / "figures"
DATA = ROOT / "data"
#: Artifacts that are recomputed in minutes; not kept in git.
CACHE = (ROOT / Path(os.environ.get("CASSIE_CACHE") or DATA / "cache").expanduser()).resolve()
# A notebook's kernel and Snakemake's jobs have current folders of their own.
for _name, _path in {"CASSIE_HOME": ROOT, "CASSIE_CACHE": CACHE}.items():
    if os.environ.get(_name):
        os.environ[_name] = str(_path)
LOCK = ROOT / "environment.lock"
README = ROOT / "README.md"
SNAKEFILE = NOTEBOOKS / "Snakefile"
ROBOT_XML = PACKAGE / "robot" / "cassie.xml"
ROBOT_PARAMETERS = PACKAGE / "robot" / "cassie_parameters.json"


def figures_folder(preset: str, changed: bool = False) -> Path:
    """Folder of the pictures and of ``results.json`` of a run.

    Only an unchanged ``laptop`` run writes where git looks: a smoke test or a trial with other
    parameters must never replace a figure that the README shows.

    Args:
        preset: Name of the preset.
        changed: Whether single parameters differ from the preset's.
    """
    if changed:
        return CACHE / f"{preset}-changed-figures"
    return {"laptop": FIGURES, "thesis": FIGURES / "thesis"}.get(
        preset, CACHE / f"{preset}-figures"
    )


def executed_folder(preset: str, changed: bool = False) -> Path:
    """Folder of the executed notebooks of a run: in git for an unchanged ``laptop`` run only."""
    if preset == "laptop" and not changed:
        return FIGURES / "executed"
    return CACHE / f"{preset}{'-changed' if changed else ''}-executed"


def gallery_folder(preset: str) -> Path:
    """Folder of the HTML gallery of a preset's executed notebooks."""
    return figures_folder(preset) / "gallery"
