"""Every public error path of a session, walked: one sentence with the rule, what was met, and what to do.

    python tests/contracts/test_error_paths.py

prints the table.
"""

import json
import re
import tempfile
from pathlib import Path

import numpy as np
import pytest

import era
import modal
import okid
from modal.command.main import status

RNG = np.random.default_rng(5)
FORCE, TIP = RNG.standard_normal((2, 60))
RECORD = okid.Record(FORCE, TIP, 0.1, name="run", input_names=["force"], output_names=["tip"])
AMBIENT = okid.Record([], TIP, 0.1)
MARKOV = okid.MarkovParameters(system=0.9 ** np.arange(20.0).reshape(20, 1, 1), dt=0.1)
MODEL = era.realise(MARKOV, order=1)
CHAIN = modal.StructuralModel.chain([1.0], [4.0], [0.1], force_dofs=[0], sensor_dofs=[0], sensor_kind="acceleration")
TABLE = okid.FrequencyResponse(np.ones((9, 1, 1), complex), np.arange(9.0))
SHAPES = modal.Shapes([[1.0], [0.5]], ["a", "b"])
CUBIC = {"k3": 1.0}


def text(name, words):
    """A file with these words, or bytes."""
    Path(name).write_bytes(words if isinstance(words, bytes) else words.encode())
    return name


def archive(name, **arrays):
    np.savez(name, **arrays)
    return name


def chain(**other):
    given = {"masses": [1.0], "stiffnesses": [4.0], "dampings": [0.1], "force_dofs": [0], "sensor_dofs": [0]}
    return modal.StructuralModel.chain(**{**given, "sensor_kind": "acceleration", **other})


def model_file(name="a.json", **given):
    return modal.read_model(text(name, json.dumps(given)))


def lines(*rows):
    return "".join(f"{row}\n" for row in rows)


ROWS = lines("time,force,tip", *(f"{0.1 * k:.1f},{FORCE[k]},{TIP[k]}" for k in range(60)))

