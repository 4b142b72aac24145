"""A folder for ``PYTHONPATH`` that cuts a Python process and its children off from the network."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

from nbformat import write
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook

from cassie_lib import paths
from cassie_lib.artifacts import recompute

#: Runs at the start of every interpreter.  ZeroMQ has sockets of its own; Jupyter's kernels are
#: reached through them, on this machine only.
GUARD = """
import os, socket, sys

def local(host):
    host = host.decode() if isinstance(host, bytes) else str(host or "")
    return host in ("", "localhost", "::1", socket.gethostname()) or host.startswith("127.")

def refuse(event, arguments):
    if event in ("socket.connect", "socket.sendto", "socket.sendmsg"):
        address = arguments[1]
        host = address[0] if isinstance(address, tuple) else ""
    elif event in ("socket.getaddrinfo", "socket.gethostbyname", "socket.gethostbyaddr"):
        host = arguments[0]
    else:
        return
    if not local(host):
        with open(os.environ["NETWORK_LOG"], "a") as log:
            log.write(f"{event} {host}\\n")
        raise OSError(f"there is no network: {event} {host}")

sys.addaudithook(refuse)
"""


def cut_off(folder: Path) -> dict[str, str]:
    """Variables for a process without network; ``NETWORK_LOG`` names what it tried to reach."""
    folder.mkdir(parents=True)
    (folder / "sitecustomize.py").write_text(GUARD)
    search = os.pathsep.join([str(folder), str(Path(__file__).parent)])
    return {"PYTHONPATH": search, "NETWORK_LOG": str(folder / "network.log")}


class Offline(NamedTuple):
    """What a run without network left behind."""

    root: Path
    code: int
    output: str
    reached_for: list[str]

    @property
    def cache(self) -> Path:
        """Folder of its artifacts."""
        return self.root / "data" / "cache"


def run_offline(root: Path) -> Offline:
    """``make figures`` of a repository with one notebook that runs all of ``pipeline_toys``."""
    cells = [
        new_markdown_cell("# Offline"),
        new_code_cell('PRESET = "laptop"  # str', metadata={"tags": ["parameters"]}),
        new_code_cell("import pipeline_toys, socket\nfrom cassie_lib import figures"),
        new_code_cell(
            "try:\n    socket.create_connection(('192.0.2.1', 80), 1)\n"
            "except OSError as error:\n    print(error)"
        ),
        new_code_cell("pipeline_toys.build()\nprint('built')"),
    ]
    kernel = {"kernelspec": {"name": "python3", "display_name": "Python 3"}}
    (root / "notebooks").mkdir()
    write(new_notebook(cells=cells, metadata=kernel), root / "notebooks" / "01_offline.ipynb")
    shutil.copy(paths.SNAKEFILE, root / "notebooks")
    (root / "environment.lock").write_text("")
    environment = {**os.environ, **cut_off(root / "guard"), "CASSIE_HOME": str(root)}
    for name in ("CASSIE_CACHE", "CASSIE_PRESET", recompute.REQUEST, recompute.SINCE):
        environment.pop(name, None)
    command = [sys.executable, "-m", "cassie_lib.batch", "figures", "--preset", "smoke"]
    done = subprocess.run(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        timeout=300,
    )  # fmt: skip
    log = root / "guard" / "network.log"
    reached_for = log.read_text().splitlines() if log.exists() else []
    return Offline(root, done.returncode, done.stdout, reached_for)
