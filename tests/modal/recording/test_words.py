"""Sentences in the pages: whole where they are ours, harmless and bounded whatever they hold."""

from modal.recording.tables import LONGEST_SENTENCE, bullets


def test_a_long_sentence_is_not_cut_in_its_middle():
    sentence = "Noise floor of held out: " + "by its level from 15 to 128 Hz, " * 30
    assert bullets([sentence])[0] == f"- {sentence.strip()}"


def test_a_hostile_one_is_bounded_and_harmless():
    (text,) = bullets(["<script>" + "x" * 10_000])
    assert "<script>" not in text
    assert len(text) < LONGEST_SENTENCE + 100
    assert bullets([]) == []
