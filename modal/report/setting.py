"""What a report knows besides the result: the test file, the geometry, the quality of the data, the limits."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from modal.acceptance.check import check_limits
from modal.identification.result import Identification
from modal.quality import check_quality

if TYPE_CHECKING:
    from modal.acceptance.check import LimitOutcome
    from modal.acceptance.test_file import Specification
    from modal.geometry.sensors import Geometry
    from modal.quality import DataQuality

__all__ = ["NOTHING_BESIDES", "Setting", "setting_of"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Setting:
    """What stands in a report besides the result itself.

    Attributes:
        specification: article, operator, sensors and limits, None without a test file.
        geometry: nodes and sensors, None where shapes are drawn as sticks.
        quality: of the data; None where it was not looked at.
        quality_of: "as read" or "as used" (means removed, decimated to the band), as the quality was found.
        outcomes: of each acceptance limit.
    """

    specification: "Specification | None" = None
    geometry: "Geometry | None" = None
    quality: "DataQuality | None" = None
    quality_of: str = "as used"
    outcomes: "tuple[LimitOutcome, ...]" = ()


NOTHING_BESIDES = Setting()
"""For a report on the result alone."""


def setting_of(
    result: Identification,
    *,
    geometry: "Geometry | None" = None,
    specification: "Specification | None" = None,
    quality: "DataQuality | None" = None,
) -> Setting:
    """Look at the data, and hold the result against the limits.

    Args:
        result: of `modal.identify`.
        geometry: of the structure; that of the specification unless given.
        specification: what the test file says.
        quality: of the records as they were read; the records as used are looked at unless given.
    """
    known = specification.geometry if specification is not None and geometry is None else geometry
    return Setting(
        specification=specification,
        geometry=known,
        quality=quality if quality is not None else check_quality(result.records),
        quality_of="as used" if quality is None else "as read",
        outcomes=() if specification is None else check_limits(result, specification),
    )
