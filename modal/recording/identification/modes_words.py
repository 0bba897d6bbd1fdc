"""The page "Modes" in words: the table of all modes with every indicator, and what the shapes leave out."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from modal.geometry.comparable import comparison_words
from modal.geometry.complexity import complexity_words
from modal.geometry.placement import Placement
from modal.identification.result import Identification
from modal.identification.trust import damping_text
from modal.modes.mode import Mode
from modal.recording.names import cell
from modal.recording.plan import Plan
from modal.recording.words import UNKNOWN, bullets, table
from modal.wording.numbers import hertz, with_interval

__all__ = ["modes_text"]

REASON_LETTERS: Final = 90
HEAD: Final = (
    *("", "f [Hz]", "ζ [%]", "verdict", "repeats", "P", "gain", "γ", "EMAC out", "EMAC in", "EMAC", "MPC", "MPD [°]"),
    *("shape", "CMI", "MSV", "kind", "why"),
)


def modes_text(identification: Identification, plan: Plan, placement: Placement | None) -> str:
    """The table of all modes, noise included, with every indicator, the verdict and its reason.

    Args:
        identification: whose modes.
        plan: their numbers.
        placement: of the outputs on the structure, where shapes are drawn.
    """
    rows = [_row(number, mode) for number, mode in enumerate(plan.modes, start=1)]
    parts = [table(*_with_content(HEAD, rows)) if rows else "The model has no mode."]
    parts += bullets(
        [
            f"{number}, {mode.frequency:.5g} Hz, {mode.verdict}: {mode.reason}"
            for number, mode in enumerate(plan.modes, start=1)
            if _start(mode.reason) != mode.reason
        ]
    )
    if identification.modes.indicators_missing:
        parts.append(f"Indicators are missing: {cell(identification.modes.indicators_missing)}")
    parts.append(_key(identification, plan))
    if placement is not None and plan.shapes:
        parts += ["**The shapes**", *bullets([*placement.sentences, *_assurance_words(identification, plan)])]
    return "\n\n".join(parts)


def _key(identification: Identification, plan: Plan) -> str:
    caution = identification.modes.indicator_caution
    spread = "±: 95 % interval. " if np.isfinite([mode.frequency_std for mode in plan.modes]).any() else ""
    return (
        f"{spread}repeats: mean overlap with the same mode found again from other data and orders; it decides the "
        "verdict. P: probability that the mode belongs to the system. gain: share of the squared error without the "
        "mode that it removes. γ: amplitude coherence. EMAC: extended modal amplitude coherence. MPC: phase "
        "collinearity. MPD: mean phase deviation. CMI = EMAC · MPC. MSV: mode singular value over the largest. "
        f"n/(pq) = {_number(caution, 2)}"
        + (": the indicators test the observer more than the data." if caution > 0.3 else ".")
    )


def _assurance_words(identification: Identification, plan: Plan) -> list[str]:
    first = identification.records[0]
    words = comparison_words(first.output_names, first.output_units) if plan.compared else ""
    return [words] if words else []


def _row(number: int, mode: Mode) -> list[str]:
    strong = "**" if mode.verdict == "system" else ""
    known = mode.kind != "real" and mode.damping_resolved
    damping = f"{strong}{_interval(100 * mode.damping_ratio, 196 * mode.damping_ratio_std)}{strong}"
    return [
        str(number),
        f"{strong}{_frequency(mode)}{strong}",
        damping if known else damping_text(mode),
        f"{strong}{mode.verdict}{strong}",
        *[_number(value, 2) for value in (mode.repeatability, mode.probability)],
        _figures(mode.gain),
        *[_number(value, 2) for value in (mode.amplitude_coherence, mode.emac_output, mode.emac_input, mode.emac)],
        _number(mode.phase_collinearity, 2),
        _number(mode.mpd, 0),
        complexity_words(mode),
        _number(mode.cmi, 2),
        _number(mode.msv, 2),
        mode.kind,
        cell(_start(mode.reason)) if mode.reason else UNKNOWN,
    ]


def _frequency(mode: Mode) -> str:
    if not np.isfinite(mode.frequency_std):
        return hertz(mode.frequency)
    return with_interval(mode.frequency, 1.96 * mode.frequency_std)


def _interval(value: float, half_width: float) -> str:
    return with_interval(value, half_width) if np.isfinite(half_width) else f"{value:#.3g}"


def _start(reason: str) -> str:
    """What fits beside the numbers on a common screen; the whole of a longer reason stands below the table."""
    return reason if len(reason) <= REASON_LETTERS else reason[: REASON_LETTERS - 1].rstrip() + "…"


def _with_content(head: Sequence[str], rows: Sequence[Sequence[str]]) -> tuple[list[str], list[list[str]]]:
    """Leave out columns that say nothing: no value in any row, or every pole oscillatory."""
    said = [k for k in range(len(head)) if {row[k] for row in rows} - {UNKNOWN, "oscillatory"}]
    return [head[k] for k in said], [[row[k] for k in said] for row in rows]


def _number(value: float, decimals: int) -> str:
    return f"{value:.{decimals}f}" if np.isfinite(value) else UNKNOWN


def _figures(value: float) -> str:
    return f"{value:.2g}" if np.isfinite(value) else UNKNOWN
