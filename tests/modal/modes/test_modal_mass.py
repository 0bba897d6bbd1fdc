"""Sizes of modes against the matrices of a chain: rebuilt receptance, a shaken base, repeated tests."""

import dataclasses

import numpy as np
import pytest
import scipy

import modal
from era.realisation import Realisation
from modal.modes.extraction import extract_modes
from modal.modes.modal_mass import ScaledShapes, base_participation, normalise_shapes
from modal.modes.mode import ModalModel, Mode
from okid.errors import IdentificationWarning, InvalidDataError

MASS = np.diag([2.0, 1.0, 3.0])
STIFFNESS = 1e4 * np.array([[3.0, -1.0, 0.0], [-1.0, 2.5, -1.5], [0.0, -1.5, 1.5]])
DAMPING = 0.3 * MASS + 2e-5 * STIFFNESS
DT = 0.002
NAMES = ("a", "b", "c")


def known(force, *, unit="m", inputs=("f",)):
    """Modes of the chain, each believed, from its matrices alone: a held force, displacements or accelerations."""
    inverse = np.linalg.inv(MASS)
    A = np.block([[np.zeros((3, 3)), np.eye(3)], [-inverse @ STIFFNESS, -inverse @ DAMPING]])
    B = np.vstack([np.zeros_like(force), inverse @ force])
    C, D = (np.eye(3, 6), np.zeros_like(force)) if unit == "m" else (A[3:], B[3:])
    m = force.shape[1]
    step = scipy.linalg.expm(DT * np.block([[A, B], [np.zeros((m, 6 + m))]]))
    modes = extract_modes(Realisation(step[:6, :6], step[:6, 6:], C, D, DT))
    return dataclasses.replace(
        modes,
        modes=tuple(dataclasses.replace(mode, verdict="system") for mode in modes),
        output_names=NAMES,
        output_units=(unit,) * 3,
        input_names=inputs,
    )


def receptance(frequencies):
    w = 2 * np.pi * np.asarray(frequencies)[:, np.newaxis, np.newaxis]
    return np.linalg.inv(STIFFNESS - w**2 * MASS + 1j * w * DAMPING)


@pytest.mark.parametrize("unit", ["m", "m/s^2"])
def test_one_driving_point_rebuilds_the_receptance_between_all_sensors(unit):
    model = known(np.array([[0.0], [0.0], [1.0]]), unit=unit)
    lines = np.linspace(0.0, 40.0, 81)
    rebuilt = modal.scaled_response(model, modal.normalise_shapes(model, driving_point=("c", "f")), lines)
    assert rebuilt.response == pytest.approx(receptance(lines), rel=1e-6, abs=1e-12)
    assert rebuilt.names == NAMES


def test_the_interval_of_a_rebuilt_response_is_what_the_deviations_of_its_modes_make():
    model = known(np.array([[0.0], [0.0], [1.0]]))
    lines = np.linspace(5.0, 40.0, 36)
    scaled = modal.normalise_shapes(model, driving_point=("c", "f"))
    plain = modal.scaled_response(model, scaled, lines).response
    rng, std = np.random.default_rng(3), (2e-3, 2e-4, 0.01)
    told = tuple(
        dataclasses.replace(
            mode,
            frequency_std=std[0],
            damping_ratio_std=std[1],
            mass_std=np.full((3, 1), std[2]),
            shape_std=np.zeros(3),
        )
        for mode in model.modes
    )
    with_std = dataclasses.replace(model, modes=told)
    stated = modal.scaled_response(with_std, modal.normalise_shapes(with_std, driving_point=("c", "f")), lines)
    errors = []
    for _ in range(2000):  # modes drawn anew and summed here, not by the function that is asked
        drawn = np.zeros_like(plain)
        for k, mode in enumerate(model.modes):
            w = 2 * np.pi * (mode.frequency + std[0] * rng.standard_normal())
            zeta = mode.damping_ratio + std[1] * rng.standard_normal()
            # unit modal mass is known to std, its phase as well, and a residue goes with 1 / Im s
            shape = scaled.shapes[:, k]
            size = (1 + std[2] * (rng.standard_normal(2) @ (1, 1j))) * mode.pole.imag / (w * np.sqrt(1 - zeta**2))
            pole = w * (-zeta + 1j * np.sqrt(1 - zeta**2))
            residue = size * np.outer(shape, shape) / (2j * mode.pole.imag)
            s = 2j * np.pi * lines[:, np.newaxis, np.newaxis]
            drawn += residue / (s - pole) + residue.conj() / (s - np.conj(pole))
        errors.append(np.abs(drawn - plain) ** 2)
    assert stated.response_std == pytest.approx(np.sqrt(np.mean(errors, axis=0)), rel=0.1)


