"""Train any of the three models: the public face of the training loops."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import torch

from cassie_lib.dynamics.curriculum import Curriculum
from cassie_lib.dynamics.loop import pick_device
from cassie_lib.dynamics.mlp import MLPModel
from cassie_lib.dynamics.normalisation import Normalisation
from cassie_lib.dynamics.run import Run, Training
from cassie_lib.dynamics.train_causal import train_causal
from cassie_lib.dynamics.train_window import EpochLoop, EpochSettings, collect_sets, make_identity
from cassie_lib.dynamics.transformer import TransformerModel
from cassie_lib.dynamics.windows import Transitions
from cassie_lib.presets import MLPParameters, TransformerParameters


def train_transformer(
    train: Transitions,
    parameters: TransformerParameters,
    *,
    validation: Transitions,
    test: Transitions | None = None,
    folder: Path | None = None,
    device: str = "auto",
    callback: Callable[[int, TransformerModel], None] | None = None,
) -> Training:
    """Algorithm 1 with the settings of section 5.1.2.

    AdamW, ReduceLROnPlateau on the validation loss, loss of Eq 3.9 in normalised units, one more
    predicted step whenever the validation loss changed by less than ``change_percent`` over
    ``patience`` epochs.  Algorithm 1 returns as soon as t reaches tau; as in the thesis's figures,
    training goes on to the last epoch here.

    Logged per epoch: ``train|validation|test/state_prediction`` (Eq 3.6), ``.../step_i``,
    ``train/penalised`` (Eq 3.9), ``train/gradient_penalty``, ``horizon``, ``increment``,
    ``learning_rate``, ``train/skipped``; ``.../state_prediction_raw`` and ``.../raw_step_i`` are
    in raw units.

    Args:
        train: Training transitions.
        parameters: Architecture and settings.
        validation: Decides on increments and the learning rate.
        test: Only measured.
        folder: For ``checkpoint.pt`` and ``log.csv``; a checkpoint found there is resumed.
        device: ``"auto"`` or a PyTorch device name.
        callback: Called with (step, model) after every optimiser step.

    Raises:
        CheckpointError: If the checkpoint is damaged or belongs to another run.
        TrainingError: If step after step is not finite.
        DataError: If an episode set has no window of H + tau states.
    """
    p = parameters
    sets = collect_sets(train, validation, test, p.horizon)
    torch.manual_seed(p.seed)
    model = TransformerModel(p, Normalisation.from_transitions(train)).to(pick_device(device))
    optimiser = torch.optim.AdamW(
        model.parameters(), lr=p.learning_rate, weight_decay=p.weight_decay
    )
    identity = make_identity(model, sets)
    run = Run(model.train(), optimiser, identity, folder, p.max_minutes, p.checkpoint_seconds)
    scheduler = torch.optim.lr_scheduler.ReduceLROnPlateau(
        optimiser, factor=p.scheduler_factor, patience=p.scheduler_patience
    )
    settings = EpochSettings(
        p.epochs, p.batch_size, p.horizon, p.seed, p.order_weights, p.gradient_penalty,
        p.windows_per_epoch, p.validation_windows,
    )
    curriculum = Curriculum(p.horizon, p.patience, p.change_percent, "percent")
    EpochLoop(run, settings, curriculum, scheduler, sets).train(callback)
    return run.finish()


def train_mlp(
    train: Transitions,
    parameters: MLPParameters,
    *,
    validation: Transitions | None = None,
    test: Transitions | None = None,
    curriculum: bool = False,
    folder: Path | None = None,
    device: str = "auto",
    callback: Callable[[int, MLPModel], None] | None = None,
) -> Training:
    """The baseline of section 5.1.1: Adam, Eq 3.4 in normalised units, equal weights.

    Args:
        train: Training transitions.
        parameters: Architecture and settings.
        validation: Measured every epoch; needed for the curriculum.
        test: Only measured.
        curriculum: False: one predicted step for ``epochs`` (Figure 5.1).  True: up to
            ``horizon`` steps over ``curriculum_epochs``, one more when the slope of the
            validation loss over ``patience`` epochs is under ``slope`` (Figure 5.2).
        folder, device, callback: As in :func:`train_transformer`.

    Raises:
        ParameterError: If the curriculum has no validation set.
        CheckpointError, TrainingError, DataError: As in :func:`train_transformer`.
    """
    p = parameters
    horizon = p.horizon if curriculum else 1
    sets = collect_sets(train, validation, test, horizon)
    torch.manual_seed(p.seed)
    model = MLPModel(p, Normalisation.from_transitions(train)).to(pick_device(device))
    optimiser = torch.optim.Adam(model.parameters(), lr=p.learning_rate)
    identity = make_identity(model, sets, curriculum=curriculum)
    run = Run(model.train(), optimiser, identity, folder, p.max_minutes, p.checkpoint_seconds)
    epochs = p.curriculum_epochs if curriculum else p.epochs
    settings = EpochSettings(epochs, p.batch_size, horizon, p.seed)
    rule = Curriculum(horizon, p.patience, p.slope, "slope")
    EpochLoop(run, settings, rule, None, sets).train(callback)
    return run.finish()


__all__ = ["Training", "train_causal", "train_mlp", "train_transformer"]
