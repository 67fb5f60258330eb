"""Finding the printed target in a picture: which of its points are seen, and where.

OpenCV's detectors find and decode the markers. Corners of single markers, tags and grids are then
fitted on the whole printed pattern in linear light (`marker_fit`); corners of a chessboard are saddle points,
which the transfer function does not move, and keep OpenCV's subpixel refinement. OpenCV counts
pixel centres at integers: positions move by +1/2 here, once.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mrbatch.capture.marker_video.calibration import Calibration
from mrbatch.capture.marker_video.marker_fit import fit_marker
from mrbatch.capture.marker_video.target_settings import (
    DICTIONARY_SIZES,
    BoardSettings,
    TagPlacement,
    TargetSettings,
)

CORNER_SIGMA = 0.3
"""Standard deviation in pixels of corners that were not fitted (OpenCV's subpixel refinement)."""


@dataclass(frozen=True)
class Detection:
    """What of the target one picture shows.

    `points_2d` (n, 2) pixels, pixel centres at half integers, as in the picture (distortion
    included). `points_3d` (n, 3) metres in the world of the target; for tags without a layout each
    point is in its own tag's frame. `ids` (n,): the marker that a point belongs to, or the corner of a
    ChArUco board. `covariance` (2n, 2n) px^2 of x0 y0 x1 y1 .... `duplicates`: ids seen more than
    once, with the centres of all places. `repaired`: wrong bits that decoding corrected, by id.
    `others`: ids of the same dictionary that are not of the target.
    """

    points_2d: np.ndarray
    points_3d: np.ndarray
    ids: np.ndarray
    covariance: np.ndarray
    duplicates: Mapping[int, tuple[tuple[float, float], ...]] = field(default_factory=dict)
    repaired: Mapping[int, int] = field(default_factory=dict)
    others: tuple[int, ...] = ()

    def __len__(self) -> int:
        return len(self.points_2d)


def srgb_to_linear(codes: np.ndarray) -> np.ndarray:
    """Codes in 0..1 to scene-linear values (IEC 61966-2-1)."""
    return np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)


def marker_corners(side: float) -> np.ndarray:
    """(4, 3) corners in the marker's frame: top left, top right, bottom right, bottom left, metres."""
    h = 0.5 * side
    return np.array([[-h, h, 0.0], [h, h, 0.0], [h, -h, 0.0], [-h, -h, 0.0]])


def placement_matrix(placement: TagPlacement) -> np.ndarray:
    """(4, 4) layout_from_tag: turned about the layout's x, then y, then z axis, then moved."""
    from scipy.spatial.transform import Rotation

    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("xyz", placement.rotation).as_matrix()
    matrix[:3, 3] = placement.position
    return matrix


def board_from_opencv(settings: BoardSettings) -> np.ndarray:
    """(4, 4) our board frame (origin at the centre, y up the page, z out) from OpenCV's.

    OpenCV's origin is the board's top left corner, y runs down the page and z into it, for the
    present and the legacy pattern.
    """
    columns, rows = settings.squares
    if settings.type == "charuco":
        assert settings.square is not None
        width, height = columns * settings.square, rows * settings.square
    else:
        assert settings.separation is not None
        width = columns * settings.marker + (columns - 1) * settings.separation
        height = rows * settings.marker + (rows - 1) * settings.separation
    matrix = np.diag([1.0, -1.0, -1.0, 1.0])
    matrix[:3, 3] = (-0.5 * width, 0.5 * height, 0.0)
    return matrix


def opencv_board(settings: BoardSettings):
    """The board as OpenCV's `CharucoBoard` or `GridBoard`."""
    import cv2

    dictionary = _dictionary(settings.dictionary)
    ids = np.arange(settings.first_id, settings.first_id + settings.marker_count, dtype=np.int32)
    if settings.type == "grid":
        assert settings.separation is not None
        return cv2.aruco.GridBoard(
            settings.squares, settings.marker, settings.separation, dictionary, ids=ids
        )
    assert settings.square is not None
    board = cv2.aruco.CharucoBoard(settings.squares, settings.square, settings.marker, dictionary, ids=ids)
    if settings.legacy:
        board.setLegacyPattern(True)
    return board


_TAG36H11_FIRST = 0xD5D628584
"""Cells of tag 0 of AprilTag's family 36h11, upright, row by row, as its authors print it."""


@functools.cache
def _dictionary(name: str):
    """OpenCV's dictionary, AprilTag families upright as the AprilTag project prints them.

    OpenCV up to 5.0.0 has these families turned by half a circle, later ones as printed.
    """
    import cv2

    entry = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    if not name.startswith("DICT_APRILTAG") or _tags_upright():
        return entry
    turned = [
        cv2.aruco.Dictionary_getByteListFromBits(np.rot90(_bits(entry, k), 2).copy())  # type: ignore[attr-defined]
        for k in range(len(entry.bytesList))
    ]
    return cv2.aruco.Dictionary(np.concatenate(turned), entry.markerSize, entry.maxCorrectionBits)


