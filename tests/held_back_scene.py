"""A marker video that nothing of the program was ever fitted to, made afresh by Mitsuba 3, and its job.

It shares no marker, map, object, camera or path with the sets in `shared/data` or the sample: a tag of
family 36h11 on a card that lies turned beside the world's origin, a sun and a green lamp, three
coloured real things that stand in each other's light, and a ring, a die and a pearl to be put between them.
Shapes, places, pictures and their codes are Mitsuba's; the job says the same in the program's words, so that
a rule read wrongly (which way up, which row first, which turn before which) shows.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mrbatch.bench.peers.mitsuba_difference import light_of_map, matt, metal, rgb, sensor

WIDTH, HEIGHT = 352, 264
MATRIX = np.array([[437.0, 0.0, 181.5], [0.0, 437.0, 127.25], [0.0, 0.0, 1.0]])
"""Pixel centres at half integers; the job counts them at whole numbers, as OpenCV does."""
GAIN = np.array([0.62, 0.66, 0.76])
FRAMES = 5
TRUTH_FRAMES = (1, 3)
SPP, TRUTH_SPP = 25, 100
"""Samples a pixel, of a sampler that stratifies: of the frames that only give poses, and of the others."""
TAG, SIDE, CARD = 113, 0.08, 1.75
"""Id, side in metres, and the card's side over the tag's."""
MARKER = {"position": (0.085, -0.085, 0.0007), "turn": 23.0}
MAP_TURN = -35.0
RING = (38.0, 13.0)
"""Radii in millimetres, as in its file: of the circle, and of what runs along it."""
RING_TILT, RING_TURN = 64.0, -10.0


def smoothstep(x: np.ndarray) -> np.ndarray:
    t = np.clip(x, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def sky() -> np.ndarray:
    """(128, 256, 3) radiance, rows at the end points: evening sky, brown ground, a sun of 8 degrees, a square
    green lamp."""
    polar = np.pi * np.arange(128) / 127
    azimuth = np.pi * (1.0 - 2.0 * (np.arange(256) + 0.5) / 256)
    z = np.broadcast_to(np.cos(polar)[:, None], (128, 256))
    x, y = (np.outer(np.sin(polar), f(azimuth)) for f in (np.cos, np.sin))
    height = smoothstep(0.5 + 8.0 * z)[..., None]
    up = np.clip(z, 0.0, 1.0)[..., None]
    above = (1.0 - up) * (0.95, 0.62, 0.42) + up * (0.22, 0.34, 0.62)
    radiance = height * above + (1.0 - height) * np.array([0.19, 0.15, 0.11])

    def direction(around: float, up: float) -> np.ndarray:
        a, e = np.radians([around, up])
        return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])

    sx, sy, sz = direction(-150.0, 34.0)
    off = np.degrees(np.arccos(np.clip(x * sx + y * sy + z * sz, -1.0, 1.0)))
    radiance += smoothstep(4.5 - off)[..., None] * (190.0, 150.0, 100.0)
    around = np.degrees(np.broadcast_to(azimuth, (128, 256)))
    lamp = (np.abs(around - 62.0) < 13.0) & (np.abs(np.degrees(np.arcsin(z)) - 47.0) < 9.0)
    radiance += lamp[..., None] * np.array([4.0, 9.0, 5.5])
    return radiance.astype(np.float32)


def write_ring(path: Path) -> None:
    """A torus about z with its own normals, millimetres."""
    import trimesh

    n, m = 120, 60
    u, v = np.meshgrid(2 * np.pi * np.arange(n) / n, 2 * np.pi * np.arange(m) / m, indexing="ij")
    out = np.stack([np.cos(u) * np.cos(v), np.sin(u) * np.cos(v), np.sin(v)], axis=-1)
    centre = np.stack([np.cos(u), np.sin(u), np.zeros_like(u)], axis=-1)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(n), np.arange(m), indexing="ij"))
    a, b = i * m + j, (i + 1) % n * m + j
    c, d = (i + 1) % n * m + (j + 1) % m, i * m + (j + 1) % m
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    mesh = trimesh.Trimesh(
        (RING[0] * centre + RING[1] * out).reshape(-1, 3),
        faces,
        vertex_normals=out.reshape(-1, 3),
        process=False,
    )
    path.write_bytes(trimesh.exchange.ply.export_ply(mesh, vertex_normal=True))


def write_card(mi: Any, path: Path) -> None:
    """The print, 8-bit codes of linear reflectance; the tag is upright as its project prints it."""
    from rendered_marker import marker_page

    page, _ = marker_page("DICT_APRILTAG_36h11", TAG, SIDE, CARD)
    ink = np.repeat(np.repeat(page, 4, axis=0), 4, axis=1)[..., None]
    codes = np.where(ink > 0.5, (206, 199, 186), (9, 10, 12)).astype(np.uint8)
    mi.Bitmap(codes).write(str(path))


def ring_height() -> float:
    """Of the tilted ring's centre, so that it just touches the table."""
    return (RING[0] * np.sin(np.radians(RING_TILT)) + RING[1]) / 1000


