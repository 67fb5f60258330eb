"""What a job says of the scene: environment, real surfaces, virtual objects.

All lengths are metres and all angles radians after reading. Matrices read `a_from_b`.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import (
    BeforeValidator,
    Field,
    ValidationError,
    ValidationInfo,
    WithJsonSchema,
    field_validator,
    model_validator,
)
from pydantic_core import InitErrorDetails, PydanticCustomError

from mrbatch.quantities import (
    Angle,
    Colour,
    InputPath,
    Number,
    Position,
    Positive,
    Rotation,
    Settings,
    Vector3,
)
from mrbatch.scene.alignment_settings import Alignment
from mrbatch.scene.depth_settings import DepthMap
from mrbatch.scene.gltf_header import SUFFIXES as GLTF_SUFFIXES
from mrbatch.scene.material_settings import (
    ConstantOrOpacityTexture,
    ConstantTextureOrPhoto,
    Dielectric,
    Material,
    Name,
    PositiveLength,
    to_triple,
    to_tuple,
)
from mrbatch.scene.matrix_settings import Matrix3, Matrix4, check_rotation
from mrbatch.scene.proxy_settings import Proxy

Scale3 = Annotated[
    Vector3,
    BeforeValidator(to_triple),
    WithJsonSchema(
        {
            "anyOf": [
                {"type": "number"},
                {"type": "array", "prefixItems": [{"type": "number"}] * 3, "minItems": 3, "maxItems": 3},
            ]
        }
    ),
]


class Environment(Settings):
    """Light from far away: an equirectangular map, linear Rec.709 radiance."""

    file: InputPath = Field(description="The map: an equirectangular picture, EXR or HDR, scene-linear")
    rows: Literal["centres", "endpoints"] = Field(
        "centres",
        description="Where row r of H lies: `centres` v = (r + 1/2) / H, `endpoints` v = r / (H - 1)",
    )
    yaw: Angle = Field(
        0.0, description="Turns the map about the world's +Z, counter-clockwise seen from above"
    )
    world_from_map: Matrix3 | None = Field(
        None, description="Rotation, 3x3, that takes directions of the map to the world; instead of `yaw`"
    )
    align: Alignment | None = Field(
        None, description="Directions marked in the map and known in the world; instead of `yaw`"
    )
    position: Position | None = Field(
        None,
        description="Where the map was made, in the world: lengths; without `proxy` it is only warned of",
    )
    proxy: Proxy | None = Field(
        None, description="Walls that the map is projected onto, to be seen from the virtual objects"
    )
    scale: Positive = Field(1.0, description="Factor on the map's radiance, 0 or more")
    interpolation: Literal["bilinear", "nearest"] = Field(
        "bilinear", description="How radiance is read between the map's texels"
    )

    @field_validator("world_from_map")
    @classmethod
    def _is_rotation(cls, value: Any) -> Any:
        if value is not None:
            check_rotation(value)
        return value

    @field_validator("align")
    @classmethod
    def _can_be_aligned(cls, value: Any, info: ValidationInfo) -> Any:
        if value is not None and value.directions is not None and "rows" in info.data:
            value.solved(info.data["rows"])
        return value

    @model_validator(mode="after")
    def _made_somewhere(self) -> Environment:
        if self.proxy is not None and self.position is None:
            raise ValueError("`proxy` needs `position`: where the map was made")
        return self

    @model_validator(mode="after")
    def _one_rotation(self) -> Environment:
        given = {"yaw": self.yaw != 0.0}
        given |= {name: getattr(self, name) is not None for name in ("world_from_map", "align")}
        names = [f"`{name}`" for name, there in given.items() if there]
        if len(names) > 1:
            which = "both" if len(names) == 2 else "all"
            raise ValueError(f"{', '.join(names[:-1])} and {names[-1]} are {which} given: give one")
        return self


def rotation_matrix(angles: tuple[float, float, float]) -> np.ndarray:
    """(3, 3) float64: turns about x, then y, then z by angles in radians."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(angles), np.sin(angles)
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


