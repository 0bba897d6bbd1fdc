"""Values out of a TOML table that somebody wrote by hand: each is checked, and an unknown key says which was meant.

Text from the file is shown short and on one line in every sentence.
"""

import datetime as dt
import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from modal.wording.names import shorten, visible
from okid.errors import InvalidDataError

__all__ = ["Table", "quoted"]

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
