"""The realisation type: what it refuses, what it freezes, and the road to and from python-control."""

from dataclasses import replace

import numpy as np
import pytest
from systems import markov, random_system

import era
from era.balanced import realise
from era.realisation import HankelFactors, Realisation
from okid.errors import IdentificationWarning, InvalidDataError
from okid.markov import MarkovParameters


def model_of(seed=0, **options):
    system = random_system(np.random.default_rng(seed))
    return realise(MarkovParameters(system=markov(system, 40), dt=system.dt), **options)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"A": np.ones((2, 3))}, r"A must have shape \(2, 2\)"),
        ({"B": np.ones((3, 1))}, r"B must have shape \(2, 1\)"),
        ({"C": np.ones((1, 3))}, r"C must have shape \(1, 2\)"),
        ({"D": np.ones((2, 1))}, r"C must have shape \(2, 2\)"),
        ({"K": np.ones((2, 2))}, r"K must have shape \(2, 1\)"),
        ({"A": np.full((2, 2), np.nan)}, "A must be finite"),
        ({"dt": 0.0}, "dt must be a positive"),
        ({"dt": np.inf}, "dt must be a positive"),
    ],
)
def test_matrices_that_do_not_fit_are_errors(change, words):
    parts = {"A": 0.5 * np.eye(2), "B": np.ones((2, 1)), "C": np.ones((1, 2)), "D": np.zeros((1, 1)), "dt": 0.1}
    with pytest.raises(InvalidDataError, match=words):
        Realisation(**(parts | change))


def test_arrays_are_frozen_copies():
    A = np.array([[0.5]])
    model = Realisation(A, [[1.0]], [[1.0]], [[0.0]], 0.1, K=[[0.2]])
    A[0, 0] = 9.0
    assert model.A[0, 0] == 0.5
    for array in (model.A, model.B, model.C, model.D, model.K, model.singular_values):
        assert not array.flags.writeable


def test_counts_and_order_zero():
    model = Realisation(np.empty((0, 0)), np.empty((0, 3)), np.empty((2, 0)), np.ones((2, 3)), 0.1)
    assert (model.order, model.n_inputs, model.n_outputs) == (0, 3, 2)


def test_factors_of_another_order_are_an_error():
    model = model_of()
    with pytest.raises(InvalidDataError, match=r"order 4, but hold 6 states; use factors.truncated\(4\)"):
        Realisation(model.A[:4, :4], model.B[:4], model.C[:, :4], model.D, model.dt, factors=model.factors)


def test_factors_that_do_not_fit_are_an_error():
    parts = {
        "observability": np.ones((4, 2)),
        "controllability": np.ones((2, 6)),
        "n_block_rows": 4,
        "n_block_columns": 6,
        "input_scale": [1.0],
        "output_scale": [1.0],
        "observer_order": None,
    }
    assert HankelFactors(**parts).observability.shape == (4, 2)
    for change in ({"observability": np.ones((5, 2))}, {"controllability": np.ones((3, 6))}, {"n_block_columns": 4}):
        with pytest.raises(InvalidDataError):
            HankelFactors(**(parts | change))


def test_truncation_outside_the_order_or_without_factors_is_an_error():
    model = model_of()
    with pytest.raises(InvalidDataError, match="orders 0 to 6, not to 7"):
        model.truncated(7)
    plain = Realisation(model.A, model.B, model.C, model.D, model.dt)
    with pytest.raises(InvalidDataError, match=r"control\.balred"):
        plain.truncated(2)


@pytest.mark.parametrize("order", [0, 3, 6])
def test_round_trip_through_control(order):
    model = model_of(order=order)
    system = model.to_control()
    assert (system.nstates, system.ninputs, system.noutputs, system.dt) == (order, 2, 3, model.dt)
    back = Realisation.from_control(system)
    for one, other in zip((model.A, model.B, model.C, model.D), (back.A, back.B, back.C, back.D), strict=True):
        np.testing.assert_array_equal(one, other)
    assert back.dt == model.dt
    assert back.K is None
    assert back.factors is None
    assert back.singular_values.size == 0