@functools.cache
def _tags_upright() -> bool:
    import cv2

    bits = _bits(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11), 0)
    return int("".join(map(str, bits.ravel())), 2) == _TAG36H11_FIRST


def _bits(entry: Any, marker: int) -> np.ndarray:
    import cv2

    packed = entry.bytesList[marker : marker + 1]
    return cv2.aruco.Dictionary_getBitsFromByteList(packed, entry.markerSize)  # type: ignore[attr-defined]


def marker_bits(dictionary: str, marker: int) -> np.ndarray:
    """(n, n) bool inner cells of a marker, true for white, seen upright."""
    return _bits(_dictionary(dictionary), marker).astype(bool)


def grey_codes(grey: np.ndarray) -> np.ndarray:
    """8-bit picture for the detectors from codes (uint8, uint16) or linear values (float)."""
    if grey.dtype == np.uint8:
        return np.ascontiguousarray(grey)
    if grey.dtype == np.uint16:
        return np.ascontiguousarray(grey >> 8).astype(np.uint8)
    finite = np.nan_to_num(np.asarray(grey, dtype=np.float64), nan=0.0, posinf=np.inf, neginf=0.0)
    top = np.percentile(finite[np.isfinite(finite)], 99) if np.isfinite(finite).any() else 1.0
    value = np.clip(finite / (top if top > 0 else 1.0), 0.0, 1.0)
    return np.round(255.0 * value ** (1.0 / 2.4)).astype(np.uint8)


def linear_brightness(
    grey: np.ndarray, transfer: Callable[[np.ndarray], np.ndarray] = srgb_to_linear
) -> np.ndarray:
    """Scene-linear brightness (height, width) from codes by their transfer function; floats as they are."""
    if np.issubdtype(grey.dtype, np.integer):
        table = transfer(np.arange(np.iinfo(grey.dtype).max + 1) / np.iinfo(grey.dtype).max)
        return np.asarray(table, dtype=np.float32)[grey]
    return np.nan_to_num(np.asarray(grey, dtype=np.float32))