class Transform(Settings):
    """Where an object is: world_from_object = translate * rotate * scale, or a matrix."""

    translate: Position = Field((0.0, 0.0, 0.0), description="Shift along world x, y, z: lengths")
    rotate: Rotation = Field(
        (0.0, 0.0, 0.0), description="Turns about the world's x, then y, then z axis (right-handed): angles"
    )
    scale: Scale3 = Field((1.0, 1.0, 1.0), description="Factor, or one for each of the object's axes; not 0")
    matrix: Matrix4 | None = Field(
        None, description="world_from_object, 4x4 by rows, metres; instead of the three others"
    )

    @field_validator("scale")
    @classmethod
    def _scales(cls, value: Any) -> Any:
        if 0.0 in value:
            raise ValueError("must not be 0")
        return value

    @field_validator("matrix")
    @classmethod
    def _affine(cls, value: Any) -> Any:
        if value is not None:
            if tuple(value[3]) != (0.0, 0.0, 0.0, 1.0):
                raise ValueError("the last row must be 0, 0, 0, 1")
            linear = np.array(value, dtype=np.float64)[:3, :3]
            # Relative to the product of the columns' lengths: a scale of 1e-6 is fine, a flat matrix is not.
            lengths = np.linalg.norm(linear, axis=0)
            if np.prod(lengths) == 0.0 or abs(np.linalg.det(linear / lengths)) < 1e-12:
                raise ValueError("the matrix is singular: it flattens the object")
        return value

    @model_validator(mode="after")
    def _one_way(self) -> Transform:
        parts = (self.translate, self.rotate, self.scale)
        if self.matrix is not None and parts != ((0.0,) * 3, (0.0,) * 3, (1.0,) * 3):
            raise ValueError("`matrix` stands alone: leave out `translate`, `rotate` and `scale`")
        return self

    def world_from_object(self) -> np.ndarray:
        """(4, 4) float64, metres."""
        if self.matrix is not None:
            return np.array(self.matrix, dtype=np.float64)
        result = np.eye(4)
        result[:3, :3] = rotation_matrix(self.rotate) @ np.diag(self.scale)
        result[:3, 3] = self.translate
        return result


class Key(Settings):
    """Where a moving object is at one frame: world_from_object = translate * rotate * scale."""

    frame: int = Field(description="Number of the frame")
    translate: Position = Field((0.0, 0.0, 0.0), description="Shift along world x, y, z: lengths")
    rotate: Rotation = Field(
        (0.0, 0.0, 0.0), description="Turns about the world's x, then y, then z axis (right-handed): angles"
    )
    scale: Scale3 = Field((1.0, 1.0, 1.0), description="Factor, or one for each axis of the object, above 0")

    @field_validator("scale")
    @classmethod
    def _positive(cls, value: Any) -> Any:
        if min(value) <= 0.0:
            raise ValueError("must be above 0")
        return value


class Clip(Settings):
    """An animation of a glTF file: its nodes move while the shot goes on."""

    name: str | None = Field(None, description="Name of the animation in the file; none: its only one")
    start: int | None = Field(
        None, description="Number of the frame at which it begins; none: the first of the footage"
    )
    repeat: bool = Field(
        False,
        description="Whether it begins anew at its end; else it stays there, and before `start` as it begins",
    )
    speed: Annotated[Number, Field(gt=0.0)] = Field(
        1.0, description="Its seconds in one second of the footage, above 0"
    )


class Plane(Settings):
    """A rectangle in z = 0 about the origin, facing +z; u runs along x, v along y."""

    size: Annotated[tuple[PositiveLength, PositiveLength], BeforeValidator(to_tuple)] = Field(
        description="Extent along x and y: lengths above 0"
    )


class Box(Settings):
    """A box about the origin."""

    size: Annotated[tuple[PositiveLength, PositiveLength, PositiveLength], BeforeValidator(to_tuple)] = Field(
        description="Extent along x, y and z: lengths above 0"
    )


class Sphere(Settings):
    """A ball about the origin."""

    radius: PositiveLength = Field(description="Radius: a length above 0")


class Object(Settings):
    """A shape with its place in the world. Exactly one of `shapes` is given."""

    shapes: ClassVar[tuple[str, ...]] = ("mesh", "plane", "box", "sphere")

    name: Name = Field(description="Name in layers, reports and `--set`; a letter first, no dots")
    mesh: InputPath | None = Field(None, description="Triangle mesh: PLY, OBJ, STL or GLB, in metres")
    plane: Plane | None = Field(None, description="A rectangle in z = 0 about the origin")
    box: Box | None = Field(None, description="A box about the origin")
    sphere: Sphere | None = Field(None, description="A ball about the origin")
    transform: Transform = Field(Transform(), description="Where it stands in the world")
    normals: Literal["file", "smooth", "flat"] = Field(
        "file",
        description="Shading normals: `file` as stored (flat where none are), `smooth` averaged at vertices, "
        "`flat` of the triangles",
    )
    camera: bool = Field(True, description="Whether the camera sees it")
    cast_shadow: bool = Field(True, description="Whether it blocks and reflects light that falls on others")
    receive: bool = Field(True, description="Whether light and shadow of others change it")

    @model_validator(mode="wrap")
    @classmethod
    def _one_shape(cls, data: Any, handler: Any) -> Any:
        """Counts the shapes beside the other checks, so that one reading shows all errors."""
        given = [shape for shape in cls.shapes if isinstance(data, dict) and data.get(shape) is not None]
        if not isinstance(data, dict) or len(given) == 1:
            return handler(data)
        if given:
            message = f"{' and '.join(f'`{shape}`' for shape in given)} are given: an object has one shape"
        else:
            message = f"no shape: give one of {', '.join(f'`{shape}`' for shape in cls.shapes)}"
        found: list[InitErrorDetails] = []
        try:
            handler(data)
        except ValidationError as error:
            if not given and any(
                e["type"] == "extra_forbidden" and len(e["loc"]) == 1 for e in error.errors()
            ):
                raise  # a misspelt shape is one mistake, not two
            found = [_again(e) for e in error.errors()]
        found.append(
            {"type": PydanticCustomError("problem", "{message}", {"message": message}), "input": None}
        )
        raise ValidationError.from_exception_data(cls.__name__, found)


