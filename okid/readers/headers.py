"""Names and units out of column headers such as `tip [m/s^2]` or `Time (s)`."""

import re
from collections import Counter
from collections.abc import Sequence

__all__ = ["looks_like_unit", "split_header", "unique_names"]

_BRACKET = re.compile(r"^(?P<name>.*?)\s*\[(?P<unit>[^\[\]]*)\]\s*$", re.DOTALL)
_PARENTHESIS = re.compile(r"^(?P<name>.*?)\s*\((?P<unit>(?:[^()]|\([^()]*\))*)\)\s*$", re.DOTALL)
_COMMON_UNITS = frozenset(
    [
        *("s", "ms", "us", "µs", "μs", "min", "h", "sec", "msec"),
        *("m", "mm", "cm", "km", "um", "µm", "μm", "nm", "in", "inch", "ft"),
        *("g", "mg", "gn", "kg", "lb", "lbs", "G", "gal", "Gal"),
        *("N", "mN", "kN", "MN", "lbf", "kip", "Nm", "kNm", "N·m"),
        *("Pa", "kPa", "MPa", "GPa", "bar", "psi", "ksi"),
        *("V", "mV", "µV", "uV", "A", "mA", "W", "kW", "J", "kJ"),
        *("K", "°C", "°F", "degC", "degF", "rad", "mrad", "deg", "°", "rpm", "Hz", "kHz"),
        *("counts", "count", "raw", "digits", "lsb", "LSB", "-", "%", "a.u."),
    ]
)
"""What a pair of parentheses may hold to be read as a unit, alone or as products, quotients and powers."""

_SEPARATORS = re.compile(r"[/*·^ ()²³]+|-?\d")

MAX_NAME = 200


def split_header(header: str) -> tuple[str, str]:
    """Name and unit of a column header; the unit is "" if there is none.

    What stands in square brackets is a unit. What stands in parentheses is one only if it is made of common units, so
    that "tip (left)" stays a name.

    Example:
        >>> split_header("tip [m/s^2]"), split_header("Time (s)"), split_header("tip (left)")
        (('tip', 'm/s^2'), ('Time', 's'), ('tip (left)', ''))
    """
    header = "".join(letter if letter.isprintable() else " " for letter in header).strip()
    match = _BRACKET.match(header)
    if match and match["name"]:
        return match["name"][:MAX_NAME], match["unit"].strip()[:MAX_NAME]
    match = _PARENTHESIS.match(header)
    if match and match["name"] and looks_like_unit(match["unit"].strip()):
        return match["name"][:MAX_NAME], match["unit"].strip()
    return header[:MAX_NAME], ""


def looks_like_unit(text: str) -> bool:
    """True if `text` is a common unit, or a product, quotient or power of common units."""
    if text in _COMMON_UNITS:
        return True
    parts = [part for part in _SEPARATORS.split(text) if part]
    return bool(parts) and all(part in _COMMON_UNITS for part in parts)


def unique_names(names: Sequence[str], headers: Sequence[str]) -> list[str]:
    """The names; where several columns share one ("tip [m]", "tip [m/s^2]") their whole headers take its place.

    A column without a name is called "column_<index>".
    """
    count = Counter(names)
    return [
        (header.strip()[:MAX_NAME] if count[name] > 1 else name) or f"column_{index}"
        for index, (name, header) in enumerate(zip(names, headers, strict=True))
    ]
