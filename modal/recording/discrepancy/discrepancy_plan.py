"""What a recording of one diagnosis will hold, settled before anything is written.

The held-out records share the timeline "time" as the records of an identification do. The timeline "step" counts the
states of the model, from the model as given (0) on. What changes from step to step is stored on both: on "time" the
steps are spread evenly from the beginning to the end, so that the page plays on either.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from modal.discrepancy.results import Diagnosis
from modal.localisation.gap import Gap
from modal.recording.levels import StoredStretch, row_budget
from modal.recording.names import path_parts
from modal.recording.plan import SHOWN_OUTPUTS
from modal.recording.tracks import laid_out, stored_levels
from modal.sections.discrepancy_stages import Stage, gap_of, ran_through, stages_of, worst_outputs

__all__ = ["DiscrepancyPlan", "planned_diagnosis"]

SERIES_PER_OUTPUT: Final = 8  # measured, and simulated and gap of up to three states, and the noise


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DiscrepancyPlan:
    """What is shown, where it is stored and when it plays.

    Attributes:
        stages: the model as given, calibrated and as found, with the gap of each.
        step_numbers: numbers of the steps that ran through; only these play.
        step_gaps: the gap of each of them.
        step_times: when each of them stands on the timeline "time" [s].
        output_paths: entity above the series of each output.
        shown_outputs: outputs that have views of their own, those with the largest gap.
        output: the one with the largest gap, which plays step by step.
        record: the held-out record with the largest gap, which plays step by step.
        starts: when each held-out record begins on the timeline [s].
        stops: when each ends [s].
        levels: how finely each record is stored, stretch by stretch.
    """

    stages: tuple[Stage, ...]
    step_numbers: tuple[int, ...]
    step_gaps: tuple[Gap, ...]
    step_times: tuple[float, ...]
    output_paths: tuple[str, ...]
    shown_outputs: tuple[int, ...]
    output: int
    record: int
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


def planned_diagnosis(diagnosis: Diagnosis) -> DiscrepancyPlan:
    """The plan for one diagnosis.

    Args:
        diagnosis: what will be recorded.

    Raises:
        InvalidDataError: the records reach further than the time axis of a recording does.
    """
    records = diagnosis.held_out
    starts, stops = laid_out(records)
    stages = stages_of(diagnosis)
    numbers = tuple(k for k, step in enumerate(diagnosis.steps) if ran_through(step))
    gaps = {stage.step: stage.gap for stage in stages}
    size = stages[0].gap.in_floors if stages else np.ones((len(records), records[0].n_outputs))
    n_series = SERIES_PER_OUTPUT * records[0].n_outputs
    shown = worst_outputs(stages[0].gap, SHOWN_OUTPUTS) if stages else list(range(min(SHOWN_OUTPUTS, size.shape[1])))
    return DiscrepancyPlan(
        stages=stages,
        step_numbers=numbers,
        step_gaps=tuple(gaps[k] if k in gaps else gap_of(diagnosis, diagnosis.steps[k]) for k in numbers),
        step_times=tuple(np.linspace(starts[0], stops[-1], max(len(numbers), 1)).tolist()[: len(numbers)]),
        output_paths=tuple(f"discrepancy/output/{part}" for part in path_parts(records[0].output_names)),
        shown_outputs=tuple(shown),
        output=int(np.argmax(np.nan_to_num(size).mean(axis=0))),
        record=int(np.argmax(np.nan_to_num(size).mean(axis=1))),
        starts=starts,
        stops=stops,
        levels=stored_levels(records, row_budget(n_series, n_series)),
    )
