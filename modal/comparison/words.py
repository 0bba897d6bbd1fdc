"""A comparison in plain words: the headline, one sentence a mode, and what the test behind it can and cannot say."""

import math
from collections.abc import Iterable

from modal.comparison.changes import Comparison, ModePair, Unmatched
from modal.comparison.shifts import Shift
from modal.modes.mode import Mode
from modal.wording.text import hertz, shorten
from okid.arrays import ROUNDED
from okid.errors import visible


def comparison_headline(comparison: Comparison) -> str:
    """What changed, in one sentence."""
    n_pairs = len(comparison.pairs)
    if n_pairs and not _common(comparison):
        return (
            f"No output channel is in both results, so nobody knows whether their modes are the same: {n_pairs} "
            f"{'is' if n_pairs == 1 else 'are'} set side by side by frequency and damping alone."
        )
    shifted = [pair for pair in comparison.pairs if pair.changed]
    alone = [
        f"{count} {word}" for count, word in ((_sure(comparison.lost), "lost"), (_sure(comparison.new), "new")) if count
    ]
    if not n_pairs and not alone:
        return "Neither result has a mode of the system, so there is nothing to compare."
    rest = f"{' and '.join(alone)}" if alone else ""
    if not n_pairs:
        return f"No mode is in both results: {rest}."
    untested = sum(all(shift.verdict == "not known" for shift in pair.shifts) for pair in comparison.pairs)
    if untested == n_pairs:
        modes, they = ("One mode is", "it") if n_pairs == 1 else (f"{n_pairs} modes are", "they")
        words = f"{modes} in both results; whether {they} changed cannot be told, because {_why_untested(comparison)}"
        return f"{words}{'; ' + rest if rest else ''}."
    matched = "The one matched mode" if n_pairs == 1 else f"{len(shifted)} of {n_pairs} matched modes"
    if n_pairs == 1:
        words = f"{matched} {'changed' if shifted else 'did not change'} beyond chance"
    else:
        words = (
            f"{matched} changed beyond chance" if shifted else f"None of {n_pairs} matched modes changed beyond chance"
        )
    if comparison.moved_together and not shifted:
        words += " by itself, but the frequencies of all did together"
    unknown = f"; of {untested} it cannot be told" if untested else ""
    return f"{words}{unknown}{'; ' + rest if rest else ''}."


def _common(comparison: Comparison) -> set[str]:
    """Outputs that both results have."""
    return {one.name for one in comparison.before.outputs} & {one.name for one in comparison.after.outputs}


def pair_sentence(pair: ModePair) -> str:
    """What became of one mode, the surest change first."""
    order = {"beyond chance": 0, "perhaps chance": 1, "within its interval": 2, "not known": 3}
    shifts = sorted(pair.shifts, key=lambda shift: order[shift.verdict])
    words = "; ".join(shift_sentence(shift) for shift in shifts)
    verdict = verdict_change(pair)
    return f"{_at(pair.before)}: {words}{'; ' + verdict if verdict else ''}."


def shift_sentence(shift: Shift) -> str:
    """One shift with its interval and what that means.

    Example:
        >>> shift_sentence(Shift(what="frequency", before=5.0, after=4.96, change=-0.008, half_width=0.001,
        ...                      p_value=1e-9, verdict="beyond chance"))
        'frequency shifted by -0.80 ± 0.10 %: beyond chance'
    """
    if shift.verdict == "not known":
        return f"{shift.what} {change_text(shift)}: whether that is chance is not known ({shift.remark})"
    meaning = {
        "beyond chance": "beyond chance",
        "perhaps chance": "outside its own interval, but not remarkable among all tests",
        "within its interval": "within its interval",
    }[shift.verdict]
    return f"{shift.what} {change_text(shift)}: {meaning}"


def change_text(shift: Shift) -> str:
    """The change with half its 95 % interval; of a shape its assurance, and the one that chance alone may leave."""
    if shift.what == "shape":
        return _shape_text(shift)
    return f"shifted by {percent_text(shift)}"


def percent_text(shift: Shift) -> str:
    """A relative change in percent, with half its 95 % interval where that is known.

    Example:
        >>> percent_text(Shift(what="frequency", before=5.0, after=5.0, change=-1e-9, half_width=0.001, p_value=1.0))
        '0.00 ± 0.10 %'
    """
    change, half_width = 100 * shift.change, 100 * shift.half_width
    if not math.isfinite(change):
        return "not known"
    if not math.isfinite(half_width):
        return f"{change:+.2g} %" if change else "0 %"
    digits = min(12, max(0, 1 - math.floor(math.log10(half_width)))) if half_width > 0 else 2
    shown = round(change, digits)
    return f"{f'{shown:+.{digits}f}' if shown else f'{0:.{digits}f}'} ± {half_width:.{digits}f} %"


