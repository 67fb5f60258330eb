"""How far each filter takes the noise down on a plane, where its weights are known."""

from __future__ import annotations

import numpy as np
import pytest
from filter_frames import apply, real_frame

H, W = 40, 60


def test_noise_of_an_even_change_falls_as_the_window_lets_it():
    """25 Gaussian weights of 1.5 pixels: the variance of independent noise is divided by 1 / sum w^2."""
    frame = real_frame(np.full((H, W), -0.3), noise=0.05)
    g = np.exp(-0.5 * (np.arange(-2, 3) / 1.5) ** 2)
    least = np.sum(np.outer(g, g) ** 2) / g.sum() ** 4
    inner = np.s_[4:-4, 4:-4, 0]
    before = np.var(frame[0].D[inner])
    after = np.var(apply("bilateral", frame).D[inner])
    assert after / before < 1.8 * least < 0.1
    assert after / before > 0.9 * least


@pytest.mark.parametrize("kind", ["bilateral", "variance", "oidn"])
def test_noise_falls_and_error_with_it_where_there_is_a_shadow_too(kind):
    """A soft shadow beside a sharp one, with the noise of few samples: the error to the truth, not the noise
    alone, is down to less than half."""
    y, x = np.mgrid[:80, :120]
    light = -0.4 * np.exp(-0.5 * ((x - 40) / 12) ** 2) - np.where((x > 85) & (x < 100), 0.3, 0.0)
    before, after = [], []
    for seed in range(4):
        frame = real_frame(light, noise=0.06, seed=seed, skew=True)
        before.append(frame[0].D[..., 0] - 0.8 * light)
        after.append(apply(kind, frame).D[..., 0] - 0.8 * light)
    rms = np.sqrt(np.mean(np.square(after)) / np.mean(np.square(before)))
    assert rms < {"bilateral": 0.45, "variance": 0.4, "oidn": 0.4}[kind]
