"""Smoothed poses: paths whose truth is known, with noise of known covariance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mrbatch.capture.marker_video.pose_motion import Motion, run_filter, run_smoother
from mrbatch.capture.marker_video.pose_smoothing import smooth_poses
from mrbatch.capture.marker_video.pose_table import FramePose

RATE = 25.0
SIGMA_ANGLE, SIGMA_PLACE, CORRELATION = 5e-3, 4e-3, 0.9
"""Of a 60 mm marker half a metre away: its turn and its place err together."""


def _factor():
    one = np.block([[np.eye(3), CORRELATION * np.eye(3)], [CORRELATION * np.eye(3), np.eye(3)]])
    return np.diag([SIGMA_ANGLE] * 3 + [SIGMA_PLACE] * 3) @ np.linalg.cholesky(one)


def swaying(frames, *, hertz=0.25, amplitude=1.0):
    """(n, 4, 4): a camera that looks down at the page and sways about it."""
    t = np.arange(frames) / RATE
    s, c = amplitude * np.sin(2 * np.pi * hertz * t), amplitude * np.cos(2 * np.pi * hertz * t)
    poses = np.tile(np.eye(4), (frames, 1, 1))
    turn = np.column_stack([2.5 + 0.2 * s, 0.3 * c, np.full(frames, 0.1)])
    poses[:, :3, :3] = Rotation.from_rotvec(turn).as_matrix()
    poses[:, :3, 3] = np.column_stack([0.2 * s, np.full(frames, -0.5), 0.4 + 0.1 * c])
    return poses


def measured(poses, *, seed=0, noise=1.0):
    """Rows as the solver gives them. The covariance is of the scene's turn about the camera's axes, and of
    the camera's place: w turns world_from_camera by exp(-w)."""
    factor, random = _factor(), np.random.default_rng(seed)
    rows = []
    for k, pose in enumerate(poses):
        e = noise * factor @ random.normal(size=6)
        seen = pose.copy()
        seen[:3, :3] = pose[:3, :3] @ Rotation.from_rotvec(-e[:3]).as_matrix()
        seen[:3, 3] += e[3:]
        rows.append(FramePose(k, k / RATE, seen, covariance=factor @ factor.T))
    return rows


def poses_of(rows):
    return np.array([row.world_from_camera for row in rows])


def deviations(rows, truth):
    """(n, 6): turn in the camera's axes, radians, and place, metres."""
    got = poses_of(rows)
    turn = Rotation.from_matrix(np.swapaxes(truth[:, :3, :3], 1, 2) @ got[:, :3, :3]).as_rotvec()
    return np.column_stack([turn, got[:, :3, 3] - truth[:, :3, 3]])


def rms(deviation):
    return np.array([np.sqrt(np.mean(np.sum(d**2, axis=1))) for d in (deviation[:, :3], deviation[:, 3:])])


@pytest.mark.parametrize("order", [2, 3])
def test_noise_is_halved_on_a_swaying_path(order):
    truth = swaying(150)
    rows = measured(truth)
    found = smooth_poses(rows, order=order)
    after = deviations(found.rows, truth)
    assert np.all(rms(after) < 0.5 * rms(deviations(rows, truth)))
    assert found.starts == (0,) and found.still == () and len(found.shifts) == 150
    assert len(found.far) <= 3  # one in 370 by chance
    # what is left is as large as the smoothed covariance says: chi^2 of six
    sign = np.array([-1.0, -1.0, -1.0, 1.0, 1.0, 1.0])
    z2 = [d * sign @ np.linalg.solve(r.covariance, d * sign) for d, r in zip(after, found.rows, strict=True)]
    assert 3.0 < np.mean(z2) < 12.0


def _lag(path, truth):
    """Frames by which a sinusoid of known frequency comes late, from the phase of its correlation."""
    phasor = np.exp(-2j * np.pi * 0.25 * np.arange(len(path)) / RATE)
    phase = np.angle(np.sum(truth * phasor)) - np.angle(np.sum(path * phasor))
    return phase / (2 * np.pi * 0.25) * RATE


