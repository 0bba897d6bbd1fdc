"""Elements of a structural model: the springs and dampers between its degrees of freedom, and between them and ground.

A spring network is a stiffness matrix that is a sum over elements, K = sum k_e b_e b_e', where b_e picks the relative
displacement of element e. Off the diagonal K_ij = -k_ij, and what a row leaves over is its spring to ground. The same
holds of C. A finite-element matrix with rotations, or a damping matrix put together from modal damping, is no such sum.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from modal.simulation.tolerances import ROUNDING
from okid.arrays import FloatArray, real_number
from okid.display import Displayed
from okid.errors import InvalidDataError

MOST_ELEMENTS = 64
"""Derive no more elements than so many from matrices: each is a place that every effect is tried at."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Element(Displayed):
    """A spring with a damper, between two degrees of freedom or between one and the ground.

    Its relative displacement is x[end] - x[start]; x[start] where it stands on the ground.

    Attributes:
        name: Name of the place.
        start: Degree of freedom at one end.
        end: Degree of freedom at the other end; None: the ground.
        stiffness: Of the spring, in force unit / length unit; 0 where there is none or it is not known.
        damping: Of the damper, in force unit s / length unit; 0 where there is none or it is not known.

    Example:
        >>> Element(name="joint", start=0, end=1, stiffness=2e4, damping=3.0).ends
        (0, 1)
    """

    name: str
    start: int
    end: int | None = None
    stiffness: float = 0.0
    damping: float = 0.0

    @property
    def ends(self) -> tuple[int, ...]:
        """The degrees of freedom that the element touches."""
        return (self.start,) if self.end is None else (self.start, self.end)


def is_numbered(element: Element) -> bool:
    """Whether nobody gave the element a name: it is called by its place in the matrices."""
    return element.name == _chain_name(element.ends)


def relative_vector(ends: Sequence[int], n_dofs: int) -> FloatArray:
    """(n_dofs,) the vector b with b' x the relative displacement over `ends` (one end: against the ground).

    Example:
        >>> relative_vector((0, 2), 3).tolist(), relative_vector((1,), 3).tolist()
        ([-1.0, 0.0, 1.0], [0.0, 1.0, 0.0])
    """
    vector = np.zeros(n_dofs)
    vector[ends[-1]] = 1.0
    if len(ends) == 2:
        vector[ends[0]] = -1.0
    return vector


def chain_elements(stiffnesses: FloatArray, dampings: FloatArray) -> tuple[Element, ...]:
    """The elements of a chain: element 0 joins DOF 0 and the ground, element e DOF e - 1 and DOF e."""
    return tuple(
        Element(
            name=f"element_{e}", start=max(e - 1, 0), end=e or None, stiffness=float(stiffness), damping=float(damping)
        )
        for e, (stiffness, damping) in enumerate(zip(stiffnesses, dampings, strict=True))
    )


def coupled_elements(stiffness: FloatArray, damping: FloatArray) -> tuple[Element, ...]:
    """The elements that stand in K and C.

    Every pair of DOFs that K couples is one, every DOF that K ties to the ground (what its row leaves over), and
    likewise for C where C is a network of dampers. Named as in a chain: "element_0" joins DOF 0 and the ground,
    "element_e" DOF e - 1 and DOF e; others are "element_i-j" and "ground_i". Where K is no network of springs, only
    the pairs are elements, of unknown stiffness.

    Raises:
        InvalidDataError: More than 64 of them.
    """
    springs, dampers = is_network(stiffness), is_network(damping)
    n_dofs = len(stiffness)
    found = []
    for ends in [*((i,) for i in range(n_dofs)), *((i, j) for j in range(n_dofs) for i in range(j))]:
        k = _coupling(stiffness, ends) if springs or len(ends) == 2 else 0.0
        c = _coupling(damping, ends) if dampers else 0.0
        if k != 0.0 or c != 0.0:
            found.append(
                Element(
                    name=_chain_name(ends),
                    start=ends[0],
                    end=ends[1] if len(ends) == 2 else None,
                    stiffness=k if springs else 0.0,
                    damping=c,
                )
            )
    if len(found) > MOST_ELEMENTS:
        raise InvalidDataError(
            f"the stiffness and damping matrices couple {len(found)} pairs of degrees of freedom, and at most "
            f"{MOST_ELEMENTS} can be searched; name those of interest, for example elements=[(0, None), (0, 1)], or "
            "pass elements=() for the degrees of freedom alone."
        )
    return tuple(sorted(found, key=lambda element: (element.ends[-1], -element.start)))


