"""Effect rules that every method of surfaces shares: absence proved from the scene's structure."""

from __future__ import annotations

import numpy as np

from mrbatch.contracts import Rule, Verdict
from mrbatch.effects.camera_rules import DEPTH_OF_FIELD, MOTION_BLUR
from mrbatch.effects.facts import FrameFacts, ShotFacts
from mrbatch.effects.light_bounds import body_of
from mrbatch.effects.verdict import absent, needed
from mrbatch.scene.lamp_table import emits


def _virtual(facts: ShotFacts) -> Verdict:
    seen = [o for o in facts.scene.virtual if o.camera]
    if not seen:
        return absent("no virtual object that the camera sees")
    return needed("virtual objects that the camera sees", objects=len(seen))


def _glossy(facts: ShotFacts) -> Verdict:
    glossy = [o for o in facts.scene.objects if o.material.kind != "diffuse"]
    if not glossy:
        return absent("every surface is diffuse")
    return needed("glossy surfaces", objects=len(glossy))


def _textures(facts: ShotFacts) -> Verdict:
    materials = [o.material for o in facts.scene.objects]
    looks = [(m.texture, m.surface_texture, m.emission_texture) for m in materials]
    textured = [found for found in looks if any(texture is not None for texture in found)]
    if not textured:
        return absent("no surface has a texture")
    return needed("textured surfaces", objects=len(textured))


def _normal_maps(facts: ShotFacts) -> Verdict:
    mapped = [o for o in facts.scene.objects if o.material.normal_texture is not None]
    if not mapped:
        return absent("no surface has a normal map")
    return needed("surfaces with a normal map", objects=len(mapped))


def _emission(facts: ShotFacts) -> Verdict:
    lit = [o for o in facts.scene.objects if o.material.most_emission.any()]
    if not lit:
        return absent("no object emits light")
    # What the camera does not see only lights others; no mirror may show it, nor may its light go to and fro
    # without a bound.
    seen = any(o.camera and o.virtual for o in lit)
    if facts.half_code > 0.0 and not seen:
        most = max(_lamp_light(facts, frame) for frame in facts.frames)
        if most < facts.half_code:
            return Verdict(
                "negligible", "what emits is unseen, and lights nothing by half a code value", bound=most
            )
    return needed("objects that emit light", objects=len(lit))


def _lamp_light(facts: ShotFacts, frame: FrameFacts) -> float:
    """The most that lamps add to any surface at a frame, in the photo's units: from l away a ball of radius r
    fills the share (r / l)^2 of a hemisphere at most, and of what comes of it surfaces return no more than
    their albedo, again and again."""
    bodies = [body_of(o) for o in facts.scene.at(frame.number).objects if o.cast_shadow or o.camera]
    albedo = max((float(b.albedo.max()) for b in bodies), default=0.0)
    if albedo >= 1.0 or any(b.item.material.kind != "diffuse" for b in bodies):
        return np.inf
    most = np.zeros(3)
    for body in bodies:
        direct = np.zeros(3)
        for lamp in (b for b in bodies if emits(b.item) and b is not body):
            low, high = body.box.low, body.box.high
            gap = np.linalg.norm(np.maximum(np.maximum(low - lamp.box.centre, lamp.box.centre - high), 0.0))
            share = 1.0 if gap <= lamp.box.radius else (lamp.box.radius / gap) ** 2
            direct += share * lamp.item.material.most_emission
        if emits(body.item):
            # Its own parts may see each other.
            direct += body.item.material.most_emission
        most = np.maximum(most, body.albedo * direct)
    gain = np.max([np.asarray(g, dtype=np.float64) for g in frame.gains.values()], axis=0)
    return float((gain * most / (1.0 - albedo)).max())


def _transmission(facts: ShotFacts) -> Verdict:
    clear = [o for o in facts.scene.virtual if o.material.kind == "dielectric"]
    if not clear:
        return absent("no virtual object lets light through")
    return needed("virtual objects that let light through", objects=len(clear))


def _alpha(facts: ShotFacts) -> Verdict:
    cut = [o for o in facts.scene.virtual if o.material.cut_out]
    if not cut:
        return absent("every virtual object is there as a whole: opacity 1 all over")
    return needed("virtual objects that are there in part", objects=len(cut))


