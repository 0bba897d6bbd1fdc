"""Names choose the channels; a wrong name gets the right one back."""

import numpy as np
import pytest

from okid.errors import InvalidDataError
from okid.readers import read_record

HEADER = "sample,time [s],shaker [kN],tip [mm],root [mm],mid (left)"
VALUES = np.column_stack([np.arange(30), 0.1 * np.arange(30), np.random.default_rng(3).standard_normal((30, 4))])


@pytest.fixture
def path(tmp_path):
    np.savetxt(tmp_path / "run.csv", VALUES, delimiter=",", header=HEADER, comments="", fmt="%.17g")
    return tmp_path / "run.csv"


@pytest.mark.parametrize(
    ("inputs", "outputs", "expected"),
    [
        (None, None, ((), ("shaker", "tip", "root", "mid (left)"))),
        (["shaker"], None, (("shaker",), ("tip", "root", "mid (left)"))),
        ("shaker", None, (("shaker",), ("tip", "root", "mid (left)"))),
        ([], None, ((), ("shaker", "tip", "root", "mid (left)"))),
        (None, ["root", "tip"], ((), ("root", "tip"))),
        (["root", "shaker"], ["mid (left)"], (("root", "shaker"), ("mid (left)",))),
        (["shaker [kN]"], ["tip [mm]"], (("shaker",), ("tip",))),
    ],
)
def test_choice(path, inputs, outputs, expected):
    record = read_record(path, inputs=inputs, outputs=outputs)
    assert (record.input_names, record.output_names) == expected
    scale = {"shaker": 1e3, "tip": 1e-3, "root": 1e-3, "mid (left)": 1.0}
    column = {"shaker": 2, "tip": 3, "root": 4, "mid (left)": 5}
    for name, values in zip(record.output_names, record.outputs.T, strict=True):
        np.testing.assert_allclose(values, scale[name] * VALUES[:, column[name]], rtol=1e-14)


@pytest.mark.parametrize(
    ("inputs", "outputs", "message"),
    [
        (
            "shakr",
            None,
            r"no channel 'shakr' in run\.csv; did you mean 'shaker'\? Its channels are shaker, tip, root, mid",
        ),
        ("Tip", None, r"did you mean 'tip'\?"),
        ("xyz", None, r"no channel 'xyz' in run\.csv; its channels are shaker"),
        (None, ["tip", "nothing"], r"no channel 'nothing'"),
        ("time", None, r"'time' of run\.csv is the time axis"),
        (None, "sample", r"'sample' of run\.csv is a counter"),
        ("tip", ["tip", "root"], r"'tip' cannot be both input and output"),
        (["tip", "tip"], None, r"'tip' is named more than once"),
        (["shaker", "tip", "root", "mid (left)"], None, r"no output is left in run\.csv"),
        (["shaker"], [], r"no output is left"),
    ],
)
def test_wrong_choice(path, inputs, outputs, message):
    with pytest.raises(InvalidDataError, match=message):
        read_record(path, inputs=inputs, outputs=outputs)


def test_input_hold_is_band_limited_unless_said(path):
    assert read_record(path, inputs="shaker").input_hold == "band_limited"
    assert read_record(path, inputs="shaker", input_hold="zero_order").input_hold == "zero_order"
    with pytest.raises(InvalidDataError, match=r"run\.csv: input_hold must be one of"):
        read_record(path, input_hold="zoh")


def test_misspelt_options_are_refused(path):
    with pytest.raises(TypeError):
        read_record(path, input="shaker")
    with pytest.raises(TypeError):
        read_record(path, ["shaker"])
