"""A merged map as an EXR file: radiance, the masks that say what to make of it, and how it came about."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from mrbatch.errors import Place, ResourceError
from mrbatch.scene.picture_library import library_error

HALF_MAX = 65504.0
HALF_NORMAL = 2.0**-14
"""Below this half keeps less than its eleven bits."""
NumberType = Literal["auto", "half", "float"]


def choose_number_type(radiance: np.ndarray) -> tuple[Literal["half", "float"], str]:
    """Half where it keeps all values to 2^-11, float else; with the reason."""
    peak = float(radiance.max())
    if not peak <= HALF_MAX:
        return "float", f"light of {peak:.4g} exceeds half's largest number, 65504"
    faint = float(np.mean((radiance > 0.0) & (radiance < HALF_NORMAL)))
    if faint > 1e-3:
        return "float", f"{100.0 * faint:.2g} % of the values are below half's normal range"
    return "half", "half keeps all values to 0.05 %"


def _ends_whole(path: Path, height: int) -> bool:
    """Whether the last row can be read; all other data lie before it."""
    import OpenImageIO as oiio

    source = oiio.ImageInput.open(str(path))
    if source is None:
        library_error(oiio)
        return False
    try:
        channels = source.spec().nchannels
        last = source.read_scanlines(0, 0, height - 1, height, 0, 0, channels, "float")
        return last is not None and not library_error(source)
    finally:
        source.close()


def write_map(
    path: Path,
    radiance: np.ndarray,
    masks: Mapping[str, np.ndarray],
    metadata: Mapping[str, Any],
    number_type: Literal["half", "float"],
) -> None:
    """Writes radiance (height, width, 3) as R, G, B and each mask (height, width) as a channel `flag.NAME`.

    The file is there whole or not at all. Raises ResourceError where it cannot be written.
    """
    import OpenImageIO as oiio

    height, width = radiance.shape[:2]
    names = ["R", "G", "B", *(f"flag.{name}" for name in masks)]
    spec = oiio.ImageSpec(width, height, len(names), number_type)
    spec.channelnames = tuple(names)
    spec.attribute("compression", "zip")
    # An empty date keeps the library from stamping the file: the same pictures give the same bytes.
    spec.attribute("DateTime", "")
    spec.attribute("chromaticities", "float[8]", (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290))
    spec.attribute("mrbatch/merge", json.dumps(metadata, sort_keys=True))
    pixels = np.concatenate([radiance, *(m[..., None] for m in masks.values())], axis=-1, dtype=np.float32)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp.exr")
    out = oiio.ImageOutput.create("openexr")
    if out is None:
        raise ResourceError("this OpenImageIO cannot write EXR", hint="install OpenImageIO from its wheel")
    try:
        done = out.open(str(temporary), spec) and out.write_image(np.ascontiguousarray(pixels))
        # Closing flushes the last buffer but does not say when that fails; the last row tells.
        if not (out.close() and done and _ends_whole(temporary, height)):
            reason = (library_error(out) or "the disk gave no reason").strip().splitlines()[0]
            raise ResourceError(f"cannot write the map: {reason}", place=Place(file=str(path)))
        os.replace(temporary, path)
    except OSError as error:
        raise ResourceError(f"cannot write the map ({error.strerror})", place=Place(file=str(path))) from None
    finally:
        temporary.unlink(missing_ok=True)
