"""Names and units out of headers such as `tip [m/s^2]` or `Time (s)`: as files write them, and what they are in SI.

A unit that is known and measures a dimension is converted to SI. What is no such unit ("counts", "raw", "%") is kept as
it is written, and the conversion says so. Two spellings need a rule, because they mean two things:

* `g` (and `G`) is standard gravity, 9.80665 m/s^2, unless the channel's name speaks of a mass, force, thrust, weight or
  load: then it is the gram.
* `rpm` and `deg` are angles in time: they become rad/s and rad; `Hz` stays Hz.

A unit that a name writes otherwise than in brackets at its end (`acc_g_1`, `mm Weg`) is not read, but it is said.
"""

import functools
import math
import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from okid.arrays import ROUNDED, FloatArray
from okid.errors import UnreadableFileError
from okid.readers.guard import first_line

STANDARD_GRAVITY = 9.80665

SI_UNITS = frozenset(
    ["s", "m", "m/s", "m/s^2", "N", "N m", "Pa", "kg", "rad", "rad/s", "rad/s^2", "Hz", "V", "A", "K", "W", "J", "N/m"]
)
"""Units that need no conversion: a file with no others does not cost the import of the units library."""

SI_NAMES = {
    "kg*m/s**2": "N",
    "kg/m/s**2": "Pa",
    "kg*m**2/s**2": "J",
    "kg*m**2/s**3": "W",
    "kg*m**2/A/s**3": "V",
    "A*s": "C",
    "kg*m**2/A**2/s**3": "ohm",
    "kg/s**2": "N/m",
}
"""Coherent SI units in base units, and the name an engineer gives them."""

SPELLINGS = {
    **dict.fromkeys(("rpm", "RPM", "Rpm", "r/min", "rev/min", "revs/min", "U/min", "Upm", "tr/min", "tr/mn"), "rpm"),
    **dict.fromkeys(("t/min", "tours/min", "r·p·m", "r·p·m."), "rpm"),
    **dict.fromkeys(("rps", "rev/s", "tr/s", "U/s"), "revolution/s"),
    **dict.fromkeys(("ips", "IPS"), "inch/s"),
    **dict.fromkeys(("in", "in.", "inches", '"'), "inch"),
    **dict.fromkeys(("mil", "mils"), "thou"),
    **dict.fromkeys(("gf", "grf", "gram·force", "grams·force"), "force_gram"),
    **dict.fromkeys(("kp", "kgf", "kg·force", "kg·f"), "force_kilogram"),
    **dict.fromkeys(("pound·force", "lb·f"), "force_pound"),
    **dict.fromkeys(("kips", "klbf"), "kip"),
    "tf": "force_metric_ton",
    "ozf": "force_ounce",
    **{
        dot.join(pair): f"{length}*force_{'ounce' if word[0] == 'o' else 'pound'}"
        for short, length in (("in", "inch"), ("ft", "foot"))
        for word in ("lb", "lbs", "lbf", "oz", "ozf")
        for pair in ((short, word), (word, short))
        for dot in ("·", "")
    },
    **dict.fromkeys(("kgf·m", "kgfm", "kp·m", "kpm"), "force_kilogram*meter"),
    **dict.fromkeys(("kgf·cm", "kgfcm"), "force_kilogram*centimeter"),
    "Ncm": "newton*centimeter",
    "mNm": "millinewton*meter",
    **dict.fromkeys(("dps", "DPS"), "degree/s"),
    **dict.fromkeys(("°", "º", "Deg", "DEG", "Grad", "degrees", "grados", "degrés", "gradi"), "degree"),
    **dict.fromkeys(("°C", "ºC", "deg·C", "Celsius", "Grad·C"), "degC"),
    **dict.fromkeys(("°F", "ºF", "deg·F", "Fahrenheit"), "degF"),
    **dict.fromkeys(("ms·2", "ms-2", "ms^-2", "mps2", "m/s/s", "ms2", "mss"), "m/s**2"),
    **dict.fromkeys(("mps", "ms-1", "ms^-1"), "m/s"),
    "fps": "foot/s",
    "fpm": "foot/min",
    "lpm": "liter/min",
    "HP": "hp",
    **dict.fromkeys(("Millimeter", "millimeter", "millimeters"), "millimeter"),
    **dict.fromkeys(("tonne", "tonnes"), "t"),
    **dict.fromkeys(("kmh", "kph", "km/hr"), "km/h"),
    **dict.fromkeys(("MPH",), "mile/hour"),
    "gal": "Gal",
    **dict.fromkeys(("PS", "ch"), "metric_horsepower"),
    **dict.fromkeys(("kt", "kts", "knots"), "knot"),
    "'": "foot",
    **dict.fromkeys(("newtons", "Newton", "Newtons"), "newton"),
    **dict.fromkeys(("Volt", "Volts", "volts"), "volt"),
    **dict.fromkeys(("Amp", "Amps", "amps", "Ampere", "amperes"), "ampere"),
    **dict.fromkeys(("Watt", "Watts", "watts"), "watt"),
    **dict.fromkeys(("grams", "grammes", "Gramm"), "gram"),
    **dict.fromkeys(("microns", "Mikrometer"), "micrometer"),
    "Bar": "bar",
    "PSI": "psi",
    **dict.fromkeys(("metre", "metres", "meters"), "meter"),
    **dict.fromkeys(("kilonewton", "kilonewtons"), "kN"),
    "KN": "kN",
    "KPa": "kPa",
}
"""What test stands, loggers and other languages write, as the units library knows it."""

