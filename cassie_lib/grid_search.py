"""Hyper-parameter grid of Appendix A.1: 243 points, or those that differ from the thesis's in one.

``python -m cassie_lib.grid_search list --preset thesis``
``python -m cassie_lib.grid_search point 121 --preset thesis``
``python -m cassie_lib.grid_search table --preset thesis``

``notebooks/grid.smk`` runs the points as jobs of a cluster.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from cassie_lib import pipeline
from cassie_lib.artifacts import WORK, Artifact, load_or_compute
from cassie_lib.artifacts.side_by_side import side_by_side
from cassie_lib.dynamics.evaluation import open_loop
from cassie_lib.dynamics.run import CHECKPOINT
from cassie_lib.dynamics.training import train_transformer
from cassie_lib.errors import CassieError, ParameterError
from cassie_lib.files import write_json
from cassie_lib.presets import Preset, TransformerParameters, replace, resolve
from cassie_lib.threads import one_torch_thread

#: What the grid varies, in the order that numbers the points.
FACTORS = ("batch_size", "context", "learning_rate", "dropout", "weight_decay")
#: Predicted steps of the score.
HORIZON = 10
SCORE = "score.json"


@dataclass(frozen=True)
class Point:
    """One point of the grid.

    Attributes:
        number: 0 to 242, the last factor varying fastest.
        values: Value of each of :data:`FACTORS`.
        seed: Of weights and batches.
    """

    number: int
    values: tuple[float, ...]
    seed: int = 0

    def changed(self, other: Point) -> dict[str, float]:
        """Factors in which it differs from another point, with its own values."""
        pairs = zip(FACTORS, self.values, other.values, strict=True)
        return {name: mine for name, mine, theirs in pairs if mine != theirs}


def grid_points(preset: Preset) -> list[Point]:
    """All points of a preset's grid, in the order of their numbers."""
    values = itertools.product(*(getattr(preset.grid, name) for name in FACTORS))
    return [Point(number, found) for number, found in enumerate(values)]


def base_point(preset: Preset) -> Point:
    """The point that the thesis chose; the preset's transformer if the grid lacks that.

    Raises:
        ParameterError: If the grid contains neither.
    """
    points = {point.values: point for point in grid_points(preset)}
    for parameters in (TransformerParameters(), preset.transformer):
        chosen = tuple(getattr(parameters, name) for name in FACTORS)
        if chosen in points:
            return points[chosen]
    raise ParameterError(f"grid lacks {dict(zip(FACTORS, chosen, strict=True))}")


def one_factor_points(preset: Preset) -> list[Point]:
    """The thesis's choice, with several seeds, and the points that differ from it in one factor.

    The spread over the seeds is the size below which an effect means nothing.
    """
    base = base_point(preset)
    near = [point for point in grid_points(preset) if len(point.changed(base)) == 1]
    return [replace(base, seed=seed) for seed in range(preset.grid.base_seeds)] + near


def point_parameters(preset: Preset, point: Point) -> TransformerParameters:
    """The transformer of a point with the grid's budget."""
    grid = preset.grid
    factors: dict[str, Any] = dict(zip(FACTORS, point.values, strict=True))
    return replace(
        preset.transformer, **factors, seed=point.seed,
        epochs=grid.epochs, windows_per_epoch=grid.windows_per_epoch, horizon=grid.horizon,
        gradient_penalty=grid.gradient_penalty, max_minutes=0.0,
    )  # fmt: skip


