"""The policies that are trained, each loaded or computed: pipeline.py, first part."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

from cassie_lib.artifacts import WORK, Artifact, load_or_compute
from cassie_lib.expert.policy import CARD_FILE, Expert, load_expert, save_expert
from cassie_lib.expert.ppo import RecurrentPPO
from cassie_lib.expert_selection import SEED, score, select
from cassie_lib.files import plain, write_json
from cassie_lib.presets import ExpertParameters, Preset
from cassie_lib.threads import one_torch_thread

#: Most episodes of each trial that chooses the expert.
_EPISODES = 8
SCORES_FILE = "trials.json"


def first_expert_artifact(preset: Preset) -> Artifact:
    """The policy after its first training; the second goes on from it."""
    return _trained_policy(preset, preset.expert)


def continued_expert_artifact(preset: Preset) -> Artifact:
    """The policy after its second training."""
    return _trained_policy(preset, preset.expert_continuation, first_expert_artifact(preset))


def expert_artifact(preset: Preset) -> Artifact:
    """The expert pi* of section 4.3.1: the one of both policies that does better in trials.

    Its weights and card, and the scores of both (:mod:`cassie_lib.expert_selection`).
    """
    candidates = [first_expert_artifact(preset), continued_expert_artifact(preset)]
    protocol = {
        "episodes": min(_EPISODES, preset.evaluation.expert_seeds),
        "steps": preset.evaluation.short_steps,
        "timestep_s": preset.simulation.timestep_s,
    }

    def compute(folder: Path) -> None:
        # Of equal bits whatever the number of cores, like all that later stages rest on.
        with one_torch_thread():
            scores = {item.name: score(load_expert(item.path), **protocol) for item in candidates}
        chosen = select(scores)
        source = next(item for item in candidates if item.name == chosen)
        card = json.loads((source.path / CARD_FILE).read_text()) | {"chosen": chosen}
        save_expert(load_expert(source.path).policy, folder, card)
        write_json(folder / SCORES_FILE, {name: item._asdict() for name, item in scores.items()})

    return load_or_compute(
        "selection", {"protocol": protocol, "seed": SEED}, compute, candidates,
        preset=preset.name, seed=SEED, kept=True,
    )  # fmt: skip


def expert_choice(preset: Preset) -> str:
    """What the trials said of both policies, and which is the expert: lines for the reader."""
    artifact = expert_artifact(preset)
    scores = json.loads(artifact.file(SCORES_FILE).read_text())
    chosen = json.loads(artifact.file(CARD_FILE).read_text())["chosen"]
    return "\n".join(
        f"after the {order} training: {found['walks']:.0%} of the episodes walk, "
        f"{found['passed']:.0%} of all trials passed{': the expert' if name == chosen else ''}"
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
    "first_expert_artifact",
    "reward_only_artifact",
]
