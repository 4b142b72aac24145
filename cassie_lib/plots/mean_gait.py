"""A model that knows nothing but the mean gait: what learning the dynamics has to beat."""

from __future__ import annotations

import torch
from torch import Tensor

from cassie_lib.dynamics.model import History, phase_of
from cassie_lib.dynamics.windows import Transitions
from cassie_lib.robot.schema import PERIOD


class MeanGait:
    """Predicts the mean state of the training data at the coming phases, whatever the actions.

    Data of one periodic gait are predicted well by it, though it holds no dynamics at all.

    Attributes:
        context: One state of history is enough.
    """

    context = 1

    def __init__(self, transitions: Transitions) -> None:
        """Average the states of each phase; a phase that does not occur gets the mean of all."""
        phase = torch.as_tensor(transitions.phase.astype("int64"))
        states = torch.as_tensor(transitions.states.astype("float64"))
        count = torch.bincount(phase, minlength=PERIOD)
        sums = torch.zeros(PERIOD, states.shape[1], dtype=torch.float64)
        sums.index_add_(0, phase, states)
        means = torch.where(count[:, None] > 0, sums / count[:, None], states.mean(dim=0))
        self.table = means.float()

    def prepare(self, history: History) -> History:
        """Nothing to encode."""
        return history

    def predict(self, history: History, actions: Tensor) -> Tensor:
        """See :class:`~cassie_lib.dynamics.model.DynamicsModel`."""
        steps = torch.arange(1, actions.shape[2] + 1)
        phase = (phase_of(history)[:, None] + steps) % PERIOD
        states = self.table[phase][:, None]
        return states.expand(*actions.shape[:3], states.shape[-1]).clone()
