"""Dynamics models and their training."""

from __future__ import annotations

from dataclasses import dataclass

from cassie_lib.parameters.ranges import require


@dataclass(frozen=True)
class MLPParameters:
    """Fully connected baseline (section 5.1.1, Figures 5.1 and 5.2)."""

    context: int = 100  # H, past state-action pairs
    hidden_layers: int = 3
    hidden_size: int = 5000
    learning_rate: float = 1e-4
    batch_size: int = 128
    epochs: int = 25
    curriculum_epochs: int = 20
    horizon: int = 6  # tau, predicted control steps
    patience: int = 4  # epochs
    slope: float = 0.05
    checkpoint_seconds: float = 60.0
    max_minutes: float = 0.0  # 0: no limit, and the same bits every time
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse values that no training can begin with."""
        counts = ("context", "hidden_layers", "hidden_size", "batch_size", "epochs", "horizon")
        require(self, *counts, "curriculum_epochs", "patience", least=1)
        require(self, "learning_rate", "checkpoint_seconds", "max_minutes", "seed", least=0)


@dataclass(frozen=True)
class TransformerParameters:
    """Encoder-decoder of section 5.1.2; the defaults have 12,919,393 parameters."""

    context: int = 30  # H
    representation_size: int = 1000
    representation_layers: int = 2
    embedding_size: int = 64
    model_size: int = 256
    heads: int = 8
    encoder_layers: int = 4
    decoder_layers: int = 4
    feedforward_size: int = 2048
    dropout: float = 0.1
    horizon: int = 10  # tau
    epochs: int = 1000
    windows_per_epoch: int = 0  # 0: all of them
    batch_size: int = 128
    learning_rate: float = 1e-4
    weight_decay: float = 1e-2
    gradient_penalty: float = 1e-2  # lambda of Eq 3.9
    order_weights: tuple[float, float, float] = (1.0, 2.0, 5.0)  # w by derivative order
    scheduler_patience: int = 75  # epochs
    scheduler_factor: float = 0.9
    patience: int = 75  # p, epochs
    change_percent: float = 5.0  # psi
    validation_windows: int = 0  # windows per epoch of validation and test; 0: all of them
    checkpoint_seconds: float = 60.0
    max_minutes: float = 0.0  # 0: no limit, and the same bits every time
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse values that no training can begin with."""
        require(
            self, "context", "representation_size", "representation_layers", "embedding_size",
            "model_size", "heads", "encoder_layers", "decoder_layers", "feedforward_size",
            "horizon", "epochs", "batch_size", "scheduler_patience", "patience", least=1,
        )  # fmt: skip
        require(
            self, "windows_per_epoch", "learning_rate", "weight_decay", "gradient_penalty",
            "validation_windows", "checkpoint_seconds", "max_minutes", "seed", least=0,
        )  # fmt: skip
        require(self, "dropout", least=0, most=0.99)


@dataclass(frozen=True)
class GridParameters:
    """Hyper-parameter grid of Appendix A.1: its values, and the budget of one point.

    Every point trains the preset's transformer with the same number of passes over windows, so
    that a point does not depend on how busy the machine is.
    """

    batch_size: tuple[int, ...] = (64, 128, 256)
    context: tuple[int, ...] = (30, 40, 50)
    learning_rate: tuple[float, ...] = (1e-3, 1e-4, 1e-5)
    dropout: tuple[float, ...] = (0.1, 0.2, 0.3)
    weight_decay: tuple[float, ...] = (1e-3, 1e-2, 1e-1)
    epochs: int = 1000
    windows_per_epoch: int = 0  # 0: all of them
    horizon: int = 10  # tau of the training
    gradient_penalty: float = 1e-2
    evaluation_windows: int = 2000  # of the validation set
    base_seeds: int = 3  # trainings of the choice itself: their spread is noise


@dataclass(frozen=True)
class CausalParameters:
    """Decoder-only model with a key-value cache: this project's extension."""

    context: int = 30  # H
    clock_input: bool = False  # whether the clock and the commanded speed are inputs
    model_size: int = 128
    heads: int = 4
    layers: int = 3
    feedforward_size: int = 512
    dropout: float = 0.0
    horizon: int = 10  # tau
    steps: int = 20_000  # optimiser steps
    rollout_share: float = 0.4  # last part of the training, on tau-step predictions
    average_share: float = 0.05  # last part, over which the weights are averaged
    batch_size: int = 128
    learning_rate: float = 1e-3
    warmup_share: float = 0.02
    final_learning_rate: float = 1e-5
    weight_decay: float = 1e-2
    clip_norm: float = 1.0
    mirror: bool = True  # half of every batch with left and right exchanged
    order_weights: tuple[float, float, float] = (1.0, 1.0, 1.0)
    validation_steps: int = 500  # optimiser steps between two validations
    validation_windows: int = 500
    checkpoint_seconds: float = 60.0
    max_minutes: float = 0.0  # 0: no limit, and the same bits every time
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse values that no training can begin with, or that would never end."""
        require(
            self, "model_size", "heads", "layers", "feedforward_size", "horizon",
            "batch_size", "validation_steps", "validation_windows", least=1,
        )  # fmt: skip
        require(self, "context", least=2)  # the past before the present state
        require(
            self, "steps", "learning_rate", "final_learning_rate", "weight_decay", "clip_norm",
            "checkpoint_seconds", "max_minutes", "seed", least=0,
        )  # fmt: skip
        require(self, "dropout", least=0, most=0.99)
        require(self, "rollout_share", "average_share", "warmup_share", least=0, most=1)
