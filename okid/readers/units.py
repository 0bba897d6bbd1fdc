"""Units as files write them, and what they are in SI.

A unit that is known and measures a dimension is converted to SI. What is no such unit ("counts", "raw", "%") is kept as
it is written, and the conversion says so. Two spellings need a rule, because they mean two things:

* `g` (and `G`) is standard gravity, 9.80665 m/s^2, unless the channel's name speaks of a mass, force, thrust, weight or
  load: then it is the gram.
* `rpm` and `deg` are angles in time: they become rad/s and rad; `Hz` stays Hz.
"""

import functools
import math
import re
from dataclasses import dataclass
from typing import Any

from okid.errors import UnreadableFileError
from okid.readers.guard import first_line

__all__ = ["UnitConversion", "convert_unit", "unit_error"]

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
    **dict.fromkeys(("RPM", "Rpm", "r/min", "rev/min", "U/min", "tr/min", "t/min"), "rpm"),
    **dict.fromkeys(("ips", "IPS", "in/sec"), "inch/s"),
    **dict.fromkeys(("mil", "mils", "thou"), "thou"),
    **dict.fromkeys(("gf", "grf", "gram-force", "gram force"), "force_gram"),
    **dict.fromkeys(("kp", "kgf", "kg-force"), "force_kilogram"),
    **dict.fromkeys(("in-lb", "in-lbf", "in·lb", "in lb", "lb-in", "lbf-in", "lbf·in", "lbf in"), "inch*force_pound"),
    **dict.fromkeys(("ft-lb", "ft-lbf", "ft·lb", "ft lb", "lb-ft", "lbf-ft", "lbf·ft", "lb ft"), "foot*force_pound"),
    **dict.fromkeys(("ozf-in", "oz-in", "ozf·in", "oz·in", "oz in", "in-oz"), "inch*force_ounce"),
    **dict.fromkeys(("dps", "DPS", "º/s"), "degree/s"),
    **dict.fromkeys(("º", "Deg", "DEG", "Grad"), "degree"),
    **dict.fromkeys(("ºC", "deg C", "Celsius"), "degC"),
    **dict.fromkeys(("ms-2", "ms^-2", "ms⁻²", "mps2", "m/s/s"), "m/s**2"),
    **dict.fromkeys(("mps", "ms-1", "ms^-1", "ms⁻¹"), "m/s"),
    "gal": "Gal",
    **dict.fromkeys(("PS", "ch"), "metric_horsepower"),
    **dict.fromkeys(("kn", "kt", "kts", "knots"), "knot"),
    '"': "inch",
    "'": "foot",
}
"""What test stands, loggers and other languages write, as the units library knows it."""

UNIT_FACTORS = {
    60.0 / (2.0 * math.pi): "revolutions per minute taken for rad/s",
    STANDARD_GRAVITY: "g taken for m/s^2, or kilogram-force for newton",
    9.81: "g taken for m/s^2, or kilogram-force for newton",
    1000.0: "a thousandth (mm, mV, gram) taken for the unit itself",
    25.4: "inches taken for millimetres",
    0.45359237 * STANDARD_GRAVITY: "pound-force taken for newton",
    180.0 / math.pi: "degrees taken for radians",
}
"""Name a gain of this size, or of its inverse, as an error of units."""

WIDEST_GAIN = 1e4
"""Expect gains up to this factor either way: the widest of the candidates and as much again."""

CHANCE = 0.05
"""Name no error of units where chance alone would find one so often."""

PER_MINUTE = frozenset(["1/min", "min-1", "min^-1", "/min"])
"""Read these as revolutions per minute where the name speaks of a rotation."""

SCALED = frozenset(
    [
        *("rpm", "gf", "kgf", "lbf", "lbs", "kip", "kN", "mN", "mm", "cm", "um", "µm", "mil", "mils", "inch", "ips"),
        *(
            "deg",
            "dps",
            "ms",
            "us",
            "mV",
            "mA",
            "psi",
            "ksi",
            "bar",
            "kPa",
            "MPa",
            "degC",
            "kHz",
            "mg",
            "g",
            "kW",
            "Nmm",
        ),
    ]
)
"""Say so where a name ends in one of these without brackets: the values are not converted."""