class TargetDetector:
    """Finds one target in pictures.

    `calibration` lets corners be fitted with the lens distortion in the model. `transfer` turns the
    codes of integer pictures (as 0..1) into linear light; float pictures are taken as linear.
    """

    def __init__(
        self,
        target: TargetSettings,
        calibration: Calibration | None = None,
        *,
        transfer: Callable[[np.ndarray], np.ndarray] = srgb_to_linear,
    ):
        self.target = target
        self.calibration = calibration
        self.transfer = transfer
        self._bits: dict[int, np.ndarray] = {}
        self._board = opencv_board(target.board) if target.board else None
        self._corners = self._known_corners()

    def _known_corners(self) -> dict[int, np.ndarray] | None:
        """World positions (4, 3) of each marker's corners; None where any id may be seen."""
        target = self.target
        if target.marker:
            return {target.marker.id: marker_corners(target.marker.side)}
        if target.board and self._board is not None:
            to_ours = board_from_opencv(target.board)
            points = [np.asarray(p, dtype=np.float64) for p in self._board.getObjPoints()]
            return {
                int(i): p @ to_ours[:3, :3].T + to_ours[:3, 3]
                for i, p in zip(self._board.getIds().ravel(), points, strict=True)
            }
        assert target.tags
        if target.tags.layout is None:
            return None
        corners = marker_corners(target.tags.side)
        placed = {i: placement_matrix(p) for i, p in target.tags.layout.items()}
        if target.tags.origin is not None:
            world_from_layout = np.linalg.inv(placed[target.tags.origin])
            placed = {i: world_from_layout @ m for i, m in placed.items()}
        return {i: corners @ m[:3, :3].T + m[:3, 3] for i, m in placed.items()}

    def _corners_of(self, marker: int) -> np.ndarray:
        if self._corners is not None:
            return self._corners[marker]
        assert self.target.tags
        return marker_corners(self.target.tags.side)

    def detect(self, grey: np.ndarray) -> Detection:
        """The target's points in a picture (height, width): uint8 or uint16 codes, or linear floats."""
        codes = grey_codes(grey)
        found = self._wanted(detect_markers(codes, self.target.dictionary))
        if not found[0]:
            # The AprilTag quad finder sees foreshortened and blurred markers that contours miss.
            found = self._wanted(detect_markers(codes, self.target.dictionary, april=True), found[1])
        markers, others = found
        duplicates = {
            i: tuple((float(q[:, 0].mean()), float(q[:, 1].mean())) for q in quads)
            for i, quads in markers.items()
            if len(quads) > 1
        }
        if self.target.board and self.target.board.type == "charuco":
            corners = self._chess_corners(codes, markers)
            if corners is not None:
                points_2d, points_3d, ids = corners
                covariance = CORNER_SIGMA**2 * np.eye(2 * len(ids))
                return Detection(points_2d, points_3d, ids, covariance, duplicates, {}, others)
        linear = linear_brightness(grey, self.transfer)
        return self._fitted(markers, linear, duplicates, others)

    def _wanted(self, found: list[tuple[int, np.ndarray]], others: tuple[int, ...] = ()):
        markers: dict[int, list[np.ndarray]] = {}
        beside = set(others)
        for i, quad in found:
            if self._corners is None or i in self._corners:
                markers.setdefault(i, []).append(quad)
            else:
                beside.add(i)
        return dict(sorted(markers.items())), tuple(sorted(beside))

    def _chess_corners(self, codes: np.ndarray, markers) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Corners of the ChArUco board, or None where too few or all in one line are seen."""
        import cv2

        if not markers or self._board is None or self.target.board is None:
            return None
        found, ids, _, _ = cv2.aruco.CharucoDetector(self._board).detectBoard(codes)
        if ids is None or len(ids) < 6:
            return None
        ids = np.asarray(ids).ravel()
        to_ours = board_from_opencv(self.target.board)
        points = np.asarray(self._board.getChessboardCorners(), dtype=np.float64)[ids]
        points = points @ to_ours[:3, :3].T + to_ours[:3, 3]
        if np.linalg.matrix_rank(points[:, :2] - points[0, :2], tol=1e-6) < 2:
            return None
        return np.asarray(found, dtype=np.float64).reshape(-1, 2) + 0.5, points, ids

    def _fitted(self, markers, linear: np.ndarray, duplicates, others) -> Detection:
        """Corners of separate markers, fitted on their patterns."""
        from scipy.linalg import block_diag

        points_2d, points_3d, ids, blocks, repaired = [], [], [], [], {}
        for i, quads in markers.items():
            quad, block = quads[0], CORNER_SIGMA**2 * np.eye(8)
            if i not in self._bits:
                self._bits[i] = marker_bits(self.target.dictionary, i)
            fit = fit_marker(linear, quad, self._bits[i], self.calibration)
            if fit is not None:
                quad, block = fit.corners, fit.covariance
                if fit.wrong_bits:
                    repaired[i] = fit.wrong_bits
            points_2d.append(quad)
            blocks.append(block)
            points_3d.append(self._corners_of(i))
            ids.append(np.full(4, i))
        if not points_2d:
            empty = np.zeros((0, 2)), np.zeros((0, 3)), np.zeros(0, dtype=int), np.zeros((0, 0))
            return Detection(*empty, duplicates, repaired, others)
        return Detection(
            np.concatenate(points_2d),
            np.concatenate(points_3d),
            np.concatenate(ids),
            block_diag(*blocks),
            duplicates,
            repaired,
            others,
        )


def detect_markers(
    codes: np.ndarray, dictionary: str, *, april: bool = False
) -> list[tuple[int, np.ndarray]]:
    """All markers of a dictionary in an 8-bit picture: id and corners (4, 2), pixel centres at half integers.

    `april` takes the AprilTag quad finder, whose corners already count pixel centres at half integers
    (measured: 0.45 px right and below the other methods').
    """
    import cv2

    parameters = cv2.aruco.DetectorParameters()
    method = cv2.aruco.CORNER_REFINE_APRILTAG if april else cv2.aruco.CORNER_REFINE_SUBPIX
    parameters.cornerRefinementMethod = method
    corners, ids, _ = cv2.aruco.ArucoDetector(_dictionary(dictionary), parameters).detectMarkers(codes)
    if ids is None:
        return []
    shift = 0.0 if april else 0.5
    quads = [np.asarray(c, dtype=np.float64).reshape(4, 2) + shift for c in corners]
    return list(zip((int(i) for i in np.ravel(ids)), quads, strict=True))


def other_dictionaries(pictures: Iterable[np.ndarray], dictionary: str) -> dict[str, tuple[int, ...]]:
    """Other dictionaries that see markers in these pictures: name to ids, the likeliest first.

    Of the dictionaries with equal cells (4X4_50, 4X4_100, ...) the smallest is named.
    DICT_APRILTAG_16h5 comes last: it has so few bits that it sees markers anywhere.
    """
    pictures = [grey_codes(p) for p in pictures]
    seen: dict[str, dict[int, int]] = {}
    for name in DICTIONARY_SIZES:
        cells = name.rsplit("_", 1)[0]
        if name == dictionary or any(other.rsplit("_", 1)[0] == cells and "X" in cells for other in seen):
            continue
        counts: dict[int, int] = {}
        for codes in pictures:
            for i, _ in detect_markers(codes, name):
                counts[i] = counts.get(i, 0) + 1
        if counts:
            seen[name] = counts
    order = sorted(seen, key=lambda name: (name == "DICT_APRILTAG_16h5", -sum(seen[name].values())))
    return {name: tuple(sorted(seen[name])) for name in order}
