"""How a result can be made again."""

from dataclasses import dataclass
from importlib import metadata

__all__ = ["Provenance", "installed_version"]

DISTRIBUTION = "okid-modal"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Provenance:
    """What a report says about where its result comes from; whoever calls the library knows, the result does not.

    Attributes:
        command: command line that made the result, "" where there was none.
        sources: paths of the files that were read, as they were given.
        dt: time step that was given with them [s], None where the files have their own.
        remarks: what the reader did to the data, such as units that it converted, in words.
    """

    command: str = ""
    sources: tuple[str, ...] = ()
    dt: float | None = None
    remarks: tuple[str, ...] = ()


def installed_version() -> str:
    """Version of the installed distribution, "not installed" when the packages run from a bare source tree."""
    try:
        return metadata.version(DISTRIBUTION)
    except metadata.PackageNotFoundError:
        return "not installed"
