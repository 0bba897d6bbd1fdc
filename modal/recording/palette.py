"""The colours of every page: few, bright on near-black, one meaning each."""

from typing import Final

import numpy as np
import numpy.typing as npt

__all__ = [
    "BACKGROUND",
    "BLUE",
    "CYCLE",
    "DIM_BLUE",
    "DIM_GREEN",
    "FRAME",
    "GOLD",
    "GREEN",
    "GREY",
    "GRID",
    "ORANGE",
    "PALE",
    "RED",
    "WHITE",
    "Colour",
    "by_share",
]

Colour = tuple[int, int, int]

BACKGROUND: Final[Colour] = (13, 14, 17)
FRAME: Final[Colour] = (120, 124, 134)
GRID: Final[Colour] = (38, 41, 48)
GREY: Final[Colour] = (112, 116, 126)
PALE: Final[Colour] = (196, 200, 210)
WHITE: Final[Colour] = (240, 242, 248)
BLUE: Final[Colour] = (86, 156, 255)  # measured
DIM_BLUE: Final[Colour] = (58, 88, 140)
ORANGE: Final[Colour] = (255, 160, 77)  # simulated from the inputs alone
GREEN: Final[Colour] = (72, 207, 140)  # kept, stable, system
GOLD: Final[Colour] = (245, 196, 84)  # inputs, choices
RED: Final[Colour] = (240, 96, 96)  # what is left over
CYCLE: Final[tuple[Colour, ...]] = (
    GOLD,
    (150, 130, 255),
    (86, 210, 220),
    (240, 130, 190),
    (190, 210, 90),
    (210, 160, 120),
)
"""For channels of equal rank, in this order, again from the start when there are more."""

DIM_GREEN: Final[Colour] = (38, 84, 62)

_KNOTS: Final = np.array([0.0, 0.5, 0.8, 0.95, 1.0])
_STOPS: Final = np.array([(84, 88, 98), (104, 98, 90), GOLD, GREEN, GREEN], dtype=np.float64)


def by_share(share: npt.ArrayLike) -> npt.NDArray[np.uint8]:
    """Colour of a share in [0, 1]: grey to 0.5, gold at 0.8, green from 0.95 on; nan is grey.

    Args:
        share: (n,) values; those outside [0, 1] take the colour of the nearer end.

    Returns:
        (n, 3) red, green, blue.

    Example:
        >>> by_share([0.0, 1.0]).tolist()
        [[84, 88, 98], [72, 207, 140]]
    """
    position = np.clip(np.nan_to_num(np.atleast_1d(np.asarray(share, dtype=np.float64))), 0.0, 1.0)
    channels = [np.interp(position, _KNOTS, _STOPS[:, c]) for c in range(3)]
    return np.round(np.column_stack(channels)).astype(np.uint8)
