"""Matrices that a job gives row by row."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator

from mrbatch.quantities import Number
from mrbatch.scene.material_settings import to_tuple

ORTHONORMAL_TOLERANCE = 1e-5
"""Largest entry of R^T R - 1 that a rotation given with six decimals may have."""

Row3 = tuple[Number, Number, Number]
Row4 = tuple[Number, Number, Number, Number]
Matrix3 = Annotated[tuple[Row3, Row3, Row3], BeforeValidator(to_tuple)]
Matrix4 = Annotated[tuple[Row4, Row4, Row4, Row4], BeforeValidator(to_tuple)]


def check_rotation(value: Any) -> None:
    """Raises ValueError for a matrix (3, 3) that is no rotation."""
    r = np.array(value, dtype=np.float64)
    if np.max(np.abs(r.T @ r - np.eye(3))) > ORTHONORMAL_TOLERANCE:
        raise ValueError("is not a rotation: its columns are not unit vectors at right angles")
    if np.linalg.det(r) < 0.0:
        raise ValueError("is not a rotation but mirrors: its determinant is -1")
