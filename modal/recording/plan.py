"""What a recording of one identification will hold, settled before anything is written.

The pages and the blueprint must agree on paths, on what is shown and on the time axis; they all read it here.

Measured series lie below `data`, what a model makes of them below `fit`: lines are painted in the order of their
paths, and the measured line belongs below the others.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from modal.identification.result import Identification
from modal.modes.mode import Mode
from modal.modes.numbering import numbered
from modal.recording.levels import StoredStretch, row_budget
from modal.recording.names import path_parts
from modal.recording.tracks import laid_out, stored_levels
from okid.record import Record

if TYPE_CHECKING:
    from modal.geometry.sensors import Geometry

__all__ = [
    "DATA",
    "SHOWN_INPUTS",
    "SHOWN_OUTPUTS",
    "DataPlan",
    "Plan",
    "planned",
    "planned_data",
]

DATA: Final = "data"
"""Above the measured series of an identification."""

SHOWN_INPUTS: Final = 6
SHOWN_OUTPUTS: Final = 12
SHOWN_MODES: Final = 9
"""Views stay bounded, whatever comes; the numbers of all the others are stored as well."""

ENTITIES_PER_OUTPUT: Final = 3  # measured; predicted with simulated; the residuals of both
SERIES_PER_OUTPUT: Final = 5


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DataPlan:
    """Where the measured channels are stored and when they play.

    Attributes:
        root: the entity above all of them.
        input_paths: entity of each input.
        output_paths: entity of each output.
        shown_outputs: outputs that have views of their own.
        shifts: seconds by which each record is moved on the timeline.
        starts: when each record begins on the timeline [s].
        stops: when each record ends on the timeline [s].
        levels: how finely each record is stored, stretch by stretch.
    """

    root: str
    input_paths: tuple[str, ...]
    output_paths: tuple[str, ...]
    shown_outputs: tuple[int, ...]
    shifts: tuple[float, ...]
    starts: tuple[float, ...]
    stops: tuple[float, ...]
    levels: tuple[tuple[StoredStretch, ...], ...]

    @property
    def start(self) -> float:
        """Where the timeline begins [s]."""
        return self.starts[0]

    @property
    def stop(self) -> float:
        """Where it ends [s]."""
        return self.stops[-1]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Plan:
    """What is shown of an identification, where it is stored and when it plays.

    Attributes:
        data: of the measured channels.
        fit_paths: entity above what the model makes of each output.
        modes: every mode in the order of its number (`modal.modes.numbering`); their position from 1 is the number used on
            every page, in the report and on the timeline "mode".
        shapes: numbers (from 1) of the modes whose shapes are drawn.
        window: length of the window which follows the cursor [s].
        geometry: where the sensors are; None where nothing is known but their order.
    """

    data: DataPlan
    fit_paths: tuple[str, ...]
    modes: tuple[Mode, ...]
    shapes: tuple[int, ...]
    window: float
    geometry: "Geometry | None" = None

    @property
    def compared(self) -> bool:
        """Whether there are shapes to compare: several, of several outputs each."""
        return len(self.shapes) > 1 and len(self.fit_paths) > 1

    @property
    def start(self) -> float:
        """Where the timeline begins [s]."""
        return self.data.start

    @property
    def stop(self) -> float:
        """Where it ends [s]."""
        return self.data.stop


def planned(identification: Identification, geometry: "Geometry | None" = None) -> Plan:
    """The plan for one identification.

    Args:
        identification: what will be recorded.
        geometry: where the sensors are.

    Raises:
        InvalidDataError: the records reach further than the time axis of a recording does.
    """
    records = identification.records
    first = records[0]
    n_entities = first.n_inputs + ENTITIES_PER_OUTPUT * first.n_outputs
    budget = row_budget(n_entities, first.n_inputs + SERIES_PER_OUTPUT * first.n_outputs)
    around = tuple(_worst_sample(*pair) for pair in zip(records, identification.simulated, strict=True))
    data = planned_data(records, budget=budget, around=around)
    modes = tuple(mode for _, mode in numbered(identification.modes.modes))
    return Plan(
        data=data,
        fit_paths=tuple(f"fit/output/{part}" for part in path_parts(first.output_names)),
        modes=modes,
        shapes=_drawn(modes),
        window=_window(modes, first.dt, data.stop - data.start),
        geometry=geometry,
    )


def planned_data(
    records: Sequence[Record], *, root: str = DATA, budget: int | None = None, around: Sequence[int] = ()
) -> DataPlan:
    """The plan for the measured channels alone.

    Args:
        records: with equal channels.
        root: the entity above them.
        budget: rows that a series may have; unless given, as many as the measured channels leave.
        around: for each record, the sample around which every sample is stored in a long one.

    Raises:
        InvalidDataError: the records reach further than the time axis of a recording does.
    """
    first = records[0]
    starts, stops = laid_out(records)
    n_channels = first.n_inputs + first.n_outputs
    return DataPlan(
        root=root,
        input_paths=tuple(f"{root}/input/{part}" for part in path_parts(first.input_names)),
        output_paths=tuple(f"{root}/output/{part}" for part in path_parts(first.output_names)),
        shown_outputs=tuple(range(min(first.n_outputs, SHOWN_OUTPUTS))),
        shifts=tuple(start - record.start_time for start, record in zip(starts, records, strict=True)),
        starts=starts,
        stops=stops,
        levels=stored_levels(records, budget or row_budget(n_channels, n_channels), around=around),
    )


def _worst_sample(record: Record, simulated: Record) -> int:
    """Where the model is furthest from what was measured, each output by its own scale; the start if nowhere."""
    residual = np.abs(record.outputs - simulated.outputs)
    there = np.isfinite(residual)
    if not there.any():
        return 0
    residual[~there] = 0.0
    residual /= np.where(residual.any(axis=0), residual.mean(axis=0), 1.0)
    return int(residual.max(axis=1).argmax())


def _drawn(modes: tuple[Mode, ...]) -> tuple[int, ...]:
    """Modes of the system; where there are none, the doubtful ones, so that there is something to judge."""
    for verdict in ("system", "doubtful"):
        chosen = [number for number, mode in enumerate(modes, start=1) if mode.verdict == verdict]
        if chosen:
            return tuple(chosen[:SHOWN_MODES])
    return ()


def _window(modes: tuple[Mode, ...], dt: float, duration: float) -> float:
    """Eight periods of the lowest system mode, but at least 60 and at most 600 samples, and a tenth of the record."""
    system = [mode.frequency for mode in modes if mode.verdict == "system" and mode.frequency > 0]
    wanted = 8.0 / min(system) if system else 300 * dt
    return float(min(np.clip(wanted, 60 * dt, 600 * dt), max(duration / 10, 20 * dt)))
