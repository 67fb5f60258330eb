"""What lies flat: the table's wood and the printed page with its marker, as reflectance pictures."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

PAPER_WHITE, INK = 0.78, 0.035
"""Linear reflectance."""
PAGE_MM, PAGE_DOTS = (297, 210), 4
"""Width and height of the page, and dots a millimetre."""
MARKER_AT_MM, MARKER_MM, MARKER_ID = (78.0, 120.0), 60, 7
"""Centre of the marker from the page's top left corner."""
TABLE_MM, TABLE_DOTS = (1600, 1200), 1


def _codes(linear: np.ndarray) -> np.ndarray:
    """8-bit sRGB codes of linear values."""
    a = np.clip(linear, 0.0, 1.0)
    curve = np.where(a <= 0.0031308, 12.92 * a, 1.055 * np.power(a, 1 / 2.4) - 0.055)
    return np.round(255.0 * curve).astype(np.uint8)


def write_page(path: Path) -> None:
    """The page: marker, its name, and a ruler to check the print with."""
    width, height = (PAGE_DOTS * n for n in PAGE_MM)
    page = np.full((height, width), PAPER_WHITE)
    side = PAGE_DOTS * MARKER_MM
    cx, cy = (round(PAGE_DOTS * n) for n in MARKER_AT_MM)
    x, y = cx - side // 2, cy - side // 2
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    marker = cv2.aruco.generateImageMarker(dictionary, MARKER_ID, side)
    page[y : y + side, x : x + side] = np.where(marker > 127, PAPER_WHITE, INK)

    ink = np.zeros((height, width), np.uint8)
    font = cv2.FONT_HERSHEY_SIMPLEX
    cv2.putText(
        ink, f"DICT_4X4_50  id {MARKER_ID}  {MARKER_MM} mm", (x, y - 34), font, 0.85, 255, 2, cv2.LINE_AA
    )
    base = y + side + 40
    cv2.line(ink, (x, base), (x + side, base), 255, 2)
    for mark in range(0, MARKER_MM + 1, 5):
        tick = 22 if mark % 10 == 0 else 12
        cv2.line(ink, (x + PAGE_DOTS * mark, base), (x + PAGE_DOTS * mark, base + tick), 255, 2)
    share = ink / 255.0 * 0.8
    page = page * (1.0 - share) + INK * share
    colour = page[..., None] * np.array([1.0, 0.985, 0.955])
    if not cv2.imwrite(str(path), _codes(colour)[..., ::-1]):
        raise OSError(f"cannot write {path}")


def write_table(path: Path) -> None:
    """Oiled oak: staves along x, each with its own tone, grain that bends, and pores."""
    width, height = (TABLE_DOTS * n for n in TABLE_MM)
    rng = np.random.default_rng(20240501)
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    tone, grain = np.zeros((height, width)), np.zeros((height, width))
    seam = np.zeros((height, width))
    stave = 75
    for row in range(height // stave):
        rows = slice(row * stave, (row + 1) * stave)
        start = rng.uniform(300, 900)
        cuts = [0.0, start, start + rng.uniform(550, 900), 2.0 * width]
        for a, b in zip(cuts, cuts[1:]):
            columns = (x[rows] >= a) & (x[rows] < b)
            along, across = x[rows] * 0.0035, (y[rows] - row * stave) * 0.055
            bend, phase = rng.uniform(-1.1, 1.1), rng.uniform(0, 20)
            figure = across + bend * (along - along.mean()) ** 2 * 0.35 + 0.5 * np.sin(1.7 * along + phase)
            rings = 0.5 + 0.5 * np.sin(2 * np.pi * (1.7 * figure + phase) + 1.2 * np.sin(figure * 5.1))
            grain[rows] = np.where(columns, rings**1.6, grain[rows])
            tone[rows] = np.where(columns, rng.uniform(-1.0, 1.0), tone[rows])
            seam[rows] = np.maximum(seam[rows], columns & (x[rows] - a < 1.2) & (a > 0))
        seam[row * stave] = 1.0
    fibres = cv2.GaussianBlur(rng.standard_normal((height, width)), (0, 0), sigmaX=9.0, sigmaY=0.6)
    fibres /= fibres.std()
    clouds = cv2.GaussianBlur(rng.standard_normal((height, width)), (0, 0), sigmaX=60.0, sigmaY=20.0)
    clouds /= clouds.std()
    shade = 1.0 + 0.13 * tone - 0.20 * (grain - 0.45) + 0.055 * fibres + 0.05 * clouds
    shade = np.clip(shade, 0.45, 1.6) * (1.0 - 0.55 * cv2.GaussianBlur(seam, (0, 0), 0.6))
    wood = np.array([0.40, 0.235, 0.118]) * np.power(shade[..., None], [0.9, 1.05, 1.2])
    if not cv2.imwrite(str(path), _codes(wood)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 90]):
        raise OSError(f"cannot write {path}")
