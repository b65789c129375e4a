"""`Array`: NumPy's array of any shape and type, for annotations; docstrings say shape, unit and frame."""

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    type Array = NDArray[Any]
else:
    Array = np.ndarray  # what reads files by the annotations of their fields (draccus) knows just this
