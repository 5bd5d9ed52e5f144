"""Soft sensors of the angle without physics: each learns from what may be fitted, and says how many numbers it has."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from validation.peers.joints import Course, Floats

_SEED = 0
_POINTS = 500
"""Points of a Gaussian process, drawn from what may be fitted."""
LAGS_S = tuple(np.arange(0.0, 0.51, 0.04))
_GP_LAGS_S = (0.0, 0.1, 0.3)
_EPOCHS, _BATCH, _WINDOW_S, _HIDDEN = 60, 16, 2.0, 64
_PENALTIES = tuple(10.0 ** np.arange(-6.0, 3.0))


@dataclass(frozen=True)
class Sensed:
    """What a soft sensor says of the held-out courses."""

    angle: list[Floats]  # of each course (N,) [rad]
    std: list[Floats] | None  # of each, or None where it gives none
    numbers: int  # that were fitted or kept


Sensor = Callable[[Sequence[Course], Sequence[Course]], Sensed]


def late(one: Course, lags_s: Sequence[float]) -> Floats:
    """Inputs of now and of earlier; before an episode begins they are as at its begin."""
    at = np.arange(len(one.angle))
    return np.column_stack([one.inputs[np.maximum(at - round(lag / one.period), one.first)] for lag in lags_s])


def least_squares(
    lags_s: Sequence[float] = (0.0,), penalties: Sequence[float] = (0.0,), pressures_alone: bool = False
) -> Sensor:
    """Ridge regression from inputs of now and of earlier; the penalty is chosen on the last fifth."""

    def features(one: Course) -> Floats:
        return late(replace(one, inputs=one.inputs[:, :2]) if pressures_alone else one, lags_s)

    def sensor(fit: Sequence[Course], held: Sequence[Course]) -> Sensed:
        x, y = np.vstack([features(one) for one in fit]), np.concatenate([one.angle for one in fit])
        scale = x.std(axis=0) + 1e-9

        def solved(rows: slice, penalty: float) -> tuple[Floats, float]:
            middle, offset = x[rows].mean(axis=0), float(y[rows].mean())
            z = (x[rows] - middle) / scale
            gram = z.T @ z + penalty * len(z) * np.eye(z.shape[1])
            weights = np.linalg.lstsq(gram, z.T @ (y[rows] - offset), rcond=1e-12)[0] / scale
            return weights, offset - float(middle @ weights)

        def error(penalty: float) -> float:
            first = int(0.8 * len(y))
            weights, offset = solved(slice(first), penalty)
            return float(np.mean((x[first:] @ weights + offset - y[first:]) ** 2))

        best = penalties[0] if len(penalties) == 1 else min(penalties, key=error)
        weights, offset = solved(slice(None), best)
        return Sensed([features(one) @ weights + offset for one in held], None, len(weights) + 1)

    return sensor


linear = least_squares(pressures_alone=True)
lagged = least_squares(LAGS_S, _PENALTIES)


def gaussian_process(fit: Sequence[Course], held: Sequence[Course]) -> Sensed:
    """A Gaussian process from the inputs at three times, by scikit-learn."""
    x, y = np.vstack([late(one, _GP_LAGS_S) for one in fit]), np.concatenate([one.angle for one in fit])
    sensor = Process(x, y)
    said = [sensor(late(one, _GP_LAGS_S)) for one in held]
    return Sensed([mean for mean, _ in said], [std for _, std in said], min(len(x), _POINTS) * x.shape[1])


class Process:
    """A Gaussian process of scikit-learn, with a length for each feature, in the features' own scales."""

    def __init__(self, x: Floats, y: Floats, points: int = _POINTS) -> None:
        from sklearn.gaussian_process import GaussianProcessRegressor
        from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

        chosen = np.random.default_rng(_SEED).permutation(len(x))[:points]
        middle, scale, offset, size = x.mean(axis=0), x.std(axis=0) + 1e-9, float(y.mean()), float(y.std()) + 1e-12
        kernel = ConstantKernel(1.0) * RBF(np.full(x.shape[1], 3.0), (0.1, 1e3)) + WhiteKernel(1e-3, (1e-8, 1.0))
        self.scales = middle, scale, offset, size
        self.gp = GaussianProcessRegressor(kernel, random_state=_SEED)
        self.gp.fit((x[chosen] - middle) / scale, (y[chosen] - offset) / size)

    def __call__(self, x: Floats) -> tuple[Floats, Floats]:
        """Mean and standard deviation."""
        middle, scale, offset, size = self.scales
        pieces = np.array_split((x - middle) / scale, 1 + len(x) // 4096)
        parts = [self.gp.predict(piece, return_std=True) for piece in pieces]
        mean, std = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
        return mean * size + offset, std * size

    def mean(self, x: Floats) -> Floats:
        """The mean alone, which is quick for few rows."""
        middle, scale, offset, size = self.scales
        signal = self.gp.kernel_.k1
        apart = (((x - middle) / scale)[:, None, :] - self.gp.X_train_) / signal.k2.length_scale
        return signal.k1.constant_value * np.exp(-0.5 * np.sum(apart**2, axis=2)) @ self.gp.alpha_ * size + offset


def _drawn(rng: np.random.Generator, count: int, weights: Floats | None) -> np.ndarray:
    return rng.integers(0, count, _BATCH) if weights is None else rng.choice(count, _BATCH, p=weights)


def recurrent(
    fit: Sequence[Course], held: Sequence[Course], seed: int = _SEED, weights: Floats | None = None
) -> Sensed:
    """A gated recurrent network of two layers of 64 (torch), from all inputs; for episodes also the first angle.

    `weights`: probability with which each window or episode is drawn in a step (E,); None: all alike.
    """
    import torch

    torch.manual_seed(seed)
    torch.set_num_threads(1)
    x = np.vstack([one.inputs for one in fit])
    middle, scale, size = x.mean(axis=0), x.std(axis=0) + 1e-9, float(np.concatenate([one.angle for one in fit]).std())
    episodes = any(len(np.unique(one.first)) > 1 for one in (*fit, *held))
    window = round(_WINDOW_S / fit[0].period)

    def sequences(one: Course, length: int) -> list[tuple[Floats, Floats]]:
        """Windows of a course; with episodes, each of them."""
        known = [one.angle[one.first, None] / size] if episodes else []
        inputs, angle = np.hstack([(one.inputs - middle) / scale, *known]), one.angle[:, None] / size
        bounds = np.unique(one.first).tolist() if episodes else range(0, max(len(angle) - length, 1), length)
        cuts = [*bounds, len(angle)] if episodes else [*bounds, bounds[-1] + length]
        return [(inputs[a:b], angle[a:b]) for a, b in zip(cuts[:-1], cuts[1:], strict=True)]

    class Network(torch.nn.Module):  # type: ignore[misc,name-defined]
        def __init__(self, features: int) -> None:
            super().__init__()
            self.memory = torch.nn.GRU(features, _HIDDEN, 2, batch_first=True)
            self.out = torch.nn.Linear(_HIDDEN, 1)

        def forward(self, signals: torch.Tensor) -> torch.Tensor:
            return self.out(self.memory(signals)[0])

    pairs = [pair for one in fit for pair in sequences(one, window)]
    network = Network(pairs[0][0].shape[1])
    steps = _EPOCHS * (1 + len(pairs) // _BATCH)
    optimizer = torch.optim.Adam(network.parameters(), 3e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 5e-3, total_steps=steps)
    rng, settled = np.random.default_rng(seed), 0 if episodes else window // 5
    for _ in range(steps):
        batch = [pairs[k] for k in _drawn(rng, len(pairs), weights)]
        longest = max(len(a) for a, _ in batch)
        padded = [np.stack([np.pad(p[k], ((0, longest - len(p[k])), (0, 0))) for p in batch]) for k in (0, 1)]
        signals, wanted = (torch.tensor(part, dtype=torch.float32) for part in padded)
        mask = torch.tensor([[settled <= i < len(a) for i in range(longest)] for a, _ in batch])
        loss = ((network(signals) - wanted)[..., 0] ** 2)[mask].mean()
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        schedule.step()
    with torch.no_grad():
        said = [
            np.concatenate([network(torch.tensor(a[None], dtype=torch.float32))[0, :, 0].numpy() * size for a, _ in
                            sequences(one, len(one.angle))])
            for one in held
        ]  # fmt: skip
    return Sensed(said, None, sum(p.numel() for p in network.parameters()))
