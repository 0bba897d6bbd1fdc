import dataclasses
from dataclasses import replace

import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st
from systems import markov, modal_system, random_system
from textbook_modal import textbook_era

import modal
from era.balanced import realise
from era.realisation import HankelFactors, Realisation
from modal.modes.extraction import extract_modes
from okid.errors import InvalidDataError, UnreadableFileError
from okid.markov import MarkovParameters

INDICATORS = ("amplitude_coherence", "emac_output", "emac_input", "emac", "cmi", "msv", "mpd", "phase_collinearity")


def realisation_of(A, n_inputs=1, n_outputs=2, dt=0.01):
    """Any A, with full rows of B and C so that every pole is driven and seen."""
    rng = np.random.default_rng(3)
    order = A.shape[0]
    B, C = rng.uniform(0.5, 1, (order, n_inputs)), rng.uniform(0.5, 1, (n_outputs, order))
    return Realisation(A, B, C, np.zeros((n_outputs, n_inputs)), dt)


def cut_from_data(h, n_rows, n_columns, order, dt=0.01):
    model = textbook_era(h, n_rows, n_columns, order)
    factors = HankelFactors(
        observability=model.observability,
        controllability=model.controllability,
        n_block_rows=n_rows,
        n_block_columns=n_columns,
        input_scale=np.ones(h.shape[2]),
        output_scale=np.ones(h.shape[1]),
        observer_order=None,
    )
    return Realisation(model.A, model.B, model.C, h[0], dt, factors=factors)


def of_poles(*poles):
    """A real A with these discrete poles, one of each pair given."""
    order = sum(2 if complex(pole).imag else 1 for pole in poles)
    A, i = np.zeros((order, order)), 0
    for pole in map(complex, poles):
        size = 2 if pole.imag else 1
        A[i : i + size, i : i + size] = [[pole.real, pole.imag], [-pole.imag, pole.real]] if pole.imag else pole.real
        i += size
    return realisation_of(A)


@pytest.mark.parametrize("seed", range(4))
def test_the_modes_of_a_random_system_come_back_exactly(seed):
    truth = random_system(np.random.default_rng(seed), n_real_poles=1)
    model = extract_modes(cut_from_data(markov(truth, 60), 30, 30, truth.order))
    assert len(model) == truth.poles.size
    for found, pole, shape, participation in zip(
        model, truth.poles, truth.shapes.T, truth.participation.T, strict=True
    ):
        assert abs(found.pole - pole) < 1e-8 * abs(pole)
        assert found.frequency == pytest.approx(abs(pole) / (2 * np.pi), rel=1e-8)
        assert found.damping_ratio == pytest.approx(-pole.real / abs(pole), abs=1e-8)
        np.testing.assert_allclose(found.shape, shape, atol=1e-7)
        np.testing.assert_allclose(found.participation, participation, atol=1e-7 * abs(participation).max())
        assert found.kind == ("oscillatory" if pole.imag else "real")


def test_residues_add_up_to_the_pulse_response():
    truth = random_system(np.random.default_rng(9), n_real_poles=2)
    h = markov(truth, 80)
    model = extract_modes(cut_from_data(h, 30, 30, truth.order))
    for k in range(1, 80):
        total = np.zeros(h.shape[1:])
        for mode in model:
            term = np.outer(mode.shape, mode.participation) * np.exp(mode.pole * truth.dt) ** (k - 1)
            total += 2 * term.real if mode.kind == "oscillatory" else term.real
        np.testing.assert_allclose(total, h[k], atol=1e-9 * abs(h).max())


@pytest.mark.parametrize(
    ("pole", "kind", "verdict"),
    [
        (0.9 * np.exp(0.3j), "oscillatory", "doubtful"),
        (0.9 * np.exp(3.13j), "oscillatory", "doubtful"),
        (0.9 * np.exp(3.14j), "oscillatory", "noise"),  # a natural frequency above half of the sampling frequency
        (1.0 * np.exp(0.3j), "oscillatory", "doubtful"),
        ((1 + 1e-7) * np.exp(0.3j), "unstable", "noise"),
        (1.01 * np.exp(3.1j), "unstable", "noise"),
        (0.7, "real", "doubtful"),
        (1.0, "real", "doubtful"),
        (1.001, "unstable", "noise"),
        (-0.7, "nyquist", "noise"),
        (-1.0, "nyquist", "noise"),
        (-1.001, "unstable", "noise"),
    ],
)
def test_poles_are_named_as_what_they_are(pole, kind, verdict):
    (mode,) = extract_modes(of_poles(pole))
    assert (mode.kind, mode.verdict) == (kind, verdict)
    words = {"unstable": "grows in time", "nyquist": "a negative real pole", "real": "a real pole: overdamped or drift"}
    assert mode.reason.startswith(words.get(kind, ""))
    assert ("not judged: repeatability needs the records" in mode.reason) == (verdict == "doubtful")
    assert (mode.probability == 0) == (verdict == "noise")


