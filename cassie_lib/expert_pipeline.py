"""The policies that are trained, each loaded or computed: pipeline.py, first part."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

from cassie_lib.artifacts import WORK, Artifact, load_or_compute
from cassie_lib.expert.policy import Expert, load_expert, save_expert
from cassie_lib.expert.ppo import RecurrentPPO
from cassie_lib.expert_selection import SEED, Score, score, select
from cassie_lib.files import plain, write_json
from cassie_lib.presets import ExpertParameters, Preset
from cassie_lib.threads import one_torch_thread

#: Most episodes of each trial that chooses the expert.
_EPISODES = 8
_SCORES = "scores.json"


def first_expert_artifact(preset: Preset) -> Artifact:
    """The policy after its first training; the second goes on from it."""
    return _trained_policy(preset, preset.expert)


def continued_expert_artifact(preset: Preset) -> Artifact:
    """The policy after its second training."""
    return _trained_policy(preset, preset.expert_continuation, first_expert_artifact(preset))


def expert_artifact(preset: Preset) -> Artifact:
    """The expert pi* of section 4.3.1: weights, card and ``timing_log.csv``.

    Of the two policies it is the one that does better in trials (:func:`expert_scores`).
    """
    chosen = select(expert_scores(preset))
    return next(item for item in _policies(preset) if item.name == chosen)


def expert_scores(preset: Preset) -> dict[str, Score]:
    """What trials say of the policies after the first and the second training, by artifact."""
    policies = _policies(preset)
    protocol: dict[str, Any] = {
        "episodes": min(_EPISODES, preset.evaluation.expert_seeds),
        "steps": preset.evaluation.short_steps,
        "timestep_s": preset.simulation.timestep_s,
    }

    def compute(folder: Path) -> None:
        # Of equal bits whatever the number of cores: all later stages rest on the choice.
        with one_torch_thread():
            found = {item.name: score(load_expert(item.path), **protocol) for item in policies}
        write_json(folder / _SCORES, {name: item._asdict() for name, item in found.items()})

    stored = load_or_compute(
        "selection", {"protocol": protocol, "seed": SEED}, compute, policies,
        preset=preset.name, seed=SEED, kept=True,
    )  # fmt: skip
    scores = json.loads(stored.file(_SCORES).read_text())
    return {item.name: Score(**scores[item.name]) for item in policies}


def _policies(preset: Preset) -> list[Artifact]:
    """Those of which one becomes the expert, in the order in which they were trained."""
    return [first_expert_artifact(preset), continued_expert_artifact(preset)]


def expert_choice(preset: Preset) -> str:
    """Scores of both policies, and which is the expert: lines for the reader."""
    scores = expert_scores(preset)
    chosen = select(scores)
    return "\n".join(
        f"after the {order} training: {found.walks:.0%} of the episodes walk, "
        f"{found.passed:.0%} of all trials passed{': the expert' if name == chosen else ''}"
        for order, (name, found) in zip(("first", "second"), scores.items(), strict=True)
    )


def reward_only_artifact(preset: Preset) -> Artifact:
    """A policy trained on Eq 3.10 alone at 0.0509 m/s, which learns to stand still."""
    return _trained_policy(preset, preset.reward_only_expert)


def _trained_policy(
    preset: Preset, parameters: ExpertParameters, first: Artifact | None = None
) -> Artifact:
    timestep_s = preset.simulation.training_timestep_s

    def compute(folder: Path) -> None:
        work = folder / WORK
        work.mkdir(parents=True, exist_ok=True)
        run = RecurrentPPO(parameters, timestep_s)
        if first is not None:
            run.policy.load_state_dict(load_expert(first.path).policy.state_dict())
        policy = run.train(work)
        # Wall times stay out of the card: they would make equal weights look different.
        card = {"parameters": plain(parameters), "timestep_s": timestep_s, "steps": run.steps}
        if first is not None:
            card["continues"] = first.name
        save_expert(policy, folder, card)
        shutil.copyfile(work / "log.csv", folder / "timing_log.csv")
        write_json(folder / "timing.json", {"training_s": run.seconds})

    return load_or_compute(
        "expert", {"expert": parameters, "timestep_s": timestep_s}, compute,
        [first] if first else [], preset=preset.name, seed=parameters.seed, kept=True,
    )  # fmt: skip


def expert(preset: Preset) -> Expert:
    """The expert as a controller."""
    return load_expert(expert_artifact(preset).path)


__all__ = [
    "continued_expert_artifact",
    "expert",
    "expert_artifact",
    "expert_choice",
    "expert_scores",
    "first_expert_artifact",
    "reward_only_artifact",
]
