"""The camera's intrinsics from a calibration file.

Read are OpenCV's FileStorage (YAML, XML, JSON), plain YAML and JSON (also ROS camera_info and
RealSense's key names), NPZ and NPY. Known names of keys are listed in `MATRIX_KEYS`,
`DISTORTION_KEYS` and `SIZE_KEYS`. OpenCV puts pixel centres at integers, this program at half
integers: the principal point moves by +1/2 here, once, unless the file says `pixel_centres: half`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from mrbatch.capture.marker_video.calibration_file import read_calibration_file
from mrbatch.document import shorten
from mrbatch.errors import InputError, Place
from mrbatch.scene.camera import Camera

MATRIX_KEYS: tuple[str, ...] = (
    *("camera_matrix", "K", "cameraMatrix", "Camera_Matrix", "CameraMatrix", "camera_mat"),
    *("matrix", "mtx", "intrinsic_matrix", "intrinsics", "M", "cam_mtx"),
)
DISTORTION_KEYS: tuple[str, ...] = (
    *("distortion_coefficients", "Distortion_Coefficients", "dist", "dist_coeffs", "distCoeffs"),
    *("distortion", "D", "dist_coefs", "distortion_coefs", "distCoeff", "dist_coef", "coeffs"),
    "DistCoeffs",
)
SIZE_KEYS = ("image_size", "imageSize", "resolution", "size", "img_size")
WIDTH_KEYS = ("image_width", "width", "Image_Width", "imageWidth", "image_Width")
HEIGHT_KEYS = ("image_height", "height", "Image_Height", "imageHeight", "image_Height")
MAX_PIXELS = 1e9
"""Sizes, focal lengths and principal points beyond this are no camera's."""
_MODEL_KEYS = ("distortion_model", "model", "camera_model", "calibration_model")
_SUPPORTED_MODELS = {"plumb_bob", "rational_polynomial", "brown_conrady", "opencv", "opencv5", "opencv8"}
_SUPPORTED_MODELS |= {"pinhole", "perspective", "radtan", "none", ""}

PixelCentres = Literal["integer", "half"]


@dataclass(frozen=True)
class Calibration:
    """Intrinsics of a camera.

    `width`, `height`: size in pixels of the pictures it is for, None where the file does not say.
    `matrix` (3, 3) float64: focal lengths and principal point in pixels, pixel centres at HALF
    integers, as in `Camera`. `distortion` (8,) float64: OpenCV's k1 k2 p1 p2 k3 k4 k5 k6.
    `source`: the file.
    """

    width: int | None
    height: int | None
    matrix: np.ndarray
    distortion: np.ndarray
    source: str = ""

    def opencv_matrix(self) -> np.ndarray:
        """(3, 3) `matrix` with pixel centres at integers, as OpenCV's functions want it."""
        matrix = self.matrix.copy()
        matrix[:2, 2] -= 0.5
        return matrix

    def check_size(self, width: int, height: int, place: Place | None = None) -> None:
        """Raises InputError where pictures have another size than the calibration is for."""
        if self.width is not None and (self.width, self.height) != (width, height):
            raise InputError(
                f"the picture is {width}x{height} but the calibration {self.source} is for "
                f"{self.width}x{self.height}",
                place=place,
                hint="calibrate at the size that was filmed, or scale the calibration file",
            )

    def camera(self, world_from_camera: np.ndarray, width: int, height: int) -> Camera:
        """A `Camera` at a pose (4, 4), for pictures of this size. Raises InputError for another size."""
        self.check_size(width, height)
        return Camera(
            width, height, self.matrix, self.distortion, np.array(world_from_camera, dtype=np.float64)
        )


def _numbers(value: Any) -> np.ndarray | None:
    """Float64 array of what a file or a job holds, or None where it holds no numbers."""
    try:
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return None