def assurance_text(shift: Shift) -> str:
    """The assurance of a shape, to the digits that chance leaves of it, five at most; never rounded up to 1.

    Example:
        >>> assurance_text(Shift(what="shape", before=1.0, after=0.99871, change=0.00129, half_width=0.02, p_value=1.0))
        '0.998'
    """
    if not math.isfinite(shift.after):
        return "not compared"
    digits = min(5, max(3, 1 - math.floor(math.log10(shift.half_width)))) if shift.half_width > 0 else 3
    return _rounded_down(shift.after, digits)


def _rounded_down(value: float, digits: int) -> str:
    return f"{math.floor(value * 10**digits + ROUNDED) / 10**digits:.{digits}f}"


def verdict_change(pair: ModePair) -> str:
    """That the verdict is another one; "" where it is the same."""
    if pair.before.verdict == pair.after.verdict:
        return ""
    return f"its verdict was {pair.before.verdict} and is {pair.after.verdict}"


def unmatched_sentence(one: Unmatched, *, present: str, absent: str) -> str:
    """A mode that only one result has."""
    present, absent = (shorten(visible(name)) for name in (present, absent))
    what = "a mode of the system" if one.mode.verdict == "system" else "a doubtful pole"
    sentence = f"{_at(one.mode)}, {what} in {present}, has no partner in {absent}"
    if one.near is None:
        return f"{sentence}: no pole there is near."
    kind = {"system": "mode of another shape", "doubtful": "doubtful pole", "noise": "pole judged as noise"}
    return f"{sentence}: a {kind[one.near.verdict]} at {hertz(one.near.frequency)} Hz is all that is near."


def how_sentence(comparison: Comparison) -> str:
    """What the verdicts rest on."""
    if not comparison.pairs:
        return "No shift was tested, because no mode is in both results."
    if not comparison.n_tests:
        return f"No shift could be tested, because {_why_untested(comparison)}."
    n_tests, told = comparison.n_tests, ""
    if math.isfinite(comparison.together):
        n_tests, told = n_tests - 1, ", one by one and the frequencies of all modes as one"
    tests = "One shift was tested" if n_tests == 1 else f"{n_tests} shifts were tested together{told}"
    return (
        f"{tests} (Holm): if nothing had changed, and the intervals of both results are right, the chance that any of "
        f"them were called beyond chance would be at most {100 * comparison.level:.0f} %."
    )


def caution_sentences(comparison: Comparison) -> tuple[str, ...]:
    """What makes the comparison weaker than it looks."""
    sentences = []
    if not _common(comparison):
        names = [{channel.name for channel in one.outputs} for one in (comparison.before, comparison.after)]
        sentences.append(
            f"The results have no output channel in common ({_named(names[0])}; {_named(names[1])}): modes were "
            "matched by frequency and damping alone, and no shape was compared."
        )
    if comparison.same_data:
        sentences.append(
            "Both results come from the same measured data: their errors are not independent, and a shift is the work "
            "of the settings, not of the structure."
            if set(comparison.before.data) == set(comparison.after.data)
            else "Both results come in part from the same measured data: their errors are not independent, so the test "
            "is not exact."
        )
    for one in (comparison.before, comparison.after):
        if one.trust == "not carried":
            name = shorten(visible(one.name))
            sentences.append(f"The result of {name} is not reliable, so its modes are not certain.")
    if any(one.kind == "unit" for one in comparison.differences):
        sentences.append("Channels of another unit were left out where shapes are compared.")
    return tuple(sentences)


def least_text(shift: Shift) -> str:
    """The least that chance alone would leave of an assurance in 95 % of cases; "" where that is not known."""
    if not (math.isfinite(shift.after) and shift.half_width > 0):
        return ""
    digits = len(assurance_text(shift)) - 2
    return f"chance alone may leave {_rounded_down(max(0.0, 1.0 - shift.half_width), digits)}"


def _shape_text(shift: Shift) -> str:
    least = least_text(shift)
    known = f"MAC {assurance_text(shift)}" if math.isfinite(shift.after) else "not compared"
    return f"{known} ({least})" if least else known


def _named(names: Iterable[str]) -> str:
    shown = sorted(names)
    more = f" and {len(shown) - 3} more" if len(shown) > 3 else ""
    return ", ".join(shorten(visible(name)) for name in shown[:3]) + more


def _why_untested(comparison: Comparison) -> str:
    """Why no shift of any pair was tested."""
    known = any(math.isfinite(shift.half_width) for pair in comparison.pairs for shift in pair.shifts)
    return "each may be no mode in one of them" if known else "no uncertainty is known"


def _sure(several: tuple[Unmatched, ...]) -> int:
    return sum(one.mode.verdict == "system" for one in several)


def _at(mode: Mode) -> str:
    return (
        f"{hertz(mode.frequency)} Hz"
        if mode.kind == "oscillatory"
        else f"overdamped pole at {hertz(mode.frequency)} Hz"
    )
