"""The measured records of a folder, as problems of simulation: training records, and the one that is scored.

Each sub-folder has an `about.json` that says which channels are inputs and which outputs. One file: its first 75 % of
rows train, the rest is scored. Several files of one system: all but the last train, the last is scored.
"""

import json
from dataclasses import dataclass

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
            if isinstance(entry, dict) and isinstance(entry.get("columns"), list)
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


def _read(path, entry, channels):
    has_time = any(column.startswith("time") for column in entry["columns"])
    return read_record(path, inputs=channels["inputs"], outputs=channels["outputs"], dt=None if has_time else 1.0)


def _problem(name, records):
    if len(records) > 1:
        return MeasuredProblem(name=name, training=tuple(records[:-1]), scored=records[-1], n_training=0)
    (record,) = records
    n_training = round(TRAINING_SHARE * record.n_samples)
    return MeasuredProblem(name=name, training=(record.samples(0, n_training),), scored=record, n_training=n_training)
