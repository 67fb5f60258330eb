"""One call from a scene in memory to a method's estimate: for tests, hard cases and benches."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mrbatch.contracts import Method
from mrbatch.device.rays import resolve_engine
from mrbatch.device.runner import Runner
from mrbatch.device.timing import TimingNode
from mrbatch.effects.facts import FrameFacts, ShotFacts
from mrbatch.effects.plan import Plan, make_plan
from mrbatch.film.accumulator import Developed
from mrbatch.film.outputs import Outputs, ViewInput, ViewOutput
from mrbatch.film.rendering import FrameRenderer, Look, Source
from mrbatch.film.window import Window
from mrbatch.scene.camera import Camera
from mrbatch.scene.moment import Moment
from mrbatch.scene.scene import Scene
from mrbatch.scene.scene_data import upload


@dataclass(frozen=True)
class Estimated:
    """A method's estimate of one frame, the plan it followed, and the work it took."""

    developed: Developed
    plan: Plan
    timing: TimingNode
    background: np.ndarray

    @property
    def counters(self) -> dict[str, int]:
        return self.timing.total_counters()


def on_window(picture: np.ndarray, window: Window) -> np.ndarray:
    """What of a picture (H, W, 3) lies on a window (h, w, 3), black beyond its edges."""
    rows = np.arange(window.y, window.y + window.height)
    columns = np.arange(window.x, window.x + window.width)
    inside = np.ix_((rows >= 0) & (rows < picture.shape[0]), (columns >= 0) & (columns < picture.shape[1]))
    out = np.zeros((window.height, window.width, 3), picture.dtype)
    out[inside] = picture[
        np.ix_(np.clip(rows, 0, picture.shape[0] - 1), np.clip(columns, 0, picture.shape[1] - 1))
    ][inside]
    return out


def estimate(
    method: Method,
    scene: Scene,
    camera: Camera,
    *,
    settings: Mapping[str, Any] | None = None,
    spp: int = 64,
    background: np.ndarray | None = None,
    gain: Iterable[float] = (1.0, 1.0, 1.0),
    needs: Iterable[str] = (),
    forced: Mapping[str, str] | None = None,
    half_code: float = 0.0,
    seed: int = 0,
    frame: int = 0,
    moments: Sequence[Moment] = (),
    window: Window | None = None,
    engine: str = "auto",
    threads: int | None = None,
    units_per_launch: int | None = None,
) -> Estimated:
    """Renders one frame with one view.

    `settings`: of the method, without its name. `background`: the photo (camera.height, camera.width, 3),
    or what of it lies on the data window (h, w, 3); black where None, and beyond the photo. `half_code`
    as in `ShotFacts`. `moments`: at which scene and camera (of the view `""`) are looked at while the shutter
    is open.
    """
    whole = Window(0, 0, camera.width, camera.height)
    window = window or whole
    model = method.settings(name=method.name, spp=spp, **(settings or {}))
    b = np.zeros((window.height, window.width, 3), np.float32)
    photo = None
    if background is not None:
        b = background
        if b.shape[:2] == (whole.height, whole.width) and window != whole:
            photo, b = background, on_window(background, window)
    g = np.asarray(tuple(gain), dtype=np.float64)
    facts = ShotFacts(
        scene=scene,
        frames=(FrameFacts(frame, {"": camera}, {"": g}, tuple(moments)),),
        windows={"": window},
        settings=model,
        layers=frozenset(needs),
        half_code=half_code,
    )
    plan = make_plan(method.rules, facts, forced or {})
    resolved = resolve_engine(engine)  # type: ignore[arg-type]
    view = ViewOutput(
        "",
        0,
        window,
        camera.model,
        bool(np.any(camera.distortion != 0.0)),
        picture=None if photo is None else whole,
    )
    blurred = plan.does("motion-blur")
    outputs = Outputs(
        (view,),
        frozenset(needs),
        seed,
        resolved,
        lens=plan.does("depth-of-field"),
        shutter=blurred,
    )
    device = upload(scene, resolved)
    pipeline = method.build(device, plan, model, outputs)
    device.show(frame)
    timing = TimingNode(method.name)
    with Runner(threads, units_per_launch=units_per_launch) as runner:
        renderer = FrameRenderer(runner, [Source("method", pipeline)], outputs, timing)
        given = ViewInput(camera, b, g, photo=photo)
        looks = [
            Look(
                lambda moment=moment: device.show(moment.time, frame),  # type: ignore[misc]
                {"": replace(given, camera=moment.cameras[""], frame_camera=camera)},
            )
            for moment in (moments if blurred else ())
        ]
        rendered = renderer.render(
            frame,
            {"": given},
            spp,
            tiles={"": plan.tiles[frame, ""]},
            seen={"": plan.seen[frame, ""]},
            looks=looks,
        )
    return Estimated(rendered.estimates[""]["method"], plan, timing, b)
