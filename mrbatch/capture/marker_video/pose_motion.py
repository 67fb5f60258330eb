"""How a camera moves from frame to frame, and the best estimate of its path under that model.

The tangent path y (6 numbers a frame: turned angle about the camera's axes, place in the world) is the
integral of white noise, `order` times over: its velocity (2) or its acceleration (3) wanders. The forward
filter is Kalman's, the backward pass Rauch, Tung and Striebel's (1965); together they are the exact
posterior mean, which of order 2 is the cubic smoothing spline (Wahba 1978; Kohn and Ansley 1987), and
has no lag: past and future count alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial

import numpy as np
from scipy.optimize import minimize
from scipy.stats import chi2

CUT = float(chi2.isf(1e-12, 6))
"""Squared innovation, in units of its covariance, from which on a frame does not continue the path: chance
alone does that once in 10^12 frames."""
_TRACKING_INDICES = (-6.0, -4.0, -2.0, 0.0, 2.0, 4.0, 6.0, 8.0)
"""log10 of process noise over sigma^2 / dt^(2 order - 1), where the search for the likeliest begins."""


@dataclass(frozen=True)
class Motion:
    """A model of motion. `order`: how often noise is integrated; 1 with no noise is a still camera.

    `noise` (6,): spectral density of the noise, unit^2 / s^(2 order - 1). `spread` (order - 1, 6): prior
    variance of the path's derivatives at the start of a segment, unit^2 / s^(2 j). Units: radians, metres.
    """

    order: int
    noise: np.ndarray
    spread: np.ndarray

    def step(self, dt: float) -> tuple[np.ndarray, np.ndarray]:
        """Transition F and covariance Q of what is added, both (6 order, 6 order), over `dt` seconds."""
        n = self.order
        f, q = np.zeros((n, n)), np.zeros((n, n))
        for i in range(n):
            for j in range(n):
                if j >= i:
                    f[i, j] = dt ** (j - i) / factorial(j - i)
                a, b = n - 1 - i, n - 1 - j
                q[i, j] = dt ** (a + b + 1) / ((a + b + 1) * factorial(a) * factorial(b))
        return np.kron(f, np.eye(6)), np.kron(q, np.diag(self.noise))

    def start(self, y: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """State (6 order,) and covariance of a segment's first frame: nothing is known but what is seen."""
        state, p = np.zeros(6 * self.order), np.zeros((6 * self.order, 6 * self.order))
        state[:6], p[:6, :6] = y, covariance
        p[6:, 6:] = np.diag(self.spread.ravel())
        return state, p


@dataclass
class Filtered:
    """What the filter keeps of each frame, for the backward pass.

    `states`, `covariances`: after the frame; `predicted`, `predicted_covariances`: before it, None where a
    segment starts. `transitions`: F into the frame. `starts`: indices of the segments' first frames.
    `cost`: -2 log likelihood of the innovations; where it is cut, of `CUT` and a pose anywhere in the shot.
    """

    states: list[np.ndarray]
    covariances: list[np.ndarray]
    predicted: list[np.ndarray | None]
    predicted_covariances: list[np.ndarray | None]
    transitions: list[np.ndarray | None]
    starts: list[int]
    cost: float = 0.0


def run_filter(
    times: np.ndarray, y: np.ndarray, covariances: np.ndarray, motion: Motion, *, cut: bool = True
) -> Filtered:
    """Forward pass. `times` (n,) seconds, rising; `y` (n, 6), NaN where nothing was measured, but not in the
    first frame; `covariances` (n, 6, 6).

    With `cut`, a frame whose innovation is beyond `CUT` starts a new segment.
    """
    state, p = motion.start(y[0], covariances[0])
    out = Filtered([state], [p], [None], [None], [None], [0])
    steps: dict[float, tuple[np.ndarray, np.ndarray]] = {}
    eye = np.eye(6 * motion.order)
    seen = ~np.isnan(y[:, 0])
    # A cut may lead anywhere in the shot: else cutting all the time would be the likeliest account of a path
    # that is known far better than it can be foretold.
    anywhere = float(np.linalg.slogdet(np.cov(y[seen].T) + covariances[seen].mean(axis=0))[1]) if cut else 0.0
    for k in range(1, len(times)):
        dt = float(times[k] - times[k - 1])
        if dt not in steps:
            steps[dt] = motion.step(dt)
        f, q = steps[dt]
        ahead, before = f @ state, f @ p @ f.T + q
        predicted: tuple[np.ndarray | None, ...] = (ahead, before, f)
        if np.isnan(y[k, 0]):
            state, p = ahead, before
        else:
            innovation, s = y[k] - ahead[:6], before[:6, :6] + covariances[k]
            solved = np.linalg.solve(s, np.column_stack([innovation, before[:6]]))
            distance = float(innovation @ solved[:, 0])
            if cut and distance > CUT:
                out.cost += CUT + anywhere
                state, p = motion.start(y[k], covariances[k])
                out.starts.append(k)
                predicted = (None, None, None)
            else:
                out.cost += distance + float(np.linalg.slogdet(s)[1])
                gain = solved[:, 1:].T
                state = ahead + gain @ innovation
                rest = eye.copy()
                rest[:, :6] -= gain
                p = rest @ before @ rest.T + gain @ covariances[k] @ gain.T  # Joseph's form: stays positive
        for kept, value in zip(
            (out.predicted, out.predicted_covariances, out.transitions), predicted, strict=True
        ):
            kept.append(value)
        out.states.append(state)
        out.covariances.append(p)
    return out


