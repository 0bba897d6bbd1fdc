"""Faults that the identification mends or says; records from `tests/reference`."""

from dataclasses import replace

import numpy as np
import pytest
from hard_records import FAMILIES
from made_records import KINDS, clean_record
from scipy.signal import lfilter

from modal.identification.pipeline import identify
from modal.preparation import faults
from modal.preparation.faults import free_of_clipping, mended, no_finer_than_sensors
from modal.preparation.kind import find_kind
from modal.preparation.lines import line_bins, machine_lines
from modal.quality.check import check_quality
from okid.record import Record

GIVEN = {"observer_order": 20, "ridge": 0.0, "input_delay": 0, "order": 6}
"""What a search would take about the same: three modes."""


def record_of(family, seed):
    made = FAMILIES[family](seed)
    return made, Record(made.inputs, made.outputs, made.dt)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("kind", ["driven", "ambient", "decay"])
def test_an_output_that_no_record_holds_is_left_out(kind):
    """It was taken for a set-up that had not measured it: a node, certain to infinity, or an error about set-ups."""
    made = FAMILIES["driven"](5)
    if kind == "decay":
        time = made.dt * np.arange(1000)
        rung = np.exp(-0.4 * time) * np.cos(40 * time) + 0.01 * np.random.default_rng(0).standard_normal(1000)
        made = replace(made, outputs=np.column_stack([rung, 0.3 * rung]))
    outputs = np.column_stack([made.outputs, np.full(len(made.outputs), np.nan)])
    given = GIVEN if kind != "decay" else {"observer_order": 20, "order": 2}
    result = identify(Record(made.inputs if kind == "driven" else [], outputs, made.dt), **given)
    assert result.record_kind == kind
    assert any("holds no number: it was not recorded; left out" in words for words in result.warnings)
    assert result.modes.system
    assert all(mode.shape.size == made.outputs.shape[1] for mode in result.modes)


@pytest.mark.parametrize("kind", KINDS)
def test_a_clean_record_stays_the_very_same(kind):
    inputs, outputs, dt = clean_record(np.random.default_rng(11), kind, n_samples=4000)
    records = (Record(inputs, outputs, dt),)
    found = mended(records)
    assert found.warnings == ()
    assert found.records[0] is records[0]


def test_spikes_are_left_out_and_nothing_else_is():
    made, record = record_of("spikes", 5)
    clean = FAMILIES["driven"](5).outputs
    (mend,) = mended((record,)).records
    spiked = np.abs(made.outputs - clean) > 0
    gone = np.isnan(mend.outputs)
    assert gone[spiked].mean() > 0.9
    assert not gone[~spiked].any()


def test_modes_stand_through_spikes():
    made, record = record_of("spikes", 1)
    result = identify(record, **GIVEN)
    found = np.array([mode.frequency for mode in result.modes.system])
    assert all((np.abs(found - f) < 0.005 * f).any() for f in made.frequencies)
    assert any("spikes" in warning for warning in result.warnings)


def test_a_limit_is_seen_below_spikes():
    """What lies beyond a limit refutes it, unless it is a spike: one of each side stands far outside both limits."""
    motion = FAMILIES["driven"](5).outputs[:, 0]
    limit = 1.5 * motion.std()
    output = np.clip(motion, -limit, limit)
    places = [np.flatnonzero(np.abs(motion) < 0.5 * limit)[k] for k in (100, 700)]
    output[places] = 9.0 * limit, -11.0 * limit
    record = Record([], output, 0.01)
    (clipped,) = (finding for finding in check_quality(record).findings if finding.what == "clipped")
    held = np.abs(motion) >= limit
    assert clipped.share == pytest.approx(held.mean(), rel=1e-3)
    assert f"at its limit {limit:.4g}" in clipped.sentence
    assert f"and {-limit:.4g}" in clipped.sentence
    driven = replace(record, inputs=np.random.default_rng(0).standard_normal((len(output), 1)), input_names=("force",))
    (kept,) = mended((driven,), driven=True).records
    assert np.isnan(kept.outputs[held]).all()


