"""Planner episodes as stored results: one protocol, one artifact."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from cassie_lib.artifacts import WORK, Artifact, load_or_compute
from cassie_lib.dynamics.model import DynamicsModel
from cassie_lib.errors import ParameterError, unknown_name
from cassie_lib.files import canonical_json, plain
from cassie_lib.planning.assemble import make_planner
from cassie_lib.planning.control import PlannerController
from cassie_lib.planning.episodes import (
    PlannedEpisodes,
    load_episodes,
    plan_episodes,
    save_episodes,
)
from cassie_lib.planning.resume import ResumableController
from cassie_lib.presets import CEMParameters
from cassie_lib.simulator import S0_SPEED_MPS
from cassie_lib.threads import one_torch_thread
from cassie_lib.walking import Push

STARTS = ("handover", "padded")
EPISODES = "episodes.npz"


@dataclass(frozen=True)
class Protocol:
    """How planner episodes are run.

    Attributes:
        episodes: Number of seeds, all planned in one batch.
        steps: Control steps.
        start: ``"handover"``: the expert drives the first H steps; ``"padded"``: no expert, the
            context starts as copies of s0.
        seed: First seed of planners and starts.
        perturbation: Spread of random initial velocities, m/s and rad/s.
        speed_mps: Commanded forward speed.
        timestep_s: Physics step of the loop.
        push_Ns: Sideways (y) impulse on the pelvis; 0 for none.
        push_step: Control step at which the push starts.
    """

    episodes: int = 10
    steps: int = 1000
    start: str = "handover"
    seed: int = 0
    perturbation: float = 0.05
    speed_mps: float = S0_SPEED_MPS
    timestep_s: float = 0.0005
    push_Ns: float = 0.0
    push_step: int = 200


def run_protocol(
    protocol: Protocol,
    model: DynamicsModel,
    parameters: CEMParameters,
    expert=None,
    checkpoint: tuple[Path, str] | None = None,
) -> PlannedEpisodes:
    """Run planner episodes.

    Args:
        protocol: How.
        model: Learned model or oracle.
        parameters: A preset's ``cem`` or ``gradient_cem``.
        expert: :class:`cassie_lib.expert.policy.Expert`; not needed for a padded start.
        checkpoint: Folder in which killed episodes leave what they need to go on, and what must
            agree for that; default none.

    Raises:
        CheckpointError: If the checkpoint is damaged or of other episodes.
        UnknownNameError: If the start is not one of the two.
        ParameterError: If a hand-over is wanted and there is no expert.
    """
    if protocol.start not in STARTS:
        raise unknown_name("start", protocol.start, STARTS)
    if protocol.start == "handover" and expert is None:
        raise ParameterError('expert is None: expected one, the start is "handover"')
    planner = make_planner(model, parameters, expert=expert, speed_mps=protocol.speed_mps)
    driver = expert if protocol.start == "handover" else None
    push = Push(protocol.push_step, (0.0, protocol.push_Ns, 0.0)) if protocol.push_Ns else None
    controller = PlannerController(planner, driver)
    if checkpoint is not None:
        controller = ResumableController(planner, driver, *checkpoint, protocol.steps)
    return plan_episodes(
        controller,
        episodes=protocol.episodes,
        steps=protocol.steps,
        speed_mps=protocol.speed_mps,
        perturbation=protocol.perturbation,
        push=push,
        seed=protocol.seed,
        timestep_s=protocol.timestep_s,
    )


def evaluate(
    stage: str,
    protocol: Protocol,
    model: DynamicsModel,
    parameters: CEMParameters,
    expert=None,
    *,
    upstream: Iterable[Artifact] = (),
    preset: str = "",
) -> tuple[PlannedEpisodes, Artifact]:
    """:func:`run_protocol`, stored: loaded when it has been run before.

    Args:
        stage: ``"cem"``, ``"gradient_cem"`` or ``"dagger"``.
        protocol: How.
        model: Learned model or oracle; of an oracle, its settings are part of the recipe.
        parameters: A preset's ``cem`` or ``gradient_cem``.
        expert: The expert.
        upstream: Artifacts of model and expert, which decide the result.
        preset: For the record.

    Returns:
        The episodes and their artifact.
    """
    settings = getattr(model, "settings", None)
    recipe = {
        "protocol": protocol,
        "planner": parameters,
        "model": {"kind": getattr(model, "kind", "learned"), **(settings or {})},
    }

    def compute(folder: Path) -> None:
        checkpoint = folder / WORK, canonical_json(plain(recipe))
        # The expert's share of an episode, too, must not depend on the number of cores.
        with one_torch_thread():
            episodes = run_protocol(protocol, model, parameters, expert, checkpoint)
        save_episodes(folder / EPISODES, episodes)

    artifact = load_or_compute(
        stage, recipe, compute, upstream, preset=preset, seed=protocol.seed, kept=True
    )
    return load_episodes(artifact.file(EPISODES)), artifact
