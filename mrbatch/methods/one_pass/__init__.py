"""One-pass differential path tracing: radiance with and without virtual objects from one camera ray."""

from mrbatch.contracts import Method
from mrbatch.methods.one_pass.axes import AXES
from mrbatch.methods.one_pass.cases import CASES
from mrbatch.methods.one_pass.effects import RULES
from mrbatch.methods.one_pass.passes import build
from mrbatch.methods.one_pass.settings import OnePassSettings

METHOD = Method(
    name="one-pass",
    meaning="differential rendering with two radiances from one camera ray, the papers' baseline",
    capture_kinds=("marker-video",),
    settings=OnePassSettings,
    build=build,
    layers=(
        "composite",
        "virtual",
        "background",
        "delta",
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
