"""Where the sensors of the embedded tower sit: its floors, its columns and the ground, for pictures of its shapes.

The position sensor of the tuned mass reads motion relative to the roof, up to a dozen times that of the roof. No node
moves by it, so it has no place here; the report says so, and the mode table and the assurance matrix hold it as ever.
"""

import numpy as np

from modal.examples.demo import N_STOREYS, OUTPUT_NAMES, STOREY_HEIGHT
from modal.geometry.sensors import Geometry, Sensor

__all__ = ["demo_geometry"]

HALF_WIDTH = 0.4
"""Of a floor [m]."""


def demo_geometry() -> Geometry:
    """Six levels of four corners, from the ground up; each floor moves as one, the ground stands still.

    Example:
        >>> geometry = demo_geometry()
        >>> geometry.n_nodes, [sensor.name for sensor in geometry.sensors]
        (24, ['floor_1', 'floor_2', 'floor_3', 'floor_4', 'roof'])
    """
    corners = HALF_WIDTH * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    levels = [tuple(range(4 * level, 4 * level + 4)) for level in range(N_STOREYS + 1)]
    return Geometry(
        node_names=tuple(f"{level}{corner}" for level in range(N_STOREYS + 1) for corner in range(1, 5)),
        positions=np.array([[x, y, level * STOREY_HEIGHT] for level in range(N_STOREYS + 1) for x, y in corners]),
        lines=(*(tuple(column) for column in zip(*levels, strict=True)), *((*floor, floor[0]) for floor in levels[1:])),
        surfaces=tuple(levels[1:]),
        sensors=tuple(
            Sensor(name=name, node=floor[0], direction=np.array([1.0, 0.0, 0.0]))
            for name, floor in zip(OUTPUT_NAMES[:N_STOREYS], levels[1:], strict=True)
        ),
        fixed=levels[0],
        rigid=tuple(levels[1:]),
    )
