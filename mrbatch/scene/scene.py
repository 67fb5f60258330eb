"""What is there: real and virtual objects and the light, on the host, in float64 world coordinates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from mrbatch.scene.environment import Environment
from mrbatch.scene.mesh import Mesh
from mrbatch.scene.motion import Clock, Motion, Played, Still

MAX_TRIANGLES = 2**31 - 1
POLISHED = 1e-3
"""GGX alpha below which glass counts as smooth."""


@dataclass(frozen=True)
class Texture:
    """A picture on a surface: (H, W, 3) float32, scene-linear; where it came from, and notes on that."""

    pixels: np.ndarray
    source: str = ""
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Material:
    """How a surface reflects.

    `kind`: a name of mrbatch.kernels.bsdf ("diffuse", "conductor", "principled",
    "dielectric"). `reflectance` (3,)
    linear in 0..1; `texture` multiplies in place of it. `alpha`: GGX roughness. `from_photo`: the diffuse
    reflectance of a real surface is what the photo and the light say it is. `name`: what masks by material
    call it; empty: as its object. `metalness`, `f0` and `edge` (3,) as in `kernels.bsdf.Surface`.
    `surface_texture`: alpha in red and metalness in green, in place of the two. `normal_texture`: shading
    normals in the frame of u, v and the surface's own, of any length. `emission` (3,): radiance that the
    surface sends of itself, to both sides, in the map's units; `emission_texture` in place of it. Of kind
    "dielectric": index of refraction `ior` of what a closed mesh is full of, its `absorption` (3,) in 1/m,
    and its `priority` where media overlap. Of kind "thin_dielectric", a pane: `ior` of its glass, and what
    `reflectance` is of others is the share of light, above 0, that one way through the glass leaves.
    `opacity` 0..1: the share of the surface that is there; `opacity_texture` (red) in place of it, and 1
    from the value `opacity_cutoff` on, else 0, where that is above 0.
    """

    kind: str = "diffuse"
    reflectance: tuple[float, float, float] = (0.5, 0.5, 0.5)
    alpha: float = 0.0
    texture: Texture | None = None
    from_photo: bool = False
    name: str = ""
    metalness: float = 0.0
    f0: float = 0.0
    edge: tuple[float, float, float] = (1.0, 1.0, 1.0)
    surface_texture: Texture | None = None
    normal_texture: Texture | None = None
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)
    emission_texture: Texture | None = None
    ior: float = 1.0
    absorption: tuple[float, float, float] = (0.0, 0.0, 0.0)
    priority: int = 0
    opacity: float = 1.0
    opacity_texture: Texture | None = None
    opacity_cutoff: float = 0.0

    @property
    def cut_out(self) -> bool:
        """Whether some of the surface is not there."""
        if self.opacity_texture is None:
            return self.opacity < 1.0
        # Between texels no value is less than the least of them.
        least = float(self.opacity_texture.pixels[..., 0].min())
        return least < (self.opacity_cutoff if self.opacity_cutoff > 0.0 else 1.0)

    @property
    def see_through(self) -> bool:
        """Whether light passes some of the surface straight on."""
        return self.cut_out or self.kind == "thin_dielectric"

    @property
    def most_emission(self) -> np.ndarray:
        """(3,) float64: no less than what any point of the surface emits."""
        if self.emission_texture is not None:
            return self.emission_texture.pixels.reshape(-1, 3).max(axis=0).astype(np.float64)
        return np.asarray(self.emission, dtype=np.float64)


def absorption(colour: Sequence[float], depth: float) -> tuple[float, float, float]:
    """1/m: of a medium that leaves the share `colour` (3,), above 0, of light after `depth` metres."""
    r, g, b = (-math.log(c) / depth for c in colour)
    return r, g, b


@dataclass(frozen=True)
class SceneObject:
    """A mesh in the world with its material and switches.

    `camera`: seen by the camera. `cast_shadow`: other surfaces see it (blocks and reflects light).
    `receive`: light and shadow of virtual objects fall on it. `holdout`: what the camera sees of it
    is the photo, untouched. `motion`: of the mesh `still`, given in the object's own coordinates; `mesh` is
    then what it is at the first key.
    """

    name: str
    mesh: Mesh
    material: Material
    virtual: bool
    camera: bool = True
    cast_shadow: bool = True
    receive: bool = True
    holdout: bool = False
    motion: Motion | Still | Played | None = None
    still: Mesh | None = None

    def at(self, time: float, frame: int | None = None) -> SceneObject:
        """The object at a time in frames; one that is not there is neither seen nor casts a shadow.

        `frame`: whose exposure the time lies in, where it is not the frame's own: what is there in a frame
        is there for all of its exposure.
        """
        if self.motion is None or self.still is None:
            return self
        matrix = self.motion.world_from_object(time)
        if np.linalg.det(matrix[:3, :3]) == 0.0:
            # Scaled to nothing, as animations hide what they do not show.
            return replace(self, camera=False, cast_shadow=False)
        moved = replace(self, mesh=self.still.transformed(matrix))
        if self.motion.there(time if frame is None else frame):
            return moved
        return replace(moved, camera=False, cast_shadow=False)


@dataclass(frozen=True)
class Scene:
    """Objects and light of a shot. `origin` (3,) float64: kernels work relative to it.

    `notes`: what a report has to say of the reading.
    """

    objects: tuple[SceneObject, ...]
    environment: Environment
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))
    notes: tuple[str, ...] = ()

    @property
    def moves(self) -> bool:
        """Whether any object is elsewhere, or not there, in some frames."""
        return any(o.motion is not None for o in self.objects)

    @property
    def plays(self) -> bool:
        """Whether any object moves by seconds, so that a clock is needed."""
        return any(isinstance(o.motion, Played) for o in self.objects)

    def by(self, clock: Clock) -> Scene:
        """With the shot's clock, for what moves by seconds."""
        return replace(
            self,
            objects=tuple(
                replace(o, motion=o.motion.by(clock)) if isinstance(o.motion, Played) else o
                for o in self.objects
            ),
        )

    def at(self, time: float, frame: int | None = None) -> Scene:
        """The scene at a time in frames, with the same origin; `frame` as in `SceneObject.at`."""
        return replace(self, objects=tuple(o.at(time, frame) for o in self.objects)) if self.moves else self

    def shifts(self, frame: float, later: float) -> np.ndarray:
        """(objects, 4, 4) float64: takes a point of each object, relative to `origin`, from one frame to
        another."""
        shift = np.eye(4)
        shift[:3, 3] = self.origin
        found = np.tile(np.eye(4), (len(self.objects), 1, 1))
        for number, item in enumerate(self.objects):
            if item.motion is not None:
                now, then = (item.motion.world_from_object(f) for f in (frame, later))
                if np.linalg.det(now[:3, :3]) == 0.0:
                    continue
                found[number] = np.linalg.inv(shift) @ then @ np.linalg.inv(now) @ shift
        return found

    @property
    def real(self) -> tuple[SceneObject, ...]:
        return tuple(o for o in self.objects if not o.virtual)

    @property
    def virtual(self) -> tuple[SceneObject, ...]:
        return tuple(o for o in self.objects if o.virtual)


