"""Synthesised responses: the modes of the system alone against the whole model, whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest

from era.realisation import Realisation
from modal.modes.extraction import extract_modes
from modal.modes.response_synthesis import frf, measured_frf
from modal.plots.responses import model_grid
from modal.plots.results import synthesised_alone
from modal.report.pictures import response_pictures


@pytest.fixture
def believed(identification):
    """The hand-made model with its own modes, all of them believed."""
    model = extract_modes(identification.realisation)
    modes = tuple(replace(mode, verdict="system") for mode in model)
    return replace(identification, modes=replace(model, modes=modes))


def test_all_modes_together_are_the_model(believed):
    measured = measured_frf(believed.records)
    alone = synthesised_alone(believed, measured)
    np.testing.assert_allclose(alone, frf(believed.realisation, model_grid(measured)), atol=1e-10)


def test_a_mode_that_is_not_believed_is_left_out(believed):
    measured = measured_frf(believed.records)
    first, *others = believed.modes.modes
    doubted = replace(believed, modes=replace(believed.modes, modes=(replace(first, verdict="doubtful"), *others)))
    grid = model_grid(measured)
    lost = np.abs(frf(believed.realisation, grid) - synthesised_alone(doubted, measured))[:, 0, 0]
    assert grid[np.argmax(lost)] == pytest.approx(first.frequency, abs=0.1)


def test_nothing_is_synthesised_where_it_would_not_compare(believed):
    measured = measured_frf(believed.records)
    none = replace(believed, modes=replace(believed.modes, modes=()))
    assert synthesised_alone(none, measured) is None
    whole = believed.realisation
    part = Realisation(whole.A[:4, :4], whole.B[:4], whole.C[:, :4], whole.D, whole.dt)
    cut = replace(believed, fitted_model=part)  # the rest stands for delays
    assert synthesised_alone(cut, measured) is None
    same = replace(believed, fitted_model=believed.realisation)
    assert synthesised_alone(same, measured) is not None


def test_the_words_follow_what_is_drawn(believed):
    picture = response_pictures(believed)["responses"]
    assert "Dashed: the modes of the system alone" in picture.caption
    assert "strongest of" not in picture.caption
    none = replace(believed, modes=replace(believed.modes, modes=()))
    assert "Dashed" not in response_pictures(none)["responses"].caption


def test_only_the_strongest_pairs_of_many_are_drawn(believed, monkeypatch):
    for place in ("modal.report.pictures", "modal.plots.results"):
        monkeypatch.setattr(f"{place}.MOST_SHOWN", 2)
    assert "The 2 strongest of 3 are shown." in response_pictures(believed)["responses"].caption


def test_records_that_are_too_short_have_no_picture(believed):
    record = believed.records[0]
    short = (replace(record, inputs=record.inputs[:10], outputs=record.outputs[:10]),)
    assert response_pictures(replace(believed, records=short)) == {}
