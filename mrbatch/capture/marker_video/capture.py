"""The marker video as a capture: once a shot its table, then frames, one at a time.

The table holds all that was found out (how codes are read, when frames are shown, poses, gains), so
that a frame is a pure function of settings, number and table on any machine.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from mrbatch.capture.frame import CaptureFacts, FrameData, ViewData, ViewGeometry
from mrbatch.capture.marker_video.calibration import Calibration, load_calibration, make_calibration
from mrbatch.capture.marker_video.footage import Footage, open_footage
from mrbatch.capture.marker_video.gain import Gain, load_gains, patch_gain
from mrbatch.capture.marker_video.lens_limit import rayless_share
from mrbatch.capture.marker_video.matte import Mattes
from mrbatch.capture.marker_video.settings import CameraSettings, MarkerVideoSettings
from mrbatch.capture.marker_video.shot_poses import SolvePoses, check_size, find_poses
from mrbatch.capture.marker_video.told import smoothing_notes
from mrbatch.contracts import Progress
from mrbatch.errors import InputError, Place
from mrbatch.scene.camera import Camera

VIEW = ""
"""Name of the one view of a mono capture."""


def read_calibration(settings: CameraSettings) -> Calibration:
    """The camera's intrinsics from file or settings. Raises InputError."""
    if settings.file is not None:
        return load_calibration(settings.file, section=settings.section, pixel_centres=settings.pixel_centres)
    return make_calibration(
        settings.matrix,
        settings.distortion,
        settings.width,
        settings.height,
        pixel_centres=settings.pixel_centres or "integer",
        source="capture.camera",
    )


def no_progress(step: str, done: int, total: int, detail: str = "") -> None:
    """For those who do not listen."""


