"""Write ``cassie.xml`` from the published parameters: the one place where the two meet.

``python -m cassie_lib.robot.mjcf`` regenerates the file; a test compares it with the stored one.
"""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET

import numpy as np

from cassie_lib import paths
from cassie_lib.robot.mjcf_looks import MATERIALS, add_light, add_rods, add_scene, text

#: Contact bits (contype, conaffinity): the trunk meets the floor, a leg floor and other leg.
_CONTACT = {
    "collision": ("1", "0"),
    "collision-left": ("2", "4"),
    "collision-right": ("4", "2"),
}
_FOOT_RADIUS_M = 0.02


def _joint(parent: ET.Element, spec: dict) -> None:
    joint = ET.SubElement(parent, "joint", name=spec["joint"], type=spec["type"])
    if spec["type"] == "hinge":
        joint.set("axis", "0 0 1")
    if "range_deg" in spec:
        joint.set("range", text(spec["range_deg"]))
        joint.set("limited", "true")
    for key, attribute in (
        ("damping_Nms_per_rad", "damping"),
        ("armature_kg_m2", "armature"),
        ("stiffness_Nm_per_rad", "stiffness"),
        ("reference_deg", "ref"),
    ):
        if key in spec:
            joint.set(attribute, text(spec[key]))


def _collision(body: ET.Element, shape: dict) -> None:
    name = shape["body"]
    side = name.split("-")[0]
    contact, affinity = _CONTACT[shape["group"]]
    geom = ET.SubElement(
        body, "geom", name=f"{name}-collision", type=shape["shape"], mass="0",
        size=text(shape["radius_m"]), material=side if side in MATERIALS else "shell",
        contype=contact, conaffinity=affinity
    )  # fmt: skip
    if shape["shape"] == "sphere":
        geom.set("pos", text(shape["position_m"]))
    else:
        geom.set("fromto", text(shape["from_to_m"]))
    if name.endswith("-foot"):
        # The two ends of the sole: foot height is measured at the lower one.
        for label, point in zip(
            ("toe", "heel"), np.reshape(shape["from_to_m"], (2, 3)), strict=True
        ):
            ET.SubElement(
                body, "site", name=f"{side}-{label}", pos=text(point), size="0.005", rgba="0 0 0 0"
            )


def _body(parent: ET.Element, spec: dict, parameters: dict, children: dict) -> None:
    body = ET.SubElement(parent, "body", name=spec["body"], pos=text(spec["position_m"]))
    if "orientation_xyaxes" in spec:
        body.set("xyaxes", text(spec["orientation_xyaxes"]))
    ET.SubElement(
        body, "inertial", pos=text(spec["com_m"]), mass=text(spec["mass_kg"]),
        fullinertia=text(spec["inertia_kg_m2_xx_yy_zz_xy_xz_yz"])
    )  # fmt: skip
    if spec["parent"] == "world":
        ET.SubElement(body, "freejoint", name="pelvis")
        ET.SubElement(
            body,
            "site",
            name="imu",
            pos=text(parameters["pelvis"]["imu_site_m"]),
            size="0.01",
            rgba="0 0 0 0",
        )
    for joint in parameters["joints"]:
        if joint["body"] == spec["body"]:
            _joint(body, joint)
    for shape in parameters["collision_shapes"]:
        if shape["body"] == spec["body"]:
            _collision(body, shape)
    add_rods(body, spec["body"])
    for child in children.get(spec["body"], ()):
        _body(body, child, parameters, children)


def _settings(root: ET.Element, parameters: dict) -> None:
    solver = parameters["solver"]
    solref = text(solver["contact_and_loop_solref"])
    ET.SubElement(root, "compiler", angle="degree", autolimits="true", inertiafromgeom="false")
    ET.SubElement(
        root,
        "option",
        timestep=text(solver["physics_timestep_s"]),
        integrator="implicitfast",
        solver="Newton",
        iterations="50",
        gravity="0 0 -9.81",
    )
    default = ET.SubElement(root, "default")
    ET.SubElement(default, "geom", solref=solref, condim="3")
    ET.SubElement(default, "equality", solref=solref)
    add_scene(root)


def _drives(root: ET.Element, parameters: dict) -> None:
    """PD law of Appendix A.3's neutral pose as affine actuators: it runs inside the C step."""
    control = parameters["control"]
    limits = {item["motor"]: item["joint_torque_limit_Nm"] for item in parameters["actuators"]}
    actuator = ET.SubElement(root, "actuator")
    rows = zip(
        control["motor_order"],
        control["neutral_pose_rad"],
        control["kp_Nm_per_rad"],
        control["kd_Nms_per_rad"],
        strict=True,
    )
    for motor, neutral, kp, kd in rows:
        ET.SubElement(
            actuator,
            "general",
            name=motor,
            joint=motor,
            gaintype="fixed",
            biastype="affine",
            gainprm=text(kp),
            biasprm=text((kp * neutral, -kp, -kd)),
            forcerange=text((-limits[motor], limits[motor])),
        )


def _sensors(root: ET.Element) -> None:
    sensor = ET.SubElement(root, "sensor")
    ET.SubElement(
        sensor, "framelinacc", name="pelvis-acceleration", objtype="xbody", objname="cassie-pelvis"
    )
    for side in ("left", "right"):
        for end in ("heel", "toe"):
            ET.SubElement(
                sensor, "framepos", name=f"{side}-{end}", objtype="site", objname=f"{side}-{end}"
            )
    for side in ("left", "right"):
        ET.SubElement(
            sensor,
            "contact",
            name=f"{side}-foot-force",
            geom1="floor",
            geom2=f"{side}-foot-collision",
            data="force",
            reduce="netforce",
            num="1",
        )


def build_mjcf(parameters: dict) -> str:
    """Render the MJCF.

    Args:
        parameters: The content of ``cassie_parameters.json``.

    Returns:
        The XML text of the model.
    """
    root = ET.Element("mujoco", model="cassie")
    _settings(root, parameters)
    world = ET.SubElement(root, "worldbody")
    add_light(world)
    ET.SubElement(
        world,
        "geom",
        name="floor",
        type="plane",
        size="0 0 0.25",
        material="floor",
        pos=text((0, 0, parameters["solver"]["floor_height_m"])),
        contype="0",
        conaffinity="7",
    )
    children: dict[str, list[dict]] = {}
    for spec in parameters["bodies"]:
        children.setdefault(spec["parent"], []).append(spec)
    for spec in children["world"]:
        _body(world, spec, parameters, children)
    equality = ET.SubElement(root, "equality")
    for loop in parameters["loop_closures"]:
        ET.SubElement(
            equality,
            "connect",
            name=f"{loop['body1']}-loop",
            body1=loop["body1"],
            body2=loop["body2"],
            anchor=text(loop["anchor_in_body1_m"]),
        )
    _drives(root, parameters)
    _sensors(root)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def main() -> None:
    """Regenerate ``cassie.xml`` in place."""
    parameters = json.loads(paths.ROBOT_PARAMETERS.read_text())
    paths.ROBOT_XML.write_text(build_mjcf(parameters))


if __name__ == "__main__":
    main()
