"""Modes compared: overlap of their pulse responses, and sets of shapes paired, averaged and read from files.

The overlap is how much of a mode's own pulse response another mode repeats. The pulse response of a mode with residue R
= c b' and discrete pole lambda is h_k = 2 Re(R lambda^k) for a pair and R lambda^k for a real pole, k = 0 ... L - 1.
With w = 2 for a pair and 1 for a real pole,

    <1, 2> = sum over k of trace(h1_k' h2_k)
           = w1 w2 / 2 Re[(c1' c2)(b1' b2) g(l1 l2) + (c1* c2)(b1* b2) g(conj(l1) l2)],   g(x) = (1 - x^L) / (1 - x)
    overlap = <1, 2> / max(<1, 1>, <2, 2>)

(' transpose, * conjugate transpose). It is 1 for the same mode only: frequency, damping, shape, participation and size
all count, without a tolerance for any of them, and the scaling of eigenvectors cancels. Channels are made comparable
by the scales of the records, so a change of unit changes nothing.

A set may come from an identification, a finite-element program or another test. Two sets are joined by the names of
their channels, so neither their order nor channels that only one of them has matter.
"""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import numpy.typing as npt
import scipy

from modal.modes.modal_form import discrete_poles
from modal.modes.mode import ModalModel, Mode
from okid.arrays import BoolArray, ComplexArray, FloatArray, frozen_with_gaps
from okid.display import Displayed, table_of_columns
from okid.errors import InvalidDataError, UnreadableFileError
from okid.readers.arrays import array_of
from okid.readers.guard import check_file, check_memory, foreign, optional_package, sound_archive

if TYPE_CHECKING:
    import pyarrow as pa

IndexArray = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Pulses:
    """Pulse responses of modes in scaled channels.

    Attributes:
        poles: (n_modes,) discrete poles.
        is_pair: (n_modes,) True where the conjugate belongs to the mode.
        outputs: (n_outputs, n_modes) c.
        inputs: (n_modes, n_inputs) b; one column of ones for a model without inputs (free responses).
    """

    poles: ComplexArray
    is_pair: BoolArray
    outputs: ComplexArray
    inputs: ComplexArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Repeatability:
    """How well modes are found again in other runs.

    Attributes:
        mean: (n_modes,) mean of `parts` over the runs, nan when there are none.
        parts: (n_runs, n_modes) overlap of each mode with its continuation in each run, 0 where it has none.
        continuation: (n_runs, n_modes) index of that mode in its run, -1 where it has none.
    """

    mean: FloatArray
    parts: FloatArray
    continuation: IndexArray


def pulses(
    modes: Sequence[Mode], *, dt: float, output_scale: FloatArray | None = None, input_scale: FloatArray | None = None
) -> Pulses:
    """Pulse responses of modes, outputs divided by `output_scale` and inputs by `input_scale` (ones unless given)."""
    modes = tuple(modes)
    poles, is_pair = discrete_poles(modes, dt)
    n_outputs, n_inputs = (modes[0].shape.size, modes[0].participation.size) if modes else (0, 0)
    outputs = np.array([mode.shape for mode in modes], dtype=np.complex128).reshape(len(modes), n_outputs).T
    inputs = np.array([mode.participation for mode in modes], dtype=np.complex128).reshape(len(modes), n_inputs)
    if modes and output_scale is not None:
        outputs = outputs / output_scale[:, np.newaxis]
    if modes and input_scale is not None and n_inputs:
        inputs = inputs * input_scale
    if n_inputs == 0:
        inputs = np.ones((len(modes), 1), dtype=np.complex128)
    return Pulses(poles=poles, is_pair=is_pair, outputs=outputs, inputs=inputs)


