"""Xacro: a URDF with macros, read as untrusted input.

Expanded here, and not by the package `xacro`, whose expressions are Python's own `eval`, which reads any file and the environment, and has no bounds.
It has no way to be told otherwise but to replace a dozen functions of its module, which a release may rename: then everything would run again.
The tests compare the two.
"""

from cei_gym.embodiment.xacro.expander import expand, is_xacro

__all__ = ["expand", "is_xacro"]
