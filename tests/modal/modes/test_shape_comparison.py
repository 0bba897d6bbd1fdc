import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modal.modes.mode import ModalModel, Mode
from modal.modes.shape_comparison import (
    Shapes,
    assurance,
    energies,
    overlap_matrix,
    pair_greatest_first,
    pair_modes,
    pulses,
    repeatability,
)
from okid.errors import InvalidDataError


def test_it_is_the_formula_shape_by_shape():
    rng = np.random.default_rng(1)
    first, second = (rng.standard_normal((4, n)) + 1j * rng.standard_normal((4, n)) for n in (3, 2))
    for i in range(3):
        for j in range(2):
            a, b = first[:, i], second[:, j]
            expected = abs(a.conj() @ b) ** 2 / ((a.conj() @ a) * (b.conj() @ b)).real
            assert assurance(first, second)[i, j] == pytest.approx(expected, abs=1e-12)


def test_scaling_a_shape_by_any_complex_number_changes_nothing():
    rng = np.random.default_rng(2)
    shapes = rng.standard_normal((5, 3)) + 1j * rng.standard_normal((5, 3))
    np.testing.assert_allclose(assurance(shapes, shapes * np.array([2.0, -1j, 3 + 4j])), assurance(shapes, shapes))
    np.testing.assert_allclose(np.diag(assurance(shapes, shapes)), 1.0)


def test_a_shape_of_zeros_is_like_none():
    assert assurance(np.zeros((3, 1)), np.ones((3, 1))) == 0


def test_no_modes_give_an_empty_table():
    assert assurance(np.empty((3, 0)), np.ones((3, 2))).shape == (0, 2)


@pytest.mark.parametrize(("first", "second"), [((3, 1), (4, 1)), ((3,), (3, 1))])
def test_shapes_over_different_outputs_are_refused(first, second):
    with pytest.raises(InvalidDataError, match="over the same outputs"):
        assurance(np.ones(first), np.ones(second))


DT = 0.01


def mode_of(discrete, shape, participation):
    """Any discrete pole; a real one has a real residue."""
    discrete = complex(discrete)
    pole = complex(np.log(discrete) / DT)
    kind = "oscillatory" if discrete.imag else "real" if discrete.real > 0 else "nyquist"
    return Mode(
        pole=pole,
        kind=kind,
        frequency=abs(pole) / (2 * np.pi),
        damping_ratio=-pole.real / abs(pole) if pole else np.nan,
        shape=np.asarray(shape, dtype=complex),
        participation=np.asarray(participation, dtype=complex),
    )


def response(mode, n_steps):
    """h_0 ... h_(L-1), one after the other."""
    discrete = np.exp(mode.pole * DT)
    if mode.kind != "oscillatory":
        discrete = complex(discrete.real)
    residue = np.outer(mode.shape, mode.participation)
    series = [residue * discrete**k for k in range(n_steps)]
    return np.array([2 * h.real if mode.kind == "oscillatory" else h.real for h in series])


def brute_force(first, second, n_steps):
    one, two = response(first, n_steps), response(second, n_steps)
    return max(0.0, (one * two).sum() / max((one**2).sum(), (two**2).sum()))


def random_modes(rng, n_modes, n_outputs=3, n_inputs=2):
    """Oscillatory, real and Nyquist poles in turn, stable and slightly unstable."""
    modes = []
    for i in range(n_modes):
        size = rng.uniform(0.6, 1.01)
        if i % 4 < 2:
            shape, participation = (rng.standard_normal(n) + 1j * rng.standard_normal(n) for n in (n_outputs, n_inputs))
            modes.append(mode_of(size * np.exp(1j * rng.uniform(0.05, 3.1)), shape, participation))
        else:
            sign = 1 if i % 4 == 2 else -1
            modes.append(mode_of(sign * size, rng.standard_normal(n_outputs), rng.standard_normal(n_inputs)))
    return modes


def overlaps(first, second, n_steps, **scales):
    return overlap_matrix(pulses(first, dt=DT, **scales), pulses(second, dt=DT, **scales), n_steps=n_steps)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), n_steps=st.integers(2, 120))
def test_the_closed_form_is_the_sum(seed, n_steps):
    rng = np.random.default_rng(seed)
    first, second = random_modes(rng, 5), random_modes(rng, 4)
    second[0] = mode_of(np.exp(first[0].pole * DT) * 0.999, first[0].shape * 1.05, first[0].participation)
    table = overlaps(first, second, n_steps)
    for i, a in enumerate(first):
        for j, b in enumerate(second):
            assert table[i, j] == pytest.approx(brute_force(a, b, n_steps), abs=1e-10)
    expected = [(response(mode, n_steps) ** 2).sum() for mode in first]
    np.testing.assert_allclose(energies(pulses(first, dt=DT), n_steps=n_steps), expected, rtol=1e-10)


