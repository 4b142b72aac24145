"""Frozen dataclasses of every hyper-parameter, with units; the defaults are the thesis's values."""

from cassie_lib.parameters.data import (
    BurstParameters,
    CollectionParameters,
    DataParameters,
    NoiseStudyParameters,
    WideCollectionParameters,
)
from cassie_lib.parameters.dynamics import (
    CausalParameters,
    GridParameters,
    MLPParameters,
    TransformerParameters,
)
from cassie_lib.parameters.expert import (
    CONTINUATION,
    REWARD_ONLY,
    ExpertParameters,
    SimulationParameters,
)
from cassie_lib.parameters.planning import (
    CEMParameters,
    DAggerParameters,
    EvaluationParameters,
    GradientCEMParameters,
)

__all__ = [
    "BurstParameters",
    "CEMParameters",
    "CONTINUATION",
    "CausalParameters",
    "CollectionParameters",
    "DAggerParameters",
    "DataParameters",
    "EvaluationParameters",
    "ExpertParameters",
    "GradientCEMParameters",
    "GridParameters",
    "MLPParameters",
    "NoiseStudyParameters",
    "REWARD_ONLY",
    "SimulationParameters",
    "TransformerParameters",
    "WideCollectionParameters",
]
