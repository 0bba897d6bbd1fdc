from collections.abc import Callable

import numpy as np
import pytest

from modal.preparation.channel import Channel, Finding, channels_of
from modal.quality.check import check_quality
from okid.record import Record
from okid.scaling import channel_scaling


@pytest.fixture
def channel_of() -> Callable[..., Channel]:
    """One channel named "tip", an output unless said otherwise, as the check hands it to its parts."""

    def make(values: np.ndarray, *, dt: float = 0.01, role: str = "output") -> Channel:
        dummy = np.arange(len(values)) % 7.0
        if role == "input":
            record = Record(values, dummy, dt, input_names=["tip"], output_names=["other"])
        else:
            record = Record(dummy, values, dt, input_names=["other"], output_names=["tip"])
        return next(one for one in channels_of([record], channel_scaling([record])) if one.name == "tip")

    return make


@pytest.fixture
def found() -> Callable[[Record, str], list[Finding]]:
    """What the whole check finds of one kind."""
    return lambda record, what: [finding for finding in check_quality(record).findings if finding.what == what]
