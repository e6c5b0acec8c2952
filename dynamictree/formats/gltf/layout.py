"""Component and element types of glTF 2.0 accessors (specification, section 3.6.2.2)."""

import numpy as np

COMPONENTS = {
    number: np.dtype(kind)
    for number, kind in ((5120, "<i1"), (5121, "<u1"), (5122, "<i2"), (5123, "<u2"), (5125, "<u4"), (5126, "<f4"))
}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


def component_number(dtype: np.dtype[np.generic] | type[np.generic]) -> int:
    """Return glTF's number of a component type."""
    return next(number for number, kind in COMPONENTS.items() if kind == np.dtype(dtype))