def make_calibration(
    matrix: Any,
    distortion: Any = None,
    width: int | None = None,
    height: int | None = None,
    *,
    pixel_centres: PixelCentres = "integer",
    source: str = "",
) -> Calibration:
    """A checked `Calibration`. Raises InputError for intrinsics that no camera has.

    `matrix` (3, 3) or 9 numbers, `distortion` 0, 4, 5 or 8 numbers in OpenCV's order (12 and 14 are
    taken where thin prism and tilt are zero).
    """
    place = Place(file=source) if source else None
    k = _numbers(matrix)
    d = np.zeros(0) if distortion is None else _numbers(distortion)
    if k is None or d is None:
        raise InputError("the intrinsics are not numbers", place=place)
    d = d.ravel()
    if k.size != 9:
        raise InputError(f"the camera matrix has shape {k.shape}, expected 3 x 3", place=place)
    k = k.reshape(3, 3)
    if not np.all(np.isfinite(k)) or not np.all(np.isfinite(d)):
        raise InputError("the intrinsics hold NaN or infinity", place=place, hint="calibrate again")
    if np.abs(k).max() > MAX_PIXELS or (d.size and np.abs(d).max() > MAX_PIXELS):
        raise InputError(f"the intrinsics reach beyond {MAX_PIXELS:g}", place=place)
    if k[0, 0] <= 0 or k[1, 1] <= 0:
        if k[0, 0] == 0 or k[1, 1] == 0:
            raise InputError("the camera matrix is singular: a focal length is 0", place=place)
        raise InputError(f"the focal lengths {k[0, 0]:g} and {k[1, 1]:g} are not both positive", place=place)
    if not np.allclose(k[2], [0, 0, 1], rtol=0, atol=1e-9) or k[1, 0] != 0:
        singular = abs(np.linalg.det(k / np.abs(k).max())) < 1e-15
        raise InputError(
            "the camera matrix is singular"
            if singular
            else "the camera matrix is not of the form [fx 0 cx; 0 fy cy; 0 0 1]",
            place=place,
            hint="give the intrinsic matrix, not a projection or its transpose",
        )
    if abs(k[0, 1]) > 1e-9 * k[0, 0]:
        raise InputError(f"the camera matrix has skew {k[0, 1]:g}, which is not supported", place=place)
    if d.size > 8 and np.any(d[8:12]):
        raise InputError(
            f"thin prism distortion ({d.size} coefficients) is not supported",
            place=place,
            hint="calibrate with the rational model (8 coefficients)",
        )
    if d.size > 12 and np.any(d[12:]):
        raise InputError(
            f"tilted sensor distortion ({d.size} coefficients) is not supported",
            place=place,
            hint="calibrate with the rational model (8 coefficients)",
        )
    if d.size not in (0, 4, 5, 8, 12, 14):
        raise InputError(
            f"{d.size} distortion coefficients are not supported: expected 0, 4, 5 or 8",
            place=place,
            hint="OpenCV's order is k1 k2 p1 p2 k3 k4 k5 k6",
        )
    for name, value in (("width", width), ("height", height)):
        if value is not None and value <= 0:
            raise InputError(f"the image's {name} is {value}, expected a positive number", place=place)
    if (width is None) != (height is None):
        raise InputError("the image's width and height must be given together", place=place)
    camera = Camera.from_opencv(0, 0, k, d, np.eye(4), pixel_centres=pixel_centres)
    return Calibration(width, height, camera.matrix, camera.distortion, source)


def load_calibration(
    path: str | Path, *, section: str | None = None, pixel_centres: PixelCentres | None = None
) -> Calibration:
    """Intrinsics from a file.

    `section`: name of the part of a file that holds several calibrations. `pixel_centres`: where the
    file's own word is missing or wrong (`integer` is OpenCV's convention and the default).
    Raises InputError: unreadable file, missing keys, impossible intrinsics, unsupported distortion.
    """
    path = Path(path)
    place = Place(file=str(path))
    if not path.is_file():
        raise InputError("the calibration file does not exist", place=place)
    content = read_calibration_file(path)
    if section is not None:
        if not isinstance(content.get(section), Mapping):
            raise InputError(
                f"there is no section `{section}`", place=place, hint=f"the file has {_names(content)}"
            )
        content = content[section]
    elif not _has_matrix(content):
        parts = [name for name, part in content.items() if isinstance(part, Mapping) and _has_matrix(part)]
        if len(parts) > 1:
            raise InputError(
                f"the file holds {len(parts)} calibrations: {shorten(', '.join(parts), 200)}",
                place=place,
                hint="name one of them as `section`",
            )
        if parts:
            content = content[parts[0]]
    return _from_mapping(content, str(path), pixel_centres)


