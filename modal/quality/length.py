"""Records too short for any fit, or for a look at coherence.

The smallest observer that holds one mode looks two samples back: of n_channels channels it has 2 n_channels + n_inputs
coefficients an output, and one row of the records gives one equation for them.
"""

from collections.abc import Sequence

from modal.quality.findings import Finding
from okid.record import Record

__all__ = ["length_findings"]

PAST = 2
"""Samples of the past that one mode needs."""
ROWS_PER_COEFFICIENT = 10
"""With fewer, a fit follows the noise."""


def length_findings(records: Sequence[Record], *, has_coherence: bool) -> list[Finding]:
    """Too few samples for the smallest observer, or for the coherence of inputs and outputs.

    Args:
        records: of one system.
        has_coherence: whether their coherence could be estimated.

    Example:
        >>> [finding.level for finding in length_findings([Record([], [0.0, 1.0, 0.0], 0.1)], has_coherence=False)]
        ['bad']
    """
    first = records[0]
    n_channels = first.n_inputs + first.n_outputs
    n_samples = sum(record.n_samples for record in records)
    n_rows = sum(max(0, record.n_samples - PAST) for record in records)
    n_coefficients = PAST * n_channels + first.n_inputs
    found = []
    if n_rows < ROWS_PER_COEFFICIENT * n_coefficients:
        needed = ROWS_PER_COEFFICIENT * n_coefficients + PAST
        found.append(
            Finding(
                level="bad" if n_rows < n_coefficients else "doubtful",
                what="few samples",
                where="all records",
                sentence=f"{n_samples} samples of {n_channels} channel{'s' * (n_channels > 1)} are "
                f"{'too few to fit anything' if n_rows < n_coefficients else 'few'}: an observer that holds one mode "
                f"has {n_coefficients} coefficients an output; record {needed} samples or more, or leave channels out.",
            )
        )
    if first.n_inputs and not has_coherence:
        found.append(
            Finding(
                level="note",
                what="no coherence",
                where="all records",
                sentence="the records are too short, or have too many gaps, for measured coherence: how much of the "
                "outputs the inputs explain was not looked at.",
            )
        )
    return found