def test_a_mode_whose_mass_is_not_known_leaves_no_interval_of_a_rebuilt_response():
    model = known(np.array([[0.0], [0.0], [1.0]]))
    given = {"frequency_std": 1e-3, "damping_ratio_std": 1e-4, "shape_std": np.full(3, 1e-3)}
    sizes = (0.01, 0.01, 0.8)  # the driving point is a node of the last one
    modes = tuple(
        dataclasses.replace(mode, mass_std=np.full((3, 1), size), **given)
        for mode, size in zip(model.modes, sizes, strict=True)
    )
    model = dataclasses.replace(model, modes=modes)
    scaled = modal.normalise_shapes(model, driving_point=("c", "f"))
    rebuilt = modal.scaled_response(model, scaled, [1.0, 5.0])
    assert np.isnan(scaled.modal_mass[2])
    assert np.isfinite(rebuilt.response).all()
    assert np.isnan(rebuilt.response_std).all()


@pytest.mark.parametrize("driven", [0, 2])
def test_deviations_of_scaled_shapes_are_those_of_residues_whose_sensors_err_alone(driven):
    model = known(np.eye(3), inputs=("fa", "fb", "fc"))
    point = (NAMES[driven], model.input_names[driven])
    exact = modal.normalise_shapes(model, driving_point=point).shapes
    rng, n_draws = np.random.default_rng(5), 4000
    of_output, of_input = np.array([0.004, 0.002, 0.006]), 0.003
    own = of_output * (rng.standard_normal((n_draws, 3, 2)) @ (1, 1j))
    common = of_input * (rng.standard_normal((n_draws, 2)) @ (1, 1j))
    told, drawn = [], []
    for k, mode in enumerate(model.modes):
        residues = exact[:, k] * exact[driven, k] * (1 + own + common[:, np.newaxis])  # (n_draws, 3) of the one force
        largest = int(np.abs(exact[:, k]).argmax())
        shapes = residues / residues[:, largest, np.newaxis]
        relative = np.zeros((3, 3))
        relative[:, driven] = np.hypot(of_output, of_input)
        told.append(
            dataclasses.replace(
                mode, shape_std=shapes.std(axis=0), mass_std=relative, frequency_std=1e-9, damping_ratio_std=1e-9
            )
        )
        drawn.append(np.abs(residues / np.sqrt(residues[:, driven, np.newaxis])))
    scaled = modal.normalise_shapes(dataclasses.replace(model, modes=tuple(told)), driving_point=point)
    assert scaled.shapes_std == pytest.approx(np.std(drawn, axis=1).T, rel=0.06)
    largest = np.abs(exact).argmax(axis=0)
    masses = np.array([1 / sizes[:, row] ** 2 for sizes, row in zip(drawn, largest, strict=True)])
    assert scaled.modal_mass_std == pytest.approx(masses.std(axis=1), rel=0.06)