UNITS = frozenset(
    prefix + unit
    for unit, prefixes in {
        "m": "n u µ m c d k",
        "s": "n u µ m",
        "N": "m da k M",
        "Pa": "u µ m h k M G",
        "V": "n u µ m k",
        "A": "n u µ m k",
        "W": "u µ m k M",
        "J": "m k M",
        "Hz": "m k M G",
        "rad": "u µ m",
        "g": "u µ m k",
        "Nm": "k",
        "Nmm": "",
        "bar": "m",
        "Gal": "m",
        "ohm": "m k M",
        "Ohm": "m k M",
        "Ω": "m k M",
        "Wh": "m k",
        **dict.fromkeys(("sec", "min", "hr", "h", "second", "seconds", "minute", "minutes", "hour", "hours", "d"), ""),
        **dict.fromkeys(("msec", "usec", "µsec", "milliseconds", "microseconds", "nanoseconds"), ""),
        **dict.fromkeys(("inch", "ft", "foot", "feet", "thou", "mile", "miles", "micron", "micrometer", "meter"), ""),
        **dict.fromkeys(("lbf", "kip", "psi", "ksi", "atm", "mmHg", "mph", "knot", "t", "slug", "slugs"), ""),
        **dict.fromkeys(("deg", "degree", "arcmin", "arcsec", "arcseconds", "rev", "turn", "revolution"), ""),
        **dict.fromkeys(("degC", "degF", "K", "l", "L", "hp", "newton", "volt", "ampere", "watt", "gram"), ""),
    }.items()
    for prefix in ("", *prefixes.split())
) | frozenset(word for text in SPELLINGS.values() for word in re.findall(r"[A-Za-z_]+", text))
"""Read what is made of these alone: the units library knows so many more that any word is one (cts, EU, %rH)."""

UNIT_SIZES = {
    (("revolutions per minute", "rad/s"),): 2.0 * math.pi / 60.0,
    (("g", "m/s^2"), ("kilogram-force", "newton")): STANDARD_GRAVITY,
    (("a thousandth (mm, mV, gram)", "the unit itself"),): 1e-3,
    (("inches", "millimetres"),): 25.4,
    (("pound-force", "newton"),): 0.45359237 * STANDARD_GRAVITY,
    (("degrees", "radians"),): math.pi / 180.0,
}
"""Name an error of units by what was taken for what, the first being so many times the second."""