@pytest.mark.parametrize("apart", [0.0, 1e-13, 1e-11, 1e-9, 1e-6, 1e-3])
def test_nearly_undamped_nearly_equal_poles_lose_no_digits(apart):
    """Here 1 - x in the closed form nearly vanishes."""
    first = mode_of((1 - apart) * np.exp(0.4j), [1.0, 0.5j], [2.0])
    second = mode_of(np.exp(1j * (0.4 + apart)), [1.0, 0.4j], [2.1])
    assert overlaps([first], [second], 300)[0, 0] == pytest.approx(brute_force(first, second, 300), abs=1e-10)
    real = mode_of(1 - apart, [1.0, 0.5], [2.0])
    assert overlaps([real], [real], 300)[0, 0] == pytest.approx(1, abs=1e-12)


def test_a_mode_overlaps_itself_by_one_and_its_negative_by_nothing():
    mode = random_modes(np.random.default_rng(0), 1)[0]
    opposite = mode_of(np.exp(mode.pole * DT), -mode.shape, mode.participation)
    np.testing.assert_allclose(overlaps([mode], [mode, opposite], 80), [[1, 0]], atol=1e-12)


def test_size_counts_too():
    mode = mode_of(0.98 * np.exp(0.3j), [1.0, 0.5], [1.0])
    half = mode_of(0.98 * np.exp(0.3j), [0.5, 0.25], [1.0])
    assert overlaps([mode], [half], 80)[0, 0] == pytest.approx(0.5)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), size=st.floats(0.01, 100), angle=st.floats(-3, 3))
def test_the_scaling_of_eigenvectors_cancels(seed, size, angle):
    first, second = random_modes(np.random.default_rng(seed), 2)
    factor = size * np.exp(1j * angle)
    scaled = mode_of(np.exp(second.pole * DT), second.shape * factor, second.participation / factor)
    assert overlaps([first], [second], 60) == pytest.approx(overlaps([first], [scaled], 60), abs=1e-12)
    assert overlaps([first], [second], 60) == pytest.approx(overlaps([second], [first], 60), abs=1e-12)


def test_scales_undo_a_change_of_unit():
    first, second = random_modes(np.random.default_rng(5), 2)
    plain = overlaps([first], [second], 60)
    units, drive = np.array([1e3, 1.0, 1e-3]), np.array([10.0, 0.01])
    other = [mode_of(np.exp(m.pole * DT), m.shape * units, m.participation / drive) for m in (first, second)]
    scaled = overlaps([other[0]], [other[1]], 60, output_scale=units, input_scale=drive)
    assert scaled == pytest.approx(plain, abs=1e-12)
    assert overlaps([other[0]], [other[1]], 60) != pytest.approx(plain, abs=1e-3)


def test_a_model_without_inputs_is_compared_by_free_responses():
    mode = mode_of(0.98 * np.exp(0.3j), [1.0, 0.5], [])
    other = mode_of(0.98 * np.exp(0.3j), [1.0, -0.5], [])
    table = overlaps([mode], [mode, other], 80)
    assert table[0, 0] == pytest.approx(1)
    assert table[0, 1] < 0.9


def test_a_pulse_response_too_large_for_a_float_overlaps_nothing():
    wild = mode_of(3.0 * np.exp(0.3j), [1.0], [1.0])
    calm = mode_of(0.9 * np.exp(0.3j), [1.0], [1.0])
    table = overlaps([wild, calm], [wild, calm], 2000)
    assert table[1, 1] == pytest.approx(1)
    assert table[0, 0] == table[0, 1] == table[1, 0] == 0


def test_overlap_no_modes_give_an_empty_table():
    mode = mode_of(0.9j, [1.0], [1.0])
    assert overlaps([], [mode], 10).shape == (0, 1)
    assert overlaps([mode], [], 10).shape == (1, 0)


def naive_pairing(table):
    table, partner = np.array(table), np.full(len(table), -1)
    while table.size and table.max() > 0:
        i, j = np.unravel_index(table.argmax(), table.shape)
        partner[i] = j
        table[i], table[:, j] = 0, 0
    return partner


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), n_rows=st.integers(0, 7), n_columns=st.integers(1, 7))
def test_pairing_takes_the_greatest_left_one_to_one(seed, n_rows, n_columns):
    table = np.clip(np.random.default_rng(seed).uniform(-0.3, 1, (n_rows, n_columns)), 0, 1)
    partner = pair_greatest_first(table)
    np.testing.assert_array_equal(partner, naive_pairing(table))
    paired = partner[partner >= 0]
    assert len(set(paired.tolist())) == paired.size


