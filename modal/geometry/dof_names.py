"""Names of degrees of freedom as test engineers write them: a node, an axis, a sign.

    12X+  12+X  12X  12x-  plate:3:+Z  plate:3Z  tip Z  tip_z+  tip.Z-  3RX+ (a rotation)  12X+ Acceleration

The node comes first, then the axis: X, Y or Z, after an R for a rotation about it. The sign stands right before the
axis or right after it, never both; without one it is plus. A minus before the axis is always a sign: `12-X` looks along
negative X. After a node that ends in a letter, one of `: . _` or a space or a sign parts it from the axis, so that
`max` and `flux` name no direction; after a digit none is needed. Words after a space, as the universal file reader adds
them to tell channels apart, are passed over where the name before them has a sign.
"""

import re
from dataclasses import dataclass
from typing import Final, Literal

__all__ = ["Dof", "Motion", "dof_of"]

Motion = Literal["along", "about"]
"""What a sensor sees: translation along its direction, or rotation about it."""

LONGEST: Final = 200
"""Letters of a name that is read at all; longer ones name no degree of freedom."""

_AXES: Final = "XYZ"
_NAME: Final = re.compile(
    r"""(?P<node>[^\s](?:.*?[^\s:._+-])??)      # what the axis belongs to
        (?:(?<=\d)|(?=[:._\s+-]))               # a digit needs nothing between
        [:._\s]?\s*
        (?P<before>[+-]?)
        (?P<turning>[Rr]?)(?P<axis>[XYZxyz])
        (?P<after>[+-]?)""",
    re.VERBOSE,
)


@dataclass(frozen=True, slots=True)
class Dof:
    """What a name says.

    Attributes:
        node: its name, as written.
        axis: 0, 1 or 2 for X, Y or Z.
        sign: +1 or -1.
        motion: "along" the axis, or "about" it for a rotation.
    """

    node: str
    axis: int
    sign: int
    motion: Motion


def dof_of(name: str) -> Dof | None:
    """Node and direction that a channel name states; None where it states none.

    Example:
        >>> dof_of("12-X"), dof_of("flux")
        (Dof(node='12', axis=0, sign=-1, motion='along'), None)
        >>> dof_of("plate:3:+Z").node, dof_of("3RX+").motion
        ('plate:3', 'about')
    """
    text = name.strip()
    if len(text) > LONGEST:
        return None
    found = _NAME.fullmatch(text)
    if found is None:
        head, _, rest = text.partition(" ")
        found = _NAME.fullmatch(head) if rest else None
        if found is None or not (found["before"] or found["after"]):
            return None
    if found["before"] and found["after"]:
        return None
    return Dof(
        node=found["node"].strip(),
        axis=_AXES.index(found["axis"].upper()),
        sign=-1 if "-" in (found["before"], found["after"]) else 1,
        motion="about" if found["turning"] else "along",
    )