def overlap_matrix(first: Pulses, second: Pulses, *, n_steps: int) -> FloatArray:
    """Overlap of every mode of one set with every mode of another.

    Args:
        first: n_first modes.
        second: n_second modes, same channels and time step.
        n_steps: L, length of the pulse responses in samples (Hankel block rows + columns).

    Returns:
        (n_first, n_second) in [0, 1]: negative overlaps (opposite signs) count 0, and so does an unstable mode whose
        pulse response is too large for a float.

    Example:
        >>> mode = Mode(pole=-1 + 9j, kind="oscillatory", frequency=1.4, damping_ratio=0.1,
        ...             shape=np.ones(2), participation=np.ones(1))
        >>> same = pulses([mode], dt=0.01)
        >>> overlap_matrix(same, same, n_steps=100).round(12).tolist()
        [[1.0]]
    """
    if first.poles.size == 0 or second.poles.size == 0:
        return np.zeros((first.poles.size, second.poles.size))
    with np.errstate(over="ignore", invalid="ignore"):
        inner = inner_products(first, second, n_steps=n_steps)
        largest = np.maximum(energies(first, n_steps=n_steps)[:, np.newaxis], energies(second, n_steps=n_steps))
        share = np.divide(inner, largest, out=np.zeros_like(inner), where=largest > 0)
    return cast("FloatArray", np.clip(np.nan_to_num(share, nan=0.0), 0.0, 1.0))


def inner_products(first: Pulses, second: Pulses, *, n_steps: int) -> FloatArray:
    """(n_first, n_second) sums over k and channels of the products of two modes' pulse responses, see the module."""
    weight = np.where(first.is_pair, 2.0, 1.0)[:, np.newaxis] * np.where(second.is_pair, 2.0, 1.0) / 2
    with np.errstate(over="ignore", invalid="ignore"):
        plain = (first.outputs.T @ second.outputs) * (first.inputs @ second.inputs.T)
        turned = (first.outputs.conj().T @ second.outputs) * (first.inputs.conj() @ second.inputs.T)
        plain = plain * _geometric(first.poles[:, np.newaxis] * second.poles, n_steps)
        turned = turned * _geometric(first.poles.conj()[:, np.newaxis] * second.poles, n_steps)
        products: FloatArray = weight * (plain + turned).real
        return products


def energies(modes: Pulses, *, n_steps: int) -> FloatArray:
    """(n_modes,) sum of squares of each mode's pulse response in scaled channels."""
    weight = np.where(modes.is_pair, 2.0, 1.0) ** 2 / 2
    with np.errstate(over="ignore", invalid="ignore"):
        plain = (modes.outputs**2).sum(axis=0) * (modes.inputs**2).sum(axis=1)
        turned = (np.abs(modes.outputs) ** 2).sum(axis=0) * (np.abs(modes.inputs) ** 2).sum(axis=1)
        plain = plain * _geometric(modes.poles**2, n_steps)
        turned = turned * _geometric(modes.poles.conj() * modes.poles, n_steps)
        products: FloatArray = weight * (plain + turned).real
        return products


def _geometric(ratio: ComplexArray, n_steps: int) -> ComplexArray:
    # 1 + x + ... + x^(L-1) = expm1(L log x) / (x - 1); written out so that neither x near 1 nor x = 0 loses digits.
    step = ratio - 1
    near_one = np.abs(step) < 0.5
    with np.errstate(divide="ignore"):
        growth = np.where(
            near_one, 0.5 * np.log1p(np.where(near_one, 2 * step.real + np.abs(step) ** 2, 0.0)), np.log(np.abs(ratio))
        )
    growth, angle = n_steps * growth, n_steps * np.angle(ratio)
    power = np.expm1(growth) * np.cos(angle) - 2 * np.sin(angle / 2) ** 2 + 1j * np.exp(growth) * np.sin(angle)
    alone = np.abs(step) < 1e-12
    return cast("ComplexArray", np.where(alone, n_steps + 0j, power / np.where(alone, 1.0, step)))


