"""What the stories share: the command of a missing effect, how it is told, and a line for each file written."""

import argparse
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np

from modal.discrepancy.results import Diagnosis, in_words
from modal.report.writing import write_report
from modal.sections.discrepancy_values import step_text
from modal.wording.numbers import times_floor_text
from okid.errors import IdentificationError, InvalidDataError

__all__ = ["parameter", "print_written", "shrinking", "tell"]


def tell(
    what: str,
    arguments: Sequence[str] | None,
    *,
    study: Callable[[np.random.Generator], Diagnosis],
    summary: Callable[[Diagnosis], str],
) -> int:
    """Diagnose, print what was found beside what was hidden, and write the report where that is asked for.

    Args:
        what: the story, one sentence.
        arguments: of the command line, its own unless given.
        study: makes the records and diagnoses them.
        summary: of the diagnosis in words.

    Returns:
        0 when an effect was named, 1 otherwise.
    """
    parser = argparse.ArgumentParser(description=what)
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", help="write the report and the recording into DIR")
    parser.add_argument("--seed", type=int, default=1, help="of the noise, the excitation and the starts (default 1)")
    given = parser.parse_args(arguments)
    diagnosis = study(np.random.default_rng(given.seed))
    print(summary(diagnosis))
    if given.output is not None:
        print_written(lambda: write_report(diagnosis, given.output))
    return 0 if diagnosis.status == "named" else 1


def print_written(write: Callable[[], Iterable[Path]]) -> None:
    """A line for each file that was written, or why there is none."""
    try:
        paths = list(write())
    except IdentificationError as error:
        print(f"not written: {error}")
    else:
        for path in paths:
            print(f"written: {path}")


def parameter(diagnosis: Diagnosis, effect: str, name: str) -> tuple[float, float]:
    """Value and standard deviation of a parameter of an effect that was found.

    Args:
        diagnosis: where the effect was found.
        effect: key in the catalogue.
        name: of the parameter.

    Raises:
        InvalidDataError: it was not found.
    """
    for finding in diagnosis.findings:
        for one in finding.parameters if finding.effect == effect else ():
            if one.name == name:
                return one.value, one.std
    raise InvalidDataError(f"the diagnosis found no {effect} with a parameter {name}; look at its verdict.")


def shrinking(diagnosis: Diagnosis) -> str:
    """How the held-out gap shrinks from step to step, a line each, in times the noise floor."""
    names = [step_text(step.name) for step in in_words(diagnosis).steps]
    sizes = [times_floor_text(step.held_out_level) for step in diagnosis.steps]
    width = max(map(len, names))
    lines = (f"  {name:<{width}}  {size:>8}" for name, size in zip(names, sizes, strict=True))
    return "\n".join(["gap on held-out data, times the noise floor:", *lines])
