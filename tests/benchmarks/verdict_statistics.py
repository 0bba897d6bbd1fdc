"""Figures of the verdict's calibration, from arrays alone: separation, reliability, the logistic fit and its limits."""

from dataclasses import dataclass

import numpy as np

N_BINS = 10
LEAST_IN_BIN = 30
LAPSES = 0.004
PRIOR_SPREAD = 30.0


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Bin:
    """Poles with a probability from `low` to `high`: how many, their mean probability, and the share that is true."""

    low: float
    high: float
    count: int
    said: float
    true: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Logistic:
    """p = 1 / (1 + exp(offset - slopes . x)), with the standard deviations of offset and slopes."""

    offset: float
    slopes: np.ndarray
    spread: np.ndarray

    def probability(self, features: np.ndarray) -> np.ndarray:
        """(n,) for features (n, n_features)."""
        return 1 / (1 + np.exp(self.offset - features @ self.slopes))

    def limit(self, p: float, *others: float) -> float:
        """The first feature at which the probability is p, the other features given."""
        rest = self.offset - float(np.dot(self.slopes[1:], others))
        return float((rest + np.log(p / (1 - p))) / self.slopes[0])


def separation(true: np.ndarray, score: np.ndarray) -> float:
    """Area under the receiver operating curve: how often a true pole scores above a false one, ties count half."""
    true, score = true[~np.isnan(score)], score[~np.isnan(score)]
    n_true, n_false = int(true.sum()), int((~true).sum())
    if not n_true or not n_false:
        return np.nan
    _, inverse, counts = np.unique(score, return_inverse=True, return_counts=True)
    ranks = (np.cumsum(counts) - (counts - 1) / 2)[inverse]
    return float((ranks[true].sum() - n_true * (n_true + 1) / 2) / (n_true * n_false))


def reliability(true: np.ndarray, p: np.ndarray) -> list[Bin]:
    """Ten bins of probability; a bin of fewer than 30 poles is merged with the next one (the last ones backwards)."""
    edges, members = [0.0], [np.zeros(0, dtype=int)]
    which = np.minimum((p * N_BINS).astype(int), N_BINS - 1)
    for i in range(N_BINS):
        members[-1] = np.concatenate([members[-1], np.flatnonzero(which == i)])
        if members[-1].size >= LEAST_IN_BIN:
            edges.append((i + 1) / N_BINS)
            members.append(np.zeros(0, dtype=int))
    rest = members.pop()
    if members:
        members[-1] = np.concatenate([members[-1], rest])
        edges[-1] = 1.0
    else:
        members, edges = [rest], [0.0, 1.0]
    return [
        Bin(low=low, high=high, count=own.size, said=float(p[own].mean()), true=float(true[own].mean()))
        for low, high, own in zip(edges[:-1], edges[1:], members, strict=True)
        if own.size
    ]


def fit_logistic(true: np.ndarray, features: np.ndarray) -> Logistic:
    """Maximum likelihood by Fisher's scoring, features (n, n_features).

    A share `LAPSES` of the poles is taken to tell nothing, whatever their features say: without it the few true modes
    that are hardly found again flatten the curve for all others. Each number has a normal prior of standard deviation
    30 about zero: without effect where the data speak, and finite numbers where the two kinds do not overlap at all.
    """
    X = np.column_stack([-np.ones(len(features)), features])
    prior = np.eye(X.shape[1]) / PRIOR_SPREAD**2
    theta = np.zeros(X.shape[1])
    for _ in range(500):
        told = 1 / (1 + np.exp(-X @ theta))
        p = LAPSES / 2 + (1 - LAPSES) * told
        slope = (1 - LAPSES) * told * (1 - told)
        information = (X * (slope**2 / (p * (1 - p)))[:, np.newaxis]).T @ X + prior
        step = np.linalg.solve(information, X.T @ (slope * (true - p) / (p * (1 - p))) - prior @ theta)
        theta = theta + step * min(1.0, 1.0 / np.abs(step).max())
        if np.abs(step).max() < 1e-9:
            break
    spread = np.sqrt(np.diag(np.linalg.inv(information)))
    return Logistic(offset=float(theta[0]), slopes=theta[1:], spread=spread)
