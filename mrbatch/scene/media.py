"""Which clear media a path is in, for kernels: nested dielectrics with priorities.

After Schmidt and Budge, *Simple Nested Dielectrics in Ray Traced Images* (JGT 7(2), 2002): where media
overlap, the one of highest priority is there, and boundaries of the others inside it are not. So a glass and
the water in it may overlap a little instead of sharing a surface exactly. Among equals the lower object is.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from mrbatch.scene.scene_data import SceneData, SurfacePoint

DEPTH = 4
"""Media that may overlap at a point; of more, the first four are known."""
AIR = wp.constant(wp.int32(-1))
vec4n: Any = wp.types.vector(length=DEPTH, dtype=wp.int32)


@wp.struct
class Media:
    """Numbers + 1 of the objects that a path is inside of, 0 where none."""

    inside: vec4n


@wp.func
def medium_of(scene: SceneData, media: Media) -> int:
    """The object whose medium is there, or AIR."""
    best = AIR
    for i in range(wp.static(DEPTH)):
        number = media.inside[i] - 1
        if number >= 0:
            if best < 0:
                best = number
            else:
                ours = scene.objects[number].priority
                other = scene.objects[best].priority
                if ours > other or (ours == other and number < best):
                    best = number
    return best


@wp.func
def crossed(media: Media, number: int, entering: bool) -> Media:
    """The media behind a boundary of object `number`."""
    result = media
    done = bool(False)
    for i in range(wp.static(DEPTH)):
        if not done:
            if entering and result.inside[i] == 0:
                result.inside[i] = number + 1
                done = bool(True)
            if (not entering) and result.inside[i] == number + 1:
                result.inside[i] = 0
                done = bool(True)
    return result


@wp.func
def enters(scene: SceneData, point: SurfacePoint) -> bool:
    """Whether a ray that sees this point goes in there: it is seen from outside."""
    return wp.dot(point.ng, scene.triangles[point.triangle].ng) > 0.0


@wp.func
def index_of(scene: SceneData, medium: int) -> float:
    """Index of refraction of a medium."""
    if medium < 0:
        return 1.0
    return scene.objects[medium].ior


@wp.func
def passed(scene: SceneData, medium: int, distance: float) -> wp.vec3:
    """Share of light that comes through `distance` metres of a medium (Beer and Lambert)."""
    if medium < 0:
        return wp.vec3(1.0, 1.0, 1.0)
    a = scene.objects[medium].absorption
    return wp.vec3(wp.exp(-a[0] * distance), wp.exp(-a[1] * distance), wp.exp(-a[2] * distance))
