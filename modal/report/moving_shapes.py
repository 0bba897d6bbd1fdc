"""The shapes of the modes as numbers for the page's script, which turns and moves them."""

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from modal.geometry.placement import Placement, placed
from modal.identification.result import Identification
from modal.report.setting import Setting
from modal.wording.numbers import hertz
from okid.arrays import ComplexArray, FloatArray

if TYPE_CHECKING:
    from markupsafe import Markup

__all__ = ["moving_shapes", "placement_of"]

MOST_MOVING = 24
"""Modes that can be chosen."""

MOST_NODES = 1500
"""Nodes of a structure that a page turns smoothly; a larger one is left to the recording."""

OBLIQUE = (-0.62, 0.36)
"""Turn and tilt from which all three directions are seen."""

MOST_DEFLECTIONS = 12_000
"""Nodes times modes: about half a megabyte of the page. Of a large structure fewer modes can be chosen."""

SWING = 0.22
"""Greatest deflection over the largest extent of the structure."""


def placement_of(result: Identification, setting: Setting) -> Placement:
    """The outputs on the geometry, or in a row without one."""
    record = result.records[0]
    return placed(setting.geometry, record.output_names, record.output_units)


def moving_shapes(result: Identification, setting: Setting) -> "Markup | str":
    """Nodes, lines and deflections as JSON without any letter that could end a tag; "" where there is nothing to move.

    Args:
        result: of `modal.identify`.
        setting: with the geometry, if there is one.
    """
    from markupsafe import Markup

    placement = placement_of(result, setting)
    geometry = placement.geometry
    modes = result.modes.system[: min(MOST_MOVING, MOST_DEFLECTIONS // max(1, geometry.n_nodes))]
    if not modes or geometry.n_nodes > MOST_NODES:
        return ""
    deflections = [placement.deflection(mode) for mode in modes]
    centre = (geometry.positions.max(axis=0) + geometry.positions.min(axis=0)) / 2
    document = {
        "nodes": _rows((geometry.positions - centre) / geometry.size),
        "lines": [list(line) for line in geometry.lines],
        "surfaces": [list(surface) for surface in geometry.surfaces],
        "home": _side_seen(placement, deflections),
        "modes": [
            {
                "name": f"{hertz(mode.frequency)} Hz",
                "real": _rows(SWING * deflection.real),
                "imaginary": _rows(SWING * deflection.imag),
            }
            for mode, deflection in zip(modes, deflections, strict=True)
        ],
    }
    text = json.dumps(document, allow_nan=False, separators=(",", ":"))
    return Markup(text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026"))  # noqa: S704 - see there


def _side_seen(placement: Placement, deflections: Sequence[ComplexArray]) -> tuple[float, float]:
    """Turn about the vertical and tilt [rad] at first: from the side where sticks move in one plane, else oblique."""
    sideways = max(float(np.abs(deflection[:, 1]).max()) for deflection in deflections)
    if placement.is_given or sideways > 0.0:
        return OBLIQUE
    return (0.0, 0.35) if np.ptp(placement.geometry.positions[:, 1]) > 0 else (0.0, 0.0)


def _rows(values: FloatArray) -> list[list[float]]:
    """To four decimals of the size of the structure: finer than a pixel."""
    return [[round(float(value), 4) + 0.0 for value in row] for row in np.nan_to_num(values)]
