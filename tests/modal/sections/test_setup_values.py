import datetime as dt
from dataclasses import replace

import numpy as np

from modal.acceptance.test_file import SensorNote, Specification
from modal.sections.validation import about_lines, channel_rows, sensor_columns

NOTES = (
    SensorNote(channel="floor_2", kind="accelerometer", calibrated=dt.date(2026, 1, 10)),
    SensorNote(channel="elsewhere", serial="9"),
)


def test_only_what_the_test_file_says_is_shown():
    assert about_lines(None) == ()
    assert about_lines(Specification()) == ()
    said = about_lines(Specification(article="frame", date=dt.date(2026, 5, 4)))
    assert said == (("Article", "frame"), ("Date", "2026-05-04"))


def test_columns_are_those_that_at_least_one_sensor_has():
    assert sensor_columns(None) == ()
    assert sensor_columns(Specification(sensors=NOTES)) == ("sensor", "serial", "calibrated")


def test_each_channel_has_the_note_of_its_name(identification):
    rows = channel_rows(identification, Specification(sensors=NOTES))
    notes = {(row.name, row.role): row.notes for row in rows}
    assert notes["floor_2", "output"] == ("accelerometer", "–", "2026-01-10")
    assert notes["floor_1", "output"] == ("–", "–", "–")
    assert ("ground", "input") in notes
    assert {row.notes for row in channel_rows(identification)} == {()}


def test_the_channel_that_is_reproduced_least_comes_first(identification):
    fit = replace(identification.fit, cross_validated=np.array([0.9, 0.6, 0.8]))
    rows = channel_rows(replace(identification, fit=fit))
    assert [row.name for row in rows] == ["floor_2", "floor_3", "floor_1", "ground"]
    assert [row.fit for row in rows][:3] == [0.6, 0.8, 0.9]


def test_bands_are_written_out_up_to_a_limit(identification):
    def bands(*bands):
        excitation = replace(identification.excitation, excited_bands=(bands,))
        return channel_rows(replace(identification, excitation=excitation))[-1].bands

    assert bands() == "nowhere"
    assert bands((0.1, 4.0)) == "0.1 to 4"
    assert bands(*[(i, i + 0.5) for i in range(9)]).endswith("5 to 5.5 and 3 more bands")
    assert channel_rows(identification)[0].bands == ""
    alone = replace(
        identification,
        records=(identification.records[0].select(inputs=[]),),
        excitation=replace(identification.excitation, excited_bands=()),
    )
    assert [row.role for row in channel_rows(alone)] == ["output"] * 3