PATHS = {
    "Record": {
        "lengths": lambda: okid.Record([1.0, 2.0], [1.0], 0.1),
        "transposed": lambda: okid.Record(np.ones((2, 50)), np.ones((3, 50)), 0.1),
        "infinite": lambda: okid.Record([1.0, 2.0], [1.0, np.inf], 0.1),
        "words": lambda: okid.Record(["a", "b"], [1.0, 2.0], 0.1),
        "no number": lambda: okid.Record([1.0, 2.0], [np.nan, np.nan], 0.1),
        "time step 0": lambda: okid.Record([1.0, 2.0], [1.0, 2.0], 0.0),
        "time step 1e-320": lambda: okid.Record([1.0, 2.0], [1.0, 2.0], 1e-320),
        "time step as words": lambda: okid.Record([1.0, 2.0], [1.0, 2.0], "0.1"),
        "names": lambda: okid.Record([1.0, 2.0], [1.0, 2.0], 0.1, output_names=["a", "b"]),
        "one name twice": lambda: okid.Record([1.0, 2.0], [1.0, 2.0], 0.1, input_names=["a"], output_names=["a"]),
        "hold": lambda: okid.Record([1.0, 2.0], [1.0, 2.0], 0.1, input_hold="cubic"),
        "start": lambda: okid.Record([1.0, 2.0], [1.0, 2.0], 0.1, start_time=np.nan),
        "no such channel": lambda: RECORD.select(outputs=["top"]),
        "no rows": lambda: RECORD.samples(70),
        "rows in halves": lambda: RECORD.samples(0.5, 9),
        "copies": lambda: modal.check_quality([RECORD, RECORD]),
        "shares": lambda: RECORD.split(0.7, 0.7),
        "decimation": lambda: RECORD.decimated(10),
        "decimation 0": lambda: RECORD.decimated(0),
        "trend": lambda: RECORD.detrended(-1),
        "frame": lambda: okid.Record.from_frame({"a": [1.0]}, inputs="a", outputs="b"),
    },
    "files": {
        "no file": lambda: okid.read_record("nothing.csv"),
        "a folder": lambda: okid.read_record("."),
        "no path": lambda: okid.read_record(3),
        "a name that no file has": lambda: okid.read_record("a\0b.csv"),
        "names that are none": lambda: okid.read_record(text("a.csv", ROWS), inputs=[1]),
        "empty": lambda: okid.read_record(text("a.csv", "")),
        "type": lambda: okid.read_record(text("a.xlsx", "PK")),
        "no numbers": lambda: okid.read_record(text("a.csv", "dear all\n")),
        "binary": lambda: okid.read_record(text("a.csv", b"1,2\n\0\0")),
        "cells": lambda: okid.read_record(text("a.csv", "a,b\n1,2\n3,4\n5,6,7\n")),
        "a word among numbers": lambda: okid.read_record(text("a.csv", "a,b\n1,2\n3,4\n5,six\n7,8\n")),
        "double columns": lambda: okid.read_record(archive("a.npz", outputs=np.eye(3), output_names=["a", "a", "b"])),
        "no time step": lambda: okid.read_record(text("a.csv", "a,b\n1,2\n3,4\n5,6\n"), inputs="a"),
        "grid": lambda: okid.read_record(text("a.csv", "time,b\n0,2\n1,4\n5,6\n6,1\n")),
        "no such column": lambda: okid.read_record(text("a.csv", ROWS), inputs=["shaker"]),
        "damaged archive": lambda: okid.read_record(text("a.npz", b"PK\3\4")),
        "damaged array": lambda: okid.read_record(text("a.npy", b"\x93NUMPY\1\0")),
        "damaged MAT": lambda: okid.read_record(text("a.mat", b"MATLAB 5.0 MAT-file".ljust(200))),
        "damaged UFF": lambda: okid.read_record(text("a.uff", "    -1\n    58\nx\n")),
        "damaged TDMS": lambda: okid.read_record(text("a.tdms", "TDSm")),
        "damaged Parquet": lambda: okid.read_record(text("a.parquet", "PAR1")),
        "more channels than rows": lambda: okid.read_record(text("a.csv", "1,2,3,4\n5,6,7,8\n"), dt=1.0),
        "one file twice": lambda: okid.readers.read_records([text("a.csv", ROWS), "a.csv"]),
        "no response": lambda: okid.read_response(text("a.csv", "f,b\n1,2\n")),
        "shapes of a type": lambda: modal.read_shapes(text("a.mat", "x")),
        "damaged shapes": lambda: modal.read_shapes(text("a.csv", "channel,3\na,word\n")),
        "no result": lambda: modal.load(text("a.npz", b"PK\3\4")),
        "no path of a result": lambda: modal.load(3),
        "model of a type": lambda: modal.read_model(text("a.xml", "x")),
        "model with a key": lambda: model_file(masses=[1.0], colour="red"),
        "model without all": lambda: model_file(masses=[1.0]),
        "model, damaged": lambda: modal.read_model(text("a.toml", "masses = [")),
        "geometry": lambda: modal.read_geometry(text("a.toml", "[nodes]\n1 = [0, 0]\n")),
    },
    "stages": {
        "records apart": lambda: okid.fit_observer([RECORD, AMBIENT], order=2),
        "no record": lambda: okid.fit_observer([], order=2),
        "order": lambda: okid.fit_observer(RECORD, order=0),
        "too short": lambda: okid.fit_observer(RECORD, order=40),
        "ridge": lambda: okid.fit_observer(RECORD, order=2, ridge=-1.0),
        "lags": lambda: okid.recover_markov(okid.fit_observer(RECORD, order=2), n_lags=0),
        "Markov shape": lambda: okid.MarkovParameters(system=np.ones(4), dt=0.1),
        "order of a model": lambda: era.realise(MARKOV, order=99),
        "matrices": lambda: era.Realisation([[1.0]], [[1.0]], [[1.0, 2.0]], [[0.0]], 0.1),
        "simulated": lambda: era.simulate(MODEL, AMBIENT),
        "predicted": lambda: era.predict(MODEL, RECORD),
        "response of records": lambda: okid.estimate_response(AMBIENT),
        "lines": lambda: okid.FrequencyResponse(np.ones((3, 1, 1), complex), [1.0, 3.0, 2.0]),
        "window": lambda: okid.FrequencyResponse(np.ones((3, 1, 1), complex), np.arange(3.0), window="round"),
        "set-ups apart": lambda: okid.join_setups([RECORD, okid.Record([], TIP, 0.1, output_names=["root"])]),
    },
    "identify": {
        "kind": lambda: modal.identify(RECORD, kind="loud"),
        "kind without input": lambda: modal.identify(AMBIENT, kind="driven"),
        "kind of a response": lambda: modal.identify(RECORD, kind="response"),
        "kind of records": lambda: modal.identify(TABLE, kind="driven"),
        "observer order": lambda: modal.identify(RECORD, observer_order=2.5),
        "ridge": lambda: modal.identify(RECORD, ridge=-1.0),
        "order": lambda: modal.identify(RECORD, order="large"),
        "decimation": lambda: modal.identify(RECORD, decimation=0),
        "refinement": lambda: modal.identify(RECORD, refinement="more"),
        "missing": lambda: modal.identify(RECORD, missing="guess", kind="driven"),
        "drift": lambda: modal.identify(RECORD, drift="cubic", kind="driven"),
        "delay in words": lambda: modal.identify(RECORD, input_delay="early", kind="driven"),
        "delay": lambda: modal.identify(RECORD, input_delay=-41, kind="driven"),
        "integrators": lambda: modal.identify(RECORD, integrators=7, kind="driven"),
        "short": lambda: modal.identify(RECORD.samples(0, 30), kind="driven"),
        "constant": lambda: modal.identify(okid.Record(FORCE, np.ones(60), 0.1), kind="driven"),
    },
    "shapes and modes": {
        "sizes": lambda: modal.Shapes([[1.0], [0.5]], ["a"]),
        "not finite": lambda: modal.Shapes([[np.nan]], ["a"]),
        "nothing in common": lambda: modal.assurance(SHAPES, modal.Shapes([[1.0]], ["c"])),
        "arrays": lambda: modal.assurance(np.ones((2, 1)), np.ones((3, 1))),
        "no driving point": lambda: modal.normalise_shapes(modal.extract_modes(MODEL), driving_point=("a", "b")),
    },
    "structure": {
        "sensor kind": lambda: chain(sensor_kind="loudness"),
        "degree of freedom": lambda: chain(sensor_dofs=[3]),
        "mass": lambda: chain(masses=[-1.0]),
        "lengths": lambda: chain(stiffnesses=[1.0, 2.0]),
        "effect": lambda: CHAIN.with_effect("quartic", "element_0", **CUBIC),
        "place": lambda: CHAIN.with_effect("cubic_stiffness", "cellar", **CUBIC),
        "parameter": lambda: CHAIN.with_effect("cubic_stiffness", "element_0", k4=1.0),
        "inputs": lambda: modal.simulate(CHAIN, np.ones((5, 1))),
        "columns": lambda: modal.simulate(CHAIN, np.ones((5, 3)), dt=0.1),
        "budget": lambda: modal.discrepancy.diagnose(CHAIN, RECORD, RECORD, budget=-1.0),
        "held out": lambda: modal.discrepancy.diagnose(CHAIN, RECORD, []),
        "catalogue": lambda: modal.discrepancy.diagnose(CHAIN, RECORD, RECORD.detrended(), catalogue=["gap_spring"]),
        "too few samples": lambda: modal.discrepancy.diagnose(CHAIN, RECORD.samples(0, 9), RECORD.samples(9, 20)),
    },
}
COMMANDS = {
    "no such file": "run nothing.csv",
    "no such channel": "run a.csv --inputs shaker",
    "an empty folder": "run a.csv --inputs force -o ''",
    "a folder that is a file": "run a.csv --inputs force -o a.csv",
    "a folder below a file": "run a.csv --inputs force -o a.csv/out",
    "diff of nothing": "diff nothing a.csv",
    "view of nothing": "view nothing",
    "view of no recording": "view a.csv",
    "gap without its model": "gap nothing.toml --fit a.csv --held-out a.csv",
    "a batch below a file": "batch a.csv -o a.csv/out",
    "no batch to track": "track nothing",
    "check of no numbers": "check b.csv",
}
REMEDY = re.compile(
    r"\b(?:add|call|check|choose|correct|cut|declare|draw|export|fit|fill|give|hold|identify|is read|are read|read are|"
    r"keep|leave|lower|make|mark|must be|must have|name|needs?|is needed|pass|raise|remove|rename|replace|resample|run|"
    r"save|select|sort|state|take|turn|use|write|its \w+ are|the \w+s are|it holds|can act at|is a positive)\b"
)