def point_artifact(preset: Preset, point: Point) -> Artifact:
    """Train one point and keep its score on the validation set; the weights are not kept."""
    parameters = point_parameters(preset, point)
    names = ("train", "validation")
    # The same windows for every H: all start after the longest history of the grid.
    longest = max(preset.grid.context)

    def compute(folder: Path) -> None:
        train, validation = (pipeline.transitions(preset, name) for name in names)
        work = folder / WORK
        work.mkdir(parents=True, exist_ok=True)
        # Several points train side by side; one alone does not depend on the number of cores.
        with one_torch_thread():
            trained = train_transformer(train, parameters, validation=validation, folder=work)
            found = open_loop(
                trained.model, validation, HORIZON, preset.grid.evaluation_windows, context=longest
            )
        loss = found.thesis_loss_by_step(parameters.order_weights, "normalised")[0]
        score = {"one_step_loss": float(loss), **found.summary(), "steps": trained.steps}
        write_json(folder / SCORE, score)
        write_json(folder / "timing.json", {"training_s": trained.seconds})
        (work / CHECKPOINT).unlink(missing_ok=True)

    recipe = {"grid": parameters, "windows": preset.grid.evaluation_windows, "context": longest}
    upstream = [pipeline.pending_dataset(preset, name) for name in names]
    return load_or_compute(
        "prediction", recipe, compute, upstream, preset=preset.name, seed=point.seed, kept=True
    )


def point_calls(preset: Preset, points: Iterable[Point]) -> list[Callable[[], Artifact]]:
    """:func:`point_artifact` of points, as calls to be made side by side with others."""
    return [partial(point_artifact, preset, point) for point in points]


def score_table(preset: Preset, points: Iterable[Point]) -> tuple[list[dict], list[Artifact]]:
    """Scores of points, computed where they are missing.

    Returns:
        One row per point (number, seed, factors, ``one_step_loss`` (Eq 3.5, normalised, validation
        set), relative errors at steps 1 and 10, minutes), and the artifacts.
    """
    base, rows, points = base_point(preset), [], list(points)
    used = side_by_side(point_calls(preset, points))
    for point, artifact in zip(points, used, strict=True):
        score = json.loads(artifact.file(SCORE).read_text(encoding="utf-8"))
        row: dict[str, Any] = {"point": point.number, "seed": point.seed}
        row |= dict(zip(FACTORS, point.values, strict=True))
        row["changed"] = ", ".join(f"{k} {v:g}" for k, v in point.changed(base).items())
        names = ("one_step_loss", "relative_step_1", f"relative_step_{HORIZON}")
        row |= {name: score[name] for name in names}
        rows.append({**row, "minutes": artifact.wall_time_s / 60})
    return rows, used


def select_points(preset: Preset, subset: str) -> list[Point]:
    """Points by the name of a subset: ``"all"`` or ``"one_factor"``.

    Raises:
        ParameterError: If there is no such subset.
    """
    if subset == "all":
        return grid_points(preset)
    if subset == "one_factor":
        return one_factor_points(preset)
    raise ParameterError(f"subset is {subset!r}: expected all or one_factor")


def _numbered(preset: Preset, number: int, seed: int) -> Point:
    points = grid_points(preset)
    if not 0 <= number < len(points):
        raise ParameterError(f"point is {number}: expected 0 to {len(points) - 1}")
    return replace(points[number], seed=seed)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m cassie_lib.grid_search", description=__doc__)
    parser.add_argument("command", choices=("list", "data", "point", "table"))
    parser.add_argument("number", type=int, nargs="?", help="of the point, for the command point")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--preset", default="laptop")
    parser.add_argument("--subset", default="one_factor", help="all or one_factor")
    options = parser.parse_args(arguments)
    try:
        preset = resolve(options.preset)
        points = select_points(preset, options.subset)
        if options.command == "list":
            for point in points:
                print(point.number, point.seed, dict(zip(FACTORS, point.values, strict=True)))
        elif options.command == "data":
            for name in ("train", "validation"):
                print(pipeline.dataset_artifact(preset, name).name)
        else:
            if options.command == "point":
                if options.number is None:
                    raise ParameterError("point needs a number: expected for example 'point 121'")
                points = [_numbered(preset, options.number, options.seed)]
            for row in score_table(preset, points)[0]:
                print(json.dumps(row))
    except CassieError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


__all__ = [
    "FACTORS",
    "HORIZON",
    "Point",
    "base_point",
    "grid_points",
    "one_factor_points",
    "point_artifact",
    "point_calls",
    "point_parameters",
    "score_table",
    "select_points",
]

if __name__ == "__main__":
    sys.exit(main())
