"""Hyper-parameters out of range are refused where they are put together, by name."""

from __future__ import annotations

from dataclasses import fields

import pytest

from cassie_lib import presets
from cassie_lib.errors import ParameterError
from cassie_lib.parameters import (
    BurstParameters,
    CausalParameters,
    ExpertParameters,
    MLPParameters,
    TransformerParameters,
)


@pytest.mark.parametrize(
    ("kind", "changes", "text"),
    [
        (ExpertParameters, {"total_steps": 0}, "ExpertParameters.total_steps = 0: expected at"),
        (ExpertParameters, {"minibatches": 0}, "minibatches = 0: expected at least 1"),
        (ExpertParameters, {"action_std_rad": -1.0}, "action_std_rad = -1.0: expected at least 0"),
        (ExpertParameters, {"randomise": -1.0}, "randomise = -1.0: expected 0 to 0.99"),
        (ExpertParameters, {"discount": 1.5}, "discount = 1.5: expected 0 to 1"),
        (MLPParameters, {"batch_size": 0}, "MLPParameters.batch_size = 0"),
        (TransformerParameters, {"heads": 0}, "heads = 0: expected at least 1"),
        (TransformerParameters, {"dropout": 2.0}, "dropout = 2.0"),
        (TransformerParameters, {"seed": -1}, "seed = -1: expected at least 0"),
        (CausalParameters, {"steps": -5}, "steps = -5: expected at least 0"),
        (CausalParameters, {"context": 1}, "context = 1: expected at least 2"),
        (CausalParameters, {"validation_windows": 0}, "validation_windows = 0"),
        (CausalParameters, {"rollout_share": float("nan")}, "rollout_share = nan"),
        (CausalParameters, {"average_share": 1.5}, "average_share = 1.5"),
        (BurstParameters, {"strongest_rad": float("inf")}, "strongest_rad = inf"),
    ],
)
def test_out_of_range_is_refused_by_name(kind, changes, text):
    with pytest.raises(ParameterError, match=text):
        kind(**changes)
    with pytest.raises(ParameterError, match=text):
        presets.replace(kind(), **changes)


@pytest.mark.parametrize("name", presets.PRESETS)
def test_every_preset_is_within_its_own_ranges(name):
    for item in fields(presets.get_preset(name)):
        section = getattr(presets.get_preset(name), item.name)
        check = getattr(section, "__post_init__", None)
        if check:
            check()
