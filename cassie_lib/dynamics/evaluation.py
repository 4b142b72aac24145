"""Open-loop accuracy: predict T steps from a true history and recorded actions, compare.

The headline figure at step k is the *relative error*: for each of the 46 physical components the
mean squared error of the predicted state, divided by the variance of that component over the
whole data set, averaged over the components.  1 is as bad as always predicting the mean.  Clock
and commanded speed are exact by construction and do not count.  The same for *no change*, which
predicts the present state for ever, shows what a model has to beat.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from cassie_lib.dynamics.losses import component_weights
from cassie_lib.dynamics.model import DynamicsModel, History
from cassie_lib.dynamics.windows import Transitions, Window
from cassie_lib.errors import ParameterError
from cassie_lib.robot import schema

#: Components with less variance than this over a data set are constant and are left out.
CONSTANT = 1e-12
GROUPS = {"position": 0, "velocity": 1, "acceleration": 2}


@dataclass(frozen=True)
class OpenLoop:
    """Mean squared errors over windows, per predicted step and component, in physical units.

    Attributes:
        model: ``(T, 46)`` of predicted states.
        no_change: ``(T, 46)`` of predicting the present state for ever.
        difference: ``(T, 46)`` of predicted one-step differences, as Eq 3.6 compares them: the
            prediction starts from the predicted, not the true, previous state.
        no_difference: ``(T, 46)`` of predicting differences of zero.
        variance: ``(46,)`` of each component over the data set.
        difference_variance: ``(46,)`` of the one-step differences over the windows.
        windows: How many windows were averaged.
    """

    model: np.ndarray
    no_change: np.ndarray
    difference: np.ndarray
    no_difference: np.ndarray
    variance: np.ndarray
    difference_variance: np.ndarray
    windows: int

    def _relative(self, errors: np.ndarray) -> np.ndarray:
        varying = self.variance > CONSTANT
        return (errors[:, varying] / self.variance[varying]).mean(axis=1)

    @property
    def relative(self) -> np.ndarray:
        """Relative error of the model at each step, ``(T,)``."""
        return self._relative(self.model)

    @property
    def relative_no_change(self) -> np.ndarray:
        """Relative error of no change at each step, ``(T,)``."""
        return self._relative(self.no_change)

    def thesis_loss(
        self,
        order_weights: tuple[float, float, float] = (1.0, 2.0, 5.0),
        units: str = "raw",
        reduction: str = "mean",
    ) -> float:
        """Eq 3.6 over all T steps; the thesis reports 0.0018, 0.0016 and 0.0013 for its sets.

        Arguments and errors as of :meth:`thesis_loss_by_step`, whose mean it is.
        """
        return float(self.thesis_loss_by_step(order_weights, units, reduction).mean())

    def thesis_loss_by_step(
        self,
        order_weights: tuple[float, float, float] = (1.0, 2.0, 5.0),
        units: str = "raw",
        reduction: str = "mean",
    ) -> np.ndarray:
        """Summands of Eq 3.6: the weighted squared error of each predicted step, ``(T,)``.

        Args:
            order_weights: w by derivative order.
            units: ``"raw"`` or ``"normalised"`` (divided by the spread of differences).
            reduction: ``"sum"`` over components as Eq 3.6 writes it, or ``"mean"`` over the 49
                (the three known ones have no error).

        Raises:
            ParameterError: If ``units`` or ``reduction`` is unknown.
        """
        if units not in ("raw", "normalised") or reduction not in ("sum", "mean"):
            raise ParameterError(
                f"units, reduction are {units!r}, {reduction!r}: expected raw or normalised, "
                "sum or mean"
            )
        weights = component_weights(order_weights, self.variance.size).numpy().astype(float)
        errors = self.difference
        if units == "normalised":
            errors = errors / np.maximum(self.difference_variance, CONSTANT)
        total = (errors * weights**2).sum(axis=1)
        return total / schema.STATE_SIZE if reduction == "mean" else total

    def summary(self) -> dict[str, float]:
        """Headline numbers by name."""
        last = len(self.model)
        return {
            "relative_step_1": float(self.relative[0]),
            f"relative_step_{last}": float(self.relative[-1]),
            "no_change_step_1": float(self.relative_no_change[0]),
            f"no_change_step_{last}": float(self.relative_no_change[-1]),
            "thesis_loss_raw_mean": self.thesis_loss(),
            "thesis_loss_raw_sum": self.thesis_loss(reduction="sum"),
            "thesis_loss_normalised_mean": self.thesis_loss(units="normalised"),
            "windows": float(self.windows),
        }


def split_window(window: Window, context: int) -> tuple[History, torch.Tensor, torch.Tensor]:
    """History, future actions ``(B, 1, T, 10)`` and true states ``(B, T, 49)`` of windows.

    Args:
        window: Windows of ``context + T`` states.
        context: H.
    """
    history = History(
        window.states[:, :context],
        window.actions[:, : context - 1],
        None,
        window.phase[:, context - 1],
    )
    return history, window.actions[:, None, context - 1 : -1], window.states[:, context:]


@torch.no_grad()
def open_loop(
    model: DynamicsModel,
    transitions: Transitions,
    horizon: int = 10,
    windows: int = 2000,
    batch: int = 250,
    context: int = 0,
) -> OpenLoop:
    """Measure the open-loop errors of a model on recorded transitions.

    Args:
        model: Any dynamics model on the CPU, or on the device of its own parameters.
        transitions: Recorded episodes.
        horizon: T, control steps.
        windows: At most so many windows, at least 1, evenly spread over the data.
        batch: Windows per forward pass.
        context: At least so many states of history, so that models of different H can be
            compared on the same windows; 0 is the model's own H.

    Raises:
        ParameterError: If there is less than one window, step or window per pass.
        DataError: If no episode has ``context + horizon`` states.
    """
    for name, value in {"horizon": horizon, "windows": windows, "batch": batch}.items():
        if value < 1:
            raise ParameterError(f"{name} = {value}: expected at least 1")
    length = max(context, model.context) + horizon
    starts = transitions.window_starts(length)
    chosen = starts[np.unique(np.linspace(0, len(starts) - 1, windows).astype(int))]
    parameter = next(iter(getattr(model, "parameters", lambda: iter(()))()), torch.zeros(()))
    physical = slice(0, schema.PHYSICAL.stop)
    sums = np.zeros((4, horizon, schema.PHYSICAL.stop))
    moments = np.zeros((2, schema.PHYSICAL.stop))
    for first in range(0, len(chosen), batch):
        window = transitions.gather(chosen[first : first + batch], length)
        window = Window(*(part.to(parameter.device) for part in window))
        history, actions, truth = split_window(window, length - horizon)
        predicted = model.predict(history, actions)[:, 0]
        now = history.states[:, -1:]
        true_step = torch.cat([now, truth], 1).double().diff(dim=1)
        made_step = torch.cat([now, predicted], 1).double().diff(dim=1)
        errors = (predicted - truth, now - truth, made_step - true_step, true_step)
        for total, error in zip(sums, errors, strict=True):
            total += error[..., physical].double().square().sum(0).cpu().numpy()
        flat = true_step[..., physical].flatten(0, 1)
        moments += np.stack([flat.sum(0).cpu().numpy(), flat.square().sum(0).cpu().numpy()])
    sums /= len(chosen)
    mean, square = moments / (len(chosen) * horizon)
    variance = np.asarray(transitions.states[:, physical], dtype=np.float64).var(axis=0)
    model_error, no_change, difference, no_difference = sums
    return OpenLoop(
        model_error, no_change, difference, no_difference, variance, square - mean**2, len(chosen)
    )


__all__ = ["OpenLoop", "open_loop", "split_window"]