def test_a_growing_pole_has_negative_damping_and_a_nyquist_pole_half_the_sampling_frequency():
    (growing,) = extract_modes(of_poles(1.01 * np.exp(0.3j)))
    assert growing.damping_ratio < 0
    (nyquist,) = extract_modes(of_poles(-0.999))
    assert nyquist.pole.imag == pytest.approx(np.pi / 0.01)
    assert nyquist.frequency == pytest.approx(50.0, rel=1e-5)


def test_an_integrator_has_no_damping_ratio():
    (mode,) = extract_modes(of_poles(1.0))
    assert mode.frequency == 0
    assert np.isnan(mode.damping_ratio)


@pytest.mark.parametrize(("small", "n_modes"), [(0.0, 1), (0.9e-3, 1), (1.1e-3, 2), (-0.9e-3, 1)])
def test_a_pole_that_dies_within_one_sample_is_left_out(small, n_modes):
    assert len(extract_modes(of_poles(0.9 * np.exp(0.3j), small))) == n_modes


def test_deadbeat_is_relative_to_a_larger_pole():
    assert len(extract_modes(of_poles(2.0, 1.9e-3))) == 1
    assert len(extract_modes(of_poles(2.0, 2.1e-3))) == 2


def test_a_pure_delay_adds_no_mode():
    vibrating = 0.98 * np.exp(0.4j)
    A = np.zeros((5, 5))
    A[:2, :2] = [[vibrating.real, vibrating.imag], [-vibrating.imag, vibrating.real]]
    A[3, 2] = A[4, 3] = 1  # three samples of delay behind the vibration, a defective pole at 0
    A[2, :2] = 1
    (mode,) = extract_modes(realisation_of(A))
    assert mode.pole * 0.01 == pytest.approx(np.log(vibrating), abs=1e-10)


@pytest.mark.parametrize(("share", "remarked"), [(0.94, False), (0.96, True)])
def test_a_frequency_next_to_nyquist_is_remarked(share, remarked):
    (mode,) = extract_modes(of_poles(0.99 * np.exp(1j * np.pi * share)))
    assert ("may be an alias" in mode.reason) == remarked


def test_37_hz_sampled_at_50_hz_appears_at_13_hz_with_more_damping():
    """THEORY 4.1: 13.0 Hz and 0.028 for a damping ratio of 0.010."""
    decay, damped = 0.01 * 2 * np.pi * 37, 2 * np.pi * 37 * np.sqrt(1 - 0.01**2)
    (mode,) = extract_modes(
        replace(of_poles(np.exp(-decay * 0.02) * np.exp(-1j * (damped * 0.02 - 2 * np.pi))), dt=0.02)
    )
    assert mode.frequency == pytest.approx(13.0, abs=0.02)
    assert mode.damping_ratio == pytest.approx(0.028, abs=5e-4)
    assert mode.pole.imag / (2 * np.pi) == pytest.approx(50 - damped / (2 * np.pi), rel=1e-9)


def test_defective_poles_do_not_crash_and_are_said_to_coincide():
    single = 0.9 * np.exp(0.5j)
    block = np.array([[single.real, single.imag], [-single.imag, single.real]])
    for A in (np.array([[0.5, 1.0], [0.0, 0.5]]), np.block([[block, np.eye(2)], [np.zeros((2, 2)), block]])):
        modes = extract_modes(realisation_of(A)).modes
        assert len(modes) >= 1
        for mode in modes:
            assert np.isfinite(mode.shape).all()
            assert np.isfinite(mode.participation).all()
            assert "coincides with another one" in mode.reason


def test_two_modes_at_one_pole_with_shapes_of_their_own_are_no_defect():
    single = 0.9 * np.exp(0.5j)
    modes = extract_modes(of_poles(single, single)).modes
    assert len(modes) == 2
    assert not any("coincides" in mode.reason for mode in modes)


def test_order_zero_gives_no_mode():
    model = extract_modes(Realisation(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((2, 0)), np.ones((2, 1)), 0.01))
    assert len(model) == 0
    assert model.indicator_caution != model.indicator_caution


