"""A strongly driven hard spring: no simulation follows it for long, spans of the records are followed."""

from dataclasses import replace

import numpy as np
import pytest
from engine_records import run

from modal.discrepancy.noise_floor import noise_floor
from modal.discrepancy.spans import cut_into_spans, floor_of_spans, span_words
from modal.discrepancy.workflow import diagnose
from modal.structure import StructuralModel
from okid.record import Record

DT, CUBIC, NOISE = 0.01, 2e5, 5e-4


def force(n_samples, seed, size=12.0):
    """Held random forces below 10 Hz."""
    lines = np.fft.rfft(np.random.default_rng(seed).standard_normal(n_samples))
    lines[np.fft.rfftfreq(n_samples, DT) > 10.0] = 0.0
    slow = np.fft.irfft(lines, n_samples)
    return size * slow / slow.std()


def duffing(n_samples, seed):
    """One mass of 1 kg on 900 N/m and a cubic spring that is as strong at the motion's size."""
    pushed = force(n_samples, seed)
    moved = run((1.0,), (900.0,), (1.2,), pushed[:, None], law=lambda d, v, t: CUBIC * d**3, dt=DT)
    noisy = moved + NOISE * np.random.default_rng(seed + 50).standard_normal(moved.shape)
    return Record(pushed, noisy, DT, name=f"run {seed}")


def test_neighbouring_motions_part():
    """Or no spans would be needed: a push that is larger by a millionth ends somewhere else."""
    pushed = force(3000, 1)
    law = {"law": lambda d, v, t: CUBIC * d**3, "dt": DT}
    one, other = (run((1.0,), (900.0,), (1.2,), scale * pushed[:, None], **law) for scale in (1.0, 1.000001))
    assert np.abs(one - other)[:200].max() < 1e-5
    assert np.abs(one - other)[-500:].max() > 0.5 * one.std()


def test_a_chaotic_motion_is_judged_in_spans():
    model = StructuralModel.chain([1.0], [864.0], [1.44], force_dofs=[0], sensor_dofs=[0])
    found = diagnose(model, [duffing(3000, 1), duffing(3000, 2)], duffing(3000, 3))
    assert found.status == "named"
    assert [one.effect for one in found.findings] == ["cubic_stiffness"]
    assert found.findings[0].parameters[0].value == pytest.approx(CUBIC, rel=2e-3)
    assert any("cut into spans" in words for words in found.warnings)
    assert len(found.held_out) > 1
    assert sum(span.n_samples for span in found.held_out) == 3000


def test_spans_are_the_record_again():
    records = [duffing(1500, 1), duffing(700, 2)]
    spans, origin = cut_into_spans(records, np.full((2, 1), NOISE**2))
    for position, record in enumerate(records):
        own = [span for span, of in zip(spans, origin, strict=True) if of == position]
        assert np.array_equal(np.concatenate([span.outputs for span in own]), record.outputs)
        assert np.array_equal(np.concatenate([span.inputs for span in own]), record.inputs)
        assert [span.start_time for span in own[1:]] == pytest.approx([span.time[-1] + DT for span in own[:-1]])
        assert all(record.name in span.name for span in own)
    assert "span" in span_words(spans)


def test_a_short_record_stays_whole():
    record = duffing(150, 1)
    assert cut_into_spans([record], np.array([[NOISE**2]]))[0][0].name == record.name


def test_spans_are_long_enough_and_lack_no_output_throughout():
    record = duffing(1500, 1)
    outputs = record.outputs.copy()
    outputs[:400] = np.nan
    late = replace(record, outputs=outputs)
    floor = np.array([[NOISE**2]])
    spans, _ = cut_into_spans([record], floor)
    fewer, _ = cut_into_spans([late], floor)
    assert 1 <= len(fewer) < len(spans)
    assert all(np.isfinite(span.outputs).any() for span in fewer)
    assert min(span.n_samples for span in cut_into_spans([record], floor, fewest=700)[0]) >= 700


def test_each_span_has_the_floor_of_its_record():
    records = [duffing(1500, 1), duffing(1500, 2)]
    whole = noise_floor(records)
    _, origin = cut_into_spans(records, whole.variance)
    cut = floor_of_spans(whole, origin)
    assert np.array_equal(cut.variance, whole.variance[list(origin)])
    assert cut.method == tuple(whole.method[position] for position in origin)
    assert len(cut.reason) == len(origin)
