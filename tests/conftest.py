"""Shared by all tests: one BLAS thread, reference systems and hidden effects on the path, the measured records."""

import os

# before numpy is imported: on small matrices one thread is faster than two, and results depend on the machine less
os.environ["OMP_NUM_THREADS"] = "1"
os.environ["OPENBLAS_NUM_THREADS"] = "1"
os.environ["MKL_NUM_THREADS"] = "1"

import atexit
import gc
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import hypothesis
import pytest

# where bytecode is not kept (containers often set this) each process that a test starts compiles us anew, which is half
# of its time: they share a folder that goes with this run
if os.environ.pop("PYTHONDONTWRITEBYTECODE", "") and "PYTHONPYCACHEPREFIX" not in os.environ:
    os.environ["PYTHONPYCACHEPREFIX"] = tempfile.mkdtemp(prefix="bytecode-")
    atexit.register(shutil.rmtree, os.environ["PYTHONPYCACHEPREFIX"], ignore_errors=True)

gc.disable()  # what is imported and collected stays: to look through it again and again is half the time that takes


def pytest_collection_finish() -> None:
    """From here on garbage is collected, among what tests make."""
    gc.freeze()
    gc.enable()


REPOSITORY = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(REPOSITORY / "tests" / "reference"))  # `from systems import random_system`
sys.path.insert(0, str(REPOSITORY / "tests" / "hidden_effects"))  # `from hidden_cases import cases`
sys.path.append(str(REPOSITORY / "tests" / "benchmarks"))  # `from hidden_scoring import outcome`


@pytest.fixture(scope="session")
def repository() -> Path:
    """The folder that holds pyproject.toml."""
    return REPOSITORY


UNSEEN = "no measured record "


class MeasuredRecords:
    """Measured records in a folder beside the repository: `shared_data / "name"` is the path of one.

    A test that asks for one that is not there is skipped, and the last lines of the run say which were not seen.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __truediv__(self, name: str) -> Path:
        if not (self.folder / name).exists():
            pytest.skip(f"{UNSEEN}{name}")
        return self.folder / name


@pytest.fixture(scope="session")
def shared_data() -> MeasuredRecords:
    """Measured records beside the repository."""
    return MeasuredRecords(REPOSITORY.parent / "shared" / "data")


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> Iterator[None]:
    """Say last how many measured records this run has not seen; reports come from all workers."""
    yield
    reasons = [str(report.longrepr[2]) for report in terminalreporter.stats.get("skipped", [])]
    unseen = [reason.partition(UNSEEN)[2] for reason in reasons if UNSEEN in reason]
    if unseen:
        names = sorted(set(unseen))
        terminalreporter.section("measured records")
        terminalreporter.line(
            f"{len(names)} measured records not seen, {len(unseen)} tests skipped: there is no ../shared/data/ with "
            + ", ".join(names)
        )


# in CI the same examples every time, so that a red run means a change, and fewer; elsewhere new ones every time
hypothesis.settings.register_profile("ci", derandomize=True, max_examples=40)
if os.environ.get("CI"):
    hypothesis.settings.load_profile("ci")