WIDEST_GAIN = 1e4
"""Expect gains up to this factor either way: the widest of the candidates and as much again."""

SHORTENED = 5e-4
"""Take a factor for one of these within so much of itself: 9.81 for 9.80665."""

CHANCE = 0.05
"""Name no error of units where chance alone would find one so often."""

POUNDS = {"lb": "force_pound", "lbs": "force_pound", "oz": "force_ounce"}
"""Read these as a force or as a mass only where the name speaks of one."""

GRAVITIES = frozenset(["g", "mg", "ug", "µg", "G"])
"""Leave what is made with one of these, gram or gravity, as it is where the name does not speak of a mass."""

PER_MINUTE = frozenset(["1/min", "min-1", "min^-1", "/min"])
"""Read these as revolutions per minute where the name speaks of a rotation."""

ORDINARY = frozenset(
    [
        "min",
        "minute",
        "minutes",
        "sec",
        "second",
        "seconds",
        "hour",
        "hours",
        "ns",
        "rad",
        "rev",
        "turn",
        "foot",
        "feet",
    ]
)
"""Take these for words of a name where they stand in it without brackets, in any case of letters."""

UNKNOWN = "is not a unit that converts to SI; kept as it is"
A_MASS = "a mass, though the name speaks of a force; write kgf if it is one"
NO_KNOT = "may be kilonewton or knots, and the name does not tell which; kept as it is"
TWO_MEANINGS = "may be a mass, a force or an acceleration, and the name does not tell which; kept as it is"
_FORCE_WORDS = re.compile(
    r"force|thrust|kraft|schub|pouss|effort|last\b|load|hammer|marteau|impact|shaker|empuje|fuerza", re.IGNORECASE
)
_WEIGHT_WORDS = re.compile(r"mass|weight|gewicht|poids|peso", re.IGNORECASE)
_MASS_WORDS = re.compile(
    r"mass|weight|(?<!\bg[ _-])force|thrust|load|gram|kraft|schub|gewicht|last\b|pouss|poids|effort|empuje|fuerza|peso",
    re.IGNORECASE,
)
_ACCELERATION_WORDS = re.compile(r"acc|beschl|a[xyz_ ]|\bah\b|quake|ground", re.IGNORECASE)
_TEMPERATURE_WORDS = re.compile(r"temp|hitze|chaleur", re.IGNORECASE)
_SPEED_WORDS = re.compile(r"speed|veloc|vitesse|geschw|fahrt|wind|current", re.IGNORECASE)
_ROTATION_WORDS = re.compile(
    r"speed|dreh|rpm|rotat|spin|vitesse|régime|regime|motor|shaft|omega|\bn(_|$)", re.IGNORECASE
)
_LENGTH_WORDS = re.compile(r"disp|stroke|travel|lvdt|weg\b|pos|length|hub\b|height", re.IGNORECASE)
_PRESSURE_WORDS = re.compile(r"druck|press|presi|oil|öl|tank|hydr|\bp\d*(?![^\W_])", re.IGNORECASE)
_ANGLE_WORDS = re.compile(r"wink|angle|angul|ángul|pos|dreh|rot", re.IGNORECASE)
_POWER_WORDS = re.compile(r"power|leist|puiss|poten", re.IGNORECASE)
_WORDS_OF_UNITS = frozenset([*UNITS, *SPELLINGS, *POUNDS])
_FOLDED = frozenset(word.lower() for word in _WORDS_OF_UNITS)
_SPOKEN_OF = {
    **dict.fromkeys(("N", "kp"), _FORCE_WORDS),
    **dict.fromkeys(("C", "F"), _TEMPERATURE_WORDS),
    **dict.fromkeys(("in", "ft"), _LENGTH_WORDS),
    **dict.fromkeys(("G", "gal"), _ACCELERATION_WORDS),
    **dict.fromkeys(("hp", "ps", "ch"), _POWER_WORDS),
    "bar": _PRESSURE_WORDS,
    "grad": _ANGLE_WORDS,
}
"""Take these at the end of a name for a unit only where the name speaks of what they measure."""
_NO_PART_OF_A_UNIT = re.compile(r"[^\w/^°%·⋅∙•*.+−-]+")
_LEVEL = re.compile(r"[\s_]+(?:rms|eff|pp|pk|peak|(?:pk|p|0)-(?:pk|p))$", re.IGNORECASE)
_INDEX_BEHIND = re.compile(r"^(.*[^\W\d])[\s_.]+\d+$|^(.*[^\W_][\s_.]+[^\W\d]+)[\s_.]+[xyzXYZ]$")  # acc_g_1, acc_g_x
_INNER_WORD = re.compile(r"(?<=[a-zß-ÿ]{2})(?=[A-Z])")
_LETTERS = re.compile(r"([^\W\d_]+|°[CF]?)\d*")
_TAILS = (
    re.compile(r"\s(?:in|en)\s+(\S+(?: \S+)?)$"),
    re.compile(r"\s/\s*(\S+)$"),
    re.compile(r"^[^\W\d]\w*/([^\W\d_]+)$"),
    re.compile(r"\s(\S*[/^²³]\S*)$"),
)
"""Where a name may end in a unit without brackets: "Weg in mm", "a / m/s²", "Kraft/N", "Vibration mm/s"."""
_INSIDE = re.compile(r"[\[({<]([^\[\](){}<>]*)[\])}>]")
_SIGNS = str.maketrans(dict.fromkeys("⋅∙•*", "·") | {"μ": "µ", "−": "-"})
_WIDE_BRACKETS = str.maketrans("（）［］｛｝【】〔〕＜＞", "()[]{}[][]<>")
_DOT = re.compile(r"(?<=[A-Za-z])(?:[.-]| *· *| +)(?=[A-Za-z])")
_WORD = re.compile(r"[^\W\d_]+|[°%\"']")
_MAGNET_WORDS = re.compile(r"magnet|flux|field|gauss", re.IGNORECASE)
_GRAVITY = re.compile(r"(m|milli|µ|u)?(?:g|G|gn|g_0|g0|gee)$")
_BIG_NUMBER = re.compile(r"\d{3,}|\d\s*\^|[a-zA-Z]\^?-?\d{2,}")  # no text can ask for 9^9^9^9
_BARE_POWER = re.compile(r"(?<=[A-Za-z])(-?\d)(?!\d)")


