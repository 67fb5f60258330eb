"""Hard cases of what is stored (IO): light beyond half floats, values that are none, code values, layers."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mrbatch.contracts import Case, Measurement
from mrbatch.errors import FramesError
from mrbatch.film import layers
from mrbatch.film.composite import composite
from mrbatch.film.exr import FrameImage, ViewImage, read_frame, write_frame
from mrbatch.kernels.transfer import TRANSFERS, from_linear, to_linear
from mrbatch.metrics.judging import none, same_bits, together, within

BITS = (8, 10, 12, 16)


def lit(value: float, channel: str = "R", colour_type: str = "half") -> FrameImage:
    """A small black frame with one value at column 3, row 2."""
    channels = layers.empty(None, 4, 5)
    channels[channel][2, 3] = value
    return FrameImage(12, {"": ViewImage(channels)}, (5, 4), colour_type=colour_type)  # type: ignore[arg-type]


def refusal(path: Path, image: FrameImage, words: Sequence[str]) -> Measurement:
    """Whether writing the frame is refused with all these words, and leaves no file."""
    try:
        write_frame(path, image)
    except FramesError as error:
        told = str(error)
    else:
        told = "written"
    missing = [word for word in words if word not in told]
    fine = not missing and not path.exists()
    return Measurement(fine, "refused, named" if fine else told, "refused, named", "exact")


def beyond_half(seed: int) -> Measurement:
    """IO-01: light above 65504 is refused by its pixel, cut with a note where that was asked for, or kept as
    float; never infinite."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "frame.exr"
        refused = refusal(path, lit(69120.0), ("69120", "(3, 2)"))
        write_frame(path, lit(-69120.0, "delta.G"), overflow="clamp")
        cut = read_frame(path)
        write_frame(path, lit(65519.0))
        rounded = read_frame(path).views[""].channels["R"][2, 3]
        write_frame(path, lit(69120.0, colour_type="float"))
        kept = read_frame(path).views[""].channels["R"][2, 3]
    stored = [cut.views[""].channels["delta.G"][2, 3], rounded, kept]
    return together(
        refused,
        within(stored, [-65504.0, 65504.0, 69120.0], 0.0, what="stored"),
        none(cut.metadata.get("clamped") != {"delta.G": 1}, "cuts without a note"),
    )


def no_numbers(seed: int) -> Measurement:
    """IO-02: NaN and infinity are never written: refused by frame, channel and pixel."""
    words = ("frame 12", "delta.R", "(3, 2)")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "frame.exr"
        return together(*(refusal(path, lit(v, "delta.R"), words) for v in (np.nan, np.inf, -np.inf)))


def codes(seed: int) -> Measurement:
    """IO-03: every code of every curve comes back from linear light, and light rises with the code; those of
    8 and 10 bits survive half floats (but for the darkest of a gamma of 2.8)."""
    judged = []
    for name in TRANSFERS:
        for bits in BITS:
            given = np.arange(2**bits, dtype=np.uint8 if bits == 8 else np.uint16)
            linear = to_linear(given, name, bits)
            judged += [
                same_bits(from_linear(linear, name, bits), given),
                none(np.diff(linear.astype(np.float64)) <= 0, "codes that are not brighter than the last"),
            ]
            if bits <= 10 and name != "gamma28":
                stored = linear.astype(np.float16).astype(np.float32)
                judged.append(within(from_linear(stored, name, bits), given, 0, what="codes by half floats"))
    return together(*judged)


def random_parts(seed: int, height: int, width: int, exponent: float) -> dict[str, np.ndarray]:
    """Random P, a, B, D with fractional edges over many orders of magnitude, in float64."""
    random = np.random.default_rng(seed)
    a = np.clip(random.uniform(-0.5, 1.5, (height, width)), 0, 1)
    shape = (height, width, 3)
    level = 10.0 ** random.uniform(-exponent, exponent, shape)
    P = random.uniform(0, 1, shape) * level * a[..., None]
    B = random.uniform(0, 1, shape) * level
    D = random.normal(0, 0.5, shape) * level * (1 - a[..., None])
    return {"P": P, "a": a, "B": B, "D": D}


def stored_layers(seed: int) -> dict[str, np.ndarray]:
    """Layers of 64 x 64 such parts as half floats hold them, in float64; `a` beside them unrounded."""
    parts = random_parts(seed, 64, 64, 4.0)
    return {n: v.astype(np.float16).astype(np.float64) for n, v in layers.channels(None, parts).items()}


def colour(stored: dict[str, np.ndarray], prefix: str) -> np.ndarray:
    """(h, w, 3) of a layer by the prefix of its channels."""
    return np.stack([stored[f"{prefix}{c}"] for c in "RGB"], axis=-1)


def layers_make_the_whole(seed: int) -> Measurement:
    """IO-04: max(0, virtual over background + delta) is the composite within 2^-10 (|P| + |B| + |D|).

    Each stored number is off by at most 2^-11 of itself, so P + (1 - a) B + D by at most
    2^-11 (|P| + (1 - a) |B| + a |B| + |D|); the composite's own rounding, 2^-11 |C|, brings it to the
    bound at most. What is below half's normal range is off by 2^-25 at most, five numbers take part.
    """
    stored = stored_layers(seed)
    P, B, D, C = (colour(stored, prefix) for prefix in ("virtual.", "background.", "delta.", ""))
    again = np.maximum(0, P + (1 - stored["virtual.A"][..., None]) * B + D)
    fractional = (stored["virtual.A"] > 0) & (stored["virtual.A"] < 1)
    few = fractional.sum() < 1000 or (D < 0).sum() < 1000 or (C == 0).sum() < 100
    return together(
        within(again, C, 2.0**-10 * (np.abs(P) + np.abs(B) + np.abs(D)) + 5 * 2.0**-25, what="composite"),
        none(few, "pictures without edges, shadows or black"),
    )


def step_wedge(seed: int) -> Measurement:
    """TRAP-3d: half of the light of each 8-bit step taken leaves half of its light, to half a code."""
    given = np.repeat(np.arange(256, dtype=np.uint8)[None, :, None], 3, axis=2)
    linear = to_linear(given, "srgb", 8)
    nothing = np.zeros_like(linear)
    found = from_linear(composite(nothing, nothing[..., 0], linear, -0.5 * linear), "srgb", 8)
    v = given / 255.0
    light = np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4) / 2
    wanted = 255 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return within(found, wanted, 0.5 + 1e-3, what="codes")


CASES: tuple[Case, ...] = (
    Case(
        "IO-01",
        "light beyond half floats is never infinite",
        beyond_half,
        setup="69120 in a frame of half floats, refused, cut or as float",
    ),
    Case("IO-02", "what is no number is not written", no_numbers, setup="NaN and infinities in a layer"),
    Case("IO-03", "codes come back from light", codes, setup="8, 10, 12, 16 bits, every curve, every code"),
    Case(
        "IO-04",
        "the layers give the composite",
        layers_make_the_whole,
        setup="64 x 64 pixels with fractional edges over eight decades, half floats",
    ),
    Case("TRAP-3d", "a change is added to light, not to codes", step_wedge, setup="256 steps, half a shadow"),
)
