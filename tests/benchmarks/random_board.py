"""The random problems: every contender on every noise realisation, its scores, and the table of them."""

import json
from dataclasses import dataclass

import numpy as np
from crb import cramer_rao_bound
from environments import run_tasks
from random_problems import random_problem
from scoring import claimed_modes, continued_fit, false_modes, fit, match, matrix, spectral_radius, tolerance

WITHIN_REACH = 3.0
"""A mode is within reach where the tolerance is at least so many bounds of its frequency: no unbiased estimate finds
the others reliably."""
MOST_BOUNDS = 9.0
"""An error of more bounds counts as missed: another mode, or noise, was taken for this one."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Case:
    """A problem, its bound, and the file of tasks for the contenders."""

    problem: object
    bound: object
    tasks_path: object
    n_realisations: int


def prepare(seed, n_realisations, work):
    problem = random_problem(seed)
    training = slice(0, problem.n_training)
    bound = cramer_rao_bound(
        problem.system, problem.inputs[training], initial_state=problem.initial_state, noise_std=problem.noise_std
    )
    path = work / "problems" / f"{seed}_{n_realisations}.npz"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        order, dt = problem.system.order, problem.system.dt
        tasks = [{"records": [["u", f"y{i}"]], "dt": dt, "order": order} for i in range(n_realisations)]
        outputs = {f"y{i}": problem.noisy(i)[training] for i in range(n_realisations)}
        np.savez(path, u=problem.inputs[training], tasks=json.dumps(tasks), **outputs)
    return Case(problem=problem, bound=bound, tasks_path=path, n_realisations=n_realisations)


def contend(cases, name, setting, work):
    """The scores of every realisation of each case, kept beside the models so that they are made once."""
    folder = work / "runs" / "random"
    jobs = [
        (case.tasks_path, folder / str(case.problem.seed) / f"{name}, {setting}.jsonl", case.n_realisations)
        for case in cases
    ]
    models = run_tasks(name, setting, jobs, work=work)
    return [scored(case, results, own) for case, (_, results, _), own in zip(cases, jobs, models, strict=True)]


def scored(case, results, models):
    kept = results.with_suffix(".scores.json")
    if kept.exists() and kept.stat().st_mtime >= results.stat().st_mtime:
        scores = json.loads(kept.read_text())
        if len(scores) >= case.n_realisations:
            return scores[: case.n_realisations]
    scores = [score(case, i, model) for i, model in enumerate(models)]
    kept.write_text(json.dumps(scores))
    return scores


def score(case, realisation, model):
    """One model: its modes against the truth, its held-out free run against the ceiling."""
    if "failure" in model:
        return {"failure": model["failure"], "cpu": model.get("cpu", np.nan)}
    system = case.problem.system
    claimed = claimed_modes(model)
    found = match(claimed, system.frequencies, system.damping_ratios)
    held_out, ceiling = held_out_fit(case, realisation, model)
    return {
        "found": [
            None
            if mode is None
            else {
                "frequency": mode.frequency - system.frequencies[i],
                "damping_ratio": mode.damping_ratio - system.damping_ratios[i],
                "frequency_std": mode.frequency_std,
                "damping_ratio_std": mode.damping_ratio_std,
                "certain": mode.certain,
                "damping_resolved": mode.damping_resolved,
            }
            for i, mode in enumerate(found)
        ],
        "false": [[mode.frequency, mode.damping_ratio] for mode in false_modes(claimed, system.frequencies)],
        "order": len(matrix(model["A"])),
        "radius": spectral_radius(matrix(model["A"])),
        "fit": held_out,
        "ceiling": ceiling,
        "cpu": model["cpu"],
    }


def held_out_fit(case, realisation, model):
    """The fit and its ceiling, the run of the true system on the same noisy rows; in the band of the model."""
    problem = case.problem
    inputs, outputs, clean, n_training = problem.inputs, problem.noisy(realisation), problem.clean, problem.n_training
    factor = round(model["dt"] / problem.system.dt)
    if factor > 1:
        inputs, outputs, clean, n_training = in_band(inputs, outputs, clean, n_training, factor)
    rows = slice(n_training, None)
    held_out = continued_fit(model, inputs, outputs, state_rows=slice(0, n_training), scored_rows=rows)
    return held_out, fit(outputs[rows], clean[rows])


def in_band(inputs, outputs, clean, n_training, factor):
    """The same rows through the decimation that a contender chose (only ours chooses one)."""
    from okid.record import Record

    record, true = (Record(inputs, part, 1.0).decimated(factor) for part in (outputs, clean))
    first = int(np.ceil((n_training - record.start_time) / factor))
    return record.inputs, record.outputs, true.outputs, first


# --- the figures of one contender ------------------------------------------------------------------------------------


def figures(cases, scores):
    """What the table shows, from the scores of each case."""
    pairs = [(case, one) for case, own in zip(cases, scores, strict=True) for one in own]
    good = [(case, one) for case, one in pairs if "failure" not in one]
    n_true = sum(len(case.bound.frequency_std) for case, _ in pairs)
    reachable = [within_reach(case) for case in cases]
    n_reachable = sum(int(reach.sum()) * len(own) for reach, own in zip(reachable, scores, strict=True))
    hits = [(case, i, mode) for case, one in good for i, mode in enumerate(one["found"]) if mode is not None]
    n_hits = sum(bool(within_reach(case)[i]) for case, i, _ in hits)
    fits = [mean_gap(own) for own in scores]
    return {
        "systems": len(cases),
        "models": len(pairs),
        "failed": len(pairs) - len(good),
        "why": sorted({one["failure"] for _, one in pairs if "failure" in one})[:3],
        "found": len(hits) / n_true,
        "found_in_reach": n_hits / n_reachable,
        "certain": sum(mode["certain"] for _, _, mode in hits) / n_true,
        "false": sum(len(one["false"]) for _, one in good),
        "frequency": ratio_over_bound(cases, scores, "frequency"),
        "damping_ratio": ratio_over_bound(cases, scores, "damping_ratio"),
        "wrong_damping": sum(bool(wrong_damping(case, i, mode)) for case, i, mode in hits),
        "near_ceiling": sum(bool(gap <= 0.01) for gap in fits) if np.isfinite(fits).any() else None,
        "unstable": sum(one["radius"] >= 1.0 for _, one in good),
        "diverged": sum(one["fit"] is not None and one["fit"] < 0 for _, one in good),
        "coverage": {key: coverage(hits, key) for key in ("frequency", "damping_ratio")},
        "cpu": float(np.median([one["cpu"] for _, one in good])) if good else None,
    }


def within_reach(case):
    system = case.problem.system
    limits = [tolerance(f, z) for f, z in zip(system.frequencies, system.damping_ratios, strict=True)]
    return WITHIN_REACH * case.bound.frequency_std <= np.array(limits)


def ratio_over_bound(cases, scores, key):
    """Errors over their bounds, of all modes, systems and realisations.

    Returns:
        "rms": root of the mean of (error / bound)^2; "std": its standard error by systems, whose errors are not
        independent of each other; "beyond": errors of more than 9 bounds, which count as missed; "median": of the
        systems' own rms, biased low where a system has few realisations; "n": errors that count.
    """
    squares, counts, beyond = [], [], 0
    for case, own in zip(cases, scores, strict=True):
        bounds = getattr(case.bound, f"{key}_std")
        found = [(i, mode) for one in own if "failure" not in one for i, mode in enumerate(one["found"]) if mode]
        ratios = np.array([mode[key] / bounds[i] for i, mode in found])
        counted = np.abs(ratios) <= MOST_BOUNDS
        beyond += int((~counted).sum())
        squares.append(float(np.sum(ratios[counted] ** 2)))
        counts.append(int(counted.sum()))
    squares, counts = np.array(squares), np.array(counts)
    if not counts.any():
        return None
    mean = squares.sum() / counts.sum()
    n_systems = int((counts > 0).sum())
    scatter = np.sum((squares - mean * counts) ** 2) * n_systems / max(n_systems - 1, 1)
    return {
        "rms": float(np.sqrt(mean)),
        "std": float(np.sqrt(scatter / mean) / (2 * counts.sum())) if n_systems > 1 else None,
        "median": float(np.median(np.sqrt(squares[counts > 0] / counts[counts > 0]))),
        "beyond": beyond,
        "n": int(counts.sum()),
    }


def sweep_score(cases, scores):
    """One figure for a setting: rms of error / bound, frequency and damping together; 9 where missed or beyond."""
    ratios = []
    for case, own in zip(cases, scores, strict=True):
        bounds = np.array([case.bound.frequency_std, case.bound.damping_ratio_std]).T
        for one in own:
            modes = [None] * len(bounds) if "failure" in one else one["found"]
            for bound, mode in zip(bounds, modes, strict=True):
                errors = np.inf if mode is None else np.array([mode["frequency"], mode["damping_ratio"]])
                ratios.append(np.minimum(np.abs(errors) / bound, MOST_BOUNDS))
    return float(np.sqrt(np.mean(np.square(ratios))))


def mean_gap(own):
    """Ceiling less fit, mean over realisations; infinite where one failed."""
    if any("failure" in one for one in own):
        return np.inf
    gaps = [one["ceiling"] - one["fit"] for one in own]
    return float(np.mean(gaps))


def wrong_damping(case, i, mode):
    off = abs(mode["damping_ratio"])
    return off > 0.5 * case.problem.system.damping_ratios[i] and off > 0.004 and mode["damping_resolved"]


def coverage(hits, key):
    """Share of 95 % intervals that hold the truth, and how many there are; modes without an interval are counted."""
    errors = np.array([[mode[key], mode[f"{key}_std"]] for _, _, mode in hits], dtype=float).reshape(-1, 2)
    there = np.isfinite(errors[:, 1])
    inside = np.abs(errors[there, 0]) <= 1.96 * errors[there, 1]
    return {"share": float(inside.mean()) if there.any() else None, "n": int(there.sum()), "none": int((~there).sum())}
