"""What a job says of materials."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from mrbatch.quantities import Albedo, InputPath, Length, Number, Reflectance, Settings

NAME_PATTERN = r"^[^\W\d][\w -]*$"
Name = Annotated[str, Field(pattern=NAME_PATTERN, max_length=64)]
"""A letter, then letters, digits, spaces, `_` and `-`: no dots, so that `--set virtual.NAME.x=` works."""


def to_tuple(value: Any) -> Any:
    return tuple(to_tuple(item) for item in value) if isinstance(value, list) else value


def to_triple(value: Any) -> Any:
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return (float(value),) * 3
    return to_tuple(value)


PositiveLength = Annotated[Length, Field(gt=0.0)]


class Texture(Settings):
    """A reflectance that varies over the surface: a picture looked up at the mesh's UV."""

    texture: InputPath = Field(description="The picture; u runs right, v up, 0..1 over the picture")
    colour: Literal["srgb", "linear"] = Field(
        "srgb", description="Transfer function of the picture's code values; reflectance is linear Rec.709"
    )
    mean: Albedo | None = Field(
        None, description="Scales the texture so that its mean reflectance is this, 0..1; none: as it is"
    )


class OpacityTexture(Settings):
    """Opacity that varies over the surface: a picture looked up at the mesh's UV."""

    texture: InputPath = Field(description="The picture; u runs right, v up, 0..1 over the picture")
    channel: Literal["auto", "alpha", "red"] = Field(
        "auto",
        description="Channel that holds it, code values as they are; `auto`: alpha if it has one, else red",
    )
    cutoff: Annotated[Number, Field(gt=0.0, le=1.0)] | None = Field(
        None, description="From this value on the surface is there, below not at all; none: in part"
    )


ConstantOrOpacityTexture = Annotated[
    Annotated[Reflectance, Tag("<constant>")] | Annotated[OpacityTexture, Tag("<texture>")],
    Discriminator(lambda value: "<texture>" if isinstance(value, (dict, OpacityTexture)) else "<constant>"),
]


def _reflectance_tag(value: Any) -> str:
    if isinstance(value, (dict, Texture)):
        return "<texture>"
    return "<photo>" if isinstance(value, str) else "<constant>"


ConstantOrTexture = Annotated[
    Annotated[Albedo, Tag("<constant>")] | Annotated[Texture, Tag("<texture>")],
    Discriminator(lambda value: "<texture>" if isinstance(value, (dict, Texture)) else "<constant>"),
]
ConstantTextureOrPhoto = Annotated[
    Annotated[Albedo, Tag("<constant>")]
    | Annotated[Texture, Tag("<texture>")]
    | Annotated[Literal["photo"], Tag("<photo>")],
    Discriminator(_reflectance_tag),
]


class Diffuse(Settings):
    """Reflects the same radiance in all directions (Lambert)."""

    type: Literal["diffuse"] = Field("diffuse", description="Kind of material")
    name: Name | None = Field(
        None, description="Name in the layer `crypto_material`, which objects may share; none: the object's"
    )
    reflectance: ConstantOrTexture = Field(
        (0.5, 0.5, 0.5), description="Share of light reflected, linear Rec.709, 0..1, or a texture"
    )


Metal = Literal["aluminium", "chromium", "copper", "gold", "iron", "nickel", "silver", "titanium"]


class Conductor(Settings):
    """Metal: GGX microfacets that reflect alike at all angles, or as a metal of known optical constants."""

    type: Literal["conductor"] = Field("conductor", description="Kind of material")
    name: Name | None = Field(
        None, description="Name in the layer `crypto_material`, which objects may share; none: the object's"
    )
    reflectance: ConstantOrTexture = Field(
        (0.9, 0.9, 0.9),
        description="Share of light reflected at normal incidence, linear Rec.709, 0..1, or a texture",
    )
    preset: Metal | None = Field(
        None,
        description="Reflectance of that metal at every angle, from measured n and k, in place of "
        "`reflectance`; light between its facets is not lost",
    )
    roughness: Reflectance = Field(0.15, description="GGX alpha (not its root), 0..1")

    @model_validator(mode="after")
    def _one_reflectance(self) -> Conductor:
        if self.preset is not None and "reflectance" in self.model_fields_set:
            usual = type(self).model_fields["reflectance"].default
            if self.reflectance != usual:  # what `resolved` filled in reads back
                raise ValueError("`preset` and `reflectance` are both given: give one")
        return self


class Principled(Settings):
    """Plastic, lacquer, metal and mixtures: the opaque part of OpenPBR, no energy lost at any roughness."""

    type: Literal["principled"] = Field("principled", description="Kind of material")
    name: Name | None = Field(
        None, description="Name in the layer `crypto_material`, which objects may share; none: the object's"
    )
    reflectance: ConstantOrTexture = Field(
        (0.8, 0.8, 0.8),
        description="Base colour, linear Rec.709, 0..1, or a texture: what lies under the gloss; of metal, "
        "what it reflects at normal incidence",
    )
    metalness: Reflectance = Field(0.0, description="0 plastic .. 1 metal")
    roughness: Reflectance = Field(
        0.1, description="GGX alpha, 0..1: the square of the roughness of Blender, glTF and OpenPBR"
    )
    ior: Annotated[Number, Field(ge=1.0, le=4.0)] = Field(
        1.5, description="Index of refraction of the gloss over what is not metal, 1..4; 1: none"
    )
    edge_tint: Albedo = Field(
        (1.0, 1.0, 1.0), description="Of metal: factor on its reflectance at 82 degrees, 0..1 (F82-tint)"
    )


Left = Annotated[Number, Field(gt=0.0, le=1.0)]


class Dielectric(Settings):
    """Glass, water, gems: a closed mesh full of a clear or coloured medium; or a thin pane of glass."""

    type: Literal["dielectric"] = Field("dielectric", description="Kind of material")
    name: Name | None = Field(
        None, description="Name in the layer `crypto_material`, which objects may share; none: the object's"
    )
    ior: Annotated[Number, Field(ge=1.0, le=4.0)] = Field(
        1.5, description="Index of refraction, 1..4: water 1.33, glass 1.5, diamond 2.4"
    )
    roughness: Reflectance = Field(
        0.0, description="GGX alpha of the surface (not its root), 0..1; 0: polished"
    )
    colour: Annotated[tuple[Left, Left, Left], BeforeValidator(to_triple)] = Field(
        (1.0, 1.0, 1.0),
        description="Share of light that is left after `depth` of the medium, above 0..1: grey or [r, g, b]; "
        "of a thin pane: after one way through it, straight on",
    )
    depth: PositiveLength = Field(
        0.1, description="Length of the way after which `colour` is left: a length above 0"
    )
    priority: Annotated[int, Field(ge=-100, le=100)] = Field(
        0,
        description="Where media overlap the one of highest priority is there: let glass beat its water",
    )
    thin: bool = Field(
        False,
        description="Whether each surface of the mesh is a pane by itself, which light passes without being "
        "bent: windows, bubbles; polished, without `depth`, `roughness` and `priority`",
    )

    @model_validator(mode="after")
    def _pane(self) -> Dielectric:
        fields = type(self).model_fields
        unused = [k for k in ("roughness", "depth", "priority") if getattr(self, k) != fields[k].default]
        if self.thin and unused:
            named = ", ".join(f"`{key}`" for key in unused)
            raise ValueError(f"thin glass has no {named}: leave it out, or `thin`")
        return self


Material = Annotated[Diffuse | Conductor | Principled | Dielectric, Field(discriminator="type")]
