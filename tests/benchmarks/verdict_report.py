"""The calibration of the verdict in Markdown, from the lines of `verdict_calibration.py`, and the figures in it.

The figures come from arrays alone: separation, reliability, the logistic fit and its limits.
"""

import itertools
import re
from collections import Counter
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


ACCEPTED_FROM = 0.8
REFUSED_BELOW = 0.1
CHANCE_BELOW = 0.1
"""Overlap with the true mode's pulse response below which only the frequency was hit, by chance."""
LEAST_GAIN = 1e-4
"""Held-out gain that counts as none; its logarithm is evidence."""
TYPICAL_LOG_GAIN = -0.5
DAMPING_SHARE, DAMPING_ABSOLUTE = 0.5, 0.004
INDICATORS = {
    "repeatability": "repeatability r",
    "probability": "probability",
    "emac": "EMAC",
    "amplitude_coherence": "amplitude coherence",
    "cmi": "CMI",
    "phase_collinearity": "phase collinearity",
    "msv": "mode singular value",
}
RUNS = {"automatic": "automatic order", "larger": "larger order"}


def report(lines):
    """All tables of one set of identifications."""
    poles = [{**pole, "run": line["run"]} for line in lines for pole in line.get("poles", ())]
    sections = [head(lines, poles), acceptance(lines, poles), bins(poles), fit(poles), missed(lines), damping(lines)]
    return "\n\n".join((*sections, classical(poles)))


# --- sections --------------------------------------------------------------------------------------------------------


def head(lines, poles):
    seeds = sorted({line["seed"] for line in lines})
    failed = Counter(line["error"].split(":")[0] for line in lines if "error" in line)
    seconds = np.mean([line["seconds"] for line in lines])
    versions = sorted({line["code"] for line in lines})
    words = [
        f"{len(seeds)} structures (seeds {seeds[0]} to {seeds[-1]}), {len(lines)} identifications of "
        f"{seconds:.1f} CPU-s on average, sources {', '.join(versions)}"
        + ("; **more than one version of the code**." if len(versions) > 1 else ".")
    ]
    if failed:
        words.append(f"Ended with an error: {', '.join(f'{count} {name}' for name, count in failed.items())}.")
    rows = []
    for run, name in RUNS.items():
        for label in ("system", "grey", "noise", "hum"):
            own = [pole for pole in poles if pole["run"] == run and pole["label"] == label]
            verdicts = Counter(pole["verdict"] for pole in own)
            likely = sum(_number(pole["probability"]) >= ACCEPTED_FROM for pole in own)
            counts = [verdicts[word] for word in ("system", "doubtful", "noise")]
            rows.append([name, label, len(own), *counts, likely])
    table = _table(["run", "truth", "poles", "system", "doubtful", "noise", f"p >= {ACCEPTED_FROM}"], rows)
    return "\n".join([*words, "", table])


def acceptance(lines, poles):
    rows = []
    for run in (*RUNS, None):
        own = [pole for pole in poles if run in (None, pole["run"])]
        if not own:
            continue
        sure = [pole for pole in own if pole["label"] != "grey"]
        p, true = _column(sure, "probability"), _true(sure)
        found = [pole for pole in own if pole["label"] == "system"]
        alike = [pole for pole in found if pole["overlap_with_truth"] >= CHANCE_BELOW]
        n_lines = sum(len(line["hum"]) for line in lines if run in (None, line["run"]) and "poles" in line)
        likely = [pole for pole in own if _number(pole["probability"]) >= ACCEPTED_FROM]
        called = [pole for pole in own if pole["verdict"] == "system"]
        rows.append(
            [
                RUNS.get(run, "both"),
                f"{separation(true, p):.4f}",
                *(_false(accepted) for accepted in (likely, called)),
                _share(found, lambda pole: pole["verdict"] == "noise"),
                _share(alike, lambda pole: pole["verdict"] == "noise"),
                f"{sum(pole['label'] == 'hum' for pole in called)} of {n_lines}",
                f"{sum(pole['label'] == 'hum' for pole in likely)}",
            ]
        )
    titles = [
        "run",
        "AUC of p",
        f"false at p >= {ACCEPTED_FROM} (existence alone)",
        'false "system" (existence alone)',
        "found modes called noise",
        "the same without chance hits",
        "hum called system",
        f"hum at p >= {ACCEPTED_FROM}",
    ]
    note = (
        '"False" counts accepted poles that are not the match of a true mode; "existence alone" lets a pole within 5 % '
        "of a true mode's frequency pass. A chance hit has the frequency of a true mode and less than "
        f"{CHANCE_BELOW} of its pulse response."
    )
    return f"{_table(titles, rows)}\n\n{note}"


def bins(poles):
    """Reliability of the probability as it is told."""
    parts = []
    for run in (*RUNS, None):
        own = [pole for pole in poles if pole["label"] != "grey" and run in (None, pole["run"])]
        own = [pole for pole in own if pole["probability"] is not None]
        if own:
            parts.append(_reliability_table(RUNS.get(run, "both"), _true(own), _column(own, "probability")))
    return "Reliability of the probability as it is told:\n\n" + "\n\n".join(parts)


def fit(poles):
    """The numbers by maximum likelihood; growing poles and hum have rules of their own and are left out."""
    sure = [pole for pole in poles if pole["label"] in ("system", "noise") and pole["repeatability"] is not None]
    sure = [pole for pole in sure if pole["kind"] in ("oscillatory", "real")]
    r = _column(sure, "repeatability")
    parts = [_fit_table("r alone", sure, r[:, np.newaxis])]
    if any(pole.get("gain") is not None for pole in sure):
        gain = np.clip(np.nan_to_num(_column(sure, "gain")), LEAST_GAIN, 1.0)
        parts.append(_fit_table("r and the gain", sure, np.column_stack([r, np.log10(gain)])))
    return "\n\n".join(parts)


