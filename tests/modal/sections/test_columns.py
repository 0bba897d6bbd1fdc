"""The limits on the page are those of the verdict, and a number is red on the wrong side of its limit alone."""

from dataclasses import replace

import numpy as np
import pytest

from modal.sections.words import INDICATORS
from modal.verdict import judgement as verdict

COLUMNS = {column.key: column for column in INDICATORS}


def test_the_words_name_the_limits_that_the_verdict_has(identification):
    mode = identification.modes.system[0]
    groups = {"halves of the data": 0.9, "other observer order and ridge": 0.9, "other model orders": 0.9}

    def called(p, least):
        return verdict._verdict(mode, p, 100.0, {**groups, "other model orders": least}, "")[0]

    least_p = COLUMNS["probability"].limit
    least_part = float(COLUMNS["repeatability"].meaning.removesuffix(".").rpartition(" ")[2])
    assert called(least_p, least_part) == "system"
    assert called(least_p - 0.001, least_part) == "doubtful"
    assert called(least_p, least_part - 0.001) == "doubtful"
    assert COLUMNS["repeatability"].limit is None  # a mean above any number may hide a part that is too low


@pytest.mark.parametrize("column", [column for column in INDICATORS if column.limit is not None], ids=lambda c: c.key)
def test_a_number_is_beyond_its_limit_on_one_side_of_it(identification, column):
    mode = identification.modes.system[0]
    worse = -0.001 if column.better == "high" else 0.001
    assert column.beyond(replace(mode, **{column.key: column.limit + worse}))
    assert not column.beyond(replace(mode, **{column.key: column.limit}))
    assert not column.beyond(replace(mode, **{column.key: np.nan}))
