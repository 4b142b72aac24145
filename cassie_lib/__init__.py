"""Companion library to *Model-Based Reinforcement Learning for Bipedal Robots*.

The stages import from left to right only:
``robot -> gait, reward -> simulator -> walking -> expert -> data -> dynamics -> planning -> dagger
-> figures``.  Importing the package itself loads neither MuJoCo nor torch.
"""

__version__ = "0.1.0"
