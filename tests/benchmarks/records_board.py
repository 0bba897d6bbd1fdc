"""Measured records: the continued fit of ours and of two subspace peers on the same rows, in the same band.

Each sub-folder has an `about.json` that says which channels are inputs and which outputs. One file: its first 75 % of
rows train, the rest is scored. Several files of one system: all but the last train, the last is scored.

Ours sees the training records as they are and chooses its band; the peers get the same records decimated to that band
and their means taken off. A peer's order is chosen among `ORDERS` by its continued fit on the last third of the
training rows (on the last training record where there are several), then all training rows are fitted with it; a peer
that takes one record only gets the last of several. For everybody: the means of the training rows are taken off the
scored record, one free run, its initial state by least squares on the training rows of that record, or, with several
records, on its first 10 %.
"""

import json
from dataclasses import dataclass, replace

import numpy as np
from environments import run_tasks
from scoring import continued_fit, matrix, spectral_radius

from okid.readers import read_record
from okid.record import Record

TRAINING_SHARE = 0.75
SEPARATE = {"process_records"}
"""Folders whose files are different systems."""
GROUPS = {
    "flexible_robot": {
        "flexible_robot": [f"sweep_{i}.csv" for i in range(1, 6)],
        "flexible_robot, scored on the step": [*(f"sweep_{i}.csv" for i in range(1, 6)), "step_1.csv"],
    }
}
"""Folders of which the files make more than one problem."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MeasuredProblem:
    """`training` and `scored` overlap in no scored row: `n_training` rows of `scored` belong to the training (one
    file), or none do (several)."""

    name: str
    training: tuple[Record, ...]
    scored: Record
    n_training: int


def measured_problems(folder):
    """(problems, {name: why not}) of every sub-folder with an about.json."""
    problems, left_out = [], {}
    for about_path in sorted(folder.glob("*/about.json")):
        about = json.loads(about_path.read_text())
        name = about_path.parent.name
        channels = about if "inputs" in about else next(iter(about.get("channel_sets", {}).values()), {})
        files = [
            file
            for file, entry in about["files"].items()
            if isinstance(entry, dict) and _holds(entry.get("columns"), channels)
        ]
        if not channels.get("inputs") or not files:
            left_out[name] = "no input is stated, or no file with named columns, so there is no free run"
            continue
        for case, members in groups(name, files).items():
            records = [_read(about_path.parent / file, about["files"][file], channels) for file in members]
            problems.append(_problem(case, records))
    return problems, left_out


def groups(name, files):
    if name in GROUPS:
        return GROUPS[name]
    return {file.removesuffix(".csv"): [file] for file in files} if name in SEPARATE else {name: files}


def _holds(columns, channels):
    """Whether a file has the channels that are stated, and not only the same under names of its own."""
    names = {column.split(" [")[0] for column in columns} if isinstance(columns, list) else set()
    return {*channels.get("inputs", ()), *channels.get("outputs", ())} <= names


def _read(path, entry, channels):
    has_time = any(column.startswith("time") for column in entry["columns"])
    return read_record(path, inputs=channels["inputs"], outputs=channels["outputs"], dt=None if has_time else 1.0)


def _problem(name, records):
    if len(records) > 1:
        return MeasuredProblem(name=name, training=tuple(records[:-1]), scored=records[-1], n_training=0)
    (record,) = records
    n_training = round(TRAINING_SHARE * record.n_samples)
    return MeasuredProblem(name=name, training=(record.samples(0, n_training),), scored=record, n_training=n_training)


ORDERS = (2, 4, 6, 8, 10, 12, 16, 20, 26, 32)
SETTINGS = {"ours": "defaults", "slicot": "to suit", "sippy": "to suit"}
CPU_LIMIT = 60
STATE_SHARE = 0.1
TAKE_SEVERAL = {"ours", "slicot"}


def contend(problem, peers, work):
    """One row of the table: our fit and, in our band, that of each peer."""
    folder = work / "runs" / "records" / problem.name
    (mine,) = _models("ours", [(problem.training, 0)], stem=folder / "ours", dt=problem.scored.dt, work=work)
    row = {
        "name": problem.name,
        "n_samples": [problem.n_training, problem.scored.n_samples - problem.n_training]
        if problem.n_training
        else [sum(record.n_samples for record in problem.training), problem.scored.n_samples],
        "n_inputs": problem.scored.n_inputs,
        "n_outputs": problem.scored.n_outputs,
    }
    # where ours fails, the peers run at the full rate
    factor = round(mine.get("dt", problem.scored.dt) / problem.scored.dt)
    training = [record.decimated(factor).detrended(0) for record in problem.training]
    inputs, outputs, state_rows, scored_rows = _scored(problem, factor)
    score = {"state_rows": state_rows, "scored_rows": scored_rows}
    row["factor"] = factor
    if "failure" in mine:
        row["ours"] = {"failure": mine["failure"]}
    else:
        row["ours"] = _own_figures(mine, continued_fit(mine, inputs, outputs, **score))
    for name in peers:
        try:
            model, order = _peer_model(name, training, folder / f"{name}_by_{factor}", work)
            row[name] = {"fit": continued_fit(model, inputs, outputs, **score), "order": order}
        except ValueError as failure:
            row[name] = {"failure": str(failure)}
    return row


def _peer_model(name, training, folder, work):
    """The model of all training rows with the order that a part of them chose; ValueError where there is none."""
    used = training if name in TAKE_SEVERAL else training[-1:]
    order = _choose_order(name, used, folder, work)
    (model,) = _models(name, [(used, order)], stem=folder / f"all_{order}", dt=training[0].dt, work=work)
    if "failure" in model:
        raise ValueError(model["failure"])
    return model, order


def _own_figures(model, fit):
    verdicts = [mode["verdict"] for mode in model["modes"]]
    return {
        "fit": fit,
        "order": len(matrix(model["A"])),
        "radius": spectral_radius(matrix(model["A"])),
        "own_fit": model["own_fit"],
        "system_modes": [mode["frequency"] for mode in model["modes"] if mode["verdict"] == "system"],
        "doubtful": verdicts.count("doubtful"),
        "warnings": len(model["warnings"]),
        "cpu": model["cpu"],
    }


def _scored(problem, factor):
    """Inputs and outputs of the scored record in the band, less the means of the training; the two sets of rows."""
    record = problem.scored.decimated(factor)
    parts = [replace(part, start_time=0.0).decimated(factor) for part in problem.training]
    into, out = (
        np.nanmean(np.concatenate([getattr(part, kind) for part in parts]), axis=0) for kind in ("inputs", "outputs")
    )
    if problem.n_training:
        lost = (problem.scored.n_samples - record.n_samples * factor) // 2  # to the filter, at either end
        edge = (problem.n_training - lost) // factor
        # the filter's last rows before the edge saw samples from beyond it
        state_rows, scored_rows = slice(0, edge - (10 if factor > 1 else 0)), slice(edge + 1, None)
    else:
        edge = round(STATE_SHARE * record.n_samples)
        state_rows, scored_rows = slice(0, edge), slice(edge, None)
    return record.inputs - into, record.outputs - out, state_rows, scored_rows


def _choose_order(name, training, folder, work):
    """The order whose model of a part of the training runs best through the rest of it."""
    if len(training) > 1:
        part, last = training[:-1], training[-1]
        edge = round(STATE_SHARE * last.n_samples)
    else:
        (last,) = training
        edge = last.n_samples * 2 // 3
        part = [last.samples(0, edge)]
    models = _models(name, [(part, order) for order in ORDERS], stem=folder / "part", dt=last.dt, work=work)
    fits = [
        continued_fit(model, last.inputs, last.outputs, state_rows=slice(0, edge), scored_rows=slice(edge, None))
        if "failure" not in model
        else -np.inf
        for model in models
    ]
    if not np.isfinite(fits).any():
        raise ValueError(next((model["failure"] for model in models if "failure" in model), "diverges at every order"))
    return ORDERS[int(np.nanargmax(fits))]


def _models(name, wanted, *, stem, dt, work):
    """One model for each (records, order)."""
    stem.parent.mkdir(parents=True, exist_ok=True)
    tasks_path = stem.with_name(stem.name + ".npz")
    if not tasks_path.exists():
        arrays, keys = {}, {}
        for records, _ in wanted:
            for record in records:
                if id(record) not in keys:
                    keys[id(record)] = [f"u{len(keys)}", f"y{len(keys)}"]
                    arrays |= dict(zip(keys[id(record)], (record.inputs, record.outputs), strict=True))
        tasks = [
            {"records": [keys[id(record)] for record in records], "dt": dt, "order": order, "cpu_limit": CPU_LIMIT}
            for records, order in wanted
        ]
        np.savez(tasks_path, tasks=json.dumps(tasks), **arrays)
    (models,) = run_tasks(
        name, SETTINGS[name], [(tasks_path, stem.with_name(stem.name + ".jsonl"), len(wanted))], work=work
    )
    return models
