"""Image-based lighting: virtual objects lit by the map alone. The baseline."""

from mrbatch.contracts import Method
from mrbatch.methods.image_based_lighting.axes import AXES
from mrbatch.methods.image_based_lighting.cases import CASES
from mrbatch.methods.image_based_lighting.effects import RULES
from mrbatch.methods.image_based_lighting.passes import build
from mrbatch.methods.image_based_lighting.settings import ImageBasedLightingSettings

METHOD = Method(
    name="image-based-lighting",
    meaning="virtual objects lit by the map alone; nothing real changes",
    capture_kinds=("marker-video",),
    settings=ImageBasedLightingSettings,
    build=build,
    layers=(
        "composite",
        "virtual",
        "background",
        "depth",
        "normal",
        "albedo",
        "motion",
        "variance",
        "samples",
        "crypto_object",
        "crypto_material",
    ),
    rules=RULES,
    axes=AXES,
    cases=CASES,
)
