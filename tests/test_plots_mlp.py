"""Figure 5.2 of notebook 04: a red line for each step that was trained, and for no other."""

from __future__ import annotations

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest

from cassie_lib.plots import mlp as plots

mpl.use("agg")


@pytest.mark.parametrize(
    ("increments", "drawn"), [([], []), ([3, 6], [3.5, 6.5]), ([3, 6, 8], [3.5, 6.5])]
)
def test_an_increment_after_the_last_epoch_is_not_drawn(increments, drawn):
    epochs = np.arange(1.0, 9.0)
    sets = ("train", "validation", "test")
    curves = {f"{name}/state_prediction": (epochs, 1.0 / epochs) for name in sets}
    if increments:
        curves["increment"] = (np.array(increments, float), np.arange(len(increments)) + 2.0)
    losses = {name: np.array([0.1, 0.2, 0.3]) for name in sets}
    figure, data = plots.plot_curriculum(curves, losses, losses)
    marks = [line.get_xdata() for line in figure.axes[0].get_lines() if len(line.get_xdata()) == 2]
    assert [mark[0] for mark in marks if mark[0] == mark[1]] == drawn
    named = [text.get_text() for text in figure.legends[0].get_texts()]
    assert named.count("one step more is predicted") == bool(drawn)
    np.testing.assert_array_equal(data["test by step"]["loss"], losses["test"])
    plt.close("all")