def virtual_bounds(objects: Sequence[SceneObject]) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest corner (3,) of the virtual objects (of all, where none is virtual) at all their
    keys; 0 where there is nothing."""
    if not objects:
        return np.zeros(3), np.zeros(3)
    chosen = [o for o in objects if o.virtual] or objects
    # Of what moves, where it is at every key: one origin for all frames.
    poses = [o.at(key) for o in chosen for key in (o.motion.frames if o.motion is not None else (0,))]
    low = np.min([o.mesh.vertices.min(axis=0) for o in poses], axis=0)
    high = np.max([o.mesh.vertices.max(axis=0) for o in poses], axis=0)
    return low, high


def centre(objects: Sequence[SceneObject]) -> np.ndarray:
    """Middle of the virtual objects' bounds (of all objects, where none is virtual), rounded to a power
    of two of their size, so that a scene moved by such steps gives the same bits.

    Floats are finest round the origin, and everything that changes happens near virtual objects: round
    the middle of a floor of kilometres a ray would start millimetres off its surface.
    """
    low, high = virtual_bounds(objects)
    size = float(np.max(high - low))
    if size == 0.0:
        return (low + high) / 2
    step = 2.0 ** np.floor(np.log2(size))
    # Halves go up, always: to the nearest even number, a move by one step would move some centres by two.
    return np.floor((low + high) / 2 / step + 0.5) * step
