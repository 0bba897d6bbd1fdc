"""How results show themselves: at most 20 lines and 2000 characters, whatever they hold, and no markup of a file."""

import copy
import dataclasses
import pickle

import numpy as np
import pyarrow as pa
import pytest

from okid.display import Displayed
from okid.frequency_response import FrequencyResponse
from okid.record import Record


@dataclasses.dataclass(frozen=True, slots=True, eq=False, repr=False)
class Holder(Displayed):
    first: object
    second: object = None


MANY = [
    np.zeros((4000, 30)),
    tuple(Record([], [[0.0], [1.0]], 1.0, output_names=["x" * 4000]) for _ in range(500)),
    "long " * 9000,
    {f"key {number}": number for number in range(9000)},
    tuple(range(9000)),
    Holder(Holder(np.arange(9.0), "\n" * 900)),
]


@pytest.mark.parametrize("value", MANY, ids=lambda value: type(value).__name__)
def test_a_representation_is_short_whatever_it_holds(value):
    text = repr(Holder(value, value))
    assert len(text) <= 2000
    assert text.count("\n") < 20


def test_many_channels_are_counted():
    names = [f"a rather long name of channel {k}" for k in range(300)]
    record = Record([], np.zeros((400, 300)), 1.0, output_names=names)
    assert len(repr(record)) <= 300
    assert "300 in all" in repr(record)


def test_a_wide_type_says_what_it_leaves_out():
    wide = dataclasses.make_dataclass(
        "Wide", [(f"field_{i}", float, 0.5) for i in range(60)], bases=(Displayed,), repr=False
    )
    text = repr(wide())
    assert len(text) <= 2000
    assert text.count("\n") < 20
    assert text.splitlines()[-1].split()[0] == "..."


def test_words_of_a_file_are_no_markup_in_a_notebook():
    assert "<script>" not in Holder("<script>alert(1)</script>")._repr_html_()


def test_a_record_goes_to_a_table_and_back():
    record = Record([0.0, 1.0, 0.0], [[0.0, np.nan], [2.0, 1.0], [1.0, 3.0]], 0.1, output_units=["m", "m/s^2"])
    table = record.to_table()
    assert table.schema.field("output_1").metadata[b"unit"] == b"m/s^2"
    again = Record.from_frame(table, inputs=record.input_names, outputs=record.output_names)
    assert again.dt == pytest.approx(record.dt, rel=1e-15)
    assert np.array_equal(again.outputs, record.outputs, equal_nan=True)
    assert again.output_units == record.output_units


def test_units_of_a_frame_are_read_as_in_a_file():
    frame = pa.table({"time [ms]": [0.0, 10.0, 20.0], "force": [1.0, 0.0, 0.0], "tip [g]": [0.0, 1.0, 0.5]})
    record = Record.from_frame(frame, inputs=(), outputs=["tip", "force"])
    assert record.dt == pytest.approx(0.01)
    assert record.outputs[1].tolist() == [9.80665, 0.0]


def test_what_is_no_frame_is_refused_in_words():
    with pytest.raises(ValueError, match="is no data frame"):
        Record.from_frame([1, 2, 3], inputs=(), outputs="a", dt=1.0)


@dataclasses.dataclass(frozen=True, slots=True, eq=False)
class Inner:
    values: object


@pytest.mark.parametrize(
    "copied",
    [copy.copy, copy.deepcopy, *(lambda x, p=p: pickle.loads(pickle.dumps(x, p)) for p in range(6))],  # noqa: S301
)
def test_a_copy_is_as_frozen_as_what_it_is_of(copied):
    """Numpy makes arrays writable again; other programs pass results between processes."""
    record = Record([0.0, 1.0, 0.0], [0.0, np.nan, 1.0], 0.1, output_names=["tip"], start_time=3.0)
    again = copied(record)
    np.testing.assert_array_equal(again.outputs, record.outputs)
    assert (again.output_names, again.start_time, again.input_hold) == (("tip",), 3.0, "zero_order")
    held = copied(Holder((np.ones(3), {"a": np.ones(2)}), Inner(np.ones(4))))
    for array in (again.inputs, again.outputs, held.first[0], held.first[1]["a"], held.second.values):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


def test_nobody_writes_to_a_result_and_whoever_made_an_array_still_may():
    mine = np.zeros(3)
    holder = Holder(mine)
    with pytest.raises(ValueError, match="read-only"):
        holder.first[0] = 1.0
    mine[0] = 2.0


def test_a_frequency_response_goes_to_a_table_with_units_and_coherence():
    response = np.arange(12.0).reshape(3, 2, 2) + 1j
    table = FrequencyResponse(
        response, [0.0, 1.0, 2.0], coherence=np.full((3, 2), 0.5), input_names=["a", "b"], output_names=["tip", "mid"],
        input_units=["N", "N"], output_units=["m", ""],
    ).to_table()  # fmt: skip
    assert table.column_names[:3] == ["frequency", "tip/a re", "tip/a im"]
    assert table.column_names[-2:] == ["tip coherence", "mid coherence"]
    assert table.column("mid/b re").to_pylist() == response[:, 1, 1].real.tolist()
    units = {field.name: (field.metadata or {}).get(b"unit", b"").decode() for field in table.schema}
    assert (units["frequency"], units["tip/a im"], units["mid/a im"]) == ("Hz", "m/N", "1/N")
    one = FrequencyResponse(response, [0.0, 1.0, 2.0], coherence=np.full((3, 2, 2), 0.5)).to_table()
    assert one.column("output_1/input_0 coherence").to_pylist() == [0.5] * 3
    assert not one.schema.field("output_0/input_0 re").metadata
    alike = FrequencyResponse(
        response, [0.0, 1.0, 2.0], output_names=["x/b", "x"], input_names=["c", "b/c"], input_units=["N m"] * 2
    ).to_table()  # fmt: skip
    assert alike.num_columns == 9
    assert alike.schema.field("output_1/input_1 re").metadata[b"unit"] == b"1/(N m)"
