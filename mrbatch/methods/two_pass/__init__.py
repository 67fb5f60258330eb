"""Two-pass differential path tracing: the scene with and without virtual objects, and the difference."""

from mrbatch.contracts import Method
from mrbatch.methods.two_pass.axes import AXES
from mrbatch.methods.two_pass.cases import CASES
from mrbatch.methods.two_pass.effects import RULES
from mrbatch.methods.two_pass.passes import build
from mrbatch.methods.two_pass.settings import TwoPassSettings

METHOD = Method(
    name="two-pass",
    meaning="differential rendering with two independent pictures, the classic baseline",
    capture_kinds=("marker-video",),
    settings=TwoPassSettings,
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