def test_no_lag_where_a_moving_average_lags():
    truth = swaying(200)  # two periods of four seconds
    rows = measured(truth)
    x = truth[:, 0, 3]
    smoothed = poses_of(smooth_poses(rows).rows)[:, 0, 3]
    taps = 9
    padded = np.concatenate([np.full(taps - 1, rows[0].world_from_camera[0, 3]), poses_of(rows)[:, 0, 3]])
    averaged = np.convolve(padded, np.full(taps, 1 / taps), mode="valid")
    assert abs(_lag(smoothed, x)) < 0.15
    assert _lag(averaged, x) == pytest.approx((taps - 1) / 2, abs=0.3)


def test_time_reversed_film_gives_the_same_path():
    """Past and future count alike, up to the direction in which segments start."""
    rows = measured(swaying(80))
    there = poses_of(smooth_poses(rows).rows)
    back = [replace(r, time=3.2 - r.time) for r in reversed(rows)]
    again = poses_of(smooth_poses(back).rows)[::-1]
    assert np.abs(there[5:-5] - again[5:-5]).max() < 0.1 * SIGMA_PLACE


def test_a_still_camera_has_one_pose():
    truth = swaying(100, amplitude=0.0)
    rows = measured(truth)
    found = smooth_poses(rows)
    got = poses_of(found.rows)
    assert found.still == (0,)
    assert np.abs(got - got[0]).max() < 1e-9
    # a tenth of the noise is left of a hundred frames
    assert np.all(rms(deviations(found.rows, truth)) < 0.3 * rms(deviations(rows, truth)))


def test_a_slow_drift_is_not_taken_for_a_still_camera():
    truth = swaying(100, amplitude=0.0)
    truth[:, 0, 3] += np.linspace(0.0, 5 * SIGMA_PLACE, 100)
    found = smooth_poses(measured(truth))
    assert found.still == ()
    assert abs(np.ptp(poses_of(found.rows)[:, 0, 3]) / (5 * SIGMA_PLACE) - 1.0) < 0.3


@pytest.mark.parametrize("frames", [24, 100])
def test_a_cut_is_not_smeared(frames):
    truth, cut = swaying(frames), frames // 2
    truth[cut:, :3, 3] += [0.3, 0.0, 0.0]
    rows = measured(truth)
    found = smooth_poses(rows)
    assert found.starts == (0, cut)
    near = slice(cut - 2, cut + 2)
    assert np.all(rms(deviations(found.rows, truth)[near]) < 1.2 * rms(deviations(rows, truth)[near]) + 1e-3)
    # each side is what it would be if the other were not there, up to how lively the camera seems
    alone = poses_of(smooth_poses(rows[:cut]).rows)
    assert np.abs(poses_of(found.rows[:cut]) - alone).max() < SIGMA_PLACE


@pytest.mark.parametrize("sigma", [1e-6, 1e-4])
def test_a_path_known_better_than_it_can_be_foretold_is_not_cut(sigma):
    rows = [
        FramePose(k, k / RATE, pose, covariance=sigma**2 * np.eye(6)) for k, pose in enumerate(swaying(40))
    ]
    found = smooth_poses(rows)
    assert found.starts == (0,) and found.still == () and found.far == []
    assert max(shift.metres for shift in found.shifts.values()) < sigma


def test_one_wrong_pose_does_not_bend_its_neighbours():
    rows = measured(swaying(100))
    wrong = rows[40].world_from_camera.copy()
    wrong[:3, 3] += [0.3, 0.0, 0.0]
    bent = [*rows[:40], replace(rows[40], world_from_camera=wrong), *rows[41:]]
    found, before = smooth_poses(bent), smooth_poses(rows)
    assert found.starts[:2] == (0, 40)
    others = [k for k in range(100) if k != 40]
    assert np.abs(poses_of(found.rows)[others, 0, 3] - poses_of(before.rows)[others, 0, 3]).max() < 0.01


@pytest.mark.parametrize("order", [2, 3])
def test_stills_from_anywhere_stay_where_they_are(order):
    random = np.random.default_rng(1)
    truth = swaying(28)
    truth[:, :3, 3] = random.normal(0.0, 0.2, (28, 3))
    truth[:, :3, :3] = Rotation.from_rotvec(random.normal(0.0, 0.5, (28, 3))).as_matrix()
    rows = measured(truth)
    found = smooth_poses(rows, order=order)
    assert found.still == ()
    assert max(shift.metres for shift in found.shifts.values()) < 0.5 * SIGMA_PLACE


