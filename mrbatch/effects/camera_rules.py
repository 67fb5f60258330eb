"""Effect rules of the camera: blur by the lens, and by what moves while the shutter is open."""

from __future__ import annotations

import numpy as np

from mrbatch.contracts import Rule, Verdict
from mrbatch.effects.facts import FrameFacts, ShotFacts
from mrbatch.effects.influence import screen_rectangle, seen_part
from mrbatch.effects.light_bounds import Body, Box, body_of
from mrbatch.effects.verdict import absent, needed
from mrbatch.film.window import Window
from mrbatch.scene.camera import Camera
from mrbatch.scene.scene import Scene

SHARP = 0.5
"""Pixels of blur below which a picture counts as sharp: the box that a pixel is hides them."""


def _bodies(scene: Scene) -> dict[int, Body]:
    """By number what can be blurred: virtual objects, and real ones on which their light falls."""
    casts = any(o.cast_shadow for o in scene.virtual)
    return {
        number: body_of(item)
        for number, item in enumerate(scene.objects)
        if item.camera and (item.virtual or (item.receive and casts))
    }


def _in_picture(camera: Camera, window: Window, box: Box) -> bool:
    rectangle = screen_rectangle(camera, box)
    if rectangle is None:
        return False
    x0, y0, x1, y1 = rectangle
    return x1 > window.x and x0 < window.x + window.width and y1 > window.y and y0 < window.y + window.height


def _points(camera: Camera, window: Window, body: Body) -> np.ndarray:
    """(8, 3): corners of a box that holds what the picture shows of a surface."""
    whole = np.array([[window.x, window.y, window.x + window.width, window.y + window.height]], np.float64)
    low, high = seen_part(camera, whole, body.box, None if body.item.virtual else body.plane)
    return Box(low[0], high[0]).corners if np.isfinite(low[0]).all() else np.zeros((0, 3))


def _depth_of_field(facts: ShotFacts) -> Verdict:
    lenses = [c.lens for frame in facts.frames for c in frame.cameras.values() if c.lens is not None]
    if not any(lens.radius > 0.0 for lens in lenses):
        return absent("no lens with a width is given: everything virtual is sharp")
    largest = 0.0
    bodies: dict[int, Body] = {}
    for frame in facts.frames:
        if not bodies or facts.scene.moves:
            bodies = _bodies(facts.scene.at(frame.number))
        for view, camera in frame.cameras.items():
            if camera.lens is None:
                continue
            focal = float(max(camera.matrix[0, 0], camera.matrix[1, 1]))
            for body in bodies.values():
                if _in_picture(camera, facts.windows[view], body.box):
                    points = _points(camera, facts.windows[view], body)
                    depths = (points @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3])[
                        :, 2
                    ]
                    largest = max(largest, float(np.max(camera.lens.spread(focal, depths), initial=0.0)))
    if not np.isfinite(largest):
        return Verdict("unresolved", "what lies before or behind the focus is blurred; it reaches the lens")
    numbers = {"largest_px": largest}
    if largest < SHARP:
        why = f"the lens blurs nothing in the picture by {SHARP:g} pixels"
        return Verdict("negligible", why, numbers)
    return needed("what lies before or behind the focus is blurred", **numbers)


def _poses(scene: Scene, frame: FrameFacts) -> dict[int, list[np.ndarray]]:
    """By number of the objects that move: where they are at a frame's own time and at its moments."""
    times = [frame.number, *(moment.time for moment in frame.moments)]
    found = {
        number: [item.motion.world_from_object(time) for time in times]
        for number, item in enumerate(scene.objects)
        if item.motion is not None
    }
    return {number: poses for number, poses in found.items() if _differ(poses)}


def _motion_blur(facts: ShotFacts) -> Verdict:
    frames = [frame for frame in facts.frames if frame.moments]
    if not frames:
        return absent("no shutter that is open for some time is given: everything virtual stands still")
    changes = any(o.camera and o.receive for o in facts.scene.real)
    largest, moving, casting = 0.0, False, False
    for frame in frames:
        stirred = _poses(facts.scene, frame)
        moving = moving or bool(stirred)
        # A shadow under low light goes further than what casts it: no bound is known.
        casting = casting or (changes and any(facts.scene.objects[number].cast_shadow for number in stirred))
        bodies: dict[int, Body] = {}
        for view, camera in frame.cameras.items():
            cameras = [camera, *(moment.cameras[view] for moment in frame.moments)]
            turned = _differ([c.world_from_camera for c in cameras])
            moving = moving or turned
            if casting or not (stirred or turned):
                continue
            bodies = bodies or _bodies(facts.scene.at(frame.number))
            for number, body in bodies.items():
                if number in stirred or any(_in_picture(c, facts.windows[view], body.box) for c in cameras):
                    points = _points(camera, facts.windows[view], body)
                    largest = max(largest, _path(points, stirred.get(number), cameras))
    if not moving:
        return absent("nothing moves while the shutter is open")
    if casting:
        return needed("what casts shadows moves while the shutter is open")
    if not np.isfinite(largest):
        return Verdict("unresolved", "the camera moves while the shutter is open, near a surface")
    numbers = {"largest_px": largest}
    if largest < SHARP:
        return Verdict("negligible", f"nothing in the picture moves by {SHARP:g} pixels meanwhile", numbers)
    return needed("the camera or an object moves while the shutter is open", **numbers)


def _differ(poses: list[np.ndarray]) -> bool:
    return any(not np.array_equal(pose, poses[0]) for pose in poses[1:])


def _path(points: np.ndarray, poses: list[np.ndarray] | None, cameras: list[Camera]) -> float:
    """Pixels that points (n, 3), where they are at a frame's own time, move over on the picture."""
    found = []
    for k, camera in enumerate(cameras):
        there = points
        if poses is not None:
            if np.linalg.det(poses[0][:3, :3]) == 0.0:
                return np.inf  # out of nothing
            shift = poses[k] @ np.linalg.inv(poses[0])
            there = points @ shift[:3, :3].T + shift[:3, 3]
        pixels, _ = camera.project(there)
        found.append(pixels)
    if not np.isfinite(found).all():
        return np.inf
    return float(np.max(np.hypot(*np.moveaxis(np.ptp(found, axis=0), -1, 0)), initial=0.0))


DEPTH_OF_FIELD = Rule("depth-of-field", "blur of what the lens is not focused on", _depth_of_field)
MOTION_BLUR = Rule("motion-blur", "blur of what moves while the shutter is open", _motion_blur)
