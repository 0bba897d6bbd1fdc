"""What the two stories of a missing effect share: the options of their commands and how they tell what was found."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from modal.discrepancy.results import Diagnosis
from modal.report.writing import write_report
from modal.sections.discrepancy_values import step_text
from modal.wording.numbers import times_floor_text
from okid.errors import IdentificationError, InvalidDataError

__all__ = ["options", "parameter", "shrinking", "write_when_asked"]


def options(module: str, what: str) -> argparse.ArgumentParser:
    """The option that both stories have: a folder for the report.

    Args:
        module: as after `python -m`.
        what: the story, one sentence.
    """
    parser = argparse.ArgumentParser(prog=f"python -m {module}", description=what)
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", help="write the report and the recording into DIR")
    parser.add_argument("--seed", type=int, default=1, help="of the noise, the excitation and the starts (default 1)")
    return parser


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
    names = [step_text(step.name) for step in diagnosis.steps]
    sizes = [times_floor_text(step.held_out_level) for step in diagnosis.steps]
    width = max(map(len, names))
    lines = (f"  {name:<{width}}  {size:>8}" for name, size in zip(names, sizes, strict=True))
    return "\n".join(["gap on held-out data, times the noise floor:", *lines])


def write_when_asked(diagnosis: Diagnosis, folder: Path | None) -> Sequence[str]:
    """Report, recording and model in the folder, if there is one; a sentence a file, or why there are none."""
    if folder is None:
        return ()
    try:
        return [f"written: {path}" for path in write_report(diagnosis, folder)]
    except IdentificationError as error:
        return [f"not written: {error}"]