NO_UNITS = frozenset(["ue", "uE", "µE", "mE", "U", "R", "pC/N", "C", "a.u.", "au", "AU", "e", "E", "M"])
"""Keep these as they are written: to the units library they are electrons, mol, astronomical units or coulombs."""

UNKNOWN = "is not a unit that converts to SI; kept as it is"
_FORCE_WORDS = re.compile(r"force|thrust|kraft|schub|pouss|effort|last\b|load", re.IGNORECASE)
_MASS_WORDS = re.compile(
    r"mass|weight|force|thrust|load|gram|kraft|schub|gewicht|last\b|pouss|poids|effort|empuje|fuerza|peso",
    re.IGNORECASE,
)
_ACCELERATION_WORDS = re.compile(r"acc|beschl|a[xyz_ ]|\bah\b|quake|ground", re.IGNORECASE)
_TEMPERATURE_WORDS = re.compile(r"temp|hitze|chaleur", re.IGNORECASE)
_ROTATION_WORDS = re.compile(r"speed|drehzahl|rpm|rotat|spin|vitesse|régime|regime|motor|shaft|omega", re.IGNORECASE)
_LAST_WORD = re.compile(r"[\s_,;/](\w+)\W*$")
_MAGNET_WORDS = re.compile(r"magnet|flux|field|gauss", re.IGNORECASE)
_GRAVITY = re.compile(r"(m|milli|µ|u)?(?:g|G|gn|g_0|g0|gee)$")
_GRAVITY_PREFIX = {"": 1.0, "m": 1e-3, "milli": 1e-3, "µ": 1e-6, "u": 1e-6}
# Letters, signs of units, small numbers; a number raised to a power is refused, so that no text can ask for 9^9^9^9.
_UNIT_TEXT = re.compile(r"[A-Za-zµμΩ°%_ ·⋅*/^()\-.0-9²³⁻¹]{1,40}")
_BIG_NUMBER = re.compile(r"\d{3,}|\d\s*(?:\^|\*\*)")
_PEAK = re.compile(r"\s(?:pp|pk|p-p|pk-pk|peak|rms|eff|0-p)\b", re.IGNORECASE)
_BARE_POWER = re.compile(r"(?<=[sm])(-?\d)(?!\d)")


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

    def __str__(self) -> str:
        if self.changed:
            shift = f" plus {self.offset:.6g}" if self.offset else ""
            words = f"{self.written} -> {self.unit}, times {self.factor:.6g}{shift}"
        elif self.note == UNKNOWN:
            return f"{self.channel}: {self.written!r} {UNKNOWN}"
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
        return UnitConversion(channel=channel, written=written, unit=unit, note="" if text else _unread_unit(channel))
    gravity = _GRAVITY.match(text)
    if text == "G" and _MAGNET_WORDS.search(channel):
        return UnitConversion(channel=channel, written=written, unit=text, note=UNKNOWN)
    if text == "gal" and not _ACCELERATION_WORDS.search(channel):  # a gallon, or cm/s^2 as seismologists write it
        return UnitConversion(channel=channel, written=written, unit=text, note=UNKNOWN)
    if gravity and not _MASS_WORDS.search(channel):
        factor = STANDARD_GRAVITY * _GRAVITY_PREFIX[gravity[1] or ""]
        note = f"{text} read as standard gravity"
        return UnitConversion(channel=channel, written=written, unit="m/s^2", factor=factor, note=note)
    is_force = text in {"lb", "lbs"} and _FORCE_WORDS.search(channel) is not None
    is_warm = text in {"C", "F"} and _TEMPERATURE_WORDS.search(channel) is not None
    is_turning = text in PER_MINUTE and _ROTATION_WORDS.search(channel) is not None
    spelt = "force_pound" if is_force else "rpm" if is_turning else text.lower() if gravity else text
    spelt = f"deg{text}" if is_warm else SPELLINGS.get(spelt, spelt)
    parsed = None if text in NO_UNITS and not is_warm else _parsed(spelt.replace("⋅", "·"))
    linear = None if parsed is None else _linear(parsed, text)
    if linear is None:
        return UnitConversion(channel=channel, written=written, unit=text, note=UNKNOWN)
    factor, offset, unit = linear
    note = f"{text} read as gram, because the name speaks of a mass or force" if gravity else ""
    if is_force:
        note = f"{text} read as pound-force, because the name speaks of a force"
    elif is_warm:
        note = f"{text} read as deg{text}, because the name speaks of a temperature"
    elif is_turning:
        note = f"{text} read as revolutions per minute, because the name speaks of a rotation"
    elif text in {"mil", "mils"}:
        note = f"{text} read as a thousandth of an inch"
    return UnitConversion(channel=channel, written=written, unit=unit, factor=factor, offset=offset, note=note)


