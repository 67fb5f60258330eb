"""Makes everything in `data_samples/marker_video`, with the product's own path tracer. No downloads.

    python data_samples/make_marker_video.py [--output FOLDER] [--draft]

The scene is that of `configs/marker_video.yaml`. A picture of it is path traced with *all* its objects
on the virtual side: with nothing captured, the method is a plain path tracer of the whole scene. The
footage shows the real objects alone; the truth shows everything. Photo = gain x radiance, with sensor
noise, in 8-bit sRGB. The same seeds give the same files. `--draft` takes a sixteenth of the samples.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import time
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import figures
import numpy as np
import printed
import room

FOLDER = Path(__file__).resolve().parent / "marker_video"
CONFIG = Path(__file__).resolve().parent.parent / "configs" / "marker_video.yaml"

WIDTH, HEIGHT, FRAMES, RATE = 480, 270, 16, 15
MATRIX = np.array([[474.6, 0.0, 240.8], [0.0, 473.9, 133.2], [0.0, 0.0, 1.0]])
"""OpenCV's convention: pixel centres at whole numbers."""
DISTORTION = np.array([-0.082, 0.031, 0.0007, -0.0005, 0.0])
TRUTH_FRAMES = (0, 7, 15)
SEEDS, TRUTH_SPP, FOOTAGE_SPP = 4, 512, 128
"""Truth is rendered SEEDS times, each in two independent halves: their scatter is its variance."""
SHOT_NOISE, READ_NOISE = 4.5e-3, 6.0e-4
"""Standard deviation of the sensor: root of (shot^2 x signal + read^2), signal 1 where it saturates."""
CODEC_CRF = 10
VARIANCE_BLOCK = 2


def camera_path() -> list[np.ndarray]:
    """`world_from_camera` of every frame: a hand that goes a little round the desk, and is not steady."""
    poses = []
    for i in range(FRAMES):
        t = i / (FRAMES - 1)
        sway = 2.0 * np.pi * i / RATE
        ease = t * t * (3.0 - 2.0 * t)
        azimuth = np.radians(-104.0 + 23.0 * ease + 0.35 * np.sin(2.3 * sway + 0.4))
        elevation = np.radians(33.0 + 3.5 * np.sin(np.pi * t) + 0.25 * np.sin(3.1 * sway + 1.9))
        distance = 0.475 - 0.03 * ease + 0.0015 * np.sin(1.7 * sway)
        target = np.array([0.062, 0.046, 0.030]) + 0.0012 * np.array(
            [np.sin(2.9 * sway), np.sin(2.1 * sway + 1.0), np.sin(3.7 * sway + 2.0)]
        )
        toward = np.array(
            [
                np.cos(elevation) * np.cos(azimuth),
                np.cos(elevation) * np.sin(azimuth),
                np.sin(elevation),
            ]
        )
        roll = np.radians(0.8 * np.sin(1.3 * sway + 0.7))
        forward = -toward
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        down = np.cross(forward, right)
        pose = np.eye(4)
        pose[:3, 0] = np.cos(roll) * right + np.sin(roll) * down
        pose[:3, 1] = np.cos(roll) * down - np.sin(roll) * right
        pose[:3, 2] = forward
        pose[:3, 3] = target + distance * toward
        poses.append(pose)
    return poses


def write_calibration(path: Path) -> None:
    """OpenCV's FileStorage."""
    import cv2

    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    file.write("image_width", WIDTH)
    file.write("image_height", HEIGHT)
    file.write("camera_matrix", MATRIX)
    file.write("distortion_coefficients", DISTORTION.reshape(1, 5))
    file.release()


def write_still_life(folder: Path) -> None:
    """All that is not rendered."""
    from mrbatch.capture.marker_video.pose_file import save_poses

    figures.write_bunny(folder / "bunny.ply")
    figures.write_face(folder / "face.ply")
    figures.write_mug(folder / "mug.ply")
    printed.write_page(folder / "page.png")
    printed.write_table(folder / "table.jpg")
    room.write_room(folder / "environment.exr")
    write_calibration(folder / "calibration.yaml")
    save_poses(folder / "poses.json", dict(enumerate(camera_path())))