def test_data_without_dynamics_give_no_mode_and_no_error():
    pulse = np.zeros((20, 2, 1))
    pulse[0] = 1.0  # a feedthrough and nothing else
    model = extract_modes(realise(MarkovParameters(system=pulse, dt=0.01)))
    assert len(model) == 0
    assert model.indicator_caution == 0.0


def test_without_inputs_participation_is_empty():
    (mode,) = extract_modes(replace(of_poles(0.9j), B=np.zeros((2, 0)), D=np.zeros((2, 0)), K=np.ones((2, 2))))
    assert mode.participation.shape == (0,)
    assert mode.frequency == pytest.approx(abs(np.log(0.9j)) / (2 * np.pi * 0.01))


def test_without_hankel_factors_indicators_are_nan_and_the_model_says_why():
    model = extract_modes(of_poles(0.9j))
    assert all(np.isnan(getattr(model.modes[0], name)) for name in INDICATORS)
    assert "no Hankel factors" in model.indicators_missing
    assert np.isnan(model.indicator_caution)


def test_with_factors_all_are_there_and_caution_is_order_over_past_outputs():
    truth = random_system(np.random.default_rng(0))
    direct = cut_from_data(markov(truth, 60), 30, 30, truth.order)
    model = extract_modes(direct)
    assert model.indicators_missing == ""
    assert all(np.isfinite(getattr(mode, name)) for mode in model for name in INDICATORS)
    assert model.indicator_caution == pytest.approx(6 / (30 * 3))
    observed = replace(direct, factors=replace(direct.factors, observer_order=12))
    assert extract_modes(observed).indicator_caution == pytest.approx(6 / (12 * 3))


def test_without_system_modes_shapes_keep_their_number_of_rows():
    assert extract_modes(of_poles(0.9j)).shapes.shape == (2, 0)


# --- invariants -------------------------------------------------------------------------------------------------------

SEEDS = st.integers(0, 10_000)


def same(first, second, *, names=("pole", "frequency", "damping_ratio", "shape", "participation", *INDICATORS)):
    for a, b in zip(first, second, strict=True):
        for name in names:
            np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=1e-5, atol=1e-7)


def noisy(seed):
    rng = np.random.default_rng(seed)
    truth = modal_system(rng, frequencies=[6, 11, 23], damping_ratios=[0.02, 0.01, 0.015])
    h = markov(truth, 48)
    return h + 0.02 * h.std() * rng.standard_normal(h.shape), rng


@settings(max_examples=15, deadline=None)
@given(seed=SEEDS)
def test_a_similarity_transform_leaves_modes_alone(seed):
    h, rng = noisy(seed)
    given_model = cut_from_data(h, 24, 24, 8)
    T = np.linalg.qr(rng.standard_normal((8, 8)))[0] * rng.uniform(0.5, 2, 8)
    inverse, factors = np.linalg.inv(T), given_model.factors
    turned = replace(
        given_model,
        A=inverse @ given_model.A @ T,
        B=inverse @ given_model.B,
        C=given_model.C @ T,
        factors=replace(
            factors, observability=factors.observability @ T, controllability=inverse @ factors.controllability
        ),
    )
    same(extract_modes(given_model), extract_modes(turned))


@settings(max_examples=15, deadline=None)
@given(seed=SEEDS, order=st.permutations([0, 1, 2]))
def test_permuted_outputs_permute_shapes(seed, order):
    h, _ = noisy(seed)
    first, second = extract_modes(cut_from_data(h, 24, 24, 6)), extract_modes(cut_from_data(h[:, order], 24, 24, 6))
    for a, b in zip(first, second, strict=True):
        np.testing.assert_allclose(a.shape[order], b.shape, atol=1e-6)
        assert a.emac == pytest.approx(b.emac, abs=1e-6)


@settings(max_examples=15, deadline=None)
@given(seed=SEEDS)
def test_twice_the_time_step_halves_frequencies(seed):
    h, _ = noisy(seed)
    once = cut_from_data(h, 24, 24, 6)
    for a, b in zip(extract_modes(once), extract_modes(replace(once, dt=0.02)), strict=True):
        assert b.frequency == pytest.approx(a.frequency / 2)
        assert b.damping_ratio == pytest.approx(a.damping_ratio)
        assert b.emac == a.emac


