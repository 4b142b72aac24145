"""The model against the published parameters, and the physics that must come out of them."""

import json
import math
import xml.etree.ElementTree as ET

import mujoco
import numpy as np
import pytest

from cassie_lib import paths
from cassie_lib.errors import ParameterError
from cassie_lib.robot import model as robot
from cassie_lib.robot.kinematics import LegKinematics, standing_qpos
from cassie_lib.robot.meshes import description_folder, load_mesh_model
from cassie_lib.robot.mjcf import build_mjcf

PARAMETERS = json.loads(paths.ROBOT_PARAMETERS.read_text())


def test_stored_xml_is_what_the_parameters_give():
    assert paths.ROBOT_XML.read_text() == build_mjcf(PARAMETERS)


def test_masses_and_sizes_are_the_published_ones():
    model = robot.load_model()
    assert model.body_mass.sum() == pytest.approx(33.312, abs=1e-9)
    assert (model.nq, model.nv, model.nu, model.neq) == (35, 32, 10, 4)
    for body in PARAMETERS["bodies"]:
        assert model.body(body["body"]).mass[0] == pytest.approx(body["mass_kg"])
        # The principal inertias are the eigenvalues of the published tensor.
        xx, yy, zz, xy, xz, yz = body["inertia_kg_m2_xx_yy_zz_xy_xz_yz"]
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        np.testing.assert_allclose(
            np.sort(model.body(body["body"]).inertia), np.linalg.eigvalsh(tensor), rtol=1e-6
        )


def test_joint_limits_armatures_and_springs():
    model = robot.load_model()
    for joint in PARAMETERS["joints"]:
        found = model.joint(joint["joint"])
        if "range_deg" in joint:
            np.testing.assert_allclose(np.degrees(found.range), joint["range_deg"])
        dof = found.dofadr[0]
        assert model.dof_armature[dof] == pytest.approx(joint.get("armature_kg_m2", 0.0))
        assert model.dof_damping[dof] == pytest.approx(joint.get("damping_Nms_per_rad", 0.0))
        assert found.stiffness[0] == pytest.approx(joint.get("stiffness_Nm_per_rad", 0.0))


def test_legs_collide_with_each_other_and_the_floor_only():
    model = robot.load_model()

    def meet(first, second):
        a, b = model.geom(first), model.geom(second)
        return bool((a.contype[0] & b.conaffinity[0]) or (b.contype[0] & a.conaffinity[0]))

    shapes = [f"{shape['body']}-collision" for shape in PARAMETERS["collision_shapes"]]
    assert all(meet(shape, "floor") for shape in shapes)
    assert meet("left-shin-collision", "right-tarsus-collision")
    assert not meet("left-shin-collision", "left-foot-collision")
    assert not meet("cassie-pelvis-collision", "left-shin-collision")


def test_pd_law_is_the_published_one_and_is_limited():
    model, data = robot.load_model(), None
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    data.qpos[:] = standing_qpos()
    data.qvel[:] = rng.normal(0.0, 0.5, model.nv)
    data.ctrl[:] = rng.normal(0.0, 0.3, 10)
    mujoco.mj_forward(model, data)
    kp, kd = robot.gains()
    target = data.ctrl + robot.neutral_pose()
    expected = kp * (target - data.qpos[robot.motor_qpos()]) - kd * data.qvel[robot.motor_qvel()]
    limit = robot.torque_limit()
    np.testing.assert_allclose(
        data.qfrc_actuator[robot.motor_qvel()], np.clip(expected, -limit, limit), atol=1e-9
    )
    data.ctrl[:] = 50.0
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.actuator_force, limit)


def test_standing_pose_closes_the_loops_that_the_published_one_leaves_open():
    kinematics = LegKinematics()
    assert np.abs(kinematics.loop_error(robot.nominal_qpos())).max() > 1e-3
    assert np.abs(kinematics.loop_error(np.array(standing_qpos()))).max() < 1e-9
    # The driven joints are untouched: A.3 gives their positions.
    np.testing.assert_array_equal(
        np.array(standing_qpos())[robot.motor_qpos()], robot.nominal_qpos()[robot.motor_qpos()]
    )


def _hanging(timestep_s=0.0005):
    """The robot far above the floor."""
    model = robot.load_model(timestep_s)
    data = mujoco.MjData(model)
    data.qpos[:] = standing_qpos()
    data.qpos[2] = 50.0
    return model, data


