"""Jobs that put objects of many materials into the real marker sets, and the sheet of them in the docs.

    python tests/real_sets.py SHARED_DATA FOLDER
    python tests/real_sets.py SHARED_DATA FOLDER --sheet docs/images/real_sets.jpg

The first writes the jobs into FOLDER and names them; the second renders them as well, and draws the sheet.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from desk_job import desk_job

MATERIALS: dict[str, dict[str, Any]] = {
    "clear glass": {"type": "dielectric"},
    "green glass": {"type": "dielectric", "colour": [0.25, 0.85, 0.45], "depth": "30 mm"},
    "frosted glass": {"type": "dielectric", "roughness": 0.25},
    "polished gold": {"type": "conductor", "preset": "gold", "roughness": 0.03},
    "polished copper": {"type": "conductor", "preset": "copper", "roughness": 0.03},
    "rough gold": {"type": "conductor", "preset": "gold", "roughness": 0.25},
    "rough aluminium": {"type": "conductor", "preset": "aluminium", "roughness": 0.3},
    "red lacquer": {"type": "principled", "reflectance": [0.55, 0.03, 0.03], "roughness": 0.05},
    "blue plastic": {"type": "principled", "reflectance": [0.04, 0.12, 0.5], "roughness": 0.3},
    "matt white": {"type": "diffuse", "reflectance": [0.75, 0.75, 0.72]},
    "matt blue": {"type": "diffuse", "reflectance": [0.15, 0.3, 0.6]},
}
MESHES = {
    # file, its lowest point along its own up, y, and a scale at which it suits a page
    "dragon": ("dragon.ply", 0.0528, 0.55),
    "bunny": ("bunny.ply", -0.0546, 0.5),
    "head": ("suzanne.ply", -0.8674, 0.02),
    "avocado": ("avocado_512.glb", 0.0, 1.0),
    "bottle": ("water_bottle_512.glb", -0.1302, 0.35),
}
TAGS = {"dictionary": "tag36h11", "side": "65 mm"}


def standing(
    shared_data: Path,
    mesh: str,
    x: float,
    y: float,
    *,
    turn: float = 0.0,
    material: str | None = None,
    size: float = 1.0,
) -> dict[str, Any]:
    """A virtual object that stands on z = 0 with its middle near (x, y), metres, turned by `turn` degrees."""
    file, lowest, scale = MESHES[mesh]
    scale *= size
    found: dict[str, Any] = {
        "name": f"new {mesh}",  # a real head stands on the desks
        "mesh": str(shared_data / "meshes" / file),
        "transform": {
            "translate": [f"{x} m", f"{y} m", f"{-lowest * scale} m"],
            "rotate": ["90 deg", 0, f"{turn} deg"],
            "scale": scale,
        },
    }
    if material is not None:
        found |= {"normals": "smooth", "material": MATERIALS[material]}
    return found


def ball(x: float, y: float, material: str, radius: float = 0.016) -> dict[str, Any]:
    return {
        "name": "new ball",
        "sphere": {"radius": f"{radius} m"},
        "transform": {"translate": [f"{x} m", f"{y} m", f"{radius} m"]},
        "material": MATERIALS[material],
    }


def charuco_job(shared_data: Path, folder: Path) -> Path:
    """Stills round a board: light of a room that is not theirs, as bright and as white as their paper is."""
    source = shared_data / "markers" / "charuco_realsense_jp"
    known = source / "calib_and_poses.json"
    return _write(
        folder,
        "charuco",
        {
            "capture": {
                "kind": "marker-video",
                "frames": str(source / "images" / "calib_*.jpg"),
                "camera": str(known),
                "target": {
                    "board": {
                        "type": "charuco",
                        "squares": [7, 5],
                        "square": "30 mm",
                        "marker": "22 mm",
                        "dictionary": "DICT_4X4_50",
                    }
                },
                "gain": _gain(13, [225, 480, 40, 20], [2.32, 1.97, 1.71]),
            },
            "environment": {
                "file": str(shared_data / "environments" / "lebombo_1k" / "lebombo_1k.exr"),
                "yaw": "180 deg",
            },
            "real": [
                # The board is a page on a card of 5 mm; the table ends at the rulers round it.
                _plane(
                    "table", [0.53, 0.45], (-0.027, -0.02, -0.005), material={**GLOSSY, "reflectance": 0.7}
                ),
                _plane("page", [0.297, 0.21], (0, 0, 0), reflectance="photo"),
            ],
            "virtual": [
                standing(shared_data, "dragon", 0.06, 0.04, turn=-20, material="clear glass"),
                standing(shared_data, "bunny", -0.04, 0.045, turn=20, material="polished gold"),
                standing(shared_data, "head", 0.075, -0.055, turn=15, material="red lacquer"),
                standing(shared_data, "avocado", 0.01, -0.035, turn=10),
                standing(shared_data, "bottle", -0.105, -0.01, turn=30),
                ball(-0.05, -0.06, "matt blue"),
            ],
            "frames": "6,13,18,23",
        },
    )


def april_job(
    shared_data: Path,
    folder: Path,
    still: int,
    marker: int,
    world_from_marker: dict[str, Any],
    paper: Sequence[int],
    white: float,
    virtual: list[dict[str, Any]],
) -> Path:
    """One still of the signs: every still is an arrangement of its own, so each has a job of its own."""
    source = shared_data / "markers" / "apriltag_duckietown"
    return _write(
        folder,
        f"april_{still:02d}",
        {
            "capture": {
                "kind": "marker-video",
                "frames": str(source / "multiple_*.jpg"),
                "subset": {"first": still, "last": still},
                "camera": {"file": str(source / "test_info.yaml"), "section": "multiple_tags_test"},
                "target": {"marker": {**TAGS, "id": marker}},
                "world_from_marker": world_from_marker,
                "gain": _gain(still, paper, [3.78, 3.15, 2.25], white),
            },
            "environment": {
                "file": str(
                    shared_data / "environments" / "st_fagans_interior_1k" / "st_fagans_interior_1k.exr"
                )
            },
            "real": [_plane("table", [3.0, 3.0], (0, 0, 0), reflectance="photo")],
            "virtual": virtual,
        },
    )


GLOSSY = {"type": "principled", "roughness": 0.12}


def _plane(name: str, size: Sequence[float], middle: Sequence[float], **light: Any) -> dict[str, Any]:
    return {
        "name": name,
        "plane": {"size": [f"{side} m" for side in size]},
        "transform": {"translate": [f"{c} m" for c in middle]},
        **light,
    }


def _gain(
    frame: int, rectangle: Sequence[int], irradiance: Sequence[float], white: float = 0.8
) -> dict[str, Any]:
    """White paper in the photo is as white under the map: `irradiance` is the map's on what faces up."""
    return {
        "patch": {
            "frame": frame,
            "rectangle": list(rectangle),
            "reflectance": white,
            "irradiance": list(irradiance),
        }
    }


