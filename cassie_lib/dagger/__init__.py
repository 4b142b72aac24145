"""Model-based DAgger: Algorithm 3 of the thesis.

The expert is in control and the planner acts at n random steps of every phi.  What happens then is
added to the data, the model is trained on, and n grows.  Older rounds may count less (beta of
section 6.2).  Each round is one artifact; a killed round goes on at its last batch of episodes or
at the last checkpoint of its training.
"""

from __future__ import annotations

from cassie_lib.dagger.recordings import (
    pad_starts,
    split_by_episode,
    to_transitions,
    window_shares,
)
from cassie_lib.dagger.rounds import Round, Start, dagger_rounds

__all__ = [
    "Round",
    "Start",
    "dagger_rounds",
    "pad_starts",
    "split_by_episode",
    "to_transitions",
    "window_shares",
]