def _again(error: Any) -> InitErrorDetails:
    """An error in the form in which pydantic takes it back."""
    kind: Any = error["type"]
    if kind == "problem":
        kind = PydanticCustomError("problem", "{message}", error["ctx"])
    return {"type": kind, "loc": error["loc"], "input": error["input"], "ctx": error.get("ctx", {})}


class RealObject(Object):
    """A surface of the captured place, as far as light needs it. Its picture is the photo's."""

    shapes: ClassVar[tuple[str, ...]] = (*Object.shapes, "depth_map")

    depth_map: DepthMap | None = Field(
        None, description="A depth map, whose camera says where it stands: without `transform`"
    )
    reflectance: ConstantTextureOrPhoto | None = Field(
        None,
        description="Diffuse reflectance, linear Rec.709, 0..1: grey, [r, g, b], a texture, or `photo`, "
        "which takes it from the picture by Delta = L_b dE / E_r; this or `material` is given",
    )
    material: Material | None = Field(
        None, description="How a surface reflects that is not matt; in place of `reflectance`"
    )
    emission: Colour | None = Field(
        None,
        description="Radiance of a real lamp, linear Rec.709, in the map's units, 0 or more: grey or "
        "[r, g, b]. Its light is in the photo; virtual objects are lit by it and stand in its way. Leave out "
        "what the map shows already",
    )
    holdout: bool = Field(
        False,
        description="Whether the photo stays untouched on it; it hides virtual objects, and others see it "
        "changed as before",
    )

    @model_validator(mode="after")
    def _one_look(self) -> RealObject:
        if (self.reflectance is None) == (self.material is None):
            raise ValueError("one of `reflectance` and `material` is given")
        if isinstance(self.material, Dielectric):
            raise ValueError("a real surface is opaque: its material is diffuse, conductor or principled")
        if self.depth_map is not None and self.transform != Transform():
            raise ValueError("`depth_map` stands where its camera saw it: leave out `transform`")
        if self.reflectance == "photo" and self.emission is not None:
            raise ValueError("the photo does not show what a lamp reflects: give its `reflectance`")
        return self


class VirtualObject(Object):
    """Something that was not there."""

    animation: Annotated[tuple[Key, ...], BeforeValidator(to_tuple)] | None = Field(
        None,
        description="Places at key frames, in place of `transform`: between them the object moves evenly and "
        "turns the shortest way",
    )
    visible: Annotated[tuple[tuple[int, int], ...], BeforeValidator(to_tuple)] | None = Field(
        None, description="[first, last] frame of each time at which it is there; none: always"
    )

    clip: Clip | None = Field(
        None,
        description="The animation of its glTF file that is played; `transform` or `animation` place it all",
    )

    @model_validator(mode="after")
    def _playable(self) -> VirtualObject:
        if self.clip is not None and (self.mesh is None or self.mesh.suffix.lower() not in GLTF_SUFFIXES):
            raise ValueError("`clip` is an animation of a glTF file, and `mesh` names none")
        return self

    @model_validator(mode="after")
    def _consistent(self) -> VirtualObject:
        if self.animation is not None:
            frames = [key.frame for key in self.animation]
            if not frames or any(b <= a for a, b in zip(frames, frames[1:])):
                raise ValueError("`animation` has one key or more, each of a later frame than the last")
            if self.transform != Transform():
                raise ValueError("`transform` and `animation` are both given: give one")
        if self.opacity is not None and isinstance(self.material, Dielectric):
            raise ValueError("`opacity` of a dielectric: light passes it as glass; give its `colour`")
        if self.emission is not None and isinstance(self.material, Dielectric) and self.material.thin:
            raise ValueError("`emission` of thin glass: a pane sends no light of itself")
        if any(last < first for first, last in self.visible or ()):
            raise ValueError("`visible`: a time ends before it begins")
        return self

    material: Material | None = Field(
        None,
        description="How its surface reflects; none: as a glTF file says, else diffuse grey",
    )
    emission: Colour | None = Field(
        None,
        description="Radiance that it sends of itself, linear Rec.709, in the map's units, 0 or more: grey "
        "or [r, g, b]; none: as a glTF file says, else 0",
    )
    opacity: ConstantOrOpacityTexture | None = Field(
        None,
        description="Share of its surface that is there, 0..1, or a texture of it: leaves, fences, veils; "
        "not of dielectrics; none: as a glTF file says, else 1",
    )
    holdout: bool = Field(
        False, description="Whether it cuts a hole: it hides virtual objects and shows the photo"
    )
