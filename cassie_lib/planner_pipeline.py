"""Trials of planners, each loaded or computed: pipeline.py, continued."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cassie_lib import pipeline
from cassie_lib.artifacts import Artifact, load_or_compute
from cassie_lib.artifacts.side_by_side import side_by_side
from cassie_lib.dagger import Round
from cassie_lib.dynamics.causal import CausalModel
from cassie_lib.dynamics.store import load_causal
from cassie_lib.errors import ParameterError, unknown_name
from cassie_lib.expert.policy import load_expert
from cassie_lib.files import write_json
from cassie_lib.planning.cem import MEANS
from cassie_lib.planning.episodes import PlannedEpisodes
from cassie_lib.planning.evaluate import Protocol, evaluate
from cassie_lib.planning.oracle import OracleModel
from cassie_lib.presets import CEMParameters, Preset, replace
from cassie_lib.threads import one_torch_thread
from cassie_lib.walking import run_episodes

PLANNERS = ("cem", "gradient_cem")


class Trial(NamedTuple):
    """Episodes of a planner in closed loop, and where they are stored."""

    episodes: PlannedEpisodes
    artifact: Artifact


def causal_model(preset: Preset, *, wide: bool = True) -> CausalModel:
    """The learned model that planners use; see :func:`cassie_lib.pipeline.causal_artifact`."""
    return load_causal(pipeline.causal_artifact(preset, wide=wide).path)


def baselines_artifact(preset: Preset) -> Artifact:
    """Plain Eq 3.10 per step of pi* and of the policy that has learned to stand still."""
    upstream = [pipeline.expert_artifact(preset), pipeline.reward_only_artifact(preset)]
    protocol: dict[str, Any] = {
        "episodes": preset.evaluation.seeds,
        "steps": preset.evaluation.short_steps,
        "speed_mps": preset.simulation.speed_mps,
        "timestep_s": preset.simulation.timestep_s,
    }

    def compute(folder: Path) -> None:
        found = {}
        for name, artifact in zip(("pi*", "standing still"), upstream, strict=True):
            with one_torch_thread():
                recording = run_episodes(load_expert(artifact.path), **protocol)
            found[name] = {
                "reward": float(np.nanmean(recording.reward)),
                "falls": int(recording.fell.sum()),
            }
        write_json(folder / "baselines.json", found)

    return load_or_compute("walking", protocol, compute, upstream, preset=preset.name, seed=0)


def baselines(preset: Preset) -> dict[str, float]:
    """Rewards per step of :func:`baselines_artifact` by name: lines of the reward figures."""
    found = json.loads(baselines_artifact(preset).file("baselines.json").read_text())
    return {name: item["reward"] for name, item in found.items()}


def planner_parameters(preset: Preset, planner: str) -> CEMParameters:
    """A preset's section of a planner.

    Raises:
        UnknownNameError: If the planner is not one of :data:`PLANNERS`.
    """
    if planner not in PLANNERS:
        raise unknown_name("planner", planner, PLANNERS)
    return getattr(preset, planner)


def _protocol(preset: Preset, **changes) -> Protocol:
    standard = Protocol(
        preset.evaluation.seeds,
        preset.evaluation.planner_steps,
        speed_mps=preset.simulation.speed_mps,
        timestep_s=preset.simulation.timestep_s,
    )
    return replace(standard, **changes)


def planner_trial(
    preset: Preset,
    planner: str,
    *,
    changes: Mapping[str, Any] | None = None,
    after: Round | None = None,
    wide: bool = True,
    steps: int | None = None,
    **protocol,
) -> Trial:
    """Closed-loop episodes of a planner on a learned model.

    Args:
        preset: The preset.
        planner: One of :data:`PLANNERS`.
        changes: Planner parameters that differ from the preset's, by name.
        after: Round of DAgger whose model is used; default the model before all rounds.
        wide: Whether that model was trained on the wide data, too.
        steps: Control steps of an episode; default those of the preset for the planner.
        protocol: Other fields of :class:`~cassie_lib.planning.evaluate.Protocol` that differ from
            the preset's evaluation.

    Raises:
        UnknownNameError: If the planner is unknown.
        ParameterError: If a push is to come after the end.
    """
    parameters = replace(planner_parameters(preset, planner), **(changes or {}))
    if steps is None:
        sizes = preset.evaluation
        steps = sizes.cem_steps if planner == "cem" else sizes.planner_steps
    if protocol.get("push_Ns"):
        # In the middle of a trial that ends before the usual step of a push.
        protocol.setdefault("push_step", min(Protocol.push_step, steps // 2))
        if not 0 <= protocol["push_step"] < steps:
            raise ParameterError(
                f"push_step = {protocol['push_step']}: expected 0 to {steps - 1}, within the trial"
            )
    source = after.artifact if after else pipeline.causal_artifact(preset, wide=wide)
    expert = pipeline.expert_artifact(preset)
    return Trial(
        *evaluate(
            "dagger" if after else planner, _protocol(preset, steps=steps, **protocol),
            after.model if after else causal_model(preset, wide=wide), parameters,
            load_expert(expert.path), upstream=[expert, source],
            preset=preset.name,
        )
    )  # fmt: skip


def planner_trials(
    preset: Preset, planner: str, wanted: Mapping[str, Mapping[str, Any]]
) -> dict[str, Trial]:
    """Trials that do not need each other, computed side by side where they are missing.

    Args:
        preset: The preset.
        planner: One of :data:`PLANNERS`.
        wanted: Arguments of :func:`planner_trial` for each, by a name.

    Returns:
        The trials by those names.
    """
    calls = [partial(planner_trial, preset, planner, **options) for options in wanted.values()]
    usual = preset.evaluation.planner_steps
    costs = [float(options.get("steps") or usual) for options in wanted.values()]
    return dict(zip(wanted, side_by_side(calls, costs), strict=True))


def mean_trials(preset: Preset, planner: str) -> dict[str, Trial]:
    """Shorter trials with each initial mean of the plans; see :func:`planner_trial`.

    The preset's own mean is taken from the full trial, which begins with the same steps.
    """
    # An untrained expert falls before it has a cycle.
    means = [mean for mean in MEANS if not (mean == "expert" and preset.name == "smoke")]
    own = planner_parameters(preset, planner).mean
    steps = preset.evaluation.ablation_steps
    wanted = {
        mean: {"steps": None if mean == own else steps, "changes": {"mean": mean}} for mean in means
    }
    return planner_trials(preset, planner, wanted)


def reward_trials(preset: Preset, planner: str) -> dict[str, Trial]:
    """What the planner's reward adds to Eq 3.11 of the thesis, part by part.

    The preset's own reward is taken from the full trial, which begins with the same steps.
    """
    steps = preset.evaluation.ablation_steps
    no_speed, no_lift = {"speed_weight": 0.0}, {"foot_weight": 0.0}
    wanted = {
        "Eq 3.11 alone": {"steps": steps, "changes": no_speed | no_lift | {"terminal_weight": 0.0}},
        "with the critic": {"steps": steps, "changes": no_speed | no_lift},
        "with the critic and the foot term": {"steps": steps, "changes": no_speed},
        "with the critic, the foot term and the speed of a cycle": {},
    }
    return planner_trials(preset, planner, wanted)


def playback_trial(preset: Preset) -> Trial:
    """The feed-forward cycle played after the hand-over, with no planner."""
    alone = {
        "mean": "feedforward", "samples": 1, "elites": 1, "iterations": 1, "include_mean": True,
        "variance": (0.0,) * len(preset.cem.variance), "std_floor_rad": 0.0,
    }  # fmt: skip
    return planner_trial(preset, "cem", steps=preset.evaluation.ablation_steps, changes=alone)


def oracle_trial(preset: Preset, planner: str) -> Trial:
    """The same planner on the true simulator: fewer seeds and steps, because it is expensive."""
    parameters, sizes = planner_parameters(preset, planner), preset.evaluation
    gradient = planner == "gradient_cem"
    oracle = OracleModel(preset.causal.context, sizes.oracle_timestep_s)
    protocol = _protocol(
        preset,
        episodes=sizes.oracle_gradient_seeds if gradient else sizes.oracle_seeds,
        steps=sizes.oracle_gradient_steps if gradient else sizes.oracle_steps,
    )
    expert = pipeline.expert_artifact(preset)
    return Trial(
        *evaluate(
            planner, protocol, oracle, parameters, load_expert(expert.path), upstream=[expert],
            preset=preset.name,
        )
    )  # fmt: skip


__all__ = [
    "PLANNERS",
    "Trial",
    "baselines",
    "baselines_artifact",
    "causal_model",
    "mean_trials",
    "oracle_trial",
    "playback_trial",
    "planner_parameters",
    "planner_trial",
    "planner_trials",
]