@dataclass(frozen=True, slots=True, kw_only=True)
class UnitConversion:
    """What became of one channel's unit: SI value = factor * value in the file + offset.

    Args:
        channel: name of the channel.
        written: unit as the file writes it, "" if it writes none.
        unit: unit of the record's values.
        factor: SI units in one unit of the file.
        offset: added after the factor; only temperatures have one.
        note: why, where a rule had to decide or the unit was kept.
    """

    channel: str
    written: str
    unit: str
    factor: float = 1.0
    offset: float = 0.0
    note: str = ""

    @property
    def changed(self) -> bool:
        """True if the record's numbers are not those of the file."""
        return self.factor != 1.0 or self.offset != 0.0

    @property
    def doubtful(self) -> bool:
        """True if the numbers may be in another unit than the record's: it was not read, or the name gainsays it."""
        if self.note == UNKNOWN:
            return not looks_like_unit(self.written.strip())
        return bool(self.note) and (not self.unit or self.note in {TWO_MEANINGS, NO_KNOT, A_MASS})

    def __str__(self) -> str:
        if self.changed:
            shift = f" plus {self.offset:.6g}" if self.offset else ""
            words = f"{self.written} -> {self.unit}, times {self.factor:.6g}{shift}"
        elif self.note in {UNKNOWN, TWO_MEANINGS, NO_KNOT}:
            return f"{self.channel}: {self.written!r} {self.note}"
        else:
            words = self.unit or "no unit in the file"
        return f"{self.channel}: {words}" + (f" ({self.note})" if self.note else "")