def test_a_pose_beyond_its_covariance_is_told():
    truth = swaying(100)
    rows = measured(truth)
    off = rows[50].world_from_camera.copy()
    off[:3, 3] += [0.0, 5 * SIGMA_PLACE, 0.0]
    found = smooth_poses([*rows[:50], replace(rows[50], world_from_camera=off), *rows[51:]])
    assert 50 in found.far and "moved-far" in found.rows[50].flags
    assert found.shifts[50].metres > 3 * SIGMA_PLACE
    report = found.as_json()
    assert report["mm"]["largest_frame"] == 50 and report["far"] == found.far


def test_lost_frames_are_filled_only_where_asked():
    truth = swaying(100)
    rows = measured(truth)
    for k in range(40, 46):
        rows[k] = FramePose(k, k / RATE, None, flags=("lost",))
    left = smooth_poses(rows)
    assert [r.number for r in left.rows if r.world_from_camera is None] == list(range(40, 46))
    filled = smooth_poses(rows, fill=True)
    assert filled.rows[42].flags == ("lost", "interpolated") and 42 not in filled.shifts
    assert rms(deviations(filled.rows[40:46], truth[40:46]))[1] < 2 * SIGMA_PLACE
    # less is known where nothing was seen
    assert np.trace(filled.rows[42].covariance) > np.trace(filled.rows[20].covariance)
    for a, b in zip(left.rows, filled.rows, strict=True):
        if a.world_from_camera is not None:
            np.testing.assert_array_equal(a.world_from_camera, b.world_from_camera)


def test_nothing_beyond_the_ends_and_across_cuts_is_invented():
    truth = swaying(60)
    truth[30:, 0, 3] += 0.4
    rows = measured(truth)
    for k in (0, 1, 28, 29, 58, 59):
        rows[k] = FramePose(k, k / RATE, None, flags=("lost",))
    found = smooth_poses(rows, fill=True)
    assert found.starts == (2, 30)
    assert [r.number for r in found.rows if r.world_from_camera is None] == [0, 1, 28, 29, 58, 59]


@pytest.mark.parametrize("frames", [0, 1, 2])
def test_too_few_poses_stay(frames):
    rows = measured(swaying(frames))
    found = smooth_poses(rows)
    assert found.rows == rows and found.shifts == {} and found.motion is None


def test_frames_at_one_time_do_no_harm():
    rows = [replace(r, time=min(r.time, 0.6)) for r in measured(swaying(20))]
    assert np.all(np.isfinite(poses_of(smooth_poses(rows).rows)))


def test_the_smoother_is_the_least_squares_spline():
    """Order 2 is the posterior mean of the same model written out as one linear system."""
    random = np.random.default_rng(3)
    times = np.cumsum(random.uniform(0.02, 0.06, 30))
    y, noise = random.normal(size=(30, 6)), np.tile(0.3**2 * np.eye(6), (30, 1, 1))
    y[11] = np.nan
    motion = Motion(2, np.full(6, 4.0), np.full((1, 6), 9.0))
    path, spread = run_smoother(run_filter(times, y, noise, motion, cut=False))
    # prior covariance of one coordinate about its start: a start velocity and an integrated Wiener process
    t = times - times[0]
    low = np.minimum.outer(t, t)
    high = np.maximum.outer(t, t)
    prior = 9.0 * np.outer(t, t) + 4.0 * (low**2 * high / 2 - low**3 / 6)
    prior += 1e3  # nothing is known of where it starts
    seen = np.arange(30) != 11
    gain = prior[:, seen] @ np.linalg.inv(prior[np.ix_(seen, seen)] + 0.3**2 * np.eye(29))
    np.testing.assert_allclose(path, gain @ y[seen], atol=1e-3)
    np.testing.assert_allclose(spread[:, 2, 2], np.diag(prior - gain @ prior[seen]), rtol=1e-3)
