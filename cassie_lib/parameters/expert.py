"""Physics, the expert and its training."""

from __future__ import annotations

from dataclasses import dataclass

from cassie_lib.parameters.ranges import require


@dataclass(frozen=True)
class SimulationParameters:
    """Physics.  Coarse steps serve expert training only; every reported number uses fine ones."""

    timestep_s: float = 0.0005
    training_timestep_s: float = 0.002
    speed_mps: float = 0.0509  # commanded forward speed of the thesis's data (section 4.3.2)


@dataclass(frozen=True)
class ExpertParameters:
    """Recurrent PPO (thesis section 4.3.1)."""

    hidden_size: int = 128
    layers: int = 2
    action_std_rad: float = 0.13  # exploration noise, fixed for most of the training
    final_action_std_rad: float = 0.05  # at its end, half of the robots: noise slows a walk
    loud_action_std_rad: float = 0.10  # at its end, the others: pushes need exploration
    robots: int = 128
    rollout_steps: int = 56  # control steps per robot and update
    total_steps: int = 4_100_000  # control steps over all robots, before the refinement
    refinement_steps: int = 2_800_000  # more, for speed and pushes, at a low learning rate
    refinement_learning_rate: float = 4e-4
    epochs: int = 3
    minibatches: int = 4
    sequence_steps: int = 28  # truncation of back-propagation through time
    learning_rate: float = 1e-3
    discount: float = 0.97
    gae_lambda: float = 0.95
    clip: float = 0.2
    target_kl: float = 0.03
    max_gradient_norm: float = 0.5
    episode_steps: int = 300
    guidance_weight: float = 0.5  # share of the gait and velocity terms in the training reward
    foot_tolerance_m: float = 0.09  # a training episode ends when a sole strays this far in height
    push_limit_Ns: float = 60.0  # largest sideways push on the pelvis during training, N s
    push_interval_steps: int = 100  # mean control steps from a recovery to the next push
    recovery_steps: int = 56  # control steps after a push in which the gait may be left
    randomise: float = 0.0  # relative spread of masses, damping, friction; 0: none
    termination_reward: float = 0.3  # an episode ends when Eq 3.10 falls under this
    min_speed_mps: float = 0.0
    max_speed_mps: float = 1.0
    checkpoint_seconds: float = 60.0
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse values that no training can begin with."""
        require(
            self, "hidden_size", "layers", "robots", "rollout_steps", "total_steps", "epochs",
            "minibatches", "sequence_steps", "episode_steps", "push_interval_steps",
            "recovery_steps", least=1,
        )  # fmt: skip
        require(
            self, "action_std_rad", "final_action_std_rad", "loud_action_std_rad",
            "refinement_steps", "refinement_learning_rate", "learning_rate", "max_gradient_norm",
            "foot_tolerance_m", "push_limit_Ns", "checkpoint_seconds", "seed", least=0,
        )  # fmt: skip
        require(self, "discount", "gae_lambda", "clip", "guidance_weight", least=0, most=1)
        require(self, "randomise", least=0, most=0.99)


#: Eq 3.10 alone at the thesis's speed: the policy that learns to stand still.
REWARD_ONLY = ExpertParameters(
    guidance_weight=0.0,
    push_limit_Ns=0.0,
    min_speed_mps=0.0509,
    max_speed_mps=0.0509,
    total_steps=1_000_000,
    refinement_steps=0,
)

#: More of the refinement: the first training ends 0.06 m/s behind at 1 m/s on one processor, and
#: with one in five robots falling after 40 N s on another.  At all speeds: a shorter one at fast
#: commands alone spoilt the slower ones and the pushes.  One step of training proper, so that
#: pushes have their full size at once.
CONTINUATION = ExpertParameters(
    action_std_rad=0.07,
    learning_rate=4e-4,
    total_steps=1,
    refinement_steps=1_300_000,
    seed=1,
)
