"""The residuals of a calibration as a picture: where corners were seen and how far off they are."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import numpy as np

from mrbatch.capture.marker_video.calibration_fit import CalibrationFit

if TYPE_CHECKING:
    from PIL import ImageDraw

_SIDE = 1100
_BAR = 14
_INK, _GREY, _RED = (20, 20, 20), (200, 200, 200), (200, 40, 30)


def residual_picture(fit: CalibrationFit) -> bytes:
    """PNG: residual vectors over the picture's area, enlarged; below, each view's error in pixels."""
    from PIL import Image, ImageDraw, ImageFont

    scale = _SIDE / max(fit.size)
    width, height = (round(s * scale) for s in fit.size)
    lengths = np.linalg.norm(np.concatenate(fit.residuals), axis=1)
    # Round enlargement: a long residual (95 %) is drawn a thirtieth of the picture long.
    wanted = _SIDE / 30.0 / max(float(np.percentile(lengths, 95)) * scale, 1e-9)
    decade = 10.0 ** np.floor(np.log10(wanted))
    larger = float(decade * max(m for m in (1.0, 2.0, 5.0) if m * decade <= wanted * (1 + 1e-9)))
    top, bars = 34, 200
    image = Image.new("RGB", (max(width, 400), top + height + bars), (255, 255, 255))
    draw = ImageDraw.Draw(image)
    font = ImageFont.load_default(size=16)
    draw.text(
        (8, 8),
        f"{fit.size[0]}x{fit.size[1]}, {len(fit.views)} views, {len(lengths)} corners, rms {fit.rms:.3f} px; "
        f"residuals x {larger:g}",
        fill=_INK,
        font=font,
    )
    draw.rectangle([0, top, width - 1, top + height - 1], outline=_GREY)
    usual = float(np.median(lengths))
    for view, residual in zip(fit.views, fit.residuals):
        for (x, y), (dx, dy) in zip(view.points * scale, residual * scale * larger):
            colour = _RED if np.hypot(dx, dy) > 3.0 * usual * scale * larger else _INK
            draw.line([x, top + y, x + dx, top + y + dy], fill=colour)
            draw.ellipse([x - 1.5, top + y - 1.5, x + 1.5, top + y + 1.5], fill=colour)
    _bars(draw, fit, (8, top + height + 8, image.width - 8, top + height + bars - 8), font)
    stream = io.BytesIO()
    image.save(stream, format="png")
    return stream.getvalue()


def _bars(
    draw: ImageDraw.ImageDraw, fit: CalibrationFit, box: tuple[int, int, int, int], font: object
) -> None:
    """Each view's error, the worst with its name."""
    left, top, right, bottom = box
    errors = fit.view_rms
    most = max(errors)
    base, room = bottom - 22, bottom - 22 - (top + 22)
    step = min(_BAR, (right - left) / len(errors))
    for i, error in enumerate(errors):
        x = left + i * step
        colour = _RED if error > 2.0 * float(np.median(errors)) else _GREY
        draw.rectangle([x, base - room * error / most, x + max(1.0, step - 2), base], fill=colour)
    line = base - room * fit.rms / most
    draw.line([left, line, left + step * len(errors), line], fill=_INK)
    worst = int(np.argmax(errors))
    text = f"rms of each view; the line is all of them; worst: {fit.views[worst].name}, {most:.2f} px"
    draw.text((left, top), text, fill=_INK, font=font)  # type: ignore[arg-type]
    draw.text((left, base + 3), "views in order", fill=_INK, font=font)  # type: ignore[arg-type]