def convert_unit(channel: str, written: str) -> UnitConversion:
    """The conversion of one channel's unit to SI.

    Args:
        channel: name of the channel; it decides what `g` means.
        written: unit as written in the file.

    Example:
        >>> print(convert_unit("tip", "g"))
        tip: g -> m/s^2, times 9.80665 (g read as standard gravity)
        >>> print(convert_unit("command", "counts"))
        command: 'counts' is not a unit that converts to SI; kept as it is
    """
    text = written.strip()
    if text in SI_UNITS or text in {"", "-", "1"}:
        unit = text if text in SI_UNITS else ""
        note = _unread_unit(channel) if not text else A_MASS if _is_no_mass(channel, unit) else ""
        return UnitConversion(channel=channel, written=written, unit=unit, note=note)
    spelt, note = _meaning(channel, text)
    linear = _linear(spelt, text) if spelt else None
    if linear is None:
        return UnitConversion(channel=channel, written=written, unit=text, note=UNKNOWN if spelt else note)
    factor, offset, unit = linear
    note = note or (A_MASS if _is_no_mass(channel, unit) else "")
    return UnitConversion(channel=channel, written=written, unit=unit, factor=factor, offset=offset, note=note)


def _is_no_mass(channel: str, unit: str) -> bool:
    """True for a mass under a name that speaks of a force and of no mass."""
    return unit == "kg" and _FORCE_WORDS.search(channel) is not None and _WEIGHT_WORDS.search(channel) is None


def in_si(values: FloatArray, conversions: Sequence[UnitConversion]) -> FloatArray:
    """The values in SI; the array itself where nothing has to be converted, so that a mapped file stays mapped."""
    if not any(conversion.changed for conversion in conversions):
        return values
    with np.errstate(all="ignore"):  # what is not finite is refused by name
        converted = np.multiply(values, [conversion.factor for conversion in conversions])
        converted += [conversion.offset for conversion in conversions]
    converted.flags.writeable = False  # fresh and held by nobody else: the record need not copy it
    return converted


def _meaning(channel: str, text: str) -> tuple[str, str]:
    """How the units library spells a unit, and what was decided; no spelling and the reason where it is kept."""
    plain = _plain(text)
    if plain == "kn" or plain in POUNDS:
        return _pounds_or_knots(channel, text, plain)
    if plain in PER_MINUTE and _ROTATION_WORDS.search(channel):
        return "rpm", f"{text} read as revolutions per minute, because the name speaks of a rotation"
    if plain in {"C", "F"} and _TEMPERATURE_WORDS.search(channel):
        return f"deg{text}", f"{text} read as deg{text}, because the name speaks of a temperature"
    if not _is_alone(channel, plain):
        return "", UNKNOWN
    if _GRAVITY.match(plain) or GRAVITIES.intersection(_WORD.findall(plain)):
        return _gram_or_gravity(channel, text, plain)
    return plain, f"{text} read as a thousandth of an inch" if plain in {"mil", "mils"} else ""


def _pounds_or_knots(channel: str, text: str, plain: str) -> tuple[str, str]:
    forced = _FORCE_WORDS.search(channel) is not None
    if plain == "kn":
        words = "kn read as kilonewton, because the name speaks of a force"
        return ("kN", words) if forced else ("knot", "") if _SPEED_WORDS.search(channel) else ("", NO_KNOT)
    mass = POUNDS[plain].removeprefix("force_")
    if forced:
        return POUNDS[plain], f"{text} read as {mass}-force, because the name speaks of a force"
    return (mass, "") if _WEIGHT_WORDS.search(channel) else ("", TWO_MEANINGS)