def _has_matrix(content: Mapping[str, Any]) -> bool:
    if any(key in content for key in ("fx", "fy")):
        return True
    return any(key in content and not (key == "matrix" and _is_pose(content[key])) for key in MATRIX_KEYS)


def _is_pose(value: Any) -> bool:
    numbers = None if isinstance(value, Mapping) else _numbers(value)
    return numbers is not None and numbers.size == 16


def _names(content: Mapping[str, Any]) -> str:
    return shorten(", ".join(str(key) for key in content), 200) or "no keys"


def _first(content: Mapping[str, Any], keys: tuple[str, ...]) -> Any:
    for key in keys:
        if key in content and content[key] is not None:
            value = content[key]
            # FileStorage and ROS wrap matrices: {rows, cols, data}
            return value["data"] if isinstance(value, Mapping) and "data" in value else value
    return None


def _from_mapping(content: Mapping[str, Any], source: str, centres: PixelCentres | None) -> Calibration:
    place = Place(file=source)
    distortion = _first(content, DISTORTION_KEYS)
    _check_model(content, distortion, place)
    matrix = _first(content, MATRIX_KEYS)
    if isinstance(matrix, Mapping):
        content, matrix = {**content, **matrix}, None
    if matrix is None:
        ppx, ppy = content.get("cx", content.get("ppx")), content.get("cy", content.get("ppy"))
        if content.get("fx") is None or content.get("fy") is None or ppx is None or ppy is None:
            raise InputError(
                "no camera matrix found",
                place=place,
                hint=f"the file has {_names(content)}; expected `camera_matrix` or fx, fy, cx, cy",
            )
        matrix = [[content["fx"], 0, ppx], [0, content["fy"], ppy], [0, 0, 1]]
    width, height = _first(content, WIDTH_KEYS), _first(content, HEIGHT_KEYS)
    size = _first(content, SIZE_KEYS)
    if width is None and height is None and size is not None:
        both = _numbers(size)
        if both is not None and both.size == 2:
            width, height = both.ravel().tolist()
    said = content.get("pixel_centres", "integer")
    if said not in ("integer", "half"):
        raise InputError(f"`pixel_centres` is `{shorten(said)}`, expected integer or half", place=place)
    pixels = [None if value is None else _pixels(value, place) for value in (width, height)]
    return make_calibration(
        matrix,
        distortion,
        pixels[0],
        pixels[1],
        pixel_centres=centres or ("half" if said == "half" else "integer"),
        source=source,
    )


def _pixels(value: Any, place: Place) -> int:
    """A number of pixels: alone, or the first of an array as MATLAB and FileStorage write it."""
    numbers = _numbers(value)
    if numbers is None or numbers.size == 0 or not np.abs(numbers.ravel()[0]) <= MAX_PIXELS:
        raise InputError("the image's width and height are not numbers", place=place)
    return int(numbers.ravel()[0])


def _check_model(content: Mapping[str, Any], distortion: Any, place: Place) -> None:
    """Refuses lens models whose coefficients mean something else."""
    if content.get("fisheye") or "xi" in content:
        raise InputError(
            "fisheye and omnidirectional lens models are not supported",
            place=place,
            hint="undistort the pictures to a perspective view first",
        )
    for key in _MODEL_KEYS:
        model = content.get(key)
        if model is None or isinstance(model, Mapping):
            continue
        name = str(model).lower().replace("distortion.", "").strip()
        coefficients = None if distortion is None else _numbers(distortion)
        harmless = coefficients is not None and not np.any(coefficients)
        if name not in _SUPPORTED_MODELS and not (harmless and name == "inverse_brown_conrady"):
            raise InputError(
                f"the lens model `{shorten(model)}` is not supported",
                place=place,
                hint="supported: OpenCV's 4, 5 or 8 coefficients (plumb_bob, rational_polynomial)",
            )
