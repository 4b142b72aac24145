"""How Cassie and her floor look: materials, light, thin rods.  Nothing here touches the physics."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np

#: Looks only: thin rods between a joint and what it carries (body, from, to, radius, material).
RODS = (
    ("hip-roll", (0, 0, 0), (0, 0, -0.07), 0.05, "shell"), ("hip-yaw", (0, 0, 0), (0, 0, -0.09),
    0.05, "metal"), ("achilles-rod", (0, 0, 0), (0.5012, 0, 0), 0.008, "metal"), ("knee", (0, 0, 0),
    (0.06068, 0.04741, 0), 0.035, "shell"), ("heel-spring", (0, 0, 0), (0.11877, -0.01, 0), 0.010,
    "spring"), ("foot-crank", (0, 0, 0), (0.055, 0, -0.00791), 0.008, "metal"), ("plantar-rod", (0,
    0, 0), (0.35012, 0, 0), 0.007, "metal")
)  # fmt: skip
MATERIALS = {
    "shell": "0.20 0.24 0.30 1", "metal": "0.62 0.65 0.68 1", "spring": "0.85 0.55 0.15 1", "left":
    "0.10 0.45 0.70 1", "right": "0.84 0.37 0.10 1"
}  # fmt: skip


def text(values) -> str:
    """Numbers as MJCF writes them, separated by spaces."""
    return " ".join(f"{float(value):.12g}" for value in np.atleast_1d(values))


def add_rods(body: ET.Element, name: str) -> None:
    """Draw the rods that a body carries, without mass or contact."""
    side, _, part = name.partition("-")
    for carrier, start, end, radius, material in RODS:
        if part == carrier:
            mirror = -1.0 if side == "right" else 1.0
            tip = (end[0], end[1], end[2] * mirror) if carrier == "foot-crank" else end
            ET.SubElement(
                body,
                "geom",
                type="capsule",
                size=text(radius),
                material=material,
                fromto=text((*start, *tip)),
                mass="0",
                contype="0",
                conaffinity="0",
                group="1",
            )


def add_scene(root: ET.Element) -> None:
    """Camera quality, textures and materials."""
    visual = ET.SubElement(root, "visual")
    ET.SubElement(visual, "global", offwidth="1280", offheight="960")
    ET.SubElement(visual, "headlight", ambient="0.35 0.35 0.35", diffuse="0.5 0.5 0.5")
    ET.SubElement(visual, "quality", shadowsize="4096")
    ET.SubElement(visual, "map", shadowclip="4")
    asset = ET.SubElement(root, "asset")
    ET.SubElement(
        asset,
        "texture",
        name="grid",
        type="2d",
        builtin="checker",
        width="300",
        height="300",
        rgb1="0.82 0.84 0.86",
        rgb2="0.93 0.94 0.95",
    )
    ET.SubElement(
        asset,
        "texture",
        type="skybox",
        builtin="gradient",
        width="64",
        height="384",
        rgb1="1 1 1",
        rgb2="0.80 0.86 0.93",
    )
    ET.SubElement(
        asset,
        "material",
        name="floor",
        texture="grid",
        texrepeat="10 10",
        texuniform="true",
        reflectance="0",
    )
    for name, rgba in MATERIALS.items():
        ET.SubElement(asset, "material", name=name, rgba=rgba)


def add_light(world: ET.Element) -> None:
    """One sun that follows the robot."""
    ET.SubElement(
        world,
        "light",
        name="sun",
        pos="-1.5 -1 4",
        dir="0.35 0.25 -1",
        mode="trackcom",
        type="directional",
        diffuse="0.5 0.5 0.5",
    )
