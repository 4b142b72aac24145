"""Algorithm 1 for the thesis's two models: epochs over windows, one more step when it settles."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from cassie_lib.dynamics.curriculum import Curriculum
from cassie_lib.dynamics.losses import component_weights
from cassie_lib.dynamics.multi_step import multi_step
from cassie_lib.dynamics.run import Run, Training
from cassie_lib.dynamics.window_model import WindowModel
from cassie_lib.dynamics.windows import Transitions, Window
from cassie_lib.errors import ParameterError
from cassie_lib.robot import schema


@dataclass(frozen=True)
class EpochSettings:
    """What the loop needs to know; made from a preset's section."""

    epochs: int
    batch_size: int
    horizon: int
    seed: int
    order_weights: tuple[float, float, float] = (1.0, 1.0, 1.0)
    gradient_penalty: float = 0.0
    windows_per_epoch: int = 0
    validation_windows: int = 0


class EpochLoop:
    """Epochs of :func:`~cassie_lib.dynamics.multi_step.multi_step`, resumable at any batch."""

    def __init__(
        self,
        run: Run,
        settings: EpochSettings,
        curriculum: Curriculum,
        scheduler: torch.optim.lr_scheduler.ReduceLROnPlateau | None,
        sets: dict[str, Transitions],
    ) -> None:
        """Take up the run where it stands.

        Args:
            run: The run; its model is the one to train.
            settings: Sizes.
            curriculum: Gives the number of predicted steps.
            scheduler: Told the validation loss of every epoch; may be None.
            sets: ``"train"``, and optionally ``"validation"`` and ``"test"``.
        """
        self.run, self.settings, self.curriculum = run, settings, curriculum
        self.scheduler, self.sets = scheduler, sets
        self.model: WindowModel = run.model
        self.length = self.model.context + settings.horizon
        self.starts = {name: part.window_starts(self.length) for name, part in sets.items()}
        self.device = next(self.model.parameters()).device
        weights = component_weights(settings.order_weights, schema.STATE_SIZE)
        self.weights = weights.to(self.device)
        self.epoch, self.batch = 0, 0
        self.sums: list[float] = []
        if run.counters:
            self._restore(run.counters)

    def _restore(self, saved: dict) -> None:
        self.epoch, self.batch, self.sums = saved["epoch"], saved["batch"], saved["sums"]
        self.curriculum.restore(saved["curriculum"])
        if self.scheduler is not None:
            self.scheduler.load_state_dict(saved["scheduler"])

    def _remember(self) -> None:
        self.run.counters = {
            "epoch": self.epoch,
            "batch": self.batch,
            "sums": self.sums,
            "curriculum": self.curriculum.state(),
            "scheduler": self.scheduler.state_dict() if self.scheduler else None,
        }

    def train(self, callback: Callable[[int, WindowModel], None] | None) -> None:
        """Run all epochs, or until the time is spent."""
        while self.epoch < self.settings.epochs and self.run.budget.share < 1.0:
            order = np.random.default_rng([self.settings.seed, self.epoch]).permutation(
                self.starts["train"]
            )
            limit = self.settings.windows_per_epoch or len(order)
            size = self.settings.batch_size
            batches = [order[i : i + size] for i in range(0, min(limit, len(order)), size)]
            while self.batch < len(batches) and self.run.budget.share < 1.0:
                self._descend(batches[self.batch])
                self.batch += 1
                self._remember()
                self.run.save_when_due()
                if callback is not None:
                    callback(self.run.step, self.model)
            self._end_epoch()
            self._remember()

    def _window(self, name: str, starts: np.ndarray) -> Window:
        window = self.sets[name].gather(starts, self.length)
        return Window(*(part.to(self.device) for part in window))

    def _descend(self, starts: np.ndarray) -> None:
        steps, weight = self.curriculum.steps, self.settings.gradient_penalty
        window = self._window("train", starts)
        losses = multi_step(self.model, window, steps, self.weights, weight > 0)
        loss = losses.steps.mean() + weight * losses.penalty
        if not self.run.descend(loss, self.epoch):
            return
        each = [*losses.steps.tolist(), *losses.raw.tolist()]
        seen = [1.0, loss.item(), losses.penalty.item(), *each]
        self.sums = [a + b for a, b in zip(self.sums or [0.0] * len(seen), seen, strict=True)]

    @torch.no_grad()
    def measure(self, name: str) -> np.ndarray:
        """Eq 3.6 per predicted step on a set, normalised and in raw units: ``(2 t,)``."""
        starts = self.starts[name]
        count = self.settings.validation_windows or len(starts)
        starts = starts[np.unique(np.linspace(0, len(starts) - 1, count).astype(int))]
        self.model.eval()
        sums = np.zeros(2 * self.curriculum.steps)
        for part in np.array_split(starts, max(1, len(starts) // 256)):
            losses = multi_step(
                self.model, self._window(name, part), self.curriculum.steps, self.weights
            )
            sums += torch.cat([losses.steps, losses.raw]).double().cpu().numpy() * len(part)
        self.model.train()
        return sums / len(starts)

    def _end_epoch(self) -> None:
        run, epoch, steps = self.run, self.epoch, self.curriculum.steps
        metrics: dict[str, float] = {"horizon": steps}
        metrics["learning_rate"] = run.optimiser.param_groups[0]["lr"]
        if self.sums:
            count, total, penalty, *each = self.sums
            metrics["train__penalised"] = total / count
            metrics["train__gradient_penalty"] = penalty / count
            metrics |= _named("train", np.array(each) / count)
        for name in [name for name in self.sets if name != "train"]:
            metrics |= _named(name, self.measure(name))
        run.note(epoch, **metrics)
        self.epoch, self.batch, self.sums = epoch + 1, 0, []
        watched = metrics.get("validation__state_prediction")
        if watched is None:
            return
        if self.scheduler is not None:
            self.scheduler.step(watched)
        if self.curriculum.update(watched):
            run.note(epoch, increment=self.curriculum.steps)
            run.guard.reset()
            if self.scheduler is not None:
                # The loss is another one from here on: its best value so far does not bind.
                self.scheduler.best = float("inf")
                self.scheduler.num_bad_epochs = 0


def _named(name: str, losses: np.ndarray) -> dict[str, float]:
    """Metrics of a set from its losses per step, normalised ones first, raw ones after."""
    steps, raw = np.split(losses, 2)
    means = {"state_prediction": steps.mean(), "state_prediction_raw": raw.mean()}
    return {
        **{f"{name}__{key}": value for key, value in means.items()},
        **{f"{name}__step_{i + 1}": loss for i, loss in enumerate(steps)},
        **{f"{name}__raw_step_{i + 1}": loss for i, loss in enumerate(raw)},
    }


def make_identity(model: WindowModel, sets: dict[str, Transitions], **extra) -> dict:
    """What a resumed run must agree with."""
    return {
        "kind": model.kind,
        "parameters": dataclasses.asdict(model.parameters_),
        "normalisation": model.normalisation.digest(),
        "transitions": {name: len(part) for name, part in sets.items()},
        **extra,
    }


def collect_sets(
    train: Transitions, validation: Transitions | None, test: Transitions | None, horizon: int
) -> dict[str, Transitions]:
    """Name the sets that are given.

    Raises:
        ParameterError: If there are steps to add but no validation set to decide by.
    """
    if validation is None and horizon > 1:
        raise ParameterError("a curriculum needs a validation set: expected validation")
    sets = {"train": train, "validation": validation, "test": test}
    return {name: part for name, part in sets.items() if part is not None}


__all__ = ["EpochLoop", "EpochSettings", "Training", "collect_sets", "make_identity"]
