"""The limits that a result can be asked to meet, out of a TOML table that somebody wrote by hand.

Each value is checked, an unknown key says which was meant, and text from the file is shown short and on one line in
every sentence. `modal.acceptance.check` weighs a result against the limits.
"""

import datetime as dt
import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from modal.geometry.sensors import quoted
from okid.errors import InvalidDataError

__all__ = ["KEYS", "AcceptanceLimit", "Range", "TomlTable", "limits_of"]

Range = tuple[float, float]
"""Lowest and highest value, both allowed."""

KEYS = {
    "mode": ("frequency", "damping"),
    "no_mode": ("frequency",),
    "n_modes": ("at_least", "at_most"),
    "damping": ("at_least", "at_most", "frequency"),
    "fit": ("at_least",),
    "uncertainty": ("frequency_at_most", "damping_at_most", "frequency"),
    "settled": ("frequency",),
    "trust": ("at_least",),
}
"""What each kind of limit may say beside its name."""

LONGEST_NAME = 200
"""Refuse the name of a limit, a channel or a sensor with more letters: it stands in a table."""

LONGEST_TEXT = 2000
"""Refuse a longer text: a report is asked to show it."""

MOST_LIMITS = 1000
"""Refuse a file with more limits: each is a row of the report."""

_RATIO = "a damping ratio is a share: write 2 % as 0.02"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class AcceptanceLimit:
    """One condition that a result must meet to be accepted; which of the values it has is told by its kind.

    Attributes:
        kind: "mode": a mode of the system lies in the band, its damping ratio in the range; "no_mode": none lies there;
            "n_modes": their number; "damping": the damping ratio of every mode in the band; "fit": cross-validated,
            mean over outputs; "uncertainty": half the 95 % interval of every mode in the band; "settled": no pole in
            the band is doubtful; "trust": the result as a whole can be relied on.
        name: e.g. "first bending"; "" where it has none.
        frequency: band [Hz]; None for all.
        damping: range of the damping ratio of a "mode"; None where any will do.
        at_least: least value of "n_modes", "damping" or "fit".
        at_most: greatest value of "n_modes" or "damping".
        frequency_at_most: largest "uncertainty" as a share of the frequency; None where it does not matter.
        damping_at_most: the same of the damping ratio.
        trust: "carried", or "with care" for that too.
    """

    kind: str
    name: str = ""
    frequency: Range | None = None
    damping: Range | None = None
    at_least: float = -math.inf
    at_most: float = math.inf
    frequency_at_most: float | None = None
    damping_at_most: float | None = None
    trust: Literal["carried", "with care"] = "carried"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TomlTable:
    """A table of the file, with the place that its errors name.

    Attributes:
        values: keys and values as the TOML reader gives them.
        where: e.g. "test.toml" or "limit 2 of test.toml".

    Example:
        >>> table = TomlTable(values={"fit": 0.9}, where="test.toml")
        >>> table.number("fit", least=0.0)
        0.9
        >>> TomlTable(values={"artcle": "frame"}, where="test.toml").refuse_others(("article", "date"))
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

    def tables(self, key: str, what: str) -> "tuple[TomlTable, ...]":
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
            TomlTable(values=item, where=f"{what} {number} of {self.where}")
            for number, item in enumerate(value, start=1)
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


def limits_of(table: TomlTable) -> tuple[AcceptanceLimit, ...]:
    """The limits of a test file, in its order.

    Args:
        table: the whole file.

    Raises:
        InvalidDataError: a kind or key that is not known, a value that is missing or none, or more than 1000 of them.

    Example:
        >>> limits_of(TomlTable(values={"limits": [{"kind": "fit", "at_least": 0.9}]}, where="test.toml"))[0].at_least
        0.9
    """
    tables = table.tables("limits", "limit")
    if len(tables) > MOST_LIMITS:
        raise InvalidDataError(f"{table.where} has {len(tables)} limits, at most {MOST_LIMITS} are weighed.")
    return tuple(map(_limit, tables))


def _limit(table: TomlTable) -> AcceptanceLimit:
    kind = table.word("kind", tuple(KEYS))
    table.refuse_others(("kind", "name", *KEYS[kind]))
    name = table.text("name", longest=LONGEST_NAME)
    if kind == "trust":
        word = table.word("at_least", ("carried", "with care"))
        return AcceptanceLimit(kind=kind, name=name, trust="carried" if word == "carried" else "with care")
    bounds = [key for key in KEYS[kind] if key.endswith(("at_least", "at_most"))]
    if bounds and not any(table.has(key) for key in bounds) and kind != "fit":
        raise InvalidDataError(f"{table.where} needs {' or '.join(bounds)}; add one of them.")
    needed = {"fit": "at_least", "mode": "frequency", "no_mode": "frequency"}.get(kind)
    values = {key: _value(table, kind, key) for key in KEYS[kind] if table.has(key) or key == needed}
    least, most = values.get("at_least", -math.inf), values.get("at_most", math.inf)
    if least > most:
        raise InvalidDataError(f"at_least {least:g} is above at_most {most:g} in {table.where}; swap the two.")
    return AcceptanceLimit(kind=kind, name=name, **values)


def _value(table: TomlTable, kind: str, key: str) -> Any:
    if key == "frequency":
        return table.pair(key, least=0.0)
    if key == "damping":
        return table.pair(key, least=-1.0, most=1.0, remedy=_RATIO)
    if kind == "damping":
        return table.number(key, least=-1.0, most=1.0, remedy=_RATIO)
    return table.number(key, least=0.0, most=1.0 if kind == "fit" else math.inf)
