"""Signals, Gram matrices and blocks against loops over samples; chunk edges, gaps, several records, real poles."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from textbook_output_error import differences, loop_sensitivities, loop_signals, loop_states, random_loop_model

from modal.estimation import modal_states, signal_sums
from modal.estimation.modal_states import NONE, ModalParameters, SignalLayout, blocks_of, layout_of
from modal.estimation.signal_sums import signal_grams
from okid.record import Record


def parameters_of(model):
    return ModalParameters(poles=model.poles, is_pair=model.is_pair, inputs=model.b, states=model.starts)


def a_case(seed, *, lengths, n_pairs=2, n_real=1, n_inputs=2, n_outputs=2, missing=0.0, roving=False, fading=1):
    rng = np.random.default_rng(seed)
    model = random_loop_model(
        rng, n_pairs=n_pairs, n_real=n_real, n_inputs=n_inputs, n_outputs=n_outputs, n_records=len(lengths)
    )
    model = replace(model, poles=model.poles * np.abs(model.poles) ** (fading - 1))
    records = [Record(rng.standard_normal((n, n_inputs)), rng.standard_normal((n, n_outputs)), 0.1) for n in lengths]
    for r, record in enumerate(records if roving else ()):  # one moves in each, of some two
        still = [j for j in range(n_inputs) if j not in (r % n_inputs, r // n_inputs)]
        records[r] = replace(record, inputs=np.where(np.isin(np.arange(n_inputs), still), 0.0, record.inputs))
    rows = [rng.random(n) >= missing for n in lengths]
    return model, records, rows


def even_folds(records, n_folds):
    """Every fourth run of rows of each record, from fold to fold."""
    folds = [[[] for _ in records] for _ in range(n_folds)]
    for r, record in enumerate(records):
        edges = np.linspace(0, record.n_samples, 8).astype(int).tolist()
        for i in range(1, 7):
            folds[i % n_folds][r].append((edges[i], edges[i + 1]))
    return folds


CASES = {
    "one record": {"lengths": (230,)},
    "three records": {"lengths": (120, 60, 150), "n_inputs": 1},
    "missing rows": {"lengths": (150, 90), "missing": 0.2},
    "real poles only": {"lengths": (80,), "n_pairs": 0, "n_real": 2},
    "pairs only, one channel each": {"lengths": (90,), "n_real": 0, "n_inputs": 1, "n_outputs": 1},
    "three inputs": {"lengths": (70, 40), "n_inputs": 3, "n_outputs": 3},
    "a record of one sample": {"lengths": (40, 1, 2), "n_inputs": 1, "n_outputs": 1},
    "no inputs": {"lengths": (60, 50), "n_inputs": 0},
    "a hammer that roves": {"lengths": (70, 40, 60, 50), "n_inputs": 3, "missing": 0.1, "roving": True},
    "one that roves, by sums that follow": {"lengths": (230, 150, 90), "n_pairs": 4, "n_inputs": 3, "roving": True},
    "over soon": {"lengths": (90, 60), "fading": 60},
    "sums that follow, over soon": {"lengths": (230, 150), "n_pairs": 4, "n_inputs": 3, "fading": 60},
    "sums that follow from each other": {"lengths": (230, 150), "n_pairs": 3, "n_real": 2, "n_inputs": 5},
}


@pytest.mark.parametrize("chunk", [7, 8192])
@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_gram_matrices_are_sums_over_the_samples_of_a_loop(monkeypatch, case, chunk):
    monkeypatch.setattr(modal_states, "CHUNK", chunk)
    monkeypatch.setattr(signal_sums, "FEWEST_ROWS", 1)
    monkeypatch.setattr(signal_sums, "FEWEST_SIGNALS", 1)
    model, records, rows = a_case(5, **case)
    blocks = blocks_of(records, even_folds(records, 2))
    parameters = parameters_of(model)
    layout = layout_of(parameters, records, records[0].n_inputs)
    known = np.r_[layout.alone.regressors, layout.alone.outputs]
    signals = [loop_signals(model, r, record.inputs, record.outputs) for r, record in enumerate(records)]
    each = [signals[block.record][block.rows][rows[block.record][block.rows]] for block in blocks]
    each = [own.T @ own for own in each]
    for held_out in (NONE, 0, 1):
        _, found, parts = signal_grams(
            parameters, records, rows, blocks, n_direct=records[0].n_inputs, held_out=held_out
        )
        nothing = np.zeros((layout.size, layout.size))
        expected = sum((own for own, block in zip(each, blocks, strict=True) if block.label != held_out), nothing)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * max(1.0, np.abs(expected).max()))
        apart = [(own, block) for own, block in zip(each, blocks, strict=True) if block.label == held_out]
        assert parts.shape == (len(apart), known.size, known.size)
        for part, (own, block) in zip(parts, apart, strict=True):
            places = layout.places(block.record)[known]
            at_most = max(1.0, np.abs(own).max())
            np.testing.assert_allclose(part, own[np.ix_(places, places)], rtol=0, atol=1e-10 * at_most)


@pytest.mark.parametrize("fewest", [1, 10_000])
def test_where_a_record_begins_at_rest_all_but_its_free_responses_is_summed_up(monkeypatch, fewest):
    monkeypatch.setattr(signal_sums, "FEWEST_ROWS", 1)
    monkeypatch.setattr(signal_sums, "FEWEST_SIGNALS", fewest)
    model, records, rows = a_case(7, lengths=(90, 70), n_pairs=4, missing=0.1)
    model = replace(model, starts=model.starts * [[1.0], [0.0]])
    layout, gram, _ = signal_grams(parameters_of(model), records, rows, blocks_of(records, []), n_direct=2)
    signals = [loop_signals(model, r, one.inputs, one.outputs)[rows[r]] for r, one in enumerate(records)]
    asked = np.ones(layout.size, dtype=bool)
    for part in (layout.real, layout.imaginary):
        asked[part.stop - layout.n_poles : part.stop] = False
    expected = sum(own.T @ own for own in signals)[np.ix_(asked, asked)]
    np.testing.assert_allclose(gram[np.ix_(asked, asked)], expected, rtol=0, atol=1e-10 * np.abs(expected).max())
    assert not gram[~asked].any()


@pytest.mark.parametrize("decay", [2e-2, 1e-4, 1e-7])
def test_sums_that_follow_from_each_other_keep_their_digits_whatever_drives_lightly_damped_poles(decay):
    rng, n_samples = np.random.default_rng(6), 3000
    angles = np.r_[np.linspace(0.1, 2.8, 7), 0.1001]  # two of them nearly double
    slow = np.convolve(rng.standard_normal(n_samples), np.ones(200), mode="same")
    tones = [np.sin(angle * np.arange(n_samples) + phase) for angle, phase in rng.uniform(0.2, 2.0, (4, 2))]
    record = Record(np.column_stack([slow, *tones]), rng.standard_normal((n_samples, 2)), 0.1)
    model = ModalParameters(
        poles=np.exp(1j * angles - decay),
        is_pair=np.ones(angles.size, dtype=bool),
        inputs=rng.standard_normal((angles.size, 5, 2)) @ [1, 1j],
        states=rng.standard_normal((1, angles.size, 2)) @ [1, 1j],
    )
    blocks = blocks_of([record], [[[(1000, 2000)]]])
    for held_out in (NONE, 0, -1):
        layout, gram, _ = signal_grams(
            model, [record], [np.ones(n_samples, dtype=bool)], blocks, n_direct=5, held_out=held_out
        )
        signals = np.vstack([one for _, one in modal_states.signals_of(layout, model, 0, record)])
        own = np.vstack([signals[block.rows] for block in blocks if block.label != held_out])
        size = np.linalg.norm(own, axis=0)
        np.testing.assert_allclose(gram / np.outer(size, size), (own / size).T @ (own / size), rtol=0, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_the_loop_sensitivities_are_slopes_of_the_loop_states(seed):
    """The loop of the test above is itself held against differences of states."""
    model, (first, second), _ = a_case(seed, lengths=(50, 30))
    for r, record in enumerate((first, second)):
        sensitivities = loop_sensitivities(model, r, record.inputs)
        for i in range(model.poles.size):
            ways = (1.0, 1j) if model.is_pair[i] else (1.0,)
            log_pole = np.log(np.abs(model.poles[i]))
            places = [(("poles", (i,), way), log_pole if way == 1.0 else 1j, 0) for way in ways]
            places += [(("b", (i, j), way), way, 1 + j) for j in range(2) for way in ways]
            places += [(("starts", (s, i), way), way, 3 + s) for s in range(2) for way in ways]
            states = partial(states_of, i, r, record.inputs)
            slopes = differences(states, model, [place for place, *_ in places], step=1e-4)
            expected = [factor * sensitivities[:, where, i] for _, factor, where in places]
            np.testing.assert_allclose(slopes, expected, rtol=0, atol=1e-8 * np.abs(sensitivities[:, :, i]).max())


def states_of(i, r, inputs, model):
    return loop_states(model, r, inputs)[:, i]


def test_a_free_response_that_has_died_out_is_zero_not_subnormal():
    parameters = ModalParameters(
        poles=np.array([1e-3 + 0j, 0.9 + 0j]),
        is_pair=np.zeros(2, dtype=bool),
        inputs=np.ones((2, 1), dtype=complex),
        states=np.ones((1, 2), dtype=complex),
    )
    record = Record(np.zeros((400, 1)), np.zeros((400, 1)), 0.1)
    rows = [np.arange(400) >= 50]
    layout, gram, _ = signal_grams(parameters, [record], rows, blocks_of([record], []), n_direct=record.n_inputs)
    start = layout.places(0)[layout.alone.real.stop - 2]
    assert gram[start, start] == 0.0
    np.testing.assert_allclose(gram[start + 1, start + 1], 0.9**100 / (1 - 0.81), rtol=1e-12)


def test_a_hundred_thousand_samples_lose_no_digits():
    """Free responses are followed over many chunks by powers of powers; the geometric series has a closed form."""
    pole = np.exp(-1e-5 + 0.3j)
    parameters = ModalParameters(
        poles=np.array([pole]),
        is_pair=np.ones(1, dtype=bool),
        inputs=np.zeros((1, 1), dtype=complex),
        states=np.ones((1, 1), dtype=complex),
    )
    n = 100_000
    record = Record(np.zeros((n, 1)), np.zeros((n, 1)), 0.1)
    _, gram, _ = signal_grams(
        parameters, [record], [np.ones(n, dtype=bool)], blocks_of([record], []), n_direct=record.n_inputs
    )
    plain, conjugate = (1 - pole ** (2 * n)) / (1 - pole**2), (1 - abs(pole) ** (2 * n)) / (1 - abs(pole) ** 2)
    expected = 0.5 * np.array([[conjugate + plain.real, plain.imag], [plain.imag, conjugate - plain.real]])
    np.testing.assert_allclose(gram[:2, :2], expected, rtol=0, atol=1e-10 * conjugate)


@st.composite
def cut_records(draw):
    lengths = draw(st.lists(st.integers(1, 30), min_size=1, max_size=3))
    n_folds = draw(st.integers(0, 3))
    labels = [draw(st.lists(st.integers(-1, n_folds - 1), min_size=n, max_size=n)) for n in lengths]
    return lengths, n_folds, labels


@settings(deadline=None)
@given(cut_records())
def test_blocks_hold_every_row_once_with_its_fold(cut):
    lengths, n_folds, labels = cut
    folds = []
    for fold in range(n_folds):
        runs = []
        for own in labels:
            inside = np.diff(np.r_[0, np.array(own) == fold, 0].astype(int))
            runs.append(list(zip(np.flatnonzero(inside > 0), np.flatnonzero(inside < 0), strict=True)))
        folds.append(runs)
    records = [Record([], np.arange(float(n)), 1.0) for n in lengths]
    found = [[] for _ in lengths]
    for block in blocks_of(records, folds):
        assert block.first == len(found[block.record])
        assert block.last > block.first
        found[block.record] += [block.label] * (block.last - block.first)
    assert found == labels


def test_every_signal_has_one_place_and_records_share_what_they_share():
    layout = SignalLayout(n_poles=3, n_inputs=2, n_outputs=2, n_records=4, n_direct=2)
    roving = replace(layout, drives=((0,), (1,), (1,), (0,)))
    own = roving.places(0)
    assert np.unique(own).size == own.size == roving.alone.size
    assert set().union(*(set(roving.places(r)) for r in range(4))) == set(range(roving.size))
    slices = (layout.regressors, layout.real, layout.imaginary, layout.outputs)
    assert [i for one in slices for i in range(one.start, one.stop)] == list(range(layout.size))
    places = [layout.places(r) for r in range(4)]
    for own in places:
        assert np.unique(own).size == own.size
    assert set().union(*map(set, places)) == set(range(layout.size))
    shared = set.intersection(*map(set, places))
    # of one record alone: its level, and real and imaginary part of its initial states
    assert all(len(set(own) - shared) == 1 + 2 * 3 for own in places)
    assert layout.owners.tolist() == [0, 1, 2] * (1 + 2 + 4)
