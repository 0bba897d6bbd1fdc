"""The table of all modes in words: every mode and indicator, intervals, and sentences on both sides of their rules."""

from dataclasses import replace

import numpy as np
import pytest

from modal.geometry.placement import placed
from modal.recording.identification.modes import modes_text
from modal.recording.plan import planned


def words(found):
    record = found.records[0]
    return modes_text(found, planned(found), placed(None, record.output_names, record.output_units))


def changed(found, **fields):
    modes = tuple(replace(mode, **fields) for mode in found.modes.modes)
    return replace(found, modes=replace(found.modes, modes=modes))


def test_every_mode_has_a_row_with_every_indicator(identification):
    text = words(identification)
    rows = [line for line in text.splitlines() if line.startswith("|")]
    assert len(rows) == 2 + len(identification.modes.modes)
    for name in ("EMAC out", "EMAC in", "MPC", "MPD [°]", "CMI", "MSV", "repeats", "γ", "shape", "why"):
        assert f"| {name} |" in rows[0]
    first = identification.modes.system[0]
    cells = [cell.strip() for cell in rows[2].split("|")]
    for value in (first.repeatability, first.emac_output, first.emac, first.phase_collinearity, first.cmi):
        assert f"{value:.2f}" in cells


def test_intervals_are_of_95_percent_and_left_out_where_unknown(identification):
    sharp = changed(identification, frequency_std=0.05, damping_ratio_std=np.nan)
    text = words(sharp)
    assert "6.667 ± 0.098" in text
    assert "±: 95 % interval." in text
    assert "±" not in words(changed(identification, frequency_std=np.nan, damping_ratio_std=np.nan))


@pytest.mark.parametrize(("caution", "said"), [(0.29, False), (0.31, True)])
def test_few_data_for_the_indicators_are_told(identification, caution, said):
    found = replace(identification, modes=replace(identification.modes, indicator_caution=caution))
    assert ("test the observer more than the data" in words(found)) is said


def test_assurance_among_different_units_is_told(build):
    sentence = "outputs in units with large numbers weigh more"
    assert sentence in words(build(units=["m", "m", "rad", "rad"]))
    assert sentence not in words(build(units="m"))


def test_long_reasons_stand_whole_below_the_table(identification):
    long = "because " * 30
    assert words(changed(identification, reason=long.strip())).count(long.strip()) == len(identification.modes.modes)
    assert words(changed(identification, reason="short")).count("short") == len(identification.modes.modes)