def pair_greatest_first(overlaps: FloatArray) -> IndexArray:
    """One-to-one pairing of rows with columns, the greatest overlap first; zeros are not paired.

    Returns:
        (n_rows,) column of each row, -1 where it has none.

    Example:
        >>> pair_greatest_first(np.array([[0.9, 0.8], [0.95, 0.1], [0.0, 0.0]])).tolist()
        [1, 0, -1]
    """
    n_rows, n_columns = overlaps.shape
    partner = np.full(n_rows, -1, dtype=np.intp)
    candidates = np.flatnonzero(overlaps > 0)
    taken: set[int] = set()
    for flat in candidates[np.argsort(-overlaps.ravel()[candidates], kind="stable")].tolist():
        row, column = divmod(flat, n_columns)
        if partner[row] < 0 and column not in taken:
            partner[row] = column
            taken.add(column)
            if len(taken) == min(n_rows, n_columns):
                break
    return partner


def repeatability(reference: Pulses, reruns: Sequence[Pulses], *, n_steps: int) -> Repeatability:
    """Overlap of each mode with its continuation in other runs, paired one to one, greatest first.

    Args:
        reference: the modes in question.
        reruns: the modes found again after a small change of the data, the observer or the model order.
        n_steps: length of the pulse responses in samples.
    """
    n_modes = reference.poles.size
    parts = np.zeros((len(reruns), n_modes))
    continuation = np.full((len(reruns), n_modes), -1, dtype=np.intp)
    for run, again in enumerate(reruns):
        overlaps = overlap_matrix(reference, again, n_steps=n_steps)
        partner = pair_greatest_first(overlaps)
        found = np.flatnonzero(partner >= 0)
        continuation[run] = partner
        parts[run, found] = overlaps[found, partner[found]]
    mean = parts.mean(axis=0) if len(reruns) else np.full(n_modes, np.nan)
    return Repeatability(mean=mean, parts=parts, continuation=continuation)


EVEN = 0.5
"""Pair two shapes only if more of the one is in the other than is not."""

DIRECTIONS = ("X+", "Y+", "Z+", "RX+", "RY+", "RZ+")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Shapes(Displayed):
    """Mode shapes, one a column, with the names of their channels.

    Args:
        shapes: (n_channels, n_modes) real or complex.
        names: (n_channels,) of the channels, each once.
        frequencies: (n_modes,) [Hz], None where not known.

    Raises:
        InvalidDataError: numbers and names do not fit together, or a name stands twice.

    Example:
        >>> Shapes([[1.0], [0.5]], ["tip", "root"], [3.0])
        Shapes(shapes=[[1. +0.j], [0.5+0.j]], names=('tip', 'root'), frequencies=[3.])
    """

    shapes: ComplexArray
    names: tuple[str, ...]
    frequencies: FloatArray | None = None

    def __post_init__(self) -> None:
        shapes = np.array(self.shapes, dtype=np.complex128)
        names = tuple(str(name) for name in self.names)
        if shapes.ndim != 2 or len(names) != len(shapes) or len(set(names)) != len(names):
            raise InvalidDataError(
                f"shapes must have the shape (n_channels, n_modes) and one name a channel, each once, but {len(names)} "
                f"names ({len(set(names))} different) stand beside an array of shape {shapes.shape}."
            )
        if not np.isfinite(shapes).all():
            raise InvalidDataError("shapes must be finite numbers; leave channels that were not measured out.")
        shapes.flags.writeable = False
        object.__setattr__(self, "shapes", shapes)
        object.__setattr__(self, "names", names)
        if self.frequencies is not None:
            wanted = (shapes.shape[1],)
            object.__setattr__(
                self, "frequencies", frozen_with_gaps(self.frequencies, name="frequencies", shape=wanted)
            )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class ModePairs(Displayed):
    """Which mode of one set is which of another.

    Attributes:
        pairs: index in the first set and in the second, of each pair.
        assurance: (n_pairs,) MAC of each pair.
        assurance_std: (n_pairs,) root mean square error of it by the deviations of the identified shapes, taken for
            independent between channels; given shapes are exact; nan where no deviation is known.
        only_first: indices of the first set without a partner.
        only_second: likewise of the second.
    """

    pairs: tuple[tuple[int, int], ...]
    assurance: FloatArray
    assurance_std: FloatArray
    only_first: tuple[int, ...]
    only_second: tuple[int, ...]

    def to_table(self) -> "pa.Table":
        """A pair a row, then each mode left alone: columns first and second (indices), assurance, assurance_std."""
        rows = [(*pair, *size) for pair, *size in zip(self.pairs, self.assurance, self.assurance_std, strict=True)]
        rows += [*((k, None, None, None) for k in self.only_first), *((None, k, None, None) for k in self.only_second)]
        names = ("first", "second", "assurance", "assurance_std")
        return table_of_columns({name: ([row[k] for row in rows], "") for k, name in enumerate(names)})


