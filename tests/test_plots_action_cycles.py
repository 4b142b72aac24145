"""The figure of action cycles draws what it is given, and shades the swing."""

from __future__ import annotations

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from recording_toys import lines

from cassie_lib import gait
from cassie_lib.errors import ShapeError
from cassie_lib.plots.action_cycles import SHOWN_JOINTS, plot_action_cycles
from cassie_lib.robot.schema import MOTOR_NAMES

mpl.use("agg")
WALK = gait.walk(0.05)


def test_each_panel_shows_one_joint_of_every_cycle():
    cycles = {"first": np.arange(280.0).reshape(28, 10), "second": np.ones((28, 10))}
    figure, data = plot_action_cycles(cycles, WALK)
    for ax, joint in zip(figure.axes, SHOWN_JOINTS, strict=True):
        assert ax.get_title() == MOTOR_NAMES[joint]
        for label, cycle in cycles.items():
            np.testing.assert_array_equal(lines(ax)[label][1], cycle[:, joint])
            np.testing.assert_array_equal(data[label][MOTOR_NAMES[joint]], cycle[:, joint])
        box = ax.patches[0]
        shaded = np.arange(28)[
            (np.arange(28) > box.get_x()) & (np.arange(28) < box.get_x() + box.get_width())
        ]
        np.testing.assert_array_equal(shaded, np.flatnonzero(~WALK.in_contact[:, 0]))
    plt.close(figure)


def test_a_cycle_of_another_length_is_named():
    with pytest.raises(ShapeError, match=r"cycle 'short' is \(14, 10\): expected \(28, 10\)"):
        plot_action_cycles({"short": np.zeros((14, 10))}, WALK)