def test_repeatability_is_the_mean_over_runs_and_names_the_continuation():
    rng = np.random.default_rng(2)
    modes = random_modes(rng, 3)
    nearly = mode_of(np.exp(modes[1].pole * DT), modes[1].shape * 0.8, modes[1].participation)
    runs = [modes[::-1], [nearly, modes[0]]]
    found = repeatability(pulses(modes, dt=DT), [pulses(run, dt=DT) for run in runs], n_steps=100)
    np.testing.assert_array_equal(found.continuation[0], [2, 1, 0])
    np.testing.assert_array_equal(found.continuation[1], [1, 0, -1])
    np.testing.assert_allclose(found.parts, [[1, 1, 1], [1, 0.8, 0]], atol=1e-12)
    np.testing.assert_allclose(found.mean, [1, 0.9, 0.5], atol=1e-12)


def test_without_runs_repeatability_is_not_known():
    found = repeatability(pulses(random_modes(np.random.default_rng(0), 2), dt=DT), [], n_steps=10)
    assert np.isnan(found.mean).all()
    assert found.parts.shape == (0, 2)


def test_the_deviation_of_a_mac_is_that_of_shapes_drawn_anew():
    """Against a long run of draws, far from 1 and at 1, with the channels of the sets in different orders."""
    rng = np.random.default_rng(23001)
    names, exact = ("a", "b", "c", "d"), np.array([1.0, 0.8, -0.5, 0.3])
    for turned in (0.0, 0.4):
        shape = (exact + turned * np.array([0.3, -1.0, 0.2, 0.9])).astype(complex)
        std = np.array([0.02, 0.05, 0.01, 0.03])
        mode = Mode(pole=-0.1 + 9j, kind="oscillatory", frequency=1.4, damping_ratio=0.01, shape=shape,
                    participation=np.ones(1), verdict="system", shape_std=std)  # fmt: skip
        model = ModalModel(modes=(mode,), dt=0.01, indicator_caution=0.1, output_names=names)
        order = [2, 0, 3, 1]
        pairs = pair_modes(model, Shapes(exact[order][:, np.newaxis], [names[k] for k in order]))
        drawn = shape + std / np.sqrt(2) * (rng.standard_normal((20000, 4)) + 1j * rng.standard_normal((20000, 4)))
        mac = np.abs(drawn @ exact) ** 2 / ((np.abs(drawn) ** 2).sum(axis=1) * (exact @ exact))
        truth = np.sqrt(((mac - pairs.assurance[0]) ** 2).mean())
        assert pairs.assurance_std[0] == pytest.approx(truth, rel=0.12)
    given = Shapes([[1.0], [0.5]], ["a", "b"])
    assert np.isnan(pair_modes(given, given).assurance_std).all()


def test_one_channel_in_common_pairs_no_modes_by_shape():
    """Every MAC is 1 there, and 20 Hz was paired with 30."""
    first = Shapes([[1.0, 1.0], [1.0, -1.0]], ["a", "b"])
    with pytest.raises(InvalidDataError, match="with one every MAC is 1"):
        pair_modes(first, Shapes([[1.0, 1.0]], ["b"]))
    known = [Shapes(one.shapes, one.names, frequencies=[10.0, 20.0]) for one in (first, Shapes([[1.0, 2.0]], ["b"]))]
    assert pair_modes(*known).pairs == ((0, 0), (1, 1))


def test_pairs_go_to_a_table_and_none_is_lost():
    one = Shapes([[1.0, 1.0, 1.0], [1.0, -1.0, 0.0], [0.0, 0.0, 9.0]], ["a", "b", "c"])
    pairs = pair_modes(one, Shapes([[1.0, 0.0], [-1.1, 1.0], [0.0, 0.0]], ["a", "b", "c"]))
    rows = pairs.to_table().to_pylist()
    assert [(row["first"], row["second"]) for row in rows[: len(pairs.pairs)]] == list(pairs.pairs)
    assert [row["assurance"] for row in rows[: len(pairs.pairs)]] == pairs.assurance.tolist()
    assert [row["first"] for row in rows if row["second"] is None] == list(pairs.only_first)
    assert [row["second"] for row in rows if row["first"] is None] == list(pairs.only_second)
    assert pairs.only_first