def _is_alone(channel: str, plain: str) -> bool:
    """True for a unit that is no other in this channel: gauss, gallons, or beats where nothing turns."""
    if plain in PER_MINUTE or (plain == "G" and _MAGNET_WORDS.search(channel)):
        return False
    if "gal" in _WORD.findall(plain) and not _ACCELERATION_WORDS.search(channel):
        return False
    return is_unit(plain) or _GRAVITY.match(plain) is not None


def _gram_or_gravity(channel: str, text: str, plain: str) -> tuple[str, str]:
    gravity = _GRAVITY.match(plain)
    if _MASS_WORDS.search(channel):
        words = f"{text} read as gram, because the name speaks of a mass or force"
        return (plain.lower(), words) if gravity else (plain, "")
    if gravity:
        return f"{gravity[1] or ''}gravity", f"{text} read as standard gravity"
    return "", TWO_MEANINGS  # g/s, mV/g, g^2/Hz


def unit_error(gain: float, std: float) -> str:
    """What a gain looks like that a forgotten conversion of units makes, in words; "" where it may be chance.

    The gain is what a channel is over what its numbers say.

    A gain between 1e-4 and 1e4 that is as likely at one power of ten as at another lies within two deviations of one of
    the n candidates with the probability n 4 (std / gain) / (2 ln 1e4). Only where that is small does closeness mean
    anything.

    Example:
        >>> unit_error(9.79, 0.02)
        'g taken for m/s^2 or kilogram-force taken for newton, a factor of 9.80665'
        >>> unit_error(9.79, 0.5), unit_error(1.02, 0.001)
        ('', '')
    """
    size = abs(gain)
    candidates = [(power * math.log(factor), power, pairs) for pairs, factor in UNIT_SIZES.items() for power in (1, -1)]
    if not size or not math.isfinite(size) or not 0.0 < std < math.inf:
        return ""
    chance = len(candidates) * 4.0 * (std / size) / (2.0 * math.log(WIDEST_GAIN))
    near = min(candidates, key=lambda one: abs(math.log(size) - one[0]))
    if abs(math.log(size) - near[0]) > 2.0 * std / size + SHORTENED or chance > CHANCE:
        return ""
    exponent, power, pairs = near
    words = " or ".join(f"{what} taken for {meant}" for what, meant in (pair[::power] for pair in pairs))
    return f"{words}, a factor of {math.exp(abs(exponent)):.6g}"


def with_unit(name: str, unit: str | None, *, stays: bool) -> str:
    """A name with a unit that stands elsewhere; its own in brackets stays where asked for, and where that is none."""
    own = split_header(name)[1]
    kept = unit is None or own == unit or ((stays or not unit) and looks_like_unit(own))
    return name if kept else f"{name} [{unit}]"


def one_time(spans: FloatArray, within: float) -> bool:
    """Whether two columns of so long spans may be one time in two units."""
    short, long = float(spans.min()), float(spans.max())
    return any(abs(long - short * size) <= within * short * size for size in (1, 60, 3600, 10**3, 10**6, 10**9))


def _unread_unit(channel: str) -> str:
    """What a reader must know where a name without a unit begins or ends in one.

    A word of two letters and more that is a unit, in capitals or not, may be one; so may a `g` that is set off. Other
    single letters name sensors more often, and some words have another meaning: they must fit what the name speaks of.
    """
    inside = [text for text in _INSIDE.findall(channel) if is_unit(text)]
    if inside:
        return (
            f"{inside[0]!r} stands within the name; if it is the unit, write it last: the values are kept as they are"
        )
    name = _LEVEL.sub("", _NO_PART_OF_A_UNIT.sub(" ", channel).strip())
    stem = _INDEX_BEHIND.sub(r"\1\2", name)
    tails = [found[1] for tail in _TAILS for text in (stem, name) if (found := tail.search(text))]
    written = next((text for text in tails if looks_like_unit(text) or text in PER_MINUTE), "")
    words = re.findall(r"[^\W_]+|°[CF]?", stem)
    last = [words[-1], _INNER_WORD.split(words[-1])[-1]] if words else []
    written = written or next((word for word in last if _may_be_unit(word, channel)), "")
    place = "ends in" if written else "begins with"
    first = words[0] if len(words) > 1 else ""
    if not written and len(first) > 1 and first in _WORDS_OF_UNITS and _may_be_unit(first, ""):
        written = first
    if not written:
        return ""
    return f"the name {place} {written!r}; if that is the unit, write it in brackets: the values are kept as they are"


