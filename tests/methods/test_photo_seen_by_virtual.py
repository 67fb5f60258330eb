"""What virtual mirrors show of the real print, and reflectances that come from a photo."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import minimum_filter

from mrbatch.methods.delta_path_tracing import METHOD as DELTA
from mrbatch.methods.delta_path_tracing.cases import delta_probe as probe
from mrbatch.methods.estimate import estimate
from mrbatch.scene.closed_forms import (
    corner,
    everything_virtual,
    lamp_sky,
    look_at,
    placed,
    real,
    scene_of,
    sky,
    virtual,
)
from mrbatch.scene.mesh import plane
from mrbatch.scene.scene import Material, SceneObject, Texture

CELLS, TEXELS = 4, 64
"""Squares along the print, and texels of each: the ramp between two squares is a texel wide."""
SIZE = 2.0
EXACT = {"strategy": "bsdf"}
"""Under an even sky every scattered ray brings the same: no noise."""


def board() -> np.ndarray:
    cells = np.indices((CELLS, CELLS)).sum(axis=0) % 2
    ink = np.where(cells, 0.8, 0.04).repeat(TEXELS, axis=0).repeat(TEXELS, axis=1)
    # One square is red, so that a mirror image cannot be taken for another.
    picture = np.repeat(ink[..., None], 3, axis=-1)
    picture[-TEXELS:, :TEXELS] = (0.8, 0.1, 0.1)
    return picture.astype(np.float32)


def print_at(x, y):
    """(n, 3) reflectance of the print at points of the floor, in float64; row 0 is at +y."""
    n = CELLS * TEXELS
    column = np.clip(np.floor((x / SIZE + 0.5) * n).astype(int), 0, n - 1)
    row = np.clip(np.floor((0.5 - y / SIZE) * n).astype(int), 0, n - 1)
    return board()[row, column].astype(np.float64)


def expected(view, mirror):
    """What the camera sees of the print, or of the print in the mirror y = 0.8 that stands on it, by 9 x 9
    rays a pixel, its corners among them: (h, w, 3) the mean, (h, w) where all agree, (h, w, 3) the middle of
    where they end."""
    offsets = np.linspace(0.0, 1.0, 9)
    k, pose = np.asarray(view.matrix), np.asarray(view.world_from_camera)
    values, points = [], []
    for dx in offsets:
        for dy in offsets:
            x = (np.arange(view.width) + dx - k[0, 2]) / k[0, 0]
            y = (np.arange(view.height) + dy - k[1, 2]) / k[1, 1]
            d = np.stack([*np.meshgrid(x, y), np.ones((view.height, view.width))], axis=-1) @ pose[:3, :3].T
            o = np.broadcast_to(pose[:3, 3], d.shape)
            if mirror:
                t = (0.8 - o[..., 1]) / d[..., 1]
                o = o + t[..., None] * d
                d = d * [1, -1, 1]
            t = np.where(d[..., 2] < 0, -o[..., 2] / np.where(d[..., 2] < 0, d[..., 2], -1), np.inf)
            with np.errstate(invalid="ignore"):
                p = o + t[..., None] * d
            on = (np.abs(p[..., 0]) < SIZE / 2) & (np.abs(p[..., 1]) < SIZE / 2) & np.isfinite(t)
            seen = print_at(np.where(on, p[..., 0], 0.0), np.where(on, p[..., 1], 0.0))
            values.append(np.where(on[..., None], seen, np.nan))
            points.append(np.where(on[..., None], p, 0.0))
    values = np.array(values)
    mean = values.mean(axis=0)
    flat = np.all(np.ptp(values, axis=0) == 0, axis=-1) & np.isfinite(mean).all(axis=-1)
    return mean, flat, np.mean(points, axis=0)


@pytest.mark.slow
@pytest.mark.case("DPT-12", "TRAP-1h")
@pytest.mark.parametrize("source", ["texture", "photo"])
def test_a_mirror_shows_the_print_on_the_table(source):
    """A perfect upright mirror takes no light from a table under an even sky, so what it shows of the table
    is the photo's own light: the print, in its place to a fraction of a pixel, to one per cent."""
    table = replace(real("table", plane(SIZE, SIZE)), material=Material(texture=Texture(board())))
    glass = placed(plane(SIZE, 1.0), at=(0, 0.8, 0.5), normal=(0, -1, 0))
    mirror = SceneObject("mirror", glass, Material("conductor", (1.0,) * 3, 0.0), True)
    view = look_at((0.15, -1.6, 1.1), (0, 0.4, 0.1), width=128, height=112, focal=128)
    photo, direct, _ = expected(view, False)
    photo = np.nan_to_num(photo, nan=0.0).astype(np.float32)
    if source == "photo":
        table = replace(table, material=Material(from_photo=True))
    found = estimate(
        DELTA, scene_of([table, mirror]), view, spp=32, background=photo, settings=EXACT
    ).developed
    wanted, flat, points = expected(view, True)
    inside = found.a == 1
    flat &= inside
    off = np.abs(found.P - wanted).max(axis=-1)
    # A pixel in from the edges, whose ramp is a texel wide; in the photo, whose pixels are the grain, too.
    flat = minimum_filter(flat, 3)
    if source == "photo":
        # What the camera does not see directly takes the mean of its surface.
        at = view.project(points.reshape(-1, 3))[0].reshape(*flat.shape, 2)
        flat &= np.all((at > 8) & (at < [view.width - 8, view.height - 8]), axis=-1)
        column, row = np.where(flat[..., None], at, 0).astype(int).transpose(2, 0, 1)
        flat &= minimum_filter(direct, 7)[row, column]
    assert flat.sum() > 100
    assert np.all(off[flat] < 0.01 * wanted[flat].max(axis=-1) + 1e-3)
    red = flat & (wanted[..., 0] > 0.5) & (wanted[..., 1] < 0.2)
    if source == "texture":
        assert red.sum() > 3
        # Edges too: half a pixel off would differ by half of the contrast there.
        edges = inside & np.isfinite(wanted).all(axis=-1) & ~flat
        assert np.sqrt(np.mean((found.P - wanted)[edges] ** 2)) < 0.06
    # Printed: the virtual paper has one albedo, and the mirror shows a blank sheet.
    blank = float(photo[photo.any(axis=-1)].mean())
    assert np.median(np.abs(wanted[flat] - blank)) > 0.2
    # Nor does the table change.
    assert np.abs(found.D.mean()) < 1e-3


