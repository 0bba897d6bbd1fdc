"""Checks of arrays, of single numbers and of stages that every part takes, and one BLAS thread while we work.

An array is kept as a view where nobody else can write to it (a memory map opened for reading, an array that is already
read-only all the way down), and copied otherwise, so that a frozen type is frozen in fact. Counts, orders and time
steps are taken as a caller may hold them (Python or numpy, 3 or 3.0), the rest is refused in one sentence; so is the
result of the wrong stage.
"""

import math
import operator
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from typing import Any

import numpy as np
import numpy.typing as npt

from okid.errors import InvalidDataError

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
BoolArray = npt.NDArray[np.bool_]

ROUNDED = 1e-9
"""Take numbers that are closer, relative to their size, as one number that was rounded twice, and a smaller share of
its like as zero: rounding, grown by a solve or by a text file."""
TINY = 1e-300
"""Divide by no less than this: nothing over nothing is nothing, and no quotient of it overflows."""
SHORTEST_STEP, LONGEST_STEP = 1e-12, 1e9
"""Refuse time steps [s] that no experiment has: beyond them the arithmetic of frequencies overflows."""

CHUNK_VALUES = 1 << 21
"""Values looked at in one step, so that checking a mapped file needs 16 MiB at a time."""


def listener(progress: Callable[[str, float], None] | None) -> Callable[[str, float], None]:
    """What is told of the progress, as `progress(what, share_done)`; None hears nothing.

    Raises:
        InvalidDataError: something that cannot be called.
    """
    if progress is None:
        return lambda _what, _share: None
    if not callable(progress):
        raise InvalidDataError(
            f"progress must be a function that is called as progress(what, share_done), but {progress!r} was given."
        )
    return progress


