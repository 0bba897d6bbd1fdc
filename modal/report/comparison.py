"""A comparison as files: a page, the same as Markdown, and every number as JSON."""

import json
import os
from dataclasses import dataclass
from pathlib import Path

from modal.comparison.changes import Comparison, ModePair, Unmatched
from modal.comparison.source import ResultSummary
from modal.report.comparison_pages import comparison_html, comparison_markdown
from modal.report.folder import Existing, refuse_names, write_folder
from modal.report.machine import as_json
from modal.sections.provenance import installed_version

__all__ = [
    "COMPARISON_SCHEMA",
    "ComparisonFiles",
    "comparison_json",
    "refuse_existing_comparison",
    "write_comparison",
]

COMPARISON_SCHEMA = "modal-report-comparison/1"
"""Name and version of the layout of the JSON."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ComparisonFiles:
    """Where the files of a comparison are.

    Attributes:
        html: self-contained page.
        markdown: the same words and tables.
        json: every number.
    """

    html: Path
    markdown: Path
    json: Path

    @classmethod
    def in_folder(cls, folder: Path) -> "ComparisonFiles":
        """The names that they have in a folder."""
        return cls(html=folder / "comparison.html", markdown=folder / "comparison.md", json=folder / "comparison.json")

    @property
    def names(self) -> list[str]:
        """File names alone."""
        return [path.name for path in (self.html, self.markdown, self.json)]


def write_comparison(
    comparison: Comparison, folder: str | os.PathLike[str], *, existing: Existing = "refuse"
) -> ComparisonFiles:
    """Write a comparison into a folder, all files or none; the same comparison gives the same bytes.

    Args:
        comparison: of `modal.comparison.changes.compare_results`.
        folder: made if it does not exist.
        existing: "refuse" to touch a folder that holds one of the files, or "replace" those files.

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


def refuse_existing_comparison(folder: Path, existing: Existing) -> None:
    """Raise before any work is done when a comparison could not be written.

    Raises:
        InvalidDataError: as in `write_comparison`.
    """
    refuse_names(folder, ComparisonFiles.in_folder(folder).names, existing)


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