def _may_be_unit(word: str, channel: str) -> bool:
    """True for a unit in words or letters, whatever number stands behind it, that is no ordinary word in this name."""
    found = _LETTERS.fullmatch(word)
    letters = found[1] if found else ""
    folded = letters if len(letters) == 1 else letters.lower()
    if folded in _SPOKEN_OF:
        set_off = word == letters or len(letters) > 1 or letters == "G"  # motor_temp C1 is a place
        return set_off and _SPOKEN_OF[folded].search(channel) is not None
    if letters == "g":
        return word == letters or _ACCELERATION_WORDS.search(channel) is not None
    return (len(letters) > 1 or letters == "°") and folded not in ORDINARY and folded in _FOLDED


def is_unit(text: str) -> bool:
    """True for a unit of a channel, or a product, quotient or power of such units.

    Example:
        >>> is_unit("m/s²"), is_unit("N-m"), is_unit("cts"), is_unit("%rF")
        (True, True, False, False)
    """
    plain = _plain(text)
    if plain in SPELLINGS:
        return True
    words = _WORD.findall(plain)
    rest = _WORD.sub("", plain)
    return (
        bool(words)
        and len(plain) <= 40
        and all(word in UNITS or word in SPELLINGS for word in words)
        and not re.search(r"[^-+.·*/^() \d]", rest)
        and not _BIG_NUMBER.search(plain)
    )


_BRACKET = re.compile(
    r"^(?P<name>.*?)\s*(?:\[(?P<unit>[^\[\]]*)\]|\{(?P<curly>[^{}]*)\}|<(?P<angle>[^<>]*)>)\s*$", re.DOTALL
)
_INDEX = re.compile(r"(?:\S\[\d+|\[(?:0|[2-9]|\d\d+))\]$")
"""Read a whole number in brackets as the place in an array, `gyro[0]`; `ratio [1]` alone has no dimension."""
PARENTHESIS = re.compile(r"^(?P<name>.*?)\s*\((?P<unit>(?:[^()]|\([^()]*\))*)\)\s*$", re.DOTALL)
_OTHER_UNITS = frozenset(
    [
        *("g", "mg", "gn", "lb", "lbs", "oz", "G", "kg", "mAh", "C", "F", "kn", "ton", "tons", "klb", "klbs"),
        *("counts", "count", "raw", "digits", "lsb", "LSB", "-", "%", "a.u.", "1/min", "min-1"),
        *("mG", "ue", "µe", "µε", "ustrain", "microstrain", "milli-g"),
    ]
)
"""What else a pair of parentheses may hold to be read as a unit; what converts to SI is known already."""

_SIDES = frozenset(["L", "l", "t", "d", "U/s"])
"""Left, a time, a day: in parentheses these are no litre and no tonne."""

MAX_NAME = 200


def split_header(header: str) -> tuple[str, str]:
    """Name and unit of a column header; the unit is "" if there is none.

    What stands in square brackets is a unit, unless it is the place in an array, as in "gyro[0]". What stands in
    parentheses is one only if it is made of common units, so that "tip (left)" stays a name.

    Example:
        >>> split_header("tip [m/s^2]"), split_header("Time (s)"), split_header("tip (left)")
        (('tip', 'm/s^2'), ('Time', 's'), ('tip (left)', ''))
    """
    header = "".join(letter if letter.isprintable() else " " for letter in header).strip()
    plain = header.translate(_WIDE_BRACKETS)
    match = _BRACKET.match(plain)
    if match and match["name"] and not _INDEX.search(header):
        unit = match["unit"] or match["curly"] or match["angle"] or ""
        return match["name"][:MAX_NAME], unit.strip()[:MAX_NAME]
    match = PARENTHESIS.match(plain)
    if match and match["name"] not in {"", "dB"} and looks_like_unit(match["unit"].strip()):
        return match["name"][:MAX_NAME], match["unit"].strip()
    return header[:MAX_NAME], ""


