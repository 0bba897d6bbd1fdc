"""Which columns of a table are inputs and which are outputs."""

import difflib
from collections import Counter
from collections.abc import Sequence
from typing import NoReturn

from okid.errors import InvalidDataError
from okid.readers.table import Table

__all__ = ["as_names", "choose_channels", "chosen_names"]

Names = Sequence[str] | str | None


def as_names(names: Names) -> list[str] | None:
    """A list of names; a single name is a list of one, None stays None."""
    return [names] if isinstance(names, str) else None if names is None else list(names)


def chosen_names(table: Table, inputs: Names, outputs: Names) -> tuple[list[str], list[str]]:
    """Names of the inputs and outputs, as `choose_channels` decides, not yet looked up."""
    into, out = as_names(inputs), as_names(outputs)
    if into is None and out is None and table.outputs is not None:
        return list(table.inputs or ()), list(table.outputs)
    into = into or []
    if out is None:
        taken = {index for name in into if (index := _find(table, name)) is not None}
        out = [table.columns[index].name for index in table.channels() if index not in taken]
    return into, out


def choose_channels(table: Table, inputs: Names, outputs: Names) -> tuple[list[int], list[int]]:
    """Column indices of the inputs and of the outputs, in the order of the names.

    Inputs and outputs given: these. Inputs alone: every other channel is an output. Outputs alone: no inputs. Neither:
    what the file itself states, else every channel is an output. The time column and a sample counter are no channels.

    Raises:
        InvalidDataError: no such channel, one that is both input and output or named twice, or no output left.
    """
    into, out = chosen_names(table, inputs, outputs)
    _check_once(into, out)
    indices = _indices(table, into), _indices(table, out)
    if not table.channels():
        left = [f"{left.name!r} was left out: {left.reason}" for left in table.left_out[:3]]
        why = left or ["save each channel as a column of numbers beside the time"]
        raise InvalidDataError(
            f"{table.path.name} holds {', '.join(table.names[:3])} but no channel; {'; '.join(why)}."
        )
    if not indices[1]:
        raise InvalidDataError(
            f"no output is left in {table.path.name}: its channels are {_listed(table)}, and all of them are inputs; "
            "name at least one output."
        )
    return indices


def _check_once(into: list[str], out: list[str]) -> None:
    both = sorted(set(into) & set(out))
    if both:
        raise InvalidDataError(f"{', '.join(map(repr, both))} cannot be both input and output; name each channel once.")
    double = sorted(name for name, count in Counter(into + out).items() if count > 1)
    if double:
        raise InvalidDataError(f"channel {', '.join(map(repr, double))} is named more than once; name each once.")


def _find(table: Table, name: str) -> int | None:
    """A column by its name, or by its whole header."""
    for index, column in enumerate(table.columns):
        if name in {column.name, column.header}:
            return index
    return None


def _indices(table: Table, names: Sequence[str]) -> list[int]:
    places = {column.header: index for index, column in enumerate(table.columns)}
    places |= {column.name: index for index, column in enumerate(table.columns)}
    channels = set(table.channels())
    for name in names:
        if places.get(name) not in channels:
            _refuse(table, name, places.get(name))
    return [places[name] for name in names]


def _refuse(table: Table, name: str, index: int | None) -> NoReturn:
    if index is not None:
        what = "the time axis" if index == table.time_column() else "a counter of the samples"
        raise InvalidDataError(
            f"column {name!r} of {table.path.name} is {what}, not a channel; the channels are {_listed(table)}."
        )
    for left in table.left_out:
        if left.name == name:
            raise InvalidDataError(f"{name!r} of {table.path.name} cannot be a channel: {left.reason}.")
    names = [table.columns[each].name for each in table.channels()]
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    folded = [each for each in names if each.lower() == name.lower()]
    guess = f"did you mean {(folded or close)[0]!r}? Its" if folded or close else "its"
    raise InvalidDataError(f"there is no channel {name!r} in {table.path.name}; {guess} channels are {_listed(table)}.")


def _listed(table: Table) -> str:
    names = [table.columns[index].name for index in table.channels()]
    more = f" and {len(names) - 20} more" if len(names) > 20 else ""
    return (", ".join(names[:20]) + more) or "none"