@pytest.mark.parametrize("unit", ["m", "m/s^2"])
def test_reciprocity_holds_for_symmetric_matrices_and_tells_of_a_wrong_gain(unit):
    forces = np.eye(3)[:, [0, 2]]
    model = known(forces, unit=unit, inputs=("fa", "fc"))
    exact = modal.reciprocity_error(model, ("a", "fa"), ("c", "fc"))
    assert exact.difference == pytest.approx(0.0, abs=1e-9)
    assert np.isnan(exact.difference_std).all()
    noisy = known(forces * [1.0, 1.1], unit=unit, inputs=("fa", "fc"))  # the second force is 10 % stronger than stated
    modes = tuple(dataclasses.replace(mode, mass_std=np.full((3, 2), 0.01)) for mode in noisy.modes)
    told = modal.reciprocity_error(dataclasses.replace(noisy, modes=modes), ("a", "fa"), ("c", "fc"))
    assert told.difference == pytest.approx(0.1 / 1.05, rel=1e-6)
    assert told.difference_std == pytest.approx(0.02, rel=0.01)
    with pytest.raises(InvalidDataError, match="no input 'fb'"):
        modal.reciprocity_error(model, ("a", "fa"), ("b", "fb"))


@pytest.mark.parametrize("unit", ["m", "m/s^2"])
def test_a_shaken_base_gives_the_effective_masses_of_the_matrices(unit):
    """Relative motion under a base's acceleration is what forces -M 1 make, so the matrices know every factor."""
    model = known(-MASS @ np.ones((3, 1)), unit=unit, inputs=("base",))
    masses = dict(zip(NAMES, np.diag(MASS), strict=True))
    found = modal.base_participation(model, base="base", masses=masses)
    _, vectors = scipy.linalg.eigh(STIFFNESS, MASS)
    gamma = vectors.T @ MASS @ np.ones(3)
    assert found.factors == pytest.approx(vectors * gamma, rel=1e-5, abs=1e-7)
    assert found.completeness == pytest.approx(np.ones(3), rel=1e-5)
    assert found.effective_mass == pytest.approx(gamma**2, rel=1e-5)
    assert found.effective_mass.sum() == pytest.approx(6.0, rel=1e-5)
    assert np.isnan(modal.base_participation(model, base="base").effective_mass).all()
    with pytest.raises(InvalidDataError, match="no input 'table'; the inputs are base"):
        modal.base_participation(model, base="table")
    with pytest.raises(InvalidDataError, match="masses are given for d"):
        modal.base_participation(model, base="base", masses={"d": 1.0})


def repeated(rng, n_tests, *, std, moved=0.0):
    """Tests whose frequencies and damping are drawn about the chain's with the deviations that they state."""
    model = known(np.array([[0.0], [0.0], [1.0]]))
    tests = []
    for _ in range(n_tests):
        modes = []
        for mode in model.modes:
            w = abs(mode.pole) + 2 * np.pi * np.hypot(std, moved) * rng.standard_normal()
            zeta = mode.damping_ratio + 1e-4 * rng.standard_normal()
            pole = w * (-zeta + 1j * np.sqrt(1 - zeta**2))
            own = {"frequency": w / 2 / np.pi, "damping_ratio": zeta, "frequency_std": std, "damping_ratio_std": 1e-4}
            modes.append(dataclasses.replace(mode, pole=pole, **own))
        tests.append(dataclasses.replace(model, modes=tuple(modes)))
    return tests


def test_scatter_of_repeated_tests_is_judged_by_the_deviations_that_they_state():
    rng = np.random.default_rng(8)
    many = [modal.mean_modes(repeated(rng, 5, std=0.01)) for _ in range(200)]
    assert np.mean([one.frequency_chi2 for one in many]) == pytest.approx(1.0, abs=0.1)
    assert np.mean([one.damping_ratio_chi2 for one in many]) == pytest.approx(1.0, abs=0.1)
    assert np.mean([one.p_values < 0.05 for one in many]) == pytest.approx(0.05, abs=0.025)
    scatter = np.sqrt(np.mean([one.frequency_scatter**2 for one in many]))
    assert scatter == pytest.approx(0.01, rel=0.1)
    other = modal.mean_modes(repeated(rng, 5, std=0.01, moved=0.05))
    assert (other.p_values[:, 0] < 1e-3).all()
    assert (other.frequency_scatter > 0.02).all()


def test_a_mode_that_one_test_does_not_show_is_averaged_over_the_others():
    tests = repeated(np.random.default_rng(2), 3, std=0.01)
    tests[2] = dataclasses.replace(tests[2], modes=tests[2].modes[1:])
    found = modal.mean_modes(tests)
    assert found.n_found.tolist() == [2, 3, 3]
    assert found.mean_frequency[0] == pytest.approx(np.mean([test.modes[0].frequency for test in tests[:2]]))
    with pytest.raises(InvalidDataError, match="at least two tests, but there is 1"):
        modal.mean_modes(tests[:1])