def _fit_table(name, sure, features):
    others, rows, true = (TYPICAL_LOG_GAIN,) * (features.shape[1] - 1), [], _true(sure)
    for run in (*RUNS, None):
        own = np.array([run in (None, pole["run"]) for pole in sure], dtype=bool)
        if true[own].all() or not true[own].any():
            continue
        found = fit_logistic(true[own], features[own])
        terms = " ".join(f"- {slope:.2f} {x}" for slope, x in zip(found.slopes, ("r", "log10 gain"), strict=False))
        numbers = f"1 / (1 + exp({found.offset:.2f} {terms}))"
        limits = [f"{found.limit(p, *others):.3f}" for p in (ACCEPTED_FROM, REFUSED_BELOW)]
        spread = ", ".join(f"{s:.2f}" for s in found.spread)
        rows.append([RUNS.get(run, "both"), int(own.sum()), numbers, spread, *limits])
    limit = "r at p" + (f" (gain {10**TYPICAL_LOG_GAIN:.2f})" if others else "")
    titles = ["run", "poles", "p", "standard deviations", f"{limit} = {ACCEPTED_FROM}", f"{limit} = {REFUSED_BELOW}"]
    text = f"The numbers that these poles give by maximum likelihood, {name}:\n\n{_table(titles, rows)}"
    if rows:  # `found` is the fit of both runs together
        told = _reliability_table(f"both, these numbers, {name}", true, found.probability(features))
        text = f"{text}\n\n{told}"
    return text


def missed(lines):
    """What became of the true modes, by how far they stand above the noise."""
    edges, rows = (0.0, 0.1, 0.25, 0.5, 1.0, 4.0, np.inf), []
    for run, name in RUNS.items():
        fates = []
        for line in lines:
            if line["run"] == run and "poles" in line:
                verdict = {pole["true_mode"]: pole["verdict"] for pole in line["poles"]}
                fates += [(mode["mode_to_noise"], verdict.get(i, "none")) for i, mode in enumerate(line["modes"])]
        for low, high in itertools.pairwise(edges):
            own = Counter(fate for ratio, fate in fates if low <= ratio < high)
            if own:
                counts = [own[word] for word in ("system", "doubtful", "noise", "none")]
                rows.append([name, f"{low:g} to {high:g}", own.total(), *counts])
    titles = ["run", "own response / noise, best output", "true modes", "system", "doubtful", "called noise", "no pole"]
    return f"What became of the true modes:\n\n{_table(titles, rows)}"


def damping(lines):
    rows = []
    for run, name in RUNS.items():
        wrong, marked, right, right_marked = 0, 0, 0, 0
        for line in lines:
            for pole in line.get("poles", ()):
                if line["run"] != run or pole["label"] != "system" or pole["verdict"] == "noise":
                    continue
                true = line["modes"][pole["true_mode"]]["damping_ratio"]
                error = abs(pole["damping_ratio"] - true)
                if error > max(DAMPING_SHARE * true, DAMPING_ABSOLUTE):
                    wrong, marked = wrong + 1, marked + (not pole["damping_resolved"])
                else:
                    right, right_marked = right + 1, right_marked + (not pole["damping_resolved"])
        rows.append([name, wrong + right, wrong, marked, wrong - marked, right_marked])
    titles = ["run", "found modes", "damping wrong", "marked unresolved", "wrong, not marked", "right, but marked"]
    words = f"Damping (wrong: off by more than {100 * DAMPING_SHARE:.0f} % and {DAMPING_ABSOLUTE}):"
    return f"{words}\n\n{_table(titles, rows)}"


def classical(poles):
    """Each indicator alone, on the same poles."""
    rows = []
    for key, name in INDICATORS.items():
        row = [name]
        for run in (*RUNS, None):
            own = [pole for pole in poles if pole["label"] != "grey" and run in (None, pole["run"])]
            row.append(f"{separation(_true(own), _column(own, key)):.4f}")
        rows.append(row)
    return f"AUC of each figure alone:\n\n{_table(['figure', *RUNS.values(), 'both'], rows)}"


# --- helpers ---------------------------------------------------------------------------------------------------------


def _reliability_table(title, true, p):
    found = reliability(true, p)
    rows = [
        [f"{b.low:.1f} to {b.high:.1f}", b.count, f"{b.said:.3f}", f"{b.true:.3f}", f"{b.true - b.said:+.3f}"]
        for b in found
    ]
    return _table([f"p ({title})", "poles", "said", "true", "apart"], rows)


def _false(accepted):
    if not accepted:
        return "-"
    strict = sum(pole["label"] != "system" for pole in accepted)
    loose = sum(pole["label"] in ("noise", "hum") for pole in accepted)
    n = len(accepted)
    return f"{strict} of {n}, {100 * strict / n:.1f} % ({loose}, {100 * loose / n:.1f} %)"


def _share(poles, rule):
    hits = sum(map(rule, poles))
    return f"{hits} of {len(poles)}, {100 * hits / max(1, len(poles)):.1f} %"


def _true(poles):
    return np.array([pole["label"] == "system" for pole in poles], dtype=bool)


def _column(poles, key):
    return np.array([_number(pole[key]) for pole in poles], dtype=float)


def _number(value):
    return np.nan if value is None else float(value)


def _table(titles, rows):
    text = [f"| {' | '.join(map(str, row))} |" for row in (titles, ["---"] * len(titles), *rows)]
    return re.sub(r"\bnan\b", "-", "\n".join(text))