@settings(max_examples=15, deadline=None)
@given(seed=SEEDS, factor=st.floats(1e-4, 1e4))
def test_an_input_in_another_unit_scales_participation_only(seed, factor):
    h, _ = noisy(seed)
    plain = cut_from_data(h, 24, 24, 6)
    other = replace(plain, B=plain.B / factor, factors=replace(plain.factors, input_scale=np.full(2, factor)))
    first, second = extract_modes(plain), extract_modes(other)
    same(first, second, names=("pole", "shape", *INDICATORS))
    for a, b in zip(first, second, strict=True):
        np.testing.assert_allclose(b.participation * factor, a.participation, rtol=1e-9)


MASS = np.diag([2.0, 1.0, 3.0])
STIFFNESS = 1e4 * np.array([[3.0, -1.0, 0.0], [-1.0, 2.5, -1.5], [0.0, -1.5, 1.5]])
DAMPING = 0.3 * MASS + 2e-5 * STIFFNESS
UNITS = ("m", "m/s", "m/s^2")


def chain_model(units, *, dt=0.002):
    """Modes of three masses with forces on the first and the last, from the matrices alone: held force, exact."""
    inverse = np.linalg.inv(MASS)
    A = np.block([[np.zeros((3, 3)), np.eye(3)], [-inverse @ STIFFNESS, -inverse @ DAMPING]])
    B = np.vstack([np.zeros((3, 2)), inverse[:, [0, 2]]])
    rows = {"m": np.eye(3, 6), "m/s": np.eye(3, 6, 3), "m/s^2": A[3:]}
    C = np.array([rows[unit][place] for place, unit in enumerate(units)])
    D = np.array([B[3 + place] if unit == "m/s^2" else np.zeros(2) for place, unit in enumerate(units)])
    step = scipy.linalg.expm(dt * np.block([[A, B], [np.zeros((2, 8))]]))
    modes = extract_modes(Realisation(step[:6, :6], step[:6, 6:], C, D, dt))
    believed = tuple(dataclasses.replace(mode, verdict="system") for mode in modes)
    return dataclasses.replace(
        modes, modes=believed, output_names=("a", "b", "c"), output_units=units, input_names=("fa", "fc")
    )


@pytest.mark.parametrize("units", [("m",) * 3, ("m/s",) * 3, ("m/s^2",) * 3, UNITS])
@pytest.mark.parametrize("point", [("a", "fa"), ("c", "fc")])
def test_shapes_for_unit_modal_mass_are_those_of_the_matrices(units, point):
    scaled = modal.normalise_shapes(chain_model(units), driving_point=point)
    _, vectors = scipy.linalg.eigh(STIFFNESS, MASS)
    assert np.abs(scaled.shapes) == pytest.approx(np.abs(vectors), rel=1e-7)
    assert scaled.modal_mass == pytest.approx(1.0 / np.abs(vectors).max(axis=0) ** 2, rel=1e-7)


def test_a_pair_of_channels_that_is_no_driving_point_is_refused_where_it_shows():
    model = chain_model(UNITS)
    with pytest.raises(InvalidDataError, match="negative modal mass at c and fa"):
        modal.normalise_shapes(model, driving_point=("c", "fa"))
    with pytest.raises(InvalidDataError, match="no input 'f'; the inputs are fa, fc"):
        modal.normalise_shapes(model, driving_point=("a", "f"))
    with pytest.raises(InvalidDataError, match="needs a driving point"):
        modal.normalise_shapes(dataclasses.replace(model, input_names=()), driving_point=("a", "fa"))
    volts = dataclasses.replace(model, output_units=("V", "m", "m"))
    with pytest.raises(InvalidDataError, match="a is in V"):
        modal.normalise_shapes(volts, driving_point=("a", "fa"))


def test_a_mode_that_the_driving_point_does_not_show_has_no_mass_and_spoils_no_other():
    """At its node a residue is noise of either sign: known to 60 %, it refuses nothing; to 40 %, a sign is a sign."""
    model = chain_model(UNITS)
    fine, vague = np.full((3, 2), 0.01), np.full((3, 2), 0.6)
    known = [dataclasses.replace(mode, mass_std=fine) for mode in model.modes]
    known[1] = dataclasses.replace(known[1], mass_std=vague, participation=-known[1].participation)
    scaled = modal.normalise_shapes(dataclasses.replace(model, modes=tuple(known)), driving_point=("a", "fa"))
    whole = modal.normalise_shapes(model, driving_point=("a", "fa"))
    assert np.isnan(scaled.modal_mass).tolist() == [False, True, False]
    assert scaled.modal_mass[[0, 2]].tolist() == whole.modal_mass[[0, 2]].tolist()
    assert np.isnan(scaled.shapes).any(axis=0).tolist() == [False, True, False]
    known[1] = dataclasses.replace(known[1], mass_std=0.4 / 0.6 * vague)
    with pytest.raises(InvalidDataError, match="negative modal mass at a and fa"):
        modal.normalise_shapes(dataclasses.replace(model, modes=tuple(known)), driving_point=("a", "fa"))