def shapes(mi: Any, folder: Path, virtual: bool) -> dict[str, Any]:
    """What stands on the table, in Mitsuba's words: its rectangle and cube reach from -1 to 1."""
    t = mi.ScalarTransform4f
    z = [0, 0, 1]
    # Its v counts from the picture's top row down.
    upright = t().scale([1, -1, 1])
    print_on_card = {"type": "bitmap", "filename": str(folder / "card.png"), "raw": True, "to_uv": upright}
    half_card = SIDE * CARD / 2
    found: dict[str, Any] = {
        "table": {
            "type": "rectangle",
            "to_world": t().translate([0.05, 0.02, 0]).scale([0.55, 0.45, 1]),
            "bsdf": matt(rgb((0.13, 0.29, 0.27))),
        },
        "card": {
            "type": "rectangle",
            "to_world": t()
            .translate(list(MARKER["position"]))
            .rotate(z, MARKER["turn"])
            .scale([half_card, half_card, 1]),
            "bsdf": matt(print_on_card),
        },
        "crate": {
            "type": "cube",
            "to_world": t().translate([-0.062, 0.058, 0.052]).rotate(z, -34).scale([0.041, 0.024, 0.052]),
            "bsdf": matt(rgb((0.62, 0.17, 0.10))),
        },
        "orange": {
            "type": "sphere",
            "center": [0.118, 0.062, 0.029],
            "radius": 0.029,
            "bsdf": matt(rgb((0.80, 0.42, 0.05))),
        },
    }
    if virtual:
        found |= {
            "ring": {
                "type": "ply",
                "filename": str(folder / "ring.ply"),
                "to_world": t()
                .translate([0.015, 0.095, ring_height()])
                .rotate(z, RING_TURN)
                .rotate([1, 0, 0], RING_TILT)
                .scale(0.001),
                "bsdf": metal(rgb((0.93, 0.71, 0.55)), 0.24),
            },
            "die": {
                "type": "cube",
                "to_world": t()
                .translate([-0.036, -0.062, 0.0205])
                .rotate(z, 19)
                .scale([0.0205, 0.0205, 0.0205]),
                "bsdf": matt(rgb((0.42, 0.20, 0.60))),
            },
            "pearl": {
                "type": "sphere",
                "center": [-0.062, 0.058, 0.122],
                "radius": 0.018,
                "bsdf": matt(rgb((0.82, 0.80, 0.74))),
            },
        }
    return found


