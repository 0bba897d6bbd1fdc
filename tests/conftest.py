"""Shared by all tests: one BLAS thread, reference systems and hidden effects on the path, the measured records."""

import os

# before numpy is imported: on small matrices one thread is faster than two, and results depend on the machine less
os.environ["OMP_NUM_THREADS"] = "1"
os.environ["OPENBLAS_NUM_THREADS"] = "1"
os.environ["MKL_NUM_THREADS"] = "1"

import sys
from pathlib import Path

import hypothesis
import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(REPOSITORY / "tests" / "reference"))  # `from systems import random_system`
sys.path.insert(0, str(REPOSITORY / "tests" / "hidden_effects"))  # `from hidden_cases import cases`


@pytest.fixture(scope="session")
def repository() -> Path:
    """The folder that holds pyproject.toml."""
    return REPOSITORY


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Measured records beside the repository; tests that need them are skipped where they are not."""
    folder = REPOSITORY.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no measured records at {folder.parent.name}/{folder.name} beside the repository")
    return folder


# in CI the same examples every time, so that a red run means a change; elsewhere new ones every time
hypothesis.settings.register_profile("ci", derandomize=True)
if os.environ.get("CI"):
    hypothesis.settings.load_profile("ci")