def test_names_of_channels_survive_the_way_to_control_and_back():
    model = replace(model_of(order=4), input_names=("shaker", "hammer"), output_names=("tip", "mid", "root"))
    system = model.to_control()
    assert (system.input_labels, system.output_labels) == (["shaker", "hammer"], ["tip", "mid", "root"])
    back = Realisation.from_control(system)
    assert (back.input_names, back.output_names) == (model.input_names, model.output_names)
    assert model.truncated(2).output_names == model.output_names
    assert model.to_control(inputs=["a", "b"]).input_labels == ["a", "b"]
    plain = Realisation.from_control(model_of().to_control())
    assert (plain.input_names, plain.output_names) == ((), ())
    with pytest.raises(InvalidDataError, match="2 output names were given for 3 outputs"):
        replace(model, output_names=("a", "b"))


def test_names_with_dots_are_told_as_control_takes_them():
    model = model_of()
    n_inputs, n_outputs = model.n_inputs, model.n_outputs
    dotted = replace(
        model,
        input_names=[f"force.{k}" for k in range(n_inputs)],
        output_names=[f"acc.{k}" for k in range(n_outputs)],
    )
    with pytest.warns(IdentificationWarning, match="no dot in the name of a channel, so of .*0.* all are called .*_0"):
        system = dotted.to_control()
    assert system.output_labels == [f"acc_{k}" for k in range(n_outputs)]
    assert system.input_labels == [f"force_{k}" for k in range(n_inputs)]


def test_names_stay_apart_and_none_is_no_name():
    two = Realisation(
        np.eye(1) / 2, np.ones((1, 2)), np.ones((1, 1)), np.zeros((1, 2)), 0.1, input_names=("a.b", "a_b")
    )
    with pytest.warns(IdentificationWarning, match="are left out, since they would not stay apart"):
        assert two.to_control().input_labels == ["u[0]", "u[1]"]
    with pytest.raises(InvalidDataError, match="'a' stand more than once"):
        replace(two, input_names=("a", "a"))
    assert replace(two, input_names=None).input_names == ()
    assert replace(two, input_names=(name for name in "xy")).input_names == ("x", "y")


def test_states_that_nothing_drives_survive_the_way_to_control():
    model = Realisation(np.diag([0.5, 0.0]), [[1.0], [0.0]], [[1.0, 0.0]], [[0.0]], 0.1)
    assert model.to_control().nstates == 2


def test_a_transfer_function_is_converted():
    import control

    model = Realisation.from_control(control.tf([1.0], [1.0, -0.5], 0.1))
    assert model.A.item() == pytest.approx(0.5)
    assert (model.C @ model.B).item() == pytest.approx(1.0)


def test_systems_without_a_time_step_are_errors_with_a_remedy():
    import control

    matrices = ([[0.5]], [[1.0]], [[1.0]], [[0.0]])
    with pytest.raises(InvalidDataError, match=r"continuous; discretise it first, .* control\.sample_system"):
        Realisation.from_control(control.ss(*matrices))
    for dt in (True, None):
        with pytest.raises(InvalidDataError, match=r"time step in seconds"):
            Realisation.from_control(control.ss(*matrices, dt))
    with pytest.raises(InvalidDataError, match="str cannot be converted"):
        Realisation.from_control("no system")


def test_what_knows_no_lead_is_told_to_be_driven_early():
    model = Realisation([[0.5]], [[1.0]], [[2.0]], [[0.0]], 0.01, K=[[0.1]], lead=3)
    assert "inputs 3 samples ahead" in repr(model)
    for made in (model.to_control, lambda: era.kalman_filter(model)):
        with pytest.warns(IdentificationWarning, match="by inputs 3 samples early"):
            made()
    with pytest.raises(InvalidDataError, match="at least 0, but is -1"):
        Realisation([[0.5]], [[1.0]], [[2.0]], [[0.0]], 0.01, lead=-1)
