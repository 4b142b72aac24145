"""Speed of the dynamics models, by hand: ``python tests/benchmarks/bench_dynamics.py [part ...]``.

Parts: ``cache`` (cached against re-encoding), ``peak`` (share of the matrix-multiply peak),
``plans`` (latencies that a planner sees), ``training`` (windows per second).  Numbers are the best
of several runs, those of ``cache`` medians and, in brackets, extremes; close other programs.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from functools import partial
from pathlib import Path

import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from dynamics_toys import make_actions, make_history, oscillators, randomise

from cassie_lib.dynamics.causal import CausalModel
from cassie_lib.dynamics.multi_step import multi_step
from cassie_lib.dynamics.normalisation import Normalisation
from cassie_lib.dynamics.train_causal import rollout_loss, teacher_forced_loss
from cassie_lib.dynamics.transformer import TransformerModel
from cassie_lib.presets import get_preset

CACHE_TURNS = 5


def best_ms(function, repeats: int) -> float:
    """Least wall time of ``repeats`` calls after one that warms up, ms."""
    function()
    return min(_ms(function) for _ in range(repeats))


def _ms(function) -> float:
    """Wall time of one call, ms."""
    start = time.perf_counter()
    function()
    return 1e3 * (time.perf_counter() - start)


def make_models():
    """Causal and encoder-decoder model of the laptop preset on toy statistics."""
    preset = get_preset("laptop")
    normalisation = Normalisation.from_transitions(oscillators())
    causal = randomise(CausalModel(preset.causal, normalisation), scale=0.02)
    transformer = TransformerModel(preset.transformer, normalisation)
    return causal.eval().requires_grad_(False), transformer.eval().requires_grad_(False)


def token_flops(model: CausalModel) -> int:
    """Multiply-adds of the linear layers for one token, times two."""
    linears = [m for m in model.modules() if isinstance(m, torch.nn.Linear)]
    return 2 * sum(m.weight.numel() for m in linears)


def bench_cache(causal: CausalModel, transformer: TransformerModel) -> None:
    """1000 candidates x 10 steps: with the cache, and encoding every window anew.

    Both predict all candidates in one forward pass per step.  Windows that are encoded anew take
    less time in groups that fit into the processor's cache: timed as well.  In turn, because the
    clock of a shared machine drifts by more than what is measured.
    """
    history = make_history(1, causal.context)
    actions = 0.1 * make_actions(1, 1000, 10)

    def anew(size: int) -> torch.Tensor:
        pieces = [causal.predict_uncached(history, part) for part in actions.split(size, dim=1)]
        return torch.cat(pieces, dim=1)

    difference = (causal.predict(history, actions) - anew(1000)).abs().max().item()
    turns = []
    for _ in range(CACHE_TURNS):
        cached = statistics.median(_ms(lambda: causal.predict(history, actions)) for _ in range(7))
        turns.append((cached, _ms(partial(anew, 1000)), _ms(partial(anew, 125))))
    names = ("cached", "re-encoding", "re-encoding, 125 at a time")
    for name, column in zip(names, zip(*turns, strict=True), strict=True):
        ratios = sorted(found / turn[0] for found, turn in zip(column, turns, strict=True))
        print(f"1000 x 10, {name:26s} {statistics.median(column):8.1f} ms "
              f"{statistics.median(ratios):6.1f} times as long "
              f"[{ratios[0]:.1f}, {ratios[-1]:.1f}]")  # fmt: skip
    part = actions[:, :50]
    sliding = 20 * best_ms(lambda: transformer.predict(history, part), 1)
    print(f"1000 x 10, encoder-decoder            {sliding:8.1f} ms")
    print(f"largest difference cached - re-encoded: {difference:.1e}")


def bench_peak(causal: CausalModel, transformer: TransformerModel) -> None:
    """FLOP/s of the linear layers as a share of a large matrix product's."""
    a = torch.randn(2048, 2048)
    peak = 2 * 2048**3 / best_ms(lambda: a @ a, 10) / 1e6
    print(f"matrix product 2048^3: {peak:.1f} GFLOP/s, {torch.get_num_threads()} threads")
    flops, history = token_flops(causal), make_history(1, causal.context)
    for candidates in (8, 32, 256, 1000):
        prepared = causal.prepare(history)
        actions = 0.1 * make_actions(1, candidates, 10)
        duration = best_ms(partial(causal.predict, prepared, actions), 5)
        rate = candidates * 10 * flops / duration / 1e6
        print(f"N = {candidates:5d}: {rate:6.1f} GFLOP/s, {100 * rate / peak:4.0f} % of it")


def gradient(causal: CausalModel, prepared, actions: torch.Tensor) -> torch.Tensor:
    """Gradient of the summed prediction in the actions."""
    leaf = actions.clone().requires_grad_(True)
    return torch.autograd.grad(causal.predict(prepared, leaf).sum(), leaf)[0]


def bench_plans(causal: CausalModel, transformer: TransformerModel) -> None:
    """Encoding, one forward pass, one gradient; 12 gradients are one laptop plan."""
    print("  E    N   encode   predict   gradient   12 gradients   (ms)")
    for episodes, candidates in ((1, 8), (1, 32), (10, 8), (10, 32)):
        history = make_history(episodes, causal.context)
        prepared = causal.prepare(history)
        actions = 0.1 * make_actions(episodes, candidates, 10)
        encode = best_ms(partial(causal.prepare, history), 10)
        predict = best_ms(partial(causal.predict, prepared, actions), 10)
        slope = best_ms(partial(gradient, causal, prepared, actions), 10)
        print(
            f"{episodes:3d} {candidates:4d} {encode:8.1f} {predict:9.1f} {slope:10.1f} "
            f"{12 * slope:14.1f}"
        )


def bench_training(causal: CausalModel, transformer: TransformerModel) -> None:
    """Optimisation speed of both models, windows per second."""
    data = oscillators(4, 80)
    window = data.gather(range(64), causal.context + 10)
    weights = torch.ones(46)
    causal.requires_grad_(True).train()
    transformer.requires_grad_(True).train()
    ones = torch.ones(49)
    losses = {
        "causal, all positions": lambda: teacher_forced_loss(causal, window, weights),
        "causal, 10-step rollout": lambda: rollout_loss(causal, window, weights),
        "encoder-decoder, 1 step": lambda: multi_step(transformer, window, 1, ones).steps.mean(),
        "encoder-decoder, 1 step, penalty": lambda: sum(
            multi_step(transformer, window, 1, ones, True)[::2]
        ).sum(),
    }
    for name, loss in losses.items():
        print(f"{name:34s} {64e3 / best_ms(lambda f=loss: f().backward(), 3):8.0f} windows/s")


PARTS = {
    "cache": bench_cache,
    "peak": bench_peak,
    "plans": bench_plans,
    "training": bench_training,
}


def main() -> None:
    """Run the parts asked for, or all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", default=list(PARTS), help=", ".join(PARTS))
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    for name in arguments.parts:
        print(f"-- {name}")
        PARTS[name](*make_models())


if __name__ == "__main__":
    main()
