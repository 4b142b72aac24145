"""Cross-entropy method over action sequences, batched over episodes: thesis section 5.2.1.

Each of C iterations draws N sequences, scores them on the dynamics model, keeps the K best and
refits mean and covariance; one last round draws N more and executes the best (Algorithm 2, lines
9-12).  Noise over the horizon may be coloured and elites reused, as in iCEM.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from cassie_lib.errors import NonFiniteError, ParameterError, ShapeError, unknown_name
from cassie_lib.planning.candidates import Candidates, Scorer
from cassie_lib.planning.objective import Objective
from cassie_lib.planning.planner import Plan
from cassie_lib.planning.sampling import initial_distribution, refit, sample, shift
from cassie_lib.presets import CEMParameters
from cassie_lib.robot.schema import ACTION_SIZE, PERIOD

MEANS = ("zero", "warm", "expert", "reference", "feedforward")
#: Means that are read from a cycle of actions by phase.
CYCLES = ("expert", "reference", "feedforward")
COVARIANCES = ("diagonal", "full")
FILLS = ("repeat", "zero")


def check_parameters(parameters: CEMParameters) -> None:
    """Refuse settings that contradict themselves.

    Raises:
        ParameterError: K > N, K < 1, C < 1, T < 1, bounds reversed, a negative floor, or a share
            (of elites, or carried over) outside [0, 1].
        UnknownNameError: For another mean or covariance than the documented ones.
    """
    p = parameters
    for name in ("samples", "elites", "iterations", "horizon"):
        if getattr(p, name) < 1:
            raise ParameterError(f"{name} is {getattr(p, name)}: expected at least 1")
    if p.elites > p.samples:
        raise ParameterError(f"elites is {p.elites}: expected at most samples, {p.samples}")
    if not p.lower_rad < p.upper_rad:
        raise ParameterError(
            f"action bounds are [{p.lower_rad}, {p.upper_rad}] rad: expected lower < upper"
        )
    if not p.std_floor_rad >= 0.0:
        raise ParameterError(f"std_floor_rad is {p.std_floor_rad}: expected at least 0")
    for name in ("elite_reuse", "carry"):
        if not 0.0 <= getattr(p, name) <= 1.0:
            raise ParameterError(f"{name} is {getattr(p, name)}: expected a share between 0 and 1")
    if p.mean not in MEANS:
        raise unknown_name("planner mean", p.mean, MEANS)
    if p.warm_fill not in FILLS:
        raise unknown_name("warm fill", p.warm_fill, FILLS)
    if p.covariance not in COVARIANCES:
        raise unknown_name("covariance", p.covariance, COVARIANCES)


class CEM:
    """Cross-entropy planner.

    Args:
        objective: Model and reward; its discount should be ``parameters.discount``.
        parameters: :class:`cassie_lib.presets.CEMParameters`.
        action_cycle: Actions by phase, ``(28, 10)`` rad: entry p is the action taken at phase p.
            The expert's recorded ones for ``mean="expert"``, the reference gait's joint angles for
            ``mean="reference"``, those and what the weight takes for ``mean="feedforward"``; not
            used otherwise.

    Raises:
        ParameterError: If parameters contradict themselves or the action cycle is missing.
        ShapeError: If the action cycle or the variance have another size.
    """

    def __init__(self, objective: Objective, parameters: CEMParameters, action_cycle=None):
        check_parameters(parameters)
        self.objective, self.parameters = objective, parameters
        self._cycle = _action_cycle(action_cycle, parameters.mean)
        self.reset([0])
        shape = (1, parameters.horizon, ACTION_SIZE)
        initial_distribution(torch.zeros(shape), parameters.variance)

    @property
    def horizon(self) -> int:
        """T, control steps of a plan."""
        return self.parameters.horizon

    def reset(self, seeds: Sequence[int]) -> None:
        """Start episodes: one generator per seed, nothing remembered from earlier plans."""
        self._generators = [torch.Generator().manual_seed(int(seed)) for seed in seeds]
        shape = (len(self._generators), self.parameters.horizon, ACTION_SIZE)
        self._last = torch.zeros(shape)
        self._elites: torch.Tensor | None = None

    def forget(self, episodes=None) -> None:
        """Drop the remembered plan of some episodes (default all): their next one starts afresh."""
        which = slice(None) if episodes is None else torch.as_tensor(episodes)
        self._last[which] = 0.0
        if self._elites is not None:
            self._elites[which] = 0.0

    def state_dict(self) -> dict[str, Any]:
        """What the next plans depend on besides their history: random numbers, earlier plans."""
        generators = [generator.get_state() for generator in self._generators]
        return {"generators": generators, "last": self._last, "elites": self._elites}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Return to a :meth:`state_dict` of as many episodes."""
        for generator, state in zip(self._generators, saved["generators"], strict=True):
            generator.set_state(state)
        self._last, self._elites = saved["last"], saved["elites"]

    def plan(self, history, phase, lateral_m, episodes=None) -> Plan:
        """Plan for E episodes at once.

        Args:
            history: :class:`cassie_lib.dynamics.model.History` of E episodes.
            phase: ``(E,)`` integer phases now, 0..27.
            lateral_m: ``(E,)`` y of the pelvis now, metres.
            episodes: Which of the episodes of :meth:`reset` these are, ``(E,)``; default all.

        Raises:
            SchemaError, ShapeError: If the history does not fit the model or the episodes.
            NonFiniteError: If every candidate of an episode has a non-finite prediction.
        """
        phase = torch.as_tensor(np.asarray(phase), dtype=torch.long)
        lateral_m = torch.as_tensor(np.asarray(lateral_m), dtype=torch.float32)
        scorer = Scorer(self.objective, history, phase, lateral_m)
        episodes = self._episodes(episodes, len(phase))
        generators = [self._generators[episode] for episode in episodes]
        p, rounds = self.parameters, []
        base = self._base(phase)
        mean = self._mean(episodes, base)
        distribution = initial_distribution(mean, p.variance, p.std_floor_rad)
        carried = self._carried(mean, self._elites[episodes] if self._elites is not None else None)
        for iteration in range(p.iterations + 1):
            with torch.inference_mode():
                drawn = sample(distribution, p.samples, generators, p.noise_colour)
                candidates = scorer(self._clip(torch.cat([drawn, *carried], dim=1)))
                rounds.append(candidates.value.amax(dim=1))
            if iteration == p.iterations:
                break
            elites = self._improve(scorer, candidates)
            distribution = refit(elites.actions, p.covariance, p.std_floor_rad)
            carried = self._carried(distribution.mean, elites.actions)
        chosen = candidates.top(1)
        if p.keep_best and scorer.best is not None:
            chosen = scorer.best
        self._remember(episodes, chosen.actions[:, 0] - base, elites.actions)
        states = chosen.states[:, :1].clone()
        with torch.inference_mode():
            imagined = self.objective.horizon_return(history, states, phase, lateral_m)
        return Plan(
            chosen.actions[:, 0].clone(),
            imagined[:, 0].clone(),
            scorer.non_finite,
            scorer.rollouts,
            torch.stack(rounds),
            states[:, 0],
        )

    def _improve(self, scorer: Scorer, candidates: Candidates) -> Candidates:
        """The elites of one iteration; plain CEM takes them as they were drawn."""
        return candidates.top(self.parameters.elites)

    def _clip(self, actions: torch.Tensor) -> torch.Tensor:
        return actions.clamp(self.parameters.lower_rad, self.parameters.upper_rad)

    def _episodes(self, episodes, count: int) -> list[int]:
        known = len(self._generators)
        if episodes is None:
            episodes = range(known)
        episodes = [int(episode) for episode in episodes]
        if len(episodes) != count:
            raise ShapeError(f"history of {count} episodes: expected {len(episodes)}, as reset")
        if any(not 0 <= episode < known for episode in episodes):
            raise ShapeError(f"episodes {episodes}: expected indices below {known}, as reset")
        return episodes

    def _base(self, phase: torch.Tensor) -> torch.Tensor:
        """What the mean is without any earlier plan, ``(E, T, 10)``: zero or a cycle of actions."""
        horizon = self.parameters.horizon
        if self._cycle is None:
            return torch.zeros(len(phase), horizon, ACTION_SIZE)
        index = (phase[:, None] + torch.arange(horizon)) % PERIOD
        return self._clip(self._cycle[index])

    def _mean(self, episodes: list[int], base: torch.Tensor) -> torch.Tensor:
        """Initial mean ``(E, T, 10)``: the base and what is kept of the last plan, moved on."""
        kept = {"zero": 0.0, "warm": 1.0}.get(self.parameters.mean, self.parameters.carry)
        if not kept:
            return base
        moved = shift(self._last[episodes], fill=self.parameters.warm_fill)
        return self._clip(base + kept * moved)

    def _carried(self, mean: torch.Tensor, elites: torch.Tensor | None) -> list[torch.Tensor]:
        """Sequences that join the samples of the next round: the mean, and reused elites."""
        count = round(self.parameters.elite_reuse * self.parameters.elites)
        carried = [mean[:, None]] if self.parameters.include_mean else []
        if count and elites is not None:
            carried.append(elites[:, :count])
        return carried

    def _remember(self, episodes: list[int], departure: torch.Tensor, elites: torch.Tensor) -> None:
        """Keep the plan's departure from its base, and the elites one step on, for the next."""
        self._last[episodes] = departure
        if self.parameters.elite_reuse:
            if self._elites is None:
                self._elites = torch.zeros(len(self._generators), *elites.shape[1:])
            self._elites[episodes] = shift(elites, fill=self.parameters.warm_fill).clone()


def _action_cycle(cycle, mean: str) -> torch.Tensor | None:
    """Check the cycle where one is needed."""
    if mean not in CYCLES:
        return None
    if cycle is None:
        raise ParameterError(
            f'mean is "{mean}" and there is no action_cycle: expected (28, 10) rad'
        )
    cycle = torch.as_tensor(np.asarray(cycle), dtype=torch.float32)
    if tuple(cycle.shape) != (PERIOD, ACTION_SIZE):
        raise ShapeError(
            f"action_cycle is {tuple(cycle.shape)}: expected ({PERIOD}, {ACTION_SIZE})"
        )
    if not bool(torch.isfinite(cycle).all()):
        raise NonFiniteError("action_cycle has non-finite values: expected radians")
    return cycle