def test_loops_stay_closed_for_ten_seconds_of_motion():
    model, data = _hanging(0.002)
    model.opt.gravity[:] = 0.0
    worst, rng = 0.0, np.random.default_rng(1)
    for step in range(5000):
        if step % 100 == 0:
            data.ctrl[:] = rng.uniform(-0.3, 0.3, 10)
        mujoco.mj_step(model, data)
        worst = max(worst, np.abs(data.efc_pos[:12]).max())
    assert worst < 5e-3


def test_passive_swing_loses_energy_only_to_damping():
    model, data = _hanging()
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
    # Semi-implicit Euler loses m g^2 dt^2 / 2 a step in free fall, which would hide the rest.
    model.opt.gravity[:] = 0.0
    data.qvel[robot.motor_qvel()] = [0.2, 0.1, 0.5, 0.3, 0.2] * 2
    for _ in range(100):  # the loops take the velocities that they do not allow
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    start = data.energy.sum()
    dissipated, last = 0.0, start
    for _ in range(400):
        power = float(np.sum(model.dof_damping * data.qvel**2))
        mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        dissipated += power * model.opt.timestep
        assert data.energy.sum() <= last + 1e-6
        last = data.energy.sum()
    lost = start - last
    assert lost > 0.0
    # Soft constraints and the first-order integrator take a little besides the dampers.
    assert lost == pytest.approx(dissipated, rel=0.1)


def test_pd_drive_settles_where_spring_and_load_balance():
    model, data = _hanging(0.002)
    model.opt.gravity[:] = 0.0
    data.ctrl[:] = 0.1
    for _ in range(1500):
        mujoco.mj_step(model, data)
    # Without gravity nothing loads the joints but the loops' own springs.
    error = data.ctrl + robot.neutral_pose() - data.qpos[robot.motor_qpos()]
    assert np.abs(error).max() < 0.02
    np.testing.assert_allclose(data.actuator_force, robot.gains()[0] * error, atol=0.05)


def test_timestep_must_divide_the_control_period():
    assert robot.substeps(0.0005) == 60
    for wrong in (0.0007, 0.0, -0.001):
        with pytest.raises(ParameterError, match="divisor of 0.03"):
            robot.load_model(wrong)


def _sdf_links(path):
    links = {}
    for link in ET.parse(path).getroot().iter("link"):
        inertial = link.find("inertial")
        if inertial is None:
            continue
        values = [
            float(inertial.find(f"inertia/{key}").text)
            for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
        ]
        links[link.get("name")] = (
            float(inertial.find("mass").text),
            [float(v) for v in inertial.find("pose").text.split()[:3]],
            values,
            [float(v) for v in link.find("pose").text.split()],
        )
    return links


def test_independent_copy_of_the_parameters_agrees():
    """Masses, centres of mass, inertias and joint frames of example-robot-data's cassie_v2.sdf."""
    folder = description_folder()
    if folder is None:
        pytest.skip("the extra `meshes` is not installed")
    links = _sdf_links(folder / "robots" / "cassie_v2.sdf")
    model = robot.load_model()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    differences = []
    for body in PARAMETERS["bodies"]:
        name = body["body"].removeprefix("cassie-")
        if name not in links:
            differences.append((name, "absent", None, None))
            continue
        mass, com, inertia, pose = links[name]
        if not math.isclose(mass, body["mass_kg"], rel_tol=1e-3):
            differences.append((name, "mass", mass, body["mass_kg"]))
        if not np.allclose(com, body["com_m"], atol=1e-3):
            differences.append((name, "com", com, body["com_m"]))
        if not np.allclose(inertia, body["inertia_kg_m2_xx_yy_zz_xy_xz_yz"], rtol=0.02, atol=1e-5):
            differences.append((name, "inertia", inertia, body["inertia_kg_m2_xx_yy_zz_xy_xz_yz"]))
        if np.linalg.norm(data.body(body["body"]).xpos - pose[:3]) > 2e-3:
            differences.append((name, "frame", pose[:3], data.body(body["body"]).xpos.tolist()))
    print("differences:", *differences, sep="\n  ")
    known = KNOWN_SDF_DIFFERENCES
    assert {(name, what) for name, what, _, _ in differences} == known


#: Places where the two published copies disagree; listed, not hidden.
KNOWN_SDF_DIFFERENCES = {("left-knee-spring", "absent"), ("right-knee-spring", "absent")}


def test_meshes_change_looks_only():
    if description_folder() is None:
        pytest.skip("the extra `meshes` is not installed")
    plain, meshed = robot.load_model(), load_mesh_model()
    np.testing.assert_allclose(meshed.body_mass, plain.body_mass)
    np.testing.assert_allclose(meshed.body_inertia, plain.body_inertia)
    assert meshed.nq == plain.nq
    assert meshed.nmesh > 10
