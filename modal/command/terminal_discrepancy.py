"""What the command prints of a diagnosis: the verdict, what is missing, before and after, and what to do next."""

import shlex
from collections.abc import Sequence

from rich.console import Console
from rich.table import Table

from modal.command.terminal import listing, plain
from modal.discrepancy.results import Diagnosis, Finding
from modal.report.discrepancy_writing import DiagnosisFiles
from modal.sections import discrepancy_words as words
from modal.sections.discrepancy_stages import Stage, rows_of, stages_of
from modal.sections.discrepancy_values import effect_text, found_value, interval_text, times_text

__all__ = ["show_diagnosis", "show_diagnosis_files"]

_TRUST = {"carried": "bold green", "with care": "bold yellow", "not carried": "bold red"}
_STAGES = {"before": "red", "linear": "yellow", "after": "green"}
MOST_PARTS = 12
"""Rows of the before/after table; the report has all."""


def show_diagnosis(console: Console, diagnosis: Diagnosis, *, remarks: Sequence[str] = ()) -> None:
    """Verdict, findings, where, before and after, runner-up, what could still hide, what to do next, warnings."""
    judgement = words.judge_diagnosis(diagnosis)
    console.print()
    console.print(plain(words.diagnosis_headline(diagnosis), "bold"))
    console.print(plain(f"{judgement.label}. ", _TRUST[judgement.trust]) + plain(" ".join(judgement.reasons)))
    if diagnosis.findings:
        console.print()
        console.print(_findings(diagnosis.findings))
    listing(console, "Why", [_why(finding) for finding in diagnosis.findings], "")
    listing(console, "Where they disagreed, before any effect was tried", words.where_sentences(diagnosis), "")
    stages = stages_of(diagnosis)
    if stages:
        console.print()
        console.print(plain("Held-out gap, times the noise floor", "bold"))
        console.print(_before_after(stages))
    limits = words.hidden_sentence(diagnosis)
    hidden = words.capital(limits.removeprefix(words.COULD_HIDE))
    listing(console, "What the data could still hide", [hidden] if limits else [], "")
    listing(console, "Next", words.next_sentences(diagnosis), "cyan")
    listing(console, "Warnings", words.read_first(diagnosis), "yellow")
    listing(console, "Data", (*words.floor_summary(diagnosis), *remarks), "")


def show_diagnosis_files(console: Console, files: DiagnosisFiles) -> None:
    """Where the report is, one line a file, so that it can be opened by a click or a copy."""
    console.print()
    meanings = (
        (files.html, "report to read"),
        (files.markdown, "the same as Markdown"),
        (files.json, "every number"),
        (files.csv, "one row a parameter found"),
        (files.recording, f"to look at: modal-report view {shlex.quote(str(files.recording.parent))}"),
        (files.model, "the updated model, to go on with"),
    )
    for path, meaning in meanings:
        if path is not None:
            console.print(plain(str(path)) + plain(f"  {meaning}", "bright_black"), soft_wrap=True)


def _findings(findings: Sequence[Finding]) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bright_black", padding=(0, 2, 0, 0))
    for heading in ("effect", "place", ""):
        table.add_column(heading)
    table.add_column("value ± std", justify="right", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    table.add_column("95 %", no_wrap=True)
    for finding in findings:
        head = (plain(effect_text(finding.effect), "bold green"), plain(finding.where))
        if not finding.parameters:
            table.add_row(*head)
        for number, one in enumerate(finding.parameters):
            table.add_row(
                *(head if number == 0 else ("", "")),
                plain(one.name),
                plain(found_value(one), "bold"),
                plain(one.unit),
                plain(interval_text(one.value, one.std), "bright_black"),
            )
    return table


def _why(finding: Finding) -> str:
    name = words.capital(effect_text(finding.effect))
    evidence = words.as_sentence(finding.evidence.words)
    law = f"{finding.effect}: {finding.law}"
    return f"{name} at {finding.where} ({law}): {evidence} {words.runner_up_sentence(finding)}"


def _before_after(stages: Sequence[Stage]) -> Table:
    """By output and by record; bands only as far as there is room."""
    table = Table(box=None, pad_edge=False, header_style="bright_black", padding=(0, 2, 0, 0))
    table.add_column("by", no_wrap=True)
    table.add_column("")
    for stage in stages:
        table.add_column(stage.name, justify="right", no_wrap=True)
    for row in rows_of(stages)[:MOST_PARTS]:
        cells = [plain(times_text(size), _STAGES[stage.kind]) for stage, size in zip(stages, row.sizes, strict=True)]
        table.add_row(plain(row.part, "bright_black"), plain(row.name), *cells)
    return table