def is_network(matrix: FloatArray) -> bool:
    """Whether a stiffness or damping matrix is that of springs or dampers of positive size between DOFs and ground.

    Example:
        >>> is_network(np.array([[3.0, -1.0], [-1.0, 1.0]])), is_network(np.array([[12.0, 6.0], [6.0, 4.0]]))
        (True, False)
    """
    tolerance = ROUNDING * np.abs(matrix).max(initial=0.0)
    off_diagonal = matrix - np.diag(np.diag(matrix))
    return bool((off_diagonal <= tolerance).all() and (matrix.sum(axis=1) >= -len(matrix) * tolerance).all())


def named_elements(
    given: Iterable[Element | tuple[int | None, int | None]], stiffness: FloatArray, damping: FloatArray
) -> tuple[Element, ...]:
    """The elements as given, pairs (start, end) completed by a name and by what K and C couple there.

    Raises:
        InvalidDataError: An element that is no pair of DOFs, touches a DOF that is not there, or has a negative
            stiffness or damping; two of one name or of the same ends.
    """
    elements = tuple(_completed(one, stiffness, damping) for one in given)
    _check_unique("name", [element.name for element in elements])
    _check_unique("ends", [str(sorted(element.ends)) for element in elements])
    return elements


def _check_unique(what: str, keys: list[str]) -> None:
    double = sorted({key for key in keys if keys.count(key) > 1})
    if double:
        raise InvalidDataError(
            f"no two elements may have the same {what}, but {', '.join(double)} stand more than once; merge them."
        )


def _completed(one: Any, stiffness: FloatArray, damping: FloatArray) -> Element:
    n_dofs = len(stiffness)
    if isinstance(one, Element):
        ends = one.ends
    else:
        if isinstance(one, str) or not isinstance(one, Sequence) or len(one) != 2:
            raise InvalidDataError(
                f"an element must be modal.Element or a pair (start, end) of DOF numbers, end None for the ground, but "
                f"is {one!r}."
            )
        ends = tuple(end for end in one if end is not None)
    there = all(real_number(end).is_integer() and 0 <= end < n_dofs for end in ends)
    if not there or len(set(ends)) != len(ends) or not ends:
        raise InvalidDataError(
            f"an element joins two of the DOFs 0 to {n_dofs - 1}, or one of them and the ground (None), but {one!r} "
            "does not; number the DOFs from 0."
        )
    if isinstance(one, Element):
        if not all(np.isfinite(v := real_number(value)) and v >= 0 for value in (one.stiffness, one.damping)):
            raise InvalidDataError(
                f"the stiffness and damping of {one.name} must be finite and not negative, but are {one.stiffness} and "
                f"{one.damping}; leave them 0 where they are not known."
            )
        return one
    ends = tuple(sorted(int(end) for end in ends))
    return Element(
        name=_chain_name(ends),
        start=ends[0],
        end=ends[1] if len(ends) == 2 else None,
        stiffness=max(_coupling(stiffness, ends), 0.0) if is_network(stiffness) else 0.0,
        damping=max(_coupling(damping, ends), 0.0) if is_network(damping) else 0.0,
    )


def _coupling(matrix: FloatArray, ends: tuple[int, ...]) -> float:
    """What joins the ends in K or C: -K_ij, or what row i leaves over for the ground; 0 where it is rounding."""
    row = ends[0]
    value = -matrix[row, ends[1]] if len(ends) == 2 else matrix[row].sum()
    # a small element beside a large one: what counts as rounding is set by the row, not by the whole matrix
    small = ROUNDING * np.abs(matrix[row]).max(initial=0.0)
    return 0.0 if abs(value) <= small else float(value)


def _chain_name(ends: tuple[int, ...]) -> str:
    if ends == (0,):
        return "element_0"
    if len(ends) == 1:
        return f"ground_{ends[0]}"
    return f"element_{ends[1]}" if ends[1] == ends[0] + 1 else f"element_{ends[0]}-{ends[1]}"
