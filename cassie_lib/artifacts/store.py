"""Load an artifact, or compute it in a way that survives being killed."""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Protocol

from cassie_lib import paths
from cassie_lib.artifacts.loading import check_may_compute, note_computed
from cassie_lib.artifacts.manifest import (
    MANIFEST,
    WORK,
    Artifact,
    check_files,
    code_notice,
    content_digest,
    damaged,
    list_files,
    read_manifest,
    seal,
)
from cassie_lib.artifacts.recompute import recompute_since
from cassie_lib.artifacts.stages import get_stage, recipe, recipe_key
from cassie_lib.artifacts.times import note_time
from cassie_lib.code_version import git_commit, library_versions, lock_hash
from cassie_lib.errors import ArtifactError
from cassie_lib.files import locked, write_json

#: Names a file to which the batch runner wants every artifact noted that a notebook uses.
USED = "CASSIE_ARTIFACT_LOG"
_SESSIONS = "sessions.json"


class Upstream(Protocol):
    """What a result is computed from: an artifact, or one that is pending."""

    @property
    def identity(self) -> str:
        """What later stages depend on."""

    def get(self) -> Artifact:
        """The artifact, computed if need be."""

    def at_hand(self) -> Artifact | None:
        """The artifact if it is stored."""


def load_or_compute(
    stage: str,
    parameters: Any,
    compute: Callable[[Path], None],
    upstream: Iterable[Upstream] = (),
    *,
    preset: str = "",
    seed: int | None = None,
    kept: bool = False,
) -> Artifact:
    """Return the stored result of a recipe, computing it first when there is none.

    The key is the SHA-256 of (stage, its version, canonical JSON of ``parameters``, identities
    of ``upstream``).  It is looked for in the cache and among the artifacts kept in git.

    Args:
        stage: A name in :data:`~cassie_lib.artifacts.stages.STAGES`.
        parameters: Frozen dataclass, or a mapping or sequence of such: everything that decides
            the result.
        compute: Called with a folder and writes the result's files there.  The folder survives
            a kill and is handed over again, so checkpoints put under ``folder / WORK`` let
            it go on; that sub-folder is no part of the result.  Files named ``timing*`` do not
            count as content.
        upstream: Artifacts that the result is computed from; pending ones
            (:class:`~cassie_lib.artifacts.Pending`) are computed only if the result has to be.
        preset: Name of the preset, for the record.
        seed: For the record; by default ``parameters.seed`` if there is one.
        kept: Also copy the result to ``data/`` for git; done for the ``laptop`` preset only.

    Raises:
        ArtifactError: If the stored result is damaged: it is neither used nor deleted.
        NotStoredError: If it is not stored, within ``loading_only``.
        UnknownNameError: If there is no such stage.
        ParameterError: If a parameter is not finite or has no canonical form.
    """
    before = tuple(upstream)
    wanted = recipe(stage, parameters, tuple(item.identity for item in before))
    key = recipe_key(wanted)
    since = recompute_since(stage)
    artifact = find(stage, key, since, before)
    if artifact is None:
        name = f"{stage}-{key[:12]}"
        check_may_compute(name)
        with locked(paths.CACHE / "locks" / f"{name}.lock", f"it computes {name}"):
            artifact = find(stage, key, since, before)
            if artifact is None:
                seed = getattr(parameters, "seed", None) if seed is None else seed
                record = {**wanted, "key": key, "preset": preset, "seed": seed}
                needed = tuple(item.get() for item in before)
                artifact = _compute(record, compute, needed, since)
    if kept and preset == "laptop":
        keep(artifact)
    if os.environ.get(USED):
        with open(os.environ[USED], "a", encoding="utf-8") as file:
            file.write(f"{artifact.name} {artifact.digest}\n")
    return artifact


def find(
    stage: str, key: str, since: float = 0.0, upstream: Iterable[Upstream] = ()
) -> Artifact | None:
    """Load a stored artifact, or return None when there is none.

    Args:
        stage: Its stage.
        key: SHA-256 of its recipe.
        since: Results finished before this Unix time (s) are passed over.
        upstream: What it was computed from, for the notice.

    Raises:
        ArtifactError: If it is damaged.
    """
    for folder in _places(f"{stage}-{key[:12]}"):
        if not folder.is_dir():
            if folder.exists() and not since:
                raise damaged(folder, "it is a file, expected a folder")
            continue
        # Asked to compute anew: an old result is passed over, damaged or not.
        if since and _finished_at(folder) < since:
            continue
        return load(folder, tuple(found for item in upstream if (found := item.at_hand())))
    return None


def _places(name: str) -> list[Path]:
    """Where an artifact may lie, best first: the cache, unless git has brought a later copy."""
    cached, kept = paths.CACHE / name, paths.DATA / name
    later = _finished_at(kept) > _finished_at(cached) > float("-inf")
    return [kept, cached] if later else [cached, kept]


def _finished_at(folder: Path, name: str = "") -> float:
    """Unix time (s) at which an artifact was finished; minus infinity without a manifest."""
    try:
        return float(read_manifest(folder, name)["finished_unix_s"])
    except ArtifactError:
        return float("-inf")


