"""The only module that knows a folder.

``CASSIE_HOME`` names the repository when the package is not installed from it in place;
``CASSIE_CACHE`` moves the artifacts that regenerate (``data/cache`` by default).
"""

from __future__ import annotations

import os
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent
ROOT = Path(os.environ.get("CASSIE_HOME", PACKAGE.parent)).expanduser().resolve()
NOTEBOOKS = ROOT / "notebooks"
FIGURES = ROOT / "figures"
DATA = ROOT / "data"
#: Artifacts that are recomputed in minutes; not kept in git.
CACHE = Path(os.environ.get("CASSIE_CACHE", DATA / "cache")).expanduser().resolve()
LOCK = ROOT / "environment.lock"
ROBOT_XML = PACKAGE / "robot" / "cassie.xml"
ROBOT_PARAMETERS = PACKAGE / "robot" / "cassie_parameters.json"