def test_what_is_clipped_is_left_out_of_driven_records():
    """With measured inputs the rest of the record tells what lay beyond: as good as a record that was never clipped."""
    truth, record = record_of("clipped", 0)
    result = identify(record, **GIVEN)
    found = np.array([mode.frequency for mode in result.modes.system])
    wrong = [np.abs(found - f).min() / f for f in truth.frequencies]
    _, whole = record_of("driven", 0)
    plain = identify(whole, **GIVEN)
    assert not any("changes" in warning for warning in plain.warnings)  # with time or level: it is linear
    clean = np.array([mode.frequency for mode in plain.modes.system])
    assert max(wrong) <= 3.0 * max(np.abs(clean - f).min() / f for f in truth.frequencies)
    assert any("these samples are left out" in warning for warning in result.warnings)
    (kept,) = mended((record,)).records
    assert not np.isnan(kept.outputs).any()


@pytest.mark.parametrize(
    ("family", "words"), [("clipped", "stands at its limit"), ("coarse", "rounding"), ("dead_channel", "left out")]
)
def test_what_check_knows_is_said(family, words):
    _, record = record_of(family, 3)
    assert any(words in warning for warning in mended((record,)).warnings)
    assert (mended((record,)).records[0].n_outputs == 3) == (family == "dead_channel")


def test_the_same_fault_of_many_channels_is_counted():
    rng = np.random.default_rng(0)
    tip = np.convolve(rng.standard_normal(3000), np.ones(6))[:3000]
    found = mended((Record([], np.column_stack([tip, np.tile(np.arange(9.0), (3000, 1))]), 0.01),))
    assert len(found.warnings) == 5
    assert "five more channels" in found.warnings[-1]
    assert found.records[0].n_outputs == 1


def test_nothing_is_left_out_where_no_output_moves():
    record = Record(np.random.default_rng(0).standard_normal(100), np.ones((100, 2)), 0.01)
    assert mended((record,)).records[0] is record


def ringing(rng, *, limit=np.inf, force=True, size=1.0, n_samples=3000):
    """Two modes struck at row 50, cut off at the limit; row after the last sample that was cut."""
    k = np.arange(float(n_samples))
    answer = [0.998**k * np.sin(0.3 * k), 0.996**k * np.sin(0.9 * k + 0.4)]
    clean = np.zeros((n_samples, 2))
    clean[50:] = size * (np.array([[1.0, 0.6], [-0.5, 1.0]]) @ answer).T[:-50]
    clean += 0.002 * rng.standard_normal(clean.shape)
    blow = np.zeros((n_samples, 1))
    blow[49:51] = size
    outputs = np.clip(clean, -limit, limit)
    last = np.flatnonzero((outputs != clean).any(axis=1))
    record = Record(blow if force else [], outputs if force else outputs[51:], 0.01)
    return record, int(last[-1]) + 1 if last.size else 0


def test_a_clipped_blow_is_left_out_where_another_was_not_clipped():
    rng = np.random.default_rng(3)
    whole, _ = ringing(rng, size=0.3)
    cut, _ = ringing(rng, limit=0.6)
    kept, kind = free_of_clipping((whole, cut), find_kind((whole, cut)), mended((whole, cut)).records)
    assert len(kept) == 1
    assert kept[0] is whole
    assert kind.kind == "transient"
    assert "left out" in kind.warnings[0]


