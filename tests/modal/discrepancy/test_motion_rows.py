"""What motion an output shows: natures of plants, units, differences."""

import numpy as np
import pytest

from modal.discrepancy.continuous_time import ContinuousSystem
from modal.discrepancy.motion_rows import motion_of_outputs


def system(A: object, B: object, C: object) -> ContinuousSystem:
    A, B, C = (np.array(matrix, dtype=float) for matrix in (A, B, C))
    return ContinuousSystem(A=A, B=B, C=C, D=np.zeros((len(C), B.shape[1])))


OSCILLATOR = [[0.0, 1.0], [-25.0, -0.5]]


@pytest.mark.parametrize(
    ("A", "B", "C", "kind", "nature"),
    [
        (OSCILLATOR, [[0], [1]], [[1, 0]], "displacement", "mechanical"),
        (OSCILLATOR, [[0], [1]], [[0, 1]], "velocity", "mechanical"),
        ([[-3.0]], [[2]], [[1]], "displacement", "flow"),
        ([[-3.0]], [[2]], [[1]], "velocity", "shaft"),
        ([[-3.0]], [[2]], [[1]], "acceleration", "shaft"),
        ([[-400.0, -20.0], [50.0, -0.5]], [[300], [0]], [[0, 1]], "velocity", "shaft"),
        ([[-0.2, 0.1], [0.2, -0.3]], [[1], [0]], [[1, 0]], "displacement", "flow"),
        ([[-0.2, 0.0], [0.2, -0.3]], [[1], [0]], [[0, 1]], "displacement", "mechanical"),
    ],
)
def test_natures(A: object, B: object, C: object, kind: str, nature: str) -> None:
    (found,) = motion_of_outputs(system(A, B, C), (kind,), ("",))
    assert found.nature == nature
    assert (found.displacement is None) == (nature == "shaft")
    assert (found.velocity is None) == (nature == "flow")


def test_an_accelerometer_on_a_damped_free_mass_shows_its_velocity() -> None:
    """a = u / m - c v / m with the state v."""
    given = ContinuousSystem(A=np.array([[-0.4]]), B=np.array([[0.5]]), C=np.array([[-0.4]]), D=np.array([[0.5]]))
    (found,) = motion_of_outputs(given, ("acceleration",), ("m/s^2",))
    np.testing.assert_allclose(found.velocity, [1.0, 0.0])
    np.testing.assert_allclose(found.direct, [1.0])
    assert (found.unit, found.force_unit) == ("m", "m/s^2")


def test_without_inputs_a_structure_is_taken_for_one() -> None:
    given = ContinuousSystem(A=np.array(OSCILLATOR), B=np.zeros((2, 0)), C=np.array([[1.0, 0.0]]), D=np.zeros((1, 0)))
    (found,) = motion_of_outputs(given, ("displacement",), ("deg",))
    assert found.nature == "mechanical"
    assert found.force_unit == "deg/s^2"


def test_small_errors_of_an_identified_model_do_not_change_the_nature() -> None:
    given = system(OSCILLATOR, [[0.02], [1.0]], [[1.0, 0.0]])  # C B should be zero
    assert motion_of_outputs(given, ("displacement",), ("",))[0].nature == "mechanical"


@pytest.mark.parametrize(
    ("kind", "unit", "length"),
    [
        ("displacement", "mm", "mm"),
        ("velocity", "rad/s", "rad"),
        ("acceleration", "m/s²", "m"),
        ("acceleration", "mm/s**2", "mm"),
        ("acceleration", "g", "g s^2"),
        ("velocity", "rpm", "rpm s"),
        ("acceleration", "", "m"),
    ],
)
def test_units(kind: str, unit: str, length: str) -> None:
    (found,) = motion_of_outputs(system(OSCILLATOR, [[0], [1]], [[1, 0]]), (kind,), (unit,))
    assert found.unit == length


def test_differences() -> None:
    given = system(OSCILLATOR, [[0], [1]], [[1.0, 0.0], [0.25, 0.0]])
    first, second = motion_of_outputs(given, ("displacement", "displacement"), ("m", "m"))
    np.testing.assert_allclose(first.less(second).displacement, [0.75, 0.0, 0.0])
    np.testing.assert_allclose(first.less(second).velocity, [0.0, 0.75, 0.0])
