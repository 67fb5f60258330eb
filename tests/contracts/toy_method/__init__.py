"""A toy method: shades the photo by random amounts. It has the furniture of every method."""

from mrbatch.contracts import Method
from toy_method.axes import AXES
from toy_method.cases import CASES
from toy_method.effects import RULES
from toy_method.passes import build
from toy_method.settings import ToyShadeSettings

METHOD = Method(
    name="toy-shade",
    meaning="takes a random share of the light away",
    capture_kinds=("toy-capture",),
    settings=ToyShadeSettings,
    build=build,
    layers=("composite", "background", "delta", "variance", "samples"),
    rules=RULES,
    axes=AXES,
    cases=CASES,
)
