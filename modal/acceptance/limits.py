"""The conditions that a result can be asked to meet, one type each.

`modal.acceptance.check` weighs a result against them.

The [[limits]] of a test file: each table becomes the condition that its `kind` names.

Values out of a TOML table that somebody wrote by hand: each is checked, and an unknown key says which was meant.

Text from the file is shown short and on one line in every sentence.
"""

import datetime as dt
import difflib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from modal.wording.names import shorten, visible
from okid.errors import InvalidDataError

__all__ = [
    "DampingRange",
    "FitAtLeast",
    "Limit",
    "ModeCount",
    "ModeExpected",
    "ModeForbidden",
    "Range",
    "SettledVerdicts",
    "Table",
    "TrustAtLeast",
    "UncertaintyAtMost",
    "limits_of",
    "quoted",
]

Range = tuple[float, float]
"""Lowest and highest value, both allowed."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ModeExpected:
    """A mode of the system lies in a frequency band, its damping in a range.

    Attributes:
        name: of the limit, e.g. "first bending".
        frequency: [Hz].
        damping: damping ratio; None where any will do.
    """

    name: str
    frequency: Range
    damping: Range | None = None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ModeForbidden:
    """No mode of the system lies in a frequency band.

    Attributes:
        name: of the limit, e.g. "clear of the rotor".
        frequency: [Hz].
    """

    name: str
    frequency: Range


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ModeCount:
    """The number of modes of the system lies in a range.

    Attributes:
        name: of the limit.
        at_least: fewest modes.
        at_most: most modes, infinite where any number will do.
    """

    name: str
    at_least: float = 0
    at_most: float = float("inf")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DampingRange:
    """The damping ratio of every mode of the system in a band lies in a range.

    Attributes:
        name: of the limit, e.g. "flutter margin".
        damping: damping ratio, the upper end infinite where any will do.
        frequency: band [Hz]; None for all modes.
    """

    name: str
    damping: Range
    frequency: Range | None = None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FitAtLeast:
    """The cross-validated fit, mean over outputs, is large enough.

    Attributes:
        name: of the limit.
        at_least: 1 is perfect.
    """

    name: str
    at_least: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class UncertaintyAtMost:
    """Half the 95 % interval of every mode of the system in a band is small enough.

    Attributes:
        name: of the limit.
        frequency_share: largest share of the frequency, e.g. 0.01; None where it does not matter.
        damping_share: largest share of the damping ratio; None where it does not matter.
        frequency: band [Hz]; None for all modes.
    """

    name: str
    frequency_share: float | None = None
    damping_share: float | None = None
    frequency: Range | None = None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SettledVerdicts:
    """No pole in a band is doubtful.

    Attributes:
        name: of the limit.
        frequency: band [Hz]; None for all poles.
    """

    name: str
    frequency: Range | None = None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TrustAtLeast:
    """The data carry the result as a whole.

    Attributes:
        name: of the limit.
        at_least: "carried", or "with care" for that too.
    """

    name: str
    at_least: Literal["carried", "with care"]


Limit = (
    ModeExpected
    | ModeForbidden
    | ModeCount
    | DampingRange
    | FitAtLeast
    | UncertaintyAtMost
    | SettledVerdicts
    | TrustAtLeast
)
"""One condition that a result must meet to be accepted."""


LONGEST_WORD = 60
"""Letters of a word from the file in a sentence."""

LONGEST_TEXT = 2000
"""Letters of a text that a report is asked to show."""


def quoted(value: object) -> str:
    """A value from a file as it may stand in a sentence: on one line, short, in quotation marks."""
    return repr(shorten(visible(str(value)), LONGEST_WORD))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Table:
    """A table of the file, with the place that its errors name.

    Attributes:
        values: keys and values as the TOML reader gives them.
        where: e.g. "test.toml" or "limit 2 of test.toml".

    Example:
        >>> table = Table(values={"fit": 0.9}, where="test.toml")
        >>> table.number("fit", least=0.0)
        0.9
        >>> Table(values={"artcle": "frame"}, where="test.toml").refuse_others(("article", "date"))
        Traceback (most recent call last):
        okid.errors.InvalidDataError: test.toml has no key 'artcle'; did you mean article? The keys are article, date.
    """

    values: Mapping[str, object]
    where: str

    def refuse_others(self, known: Sequence[str]) -> None:
        """Raise where the table has a key that is not known.

        Raises:
            InvalidDataError: the first such key, the nearest known one, and all of them.
        """
        for key in self.values:
            if key not in known:
                near = difflib.get_close_matches(key, known, n=1)
                meant = f"did you mean {near[0]}? The keys are" if near else "the keys are"
                raise InvalidDataError(f"{self.where} has no key {quoted(key)}; {meant} {', '.join(known)}.")

    def has(self, key: str) -> bool:
        """Whether the table has the key."""
        return key in self.values

    def text(self, key: str, *, longest: int = LONGEST_TEXT) -> str:
        """A text, "" where there is none; a serial number may be written as a number."""
        value = self.values.get(key, "")
        if isinstance(value, bool) or not isinstance(value, str | int | float):
            raise self._wrong(key, "a text in quotation marks")
        text = str(value).strip()
        if len(text) > longest:
            raise InvalidDataError(
                f"{key} in {self.where} has {len(text)} characters, at most {longest} are shown; shorten it."
            )
        return text

    def word(self, key: str, choices: Sequence[str]) -> str:
        """One of some words.

        Raises:
            InvalidDataError: it is missing or another one; the nearest is named.
        """
        value = self.values.get(key)
        if isinstance(value, str) and value in choices:
            return value
        near = difflib.get_close_matches(value, choices, n=1) if isinstance(value, str) else []
        meant = f"; did you mean {near[0]}?" if near else "."
        found = f"but is {quoted(value)}" if self.has(key) else "but is missing"
        raise InvalidDataError(f"{key} in {self.where} must be one of {', '.join(choices)}, {found}{meant}")

    def day(self, key: str) -> dt.date | None:
        """A date, None where there is none: 2026-05-04, or the same in quotation marks."""
        value = self.values.get(key)
        if value is None:
            return None
        if isinstance(value, dt.datetime):
            return value.date()
        if isinstance(value, dt.date):
            return value
        try:
            return dt.date.fromisoformat(str(value))
        except ValueError as error:
            raise self._wrong(key, "a date such as 2026-05-04") from error

    def number(self, key: str, *, least: float = -math.inf, most: float = math.inf, remedy: str = "") -> float:
        """A finite number in a range; it must be there.

        Raises:
            InvalidDataError: it is missing, no number, or out of range.
        """
        if not self.has(key):
            raise InvalidDataError(f"{self.where} needs {key}; add it, or take the table out.")
        return self._number(self.values[key], key, least, most, remedy)

    def number_or(self, key: str, otherwise: float, *, least: float = -math.inf, most: float = math.inf) -> float:
        """The same, with a value where it is missing."""
        return self.number(key, least=least, most=most) if self.has(key) else otherwise

    def pair(self, key: str, *, least: float, most: float = math.inf, remedy: str = "") -> tuple[float, float]:
        """Two rising numbers, such as the ends of a band.

        Raises:
            InvalidDataError: it is missing, not two numbers, not rising or out of range.
        """
        if not self.has(key):
            raise InvalidDataError(f"{self.where} needs {key} = [lowest, highest]; add it.")
        value = self.values[key]
        if not isinstance(value, list) or len(value) != 2:
            raise self._wrong(key, "two numbers [lowest, highest]")
        low, high = (self._number(item, key, least, most, remedy) for item in value)
        if not low < high:
            raise InvalidDataError(f"{key} in {self.where} must rise, but goes from {low:g} to {high:g}; swap the two.")
        return low, high

    def pair_or_none(
        self, key: str, *, least: float, most: float = math.inf, remedy: str = ""
    ) -> tuple[float, float] | None:
        """The same, None where it is missing."""
        return self.pair(key, least=least, most=most, remedy=remedy) if self.has(key) else None

    def tables(self, key: str, what: str) -> "tuple[Table, ...]":
        """A list of tables, each with its number in the name of its place.

        Args:
            key: of the list.
            what: one of them is, e.g. "limit".

        Raises:
            InvalidDataError: it is no list of tables.
        """
        value = self.values.get(key, [])
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            raise self._wrong(key, f"tables, each under a line [[{key}]]")
        return tuple(
            Table(values=item, where=f"{what} {number} of {self.where}") for number, item in enumerate(value, start=1)
        )

    def _number(self, value: object, key: str, least: float, most: float, remedy: str) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self._wrong(key, "a number")
        try:
            number = float(value)
        except OverflowError:  # an integer of more than 308 digits
            number = math.nan
        if not (math.isfinite(number) and least <= number <= most):
            upper = f" and at most {most:g}" if math.isfinite(most) else ""
            raise InvalidDataError(
                f"{key} in {self.where} must be at least {least:g}{upper}, but is {quoted(value)}"
                + (f"; {remedy}." if remedy else ".")
            )
        return number

    def _wrong(self, key: str, wanted: str) -> InvalidDataError:
        return InvalidDataError(f"{key} in {self.where} must be {wanted}, but is {quoted(self.values[key])}.")


_LONGEST_NAME = 200
_MOST_LIMITS = 1000
_RATIO = "a damping ratio is a share: write 2 % as 0.02"


def limits_of(table: Table) -> tuple[Limit, ...]:
    """The conditions of a test file, in its order.

    Args:
        table: the whole file.

    Raises:
        InvalidDataError: a kind or key that is not known, a value that is missing or none, or more than 1000 of them.

    Example:
        >>> limits_of(Table(values={"limits": [{"kind": "fit", "at_least": 0.9}]}, where="test.toml"))
        (FitAtLeast(name='', at_least=0.9),)
    """
    tables = table.tables("limits", "limit")
    if len(tables) > _MOST_LIMITS:
        raise InvalidDataError(f"{table.where} has {len(tables)} limits, at most {_MOST_LIMITS} are weighed.")
    return tuple(_KINDS[one.word("kind", tuple(_KINDS))](one) for one in tables)


def _name(table: Table, *keys: str) -> str:
    """The name of a limit, once its keys are known to be right."""
    table.refuse_others(("kind", "name", *keys))
    return table.text("name", longest=_LONGEST_NAME)


def _mode(table: Table) -> ModeExpected:
    return ModeExpected(
        name=_name(table, "frequency", "damping"),
        frequency=table.pair("frequency", least=0.0),
        damping=table.pair_or_none("damping", least=-1.0, most=1.0, remedy=_RATIO),
    )


def _no_mode(table: Table) -> ModeForbidden:
    return ModeForbidden(name=_name(table, "frequency"), frequency=table.pair("frequency", least=0.0))


def _n_modes(table: Table) -> ModeCount:
    name = _name(table, "at_least", "at_most")
    _need_one(table, "at_least", "at_most")
    least, most = table.number_or("at_least", 0, least=0), table.number_or("at_most", math.inf, least=0)
    _need_order(table, least, most)
    return ModeCount(name=name, at_least=least, at_most=most)


def _damping(table: Table) -> DampingRange:
    name = _name(table, "at_least", "at_most", "frequency")
    _need_one(table, "at_least", "at_most")
    least, most = (
        table.number(key, least=-1.0, most=1.0, remedy=_RATIO) if table.has(key) else otherwise
        for key, otherwise in (("at_least", -math.inf), ("at_most", math.inf))
    )
    _need_order(table, least, most)
    return DampingRange(name=name, damping=(least, most), frequency=table.pair_or_none("frequency", least=0.0))


def _fit(table: Table) -> FitAtLeast:
    return FitAtLeast(name=_name(table, "at_least"), at_least=table.number("at_least", least=0.0, most=1.0))


def _uncertainty(table: Table) -> UncertaintyAtMost:
    keys = ("frequency_at_most", "damping_at_most")
    name = _name(table, *keys, "frequency")
    _need_one(table, *keys)
    frequency, damping = (table.number(key, least=0.0) if table.has(key) else None for key in keys)
    return UncertaintyAtMost(
        name=name,
        frequency_share=frequency,
        damping_share=damping,
        frequency=table.pair_or_none("frequency", least=0.0),
    )


def _settled(table: Table) -> SettledVerdicts:
    return SettledVerdicts(name=_name(table, "frequency"), frequency=table.pair_or_none("frequency", least=0.0))


def _trust(table: Table) -> TrustAtLeast:
    name = _name(table, "at_least")
    word = table.word("at_least", ("carried", "with care"))
    return TrustAtLeast(name=name, at_least="carried" if word == "carried" else "with care")


def _need_one(table: Table, *keys: str) -> None:
    if not any(table.has(key) for key in keys):
        raise InvalidDataError(f"{table.where} needs {' or '.join(keys)}; add one of them.")


def _need_order(table: Table, least: float, most: float) -> None:
    if least > most:
        raise InvalidDataError(f"at_least {least:g} is above at_most {most:g} in {table.where}; swap the two.")


_KINDS: dict[str, Callable[[Table], Limit]] = {
    "mode": _mode,
    "no_mode": _no_mode,
    "n_modes": _n_modes,
    "damping": _damping,
    "fit": _fit,
    "uncertainty": _uncertainty,
    "settled": _settled,
    "trust": _trust,
}
