"""A comparison as files: one set of tables and words as HTML and as Markdown, and every number as JSON."""

import json
import math
import os
from dataclasses import dataclass
from pathlib import Path

from modal.comparison import words
from modal.comparison.changes import Comparison, ModePair, Unmatched
from modal.comparison.shifts import ResultSummary, Shift
from modal.identification.words import damping_text
from modal.modes.mode import Mode
from modal.report.folder import FileSet, write_folder
from modal.report.machine import as_json
from modal.report.pages import environment
from modal.sections.validation import installed_version
from modal.wording.text import fit_text, hertz, ratio_text
from okid.readers.guard import Existing

MIDDLE, ARM = 100.0, 92.0
"""Of a drawn interval, in a box 200 wide: the line of no change, and the longest arm to either side."""


def comparison_html(comparison: Comparison) -> str:
    """One page that needs nothing but itself."""
    return environment(html=True).get_template("comparison.html.j2").render(**_context(comparison)) + "\n"


def comparison_markdown(comparison: Comparison) -> str:
    """The same words and tables as Markdown."""
    return environment(html=False).get_template("comparison.md.j2").render(**_context(comparison)) + "\n"


def _context(comparison: Comparison) -> dict[str, object]:
    before, after = comparison.before, comparison.after
    pairs = comparison.pairs
    scales = {
        "frequency": _reach([pair.frequency for pair in pairs]),
        "damping": _reach([pair.damping for pair in pairs]),
    }
    return {
        "headline": words.comparison_headline(comparison),
        "before": before.name,
        "after": after.name,
        "changed": comparison.changed,
        "cautions": words.caution_sentences(comparison),
        "how": words.how_sentence(comparison),
        "facts": (
            ("matched modes", str(len(pairs))),
            ("changed beyond chance", str(sum(pair.changed for pair in pairs))),
            ("modes lost", str(sum(one.mode.verdict == "system" for one in comparison.lost))),
            ("modes new", str(sum(one.mode.verdict == "system" for one in comparison.new))),
            ("fit", f"{fit_text(before.fit)} → {fit_text(after.fit)}"),
        ),
        "rows": [_row(pair, scales) for pair in pairs],
        "lost": [words.unmatched_sentence(one, present=before.name, absent=after.name) for one in comparison.lost],
        "new": [words.unmatched_sentence(one, present=after.name, absent=before.name) for one in comparison.new],
        "differences": comparison.differences,
        "version": installed_version(),
    }


def _row(pair: ModePair, scales: dict[str, float]) -> dict[str, object]:
    moved = f" → {pair.number_after}" if pair.number_after != pair.number_before else ""
    frequencies = [hertz(pair.before.frequency), f"{hertz(pair.after.frequency)} Hz"]
    dampings = [_damping(mode) for mode in (pair.before, pair.after)]
    return {
        "number": f"{pair.number_before}{moved}",
        "shifts": (
            _cell(pair.frequency, words.percent_text(pair.frequency), frequencies, scales["frequency"]),
            _cell(pair.damping, words.percent_text(pair.damping), dampings, scales["damping"]),
            _cell(pair.shape, words.assurance_text(pair.shape), ["", ""], math.nan),
        ),
        "verdict": _verdicts(pair.before, pair.after),
    }


def _cell(shift: Shift, text: str, values: list[str], scale: float) -> dict[str, object]:
    remark = shift.remark
    if shift.what == "shape" and not remark:
        remark = words.least_text(shift)
    return {
        "before": values[0],
        "after": values[1],
        "text": text,
        "verdict": shift.verdict,
        "state": shift.verdict.replace(" ", "-"),
        "remark": remark,
        "bar": _bar(shift, scale),
    }


def _bar(shift: Shift, scale: float) -> dict[str, float] | None:
    """Where the interval and its middle are drawn; None where there is no interval."""
    if not (math.isfinite(scale) and math.isfinite(shift.half_width)):
        return None
    per_share = ARM / scale
    low, high = (MIDDLE + per_share * (shift.change + sign * shift.half_width) for sign in (-1, 1))
    return {
        "low": round(low, 2),
        "width": round(max(high - low, 1.0), 2),
        "at": round(MIDDLE + per_share * shift.change, 2),
    }