def assurance(
    first: "ModalModel | Shapes | npt.NDArray[np.generic]", second: "ModalModel | Shapes | npt.NDArray[np.generic]"
) -> FloatArray:
    """MAC |a^H b|^2 / (a^H a b^H b) of every shape of one set with every shape of another, over common channels.

    Args:
        first: its system modes where it is a model; an array holds one shape a column.
        second: likewise.

    Returns:
        (n_first, n_second) in [0, 1]; 0 for a shape of zeros.

    Raises:
        InvalidDataError: the sets have no channel in common, or arrays differ in their number of outputs.

    References:
        Allemang, Brown, A correlation coefficient for modal vector analysis, 1st International Modal Analysis
        Conference, 1982.

    Example:
        >>> one, other = Shapes([[1.0], [1.0]], ["a", "b"]), Shapes([[2.0], [9.0], [2.0]], ["b", "c", "a"])
        >>> assurance(one, other).round(12).tolist()
        [[1.0]]
    """
    one, other, _ = _joined(first, second)
    return cast("FloatArray", np.abs(_unit(one).conj().T @ _unit(other)) ** 2)


def _unit(shapes: ComplexArray) -> ComplexArray:
    length = np.linalg.norm(shapes, axis=0)
    return shapes / np.where(length > 0, length, 1.0)


def coordinate_assurance(first: ModalModel | Shapes, second: ModalModel | Shapes) -> FloatArray:
    """COMAC: how alike the paired modes of two sets are at each channel.

    Args:
        first: its system modes where it is a model.
        second: likewise; the modes are paired by `pair_modes`.

    Returns:
        (n_common,) in [0, 1], one a channel that both have, in the order of the first; nan where no mode is paired.

    References:
        Lieven, Ewins, Spatial correlation of mode shapes, the coordinate modal assurance criterion, 6th International
        Modal Analysis Conference, 1988.

    Example:
        >>> one = Shapes([[1.0, 1.0], [1.0, -1.0]], ["a", "b"])
        >>> coordinate_assurance(one, one).round(12).tolist()
        [1.0, 1.0]
    """
    pairs = pair_modes(first, second).pairs
    one, other, _ = _joined(first, second)
    if not pairs:
        return np.full(len(one), np.nan)
    a, b = one[:, [pair[0] for pair in pairs]], other[:, [pair[1] for pair in pairs]]
    a, b = a / np.linalg.norm(a, axis=0), b / np.linalg.norm(b, axis=0)
    # one phase for all channels of a pair, the best one: an identified shape may be turned as a whole
    turned = b * np.exp(1j * np.angle((b.conj() * a).sum(axis=0)))
    size = (np.abs(a) ** 2).sum(axis=1) * (np.abs(b) ** 2).sum(axis=1)
    alike = np.abs((a * turned.conj()).sum(axis=1)) ** 2
    return cast("FloatArray", np.divide(alike, size, out=np.full(len(one), np.nan), where=size > 0))


