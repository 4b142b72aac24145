"""The data sets of section 4.3."""

from __future__ import annotations

from dataclasses import dataclass

from cassie_lib.parameters.ranges import require


@dataclass(frozen=True)
class CollectionParameters:
    """One data set of section 4.3: how many transitions at which action noise."""

    name: str
    transitions: int
    noise_std_rad: float
    seed: int
    episode_steps: int = 300
    robots: int = 32


@dataclass(frozen=True)
class BurstParameters:
    """Bursts of correlated action noise that push the robot off the expert's walk."""

    strongest_rad: float = 0.5
    longest_steps: int = 14  # control steps
    pause_steps: tuple[int, int] = (15, 70)  # least and most control steps between two bursts

    def __post_init__(self) -> None:
        """Refuse a strength that is no angle."""
        require(self, "strongest_rad", least=0)


@dataclass(frozen=True)
class WideCollectionParameters(CollectionParameters):
    """A data set far off the expert's habits."""

    bursts: BurstParameters = BurstParameters()


@dataclass(frozen=True)
class NoiseStudyParameters:
    """Whole episodes at each of several noise levels (falls and foot paths against sigma)."""

    noise_std_rad: tuple[float, ...] = (
        0.0, 0.01, 0.03, 0.06, 0.08, 0.1, 0.125, 0.15, 0.175, 0.2, 0.225, 0.25,
    )  # fmt: skip
    robots: int = 32  # episodes per level
    episode_steps: int = 300
    seed: int = 8


@dataclass(frozen=True)
class DataParameters:
    """The five data sets of sections 5.1.1 and 5.1.2, two wide ones, and the noise study."""

    train: CollectionParameters = CollectionParameters("train", 90_650, 0.06, 1)
    validation: CollectionParameters = CollectionParameters("validation", 41_650, 0.03, 2)
    test: CollectionParameters = CollectionParameters("test", 41_650, 0.01, 3)
    # Longer episodes, so that windows of H = 100 lose a tenth of the samples, not a third.
    baseline: CollectionParameters = CollectionParameters("baseline", 10_000, 0.01, 4, 1000)
    baseline_test: CollectionParameters = CollectionParameters(
        "baseline_test", 4_000, 0.03, 5, 1000
    )
    #: Not in the thesis: trains the causal model off the expert's habits ...
    wide: WideCollectionParameters = WideCollectionParameters("wide", 240_000, 0.06, 6)
    #: ... and tests it at a noise that no model trains on.
    wide_test: CollectionParameters = CollectionParameters("wide_test", 10_000, 0.15, 7)
    noise_study: NoiseStudyParameters = NoiseStudyParameters()
