"""The whole pipeline at sizes that take seconds; every stage by the name of its artifact."""

from __future__ import annotations

from cassie_lib import dagger_pipeline, pipeline, planner_pipeline
from cassie_lib.dynamics.store import load_model
from cassie_lib.expert.policy import load_expert
from cassie_lib.presets import CollectionParameters, SimulationParameters, get_preset, replace

SMOKE = get_preset("smoke")
_SETS = {
    name: replace(getattr(SMOKE.data, name), transitions=120, episode_steps=30)
    for name, kind in vars(SMOKE.data).items()
    if isinstance(kind, CollectionParameters)
}
TINY = replace(
    SMOKE,
    simulation=SimulationParameters(timestep_s=0.002, training_timestep_s=0.002),
    expert=replace(SMOKE.expert, total_steps=112, refinement_steps=0, checkpoint_seconds=0.0),
    data=replace(SMOKE.data, **_SETS),
    causal=replace(SMOKE.causal, max_minutes=0.0, checkpoint_seconds=0.0),
    cem=replace(SMOKE.cem, samples=4, elites=2),
    gradient_cem=replace(SMOKE.gradient_cem, samples=4, elites=2),
    dagger=replace(SMOKE.dagger, transitions=100, episode_steps=25, minutes_per_round=0.0),
    evaluation=replace(SMOKE.evaluation, cem_steps=10),
)
#: Loads what an artifact holds, as the stages and figures after it do.
LOADERS = {
    # One policy, whichever is the expert: what changes it has it tried again.
    "expert": lambda: load_expert(pipeline.continued_expert_artifact(TINY).path),
    "data": lambda: pipeline.dataset(TINY, "train"),
    "mlp": lambda: load_model(pipeline.mlp_artifact(TINY).path, "mlp"),
    "transformer": lambda: load_model(pipeline.transformer_artifact(TINY).path, "transformer"),
    "causal": lambda: planner_pipeline.causal_model(TINY),
    "cem": lambda: planner_pipeline.planner_trial(TINY, "cem"),
    "dagger": lambda: dagger_pipeline.dagger(TINY, rounds=1),
}
ARTIFACTS = {
    "expert": lambda: pipeline.continued_expert_artifact(TINY),
    "data": lambda: pipeline.dataset_artifact(TINY, "train"),
    "wide": lambda: pipeline.dataset_artifact(TINY, "wide"),
    "mlp": lambda: pipeline.mlp_artifact(TINY),
    "transformer": lambda: pipeline.transformer_artifact(TINY),
    "causal": lambda: pipeline.causal_artifact(TINY),
    "cem": lambda: planner_pipeline.planner_trial(TINY, "cem").artifact,
    "dagger": lambda: dagger_pipeline.dagger(TINY, rounds=1)[0].artifact,
}


def build() -> None:
    """Compute all of them, or load what there is."""
    for load in LOADERS.values():
        load()
