"""Training loops: resume after a kill, skipped steps, schedule, warm start."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from dynamics_toys import CAUSAL, MLP, TRANSFORMER, oscillators

from cassie_lib.dynamics.evaluation import open_loop
from cassie_lib.dynamics.loop import Budget, StepGuard, pick_device
from cassie_lib.dynamics.train_causal import learning_rate
from cassie_lib.dynamics.training import train_causal, train_mlp, train_transformer
from cassie_lib.errors import CheckpointError, DataError, ParameterError, TrainingError
from cassie_lib.presets import replace

TESTS = Path(__file__).parent
KINDS = ("causal", "transformer", "mlp")
QUICK = {
    "causal": replace(CAUSAL, dropout=0.1),
    "transformer": replace(TRANSFORMER, checkpoint_seconds=0.0, change_percent=1e9),
    "mlp": replace(MLP, checkpoint_seconds=0.0, slope=1e9),
}


def run(kind, folder=None, callback=None, parameters=None):
    torch.set_num_threads(1)
    sets = {"validation": oscillators(2, 20, seed=2), "folder": folder, "callback": callback}
    train, parameters = oscillators(3, 20), parameters or QUICK[kind]
    if kind == "causal":
        return train_causal(train, parameters, **sets)
    if kind == "mlp":
        return train_mlp(train, parameters, curriculum=True, **sets)
    return train_transformer(train, parameters, test=oscillators(2, 20, seed=3), **sets)


def kill_at(step, kind, folder):
    """Called in a process of its own: dies without any chance to clean up."""

    def callback(now, model):
        if now == step:
            os.kill(os.getpid(), signal.SIGKILL)

    run(kind, Path(folder), callback)


@pytest.mark.parametrize("kind", KINDS)
def test_killed_training_ends_with_the_same_weights_to_the_bit(kind, tmp_path):
    code = f"import test_dynamics_training as t; t.kill_at(8, {kind!r}, {str(tmp_path)!r})"
    done = subprocess.run([sys.executable, "-c", code], cwd=TESTS, capture_output=True, text=True)
    assert done.returncode == -signal.SIGKILL, done.stderr
    seen = []
    resumed = run(kind, tmp_path, lambda step, model: seen.append(step))
    whole = run(kind)
    assert seen[0] == 9
    assert resumed.steps == whole.steps > 9
    for name, value in whole.model.state_dict().items():
        assert torch.equal(value, resumed.model.state_dict()[name]), name
    columns = [[(r[0], r[1], r[3], r[4]) for r in t.log.rows] for t in (whole, resumed)]
    assert columns[0] == columns[1]
    with (tmp_path / "log.csv").open() as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["epoch", "step", "seconds", "metric", "value"]
    assert len(rows) == len(resumed.log.rows) + 1


@pytest.mark.parametrize(("share", "averaged"), [(0.0, 1), (0.25, 4), (1.0, 16)])
def test_causal_weights_are_the_mean_over_the_last_steps(share, averaged):
    """What is validated last is what is returned."""
    seen = []

    def note(step, model):
        seen.append([value.detach().clone() for value in model.parameters()])

    trained = run("causal", None, note, replace(CAUSAL, average_share=share))
    assert len(seen) == 16
    for index, value in enumerate(trained.model.parameters()):
        expected = torch.stack([weights[index] for weights in seen[-averaged:]]).mean(0)
        torch.testing.assert_close(value, expected)
    moved = any(not torch.equal(a, b) for a, b in zip(seen[-1], seen[-2], strict=True))
    assert moved, "the steps must differ for their mean to mean anything"
    found = open_loop(trained.model, oscillators(2, 20, seed=2), CAUSAL.horizon, 8)
    logged = trained.log.series(f"validation/relative_step_{CAUSAL.horizon}")[2][-1]
    assert logged == pytest.approx(found.relative[-1])


def test_mean_of_the_weights_has_less_of_the_luck_of_the_last_batches():
    """With a learning rate that never settles, the mean is nearer the truth than most steps."""
    errors = []
    data = oscillators(2, 20, seed=2)

    def note(step, model):
        if step > 150:
            errors.append(open_loop(model.eval(), data, CAUSAL.horizon, 8).relative[-1])
            model.train()

    settings = replace(
        CAUSAL, steps=200, learning_rate=5e-3, final_learning_rate=5e-3, average_share=0.25
    )
    trained = run("causal", None, note, settings)
    assert open_loop(trained.model, data, CAUSAL.horizon, 8).relative[-1] < np.median(errors)


def test_finished_training_is_not_repeated(tmp_path):
    first = run("causal", tmp_path)
    seen = []
    again = run("causal", tmp_path, lambda step, model: seen.append(step))
    assert seen == []
    assert torch.equal(first.model.head.weight, again.model.head.weight)


def test_checkpoint_of_another_run_or_damaged(tmp_path):
    run("causal", tmp_path)
    with pytest.raises(CheckpointError, match="belongs to run"):
        run("causal", tmp_path, parameters=replace(QUICK["causal"], learning_rate=5e-4))
    path = tmp_path / "checkpoint.pt"
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(CheckpointError):
        run("causal", tmp_path)
    # A changed byte in the middle of the tensors, which the container may not notice.
    position = whole.find(np.float32(run("causal").model.norm.weight[0].item()).tobytes())
    damaged = bytearray(whole)
    damaged[position] ^= 0xFF
    path.write_bytes(bytes(damaged))
    with pytest.raises(CheckpointError):
        run("causal", tmp_path)


@pytest.mark.parametrize("kind", KINDS)
def test_training_lowers_the_loss(kind):
    settings = {
        "causal": replace(QUICK["causal"], steps=200, learning_rate=1e-2, rollout_share=0.2),
        "transformer": replace(
            QUICK["transformer"], epochs=12, learning_rate=3e-3, horizon=1, dropout=0.0
        ),
        "mlp": replace(QUICK["mlp"], curriculum_epochs=12, learning_rate=3e-3, horizon=1),
    }
    metric = "one_step_loss" if kind == "causal" else "state_prediction"
    values = run(kind, parameters=settings[kind]).log.series(f"train/{metric}")[2]
    assert values[-1] < 0.8 * values[0]


def test_curriculum_adds_steps_and_logs_them():
    training = run("transformer")
    assert training.log.series("increment")[2] == [2.0, 3.0]
    assert training.log.series("horizon")[2] == [1.0, 1.0, 2.0, 2.0]
    assert len(training.log.series("test/step_2")[2]) == 2
    assert len(training.log.series("train/penalised")[2]) == 4
    with pytest.raises(ParameterError, match="validation"):
        train_mlp(oscillators(), MLP, curriculum=True)


def test_warm_start_takes_weights_and_normalisation():
    first = run("causal")
    still = replace(QUICK["causal"], steps=0)
    other = oscillators(2, 30, seed=9)
    second = train_causal(other, still, initial=first.model)
    for name, value in first.model.state_dict().items():
        assert torch.equal(value, second.model.state_dict()[name]), name
    with pytest.raises(ParameterError, match="other sizes"):
        train_causal(other, replace(still, model_size=8), initial=first.model)


def test_mixed_sources_by_share():
    sources = [oscillators(2, 20), oscillators(2, 20, seed=4)]
    assert train_causal(sources, replace(CAUSAL, steps=2), shares=(0.9, 0.1)).steps == 2
    with pytest.raises(DataError, match="longest episode has 9"):
        train_causal(oscillators(2, 9), CAUSAL)


def test_guard_skips_and_counts_bad_steps():
    layer = torch.nn.Linear(3, 1)
    optimiser = torch.optim.SGD(layer.parameters(), lr=0.1)
    guard = StepGuard()
    for _ in range(25):
        assert guard.step(layer(torch.ones(1, 3)).sum(), layer, optimiser)
    before = layer.weight.detach().clone()
    for loss in (layer(torch.full((1, 3), float("nan"))).sum(), 1e6 * layer(torch.ones(3)).sum()):
        assert not guard.step(loss, layer, optimiser)
    assert torch.equal(before, layer.weight)
    assert guard.skipped == 2
    assert guard.step(layer(torch.ones(1, 3)).sum(), layer, optimiser)
    bad = torch.tensor(float("nan"))
    assert not any(guard.step(bad, layer, optimiser) for _ in range(49))
    with pytest.raises(TrainingError, match="50 optimiser steps in a row"):
        guard.step(bad, layer, optimiser)


def test_learning_rate_warms_up_and_decays():
    rates = [learning_rate(x, CAUSAL) for x in np.linspace(0, 1, 101)]
    peak = int(np.argmax(rates))
    assert rates[peak] == pytest.approx(CAUSAL.learning_rate)
    assert peak == round(100 * CAUSAL.warmup_share)
    assert all(np.diff(rates[: peak + 1]) > 0)
    assert all(np.diff(rates[peak:]) < 0)
    assert rates[-1] == pytest.approx(CAUSAL.final_learning_rate)


def test_budget_counts_earlier_sessions():
    assert Budget(1.0, spent=59.0).share == pytest.approx(59 / 60, rel=1e-2)
    assert Budget(0.0, spent=1e6).share == 0.0


def test_unknown_device():
    assert pick_device().type in ("cpu", "cuda")
    with pytest.raises(ParameterError, match="device is 'abacus'"):
        pick_device("abacus")
