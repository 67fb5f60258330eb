"""Effect rules of delta path tracing: what is absent is proved from the scene's structure alone."""

from __future__ import annotations

import numpy as np

from mrbatch.contracts import Rule, Verdict
from mrbatch.effects.facts import ShotFacts
from mrbatch.effects.surface_rules import (
    DISTORTION,
    ENVIRONMENT,
    GLOSSY,
    HOLDOUT,
    TEXTURES,
    VIRTUAL,
    absent,
    needed,
)
from mrbatch.scene.mesh import plane_of
from mrbatch.scene.scene import SceneObject


def _light_change(facts: ShotFacts) -> Verdict:
    if not any(o.cast_shadow for o in facts.scene.virtual):
        return absent("no virtual object that blocks or reflects light")
    receivers = [o for o in facts.scene.real if o.camera and o.receive]
    if not receivers:
        return absent("no real surface that the camera sees and that receives light")
    return needed("real surfaces receive light that virtual objects block and send", surfaces=len(receivers))


def _real_on_real(facts: ShotFacts) -> Verdict:
    seen = [o for o in facts.scene.real if o.cast_shadow]
    if not seen:
        return absent("no real surface that other surfaces see")
    # Those that others do not see still see others.
    real = facts.scene.real
    planes = [plane_of(o.mesh) for o in real]
    first = planes[0]
    if all(p is not None for p in planes) and first is not None:
        spacing = np.spacing(np.float32(max(np.abs(o.mesh.vertices).max() for o in real)))
        same = all(
            abs(float(p[0] @ first[0])) > 1 - 1e-12
            and abs(p[1] * np.sign(float(p[0] @ first[0])) - first[1]) <= 4 * spacing
            for p in planes
            if p is not None
        )
        if same:
            return absent("all real surfaces lie in one plane: none can see another")
    return needed("a real surface can see another, so light between them can be blocked", surfaces=len(real))


def _can_send(item: SceneObject) -> bool:
    # What lies over a black base is not black.
    if item.material.kind == "principled":
        return True
    return item.material.texture is not None or max(item.material.reflectance) > 0.0


def _bleeding(facts: ShotFacts) -> Verdict:
    senders = [o for o in facts.scene.virtual if o.cast_shadow and _can_send(o)]
    if not senders:
        return absent("no virtual object that reflects light onto others")
    return needed("virtual objects reflect light onto real surfaces", objects=len(senders))


def _photo_reflectance(facts: ShotFacts) -> Verdict:
    from_photo = [o for o in facts.scene.real if o.material.from_photo]
    if not from_photo:
        return absent("every real surface has a reflectance of its own")
    return needed("real surfaces whose reflectance is what the photo shows", surfaces=len(from_photo))


def _receive(facts: ShotFacts) -> Verdict:
    if all(o.receive for o in facts.scene.objects):
        return absent("every object receives light changes")
    return needed("objects that take no light change from virtual ones")


RULES = (
    VIRTUAL,
    Rule("light-change", "shadow and light of virtual objects on real surfaces", _light_change),
    Rule("real-on-real", "light between real surfaces that virtual objects block", _real_on_real),
    Rule("bleeding", "light that virtual objects send onto real surfaces", _bleeding),
    GLOSSY,
    TEXTURES,
    Rule("photo-reflectance", "reflectance of real surfaces from the photo", _photo_reflectance),
    HOLDOUT,
    Rule("receive-switch", "objects that take no light change", _receive),
    DISTORTION,
    ENVIRONMENT,
)