def told(call):
    with pytest.raises(okid.IdentificationError) as caught:
        call()
    return str(caught.value)


def check(sentence):
    assert sentence.isprintable()
    assert 30 <= len(sentence) <= 600
    assert sentence.endswith((".", ".)"))
    assert not sentence.endswith("..")
    assert REMEDY.search(sentence), "what is the rule, and what shall be done?"
    assert not re.search(r"\b(?:None|array\(|dtype|object at|Traceback|Errno)", sentence)


@pytest.mark.parametrize(("part", "what"), [(part, what) for part, paths in PATHS.items() for what in paths])
def test_each_error_is_one_sentence_with_rule_and_remedy(part, what, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    check(told(PATHS[part][what]))


@pytest.mark.parametrize("what", COMMANDS)
def test_each_command_ends_with_one_sentence(what, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    text("a.csv", ROWS), text("b.csv", "dear all\n")
    assert status([word.strip("'") for word in COMMANDS[what].split()]) == 2
    check(capsys.readouterr().err.strip().removeprefix("modal-report: "))


def test_there_are_enough():
    assert sum(map(len, PATHS.values())) + len(COMMANDS) >= 60


if __name__ == "__main__":
    import os

    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        for part, paths in PATHS.items():
            for what, call in paths.items():
                print(f"| {part} | {what} | {told(call)} |")
