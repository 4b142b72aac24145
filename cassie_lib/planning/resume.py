"""Long episodes of a planner that go on where they were killed.

Planning a control step costs some thirty times what simulating it does.  So only what was planned
is saved: the actions, the log, and what the planner remembers.  A resume replays the actions in the
simulator, which makes the same bits again, and plans from the first step that was not saved.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

from cassie_lib.checkpoints import load_checkpoint, save_checkpoint
from cassie_lib.errors import CheckpointError
from cassie_lib.logs import Progress
from cassie_lib.planning.cem import CEM
from cassie_lib.planning.control import PlannerController

CHECKPOINT = "episodes.pt"
#: Time between two checkpoints, s.
SAVE_EVERY_S = 60.0


class ResumableController(PlannerController):
    """A :class:`~cassie_lib.planning.control.PlannerController` with a checkpoint.

    Args:
        planner: CEM or Gradient-CEM, which tell what they remember.
        expert: As for the planner controller.
        folder: For ``episodes.pt``; made when it is missing.
        identity: What a resume must agree with: protocol, planner, model.
        steps: Control steps of the episodes, to tell how many are left; 0 tells nothing.
    """

    def __init__(self, planner: CEM, expert, folder: Path, identity: str, steps: int = 0) -> None:
        super().__init__(planner, expert)
        self.planner: CEM = planner
        self._steps, self._path, self._identity = steps, folder / CHECKPOINT, identity
        folder.mkdir(parents=True, exist_ok=True)

    def reset(self, count: int, seed: int = 0) -> None:
        """Start ``count`` robots, or take up those that were killed.

        Raises:
            CheckpointError: If the checkpoint is damaged or of other episodes.
        """
        super().reset(count, seed)
        self._start = f"{self._identity} {count} robots from seed {seed}"
        self._saved = load_checkpoint(self._path, self._start)
        self._done: list[np.ndarray] = []
        self._saved_at = time.monotonic()
        planned = len(self._saved["actions"]) if self._saved else 0
        label = f"{type(self.planner).__name__} of {count} robots"
        self._meter = Progress(label, self._steps, planned, SAVE_EVERY_S, not self._steps)

    def act(self, observation) -> np.ndarray:
        """Actions ``(N, 10)`` rad: those that were saved, and planned ones after them.

        Raises:
            CheckpointError: If the replayed robots are not in the states that were saved.
            NonFiniteError: If every candidate of a robot has a non-finite prediction.
        """
        states = torch.as_tensor(np.asarray(observation.states))
        if self._saved is not None:
            actions = self._saved["actions"][len(self._done)].numpy().copy()
            self._done.append(actions)
            if len(self._done) == len(self._saved["actions"]):
                self._take_up(states)
            return actions
        actions = super().act(observation)
        self._done.append(np.array(actions))
        self._meter.update(len(self._done), {"planned for": self._rows[-1].planned.sum()})
        # Until the hand-over the expert acts, and what it remembers is not saved.
        due = time.monotonic() - self._saved_at >= SAVE_EVERY_S
        if due and len(self._done) > self.handover_step:
            self._save(states)
        return actions

    def _save(self, states: torch.Tensor) -> None:
        content = {
            "actions": torch.as_tensor(np.array(self._done)),
            "states": states,
            "controller": self.state_dict(),
            "planner": self.planner.state_dict(),
        }
        save_checkpoint(self._path, content, self._start)
        self._saved_at = time.monotonic()

    def _take_up(self, states: torch.Tensor) -> None:
        """Be as at the checkpoint; ``states`` are those before its last action."""
        saved: dict[str, Any] = self._saved or {}
        if not torch.equal(states, saved["states"]):
            raise CheckpointError(
                f"{self._path} was left by a simulator that rounds in another way: "
                "expected the same states after the same actions; remove it to start over"
            )
        self.load_state_dict(saved["controller"])
        self.planner.load_state_dict(saved["planner"])
        self._saved = None


__all__ = ["ResumableController"]