def job(frames: str = "photo_####.png") -> dict[str, Any]:
    """The same in the words of a job file, whose paths count from its folder."""
    m = MATRIX.copy()
    m[:2, 2] -= 0.5

    def lengths(*values: float) -> list[str]:
        return [f"{value:.12g} mm" for value in values]

    return {
        "name": "held_back",
        "capture": {
            "kind": "marker-video",
            "frames": frames,
            "camera": {"matrix": m.tolist(), "width": WIDTH, "height": HEIGHT},
            "target": {"marker": {"dictionary": "tag36h11", "id": TAG, "side": "8 cm"}},
            "world_from_marker": {
                "position": lengths(*(1000 * x for x in MARKER["position"])),
                "rotation": ["0 deg", "0 deg", f"{MARKER['turn']} deg"],
            },
            "gain": GAIN.tolist(),
        },
        "environment": {"file": "sky.exr", "rows": "endpoints", "yaw": f"{MAP_TURN} deg"},
        "real": [
            {
                "name": "table",
                "plane": {"size": ["1.1 m", "0.9 m"]},
                "transform": {"translate": lengths(50, 20, 0)},
                "reflectance": [0.13, 0.29, 0.27],
            },
            {
                "name": "card",
                "plane": {"size": ["14 cm", "14 cm"]},
                "transform": {
                    "translate": lengths(*(1000 * x for x in MARKER["position"])),
                    "rotate": ["0 deg", "0 deg", f"{MARKER['turn']} deg"],
                },
                "reflectance": {"texture": "card.png", "colour": "linear"},
            },
            {
                "name": "crate",
                "box": {"size": lengths(82, 48, 104)},
                "transform": {"translate": lengths(-62, 58, 52), "rotate": ["0 deg", "0 deg", "-34 deg"]},
                "reflectance": [0.62, 0.17, 0.10],
            },
            {
                "name": "orange",
                "sphere": {"radius": "29 mm"},
                "transform": {"translate": lengths(118, 62, 29)},
                "reflectance": [0.80, 0.42, 0.05],
            },
        ],
        "virtual": [
            {
                "name": "ring",
                "mesh": "ring.ply",
                "transform": {
                    "translate": lengths(15, 95, 1000 * ring_height()),
                    "rotate": [f"{RING_TILT} deg", "0 deg", f"{RING_TURN} deg"],
                    "scale": 0.001,
                },
                "material": {"type": "conductor", "reflectance": [0.93, 0.71, 0.55], "roughness": 0.24},
            },
            {
                "name": "die",
                "box": {"size": lengths(41, 41, 41)},
                "transform": {"translate": lengths(-36, -62, 20.5), "rotate": ["0 deg", "0 deg", "19 deg"]},
                "material": {"type": "diffuse", "reflectance": [0.42, 0.20, 0.60]},
            },
            {
                "name": "pearl",
                "sphere": {"radius": "18 mm"},
                "transform": {"translate": lengths(-62, 58, 122)},
                "material": {"type": "diffuse", "reflectance": [0.82, 0.80, 0.74]},
            },
        ],
        "method": {"name": "delta-path-tracing"},
        "output": {"directory": "out"},
    }


def camera_path(mi: Any) -> list[np.ndarray]:
    """`world_from_camera` (4, 4) of every frame, x right, y down, z forward: a rising arc from the left."""
    poses = []
    for number in range(FRAMES):
        t = number / (FRAMES - 1)
        around, up = np.radians([-118.0 + 46.0 * t, 36.0 + 11.0 * t])
        away = 0.53 + 0.03 * np.sin(5.0 * t)
        toward = [np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)]
        target = np.array([0.032, -0.012 - 0.015 * t, 0.02])
        lean = [0.05 * np.sin(4.0 * t), 0.0, 1.0]
        placed = mi.ScalarTransform4f().look_at(list(target + away * np.array(toward)), list(target), lean)
        poses.append(np.array(placed.matrix, np.float64) @ np.diag([-1.0, -1.0, 1.0, 1.0]))
    return poses


