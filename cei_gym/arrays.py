"""`Array`: NumPy's array of any shape and type, for annotations; docstrings say shape, unit and frame."""

from typing import Any

from numpy.typing import NDArray

type Array = NDArray[Any]
