"""The result of the wrong stage is refused in one sentence, and every type shows itself in one line."""

import numpy as np
import pytest

import era
import modal
import okid

RECORD = okid.Record(np.arange(40.0) % 7, np.arange(40.0) % 5, 0.1, name="run", output_names=["tip"])
MARKOV = okid.MarkovParameters(system=0.9 ** np.arange(20.0).reshape(20, 1, 1), dt=0.1)
MODEL = era.realise(MARKOV, order=1)
OBSERVER = okid.fit_observer(RECORD, order=2)
CHAIN = modal.StructuralModel.chain([1.0], [4.0], [0.1], force_dofs=[0], sensor_dofs=[0], output_names=["tip"])


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: okid.recover_markov(MARKOV), "recover_markov takes an ObserverFit, but was given MarkovParameters"),
        (lambda: era.realise(OBSERVER), "takes a MarkovParameters, but was given ObserverFit"),
        (lambda: era.simulate(MODEL, np.ones((5, 1))), "takes a Record, but was given ndarray"),
        (lambda: era.predict(MARKOV, RECORD), "takes a Realisation, but was given MarkovParameters"),
        (lambda: modal.extract_modes(MARKOV), "extract_modes takes a Realisation, but was given MarkovParameters"),
        (lambda: modal.write_report(RECORD, "nowhere"), "takes an Identification, but was given Record"),
        (lambda: modal.save_recording(RECORD, "nowhere.rrd"), "takes an Identification, but was given Record"),
        (lambda: modal.identify(MODEL), "okid.Record"),
        (lambda: modal.frequency_response(RECORD), "takes an Identification, but was given Record"),
        (lambda: modal.simulate(RECORD, RECORD), "a model is a StructuralModel, a state space"),
        (lambda: modal.simulate(CHAIN, RECORD.inputs), "plain inputs need a time step"),
        (lambda: modal.discrepancy.diagnose(CHAIN, RECORD, []), "there is no held-out record"),
        (lambda: modal.discrepancy.diagnose(CHAIN, RECORD, RECORD), "also among the records to fit"),
        (lambda: modal.discrepancy.noise_floor(CHAIN), "one okid.Record or a sequence of them is needed"),
        (lambda: modal.log_diagnosis(RECORD, None), "log_diagnosis takes a Diagnosis, but was given Record"),
        (lambda: modal.read_model("nothing.toml"), "there is no file nothing.toml"),
    ],
)
def test_the_wrong_stage_is_refused_in_one_sentence(call, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(okid.InvalidDataError) as caught:
        call()
    text = str(caught.value)
    assert words in text
    assert "\n" not in text
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (RECORD, "Record('run': 40 samples every 0.1 s, inputs ['input_0'], outputs ['tip'])"),
        (MARKOV, "MarkovParameters(19 lags every 0.1 s, 1 inputs, 1 outputs, no gain)"),
        (MODEL, "Realisation(order 1, 1 inputs, 1 outputs, dt 0.1 s, no gain)"),
        (CHAIN, "StructuralModel(1 DOFs, inputs ['input_0'], outputs ['tip'], elements ['element_0'])"),
    ],
)
def test_a_type_shows_itself_in_one_line(value, text):
    assert repr(value) == text


def test_an_observer_shows_its_order_and_its_rows():
    assert repr(OBSERVER).startswith("ObserverFit(order 2, ridge 0, 1 inputs, 1 outputs, 38 rows")
