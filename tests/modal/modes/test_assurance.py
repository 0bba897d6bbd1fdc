import numpy as np
import pytest

from modal.modes.shape_comparison import assurance
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