def test_an_input_in_another_unit_makes_no_wrong_mass_in_silence():
    mode = Mode(
        pole=-1 + 9j,
        kind="oscillatory",
        frequency=1.44,
        damping_ratio=0.11,
        shape=np.ones(1),
        participation=np.ones(1),
        verdict="system",
    )
    named = {"output_names": ("a",), "output_units": ("m/s^2",), "input_names": ("f",), "input_units": ("kN",)}
    model = ModalModel(modes=(mode,), dt=0.01, indicator_caution=0.1, **named)
    with pytest.raises(InvalidDataError, match="in N, but f is in kN"):
        normalise_shapes(model, driving_point=("a", "f"))
    with pytest.raises(InvalidDataError, match="in m/s\\^2, but f is in kN"):
        base_participation(model, base="f")


def with_deviations(model, std, **changes):
    modes = (dataclasses.replace(mode, mass_std=np.full((3, 1), std), **changes) for mode in model.modes)
    return dataclasses.replace(model, modes=tuple(modes))


@pytest.mark.parametrize("unit", ["m", "m/s^2"])
def test_the_phases_of_modes_tell_what_the_force_did_between_the_samples(unit):
    """The force was held; taken for band-limited, the masses are wrong by the sinc of half a sample."""
    model = with_deviations(known(np.array([[0.0], [0.0], [1.0]]), unit=unit), 0.003)
    right = normalise_shapes(model, driving_point=("c", "f")).modal_mass  # a warning would be an error here
    told = dataclasses.replace(model, input_hold="band_limited")
    steps = np.array([mode.pole for mode in model.system]) * DT
    factor = np.abs((1 - np.exp(-steps)) / steps)
    turned, changed = np.degrees(np.sqrt(np.mean((steps.imag / 2) ** 2))), 100 * np.max(1 - factor)
    with pytest.warns(IdentificationWarning, match=f"{turned:.1f} degrees off, 0.0 with zero_order.*{changed:.2g} %"):
        wrong = normalise_shapes(told, driving_point=("c", "f")).modal_mass
    assert wrong == pytest.approx(right / factor, rel=1e-3)
    noisy = with_deviations(told, 0.15)  # phases that nobody knows accuse nothing
    normalise_shapes(noisy, driving_point=("c", "f"))


def test_a_mode_that_no_measured_force_drives_has_no_mass_and_no_wrong_sign():
    model = known(np.array([[0.0], [0.0], [1.0]]))
    undriven = dataclasses.replace(model.modes[1], participation=np.zeros(1), mass_std=None)
    model = dataclasses.replace(model, modes=(model.modes[0], undriven, model.modes[2]))
    assert np.isnan(normalise_shapes(model, driving_point=("c", "f")).modal_mass).tolist() == [False, True, False]


def test_scaled_shapes_go_to_a_table():
    scaled = ScaledShapes(
        shapes=np.array([[1.0 + 2.0j, 3.0], [0.5, -1.0]]), shapes_std=np.array([[0.1, 0.2], [0.3, np.nan]]),
        modal_mass=np.array([2.0, 3.0]), modal_mass_std=np.array([0.1, np.nan]), driving_point=("tip", "force"),
        names=("tip", "mid"), frequencies=np.array([1.0, 2.0]),
    )  # fmt: skip
    table = scaled.to_table()
    assert table.schema.field("modal_mass").metadata == {b"unit": b"kg"}
    assert table.schema.metadata == {b"output_names": b"tip\nmid", b"driving_point": b"tip\nforce"}
    assert table.column("shape").to_pylist()[0] == [{"real": 1.0, "imaginary": 2.0}, {"real": 0.5, "imaginary": 0.0}]
    assert table.column("shape_std").to_pylist()[0] == [0.1, 0.3]
    assert table.column("frequency").to_pylist() == [1.0, 2.0]