def pair_modes(first: ModalModel | Shapes, second: ModalModel | Shapes) -> ModePairs:
    """Which system mode of one set is which of another: one to one, the greatest MAC first.

    Where both sets know frequencies, the MAC counts less by the ratio of the two, so that two modes that few sensors
    cannot tell apart are paired with their neighbours in frequency.

    Args:
        first: a model or a set of shapes.
        second: likewise.

    Returns:
        Pairs with a MAC above 0.5, and what is left alone.

    Raises:
        InvalidDataError: the sets have no channel in common, or one alone and no frequencies.

    Example:
        >>> one = Shapes([[1.0, 1.0], [1.0, -1.0]], ["a", "b"])
        >>> pair_modes(one, Shapes([[1.0], [-1.1]], ["a", "b"])).pairs
        ((1, 0),)
    """
    one, other, frequencies = _joined(first, second)
    alike = assurance(one, other)
    nearness = np.ones_like(alike)
    if frequencies is None and one.shape[0] < 2:
        raise InvalidDataError(
            "pairing modes by shape needs at least two channels that both sets have; with one every MAC is 1: give "
            "both sets frequencies, or more channels."
        )
    if frequencies is not None:
        ratio = frequencies[0][:, np.newaxis] / frequencies[1]
        nearness = np.minimum(ratio, 1.0 / ratio)
    partner = pair_greatest_first(np.where(alike > EVEN, alike * nearness, 0.0))
    pairs = tuple((int(row), int(column)) for row, column in enumerate(partner) if column >= 0)
    common = [name for name in _columns(first)[1] if name in _columns(second)[1]]
    spread = [_shape_std(each, common)[:, [pair[side] for pair in pairs]] for side, each in enumerate((first, second))]
    return ModePairs(
        pairs=pairs,
        assurance=np.array([alike[pair] for pair in pairs]),
        assurance_std=_assurance_std(one[:, [a for a, _ in pairs]], other[:, [b for _, b in pairs]], *spread),
        only_first=tuple(sorted(set(range(one.shape[1])) - {pair[0] for pair in pairs})),
        only_second=tuple(sorted(set(range(other.shape[1])) - {pair[1] for pair in pairs})),
    )


def _shape_std(shapes: ModalModel | Shapes, common: list[str]) -> FloatArray:
    """(n_common, n_modes) deviations of the components; 0 for shapes that were given, nan where not known."""
    values, names, _ = _columns(shapes)
    std = np.zeros(values.shape)
    if isinstance(shapes, ModalModel):
        for column, mode in enumerate(shapes.system):
            std[:, column] = np.nan if mode.shape_std is None else mode.shape_std
    return std[[names.index(name) for name in common]] if common else std


def _assurance_std(one: ComplexArray, other: ComplexArray, std: FloatArray, other_std: FloatArray) -> FloatArray:
    """(n_pairs,) by draws: near 1, where a MAC ends, its error is of second order in that of the shapes."""
    known = (std**2).sum(axis=0) + (other_std**2).sum(axis=0) > 0
    rng = np.random.default_rng(0)

    def drawn(shapes: ComplexArray, deviations: FloatArray) -> ComplexArray:
        real, imaginary = rng.standard_normal((2, 500, *shapes.shape))  # the deviation is then known to some 3 %
        return cast("ComplexArray", shapes + deviations / np.sqrt(2.0) * (real + 1j * imaginary))

    a, b = drawn(one, std), drawn(other, other_std)
    size = (np.abs(a) ** 2).sum(axis=1) * (np.abs(b) ** 2).sum(axis=1)
    exact = np.abs((one.conj() * other).sum(axis=0)) ** 2
    exact = exact / (np.abs(one) ** 2).sum(axis=0) / (np.abs(other) ** 2).sum(axis=0)
    errors = np.abs((a.conj() * b).sum(axis=1)) ** 2 / size - exact
    return cast("FloatArray", np.where(known, np.sqrt((errors**2).mean(axis=0)), np.nan))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class RepeatedModes(Displayed):
    """What repeated tests of one structure say of the modes of the first of them.

    Attributes:
        frequencies: (n_tests, n_modes) [Hz], nan where a test did not show the mode.
        damping_ratios: (n_tests, n_modes) likewise.
        mean_frequency: (n_modes,) [Hz] plain mean of the tests that show the mode.
        mean_damping_ratio: (n_modes,).
        frequency_scatter: (n_modes,) [Hz] standard deviation between the tests; nan of one alone.
        damping_ratio_scatter: (n_modes,) likewise.
        frequency_chi2: (n_modes,) squares of the scatter over those that the tests state; chance makes 1 on average,
            more says that the structure or its mounting was another each time; nan where no deviation is known.
        damping_ratio_chi2: (n_modes,) likewise.
        p_values: (n_modes, 2) how often chance alone makes the chi2 of frequency and of damping as large.
        n_found: (n_modes,) tests that show the mode.
    """

    frequencies: FloatArray
    damping_ratios: FloatArray
    mean_frequency: FloatArray
    mean_damping_ratio: FloatArray
    frequency_scatter: FloatArray
    damping_ratio_scatter: FloatArray
    frequency_chi2: FloatArray
    damping_ratio_chi2: FloatArray
    p_values: FloatArray
    n_found: IndexArray