def _write(folder: Path, name: str, job: dict[str, Any]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.yaml"
    whole = {
        "name": name,
        **job,
        "method": {"name": "delta-path-tracing", "spp": 32},
        "output": {"directory": str(folder / name), "filter": {"kind": "variance"}},
    }
    path.write_text(json.dumps(whole, indent=1), encoding="utf-8")
    return path


def april_jobs(shared_data: Path, folder: Path) -> list[Path]:
    """Four of the stills, each by one sign.

    A sign that lies rests on its foot and on a pad of paper: its tag is 18 mm above the table and not
    parallel to it. `world_from_marker` turns it by what the plane through the middles of all lying tags
    of the still says, and standing ones by the plane through the middles of those.
    """

    def put(mesh: str, *where: float, **more: Any) -> dict[str, Any]:
        return standing(shared_data, mesh, *where, **more)

    def job(still: int, marker: int, turn: Sequence[float], height: float, *rest: Any) -> Path:
        world_from_marker = {
            "rotation": [*(f"{angle} deg" for angle in turn), 0],
            "position": [0, 0, f"{height} m"],
        }
        return april_job(shared_data, folder, still, marker, world_from_marker, *rest)

    return [
        job(
            2,
            198,
            (4.0, 0.0),
            0.018,
            [300, 300, 40, 40],
            0.8,
            [
                put("bunny", -0.3, 0.07, turn=-10, material="matt blue"),
                put("dragon", -0.19, 0.0, turn=-35, material="polished copper"),
                put("avocado", -0.27, -0.05, turn=-20),
                put("head", -0.33, 0.0, turn=-10, material="rough aluminium"),
            ],
        ),
        job(
            9,
            85,
            (-9.2, 1.7),
            0.017,
            [210, 330, 40, 40],
            0.8,
            [
                put("bunny", 0.33, 0.11, turn=120, material="polished copper", size=0.7),
                put("dragon", 0.385, 0.085, turn=140, material="green glass", size=0.6),
                put("avocado", 0.39, 0.15, turn=146, size=0.5),
            ],
        ),
        job(
            10,
            198,
            (97.0, 2.7),
            0.07,
            [300, 300, 20, 20],
            0.2,
            [
                put("bunny", -0.32, -0.12, turn=20, material="red lacquer"),
                put("dragon", -0.17, -0.13, turn=-20, material="rough gold"),
                put("bottle", -0.235, -0.2, turn=10),
            ],
        ),
        job(
            7,
            24,
            (91.6, 3.0),
            0.07,
            [270, 370, 40, 30],
            0.8,
            [
                put("dragon", -0.03, -0.26, turn=10, material="blue plastic"),
                put("bottle", 0.06, -0.24, turn=10),
                put("head", 0.05, -0.33, turn=0, material="rough gold"),
                ball(-0.02, -0.34, "clear glass"),
            ],
        ),
    ]


def desk_jobs(shared_data: Path, folder: Path) -> list[Path]:
    """The two desks of another renderer, in their own light."""

    def put(mesh: str, *where: float, **more: Any) -> dict[str, Any]:
        return standing(shared_data, mesh, *where, **more)

    virtual = {
        "mitsuba_desk_window": [
            put("dragon", -0.01, -0.09, turn=-10, material="green glass"),
            put("bunny", -0.1, 0.02, turn=20, material="polished copper"),
            put("head", 0.09, -0.09, turn=10, material="rough aluminium"),
            put("avocado", 0.08, 0.0, turn=-20),
            put("bottle", -0.06, 0.12, turn=30),
            ball(-0.09, -0.1, "frosted glass"),
        ],
        "mitsuba_desk_lamps": [
            put("dragon", 0.0, -0.08, turn=-10, material="rough gold"),
            put("bunny", -0.1, 0.03, turn=20, material="matt white"),
            put("head", 0.09, -0.09, turn=10, material="clear glass"),
            put("avocado", 0.08, 0.0, turn=-20),
            put("bottle", -0.04, 0.13, turn=30),
            ball(-0.09, -0.1, "red lacquer"),
        ],
    }
    jobs = []
    for name, objects in virtual.items():
        whole = json.loads(desk_job(shared_data, name, "diffuse", folder).read_text(encoding="utf-8"))
        for real in whole["real"][:2]:
            # Of the photo's own: where its paper clips, a known reflectance would make shadows off colour.
            real["reflectance"] = "photo"
        jobs.append(_write(folder, name, {**whole, "name": name, "virtual": objects, "frames": "0,4"}))
    return jobs


def draw_sheet(jobs: dict[str, list[Path]], sheet: Path) -> None:
    """Renders the jobs, keeping what is there, and draws all frames as a JPEG; `jobs` by their note."""
    from mrbatch import load_job, render
    from mrbatch.batch.previews import composite_of
    from mrbatch.film.preview import ContactSheet, preview_codes, write_picture

    drawn = ContactSheet("Virtual objects in real marker sets", width=360)
    for note, paths in jobs.items():
        for path in paths:
            job = load_job(path)
            render(job, report=False)
            for frame in sorted(job.output.directory.glob("*.exr")):
                number = int(frame.suffixes[0].lstrip("."))
                drawn.add(number, preview_codes(composite_of(frame)), note)
    write_picture(sheet, drawn.draw(), quality=85)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("shared_data", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--sheet", type=Path, help="JPEG to draw")
    given = parser.parse_args()
    shared_data, folder = given.shared_data.resolve(), given.folder.resolve()
    window, lamps = desk_jobs(shared_data, folder)
    jobs = {
        "ChArUco board": [charuco_job(shared_data, folder)],
        "AprilTag signs": april_jobs(shared_data, folder),
        "desk, window (Mitsuba)": [window],
        "desk, lamps (Mitsuba)": [lamps],
    }
    for path in (path for paths in jobs.values() for path in paths):
        print(path)
    if given.sheet:
        draw_sheet(jobs, given.sheet)


if __name__ == "__main__":
    main()
