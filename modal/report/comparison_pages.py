"""The pages of a comparison for people: the same tables and words in HTML and in Markdown."""

import math

from modal.comparison import words as words
from modal.comparison.changes import Comparison, ModePair
from modal.comparison.shifts import Shift
from modal.identification.trust import damping_text
from modal.modes.mode import Mode
from modal.report.page_environment import environment
from modal.sections.provenance import installed_version
from modal.wording.numbers import fit_text, hertz, ratio_text

__all__ = ["comparison_html", "comparison_markdown"]

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
