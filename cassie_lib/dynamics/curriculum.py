"""When to predict one more step: the condition Psi of Algorithm 1."""

from __future__ import annotations

from typing import Any

from cassie_lib.errors import ParameterError

RULES = ("percent", "slope")


class Curriculum:
    """Number of predicted steps t, raised from 1 to tau as the validation loss settles.

    With p the patience and L_e the validation loss of epoch e, Psi holds when

    * ``"percent"`` (section 5.1.2): ``100 |L_e - L_{e-p}| / L_{e-p} < threshold``;
    * ``"slope"`` (section 5.1.1): ``|L_e - L_{e-p}| / p < threshold``.

    Losses before the last increment do not count: they were taken over fewer steps.

    Attributes:
        steps: t, the number of steps predicted now.
    """

    def __init__(self, horizon: int, patience: int, threshold: float, rule: str = "percent"):
        """Start at one step.

        Args:
            horizon: tau.
            patience: p, epochs.
            threshold: Percent, or loss per epoch.
            rule: ``"percent"`` or ``"slope"``.

        Raises:
            ParameterError: If a value is out of range.
        """
        if horizon < 1 or patience < 1 or threshold < 0:
            raise ParameterError(
                f"horizon, patience, threshold are {horizon}, {patience}, {threshold}: "
                "expected at least 1, 1 and 0"
            )
        if rule not in RULES:
            raise ParameterError(f"curriculum rule is {rule!r}: expected one of {RULES}")
        self.horizon, self.patience, self.threshold, self.rule = horizon, patience, threshold, rule
        self.steps = 1
        self.losses: list[float] = []

    def settled(self) -> bool:
        """Psi, on the losses since the last increment."""
        if len(self.losses) <= self.patience:
            return False
        now, before = self.losses[-1], self.losses[-1 - self.patience]
        if self.rule == "slope":
            return abs(now - before) / self.patience < self.threshold
        return 100.0 * abs(now - before) < self.threshold * abs(before)

    def update(self, validation_loss: float) -> bool:
        """Tell the validation loss of one epoch; True if one more step is predicted from now on."""
        self.losses.append(float(validation_loss))
        if self.steps >= self.horizon or not self.settled():
            return False
        self.steps += 1
        self.losses.clear()
        return True

    def state(self) -> dict[str, Any]:
        """Plain state for a checkpoint."""
        return {"steps": self.steps, "losses": list(self.losses)}

    def restore(self, state: dict[str, Any]) -> None:
        """Take up a state of :meth:`state`."""
        self.steps, self.losses = state["steps"], list(state["losses"])


__all__ = ["Curriculum"]
