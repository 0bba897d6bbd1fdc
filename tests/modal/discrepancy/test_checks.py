"""Model and records that do not belong together get one sentence each."""

from dataclasses import replace

import numpy as np
import pytest
from engine_plants import some_records, two_masses

from modal.discrepancy import setup
from modal.discrepancy.setup import check_plant, check_records
from okid.errors import InsufficientDataError, InvalidDataError
from okid.record import Record


def records():
    first, second = some_records(two_masses(), lengths=(60, 50))
    (third,) = some_records(two_masses(), lengths=(55,), levels=(2.0,), seed=9)
    return first, second, third


def refuses(words, call):
    with pytest.raises((InvalidDataError, InsufficientDataError), match=words) as caught:
        call()
    text = str(caught.value)
    assert "\n" not in text
    assert not text.endswith(".") or text.count(". ") == 0
    assert 40 < len(text) < 300


def test_good_records_pass():
    first, second, third = records()
    assert check_records([first, second], third) == ((first, second), (third,), ())
    assert check_records(first, [second]) == ((first,), (second,), ())


def test_of_long_records_a_stretch_each_is_looked_at(monkeypatch):
    """The first one that moves as it does elsewhere, by its rows; the reader is told."""
    moves = np.where(np.arange(50) % 2, 1.0, -1.0)
    first = Record(moves, np.cumsum(moves), 0.1, name="run 0")
    second = replace(first, inputs=np.where(np.arange(50) < 31, 0.0, moves)[:, np.newaxis], name="run 1")
    monkeypatch.setattr(setup, "MOST_STATES", 60)
    fits, helds, notes = setup.searched_parts((first, second), (replace(first, name=""),), 2)
    assert setup.searched_parts((first,), (second,), 1) == ((first,), (second,), ())
    assert [part.name for part in fits] == ["run 0, rows 0 to 14", "run 1, rows 30 to 44"]
    assert np.array_equal(fits[1].outputs, second.outputs[30:45])
    assert [part.name for part in helds] == ["record, rows 0 to 29"]
    assert "(run 0, rows 0 to 14, run 1, rows 30 to 44, record, rows 0 to 29)" in notes[-1]
    monkeypatch.setattr(setup, "memory_budget", lambda: (1e6, "ulimit leaves"))
    with pytest.raises(
        InvalidDataError, match=r"along 60 rows with 2 states needs about 0\.0 GiB, .* that ulimit leaves"
    ):
        setup.searched_parts((first, second), (replace(first, name=""),), 2)


def test_there_must_be_records_of_both_kinds():
    first, *_ = records()
    refuses("no record to fit", lambda: check_records([], first))
    refuses("no held-out record", lambda: check_records(first, []))


def test_the_same_record_in_both_proves_nothing():
    first, second, _ = records()
    refuses("run 0 is also among the records to fit", lambda: check_records([first, second], first))
    refuses("proves nothing", lambda: check_records([first, second], replace(first, name="copy")))


@pytest.mark.parametrize("held_out", [False, True])
def test_inputs_must_be_whole(held_out):
    """Outputs may have gaps; without the input at one sample the motion from then on is anyone's."""
    first, second, third = records()
    inputs = np.array(second.inputs)
    inputs[7] = np.nan
    gap = replace(second, inputs=inputs)
    words = r"inputs of record run 1 are missing \(NaN\) at 1 of 50 samples"
    refuses(words, lambda: check_records([first], gap) if held_out else check_records([first, gap], third))


def test_a_record_in_which_nothing_moves_is_refused():
    """It was said to grow without bound."""
    first, second, third = records()
    still = replace(first, inputs=np.zeros_like(first.inputs), outputs=np.ones_like(first.outputs), name="run 1")
    refuses("nothing moves in record run 1", lambda: check_records([still, second], third))
    dead = replace(first, outputs=np.ones_like(first.outputs))  # of sensors, which is a finding
    assert check_records([dead, second], third)[0][0] is dead


def test_records_must_be_alike():
    first, second, third = records()
    narrow = Record(first.inputs[:, :1], first.outputs, first.dt)
    refuses(
        "2 inputs and 3 outputs against 1 and 3",
        lambda: check_records([replace(first, input_hold="zero_order"), narrow], third),
    )
    refuses("time step: 0.02 s against 0.03 s", lambda: check_records([first, replace(second, dt=0.03)], third))
    refuses("time step", lambda: check_records(first, replace(third, dt=0.0200001)))
    refuses("linear against zero_order", lambda: check_records(first, replace(third, input_hold="zero_order")))
    metres, inches = (replace(one, output_units=(unit, "m/s", "m")) for one, unit in ((first, "m"), (third, "in")))
    refuses("units of their outputs: m, m/s, m against in", lambda: check_records(metres, inches))
    assert check_records(metres, third)