def load(folder: Path, upstream: tuple[Artifact, ...] = ()) -> Artifact:
    """Load an artifact from its folder, checking every file.

    Args:
        folder: The artifact's folder.
        upstream: What it was computed from, if at hand: other content than at the time is told
            in the notice, as are the notices of these artifacts themselves.

    Raises:
        ArtifactError: If anything is missing or changed; the file is named.
    """
    manifest = read_manifest(folder)
    check_files(folder, manifest)
    notice = [*code_notice(manifest), *manifest["notice"]]
    stage, key = manifest["stage"], manifest["key"]
    for item in upstream:
        if manifest["upstream_digests"].get(item.name, item.digest) != item.digest:
            notice.append(f"{stage}-{key[:12]} was made from another copy of {item.name}")
        notice.extend(item.notice)
    return Artifact(stage, key, folder, manifest, True, tuple(dict.fromkeys(notice)))


def _compute(
    record: dict[str, Any],
    compute: Callable[[Path], None],
    upstream: tuple[Artifact, ...],
    since: float,
) -> Artifact:
    stage, key = record["stage"], record["key"]
    final = paths.CACHE / f"{stage}-{key[:12]}"
    work = final.with_name(f"{final.name}.partial")
    if _is_finished(work, final.name):
        if _finished_at(work, final.name) >= since:
            # Killed between the manifest and the renaming: nothing is left to compute.
            _move_into_place(work, final)
            return load(final, upstream)
        shutil.rmtree(work)  # finished before it was asked for anew
    code = get_stage(stage).code()
    sessions = _open_sessions(work, code, fresh_code=since > 0)
    compute(work)
    files = list_files(work)
    if not files:
        raise ArtifactError(f"stage {stage!r} wrote no file: expected at least one in {work.name}")
    inherited = [line for item in upstream for line in item.notice]
    mixed = any(past["code"] != code for past in sessions["past"])
    resumed = [f"{final.name} was begun by other code and finished by this"] if mixed else []
    manifest = {
        **record,
        "upstream_digests": {item.name: item.digest for item in upstream},
        "wall_time_s": round(time.time() - sessions["start"] + sessions["before"], 1),
        "finished_unix_s": time.time(),
        "notice": list(dict.fromkeys([*resumed, *inherited])),
        "code": code,
        "commit": git_commit(),
        "lock": lock_hash(),
        "libraries": library_versions(),
        "digest": content_digest(files),
        "files": files,
    }
    manifest["seal"] = seal(manifest)
    write_json(work / MANIFEST, manifest)
    _move_into_place(work, final)
    note_time(final.name, manifest, anew=since > 0)
    note_computed([final.name])
    return Artifact(stage, key, final, manifest, False, tuple(manifest["notice"]))


def _open_sessions(work: Path, code: dict[str, str], fresh_code: bool) -> dict[str, Any]:
    """Note the start of this session in the work folder and add up those before it."""
    note = work / WORK / _SESSIONS
    try:
        past = json.loads(note.read_text(encoding="utf-8"))
        # A session that was killed lasted until its last write.
        last = max(path.stat().st_mtime for path in work.rglob("*") if path.is_file())
        past = [
            {"start": float(p["start"]), "seconds": float(p["seconds"]), "code": dict(p["code"])}
            for p in past
        ]
        if past:
            past[-1]["seconds"] = max(0.0, last - past[-1]["start"])
    except (OSError, ValueError, KeyError, TypeError):
        past = []
    # A request to compute anew does not go on from what other code has left.
    if not past or (fresh_code and past[-1]["code"] != code):
        shutil.rmtree(work, ignore_errors=True)
        past = []
    start = time.time()
    write_json(note, [*past, {"start": start, "seconds": 0.0, "code": code}])
    return {"start": start, "before": sum(item["seconds"] for item in past), "past": past}


def _is_finished(work: Path, name: str) -> bool:
    try:
        check_files(work, read_manifest(work, name))
    except ArtifactError:
        return False
    return True


def _move_into_place(work: Path, final: Path) -> None:
    shutil.rmtree(work / WORK, ignore_errors=True)
    replaced = final.with_name(f"{final.name}.replaced.partial")
    shutil.rmtree(replaced, ignore_errors=True)
    if final.is_dir():
        final.rename(replaced)
    else:
        final.unlink(missing_ok=True)
    work.rename(final)
    shutil.rmtree(replaced, ignore_errors=True)


def keep(artifact: Artifact) -> Path:
    """Copy an artifact to ``data/``, where git keeps it; returns the folder there.

    A copy that is there already stays unless it is older or its manifest is damaged.
    """
    target = paths.DATA / artifact.name
    if target == artifact.path:
        return target
    with locked(paths.CACHE / "locks" / f"keep-{target.name}.lock", f"it keeps {target.name}"):
        if _finished_at(target) < float(artifact.manifest["finished_unix_s"]):
            copy = target.with_name(f"{target.name}.partial")
            shutil.rmtree(copy, ignore_errors=True)
            shutil.copytree(artifact.path, copy, ignore=shutil.ignore_patterns(".*"))
            _move_into_place(copy, target)
    return target


def stored(stage: str = "") -> list[Path]:
    """Folders of all stored artifacts of a stage (or of all stages), cache first."""
    names = [stage] if stage else None
    found = []
    for place in (paths.CACHE, paths.DATA):
        for folder in sorted(place.glob("*-????????????")):
            if folder.is_dir() and (names is None or folder.name.rsplit("-", 1)[0] in names):
                found.append(folder)
    return found