def test_sets_are_joined_by_the_names_of_their_channels():
    model = chain_model(("m",) * 3)
    names = ("c", "extra", "a", "b")
    turned = model.shapes[[2, 0, 0, 1]][:, [2, 0]] * np.array([2j, -3.0])
    other = modal.Shapes(turned, names, model.frequencies[[2, 0]])
    assert modal.assurance(model, other)[[2, 0], [0, 1]] == pytest.approx(1.0)
    found = modal.pair_modes(model, other)
    assert found.pairs == ((0, 1), (2, 0))
    assert found.only_first == (1,)
    assert found.only_second == ()
    assert modal.coordinate_assurance(model, other) == pytest.approx(1.0)
    with pytest.raises(InvalidDataError, match="no channel in common"):
        modal.assurance(model, modal.Shapes([[1.0]], ["elsewhere"]))


def test_a_channel_whose_sign_is_turned_in_one_mode_shows_in_its_coordinate_assurance():
    model = chain_model(("m",) * 3)
    wrong = model.shapes.copy()
    wrong[0, 1] *= -1
    found = modal.coordinate_assurance(model, modal.Shapes(wrong, ("a", "b", "c"), model.frequencies))
    assert found.argmin() == 0


@pytest.mark.parametrize("ending", [".csv", ".npz"])
def test_shapes_come_back_from_a_file(tmp_path, ending):
    shapes, names, frequencies = np.array([[1.0, 0.5 - 0.25j], [0.1j, 1.0]]), ("12X+", "3Z+"), np.array([1.5, 20.0])
    path = tmp_path / f"shapes{ending}"
    if ending == ".npz":
        np.savez(path, shapes=shapes, names=np.array(names), frequencies=frequencies)
    else:
        rows = ["channel,1.5 Hz,20 Hz"]
        rows += [
            ",".join([name, *(f"{z.real}{z.imag:+}j" for z in row)]) for name, row in zip(names, shapes, strict=True)
        ]
        path.write_text("\n".join(rows))
    found = modal.read_shapes(path)
    assert found.names == names
    assert found.frequencies.tolist() == frequencies.tolist()
    assert np.array_equal(found.shapes, shapes)


@pytest.mark.parametrize(
    "content", [b"", b"a,b\nc,not a number\n", b"\x00\xff\x00", b"channel,1 Hz\na,1\na,2\n", b"channel,1 Hz\na,1_0\n"]
)
def test_a_file_without_shapes_is_told_in_one_sentence(tmp_path, content):
    for ending in (".csv", ".npz", ".uff"):
        path = tmp_path / f"broken{ending}"
        path.write_bytes(content)
        with pytest.raises(UnreadableFileError):
            modal.read_shapes(path)


def test_a_shape_without_end_is_refused_by_us_and_not_warned_of_by_the_reader(tmp_path):
    """One of 10 000 damaged files: the library multiplies before we look, and numpy said so on stderr."""
    pyuff = pytest.importorskip("pyuff")
    path = tmp_path / "shapes.uff"
    one = pyuff.prepare_55(
        model_type=1,
        analysis_type=3,
        data_ch=3,
        spec_data_type=8,
        data_type=5,
        load_case=1,
        mode_n=1,
        eig=-0.1 + 6j,
        modal_a=0.5 + 0.5j,
        modal_b=0.5 + 0.5j,
        node_nums=np.array([1]),
        **{f"r{axis}": np.array([12345.0 + 12345.0j]) for axis in (1, 2, 3)},
    )
    pyuff.UFF(str(path)).write_sets([one], "overwrite")
    path.write_text(path.read_text().replace("1.23450e+04", "        inf"))
    with pytest.raises(UnreadableFileError, match="must be finite numbers"):
        modal.read_shapes(path)


def test_the_table_of_modes_has_a_row_a_mode_and_its_shape():
    model = chain_model(UNITS)
    table = model.to_table()
    assert table.column("frequency").to_pylist() == sorted(mode.frequency for mode in model)
    shape = table.column("shape").to_pylist()[0]
    assert [complex(z["real"], z["imaginary"]) for z in shape] == model.modes[0].shape.tolist()
    assert table.schema.field("shape").metadata[b"output_names"] == b"a\nb\nc"