def test_the_same_channels_in_another_order_are_refused_and_other_names_are_not():
    """A diagnosis goes by the order of the channels: swapped ones would look like a strange effect."""
    first, _, third = records()
    named, swapped, other = (
        replace(one, output_names=names)
        for one, names in ((first, ("a", "b", "c")), (third, ("b", "a", "c")), (third, ("a", "b", "other")))
    )
    refuses("outputs in another order: a, b, c against b, a, c", lambda: check_records(named, swapped))
    assert check_records(named, other)[1] == (other,)


def test_one_level_only_is_said():
    first, _, third = records()
    size, like = (np.sqrt(np.mean(one.inputs**2, axis=0).sum()) for one in (first, third))

    def said(ratio):
        return check_records(first, replace(third, inputs=third.inputs * ratio * size / like))[2]

    assert said(0.7) == said(1.3) == ()
    for ratio in (0.85, 1.2):
        (note,) = said(ratio)
        assert "one level" in note
        assert "look much the same" in note
        assert "second level" not in note  # what to measure is the advice's to say


def test_the_plant_must_have_the_records_channels_and_units():
    plant, (first, *_) = two_masses(), records()
    check_plant(plant, plant.nominal, [first])
    refuses(
        "2 inputs and 3 outputs, the records have 1 and 3",
        lambda: check_plant(
            plant, plant.nominal, [replace(first, inputs=first.inputs[:, :1], input_names=("a",), input_units=("",))]
        ),
    )
    refuses(
        "2 inputs and 3 outputs, the records have 2 and 2",
        lambda: check_plant(
            plant,
            plant.nominal,
            [replace(first, outputs=first.outputs[:, :2], output_names=("a", "b"), output_units=("", ""))],
        ),
    )
    mm = replace(first, output_units=("mm", "m/s", "m/s^2"))
    refuses("in m and the record's in mm", lambda: check_plant(plant, plant.nominal, [mm]))
    check_plant(plant, plant.nominal, [replace(first, output_units=("m", "m/s", "m / s²"))])


def test_an_unstable_plant_is_refused():
    plant, (first, *_) = two_masses(), records()
    refuses("unstable", lambda: check_plant(plant, np.array([90.0, -3.0]), [first]))
    refuses("unstable", lambda: check_plant(plant, np.array([-90.0, 1.0]), [first]))


def test_a_mass_that_drifts_freely_is_not_unstable():
    plant, (first, *_) = two_masses(), records()
    check_plant(plant, np.array([0.0, 0.0]), [first])


def test_too_few_values():
    plant, (first, *_) = two_masses(), records()
    short = replace(first, inputs=first.inputs[:9], outputs=first.outputs[:9])
    refuses(
        "27 measured values are too few for 6 linear parameters and initial states; pass at least 30",
        lambda: check_plant(plant, plant.nominal, [short]),
    )
    check_plant(plant, plant.nominal, [replace(first, inputs=first.inputs[:10], outputs=first.outputs[:10])])


@pytest.mark.parametrize(("n_samples", "refused"), [(63, True), (64, False)])
def test_a_record_that_proves_nothing_is_refused(n_samples, refused):
    from modal.discrepancy.setup import check_long_enough
    from modal.structure.structural_model import StructuralModel
    from modal.structure.structural_plant import structural_plant

    plant = structural_plant(StructuralModel.chain([1.0], [400.0], [0.6], force_dofs=[0], sensor_dofs=[0]))
    record = Record(np.ones(n_samples), np.arange(n_samples, dtype=float), 0.02)
    if refused:
        with pytest.raises(InsufficientDataError, match="has 63 samples; a diagnosis with 2 states needs at least 64"):
            check_long_enough(plant, [record])
    else:
        check_long_enough(plant, [record])


def test_a_model_beyond_the_sampling_frequency_is_refused():
    from modal.structure.structural_model import StructuralModel
    from modal.structure.structural_plant import structural_plant

    model = StructuralModel.chain([1.0], [400.0], [0.6], force_dofs=[0], sensor_dofs=[0])  # 3.18 Hz
    plant = structural_plant(model)
    record = Record(np.ones(100), np.arange(100, dtype=float), 0.15)  # half the sampling frequency: 3.33 Hz
    check_plant(plant, plant.nominal, [record])
    with pytest.raises(InvalidDataError, match="above half the sampling frequency of the records"):
        check_plant(plant, plant.nominal, [replace(record, dt=0.16)])