@pytest.mark.parametrize("spike", [pytest.param(0.0, marks=pytest.mark.slow), 3.0])
@pytest.mark.parametrize("force", [True, False])
def test_what_rings_on_after_clipping_is_a_decay(force, spike):
    record, last = ringing(np.random.default_rng(4), limit=0.5, force=force, n_samples=1500)
    outputs = record.outputs.copy()
    outputs[[1000, 1200]] += [[spike], [-spike]]
    record = replace(record, outputs=outputs)
    clean = mended((record,)).records
    (kept,), kind = free_of_clipping((record,), find_kind(clean), clean)
    assert (kept.n_inputs, kind.kind, kind.starts) == (0, "decay", (last - (0 if force else 51),))
    result = identify(record, observer_order=32, ridge=0.0, order=4)
    found = [mode.frequency for mode in result.modes.system]
    np.testing.assert_allclose(found, np.array([0.3, 0.9]) / (2 * np.pi * 0.01), rtol=1e-3)


def test_blows_that_nobody_measured_are_no_ambient_motion_where_they_are_clipped():
    """Three blows with rest between them: what limits make of the free motion was found again in every half."""
    rng = np.random.default_rng(4)
    each = [ringing(rng, size=size, n_samples=1200)[0].outputs for size in (1.0, 0.8, 1.1)]
    record = Record([], np.clip(np.concatenate(each), -0.5, 0.5), 0.01)
    assert find_kind([record]).kind == "ambient"
    result = identify(record, observer_order=32, ridge=0.0, order=4)
    assert result.record_kind == "decay"
    found = [mode.frequency for mode in result.modes.system]
    np.testing.assert_allclose(found, np.array([0.3, 0.9]) / (2 * np.pi * 0.01), rtol=1e-3)
    assert sum("only the free motion" in warning for warning in result.warnings) == 1


def test_nothing_tells_what_limits_make_of_motion_that_is_not_steady():
    record = record_of("ambient", 5)[1].samples(0, 6000)
    gusts = np.ones(record.n_samples)
    gusts[1500:2700] = 20.0
    size = 1.5 * (gusts[:, np.newaxis] * record.outputs).std(axis=0)
    clipped = replace(record, outputs=np.clip(gusts[:, np.newaxis] * record.outputs, -size, size))
    result = identify(clipped, observer_order=16, ridge=0.003, order=10)
    assert result.record_kind == "ambient"
    assert not result.modes.system
    assert any("not steady, so nothing tells what their limits" in mode.reason for mode in result.modes)


def test_what_was_not_clipped_stays_the_very_same():
    record, _ = ringing(np.random.default_rng(5))
    kept, kind = free_of_clipping((record,), find_kind((record,)), mended((record,)).records)
    assert kept[0] is record
    assert kind.kind == "transient"


def test_a_sensor_that_drifts_makes_no_mode_of_a_decay():
    record, _ = ringing(np.random.default_rng(6), force=False, n_samples=1000)
    settling = 0.4 * (1 - np.exp(-np.linspace(0.0, 4.0, record.n_samples)))[:, np.newaxis] * [1.0, 0.3]
    result = identify(Record([], record.outputs + settling, record.dt), observer_order=46, ridge=0.0)
    assert [mode.kind for mode in result.modes.system] == ["oscillatory", "oscillatory"]


def test_ambient_outputs_without_noise_make_nothing_certain_that_is_not():
    """Exact outputs of few forces behind a steep filter: intervals were up to twelve deviations off."""
    made, record = record_of("noiseless", 9)
    result = identify(record, observer_order=16, ridge=0.0)
    assert "noise floor" in [choice.what for choice in result.choices]
    for frequency, ratio in zip(made.frequencies, made.damping_ratios, strict=True):
        mode = min(result.modes.system, key=lambda m: abs(m.frequency - frequency))
        assert abs(mode.frequency - frequency) < 4 * mode.frequency_std < 0.02 * frequency
        assert abs(mode.damping_ratio - ratio) < 4 * mode.damping_ratio_std
    assert len(result.modes.system) == made.frequencies.size


def test_outputs_with_a_sensor_s_noise_stay_the_very_same():
    _, record = record_of("ambient", 1)
    records, choices = no_finer_than_sensors((replace(record, inputs=record.inputs[:, :0]),))
    assert records[0].outputs is record.outputs
    assert not choices


