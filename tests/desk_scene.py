"""The two desk sets (`markers/mitsuba_desk_*`) as scenes, and their composites judged.

Another renderer made photo and truth; everything it used is in `scene.json`. The truth's own noise is
not stored (`judgement`).
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from judgement import HALF_ROUNDING, against_truth

from mrbatch.film.composite import composite
from mrbatch.film.window import Window
from mrbatch.methods.estimate import Estimated, estimate
from mrbatch.metrics.region import noisy_region_of_interest
from mrbatch.metrics.statistics import TileTest
from mrbatch.scene.camera import Camera
from mrbatch.scene.environment import load_environment
from mrbatch.scene.mesh import plane
from mrbatch.scene.mesh_file import load_mesh
from mrbatch.scene.scene import Material, Scene, SceneObject, Texture, centre

SETS = ("mitsuba_desk_window", "mitsuba_desk_lamps")
PAPER_MM = (210, 297)
MARKER_MM = 60


def read(path: Path) -> np.ndarray:
    import OpenImageIO as oiio

    return oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT)[:, :, :3].copy()


def paper_texture(marker: int, texels_per_mm: int = 8) -> np.ndarray:
    import cv2

    w, h, n = (size * texels_per_mm for size in (*PAPER_MM, MARKER_MM))
    ink = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50), marker, n)
    paper = np.full((h, w), 0.8, np.float32)
    y, x = (h - n) // 2, (w - n) // 2
    paper[y : y + n, x : x + n] = np.where(ink > 127, 0.8, 0.04)
    return np.repeat(paper[:, :, None], 3, axis=2)


@dataclass(frozen=True)
class Desk:
    """A scene with its cameras, gain (photo = gain x radiance), and folder."""

    folder: Path
    kind: str
    scene: Scene
    cameras: tuple[Camera, ...]
    gain: float

    def photo(self, frame: int) -> np.ndarray:
        return read(self.folder / f"photo_linear_{frame:04d}.exr")

    def truth(self, frame: int) -> np.ndarray:
        return read(self.folder / f"truth_{self.kind}_{frame:04d}.exr")


def desk(shared_data: Path, name: str, kind: str) -> Desk:
    """`kind`: the bunny `diffuse` or of `metal`."""
    folder = shared_data / "markers" / name
    given = json.loads((folder / "scene.json").read_text())
    real = given["real"]

    def lifted(mesh, z):
        matrix = np.eye(4)
        matrix[2, 3] = z
        return mesh.transformed(matrix)

    meshes = shared_data / "meshes"
    table, paper, head = real["table"], real["paper"], real["suzanne"]
    bunny = given["virtual"]["bunny"]
    look = (
        Material(reflectance=tuple(bunny["diffuse"]))
        if kind == "diffuse"
        else Material("conductor", tuple(bunny["metal"]["tint"]), bunny["metal"]["ggx_alpha"])
    )
    print_on_paper = Texture(paper_texture(given["marker"]["id"]))
    objects = (
        SceneObject(
            "table",
            lifted(plane(*table["size"]), table["z"]),
            Material(reflectance=tuple(table["reflectance"])),
            False,
        ),
        SceneObject(
            "paper",
            lifted(plane(*paper["size"]), paper["z"]),
            Material(texture=print_on_paper),
            False,
        ),
        SceneObject(
            "head",
            load_mesh(meshes / "suzanne.ply").transformed(np.array(head["world_from_object"])),
            Material(reflectance=tuple(head["reflectance"])),
            False,
        ),
        SceneObject(
            "bunny",
            load_mesh(meshes / "bunny.ply")
            .with_angle_weighted_normals()
            .transformed(np.array(bunny["world_from_object"])),
            look,
            True,
        ),
    )
    light = load_environment(folder / "environment.exr", rows="endpoints")
    cameras = tuple(
        Camera.from_opencv(
            given["width"],
            given["height"],
            np.array(given["camera_matrix"]),
            np.array(given["distortion"]),
            np.array(pose),
            pixel_centres="half",
        )
        for pose in given["world_from_camera"]
    )
    return Desk(folder, kind, Scene(objects, light, centre(objects)), cameras, float(given["exposure"]))


@dataclass(frozen=True)
class Judged:
    """Outcome on the region of interest. `ours`, `theirs`: mean variance of a pixel, ours and the truth's.

    `test`, `relmse`, `beyond`: as in `Judgement`.
    """

    test: TileTest
    relmse: float
    beyond: float
    ours: float
    theirs: float
    pixels: int
    seconds: float
    rays: int


def region_window(region: np.ndarray) -> Window:
    """The whole tiles that hold the region."""
    y, x = np.nonzero(region)
    x0, y0, x1, y1 = x.min() // 16 * 16, y.min() // 16 * 16, x.max() // 16 * 16 + 16, y.max() // 16 * 16 + 16
    return Window(int(x0), int(y0), int(min(x1, region.shape[1]) - x0), int(min(y1, region.shape[0]) - y0))


def render(
    method, desk: Desk, frame: int, window: Window | None, *, spp: int, seed: int = 0, **settings
) -> Estimated:
    """`masking`: as the renderer of the truth combines it."""
    return estimate(
        method,
        desk.scene,
        desk.cameras[frame],
        settings={"masking": "separable", **settings},
        spp=spp,
        background=desk.photo(frame),
        gain=[desk.gain] * 3,
        frame=frame,
        seed=seed,
        window=window,
    )


def judge(method, desk: Desk, frame: int, *, spp: int, seed: int = 0, **settings) -> Judged:
    """Renders the region of interest and compares it with the truth."""
    photo, truth = desk.photo(frame), desk.truth(frame)
    region = noisy_region_of_interest(truth, photo)
    window = region_window(region)
    result = render(method, desk, frame, window, spp=spp, seed=seed, **settings)
    part = np.s_[window.y : window.y + window.height, window.x : window.x + window.width]
    region = region[part]
    d = result.developed
    picture = composite(d.P, d.a, result.background, d.D)
    found = against_truth(picture, truth[part], region, origin=(window.x, window.y), rounding=HALF_ROUNDING)
    # Our variance from the two halves, which are independent whatever the points are.
    halves = [h[..., :3] - h[..., 3:4] * result.background + h[..., 4:7] for h in d.halves]
    ours = (halves[0] - halves[1]) ** 2 / 4
    # Where the object covers the pixel there is no photo: the rest of the spread is the truth's own.
    inside = region & (d.a == 1)
    theirs = (found.spread - ours)[inside].mean()
    seconds = sum(node.seconds for name, node in result.timing.children.items() if name != "compile")
    rays = sum(n for name, n in result.counters.items() if name.endswith("rays"))
    return Judged(
        found.test,
        found.relmse,
        found.beyond,
        float(ours[inside].mean()),
        float(theirs),
        int(region.sum()),
        seconds,
        rays,
    )
