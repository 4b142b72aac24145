"""Where a figure or a number comes from, in one line and in one record."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from cassie_lib.artifacts import Artifact, Upstream
from cassie_lib.artifacts.ledger import from_nothing_s
from cassie_lib.artifacts.loading import computed
from cassie_lib.code_version import git_commit, library_versions, lock_hash
from cassie_lib.errors import ParameterError

#: JSON of the parameters that the batch runner injected besides the preset.
CHANGED = "CASSIE_CHANGED_PARAMETERS"


def changed_parameters() -> dict[str, Any]:
    """Notebook parameters that this run changes besides the preset (set by the batch runner).

    Raises:
        ParameterError: If ``CASSIE_CHANGED_PARAMETERS`` is not a JSON object.
    """
    text = os.environ.get(CHANGED, "") or "{}"
    try:
        found = json.loads(text)
    except ValueError:
        found = None
    if not isinstance(found, dict):
        raise ParameterError(f"{CHANGED} is {text!r}: expected a JSON object")
    return found


@dataclass(frozen=True)
class Provenance:
    """What made a figure.

    Attributes:
        preset: Name of the preset that really ran (``resolve(PRESET).name``).
        seeds: The seeds, in order.
        artifacts: Stored results that it was drawn from.
        changed: Parameters that differ from the preset's.
        commit: Commit of the code, ``+changes`` if the code differs from it.
        lock: Hash of ``environment.lock``.
    """

    preset: str
    seeds: tuple[int, ...] = ()
    artifacts: tuple[Artifact, ...] = ()
    changed: dict[str, Any] = field(default_factory=changed_parameters)
    commit: str = field(default_factory=git_commit)
    lock: str = field(default_factory=lock_hash)

    @classmethod
    def of(
        cls, preset: str, seeds: int | Iterable[int] = (), artifacts: Iterable[Upstream] = ()
    ) -> Provenance:
        """Collect the provenance of this run.

        Args:
            preset: Name of the preset.
            seeds: The seeds, or a single one.
            artifacts: What was used; each counts once, however often it is named, and pending ones
                that nobody has needed are left out.
        """
        numbers = (seeds,) if isinstance(seeds, int) else tuple(int(seed) for seed in seeds)
        used = {found.name: found for item in artifacts if (found := item.at_hand())}
        return cls(preset, numbers, tuple(used.values()))

    @property
    def notices(self) -> tuple[str, ...]:
        """What the artifacts have to say about themselves, each line once."""
        return tuple(dict.fromkeys(line for item in self.artifacts for line in item.notice))

    @property
    def from_nothing_s(self) -> float:
        """Wall time of all artifacts and of everything that they rest on (s)."""
        return from_nothing_s(self.artifacts)

    def line(self) -> str:
        """One line for a reader: preset, seeds, cache or recomputed, commit, lock, notices."""
        parts = [f"preset {self.preset}" + _SMOKE.get(self.preset, "")]
        if os.environ.get("CASSIE_PRESET"):
            parts[0] += " (set by CASSIE_PRESET)"
        if self.changed:
            parts.append("changed " + ", ".join(f"{k}={v}" for k, v in self.changed.items()))
        if self.seeds:
            parts.append(f"seeds {_ranges(self.seeds)}")
        cached = [item.name for item in self.artifacts if _from_cache(item)]
        made = [item.name for item in self.artifacts if not _from_cache(item)]
        if made:
            parts.append("recomputed " + ", ".join(made))
        if cached:
            parts.append("from cache " + ", ".join(cached))
        parts += [f"commit {self.commit}", f"lock {self.lock}"]
        return " · ".join(parts + [f"NOTICE: {line}" for line in self.notices])

    def record(self) -> dict[str, Any]:
        """The same as plain values for a JSON file."""
        return {
            "line": self.line(),
            "preset": self.preset,
            "changed": self.changed,
            "seeds": list(self.seeds),
            "commit": self.commit,
            "lock": self.lock,
            "libraries": library_versions(),
            "artifacts": [_artifact_record(item) for item in self.artifacts],
            "notices": list(self.notices),
        }

    def __str__(self) -> str:
        """The line."""
        return self.line()


_SMOKE = {"smoke": " (a test run: its numbers mean nothing)"}


def _from_cache(item: Artifact) -> bool:
    """False also when another process of this run has computed it."""
    return item.from_cache and item.name not in computed()


def _artifact_record(item: Artifact) -> dict[str, Any]:
    return {
        "name": item.name,
        "key": item.key,
        "digest": item.digest,
        "from_cache": _from_cache(item),
        "wall_time_s": item.wall_time_s,
        "commit": item.manifest["commit"],
    }


def _ranges(numbers: tuple[int, ...]) -> str:
    """Write 0, 1, 2, 5 as ``0-2, 5``."""
    spans: list[list[int]] = []
    for number in sorted(set(numbers)):
        if spans and number == spans[-1][1] + 1:
            spans[-1][1] = number
        else:
            spans.append([number, number])
    return ", ".join(str(a) if a == b else f"{a}-{b}" for a, b in spans)


def provenance_line(
    preset: str, seeds: int | Iterable[int] = (), artifacts: Iterable[Artifact] = ()
) -> str:
    """Shortcut for ``Provenance.of(preset, seeds, artifacts).line()``."""
    return Provenance.of(preset, seeds, artifacts).line()