def looks_like_unit(text: str) -> bool:
    """True if `text` is a common unit, or a product, quotient or power of common units."""
    return text in _OTHER_UNITS or (text not in _SIDES and is_unit(text))


def _plain(text: str) -> str:
    """One spelling of what is printed in several: powers as m/s2, products with a dot in the middle."""
    text = unicodedata.normalize("NFKC", text.strip().replace("º", "°")).replace("**", "^").translate(_SIGNS)
    return _DOT.sub("·", text)


@functools.cache
def _registry() -> Any:
    try:
        import pint

        registry: Any = pint.UnitRegistry()
    except Exception as error:  # a version that does not work with another library: no unit would be known
        raise UnreadableFileError(
            f"units cannot be read, because the library pint does not work here ({first_line(error)}); run: pip "
            "install --upgrade pint."
        ) from error
    registry.define("Nm = newton * meter")
    registry.define("Nmm = newton * millimeter")
    registry.define("Ns = newton * second")
    registry.define("@alias turn = rev")
    registry.define("@alias ohm = Ohm")
    return registry


@functools.cache
def _parsed(text: str) -> Any:
    """The unit as pint knows it, None if it does not; "m/s2" and "m s-2" are read as powers."""
    text = SPELLINGS.get(text) or _WORD.sub(lambda word: SPELLINGS.get(word[0], word[0]), text).replace("·", "*")
    registry = _registry()
    for spelling in (text, _BARE_POWER.sub(r"^\1", text)):
        try:
            return registry.parse_units(spelling)
        except Exception:  # noqa: BLE001, S112 - pint raises many kinds for text that is no unit; all mean "unknown"
            continue
    return None


def _linear(spelt: str, written: str) -> tuple[float, float, str] | None:
    """Factor, offset and SI unit; None for what measures no dimension (counts, %) or is not linear (dB)."""
    if spelt.endswith("gravity"):  # does not cost the import of the units library
        return {"": 1.0, "m": 1e-3, "milli": 1e-3}.get(spelt[:-7], 1e-6) * STANDARD_GRAVITY, 0.0, "m/s^2"
    parsed = _parsed(spelt)
    if parsed is None:
        return None
    quantity = _registry().Quantity
    try:
        zero, one, two = (quantity(value, parsed).to_base_units() for value in (0.0, 1.0, 2.0))
    except Exception:  # noqa: BLE001 - a logarithm within a product (dB(A)) has a name that the library cannot reduce
        return None
    base = f"{one.units:~C}"
    if base in {"", "count"} or abs(two.magnitude - 2 * one.magnitude + zero.magnitude) > ROUNDED * abs(two.magnitude):
        return None
    offset = float(zero.magnitude)
    factor = float(one.magnitude) - offset
    if offset:  # the difference of two temperatures has lost digits: 1.0 must stay 1.0
        factor = float(f"{factor:.12g}")
    unit = _si_name(base, str(parsed))
    if (factor, offset) == (1.0, 0.0) and unit not in SI_UNITS:
        unit = written  # already coherent, and the engineer's own spelling is the shorter one
    return factor, offset, unit


def _si_name(base: str, parsed: str) -> str:
    if base == "1/s" and "hertz" in parsed:
        return "Hz"
    if SI_NAMES.get(base) == "J" and ("*" in parsed or parsed.endswith(("Nm", "Nmm"))):
        return "N m"  # a torque: written as a product of force and length
    return SI_NAMES.get(base, base.replace("**", "^").replace("*", " "))
