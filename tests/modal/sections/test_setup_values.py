import datetime as dt
from dataclasses import replace

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
    assert [(row.name, row.role) for row in rows][:2] == [("ground", "input"), ("floor_1", "output")]
    assert rows[2].notes == ("accelerometer", "–", "2026-01-10")
    assert rows[1].notes == ("–", "–", "–")
    assert channel_rows(identification, None)[2].notes == ()


def test_bands_are_written_out_up_to_a_limit(identification):
    def bands(*bands):
        excitation = replace(identification.excitation, excited_bands=(bands,))
        return channel_rows(replace(identification, excitation=excitation), None)[0].bands

    assert bands() == "nowhere"
    assert bands((0.1, 4.0)) == "0.1 to 4"
    assert bands(*[(i, i + 0.5) for i in range(9)]).endswith("5 to 5.5 and 3 more bands")
    assert channel_rows(identification, None)[1].bands == ""
    alone = replace(
        identification,
        records=(identification.records[0].select(inputs=[]),),
        excitation=replace(identification.excitation, excited_bands=()),
    )
    assert [row.role for row in channel_rows(alone, None)] == ["output"] * 3