class PathTracer:
    """The sample's scene as a plain path tracer sees it: real and virtual things alike."""

    def __init__(self) -> None:
        from mrbatch.job import load_job
        from mrbatch.scene.build import build_scene

        job = load_job(CONFIG)
        self.method = job.method_object
        self.gain = np.asarray(job.capture.gain.value, dtype=np.float64)
        scene = build_scene(job.environment, job.real, job.virtual)
        self.whole = replace(scene, objects=tuple(replace(o, virtual=True) for o in scene.objects))
        self.empty = replace(
            scene, objects=tuple(replace(o, virtual=True) for o in scene.objects if not o.virtual)
        )

    def radiance(
        self, frame: int, *, whole: bool, spp: int, seeds: int, first_seed: int = 0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Photo units (h, w, 3) float64 of `spp` samples in all, and the variance of each pixel's mean.

        The variance is estimated from the scatter of 2 x `seeds` independent pictures: it knows what
        stratification gains, and pixels need the average of a neighbourhood to have it exactly.
        """
        from mrbatch.methods.estimate import estimate
        from mrbatch.scene.camera import Camera

        camera = Camera.from_opencv(WIDTH, HEIGHT, MATRIX, DISTORTION, camera_path()[frame])
        parts = []
        for number in range(seeds):
            made = estimate(
                self.method,
                self.whole if whole else self.empty,
                camera,
                spp=spp // seeds,
                gain=self.gain,
                seed=1000 * (1 + whole) + first_seed + number,
                frame=frame,
            ).developed
            if made.a.min() < 1.0:
                raise ValueError(f"frame {frame} sees past the table: make the table larger")
            parts += [half.reshape(HEIGHT, WIDTH, -1)[..., :3] for half in made.halves]
        stack = np.array(parts)
        return stack.mean(axis=0), stack.var(axis=0, ddof=1) / len(stack)


def to_photo(linear: np.ndarray, frame: int) -> np.ndarray:
    """8-bit sRGB codes (h, w, 3) of a picture in photo units, as a sensor would have given it."""
    from mrbatch.kernels.transfer import encode

    rng = np.random.default_rng([77, frame])
    deviation = np.sqrt(SHOT_NOISE**2 * linear + READ_NOISE**2)
    noisy = np.clip(linear + deviation * rng.standard_normal(linear.shape), 0.0, 1.0)
    return np.round(255.0 * encode(noisy, "srgb")).astype(np.uint8)


def to_planes(codes: np.ndarray) -> list[np.ndarray]:
    """Y', Cb, Cr of BT.709, limited range, 4:2:0 with chroma sited left, from R'G'B' codes."""
    r, g, b = np.moveaxis(codes.astype(np.float64) / 255.0, -1, 0)
    luma = 0.2126 * r + 0.7152 * g + 0.0722 * b
    planes = [16.0 + 219.0 * luma]
    for difference in ((b - luma) / 1.8556, (r - luma) / 1.5748):
        across = np.pad(difference, ((0, 0), (1, 1)), mode="edge")
        left = 0.25 * across[:, :-2] + 0.5 * across[:, 1:-1] + 0.25 * across[:, 2:]
        planes.append(128.0 + 224.0 * 0.5 * (left[0::2, 0::2] + left[1::2, 0::2]))
    return [np.round(p).astype(np.uint8) for p in planes]


def write_video(path: Path, photos: list[np.ndarray]) -> None:
    """H.264 4:2:0 in MP4, tagged BT.709 with the sRGB curve, on one thread so that bytes repeat."""
    import av

    with av.open(str(path), "w", format="mp4", options={"movflags": "+faststart"}) as file:
        options = {"crf": str(CODEC_CRF), "preset": "slow", "threads": "1", "sliced-threads": "0"}
        stream = file.add_stream("libx264", rate=RATE, options=options)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        context = stream.codec_context
        context.time_base = Fraction(1, RATE)
        context.thread_count = 1
        context.color_primaries, context.color_trc, context.colorspace, context.color_range = 1, 13, 1, 1
        for i, photo in enumerate(photos):
            frame = av.VideoFrame(WIDTH, HEIGHT, "yuv420p")
            for plane, values in zip(frame.planes, to_planes(photo)):
                rows = np.zeros((values.shape[0], plane.line_size), np.uint8)
                rows[:, : values.shape[1]] = values
                plane.update(rows.tobytes())
            frame.pts, frame.time_base = i, Fraction(1, RATE)
            file.mux(stream.encode(frame))
        file.mux(stream.encode())


def write_exr(path: Path, picture: np.ndarray) -> None:
    """Half floats, R G B."""
    import OpenImageIO as oiio

    spec = oiio.ImageSpec(picture.shape[1], picture.shape[0], 3, oiio.HALF)
    spec.attribute("compression", "piz")
    out = oiio.ImageOutput.create(str(path))
    if not out or not out.open(str(path), spec) or not out.write_image(picture.astype(np.float32)):
        raise OSError(f"cannot write {path}: {oiio.geterror()}")
    out.close()


def blocks(variance: np.ndarray) -> np.ndarray:
    """Means over VARIANCE_BLOCK x VARIANCE_BLOCK pixels; the roots of these are what half floats hold."""
    n = VARIANCE_BLOCK
    return variance.reshape(HEIGHT // n, n, WIDTH // n, n, 3).mean(axis=(1, 3))


def write_pictures(folder: Path, share: float) -> None:
    tracer = PathTracer()
    photos = []
    for frame in range(FRAMES):
        began = time.perf_counter()
        for_truth = frame in TRUTH_FRAMES
        spp, seeds = (TRUTH_SPP, SEEDS) if for_truth else (FOOTAGE_SPP, 1)
        per_seed = max(2, round(share * spp / seeds / 2) * 2)
        linear, variance = tracer.radiance(frame, whole=False, spp=per_seed * seeds, seeds=seeds)
        photos.append(to_photo(linear, frame))
        if for_truth:
            write_exr(folder / f"photo_linear_{frame:04d}.exr", linear)
            write_exr(folder / f"photo_deviation_{frame:04d}.exr", np.sqrt(blocks(variance)))
            truth, variance = tracer.radiance(frame, whole=True, spp=per_seed * seeds, seeds=seeds)
            write_exr(folder / f"truth_{frame:04d}.exr", truth)
            write_exr(folder / f"truth_deviation_{frame:04d}.exr", np.sqrt(blocks(variance)))
        print(f"frame {frame}: {time.perf_counter() - began:.0f} s, up to {linear.max():.2f}", flush=True)
    write_video(folder / "footage.mp4", photos)


def write_manifest(folder: Path) -> None:
    """Size and SHA-256 of every file."""
    files = {
        path.name: {"bytes": path.stat().st_size, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
        for path in sorted(folder.iterdir())
        if path.name != "manifest.json"
    }
    (folder / "manifest.json").write_text(json.dumps(files, indent=1) + "\n", encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--output", type=Path, default=FOLDER, help="folder for the files")
    parser.add_argument("--draft", action="store_true", help="a sixteenth of the samples")
    given = parser.parse_args()
    given.output.mkdir(parents=True, exist_ok=True)
    write_still_life(given.output)
    write_pictures(given.output, 1 / 16 if given.draft else 1.0)
    write_manifest(given.output)


if __name__ == "__main__":
    main()
