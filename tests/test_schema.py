"""The 49 components: Table 4.1, Appendix A.3, derivative orders and the mirror."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cassie_lib.errors import ShapeError
from cassie_lib.robot import schema

RANDOM = np.random.default_rng(0)


def test_table_4_1_order():
    """Table 4.1, with its last row one index shorter, then clock and speed."""
    expected = [
        ("pelvis height", 0, 0), ("pelvis orientation", 1, 4), ("motor position", 5, 14),
        ("pelvis linear velocity", 15, 17), ("pelvis angular velocity", 18, 20),
        ("motor velocity", 21, 30), ("pelvis linear acceleration", 31, 33),
        ("unactuated joint position", 34, 39), ("unactuated joint velocity", 40, 45),
        ("clock", 46, 47), ("commanded forward speed", 48, 48),
    ]  # fmt: skip
    found = [(g.name, g.slice.start, g.slice.stop - 1) for g in schema.GROUPS]
    assert found == expected


def test_groups_cover_every_component_once():
    covered = np.concatenate([np.arange(49)[group.slice] for group in schema.GROUPS])
    assert covered.tolist() == list(range(schema.STATE_SIZE))
    assert [c.index for c in schema.COMPONENTS] == list(range(schema.STATE_SIZE))
    assert len({c.name for c in schema.COMPONENTS}) == schema.STATE_SIZE
    for group in schema.GROUPS:
        assert len(group.labels) == group.slice.stop - group.slice.start
        for component in schema.COMPONENTS[group.slice]:
            assert component.name.startswith(group.name)
            assert (component.unit, component.order) == (group.unit, group.order)


def test_appendix_a_3_clock_is_phase_14():
    assert schema.clock(14) == pytest.approx([-0.11609, -0.99324], abs=5e-6)


def test_clock_repeats_after_28_steps_of_a_divisor_of_27():
    phases = np.arange(schema.PERIOD)
    values = schema.clock(phases)
    assert values.shape == (28, 2)
    assert np.allclose(np.linalg.norm(values, axis=-1), 1)
    assert np.allclose(values[27], values[0]), "27 steps of 1/27 turn are a whole turn"
    assert schema.phase_from_clock(values).tolist() == [*range(27), 0]
    noisy = values + RANDOM.normal(0, 0.03, values.shape)
    assert schema.phase_from_clock(noisy).tolist() == [*range(27), 0]


def test_derivative_orders_give_the_weights_of_eq_3_6():
    weights = np.array([1.0, 2.0, 5.0])[schema.DERIVATIVE_ORDER]
    assert set(weights[schema.PELVIS_ACCELERATION]) == {5.0}
    velocities = (
        schema.PELVIS_VELOCITY, schema.PELVIS_ANGULAR_VELOCITY, schema.MOTOR_VELOCITY,
        schema.JOINT_VELOCITY,
    )  # fmt: skip
    for part in velocities:
        assert set(weights[part]) == {2.0}
    for part in (schema.PELVIS_HEIGHT, schema.PELVIS_ORIENTATION, schema.MOTOR_POSITION):
        assert set(weights[part]) == {1.0}
    counts = np.bincount(schema.DERIVATIVE_ORDER[schema.PHYSICAL], minlength=3)
    assert counts.tolist() == [21, 22, 3]


def test_left_and_right_sides_answer_each_other():
    for component in schema.COMPONENTS:
        partner = schema.COMPONENTS[component.mirror]
        assert partner.mirror == component.index
        assert partner.sign == component.sign
        sides = {"left": "right", "right": "left"}
        for side, other in sides.items():
            if f" {side}-" in component.name:
                assert partner.name == component.name.replace(f" {side}-", f" {other}-")
        if "left" not in component.name and "right" not in component.name:
            assert partner is component


@pytest.mark.parametrize(
    ("name", "sign"),
    [
        ("motor position left-hip-roll", -1),
        ("motor position left-hip-yaw", -1),
        ("motor position right-hip-pitch", 1),
        ("motor velocity left-knee", 1),
        ("pelvis linear velocity y", -1),
        ("pelvis linear velocity x", 1),
        ("pelvis angular velocity y", 1),
        ("pelvis angular velocity z", -1),
        ("pelvis orientation x", -1),
        ("pelvis orientation y", 1),
        ("unactuated joint position left-tarsus", 1),
    ],
)
def test_signs_of_a_reflection_in_the_x_z_plane(name, sign):
    """Axial vectors turn the other way round than polar ones."""
    assert {c.name: c.sign for c in schema.COMPONENTS}[name] == sign


@given(st.integers(0, 27), st.integers(0, 2**32 - 1))
def test_mirror_is_an_involution(phase, seed):
    random = np.random.default_rng(seed)
    states, actions = random.normal(size=(3, 49)), random.normal(size=(3, 10))
    assert np.array_equal(schema.mirror_state(schema.mirror_state(states)), states)
    assert np.array_equal(schema.mirror_action(schema.mirror_action(actions)), actions)
    states[:, schema.CLOCK] = schema.clock(phase)
    once = schema.mirror_state(states, np.full(3, phase))
    assert schema.clock((phase + 14) % 28) == pytest.approx(once[0, schema.CLOCK])
    twice = schema.mirror_state(once, np.full(3, (phase + 14) % 28))
    assert np.allclose(twice, states)


def test_mirror_keeps_length_and_commutes_with_batches():
    states = RANDOM.normal(size=(4, 5, 49))
    mirrored = schema.mirror_state(states)
    assert mirrored.shape == states.shape
    assert np.allclose(np.linalg.norm(mirrored, axis=-1), np.linalg.norm(states, axis=-1))
    assert np.array_equal(mirrored[2, 3], schema.mirror_state(states[2, 3]))


def test_wrong_sizes_are_refused():
    with pytest.raises(ShapeError, match=r"\(3, 48\): expected \(\.\.\., 49\)"):
        schema.mirror_state(np.zeros((3, 48)))
    with pytest.raises(ShapeError, match=r"\(49,\): expected \(\.\.\., 10\)"):
        schema.mirror_action(np.zeros(49))
