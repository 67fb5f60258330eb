"""Effect rules of delta path tracing: what is absent is proved from the scene's structure alone."""

from __future__ import annotations

import numpy as np

from mrbatch.contracts import Rule, Verdict
from mrbatch.effects.facts import ShotFacts
from mrbatch.effects.surface_rules import LIGHT_CHANGE, PATH_RULES, VIRTUAL
from mrbatch.effects.verdict import absent, needed
from mrbatch.scene.mesh import plane_of
from mrbatch.scene.scene import SceneObject


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
    if item.material.kind == "principled" or item.material.most_emission.any():
        return True
    return item.material.texture is not None or max(item.material.reflectance) > 0.0


def _bleeding(facts: ShotFacts) -> Verdict:
    senders = [o for o in facts.scene.virtual if o.cast_shadow and _can_send(o)]
    if not senders:
        return absent("no virtual object that reflects light onto others")
    return needed("virtual objects reflect light onto real surfaces", objects=len(senders))


RULES = (
    VIRTUAL,
    LIGHT_CHANGE,
    Rule("real-on-real", "light between real surfaces that virtual objects block", _real_on_real),
    Rule("bleeding", "light that virtual objects send onto real surfaces", _bleeding),
    *PATH_RULES,
)
