"""An upstream result that is known by its recipe and computed only when somebody needs it.

A trained model that is kept in git depends on minutes of data collection.  Whoever only loads the
model must not have to collect the data first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from cassie_lib.artifacts.manifest import Artifact
from cassie_lib.artifacts.stages import get_stage, recipe, recipe_key
from cassie_lib.artifacts.store import Upstream, find, load_or_compute
from cassie_lib.errors import ParameterError


class Pending:
    """What :func:`~cassie_lib.artifacts.load_or_compute` would return, not asked for yet.

    Attributes:
        stage, key: As of the artifact.
    """

    def __init__(
        self,
        stage: str,
        parameters: Any,
        compute: Callable[[Path], None],
        upstream: Iterable[Upstream] = (),
        **options: Any,
    ) -> None:
        """Arguments as for :func:`~cassie_lib.artifacts.load_or_compute`.

        Raises:
            ParameterError: If later stages depend on the stage's content: it has to be computed
                before anything about it is known.
            UnknownNameError: If the stage is unknown.
        """
        if get_stage(stage).by_content:
            raise ParameterError(
                f"stage {stage!r} counts by its content: expected one that counts by its recipe"
            )
        self.stage, self._upstream = stage, tuple(upstream)
        identities = tuple(item.identity for item in self._upstream)
        self.key = recipe_key(recipe(stage, parameters, identities))
        self._arguments, self._options = (stage, parameters, compute, self._upstream), options

    @property
    def identity(self) -> str:
        """What later stages depend on: the recipe."""
        return self.key

    @property
    def name(self) -> str:
        """Folder name of the artifact."""
        return f"{self.stage}-{self.key[:12]}"

    def get(self) -> Artifact:
        """Load it, or compute it first."""
        return load_or_compute(*self._arguments, **self._options)

    def at_hand(self) -> Artifact | None:
        """The stored artifact, or None when it has not been computed here."""
        return find(self.stage, self.key, upstream=self._upstream)


__all__ = ["Pending"]
