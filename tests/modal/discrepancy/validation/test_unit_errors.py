"""A sensor in another unit than the model: named as such, and only there."""

import numpy as np
import pytest

import modal
import okid
from modal.discrepancy import diagnose


@pytest.mark.parametrize(("gain", "words"), [(9.80665, "g taken for m/s^2"), (1.4, "")])
def test_a_gain_of_g_is_named_as_a_unit(gain, words):
    model = modal.StructuralModel.chain(
        [1.0, 1.5], [4000.0, 3000.0], [2.0, 2.0], force_dofs=[1], sensor_dofs=[0, 1], sensor_kind="acceleration"
    )
    records = []
    for seed in (1, 2):
        rng = np.random.default_rng(seed)
        force = rng.standard_normal(1500)
        drive = okid.Record(force, np.zeros((1500, 2)), 0.005, input_names=model.input_names, output_names=["a", "b"])
        clean = np.array(modal.simulate(model, drive).outputs)
        values = (clean + 0.01 * clean.std(axis=0) * rng.standard_normal(clean.shape)) * [gain, 1.0]
        records.append(okid.Record(force, values, 0.005, input_names=model.input_names, output_names=["a", "b"]))
    found = diagnose(model, records[0], records[1])
    assert [one.effect for one in found.findings] == ["sensor_gain"]
    said = [text for text in found.warnings if "unit" in text]
    assert [words in text for text in said] == [True] * bool(words)
