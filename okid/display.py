"""How a frozen type shows itself: a few lines in a console, a small table in a notebook, never all of its numbers.

And how it is copied and pickled: numpy makes arrays writable again, and a copy is to be as frozen as what it is of.
"""

import html
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    import pyarrow as pa


class DisplayLimits:
    """How an object shows itself."""

    WIDTH: Final = 110
    """Show an object in one line where it is no longer than this."""
    MOST_LINES: Final = 18
    """Show so many fields at most; what is left out is counted in one more line."""


class Displayed:
    """A frozen type with a representation of at most 20 lines and 2000 characters.

    A type that says more in its own way has its own `__repr__`; one that is a table of something gives `display_rows`.
    """

    __slots__: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        """Let nobody write to the arrays; a type that checks them has its own."""
        own: Any = self
        for field in fields(own):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray) and value.flags.writeable:
                view = value.view()  # whoever made it may still write to it
                view.flags.writeable = False
                object.__setattr__(self, field.name, view)

    def __reduce__(self) -> tuple[Any, ...]:
        own: Any = self
        return _again, (type(self), {field.name: getattr(self, field.name) for field in fields(own)})

    def display_rows(self) -> list[tuple[str, str]]:
        """What is shown: the name of each field and its value in short."""
        own: Any = self  # a dataclass: this class has no fields of its own
        return [(field.name, in_short(getattr(self, field.name))) for field in fields(own) if field.repr]

    def display_title(self) -> str:
        """What stands above the rows."""
        return type(self).__name__

    def __repr__(self) -> str:
        rows, title = self.display_rows(), self.display_title()
        line = f"{title}({', '.join(f'{key}={value}' for key, value in rows)})"
        if len(line) <= DisplayLimits.WIDTH and "\n" not in line and title == type(self).__name__:
            return line
        return "\n".join([f"{title}:", *_lines(rows)])

    def _repr_html_(self) -> str:
        cells = "".join(
            f"<tr><th style='text-align:left'>{html.escape(key)}</th>"
            f"<td style='text-align:left'>{html.escape(value)}</td></tr>"
            for key, value in _cut(self.display_rows())
        )
        return f"<table><caption>{html.escape(self.display_title())}</caption>{cells}</table>"


def _again(kind: type, values: Mapping[str, Any]) -> Any:
    """An object with these fields, frozen and not checked again."""
    made: Any = object.__new__(kind)
    for name, value in values.items():
        _freeze(value)
        object.__setattr__(made, name, value)
    return made


def _freeze(value: Any) -> None:
    """Let nobody write to the arrays in a value."""
    if isinstance(value, np.ndarray):
        value.flags.writeable = False
    elif isinstance(value, tuple | list):
        for each in value:
            _freeze(each)
    elif isinstance(value, Mapping):
        _freeze(tuple(value.values()))
    elif is_dataclass(value) and not isinstance(value, type | Displayed):
        _freeze(tuple(getattr(value, field.name) for field in fields(value)))


def first_names(names: Sequence[str]) -> str:
    """Names as a list, the first few where they are many.

    Example:
        >>> first_names(["tip", "root"]), first_names([f"floor_{k}" for k in range(40)])
        ("['tip', 'root']", "['floor_0', 'floor_1', 'floor_2', 'floor_3', ... 40 in all]")
    """
    text = str(list(names))
    if len(text) <= 4 * DisplayLimits.WIDTH:
        return text
    return f"[{', '.join(map(in_short, names[:4]))}, ... {len(names)} in all]"


def in_short(value: Any) -> str:
    """One line about a value: numbers where there are few, else what and how many."""
    if isinstance(value, np.ndarray):
        return _array(value)
    if isinstance(value, float | complex | np.inexact):
        return f"{value:.6g}"
    if isinstance(value, str):
        return repr(value if len(value) <= DisplayLimits.WIDTH else f"{value[: DisplayLimits.WIDTH - 3]}...")
    if isinstance(value, tuple | list):
        return _several(value)
    if isinstance(value, Mapping):
        return f"{len(value)} of {', '.join(map(str, list(value)[:4]))}{', ...' if len(value) > 4 else ''}"
    text = repr(value)
    return text if "\n" not in text and len(text) <= DisplayLimits.WIDTH else f"{type(value).__name__}(...)"


def _array(value: npt.NDArray[Any]) -> str:
    if value.size > 6 or value.dtype == object:
        return f"{value.dtype} {value.shape}"
    return " ".join(np.array2string(value, precision=4, separator=", ").split())


def _several(values: tuple[Any, ...] | list[Any]) -> str:
    if all(isinstance(value, str | int | float | complex | np.number | None) for value in values):
        text = ", ".join(in_short(value) for value in values)
        if len(text) <= DisplayLimits.WIDTH:
            return f"({text})"
    kinds = sorted({type(value).__name__ for value in values})
    return f"{len(values)} {' and '.join(kinds)}" if len(kinds) <= 2 else f"{len(values)} values"


def _cut(rows: list[tuple[str, str]]) -> list[tuple[str, str]]:
    if len(rows) <= DisplayLimits.MOST_LINES + 1:
        return rows
    rest = ", ".join(name for name, _ in rows[DisplayLimits.MOST_LINES :])
    return [
        *rows[: DisplayLimits.MOST_LINES],
        ("...", rest if len(rest) <= DisplayLimits.WIDTH else f"{len(rows) - DisplayLimits.MOST_LINES} more"),
    ]


def _lines(rows: list[tuple[str, str]]) -> list[str]:
    rows = _cut(rows)
    wide = max(len(name) for name, _ in rows)
    return [f"  {name:{wide}}  {value if len(value) <= 80 else f'{value[:77]}...'}" for name, value in rows]


def table_of_columns(columns: Mapping[str, tuple[Any, str]]) -> "pa.Table":
    """An Arrow table of columns by name, each with its values and their unit, which stands in its metadata.

    Example:
        >>> table_of_columns({"frequency": ([1.0, 2.0], "Hz")}).schema.field("frequency").metadata
        {b'unit': b'Hz'}
    """
    import pyarrow as pa

    arrays = [pa.array(values) for values, _ in columns.values()]
    units = [{"unit": unit} if unit else None for _, unit in columns.values()]
    fields = [
        pa.field(name, array.type, metadata=unit) for name, array, unit in zip(columns, arrays, units, strict=True)
    ]
    return pa.table(arrays, schema=pa.schema(fields))


def complex_lists(columns: npt.NDArray[np.complex128]) -> list[list[dict[str, float]]]:
    """Each column as a list of {real, imaginary}: Arrow knows no complex numbers."""
    return [[{"real": z.real, "imaginary": z.imag} for z in column] for column in columns.T.tolist()]
