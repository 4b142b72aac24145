"""The stages whose results are stored, and what identifies a result."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from cassie_lib.code_version import code_fingerprint
from cassie_lib.errors import unknown_name
from cassie_lib.files import canonical_json, plain, sha256_text


@dataclass(frozen=True)
class Stage:
    """A kind of stored result.

    Attributes:
        version: Raised by hand whenever the stage computes something else from the same
            parameters.  It is part of the hash, so older results are no longer found.
        modules: Modules and folders of ``cassie_lib`` that do the work.  Their fingerprint is
            stored; when it differs on load the artifact says so in its notice.
        without: Files in those folders that have no part in the work.
        by_content: How later stages depend on this one.  True: on its bits (weights, which are
            kept in git).  False: on its recipe (data that any machine makes again, where the last
            digit of a float may differ and must not cost anyone a retraining).
    """

    version: int
    modules: tuple[str, ...]
    without: tuple[str, ...] = ()
    by_content: bool = False

    def code(self) -> dict[str, str]:
        """Fingerprints of the source files that do the work, by path below the package."""
        found = code_fingerprint(self.modules)
        return {path: value for path, value in found.items() if path not in self.without}


_ROBOT = ("robot", "gait", "reward", "simulator")
_WALKING = (*_ROBOT, "controllers", "recording", "walking")
_PLANNING = (*_WALKING, "threads", "dynamics", "planning", "packing")
#: Models learn from arrays; mirror, derivative orders and slices are those of the schema.
_LEARNING = ("robot/schema", "data", "dynamics")
#: The fast rollout of a model whose weights are fixed: planners use it, training does not.
_FROZEN = ("dynamics/adjoint.py", "dynamics/adjoint_layers.py")
#: What else the windowed models have no part in: the loop that trains the causal one.
_WINDOWED = (*_FROZEN, "dynamics/train_causal.py")
#: Lets killed episodes go on; they end with the bits that they would have had.
_RESUME = ("planning/resume.py",)

#: Raise a version here when a stage's results change; see :class:`Stage`.
STAGES = {
    "expert": Stage(1, (*_WALKING, "expert"), by_content=True),
    "selection": Stage(1, (*_WALKING, "walking_report", "expert", "expert_selection")),
    "walking": Stage(1, (*_WALKING, "expert")),
    "data": Stage(1, (*_WALKING, "expert", "data")),
    "mlp": Stage(2, _LEARNING, _WINDOWED, by_content=True),
    "transformer": Stage(1, _LEARNING, _WINDOWED, by_content=True),
    "causal": Stage(1, _LEARNING, _FROZEN, by_content=True),
    "prediction": Stage(2, _LEARNING, _WINDOWED),
    "cem": Stage(1, _PLANNING, _RESUME),
    "gradient_cem": Stage(1, _PLANNING, _RESUME),
    "dagger": Stage(1, (*_PLANNING, "data", "dagger"), _RESUME, by_content=True),
}


def get_stage(name: str) -> Stage:
    """Look a stage up.

    Raises:
        UnknownNameError: If there is no such stage.
    """
    if name not in STAGES:
        raise unknown_name("stage", name, STAGES)
    return STAGES[name]


def recipe(stage: str, parameters: Any, upstream: tuple[str, ...]) -> dict[str, Any]:
    """Everything that decides a result: stage, version, parameters and upstream identities.

    Args:
        stage: A name in :data:`STAGES`.
        parameters: Frozen dataclass, or a mapping or sequence of such.
        upstream: Identities of the artifacts that it is computed from, in order.

    Raises:
        UnknownNameError: If there is no such stage.
        ParameterError: If a parameter is not finite or has no canonical form.
    """
    return {
        "stage": stage,
        "version": get_stage(stage).version,
        "parameters": plain(parameters),
        "upstream": list(upstream),
    }


def recipe_key(found: dict[str, Any]) -> str:
    """SHA-256 of a recipe, 64 hexadecimal digits."""
    names = ("stage", "version", "parameters", "upstream")
    return sha256_text(canonical_json({name: found[name] for name in names}))