def _reach(shifts: list[Shift]) -> float:
    """The largest end of any interval, so that all of them are drawn to one scale."""
    ends = [abs(shift.change) + shift.half_width for shift in shifts if math.isfinite(shift.half_width)]
    return max(ends, default=math.nan)


def _damping(mode: Mode) -> str:
    """Without its interval, which the shift has."""
    return (
        ratio_text(mode.damping_ratio) if mode.damping_resolved and mode.kind == "oscillatory" else damping_text(mode)
    )


def _verdicts(before: Mode, after: Mode) -> str:
    return before.verdict if before.verdict == after.verdict else f"{before.verdict} → {after.verdict}"


COMPARISON_SCHEMA = "modal-report-comparison/1"
"""Name and version of the layout of the JSON."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ComparisonFiles(FileSet):
    """Where the files of a comparison are."""

    html: Path
    markdown: Path
    json: Path

    @classmethod
    def in_folder(cls, folder: Path) -> "ComparisonFiles":
        """The names that they have in a folder."""
        return cls(html=folder / "comparison.html", markdown=folder / "comparison.md", json=folder / "comparison.json")


def write_comparison(
    comparison: Comparison, folder: str | os.PathLike[str], *, existing: Existing = "refuse"
) -> ComparisonFiles:
    """Write a comparison into a folder, all files or none; the same comparison gives the same bytes.

    Raises:
        InvalidDataError: a file exists already, or the folder cannot be written.
    """
    target = Path(folder)

    def write(made: Path) -> None:
        files = ComparisonFiles.in_folder(made)
        files.html.write_bytes(comparison_html(comparison).encode("utf-8"))
        files.markdown.write_bytes(comparison_markdown(comparison).encode("utf-8"))
        files.json.write_bytes(comparison_json(comparison).encode("utf-8"))

    write_folder(target, ComparisonFiles.in_folder(target).names, write, existing=existing)
    return ComparisonFiles.in_folder(target)


def comparison_json(comparison: Comparison) -> str:
    """Every number; nan is null, a complex number is [real, imaginary]."""
    document = {
        "schema": COMPARISON_SCHEMA,
        "version": installed_version(),
        "before": _side(comparison.before),
        "after": _side(comparison.after),
        "changed": comparison.changed,
        "same_data": comparison.same_data,
        "n_tests": comparison.n_tests,
        "together": comparison.together,
        "moved_together": comparison.moved_together,
        "level": comparison.level,
        "pairs": [_pair(pair) for pair in comparison.pairs],
        "lost": [_unmatched(one) for one in comparison.lost],
        "new": [_unmatched(one) for one in comparison.new],
        "differences": comparison.differences,
    }
    return json.dumps(as_json(document), allow_nan=False, indent=1) + "\n"


def _side(summary: ResultSummary) -> dict[str, object]:
    return {"name": summary.name, "fit": summary.fit, "trust": summary.trust, "n_modes": len(summary.modes)}


def _pair(pair: ModePair) -> dict[str, object]:
    return {
        "number_before": pair.number_before,
        "number_after": pair.number_after,
        "pole_before": pair.before.pole,
        "pole_after": pair.after.pole,
        "verdict_before": pair.before.verdict,
        "verdict_after": pair.after.verdict,
        "assurance": pair.assurance,
        "frequency": pair.frequency,
        "damping": pair.damping,
        "shape": pair.shape,
    }


def _unmatched(one: Unmatched) -> dict[str, object]:
    near = None if one.near is None else {"frequency": one.near.frequency, "verdict": one.near.verdict}
    mode = one.mode
    return {"number": one.number, "frequency": mode.frequency, "verdict": mode.verdict, "pole": mode.pole, "near": near}
