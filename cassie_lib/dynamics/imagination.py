"""What a model imagines, as a motion of the robot: open-loop prediction beside the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from cassie_lib.dynamics.evaluation import split_window
from cassie_lib.dynamics.model import DynamicsModel
from cassie_lib.dynamics.windows import Transitions
from cassie_lib.errors import ParameterError
from cassie_lib.robot import schema
from cassie_lib.robot.state import configuration_from_state


@dataclass(frozen=True)
class Imagined:
    """A true motion and the one that a model predicts from the same actions.

    Attributes:
        states: ``(T + 1, 49)`` true; row 0 is the present.
        predicted: ``(T + 1, 49)``; row 0 is the present, nothing after it is seen.
        qpos: ``(T + 1, 35)`` of the true motion, pelvis x and y from its velocity, from (0, 0).
        ghost: ``(T + 1, 35)`` of the predicted motion likewise.
    """

    states: np.ndarray
    predicted: np.ndarray
    qpos: np.ndarray
    ghost: np.ndarray

    @property
    def pelvis_distance_m(self) -> np.ndarray:
        """Distance of the two pelvises at each step, ``(T + 1,)`` m."""
        return np.linalg.norm(self.qpos[:, :3] - self.ghost[:, :3], axis=1)

    @property
    def joint_error_rad(self) -> np.ndarray:
        """Root mean square error of the ten motor angles at each step, ``(T + 1,)`` rad."""
        error = (self.states - self.predicted)[:, schema.MOTOR_POSITION]
        return np.sqrt(np.square(error).mean(axis=1))


def pick_start(transitions: Transitions, past: int, steps: int) -> tuple[int, int]:
    """A row in the middle of a recording at which to begin, and how many steps may follow.

    Args:
        transitions: Recorded episodes.
        past: States of history, the present among them.
        steps: Steps wanted; fewer if the longest episode has no room for them.

    Returns:
        Start and steps for :func:`imagine`.

    Raises:
        DataError: If no episode is longer than ``past``.
    """
    steps = max(1, min(steps, int(transitions.episode_lengths.max()) - past))
    starts = transitions.window_starts(past + steps)
    return int(starts[len(starts) // 2]) + past - 1, steps


@torch.no_grad()
def imagine(
    model: DynamicsModel, transitions: Transitions, start: int, steps: int, context: int = 0
) -> Imagined:
    """Predict ``steps`` control steps from recorded actions and turn both motions into qpos.

    Args:
        model: A dynamics model on the CPU.
        transitions: Recorded episodes.
        start: Row of the recording at which the prediction begins: the present.
        steps: T, control steps of 0.03 s.
        context: At least so many states of history; 0 is the model's own H.

    Raises:
        ParameterError: If history or future of that row are not in one episode.
    """
    past = max(context, model.context)
    first, length = start - past + 1, past + steps
    if first not in transitions.window_starts(length):
        raise ParameterError(
            f"start is {start}: expected {past - 1} steps of its episode before it, {steps} after"
        )
    window = transitions.gather(np.array([first]), length)
    history, actions, truth = split_window(window, past)
    now = history.states[:, -1:]
    found = [torch.cat([now, part], dim=1)[0].numpy().astype(float)
             for part in (truth, model.predict(history, actions)[:, 0])]  # fmt: skip
    # A poor prediction may be no possible pose: draw it as well as the loops allow.
    motions = [configuration_from_state(states, gap_m=np.inf) for states in found]
    return Imagined(found[0], found[1], motions[0], motions[1])


__all__ = ["Imagined", "imagine", "pick_start"]