def mean_modes(tests: Sequence[ModalModel]) -> RepeatedModes:
    """Mean and scatter of the modes over repeated tests, beside the deviations that each test states.

    Args:
        tests: models of at least two tests (`result.modes`); the system modes of the first are looked for in the others
            by `pair_modes`.

    Raises:
        InvalidDataError: fewer than two tests, or no channel in common.

    References:
        Birge, Physical Review 40(2), 1932, 207-227, doi 10.1103/PhysRev.40.207 (external over internal consistency).

    Example:
        >>> mean_modes([ModalModel(modes=(), indicator_caution=0.0, dt=0.01)])
        Traceback (most recent call last):
        okid.errors.InvalidDataError: scatter needs at least two tests, but there is 1; identify each run by itself.
    """
    tests = tuple(tests)
    if len(tests) < 2:
        raise InvalidDataError(
            f"scatter needs at least two tests, but there is {len(tests)}; identify each run by itself."
        )
    first = tests[0].system
    values = np.full((4, len(tests), len(first)), np.nan)
    for number, test in enumerate(tests):
        same = [(k, k) for k in range(len(first))] if number == 0 else pair_modes(tests[0], test).pairs
        for there, here in same:
            mode = test.system[here]
            known = mode.frequency, mode.damping_ratio, mode.frequency_std, mode.damping_ratio_std
            values[:, number, there] = known
    found = np.isfinite(values[0])
    n_found = found.sum(axis=0)
    freedom = np.maximum(n_found - 1, 0)

    def over(own: FloatArray) -> FloatArray:
        total: FloatArray = np.where(found, own, 0.0).sum(axis=0)
        return total

    told = []
    for value, std in ((values[0], values[2]), (values[1], values[3])):
        mean = over(value) / n_found
        with np.errstate(invalid="ignore", divide="ignore"):
            scatter = np.sqrt(over((value - mean) ** 2) / np.where(freedom > 0, freedom, np.nan))
            weight = 1.0 / std**2
            weighted = over(weight * value) / over(weight)
            squares = over(weight * (value - weighted) ** 2)
            told.append((mean, scatter, squares / np.where(freedom > 0, freedom, np.nan), squares))
    p_values = np.array([scipy.special.gammaincc(0.5 * np.maximum(freedom, 1), 0.5 * one[3]) for one in told]).T
    return RepeatedModes(
        frequencies=values[0],
        damping_ratios=values[1],
        mean_frequency=told[0][0],
        mean_damping_ratio=told[1][0],
        frequency_scatter=told[0][1],
        damping_ratio_scatter=told[1][1],
        frequency_chi2=told[0][2],
        damping_ratio_chi2=told[1][2],
        p_values=np.where(freedom[:, np.newaxis] > 0, p_values, np.nan),
        n_found=n_found,
    )


def _joined(
    first: "ModalModel | Shapes | npt.NDArray[np.generic]", second: "ModalModel | Shapes | npt.NDArray[np.generic]"
) -> tuple[ComplexArray, ComplexArray, tuple[FloatArray, FloatArray] | None]:
    """Shapes over the channels that both have, and the frequencies where both know them."""
    (one, names, known), (other, others, also_known) = _columns(first), _columns(second)
    if names and others:
        common = [name for name in names if name in others]
        if not common:
            raise InvalidDataError(
                f"the sets have no channel in common ({', '.join(names[:4])}, ... and {', '.join(others[:4])}, ...); "
                "give the channels of one place the same name."
            )
        one = one[[names.index(name) for name in common]]
        other = other[[others.index(name) for name in common]]
    if one.ndim != 2 or other.ndim != 2 or len(one) != len(other):
        raise InvalidDataError(
            f"shapes must stand in columns over the same outputs, but have shapes {one.shape} and {other.shape}; "
            "pass (n_outputs, n_modes) twice, or sets with the names of their channels."
        )
    return one, other, None if known is None or also_known is None else (known, also_known)


