"""Companion library to *Model-Based Reinforcement Learning for Bipedal Robots*.

The stages import from left to right only:
``robot -> gait, reward -> simulator -> walking -> expert -> data -> dynamics -> planning -> dagger
-> figures``.  Importing the package itself loads neither MuJoCo nor torch.
"""

import os
import sys

# Headless Linux: MuJoCo chooses its OpenGL back end once, when it is first imported.
if sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
    os.environ.setdefault("MUJOCO_GL", "egl")

__version__ = "0.1.0"