def _thin_glass(facts: ShotFacts) -> Verdict:
    panes = [o for o in facts.scene.virtual if o.material.kind == "thin_dielectric"]
    if not panes:
        return absent("no virtual object is thin glass")
    return needed("virtual objects of thin glass, which light passes straight on", objects=len(panes))


def _holdout(facts: ShotFacts) -> Verdict:
    if not any(o.holdout for o in facts.scene.objects):
        return absent("no object is a holdout")
    return needed("holdout objects")


def _distortion(facts: ShotFacts) -> Verdict:
    cameras = [c for frame in facts.frames for c in frame.cameras.values()]
    if not any(np.any(c.distortion != 0.0) for c in cameras):
        return absent("no lens distortion in the calibration")
    return needed("the lens distorts", largest=max(float(np.abs(c.distortion).max()) for c in cameras))


def _environment(facts: ShotFacts) -> Verdict:
    if facts.scene.environment.black:
        return absent("no light comes from the environment")
    return needed("light from the environment", fluence=float(facts.scene.environment.fluence().mean()))


def _light_change(facts: ShotFacts) -> Verdict:
    if not any(o.cast_shadow for o in facts.scene.virtual):
        return absent("no virtual object that blocks or reflects light")
    receivers = [o for o in facts.scene.real if o.camera and o.receive]
    if not receivers:
        return absent("no real surface that the camera sees and that receives light")
    return needed("real surfaces receive light that virtual objects block and send", surfaces=len(receivers))


def _photo_reflectance(facts: ShotFacts) -> Verdict:
    from_photo = [o for o in facts.scene.real if o.material.from_photo]
    if not from_photo:
        return absent("every real surface has a reflectance of its own")
    return needed("real surfaces whose reflectance is what the photo shows", surfaces=len(from_photo))


def _receive(facts: ShotFacts) -> Verdict:
    if all(o.receive for o in facts.scene.objects):
        return absent("every object receives light changes")
    return needed("objects that take no light change from virtual ones")


VIRTUAL = Rule("virtual", "what the camera sees of virtual objects", _virtual)
GLOSSY = Rule("glossy", "glossy reflection", _glossy)
TEXTURES = Rule("textures", "reflectance that varies over a surface", _textures)
NORMAL_MAPS = Rule("normal-maps", "shading normals from a map", _normal_maps)
EMISSION = Rule("emission", "light that objects send of themselves", _emission)
TRANSMISSION = Rule("transmission", "light through glass and the like", _transmission)
ALPHA = Rule("alpha", "surfaces that are there in part, by opacity or cut out", _alpha)
THIN_GLASS = Rule("thin-glass", "light straight through thin panes", _thin_glass)
HOLDOUT = Rule("holdout", "objects that show the photo, untouched, and hide virtual ones", _holdout)
DISTORTION = Rule("lens-distortion", "distortion of the lens on the virtual layer", _distortion)
ENVIRONMENT = Rule("environment-light", "light from the environment map", _environment)
LIGHT_CHANGE = Rule("light-change", "shadow and light of virtual objects on real surfaces", _light_change)
PHOTO_REFLECTANCE = Rule(
    "photo-reflectance", "reflectance of real surfaces from the photo", _photo_reflectance
)
RECEIVE = Rule("receive-switch", "objects that take no light change", _receive)

PATH_RULES = (
    GLOSSY,
    EMISSION,
    TRANSMISSION,
    ALPHA,
    THIN_GLASS,
    NORMAL_MAPS,
    TEXTURES,
    PHOTO_REFLECTANCE,
    HOLDOUT,
    RECEIVE,
    DISTORTION,
    DEPTH_OF_FIELD,
    MOTION_BLUR,
    ENVIRONMENT,
)
"""What surfaces, light and lens may call for, whatever a method makes of the light change."""

WHOLE_PATH_RULES = (VIRTUAL, LIGHT_CHANGE, *PATH_RULES)
"""Of methods that trace both radiances in full: fewer effects can be left out than where only
their change is."""
