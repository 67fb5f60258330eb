"""How a frame is exposed: the lens of its cameras, and the moments at which it is looked at.

A moment's camera lies on the way from the frame's pose to its neighbour's, in turning and in place, at an
even speed. A neighbour is the next frame that the shot should have; one that has no pose, or lies behind a
cut, is none, and the way from the other side goes on at its speed. With no neighbour the camera stands still,
and the frame says so.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np

from mrbatch.capture.frame import ViewGeometry
from mrbatch.contracts import Capture
from mrbatch.effects.facts import FrameFacts
from mrbatch.errors import InputError, JobError, Place
from mrbatch.film.outputs import ViewInput
from mrbatch.film.rendering import Look
from mrbatch.job.model import Job
from mrbatch.scene.camera import Camera
from mrbatch.scene.camera_settings import LensSettings, ShutterSettings
from mrbatch.scene.lens import Lens
from mrbatch.scene.moment import Moment
from mrbatch.scene.motion import rigid_between
from mrbatch.scene.scene import Scene

LONGEST = 2.0
"""Frame intervals that an exposure may last: to the middle of either neighbour's."""
UNMOVED = "camera-still-while-exposed"


def shutter_times(shutter: ShutterSettings, rate: Fraction | None) -> tuple[float, ...]:
    """Moments in frames from the frame's own time: middles of equal parts of the exposure.

    `rate`: frames per second, None where the footage has none. Raises JobError.
    """
    if shutter.exposure is None:
        assert shutter.open is not None and shutter.close is not None
        first, last = shutter.open, shutter.close
    elif rate is None:
        raise JobError(
            "`shutter.exposure` is a time, and the footage has no frame rate",
            hint="give `open` and `close` in frames, or `capture.frame_rate`",
        )
    else:
        whole = shutter.exposure * float(rate)
        if whole > LONGEST:
            raise JobError(
                f"an exposure of {shutter.exposure:g} s lasts {whole:.3g} frames of this footage",
                hint=f"a shutter is open for at most {LONGEST:g} frames",
            )
        first, last = -whole / 2, whole / 2
    if first == last:
        return (first,) if first else ()
    n = shutter.samples
    return tuple(first + (last - first) * (k + 0.5) / n for k in range(n))


def focus_depth(scene: Scene, name: str, camera: Camera, number: int) -> float:
    """Planar z of the middle of an object's bounds, metres. Raises InputError where it is not in front."""
    found = [item.at(number).mesh.bounds() for item in scene.objects if item.name == name]
    middle = (np.min([low for low, _ in found], axis=0) + np.max([high for _, high in found], axis=0)) / 2
    depth = float((camera.camera_from_world @ np.append(middle, 1.0))[2])
    if depth <= 0.0:
        raise InputError(
            f"the camera cannot focus on `{name}`, whose middle is behind it",
            place=Place(frame=number),
            hint="give `lens.focus_distance`, or leave the frame out",
        )
    return depth


def lens_of(settings: LensSettings, scene: Scene, camera: Camera, number: int) -> Lens:
    """The lens of a camera in a frame. Raises InputError for one that cannot focus there."""
    if settings.focus_object is not None:
        focus = focus_depth(scene, settings.focus_object, camera, number)
    else:
        assert settings.focus_distance is not None
        focus = settings.focus_distance
    if settings.aperture is not None:
        return Lens(settings.aperture / 2, focus)
    assert settings.f_number is not None
    if settings.sensor_width is not None:
        # The calibrated focal length is the picture's distance behind the lens: 1 / f = 1 / v + 1 / focus.
        behind = float(camera.matrix[0, 0]) * settings.sensor_width / camera.width
        focal = behind * focus / (behind + focus)
    else:
        assert settings.focal_length is not None
        focal = settings.focal_length
    if focus <= focal:
        raise InputError(
            f"a lens of {focal * 1e3:g} mm cannot focus at {focus:g} m",
            place=Place(frame=number),
            hint="see `lens.focus_object` and `lens.focal_length`",
        )
    return Lens(focal / settings.f_number / 2, focus)


def pinholes(
    geometry: Mapping[str, ViewGeometry], display: Mapping[str, tuple[int, int]]
) -> dict[str, Camera]:
    """Cameras by view in output pixels, without lens."""
    return {name: view.camera.scaled(*display[name]) for name, view in geometry.items()}


