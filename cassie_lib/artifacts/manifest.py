"""``manifest.json``: what an artifact holds, what made it, and whether it is still whole."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cassie_lib import paths
from cassie_lib.artifacts.equal_code import same_code
from cassie_lib.artifacts.stages import get_stage, recipe_key
from cassie_lib.errors import ArtifactError
from cassie_lib.files import canonical_json, sha256_file, sha256_text

MANIFEST = "manifest.json"
#: Files whose name starts like this hold wall times; they do not count as content.
TIMING = "timing"
#: Folder inside the work folder for a stage's checkpoints; it is removed at the end.
WORK = "work"
#: Folders whose files this process has compared, with what they looked like then.
_COMPARED: dict[Path, tuple] = {}
#: More than the step of any file system's clock.
_SETTLED_NS = 2_000_000_000


@dataclass(frozen=True)
class Artifact:
    """A stored result whose every file has been checked.

    Attributes:
        stage: Name of the stage.
        key: SHA-256 of the recipe (stage, version, parameters, upstream).
        path: Its folder.
        manifest: What ``manifest.json`` says.
        from_cache: False when this very process computed it.
        notice: Lines on what a reader must know: the code or an upstream result has changed
            since.  Empty when all is as it was.
    """

    stage: str
    key: str
    path: Path
    manifest: dict[str, Any]
    from_cache: bool
    notice: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Folder name, e.g. ``expert-0a1b2c3d4e5f``."""
        return f"{self.stage}-{self.key[:12]}"

    @property
    def digest(self) -> str:
        """SHA-256 over its files except those with wall times."""
        return str(self.manifest["digest"])

    @property
    def identity(self) -> str:
        """What later stages depend on: its content or its recipe (:class:`Stage`)."""
        return self.digest if get_stage(self.stage).by_content else self.key

    @property
    def wall_time_s(self) -> float:
        """Seconds that its computation took, over all its sessions."""
        return float(self.manifest["wall_time_s"])

    def get(self) -> Artifact:
        """Itself: it need not be computed, unlike one that is pending."""
        return self

    def at_hand(self) -> Artifact:
        """Itself: it is stored."""
        return self

    def file(self, name: str) -> Path:
        """Path of one of its files.

        Raises:
            ArtifactError: If the artifact has no such file; the message lists those it has.
        """
        if name not in self.manifest["files"]:
            known = ", ".join(self.manifest["files"])
            raise ArtifactError(f"artifact {self.name} has no file {name!r}: it has {known}")
        return self.path / name


def list_files(folder: Path) -> dict[str, dict[str, Any]]:
    """SHA-256 and size in bytes of every file but hidden ones, checkpoints and the manifest."""
    return {
        name: {"sha256": sha256_file(path), "bytes": path.stat().st_size}
        for name, path in _content(folder).items()
    }


def _content(folder: Path) -> dict[str, Path]:
    """Files but hidden ones, checkpoints and the manifest, by path below the folder."""
    found = {}
    for path in sorted(folder.rglob("*")):
        parts = path.relative_to(folder).parts
        skipped = parts[0] in (WORK, MANIFEST) or any(part.startswith(".") for part in parts)
        if path.is_file() and not skipped:
            found["/".join(parts)] = path
    return found


def content_digest(files: dict[str, dict[str, Any]]) -> str:
    """One SHA-256 for the content of all files except those with wall times."""
    content = {n: f["sha256"] for n, f in files.items() if not Path(n).name.startswith(TIMING)}
    return sha256_text(canonical_json(content))


def seal(manifest: dict[str, Any]) -> str:
    """SHA-256 of a manifest's own content, stored in it as ``seal``."""
    return sha256_text(canonical_json({k: v for k, v in manifest.items() if k != "seal"}))


def damaged(folder: Path, what: str) -> ArtifactError:
    """The error for a damaged artifact: what is wrong, and how to get it back."""
    stage = folder.name.rsplit("-", 1)[0]
    if folder.is_relative_to(paths.ROOT):
        folder = folder.relative_to(paths.ROOT)
    return ArtifactError(
        f"artifact {folder.as_posix()} is damaged: {what}; rebuild it with: "
        f"make figures RECOMPUTE={stage}"
    )


def read_manifest(folder: Path, name: str = "") -> dict[str, Any]:
    """Read a manifest and check that it is the one that was written.

    Args:
        folder: The artifact's folder.
        name: Name that the manifest must give, if not the folder's.

    Raises:
        ArtifactError: If it is missing, unreadable, edited or belongs to another recipe.
    """
    try:
        manifest = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
        sealed, key, expected = manifest["seal"], str(manifest["key"]), recipe_key(manifest)
        lacking = sorted({"files", "digest", "code", "notice"} - set(manifest))
    except FileNotFoundError:
        raise damaged(folder, f"{MANIFEST} is missing") from None
    except (OSError, ValueError, KeyError, TypeError):
        raise damaged(folder, f"{MANIFEST} cannot be read") from None
    if sealed != seal(manifest):
        raise damaged(folder, f"{MANIFEST} was edited")
    if lacking:
        raise damaged(folder, f"{MANIFEST} lacks {', '.join(lacking)}")
    if key != expected or (name or folder.name) != f"{manifest['stage']}-{key[:12]}":
        raise damaged(folder, f"{MANIFEST} belongs to {manifest['stage']}-{key[:12]}")
    return manifest


def check_files(folder: Path, manifest: dict[str, Any]) -> None:
    """Compare every file with the manifest.

    A notebook asks for the same data sets many times over.  Files that this process has compared
    already are not read again as long as none has another size or time of change.

    Raises:
        ArtifactError: If a file is missing, changed, cut or not listed; it is named.
    """
    expected = manifest["files"]
    looks = (seal(manifest), _looks(folder))
    if _COMPARED.get(folder.absolute()) == looks:
        return
    for name, facts in expected.items():
        path = folder / name
        if not path.is_file():
            raise damaged(folder, f"{name} is missing")
        size = path.stat().st_size
        if size != facts["bytes"]:
            raise damaged(folder, f"{name} has {size} bytes, expected {facts['bytes']}")
        if sha256_file(path) != facts["sha256"]:
            raise damaged(folder, f"{name} has another SHA-256 than when it was written")
    extra = sorted(set(_content(folder)) - set(expected))
    if extra:
        raise damaged(folder, f"{extra[0]} is not in {MANIFEST}")
    # A file that was written just now can change again without another time of change.
    if all(time.time_ns() - changed > _SETTLED_NS for *_, changed in looks[1]):
        _COMPARED[folder.absolute()] = looks


def _looks(folder: Path) -> tuple[tuple[str, int, int, int], ...]:
    """What changes with a file, of every file: name, inode, size, time of change (ns)."""
    facts = {name: path.stat() for name, path in _content(folder).items()}
    return tuple((n, f.st_ino, f.st_size, f.st_mtime_ns) for n, f in facts.items())


def code_notice(manifest: dict[str, Any]) -> tuple[str, ...]:
    """Name the source files that have changed since an artifact was made, if any.

    A version that is proven to make the same bits has not changed:
    :mod:`~cassie_lib.artifacts.equal_code`.
    """
    stage, made = get_stage(manifest["stage"]), manifest["code"]
    now = stage.code()
    known = (made.keys() | now.keys()) - set(stage.without)
    changed = sorted(name for name in known if not same_code(name, made.get(name), now.get(name)))
    if not changed:
        return ()
    name = f"{manifest['stage']}-{manifest['key'][:12]}"
    return (f"{name} was made by other code: {', '.join(changed)} changed since",)