@pytest.mark.parametrize("share", [0.1, 0.3])
def test_where_no_past_is_whole_nothing_is_foretold(share):
    """Ten per cent missing in each of five outputs leave no row with 32 whole ones before it: a division by none."""
    rng = np.random.default_rng(0)
    outputs = lfilter([1.0], [1.0, -1.6, 0.9], rng.standard_normal((4000, 5)), axis=0)
    outputs[rng.random(outputs.shape) < share] = np.nan
    record = Record([], outputs, 0.01)
    assert no_finer_than_sensors((record,)) == ((record,), ())


def test_records_are_looked_over_once(monkeypatch):
    """Ambient ones were three times: for their kind, before the fit, and for what their limits make of the modes."""
    looked, look = [], faults._looked
    monkeypatch.setattr(faults, "_looked", lambda records: looked.append(records) or look(records))
    tip = lfilter([1.0], [1.0, -1.6, 0.9], np.random.default_rng(3).standard_normal(3000))
    identify(Record([], tip, 0.01), observer_order=8, order=2, ridge=0.0)
    assert len(looked) == 1


def ambient_record(family, seed):
    made = FAMILIES[family](seed)
    return made, Record(made.inputs, made.outputs, made.dt).detrended()


def test_lines_are_named_and_nothing_else_is():
    there = found = 0
    for seed in range(100, 112):
        made, record = ambient_record("machine_lines", seed)
        lines = machine_lines([record])
        named = [np.abs(lines.frequencies - line).min(initial=1.0) < 0.02 for line in made.lines]
        there, found = there + len(named), found + sum(named)
        assert lines.frequencies.size == sum(named)
        if all(named):  # what is left is the motion without them
            clean = FAMILIES["ambient"](seed).outputs
            left = lines.records[0].outputs - (clean - clean.mean(axis=0))
            assert (left.std(axis=0) < 0.05 * clean.std(axis=0)).all()
    assert found >= 0.95 * there


@pytest.mark.parametrize("family", ["ambient", "coloured_noise", "hidden_earthquake"])
def test_motion_without_lines_stays_the_very_same(family):
    for seed in range(100, 110):
        _, record = ambient_record(family, seed)
        found = machine_lines([record])
        assert found.records[0] is record
        assert found.warnings == ()


def test_multiples_are_named_as_a_family():
    rng, time = np.random.default_rng(0), 0.01 * np.arange(8000)
    machine = sum(np.sin(2 * np.pi * 6.1 * k * time) for k in (1, 2, 3))
    record = Record([], machine + rng.standard_normal(8000), 0.01)
    (warning,) = machine_lines([record]).warnings
    assert "6.1, 12.2 and 18.3 Hz are multiples of 6.1 Hz" in warning


def test_with_inputs_or_gaps():
    rng, time = np.random.default_rng(0), 0.01 * np.arange(8000)
    motion = np.sin(2 * np.pi * 6.1 * time) + rng.standard_normal(8000)
    driven = Record(rng.standard_normal(8000), motion, 0.01)
    assert machine_lines([driven]).records[0] is driven
    motion[1000:1200] = np.nan
    found = machine_lines([Record([], motion, 0.01)])
    assert np.isnan(found.records[0].outputs).sum() == 200
    assert np.nanstd(found.records[0].outputs) == pytest.approx(1.0, abs=0.03)


def test_a_machine_makes_no_mode_and_takes_none():
    made, record = ambient_record("machine_lines", 0)
    result = identify(record, observer_order=16, ridge=1e-5, order=10)
    found = np.array([mode.frequency for mode in result.modes.system])
    assert found.size == made.frequencies.size
    assert (np.abs(np.sort(found) - made.frequencies) < 0.01 * made.frequencies).all()


def test_white_noise_has_no_line():
    bins, power = line_bins(np.random.default_rng(0).standard_normal((20_000, 5)))
    assert not bins.any()
    np.testing.assert_allclose(power.sum(axis=0), 1.0)
