import numpy as np
import pytest

from modal.preparation.samples import length_findings
from modal.quality import check_quality
from okid.record import Record


def record_of(n_samples, n_inputs=1, n_outputs=2):
    rng = np.random.default_rng(n_samples)
    return Record(rng.standard_normal((n_samples, n_inputs)), rng.standard_normal((n_samples, n_outputs)), 0.1)


@pytest.mark.parametrize(("n_samples", "level"), [(8, "bad"), (9, "doubtful"), (71, "doubtful"), (72, None)])
def test_an_observer_of_one_mode_needs_rows(n_samples, level):
    """Three channels, two of the past, and one input: 7 coefficients, so 7 rows to solve and 70 to trust."""
    found = length_findings([record_of(n_samples)], has_coherence=True)
    assert [finding.level for finding in found] == ([] if level is None else [level])
    assert all("record 72 samples or more" in finding.sentence for finding in found)


def test_each_record_loses_its_first_rows():
    assert length_findings([record_of(36), record_of(37)], has_coherence=True) != []
    assert length_findings([record_of(37), record_of(37)], has_coherence=True) == []


@pytest.mark.parametrize(("n_samples", "is_said"), [(60, True), (2000, False)])
def test_what_was_not_looked_at_is_said(n_samples, is_said):
    quality = check_quality(record_of(n_samples))
    assert ("no coherence" in {finding.what for finding in quality.findings}) is is_said


def test_three_samples_are_not_called_good():
    assert check_quality(record_of(3)).level == "bad"
    assert check_quality(Record([], [0.0, 1.0, 0.5], 0.1)).level == "bad"
