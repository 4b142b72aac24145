"""What made a result: fingerprints of the code, the commit, the lock and the libraries."""

from __future__ import annotations

import ast
import json
import platform
import subprocess
import sys
from functools import cache
from importlib import metadata
from pathlib import Path
from xml.etree import ElementTree

from cassie_lib import paths
from cassie_lib.files import canonical_json, sha256_file, sha256_text

LIBRARIES = ("numpy", "scipy", "mujoco", "gymnasium", "torch", "safetensors")
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


#: Python 3.13 leaves empty lists out unless told otherwise.
_EMPTY_TOO = {"show_empty": True} if sys.version_info >= (3, 13) else {}


def _syntax(text: str) -> str:
    """Syntax tree without docstrings as text, the same on every supported version of Python."""
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, DOCUMENTED) and ast.get_docstring(node, clean=False) is not None:
            node.body = node.body[1:]
        # A field that Python 3.12 has added; what is in use stays in the fingerprint.
        if getattr(node, "type_params", None) == []:
            delattr(node, "type_params")
    return ast.dump(tree, **_EMPTY_TOO)


@cache
def file_fingerprint(path: Path) -> str:
    """Hash of what a source file does: comments, docstrings and layout do not count.

    Python is hashed as its syntax tree, XML and JSON in canonical form, others as bytes.
    """
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        text = _syntax(text)
    elif path.suffix == ".xml":
        text = ElementTree.canonicalize(text, strip_text=True)
    elif path.suffix == ".json":
        text = canonical_json(json.loads(text))
    return sha256_text(text)[:16]


def _source_files(module: str) -> list[Path]:
    place = paths.PACKAGE / module
    if place.is_dir():
        kinds = (".py", ".xml", ".json")
        return sorted(path for path in place.rglob("*") if path.suffix in kinds)
    single = place.with_suffix(".py")
    return [single] if single.exists() else []


def code_fingerprint(modules: tuple[str, ...]) -> dict[str, str]:
    """Fingerprint of each source file of some modules of this package.

    Args:
        modules: Names below ``cassie_lib``: a module (``"reward"``), a folder (``"robot"``) or a
            module in a folder (``"dynamics/mlp"``).

    Returns:
        Path below the package -> 16 hexadecimal digits.
    """
    found = [path for module in modules for path in _source_files(module)]
    return {path.relative_to(paths.PACKAGE).as_posix(): file_fingerprint(path) for path in found}


@cache
def git_commit() -> str:
    """Short commit of the working tree, with ``+changes`` when code differs from it.

    Only code, notebooks and the lock count: regenerated figures do not change what made them.
    Outside git it is ``"unknown"``.
    """

    def git(*arguments: str) -> str:
        command = ["git", "-C", str(paths.ROOT), *arguments]
        return subprocess.run(
            command, capture_output=True, text=True, check=True, timeout=20
        ).stdout.strip()

    try:
        watched = ("cassie_lib", "notebooks", paths.LOCK.name)
        commit = git("rev-parse", "--short=10", "HEAD")
        return commit + ("+changes" if git("status", "--porcelain", "--", *watched) else "")
    except (OSError, subprocess.SubprocessError):
        return "unknown"


def lock_hash() -> str:
    """First 12 hexadecimal digits of the SHA-256 of ``environment.lock``."""
    return sha256_file(paths.LOCK)[:12] if paths.LOCK.exists() else "missing"


@cache
def library_versions() -> dict[str, str]:
    """Versions of Python and of the libraries that numbers depend on; imports none of them."""
    found = {"python": platform.python_version(), "machine": platform.machine()}
    for name in LIBRARIES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "missing"
    return found
