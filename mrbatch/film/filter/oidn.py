"""Intel Open Image Denoise: a neural network that was taught on path-traced pictures (Áfra, 2019-2025).

It is given light, without texture and coverage (`signal.py`), with the normals of first hits:

- A change of light has a sign, pictures have none. The network sees S + change, with S for each channel the
  deepest shadow but for one pixel in a thousand: as a white surface looks that receives S, shadows and all.
  What is deeper is left out and added again.
- Pixels that are to be left alone would look like edges, and of those that show less than half of the surface
  the light is too noisy. What the network sees there is the mean of their neighbours.
- The network blurs and invents even where there is no noise: its change is applied as far as noise accounts
  for it (`strength.py`).
- The network does not keep means; what it takes away from them is given back (`residual.py`).

The network's reach is most of the picture, so a crop is not the crop of the picture. Threads do not change
its bits; other processors, for which it has other code, may.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mrbatch.errors import ResourceError
from mrbatch.film.filter.neighbours import surfaces_of
from mrbatch.film.filter.residual import mean_kept
from mrbatch.film.filter.signal import Signal
from mrbatch.film.filter.strength import strength_of

NEAR = 3.0
"""Standard deviation, in pixels, of the mean that stands in for a pixel that is left alone."""
DEEPEST = 0.999


def load_oidn() -> Any:
    """The module `pyoidn`. Raises ResourceError where it cannot be imported."""
    try:
        import pyoidn
    except (ImportError, OSError) as error:
        raise ResourceError(
            f"the filter `oidn` needs Open Image Denoise, which cannot be loaded: {error}",
            hint="pip install 'mrbatch[denoise]'",
        ) from error
    return pyoidn


def denoise(
    library: Any, signal: Signal, also: tuple[np.ndarray, ...] = (), threads: int = 1
) -> tuple[np.ndarray, ...]:
    """What to add to `signal.value`, then to each of `also` (parts of it, (h, w, 3)).

    (h, w, 3) float64; 0 where the group is 0. `library`: what `load_oidn` gave. The network runs once for
    each array. Raises ResourceError where the library fails.
    """
    taken = signal.group != 0
    whole = taken & (signal.share > 0.5)
    if not whole.any():
        return tuple(np.zeros(signal.value.shape) for _ in range(1 + len(also)))
    length = np.linalg.norm(signal.guide.normal, axis=-1, keepdims=True)
    normal = (signal.guide.normal / np.maximum(length, 1e-20)).astype(np.float32)
    white = np.where(length > 0, np.float32(1), np.float32(0)) * np.ones(3, np.float32)

    def run(light: np.ndarray) -> np.ndarray:
        try:
            clean = library.denoise(
                light.astype(np.float32), albedo=white, normal=normal, hdr=True, clean_aux=True
            )
        except RuntimeError as error:
            raise ResourceError(f"Open Image Denoise failed: {error}") from error
        return clean.astype(np.float64)

    changes = [_change(value, signal.weight, whole, taken, run) for value in (signal.value, *also)]
    surfaces = surfaces_of(signal.group, signal.guide)
    s = strength_of(signal, surfaces, changes[0], 0.0, threads)
    return tuple(mean_kept(s * change, signal.weight, signal.group) for change in changes)


def _change(
    value: np.ndarray, weight: np.ndarray, whole: np.ndarray, taken: np.ndarray, run: Any
) -> np.ndarray:
    """What the network would add to `value`; `whole`, `taken` (h, w): what it sees, what it changes."""
    from scipy.ndimage import gaussian_filter

    def blurred(values: np.ndarray) -> np.ndarray:
        return gaussian_filter(values, (NEAR, NEAR, 0), mode="constant", truncate=3.0)

    there = taken[..., None] & (weight > 0)
    light = np.divide(value, weight, out=np.zeros(value.shape), where=there)
    shift = np.maximum(np.quantile(-light[whole], DEEPEST, axis=0, method="lower"), 0.0)
    solid = there & whole[..., None]
    near, weights = blurred(np.where(solid, value, 0.0)), blurred(np.where(solid, weight, 0.0))
    near = np.divide(near, weights, out=np.zeros(value.shape), where=weights > 1e-6)
    seen = shift + np.where(solid, light, near)
    deeper = np.minimum(seen, 0.0)
    clean = run(seen - deeper) - shift + np.where(solid, deeper, 0.0)
    return np.where(there, clean * weight - value, 0.0)