def _columns(shapes: object) -> tuple[ComplexArray, Sequence[str], FloatArray | None]:
    if isinstance(shapes, ModalModel):
        return shapes.shapes, shapes.output_names, shapes.frequencies
    if isinstance(shapes, Shapes):
        return shapes.shapes, shapes.names, shapes.frequencies
    return np.asarray(shapes), (), None


def read_shapes(path: str | Path) -> Shapes:
    """Shapes of a finite-element program or of another test.

    Args:
        path: a CSV table (first column: names of the channels; the head of every other column the frequency [Hz];
            complex numbers as `0.5+0.1j`), an NPZ archive with `shapes`, `names` and `frequencies`, or a universal
            file with data sets 55, whose channels are named by node and direction (`12X+`).

    Raises:
        UnreadableFileError: no such file, another type, damage, or no shape in it.
    """
    path = check_file(path)
    check_memory(path, 8.0 * path.stat().st_size)
    readers = {".csv": _read_csv, ".npz": _read_npz, ".uff": _read_uff, ".unv": _read_uff}
    if path.suffix.lower() not in readers:
        raise UnreadableFileError(
            f"{path.name} is of type {path.suffix or 'none'}; shapes are read from {', '.join(readers)}."
        )
    with foreign(path, "set of shapes"):
        return readers[path.suffix.lower()](path)


def _read_csv(path: Path) -> Shapes:
    with path.open(newline="", encoding="utf-8-sig") as file:
        rows = [row for row in csv.reader(file) if any(cell.strip() for cell in row)]
    head, body = rows[0], rows[1:]
    if any("_" in cell for row in (head[1:], *(row[1:] for row in body)) for cell in row):
        raise ValueError("a number with an underscore")  # which Python alone takes for one
    values = [[complex(cell.replace(" ", "").replace("i", "j")) for cell in row[1:]] for row in body]
    frequencies = [float(cell.replace("Hz", "").strip(" []")) for cell in head[1:]]
    return Shapes(np.array(values), tuple(row[0].strip() for row in body), np.array(frequencies))


def _read_npz(path: Path) -> Shapes:
    with sound_archive(path) as archive:
        arrays: dict[str, Any] = {
            member.filename.removesuffix(".npy"): array_of(archive, member) for member in archive.infolist()
        }
    return Shapes(arrays["shapes"], tuple(map(str, arrays["names"])), arrays.get("frequencies"))


def _read_uff(path: Path) -> Shapes:
    pyuff = optional_package("pyuff", path)
    file = pyuff.UFF(str(path))
    sets = [file.read_sets(number) for number, kind in enumerate(file.get_set_types()) if int(kind) == 55]
    if not sets:
        raise UnreadableFileError(f"{path.name} holds no data set 55, data at nodes; export the mode shapes.")
    columns = []
    for each in sets:
        motions = {f"r{axis}": each.get(f"r{axis}") for axis in range(1, 7)}
        columns.append(
            {
                f"{int(node)}{direction}": complex(values[row])
                for direction, values in zip(DIRECTIONS, motions.values(), strict=True)
                if values is not None
                for row, node in enumerate(each["node_nums"])
            }
        )
    names = [name for name in columns[0] if any(column.get(name, 0) != 0 for column in columns)]
    frequencies = [float(each["freq"]) if "freq" in each else abs(complex(each["eig"])) / (2 * np.pi) for each in sets]
    return Shapes(
        np.array([[column[name] for column in columns] for name in names]), tuple(names), np.array(frequencies)
    )