@pytest.mark.slow
@pytest.mark.case("MC-07")
def test_the_ratio_of_photo_and_irradiance_has_no_bias():
    """L_b dE / E_r with E_r by 256 pairs of samples, over many seeds: within a thousandth of dE by the true
    reflectance. With an E_r by few samples the mean of 1 / E_r is not 1 / E_r."""
    light = lamp_sky()
    base = corner(0.5, size=8.0)
    # Not quite flat, so that its irradiance has no closed form.
    vertices = base[0].mesh.vertices.copy()
    vertices[0, 2] -= 1e-5
    floor = replace(base[0], mesh=replace(base[0].mesh, vertices=vertices, normals=None))
    lid = virtual("lid", plane(0.6, 0.6, centre=(0.8, 0, 0.4)), 0.0, camera=False)
    view = look_at((0.9, 0, 1.5), (0.9, 0, 0), width=8, height=8, focal=8 * 2**12)
    shown = everything_virtual([floor, base[1]])
    photo = np.full((8, 8, 3), 1.0, np.float32)
    photo *= np.mean(
        [estimate(DELTA, scene_of(shown, light), view, spp=16384, seed=90).developed.P.mean(axis=(0, 1))],
        axis=0,
    )
    truth = probe(scene_of([floor, base[1], lid], light), (0.9, 0, 0), distance=1.5, spp=8192, seed=70)
    seen = replace(floor, material=Material(from_photo=True))
    found = [
        estimate(
            DELTA, scene_of([seen, base[1], lid], light), view, spp=512, seed=k, background=photo
        ).developed.D.mean(axis=(0, 1))
        for k in range(12)
    ]
    mean, error = np.mean(found, axis=0), np.std(found, axis=0, ddof=1) / np.sqrt(12)
    assert np.all(truth.delta < -0.03)
    room = 4 * np.hypot(error, truth.delta_error) + 1e-3 * np.abs(truth.delta)
    assert np.all(np.abs(mean - truth.delta) < room)
    assert np.all(room < 0.015 * np.abs(truth.delta))


@pytest.mark.case("TRAP-3b")
def test_one_albedo_for_ink_and_paper_would_make_the_ink_black():
    """Paper .8, ink .04, half of the sky taken: ink keeps half of its light; less .4 it would have none."""
    dark = np.full((8, 8, 3), 0.04, np.float32)
    paper = real("paper", plane(2.0**12, 2.0**12), 0.8)
    half = placed(plane(2.0**12, 2.0**12), at=(-0.01, 0, 2.0**11), normal=(1, 0, 0))
    wall = virtual("wall", half, 0.0, camera=False)
    view = look_at((0, 0, 0.5), (0, 0, 0), width=8, height=8, focal=8 * 2**12)
    printed = estimate(DELTA, scene_of([paper, wall], sky()), view, spp=256, background=dark).developed.D
    assert np.all(dark + printed < -0.3)
    from_photo = replace(paper, material=Material(from_photo=True))
    ours = estimate(DELTA, scene_of([from_photo, wall], sky()), view, spp=256, background=dark).developed.D
    assert ours.mean() == pytest.approx(-0.02, rel=3e-3)
