"""A stage whose computation counts its runs, and ways to damage what it has stored."""

from __future__ import annotations

import time
from dataclasses import dataclass

from cassie_lib import artifacts


@dataclass(frozen=True)
class Parameters:
    """A stage's parameters of every kind that has a canonical form."""

    size: int = 3
    rate: float = 1e-3
    name: str = "a"
    weights: tuple[float, ...] = (1.0, 2.0)
    seed: int = 7


class Counted:
    """A computation that counts its runs."""

    def __init__(self, content: str = "result"):
        self.runs, self.content = 0, content

    def __call__(self, folder):
        self.runs += 1
        (folder / "weights.bin").write_bytes(b"\x00\x01" * 500)
        (folder / "sub").mkdir(exist_ok=True)
        (folder / "sub" / "log.csv").write_text(f"step,value\n0,{self.content}\n")
        (folder / "timing.csv").write_text(f"{time.time_ns()}\n")


def make(parameters=None, stage="data", compute=None, **options):
    parameters = Parameters() if parameters is None else parameters
    return artifacts.load_or_compute(stage, parameters, compute or Counted(), **options)


def wait_until(reached):
    """Return as soon as a condition holds, which another process brings about."""
    end = time.time() + 60
    while time.time() < end:
        if reached():
            return
        time.sleep(0.005)
    raise AssertionError("waited in vain")


def damage_flip(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(bytes(content))


def damage_cut(path):
    path.write_bytes(path.read_bytes()[:-3])


def damage_empty(path):
    path.write_bytes(b"")


def damage_remove(path):
    path.unlink()


DAMAGES = [damage_flip, damage_cut, damage_empty, damage_remove]
