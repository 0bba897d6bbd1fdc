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
"""

import datetime as dt
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from modal.acceptance.limits import LONGEST_NAME, AcceptanceLimit, TomlTable, limits_of
from modal.geometry.file import MOST_TEXT, geometry_of_table, read_geometry
from modal.geometry.sensors import quoted
from modal.wording.names import shorten, visible
from okid.display import Displayed
from okid.errors import InvalidDataError, UnreadableFileError

if TYPE_CHECKING:
    from modal.geometry.sensors import Geometry

__all__ = ["SensorNote", "Specification", "read_specification"]

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
    geometry: "Geometry | None" = None
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
        words = shorten(visible(str(error).rstrip(".")), LONGEST_NAME)
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
        texts = {key: one.text(key, longest=LONGEST_NAME) for key in _SENSOR_KEYS if key != "calibrated"}
        if not texts["channel"]:
            raise InvalidDataError(f"{one.where} needs channel, the name of its column in the measured file; add it.")
        notes.append(SensorNote(**texts, calibrated=one.day("calibrated")))
    channels = [note.channel for note in notes]
    twice = next((channel for channel in channels if channels.count(channel) > 1), None)
    if twice is not None:
        raise InvalidDataError(f"{table.where} has two sensors of channel {quoted(twice)}; keep one.")
    return tuple(notes)


def _geometry(table: TomlTable, path: Path) -> "Geometry | None":
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
