"""Springs and dampers read back from the matrices that they make up."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modal.structure.structural_plant import (
    Element,
    chain_elements,
    coupled_elements,
    is_network,
    named_elements,
    relative_vector,
)
from okid.errors import InvalidDataError


def put_together(values: dict[tuple[int, ...], float], n_dofs: int) -> np.ndarray:
    """The textbook sum: +k on both diagonals, -k between; a ground spring on its diagonal alone."""
    matrix = np.zeros((n_dofs, n_dofs))
    for ends, value in values.items():
        for i in ends:
            matrix[i, i] += value
        if len(ends) == 2:
            matrix[ends[0], ends[1]] -= value
            matrix[ends[1], ends[0]] -= value
    return matrix


@given(data=st.data())
@settings(max_examples=60, deadline=None)
def test_every_network_is_read_back(data: st.DataObject) -> None:
    n_dofs = data.draw(st.integers(1, 5))
    ends = [(i,) for i in range(n_dofs)] + [(i, j) for i in range(n_dofs) for j in range(i + 1, n_dofs)]
    sizes = st.one_of(st.just(0.0), st.floats(0.5, 1e4))
    springs = {one: data.draw(sizes) for one in ends}
    dampers = {one: data.draw(sizes) / 100 for one in ends}
    found = coupled_elements(put_together(springs, n_dofs), put_together(dampers, n_dofs))
    present = {one for one in ends if springs[one] or dampers[one]}
    assert {element.ends for element in found} == present
    for element in found:
        # a row of large entries rounds what it leaves over for the ground
        assert element.stiffness == pytest.approx(springs[element.ends], rel=1e-6, abs=1e-6)
        assert element.damping == pytest.approx(dampers[element.ends], rel=1e-6, abs=1e-8)
    names = [element.name for element in found]
    assert len(set(names)) == len(names)


def test_a_chain_has_the_names_of_the_chain() -> None:
    stiffness = put_together({(0,): 9.0, (0, 1): 7.0, (1, 2): 4.0}, 3)
    derived = coupled_elements(stiffness, stiffness / 100)
    built = chain_elements(np.array([9.0, 7.0, 4.0]), np.array([0.09, 0.07, 0.04]))
    assert [(e.name, e.start, e.end) for e in derived] == [(e.name, e.start, e.end) for e in built]
    np.testing.assert_allclose([e.stiffness for e in derived], [e.stiffness for e in built])


def test_elements_off_the_chain_say_where_they_are() -> None:
    stiffness = put_together({(0, 1): 7.0, (0, 2): 4.0, (2,): 2.0}, 3)
    assert {e.name: e.ends for e in coupled_elements(stiffness, np.zeros((3, 3)))} == {
        "element_1": (0, 1),
        "element_0-2": (0, 2),
        "ground_2": (2,),
    }


def test_a_beam_is_no_network_but_its_couplings_are_places() -> None:
    beam = np.array([[12.0, 6.0, -12.0], [6.0, 4.0, -6.0], [-12.0, -6.0, 24.0]])
    assert not is_network(beam)
    found = coupled_elements(beam, np.zeros((3, 3)))
    assert [element.ends for element in found] == [(0, 1), (1, 2), (0, 2)]
    assert all(element.stiffness == 0 for element in found)


def test_too_many_couplings_ask_for_a_choice() -> None:
    full = 30 * np.eye(12) - np.ones((12, 12))
    with pytest.raises(InvalidDataError, match=r"couple 78 pairs .* at most 64 .* elements=\(\) for"):
        coupled_elements(full, np.zeros((12, 12)))


def test_pairs_are_completed() -> None:
    stiffness = put_together({(0,): 9.0, (0, 1): 7.0}, 2)
    found = named_elements([(1, 0), (None, 0), (1, None)], stiffness, stiffness / 10)
    assert [(e.name, e.start, e.end) for e in found] == [
        ("element_1", 0, 1),
        ("element_0", 0, None),
        ("ground_1", 1, None),
    ]
    np.testing.assert_allclose([e.stiffness for e in found], [7.0, 9.0, 0.0])
    np.testing.assert_allclose([e.damping for e in found], [0.7, 0.9, 0.0])


@pytest.mark.parametrize(
    ("elements", "words"),
    [
        ([(0, 2)], r"joins two of the DOFs 0 to 1, or one of them and the ground \(None\), but \(0, 2\) does not"),
        ([(0, 0)], "joins two of the DOFs"),
        ([(None, None)], "joins two of the DOFs"),
        (["ab"], r"modal\.Element or a pair"),
        ([(0, 1), (1, 0)], "same name, but element_1"),
        ([Element(name="a", start=0, end=1), Element(name="b", start=1, end=0)], r"same ends, but \[0, 1\]"),
        ([Element(name="a", start=0, stiffness=-1.0)], "must be finite and not negative, but are -1.0 and 0.0"),
        ([Element(name="a", start=5)], "joins two of the DOFs"),
    ],
)
def test_refuses(elements: list[object], words: str) -> None:
    with pytest.raises(InvalidDataError, match=words):
        named_elements(elements, np.eye(2), np.eye(2))


def test_relative_vector_points_from_start_to_end() -> None:
    np.testing.assert_array_equal(relative_vector((2, 0), 3), [1.0, 0.0, -1.0])
