import numpy as np
import pytest

from modal.preparation.amplitude import resolution_findings, resolution_of


@pytest.mark.parametrize("step", [1e-9, 0.03, 5e6])
def test_the_step_of_a_converter_is_found_in_any_unit(channel_of, step):
    values = step * np.round(40 * np.random.default_rng(0).standard_normal(3000))
    assert resolution_of(channel_of(values)) == pytest.approx(step)


def test_values_on_no_grid_have_no_step(channel_of):
    assert np.isnan(resolution_of(channel_of(np.random.default_rng(0).standard_normal(3000))))


@pytest.mark.parametrize(("levels", "level"), [(8.0, None), (4.0, "doubtful"), (0.7, "bad")])
def test_few_levels_a_standard_deviation_are_doubtful_then_bad(channel_of, levels, level):
    """Rounding noise is 1 / (levels sqrt(12)): 3.6, 7.2 and 41 %."""
    values = np.round(levels * np.random.default_rng(0).standard_normal(3000)) / levels
    channel = channel_of(values)
    found = resolution_findings(channel, resolution_of(channel), 1)
    assert [finding.level for finding in found] == ([] if level is None else [level])


def test_the_levels_of_an_input_are_what_they_are(channel_of):
    channel = channel_of(np.random.default_rng(0).choice([-1.0, 1.0], 500), role="input")
    assert resolution_findings(channel, resolution_of(channel), 1) == []