class MarkerVideoCapture:
    """A marker video; see `mrbatch.contracts.Capture`.

    `folder`: what relative paths in the settings count from. `solve`: stands in for `solve_poses`.
    """

    def __init__(self, settings: MarkerVideoSettings, folder: Path, *, solve: SolvePoses | None = None):
        self.settings = _absolute(settings, Path(folder))
        self._solve = solve
        self._footage: Footage | None = None
        self._mattes = Mattes(self.settings.mattes) if self.settings.mattes is not None else None
        self._posed: tuple[int, ...] | None = None

    def close(self) -> None:
        """Lets go of open files."""
        if self._footage is not None:
            self._footage.close()

    def _opened(self, table: Mapping[str, Any] | None = None) -> Footage:
        if self._footage is None:
            self._footage = open_footage(self.settings, table["footage"] if table else None)
        return self._footage

    def _chosen(self) -> tuple[int, ...]:
        """Numbers of the frames that the job's subset leaves."""
        subset, footage = self.settings.subset, self._opened()
        numbers = []
        for number in footage.numbers:
            time = float(footage.time(number))  # as exact as the limits, which are floats
            if (
                (subset.first is None or number >= subset.first)
                and (subset.last is None or number <= subset.last)
                and (subset.from_time is None or time >= subset.from_time)
                and (subset.to_time is None or time < subset.to_time)
            ):
                numbers.append(number)
        numbers = [n for n in numbers if (n - numbers[0]) % subset.step == 0]
        if not numbers:
            every = footage.numbers
            raise InputError(
                f"`capture.subset` leaves no frame of {every[0]} to {every[-1]}",
                place=Place(file=str(self.settings.frames[0])),
            )
        return tuple(numbers)

    def frame_numbers(self) -> Sequence[int]:
        """All frames of the subset; after `prepare`, without those that have no pose (`lost: skip`)."""
        return self._posed if self._posed is not None else self._chosen()

    def announced_numbers(self) -> Sequence[int]:
        """All frames of the subset, gaps of a sequence and the cut end of a video included."""
        chosen = self._chosen()
        return sorted({*chosen, *self._missing(self._opened(), chosen)})

    def inputs(self) -> Sequence[Path]:
        settings, numbers = self.settings, tuple(self._chosen())
        paths = self._opened().paths(numbers)
        patch = settings.gain.patch
        if patch is not None and patch.frame not in numbers and patch.frame in self._opened().numbers:
            paths += self._opened().paths((patch.frame,))
        for path in (settings.camera.file, settings.poses, settings.gain.file):
            if path is not None:
                paths.append(path)
        if self._mattes is not None:
            paths += [self._mattes.path(n) for n in numbers if n in self._mattes.sequence.numbers]
        return paths

    def prepare(self, progress: Progress = no_progress) -> Mapping[str, Any]:
        """Sees the shot once. Raises InputError: what no frame can be rendered without.

        Keys: `frames` (numbers with a pose, and broken ones), `times` (s, float, one for each),
        `footage` (how it is read), `camera`, `poses` (world_from_camera by number), `gains`, `flags`,
        `broken` (why a frame that is there cannot be used, by number), `missing`, `skipped` (numbers),
        `absent` (why these two are not rendered, by number), `pose_report` (each frame's `other_root` in the
        world, too), `notes`, `frame_rate`.
        """
        footage, numbers = self._opened(), self._chosen()
        about = footage.describe()
        calibration = read_calibration(self.settings.camera)
        width, height = about["width"], about["height"]
        calibration.check_size(width, height, Place(file=str(footage.paths(numbers[:1])[0])))
        unmatted = self._mattes.lacking(numbers) if self._mattes is not None else []
        notes = list(about["notes"])
        rayless = rayless_share(calibration.matrix, calibration.distortion, (width, height))
        if rayless > 0.0:
            notes.append(
                f"the calibration's lens folds back within the picture: {100 * rayless:.2g} % of the pixels, "
                "towards the corners, show nothing virtual and no shadow; calibrate with fewer coefficients"
            )
        missing = self._missing(footage, numbers)
        if missing:
            notes.append(f"missing in the footage: {_listed(missing)}")
        broken: dict[int, str] = {}
        rows, report = find_poses(
            self.settings, footage, numbers, about, calibration, broken, progress, solve=self._solve
        )
        place_marker = self.settings.world_from_marker.array()
        poses, flags = {}, {}
        for row in rows:
            if row.world_from_camera is not None:
                poses[row.number] = (place_marker @ row.world_from_camera).tolist()
            if row.flags:
                flags[row.number] = [f"pose-{flag}" for flag in row.flags]
            if row.fault:
                broken[row.number] = row.fault
        for number in unmatted:
            broken.setdefault(number, "the frame has no matte")
        skipped = [n for n in numbers if n not in poses and n not in broken]
        frames = [n for n in numbers if n in poses or n in broken]
        gains = self._gains(footage, frames, about, broken)
        if not poses:
            raise InputError("no frame has a pose", place=Place(frame=numbers[0]))
        if skipped:
            notes.append(f"without a pose, so left out: {_listed(skipped)}")
        if broken:
            notes.append(f"cannot be used: {_listed(sorted(broken))}")
        if report["source"] == "target":
            seen = sum(row.points > 0 for row in rows)
            notes.append(
                f"the target is seen in {seen} of {len(numbers)} frames, "
                f"median reprojection error {report['median_rms_px']:.2f} px"
            )
        if "smoothing" in report:
            notes += smoothing_notes(report["smoothing"])
        absent = {n: "the footage has no such frame" for n in missing}
        absent |= {n: "the frame has no camera pose: the target was not found in it" for n in skipped}
        self._posed = tuple(frames)
        return {
            "kind": "marker-video",
            "frames": frames,
            "times": [float(footage.time(n)) for n in frames],
            "frame_rate": None if footage.rate is None else str(footage.rate),
            "footage": about,
            "camera": {
                "width": width,
                "height": height,
                "matrix": calibration.matrix.tolist(),
                "distortion": calibration.distortion.tolist(),
            },
            "poses": {str(n): pose for n, pose in poses.items()},
            "gains": {str(n): list(gain) for n, gain in gains.items()},
            "flags": {str(n): words for n, words in flags.items()},
            "broken": {str(n): message for n, message in broken.items()},
            "missing": missing,
            "skipped": skipped,
            "absent": {str(n): absent[n] for n in sorted(absent)},
            "pose_report": report,
            "notes": notes,
        }

    def _missing(self, footage: Footage, numbers: tuple[int, ...]) -> list[int]:
        """Frames of the subset that the footage should have and has not."""
        subset = self.settings.subset
        found = []
        for n in footage.missing:
            if n < numbers[0] or (subset.last is not None and n > subset.last):
                continue
            if subset.to_time is not None and float(footage.time(n)) >= subset.to_time:
                continue
            if (n - numbers[0]) % subset.step == 0:
                found.append(n)
        return found

    def _gains(
        self, footage: Footage, frames: Sequence[int], about: Mapping[str, Any], broken: dict[int, str]
    ) -> dict[int, Gain]:
        """By frame number; a frame that a file leaves out goes to `broken`. Raises InputError."""
        gain = self.settings.gain
        if gain.file is not None:
            given = load_gains(gain.file)
            lacking = [n for n in frames if n not in given]
            if len(lacking) == len(frames):
                raise InputError(
                    f"none of the {len(lacking)} frames has a gain, from {lacking[0]} to {lacking[-1]}",
                    place=Place(file=str(gain.file), frame=lacking[0]),
                    hint=f"the file has gains of {min(given)} to {max(given)}",
                )
            for number in lacking:
                broken.setdefault(number, f"the frame has no gain in {gain.file.name}")
            return {n: given[n] for n in frames if n in given}
        if gain.patch is not None:
            number = gain.patch.frame
            if number not in footage.numbers:
                raise InputError("`gain.patch` names a frame that is not there", place=Place(frame=number))
            place = Place(file=str(footage.paths((number,))[0]), frame=number)
            picture = footage.picture(number, about)
            ceiling = None if about["float"] else _ceiling(about["colour"])
            value = patch_gain(picture, gain.patch, place, ceiling=ceiling)
        else:
            assert gain.value is not None
            value = gain.value
        return {n: value for n in frames}

    def facts(self, table: Mapping[str, Any]) -> CaptureFacts:
        colour = table["footage"]["colour"]
        rate = table["frame_rate"]
        return CaptureFacts(
            source_bits=int(colour["bits"]),
            source_is_float=bool(table["footage"]["float"]),
            transfer=colour["transfer"],
            frame_rate=None if rate is None else Fraction(rate),
            notes=tuple(table["notes"]),
        )

    def geometry(self, number: int, table: Mapping[str, Any]) -> Mapping[str, ViewGeometry]:
        """Camera and gain of a frame. Raises InputError for a frame that has no pose."""
        key = str(number)
        if key in table["broken"]:
            raise InputError(
                table["broken"][key], place=Place(file=str(self.settings.frames[0]), frame=number)
            )
        if key not in table["poses"]:
            raise InputError(
                "the frame has no camera pose",
                place=Place(file=str(self.settings.frames[0]), frame=number),
                hint="see `capture.lost` and the notes of the shot",
            )
        about = table["camera"]
        camera = Camera(
            about["width"],
            about["height"],
            np.array(about["matrix"], dtype=np.float64),
            np.array(about["distortion"], dtype=np.float64),
            np.array(table["poses"][key], dtype=np.float64),
        )
        return {VIEW: ViewGeometry(camera, np.array(table["gains"][key], dtype=np.float64))}

    def frame(self, number: int, table: Mapping[str, Any]) -> FrameData:
        """Raises InputError with the frame: unreadable picture or matte, another size, no pose."""
        view = self.geometry(number, table)[VIEW]
        footage, about = self._opened(table), table["footage"]
        picture = footage.picture(number, about)
        check_size(picture.linear, about, footage.paths((number,))[0], number)
        matte = None
        if self._mattes is not None:
            matte = self._mattes.read(number, about["width"], about["height"])
        data = ViewData(view.camera, picture.linear, view.gain, matte, picture.codes)
        flags = (*table["flags"].get(str(number), ()), *picture.flags)
        return FrameData(number, table["times"][table["frames"].index(number)], {VIEW: data}, flags)


def _listed(numbers: Sequence[int]) -> str:
    """`1 frame (7)`, `3 frames (7, 8, 9)`; of many the first twenty."""
    shown = ", ".join(map(str, numbers[:20])) + (", ..." if len(numbers) > 20 else "")
    return f"{len(numbers)} frame{'s' if len(numbers) > 1 else ''} ({shown})"


def _ceiling(colour: Mapping[str, Any]) -> float:
    """Linear value of the highest code: what clipped pixels have, before primaries are converted."""
    from mrbatch.kernels.transfer import decode_table

    return float(np.float32(decode_table(colour["transfer"], 8)[-1])) * (1.0 - 1e-3)


def _absolute(value: Any, folder: Path) -> Any:
    """Settings with relative paths counted from `folder`."""
    from pydantic import BaseModel

    if isinstance(value, Path):
        return value if value.is_absolute() else folder / value
    if isinstance(value, BaseModel):
        update = {name: _absolute(getattr(value, name), folder) for name in type(value).model_fields}
        return value.model_copy(update=update)
    if isinstance(value, tuple):
        return tuple(_absolute(item, folder) for item in value)
    return value