def unit_error(gain: float, std: float) -> str:
    """What a gain looks like that a forgotten conversion of units makes, in words; "" where it may be chance.

    A gain between 1e-4 and 1e4 that is as likely at one power of ten as at another lies within two deviations of one of
    the n candidates with the probability n 4 (std / gain) / (2 ln 1e4). Only where that is small does closeness mean
    anything.

    Args:
        gain: found for a channel; its sign does not matter.
        std: its standard deviation.

    Example:
        >>> unit_error(9.79, 0.02)
        'a factor of 9.80665: g taken for m/s^2, or kilogram-force for newton'
        >>> unit_error(9.79, 0.5), unit_error(1.02, 0.001)
        ('', '')
    """
    size = abs(gain)
    candidates = [(power, factor, words) for factor, words in UNIT_FACTORS.items() for power in (1, -1)]
    if not size or not math.isfinite(size) or not 0.0 < std < math.inf:
        return ""
    chance = len(candidates) * 4.0 * (std / size) / (2.0 * math.log(WIDEST_GAIN))
    near = [one for one in candidates if abs(math.log(size) - one[0] * math.log(one[1])) <= 2.0 * std / size]
    if not near or chance > CHANCE:
        return ""
    power, factor, words = min(near, key=lambda one: abs(math.log(size) - one[0] * math.log(one[1])))
    return f"a factor of {'1 / ' if power < 0 else ''}{factor:.6g}: {words}{'' if power > 0 else ', turned round'}"


def _unread_unit(channel: str) -> str:
    """What a reader must know where a name without a unit ends in one."""
    last = _LAST_WORD.search(channel)
    if last is None or (last[1] not in SCALED and last[1].lower() != "rpm"):
        return ""
    return f"the name ends in {last[1]!r}; if that is the unit, write it in brackets: the values are kept as they are"


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
    if not _UNIT_TEXT.fullmatch(text) or _BIG_NUMBER.search(text):
        return None
    if " " in text and _PEAK.search(text):
        return None
    registry = _registry()
    for spelling in (text, _BARE_POWER.sub(r"^\1", text)):
        try:
            return registry.parse_units(spelling)
        except Exception:  # noqa: BLE001, S112 - pint raises many kinds for text that is no unit; all mean "unknown"
            continue
    return None


def _linear(parsed: Any, written: str) -> tuple[float, float, str] | None:
    """Factor, offset and SI unit; None for what measures no dimension (counts, %) or is not linear (dB)."""
    quantity = _registry().Quantity
    try:
        zero, one, two = (quantity(value, parsed).to_base_units() for value in (0.0, 1.0, 2.0))
    except Exception:  # noqa: BLE001 - a logarithm within a product (dB(A)) has a name that the library cannot reduce
        return None
    base = f"{one.units:~C}"
    if base in {"", "count"} or abs(two.magnitude - 2 * one.magnitude + zero.magnitude) > 1e-9 * abs(two.magnitude):
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
