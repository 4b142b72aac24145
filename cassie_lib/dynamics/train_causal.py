"""Training of the causal model: every position of a window first, then its own predictions.

The first part is teacher forced: one pass over a window of H + tau pairs gives as many one-step
predictions, and all of them are learned from.  The second part rolls the model out over tau steps
through the cached path, as the planner will, and back-propagates through the whole rollout.

What is returned is the mean of the weights over the last steps (Polyak averaging): at step ten a
single set of weights carries the luck of its last batches as a bias that adds up over the rollout.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel

from cassie_lib.dynamics.causal import PHYSICAL_SIZE, CausalModel
from cassie_lib.dynamics.evaluation import open_loop, split_window
from cassie_lib.dynamics.loop import pick_device
from cassie_lib.dynamics.losses import component_weights
from cassie_lib.dynamics.normalisation import Normalisation
from cassie_lib.dynamics.run import Run, Training
from cassie_lib.dynamics.sampler import Sampler
from cassie_lib.dynamics.windows import Transitions, Window, concatenate
from cassie_lib.errors import ParameterError
from cassie_lib.presets import CausalParameters

LOG_STEPS = 50


def learning_rate(progress: float, parameters: CausalParameters) -> float:
    """Linear warm-up, then half a cosine down to ``final_learning_rate``; progress 0..1."""
    warmup = parameters.warmup_share
    if progress < warmup:
        return parameters.learning_rate * (progress + 1e-3) / (warmup + 1e-3)
    share = min(1.0, (progress - warmup) / max(1e-9, 1.0 - warmup))
    low, high = parameters.final_learning_rate, parameters.learning_rate
    return low + (high - low) * 0.5 * (1.0 + math.cos(math.pi * share))


def error_unit(model: CausalModel) -> Tensor:
    """Unit ``(46,)`` in which each component's error is counted: the spread of its state.

    With it the loss is the relative error of :mod:`~cassie_lib.dynamics.evaluation`, taken with
    the training set's variance.
    """
    return model.normalisation.state_std[:PHYSICAL_SIZE]


def teacher_forced_loss(model: CausalModel, window: Window, weights: Tensor) -> Tensor:
    """Mean squared weighted one-step error over all positions of a window."""
    outputs = model(window.states[:, :-1], window.actions[:, :-1])
    target = window.states.diff(dim=1)[..., :PHYSICAL_SIZE]
    error = model.normalisation.to_differences(outputs) - target
    return (error * (weights / error_unit(model))).square().mean()


def rollout_loss(model: CausalModel, window: Window, weights: Tensor) -> Tensor:
    """Mean squared weighted error of the states over tau predicted steps."""
    history, actions, truth = split_window(window, model.context)
    predicted = model.rollout(model.encode(history), actions)[:, 0]
    error = (predicted - truth)[..., :PHYSICAL_SIZE]
    return (error * (weights / error_unit(model))).square().mean()


class _Averaged(nn.Module):
    """A model in training and the mean of its weights so far, saved and restored together."""

    def __init__(self, model: CausalModel) -> None:
        super().__init__()
        self.model = model
        self.mean = AveragedModel(model)

    @property
    def best(self) -> CausalModel:
        """The mean, or the model itself as long as nothing has been averaged."""
        return self.mean.module if int(self.mean.n_averaged) else self.model


class _CausalLoop:
    """Runs a training to its end; ``part`` 0 is teacher forced, 1 is rollout."""

    def __init__(self, run: Run, sampler: Sampler, sets: dict[str, Transitions]) -> None:
        self.run, self.sampler, self.sets = run, sampler, sets
        self.pair: _Averaged = run.model
        self.model = self.pair.model
        self.parameters: CausalParameters = self.model.parameters_
        self.state = run.counters or {"part": 0, "total": 0.0, "count": 0}
        run.counters = self.state
        device = next(self.model.parameters()).device
        weights = component_weights(self.parameters.order_weights, PHYSICAL_SIZE)
        self.device, self.weights = device, weights.to(device)

    @property
    def progress(self) -> float:
        steps = self.parameters.steps
        return max(self.run.step / steps if steps else 1.0, self.run.budget.share)

    def train(self, callback: Callable[[int, CausalModel], None] | None) -> None:
        while (progress := self.progress) < 1.0:
            self.advance(progress)
            if self.run.step % self.parameters.validation_steps == 0:
                self.validate()
            self.run.save_when_due()
            if callback is not None:
                callback(self.run.step, self.model)
        self.validate()

    def advance(self, progress: float) -> None:
        run, state = self.run, self.state
        part = int(progress >= 1.0 - self.parameters.rollout_share)
        if part != state["part"]:
            run.guard.reset()
            state.update(part=part, total=0.0, count=0)
        rate = learning_rate(progress, self.parameters)
        for group in run.optimiser.param_groups:
            group["lr"] = rate
        window = Window(*(value.to(self.device) for value in self.sampler.batch(run.step)))
        loss = (teacher_forced_loss, rollout_loss)[part](self.model, window, self.weights)
        if run.descend(loss):
            if progress >= 1.0 - self.parameters.average_share:
                self.pair.mean.update_parameters(self.model)
            state["total"] += loss.item()
            state["count"] += 1
        if run.step % LOG_STEPS == 0 and state["count"]:
            name = ("train__one_step_loss", "train__rollout_loss")[part]
            run.note(**{name: state["total"] / state["count"], "learning_rate": rate})
            state.update(total=0.0, count=0)

    def validate(self) -> None:
        horizon, windows = self.parameters.horizon, self.parameters.validation_windows
        model = self.pair.best.eval()
        metrics: dict[str, float] = {}
        for name, part in self.sets.items():
            result = open_loop(model, part, horizon, windows)
            metrics[f"{name}__relative_step_1"] = result.relative[0]
            metrics[f"{name}__relative_step_{horizon}"] = result.relative[-1]
            metrics[f"{name}__state_prediction_raw"] = result.thesis_loss()
            losses = result.thesis_loss_by_step()
            metrics |= {f"{name}__raw_step_{i + 1}": loss for i, loss in enumerate(losses)}
        self.model.train()
        self.run.note(0, **metrics)


def train_causal(
    train: Transitions | Sequence[Transitions],
    parameters: CausalParameters,
    *,
    validation: Transitions | None = None,
    measured: Mapping[str, Transitions] | None = None,
    shares: Sequence[float] | None = None,
    initial: CausalModel | None = None,
    folder: Path | None = None,
    device: str = "auto",
    callback: Callable[[int, CausalModel], None] | None = None,
) -> Training:
    """Train a causal model, or go on with one.

    The learning rate and the change from one-step to rollout training follow the larger of
    ``step / steps`` and ``minutes / max_minutes``: with ``max_minutes = 0`` the result is the
    same to the bit on one machine, killed and resumed or not.  The weights returned, and those
    validated from then on, are the mean over the last ``average_share`` of the training.

    Args:
        train: One recording, or several that are sampled by ``shares``.
        parameters: Sizes and hyper-parameters.
        validation: Recording to validate on; None for none.
        measured: More recordings on which the errors are logged, by name.
        shares: Part of the batches that each recording gets.
        initial: Warm start: weights and normalisation of another model of the same sizes.
        folder: Where ``checkpoint.pt`` and ``log.csv`` go; a checkpoint found there is resumed.
        device: ``"auto"`` or a PyTorch device name.
        callback: Called with (step, model) after every step.

    Raises:
        ParameterError: If ``initial`` has other sizes or the shares do not fit.
        CheckpointError: If the checkpoint is damaged or belongs to another run.
        TrainingError: If step after step is not finite.
    """
    sources = [train] if isinstance(train, Transitions) else list(train)
    torch.manual_seed(parameters.seed)
    length = parameters.context + parameters.horizon
    sampler = Sampler(
        sources, shares, length, parameters.batch_size, parameters.seed, parameters.mirror
    )
    model = CausalModel(parameters, Normalisation.from_transitions(concatenate(sources)))
    if initial is not None:
        try:
            model.load_state_dict(initial.state_dict())
        except RuntimeError as error:
            raise ParameterError("the initial model has other sizes than parameters") from error
    model = model.to(pick_device(device)).train()
    optimiser = torch.optim.AdamW(
        model.parameters(), lr=parameters.learning_rate, weight_decay=parameters.weight_decay
    )
    identity = {
        "kind": "causal",
        "parameters": dataclasses.asdict(parameters),
        "normalisation": model.normalisation.digest(),
        "windows": [len(starts) for starts in sampler.starts],
    }
    run = Run(
        _Averaged(model), optimiser, identity, folder, parameters.max_minutes,
        parameters.checkpoint_seconds, parameters.clip_norm,
    )
    sets = {**({"validation": validation} if validation is not None else {}), **(measured or {})}
    _CausalLoop(run, sampler, sets).train(callback)
    trained = run.finish()
    return trained._replace(model=trained.model.best)


__all__ = ["train_causal"]
