"""Where several tags lie relative to each other, found from the shot itself.

A first guess is spread from the origin tag through the pictures that show two tags together; then all
tags and all cameras are adjusted at once so that the corners' reprojection errors are least (bundle
adjustment, Triggs et al. 2000; robust loss, sparse Jacobian).
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np

from mrbatch.capture.marker_video.calibration import Calibration
from mrbatch.capture.marker_video.markers import Detection
from mrbatch.capture.marker_video.pose_solver import exponential, invert, project, solve
from mrbatch.capture.marker_video.target_settings import TagsSettings
from mrbatch.errors import InputError, Place

_MOVED = 3.0
"""Error in pixels, and ..."""
_MOVED_SHARE = 0.05
"""... share of a tag's side in the picture: beyond both a sighting is off."""
_MOVED_SIGHTINGS = 0.2
"""Share of sightings that are off from which on the tags are not fixed to each other."""
_SWEEPS = 4
_MOST_PICTURES = 60
"""Bundle adjustment takes at most so many pictures, spread over the shot."""


def place(detection: Detection, layout: dict[int, np.ndarray]) -> Detection:
    """Points moved from their tags' frames into the world; tags without a place are left out."""
    known = np.isin(detection.ids, list(layout))
    points = detection.points_3d[known]
    ids = detection.ids[known]
    placed = np.array(
        [layout[int(i)][:3, :3] @ p + layout[int(i)][:3, 3] for i, p in zip(ids, points, strict=True)]
    ).reshape(-1, 3)
    keep = np.repeat(known, 2)
    return replace(
        detection,
        points_2d=detection.points_2d[known],
        points_3d=placed,
        ids=ids,
        covariance=detection.covariance[np.ix_(keep, keep)],
    )


def _one_tag(detection: Detection, tag: int) -> Detection:
    return place(detection, {tag: np.eye(4)})


def estimate_layout(
    looked: list[tuple[int, Detection]], calibration: Calibration, settings: TagsSettings
) -> dict[int, np.ndarray]:
    """world_from_tag (4, 4) by id; the origin tag's is the identity.

    `looked`: frame number and what was detected there, points in their tags' frames. Raises
    InputError: the origin is never seen, or tags moved between the pictures.
    """
    counts = Counter(int(i) for _, d in looked for i in np.unique(d.ids))
    origin = settings.origin
    if origin is None:
        origin = min(counts, key=lambda i: (-counts[i], i))
    if origin not in counts:
        raise InputError(
            f"the origin tag {origin} is seen in none of the {len(looked)} frames",
            hint=f"seen are {', '.join(map(str, sorted(counts)))}",
        )
    pictures = [(n, d) for n, d in looked if len(d)]
    if len(pictures) > _MOST_PICTURES:
        pick = np.unique(np.linspace(0, len(pictures) - 1, _MOST_PICTURES).round().astype(int))
        pictures = [pictures[i] for i in pick]
    scene = _Scene(pictures, calibration, origin)
    scene.spread()
    if len(scene.tags) > 1:
        scene.adjust()
        scene.check_fixed()
    return dict(sorted(scene.tags.items()))


