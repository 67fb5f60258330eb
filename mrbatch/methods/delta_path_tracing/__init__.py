"""Delta path tracing: light on virtual objects, and only the change of light on real ones."""

from mrbatch.contracts import Method
from mrbatch.methods.delta_path_tracing.axes import AXES
from mrbatch.methods.delta_path_tracing.cases import CASES
from mrbatch.methods.delta_path_tracing.effects import RULES
from mrbatch.methods.delta_path_tracing.passes import build
from mrbatch.methods.delta_path_tracing.settings import DeltaPathTracingSettings

METHOD = Method(
    name="delta-path-tracing",
    meaning="global illumination between real and virtual, traced only where it changes something",
    capture_kinds=("marker-video",),
    settings=DeltaPathTracingSettings,
    build=build,
    layers=(
        "composite",
        "virtual",
        "background",
        "delta",
        "shadow",
        "indirect",
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
