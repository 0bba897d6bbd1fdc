"""The conditions that a result can be asked to meet, one type each; `modal.acceptance.check` weighs a result against them."""

from dataclasses import dataclass
from typing import Literal

__all__ = [
    "DampingRange",
    "FitAtLeast",
    "Limit",
    "ModeCount",
    "ModeExpected",
    "ModeForbidden",
    "Range",
    "SettledVerdicts",
    "TrustAtLeast",
    "UncertaintyAtMost",
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