class _Scene:
    """Tags and cameras as far as they are known."""

    def __init__(self, pictures: list[tuple[int, Detection]], calibration: Calibration, origin: int):
        self.pictures = pictures
        self.calibration = calibration
        self.origin = origin
        self.tags: dict[int, np.ndarray] = {origin: np.eye(4)}
        self.cameras: dict[int, np.ndarray] = {}
        """camera_from_world by index of the picture."""
        self.ids = [sorted(int(i) for i in np.unique(d.ids)) for _, d in pictures]
        self.points = [
            {i: (d.points_3d[d.ids == i], d.points_2d[d.ids == i]) for i in ids}
            for (_, d), ids in zip(pictures, self.ids, strict=True)
        ]
        # camera_from_tag of every root of every tag in every picture
        self.roots = [
            {i: [invert(r.world_from_camera) for r in solve(_one_tag(d, i), calibration)] for i in ids}
            for (_, d), ids in zip(pictures, self.ids, strict=True)
        ]

    def error(self, picture: int, tag: int, camera_from_tag: np.ndarray) -> float:
        """Robust squared reprojection error of one tag in one picture, px^2."""
        points_3d, points_2d = self.points[picture][tag]
        if np.any(points_3d @ camera_from_tag[2, :3] + camera_from_tag[2, 3] <= 0):
            return 1e4
        pixels = project(points_3d, camera_from_tag, self.calibration)[0]
        return float(np.minimum(np.sum((pixels - points_2d) ** 2, axis=1), 1e4).mean())

    def spread(self) -> None:
        """Places tags and cameras in turn; later sweeps choose again with more known."""
        for _ in range(_SWEEPS):
            for _ in range(len(self.pictures) + 1):
                grown = self._place_cameras() + self._place_tags()
                if not grown:
                    break
            self._choose_again()

    def _place_cameras(self) -> int:
        """Cameras of pictures that show a known tag: the candidate that explains all known tags best."""
        new = 0
        for picture in range(len(self.pictures)):
            if picture in self.cameras:
                continue
            best = self._best_camera(picture)
            if best is not None:
                self.cameras[picture] = best
                new += 1
        return new

    def _best_camera(self, picture: int) -> np.ndarray | None:
        known = [i for i in self.ids[picture] if i in self.tags]
        candidates = [root @ invert(self.tags[i]) for i in known for root in self.roots[picture][i]]
        if not candidates:
            return None
        costs = [sum(self.error(picture, i, c @ self.tags[i]) for i in known) for c in candidates]
        return candidates[int(np.argmin(costs))]

    def _place_tags(self) -> int:
        """The unknown tag that most known cameras see."""
        seen = Counter(i for p in self.cameras for i in self.ids[p] if i not in self.tags)
        if not seen:
            return 0
        tag = min(seen, key=lambda i: (-seen[i], i))
        placed = self._best_tag(tag)
        if placed is None:
            return 0
        self.tags[tag] = placed
        return 1

    def _best_tag(self, tag: int) -> np.ndarray | None:
        where = [p for p in self.cameras if tag in self.ids[p]]
        candidates = [invert(self.cameras[p]) @ root for p in where for root in self.roots[p][tag]]
        if not candidates:
            return None
        costs = [sum(self.error(p, tag, self.cameras[p] @ c) for p in where) for c in candidates]
        return candidates[int(np.argmin(costs))]

    def _choose_again(self) -> None:
        for picture in list(self.cameras):
            best = self._best_camera(picture)
            if best is not None:
                self.cameras[picture] = best
        for tag in list(self.tags):
            if tag != self.origin:
                best = self._best_tag(tag)
                if best is not None:
                    self.tags[tag] = best

    def adjust(self) -> None:
        """All tags but the origin and all cameras at once."""
        from scipy.optimize import least_squares
        from scipy.sparse import lil_matrix

        free = [i for i in self.tags if i != self.origin]
        shots = sorted(self.cameras)
        pairs = [(p, i) for p in shots for i in self.ids[p] if i in self.tags]
        column = {("tag", i): 6 * k for k, i in enumerate(free)}
        column |= {("camera", p): 6 * (len(free) + k) for k, p in enumerate(shots)}
        pattern = lil_matrix((8 * len(pairs), 6 * (len(free) + len(shots))), dtype=np.int8)
        for k, (p, i) in enumerate(pairs):
            for key in (("tag", i), ("camera", p)):
                if key in column:
                    pattern[8 * k : 8 * k + 8, column[key] : column[key] + 6] = 1
        tags, cameras = dict(self.tags), dict(self.cameras)

        def moved(base: np.ndarray, x: np.ndarray, key) -> np.ndarray:
            if key not in column:
                return base
            step = x[column[key] : column[key] + 6]
            pose = base.copy()
            pose[:3, :3] = base[:3, :3] @ exponential(step[:3])
            pose[:3, 3] = base[:3, 3] + step[3:]
            return pose

        def residuals(x: np.ndarray) -> np.ndarray:
            placed = {i: moved(tags[i], x, ("tag", i)) for i in tags}
            out = []
            for p in shots:
                camera = moved(cameras[p], x, ("camera", p))
                for i in self.ids[p]:
                    if i in tags:
                        points_3d, points_2d = self.points[p][i]
                        pixels = project(points_3d, camera @ placed[i], self.calibration)[0]
                        out.append((pixels - points_2d).ravel())
            return np.concatenate(out)

        found = least_squares(
            residuals,
            np.zeros(pattern.shape[1]),
            jac_sparsity=pattern,
            loss="soft_l1",
            f_scale=0.5,
            x_scale="jac",
            method="trf",
            max_nfev=60,
        )
        self.tags = {i: moved(tags[i], found.x, ("tag", i)) for i in tags}
        self.cameras = {p: moved(cameras[p], found.x, ("camera", p)) for p in shots}

    def check_fixed(self) -> None:
        """Raises InputError naming the worst tag where the tags cannot all have stayed in their places."""
        errors: dict[int, list[float]] = {}
        sides: list[float] = []
        for p, camera in self.cameras.items():
            for i in self.ids[p]:
                if i in self.tags:
                    errors.setdefault(i, []).append(np.sqrt(self.error(p, i, camera @ self.tags[i])))
                    quad = self.points[p][i][1]
                    sides.append(float(np.linalg.norm(np.roll(quad, 1, axis=0) - quad, axis=1).mean()))
        every = [e for each in errors.values() for e in each]
        off = np.array(every) > max(_MOVED, _MOVED_SHARE * float(np.median(sides)))
        if off.mean() > _MOVED_SIGHTINGS:
            worst = max(errors, key=lambda i: (np.mean(errors[i]), i))
            at = max(
                (p for p in self.cameras if worst in self.ids[p]),
                key=lambda p: self.error(p, worst, self.cameras[p] @ self.tags[worst]),
            )
            raise InputError(
                f"the tags do not keep their places: tag {worst} is off by "
                f"{np.mean(errors[worst]):.1f} pixels (mean)",
                place=Place(frame=self.pictures[at][0]),
                hint="tags must not move during the shot; use a single tag as `marker` otherwise",
            )