class Exposure:
    """Tells what of a frame is known before its picture is read; `frame` is a pure function of the shot.

    `display`: size of the output by view. `announced`: all frames that the shot should have. Raises JobError
    for a shutter that this footage cannot have.
    """

    def __init__(
        self,
        job: Job,
        capture: Capture,
        table: Mapping[str, Any],
        scene: Scene,
        display: Mapping[str, tuple[int, int]],
        announced: Sequence[int],
    ) -> None:
        self.capture, self.table, self.scene, self.display = capture, table, scene, display
        self._lens = job.lens
        self._announced = sorted(announced)
        self._place = {number: at for at, number in enumerate(self._announced)}
        self._cuts = {int(n) for n in table.get("cuts", ())}
        rate = capture.facts(table).frame_rate
        self._times = () if job.shutter is None else shutter_times(job.shutter, rate)

    def frame(self, number: int) -> FrameFacts:
        """Cameras in output pixels with their lens, gains, and the moments of the exposure; none where
        nothing moves meanwhile. Raises InputError for a frame without a camera."""
        geometry = self.capture.geometry(number, self.table)
        cameras = {}
        for name, camera in pinholes(geometry, self.display).items():
            if self._lens is not None:
                if camera.model != "perspective":
                    raise JobError("`lens` needs a camera that is no panorama", hint="leave it out")
                camera = camera.with_lens(lens_of(self._lens, self.scene, camera, number))
            cameras[name] = camera
        gains = {name: np.asarray(view.gain, dtype=np.float64) for name, view in geometry.items()}
        return FrameFacts(number, cameras, gains, self._moments(number, cameras))

    def flags(self, number: int) -> tuple[str, ...]:
        """What a person should know of the frame's exposure."""
        if self._times and not any(self._neighbour(number, side) for side in (-1, 1)):
            return (UNMOVED,)
        return ()

    def _moments(self, number: int, cameras: Mapping[str, Camera]) -> tuple[Moment, ...]:
        if not self._times:
            return ()
        sides = {side: self._neighbour(number, side) for side in (-1, 1)}
        moments = []
        for offset in self._times:
            side = -1 if offset < 0.0 else 1
            found = sides[side] or sides[-side]
            there = dict(cameras)
            if found is not None:
                other, poses = found
                share = offset / (other - number)
                there = {
                    name: camera.at(rigid_between(camera.world_from_camera, poses[name], share))
                    for name, camera in cameras.items()
                }
            moments.append(Moment(number + offset, there))
        return tuple(moments) if self._stirs(number, cameras, moments) else ()

    def _stirs(self, number: int, cameras: Mapping[str, Camera], moments: Sequence[Moment]) -> bool:
        """Whether anything is elsewhere at any moment than at the frame's own time."""
        for moment in moments:
            for name, camera in cameras.items():
                if not np.array_equal(moment.cameras[name].world_from_camera, camera.world_from_camera):
                    return True
            for item in self.scene.objects:
                if item.motion is not None:
                    now, then = (item.motion.world_from_object(time) for time in (number, moment.time))
                    if not np.array_equal(now, then):
                        return True
        return False

    def _neighbour(self, number: int, side: int) -> tuple[int, dict[str, np.ndarray]] | None:
        """Number and poses by view of the frame before (-1) or after (1), if the camera's way leads there."""
        at = self._place.get(number, -2) + side
        if not 0 <= at < len(self._announced):
            return None
        other = self._announced[at]
        if max(number, other) in self._cuts:
            return None
        try:
            geometry = self.capture.geometry(other, self.table)
        except InputError:
            return None
        return other, {name: view.camera.world_from_camera for name, view in geometry.items()}


def looks_at(
    exposed: FrameFacts,
    scene: Scene,
    views: Mapping[str, ViewInput],
    show: Callable[[float, int], None],
) -> list[Look]:
    """What is looked at while the shutter is open; `show(time, number)` puts the scene where it then is."""
    found = []
    for moment in exposed.moments:
        home = scene.shifts(moment.time, exposed.number) if scene.moves else None
        there = {
            name: replace(given, camera=moment.cameras[name], frame_camera=given.camera, home=home)
            for name, given in views.items()
        }
        found.append(Look(functools.partial(show, moment.time, exposed.number), there))
    return found
