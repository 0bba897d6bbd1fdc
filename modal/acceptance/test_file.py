"""What no measured file knows of a test: the article, the sensors, who and where, and the limits of acceptance.

It stands in a TOML file that somebody wrote by hand. Every key is known; a misspelt one is an error that says which was
meant. All of it may be left out:

    article = "three-storey frame"
    operator = "A. Tester"
    place = "hall 2"
    date = 2026-05-04
    notes = "second floor bolted again before run 3"
    geometry = "frame.geometry.toml"       # or a table [geometry]

    [[sensors]]
    channel = "tip"                        # as in the measured file
    kind = "accelerometer"
    serial = "12345"
    sensitivity = "100 mV/g"
    calibrated = 2026-01-10
    dof = "3X+"

    [[limits]]
    kind = "mode"                          # a mode must lie in the band
    frequency = [3.5, 3.9]                 # Hz
    damping = [0.005, 0.02]                # as a ratio: 0.02 is 2 %; may be left out

The other kinds of limit: no_mode (frequency), n_modes (at_least, at_most), damping (at_least, at_most, frequency), fit
(at_least), uncertainty (frequency_at_most, damping_at_most: half the 95 % interval as a share of the value; frequency),
settled (no doubtful pole; frequency) and trust (at_least = "carried" or "with care"). Each may have a name.

Each value is checked, and text from the file is shown short and on one line in every sentence. A result is weighed
against the limits in `modal.acceptance.check`.
"""

import datetime as dt
import difflib
import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

from modal.geometry.file import MOST_TEXT, geometry_of_table, read_geometry
from modal.geometry.sensors import Geometry, quoted
from modal.wording.text import shorten
from okid.display import Displayed
from okid.errors import InvalidDataError, UnreadableFileError, visible

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


class FileLimits:
    """What a test file may hold."""

    LONGEST_NAME: Final = 200
    """Refuse the name of a limit, a channel or a sensor with more letters: it stands in a table."""
    MOST_LIMITS: Final = 1000
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

    def text(self, key: str, *, longest: int = 2000) -> str:
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

    Raises:
        InvalidDataError: a kind or key that is not known, a value that is missing or none, or more than 1000 of them.

    Example:
        >>> limits_of(TomlTable(values={"limits": [{"kind": "fit", "at_least": 0.9}]}, where="test.toml"))[0].at_least
        0.9
    """
    tables = table.tables("limits", "limit")
    if len(tables) > FileLimits.MOST_LIMITS:
        raise InvalidDataError(f"{table.where} has {len(tables)} limits, at most {FileLimits.MOST_LIMITS} are weighed.")
    return tuple(map(_limit, tables))


def _limit(table: TomlTable) -> AcceptanceLimit:
    kind = table.word("kind", tuple(KEYS))
    table.refuse_others(("kind", "name", *KEYS[kind]))
    name = table.text("name", longest=FileLimits.LONGEST_NAME)
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


_KEYS = ("article", "operator", "place", "date", "notes", "geometry", "sensors", "limits")
_SENSOR_KEYS = ("channel", "kind", "maker", "model", "serial", "sensitivity", "calibrated", "dof", "note")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SensorNote:
    """What is known of one sensor or exciter; "" or None where the file does not say.

    Attributes:
        channel: name of its channel in the measured file.
        kind: e.g. "accelerometer".
        maker: who built it.
        model: type number.
        serial: serial number.
        sensitivity: as on its certificate, e.g. "100 mV/g"; it is shown, not applied: the record is in units already.
        calibrated: day of its last calibration.
        dof: node and direction as in the field, e.g. "12X+".
        note: anything else.
    """

    channel: str
    kind: str = ""
    maker: str = ""
    model: str = ""
    serial: str = ""
    sensitivity: str = ""
    calibrated: dt.date | None = None
    dof: str = ""
    note: str = ""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Specification(Displayed):
    """What the test file says; "" or None where it does not.

    Attributes:
        article: what was tested.
        operator: who tested it.
        place: where.
        date: when.
        notes: anything else a reader should know.
        sensors: one a channel, in the order of the file.
        geometry: nodes, lines and sensors.
        limits: conditions of acceptance, in the order of the file.

    Example:
        >>> Specification(article="frame", limits=()).article
        'frame'
    """

    article: str = ""
    operator: str = ""
    place: str = ""
    date: dt.date | None = None
    notes: str = ""
    sensors: tuple[SensorNote, ...] = ()
    geometry: Geometry | None = None
    limits: tuple[AcceptanceLimit, ...] = ()


def read_specification(path: str | Path) -> Specification:
    """What a test file says.

    Args:
        path: of a TOML file; a geometry file that it names is looked for beside it.

    Raises:
        UnreadableFileError: no such file, too large, no TOML, or no text.
        InvalidDataError: an unknown key, a value that is none, two notes on one channel.
    """
    path = Path(path)
    table = TomlTable(values=_parsed(path), where=quoted(path.name)[1:-1])
    table.refuse_others(_KEYS)
    return Specification(
        article=table.text("article"),
        operator=table.text("operator"),
        place=table.text("place"),
        date=table.day("date"),
        notes=table.text("notes"),
        sensors=_sensors(table),
        geometry=_geometry(table, path),
        limits=limits_of(table),
    )


def _parsed(path: Path) -> dict[str, object]:
    name = quoted(path)
    text = _text(path, name)
    try:
        return tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError, ValueError) as error:
        words = shorten(visible(str(error).rstrip(".")), FileLimits.LONGEST_NAME)
        raise UnreadableFileError(f"{name} is no TOML ({words}); mend that line.") from error


def _text(path: Path, name: str) -> str:
    try:
        if not path.is_file():
            raise UnreadableFileError(f"there is no file {name}; give the path of a test file (TOML).")
        if (size := path.stat().st_size) > MOST_TEXT:
            raise UnreadableFileError(
                f"{name} has {size} bytes, and a test file at most {MOST_TEXT}; is it the measured file?"
            )
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise UnreadableFileError(f"{name} cannot be read ({error.strerror or error}).") from error
    except UnicodeDecodeError as error:
        raise UnreadableFileError(
            f"{name} is no text in UTF-8; save it as such, or is it the measured file?"
        ) from error


def _sensors(table: TomlTable) -> tuple[SensorNote, ...]:
    notes = []
    for one in table.tables("sensors", "sensor"):
        one.refuse_others(_SENSOR_KEYS)
        texts = {key: one.text(key, longest=FileLimits.LONGEST_NAME) for key in _SENSOR_KEYS if key != "calibrated"}
        if not texts["channel"]:
            raise InvalidDataError(f"{one.where} needs channel, the name of its column in the measured file; add it.")
        notes.append(SensorNote(**texts, calibrated=one.day("calibrated")))
    channels = [note.channel for note in notes]
    twice = next((channel for channel in channels if channels.count(channel) > 1), None)
    if twice is not None:
        raise InvalidDataError(f"{table.where} has two sensors of channel {quoted(twice)}; keep one.")
    return tuple(notes)


def _geometry(table: TomlTable, path: Path) -> Geometry | None:
    if not table.has("geometry"):
        return None

    given = table.values["geometry"]
    if isinstance(given, str):
        return read_geometry(path.parent / given)
    if isinstance(given, dict):
        return geometry_of_table(given, f"[geometry] of {table.where}")
    raise InvalidDataError(
        f"geometry in {table.where} must be a table [geometry] or the name of a file, but is {quoted(given)}."
    )