def run_smoother(filtered: Filtered) -> tuple[np.ndarray, np.ndarray]:
    """Backward pass: the path (n, 6) given all of its segment, and its covariance (n, 6, 6)."""
    state, p = filtered.states[-1], filtered.covariances[-1]
    path, spread = [state[:6]], [p[:6, :6]]
    for k in range(len(filtered.states) - 2, -1, -1):
        f, before = filtered.transitions[k + 1], filtered.predicted_covariances[k + 1]
        own_state, own_p = filtered.states[k], filtered.covariances[k]
        if f is None or before is None:
            state, p = own_state, own_p
        else:
            # Variances of angles, places and speeds differ by many powers of ten.
            scale = 1.0 / np.sqrt(np.diag(before))
            gain = np.linalg.solve(before * np.outer(scale, scale), (f @ own_p) * scale[:, None]).T * scale
            state = own_state + gain @ (state - filtered.predicted[k + 1])
            p = own_p + gain @ (p - before) @ gain.T
            p = 0.5 * (p + p.T)
        path.append(state[:6])
        spread.append(p[:6, :6])
    return np.array(path[::-1]), np.array(spread[::-1])


def likeliest_motion(
    times: np.ndarray, y: np.ndarray, covariances: np.ndarray, order: int, *, near: Motion | None = None
) -> Motion:
    """The noise, one of turning and one of moving, under which the innovations are likeliest.

    The prior of velocity (and acceleration) at starts is what the shot's own frames show. `near`: a first
    guess. Arguments as of `run_filter`.
    """
    seen = ~np.isnan(y[:, 0])
    t, path, variances = times[seen], y[seen], np.diagonal(covariances[seen], axis1=1, axis2=2)
    dt = float(np.median(np.diff(t)))
    scale = [float(np.median(variances[:, part].mean(axis=1))) for part in (slice(0, 3), slice(3, 6))]
    spread, rate, at = [], path, t
    for _ in range(order - 1):
        if len(rate) > 1:
            rate, at = np.diff(rate, axis=0) / np.diff(at)[:, None], 0.5 * (at[1:] + at[:-1])
        squares = [np.sum(rate[:, part] ** 2, axis=1) / 3.0 for part in (slice(0, 3), slice(3, 6))]
        # Cuts are seldom, so they do not reach the nine tenths.
        usual = [
            max(float(np.quantile(s, 0.9)), 1e-6 * c / dt**2) for s, c in zip(squares, scale, strict=True)
        ]
        spread.append(np.repeat(usual, 3))
    unit = [c / dt ** (2 * order - 1) for c in scale]

    def motion(exponents: np.ndarray) -> Motion:
        noise = [u * 10.0**e for u, e in zip(unit, np.clip(exponents, -10.0, 14.0), strict=True)]
        return Motion(order, np.repeat(noise, 3), np.array(spread))

    def cost(exponents: np.ndarray) -> float:
        return run_filter(times, y, covariances, motion(exponents)).cost

    if near is None:
        first = min((np.array([e, e]) for e in _TRACKING_INDICES), key=cost)
    else:
        first = np.log10(near.noise[[0, 3]] / unit)
    simplex = first + np.array([[0.0, 0.0], [1.5, 0.0], [0.0, 1.5]])
    found = minimize(
        cost,
        first,
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "xatol": 0.05, "fatol": 0.05, "maxfev": 60},
    )
    return motion(found.x)


STILL = Motion(1, np.zeros(6), np.zeros((0, 6)))
"""A camera that does not move."""