def crossings(mi: Any, scenes: tuple[Any, Any], pose: np.ndarray) -> np.ndarray:
    """(h, w) bool: pixels that something virtual covers in part and that an edge of something real crosses,
    seen with the virtual or hidden by it. `scenes`: without and with what is virtual."""
    n = 4
    finer = MATRIX.copy()
    finer[:2] *= n
    eye = mi.load_dict(sensor((n * WIDTH, n * HEIGHT), finer, pose, mi))
    surfaces = mi.load_dict({"type": "aov", "aovs": "z:depth,n:geo_normal,s:shape_index"})
    empty, whole = (
        np.array(mi.render(scene, sensor=eye, integrator=surfaces, spp=1, seed=0))
        .reshape(HEIGHT, n, WIDTH, n, 5)
        .swapaxes(1, 2)
        .reshape(HEIGHT, WIDTH, n * n, 5)
        for scene in scenes
    )
    nearer = whole[..., 0] < (1 - 1e-5) * np.where(empty[..., 4] > 0, empty[..., 0], np.inf)
    nearer &= whole[..., 4] > 0
    partly = nearer.any(axis=2) & ~nearer.all(axis=2)
    edge = np.ptp(empty[..., 4], axis=2) > 0
    edge |= (np.ptp(empty[..., 1:4], axis=2) > 0.5).any(axis=2)
    return partly & edge


@dataclass(frozen=True)
class HeldBack:
    """Linear pictures (h, w, 3) in photo units of `TRUTH_FRAMES` and where in them outlines cross (h, w), and
    every frame's true pose."""

    folder: Path
    job: Path
    photos: Mapping[int, np.ndarray]
    truths: Mapping[int, np.ndarray]
    crossings: Mapping[int, np.ndarray]
    world_from_camera: tuple[np.ndarray, ...]


def make(mi: Any, folder: Path) -> HeldBack:
    """Writes footage (8-bit sRGB PNG; linear EXR of `TRUTH_FRAMES`), poses in the marker's frame, map, mesh,
    print and `job.yaml` into `folder`."""
    write_ring(folder / "ring.ply")
    write_card(mi, folder / "card.png")
    radiance = sky()
    mi.Bitmap(radiance).write(str(folder / "sky.exr"))
    c, s = np.cos(np.radians(MAP_TURN)), np.sin(np.radians(MAP_TURN))
    light = light_of_map(radiance, [[c, -s, 0], [s, c, 0], [0, 0, 1]], mi)
    path = mi.load_dict({"type": "path", "max_depth": -1, "rr_depth": 5})
    empty, whole = (
        mi.load_dict({"type": "scene", "light": light} | shapes(mi, folder, virtual))
        for virtual in (False, True)
    )
    poses = camera_path(mi)

    def picture(scene: Any, number: int, seed: int) -> np.ndarray:
        eye = mi.load_dict(sensor((WIDTH, HEIGHT), MATRIX, poses[number], mi, "multijitter"))
        spp = TRUTH_SPP if number in TRUTH_FRAMES else SPP
        linear = mi.render(scene, sensor=eye, integrator=path, spp=spp, seed=seed)
        return (GAIN * np.array(linear)).astype(np.float32)

    photos, truths, crossed = {}, {}, {}
    for number in range(FRAMES):
        photo = picture(empty, number, 2 * number)
        codes = mi.Bitmap(photo).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.UInt8, srgb_gamma=True)
        codes.write(str(folder / f"photo_{number:04d}.png"))
        if number in TRUTH_FRAMES:
            mi.Bitmap(photo).write(str(folder / f"linear_{number:04d}.exr"))
            photos[number] = photo
            truths[number] = picture(whole, number, 2 * number + 1)
            crossed[number] = crossings(mi, (empty, whole), poses[number])
    marker = np.eye(4)
    c, s = np.cos(np.radians(MARKER["turn"])), np.sin(np.radians(MARKER["turn"]))
    marker[:2, :2], marker[:3, 3] = [[c, -s], [s, c]], MARKER["position"]
    told = [
        {"frame": n, "world_from_camera": (np.linalg.inv(marker) @ pose).tolist()}
        for n, pose in enumerate(poses)
    ]
    (folder / "poses.json").write_text(json.dumps(told), encoding="utf-8")
    (folder / "job.yaml").write_text(json.dumps(job(), indent=1), encoding="utf-8")
    return HeldBack(folder, folder / "job.yaml", photos, truths, crossed, tuple(poses))