def row_chunks(n_samples: int, n_channels: int) -> Iterator[slice]:
    """Row slices of at most `CHUNK_VALUES` values that cover `n_samples` rows."""
    step = max(1, CHUNK_VALUES // max(1, n_channels))
    return (slice(start, min(start + step, n_samples)) for start in range(0, n_samples, step))


def column_block(array: FloatArray, indices: Sequence[int]) -> FloatArray:
    """The columns at `indices`, in that order: a view where they are evenly spaced, a copy otherwise.

    A view keeps a mapped file on disk: inputs and outputs that stand side by side in it cost no memory.

    Example:
        >>> table = np.arange(12.0).reshape(3, 4)
        >>> column_block(table, [1, 2]).base is table.base, column_block(table, [2, 0, 1])[0]
        (True, array([2., 0., 1.]))
    """
    if len(indices) == 0:
        return array[:, :0]
    steps = set(np.diff(indices).tolist())
    if len(steps) > 1 or not all(step > 0 for step in steps):
        return np.ascontiguousarray(array[:, list(indices)])
    return array[:, indices[0] : indices[-1] + 1 : steps.pop() if steps else 1]


def _nobody_can_write(array: npt.NDArray[np.generic]) -> bool:
    base: object = array
    while isinstance(base, np.ndarray):
        if base.flags.writeable:
            return False
        base = base.base
    return True


def is_mapped(array: npt.NDArray[np.generic]) -> bool:
    """Whether it stands in a file, not in memory."""
    base: object = array
    while isinstance(base, np.ndarray):
        if isinstance(base, np.memmap):
            return True
        base = base.base
    return False


def frozen(values: npt.ArrayLike, *, name: str, shape: tuple[int | None, ...] | None = None) -> FloatArray:
    """A read-only C-contiguous float64 array, checked to be finite and of the given shape (None: any length).

    Args:
        values: anything that numpy takes for real numbers.
        name: what to call it in an error.
        shape: expected shape, None for a free axis.

    Raises:
        InvalidDataError: not real numbers, wrong shape, or a value that is not finite.

    Example:
        >>> frozen([[1, 2]], name="D", shape=(1, None)).flags.writeable
        False
    """
    array = _as_float(values, name)
    _check_shape(array, name, shape)
    if not np.isfinite(array).all():
        raise InvalidDataError(
            f"{name} must be finite, but {int((~np.isfinite(array)).sum())} of its {array.size} values are NaN or "
            "infinite."
        )
    return _read_only(array)


def frozen_with_gaps(values: npt.ArrayLike, *, name: str, shape: tuple[int | None, ...] | None = None) -> FloatArray:
    """As `frozen`, for numbers of which some may not be known (NaN)."""
    array = _as_float(values, name)
    _check_shape(array, name, shape)
    return _read_only(array)


def frozen_complex(values: npt.ArrayLike, *, name: str) -> ComplexArray:
    """As `frozen`, for complex128 of any shape."""
    array = np.asarray(values, dtype=np.complex128)
    if not np.isfinite(array).all():
        raise InvalidDataError(f"{name} must be finite.")
    if array.flags.writeable:
        array = array.copy()
        array.flags.writeable = False
    return array


def time_major(values: npt.ArrayLike, *, name: str) -> FloatArray:
    """A read-only (n_samples, n_channels) float64 array; NaN is allowed, infinity is not.

    One-dimensional values are one channel; masked values are missing. Strided views of a read-only memory map stay
    views.

    Raises:
        InvalidDataError: not numbers, more than two axes, or infinite values.
    """
    array = _as_float(values, name)
    if array.ndim == 1:
        array = array[:, np.newaxis]
    if array.ndim != 2:
        raise InvalidDataError(
            f"{name} must be (n_samples, n_channels), but has {array.ndim} axes {array.shape}; pass a two-dimensional "
            "array."
        )
    for rows in row_chunks(*array.shape):
        infinite = np.isinf(array[rows])
        if infinite.any():
            row, channel = (int(index) for index in np.argwhere(infinite)[0])
            raise InvalidDataError(
                f"{name} must not hold infinite values, but sample {rows.start + row} of channel {channel} is one; "
                "mark missing samples as NaN."
            )
    return _read_only(array)


def _as_float(values: npt.ArrayLike, name: str) -> FloatArray:
    try:
        given = np.asarray(values)
        if given.dtype.kind == "c":
            raise InvalidDataError(
                f"{name} must be real numbers, but is complex; pass its real part, or time histories."
            )
        if given.dtype.kind in "USmM" or (given.dtype.kind == "O" and any(map(_is_no_number, given.flat))):
            raise InvalidDataError(
                f"{name} must be real numbers, but holds texts or times; turn texts into numbers, and times into "
                "seconds after the first."
            )
        if given.dtype.kind not in "biuf":
            given = given.astype(np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        if isinstance(error, InvalidDataError):
            raise
        raise InvalidDataError(f"{name} must be an array of real numbers ({error}).") from error
    array = given.astype(np.float64, copy=False)
    # What lies under a mask is no measurement, and numpy.asarray would bring it back.
    return np.where(np.ma.getmaskarray(values), np.nan, array) if isinstance(values, np.ma.MaskedArray) else array


def _is_no_number(value: object) -> bool:
    return isinstance(value, str | bytes | np.datetime64 | np.timedelta64)


def _check_shape(array: npt.NDArray[np.generic], name: str, shape: tuple[int | None, ...] | None) -> None:
    if shape is None:
        return
    if array.ndim != len(shape) or any(want not in (None, have) for want, have in zip(shape, array.shape, strict=True)):
        wanted = ", ".join("any" if want is None else str(want) for want in shape)
        raise InvalidDataError(f"{name} must have shape ({wanted}), but has {array.shape}.")


def _read_only(array: FloatArray) -> FloatArray:
    if _nobody_can_write(array) and (array.flags.c_contiguous or is_mapped(array)):
        return array
    array = np.array(array, dtype=np.float64, order="C")
    array.flags.writeable = False
    return array


def real_number(value: Any) -> float:
    """The value as a float; nan where it is no single real number (text, a list, a truth value, None).

    Example:
        >>> real_number(3), real_number("3"), real_number(True)
        (3.0, nan, nan)
    """
    if isinstance(value, bool | bytearray) or _is_no_number(value) or getattr(value, "ndim", 0) != 0:
        return math.nan
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return math.nan


def whole_number(value: Any, *, name: str, least: int, otherwise: str = "") -> int:
    """The value as an int of at least `least`.

    Args:
        value: 3, 3.0 or a numpy scalar.
        name: what to call it in an error.
        least: smallest value allowed.
        otherwise: what else the argument may be, for the message, e.g. 'or "auto"'.

    Raises:
        InvalidDataError: no number, no whole number, or one below `least`.

    Example:
        >>> whole_number(3.0, name="n_lags", least=1)
        3
    """
    number = real_number(value)
    if math.isfinite(number) and number == math.floor(number) and number >= least:
        # An integer beyond 2^53 is not what its float says.
        return operator.index(value) if hasattr(value, "__index__") else int(number)
    options = f" {otherwise}" if otherwise else ""
    raise InvalidDataError(f"{name} must be a whole number of at least {least}{options}, but is {value!r}.")


def time_step(value: Any) -> float:
    """A time step in seconds as a float.

    Raises:
        InvalidDataError: no number, or one that is not positive, finite and within what an experiment can have.

    Example:
        >>> time_step(0.01)
        0.01
    """
    step = real_number(value)
    if not (math.isfinite(step) and step > 0):
        raise InvalidDataError(f"dt must be a positive time step in seconds, but is {value!r}.")
    if not SHORTEST_STEP <= step <= LONGEST_STEP:
        raise InvalidDataError(
            f"dt must be a time step between {SHORTEST_STEP:g} and {LONGEST_STEP:g} s, but is {step:g}; count the time "
            "in another unit."
        )
    return step


def require(value: object, kind: type, *, where: str, made_by: str) -> None:
    """Refuse anything but an instance of `kind`.

    Args:
        value: what the caller gave.
        kind: the type that is taken.
        where: the function that takes it.
        made_by: how one comes by such a thing.

    Raises:
        InvalidDataError: another type; the message names both and the remedy.

    Example:
        >>> require(3, str, where="f", made_by="str(...)")
        Traceback (most recent call last):
        okid.errors.InvalidDataError: f takes a str, but was given int; make one by str(...).
    """
    if not isinstance(value, kind):
        article = "an" if kind.__name__[0] in "AEIOU" else "a"
        raise InvalidDataError(
            f"{where} takes {article} {kind.__name__}, but was given {type(value).__name__}; make one by {made_by}."
        )


def any_number(array: FloatArray) -> bool:
    """Whether anything but NaN is there; a mapped file is read only as far as needed."""
    return any(not np.isnan(array[rows]).all() for rows in row_chunks(*array.shape))


def with_numbers(array: FloatArray) -> BoolArray:
    """(n_channels,) whether a channel holds anything but NaN; a mapped file is read only as far as needed."""
    seen = np.zeros(array.shape[1], dtype=np.bool_)
    for rows in row_chunks(*array.shape):
        chunk = array[rows]
        seen |= ~np.isnan(chunk[0])  # mostly the first sample tells
        seen |= seen.all() or ~np.isnan(chunk).all(axis=0)
        if seen.all():
            break
    return seen


def check_not_empty(array: FloatArray, names: tuple[str, ...], kind: str) -> None:
    """Raise if a channel is missing in every sample."""
    seen = with_numbers(array)
    empty = [repr(name) for name, any_number in zip(names, seen, strict=True) if not any_number]
    if len(empty) == 1:
        raise InvalidDataError(
            f"{kind} {empty[0]} holds no number in any of its {array.shape[0]} samples; leave it out."
        )
    if empty:
        raise InvalidDataError(
            f"{kind}s {', '.join(empty)} hold no number in any of their {array.shape[0]} samples; leave them out."
        )


def one_blas_thread() -> AbstractContextManager[object]:
    """A context in which numpy and scipy use one thread; what was set before is restored at its end.

    Our matrices have a few hundred rows. For them a second thread gains nothing, and on a busy machine the threads wait
    for each other: an identification took 42 s of processor time instead of 5 s on two cores with a load of eight.

    Example:
        >>> with one_blas_thread():
        ...     pass
    """
    import scipy.linalg  # noqa: F401  # scipy brings a BLAS of its own, which must be loaded before it can be limited
    from threadpoolctl import threadpool_limits

    limits: AbstractContextManager[object] = threadpool_limits(limits=1, user_api="blas")
    return limits
