"""The text of everything in the wheel."""

import ast

import numpy as np
import pytest
from signals import random_inputs, with_noise
from systems import random_chain, simulate


@pytest.fixture(scope="session")
def sources(repository):
    """{path relative to the repository: syntax tree} of everything in the wheel."""
    files = [path for package in ("okid", "era", "modal") for path in sorted((repository / package).rglob("*.py"))]
    return {path.relative_to(repository).as_posix(): ast.parse(path.read_text(encoding="utf-8")) for path in files}


@pytest.fixture(scope="session")
def small_identification():
    """The whole road on a short noisy record of two masses."""
    from modal.identification.pipeline import identify
    from okid.record import Record

    rng = np.random.default_rng(1)
    system = random_chain(rng, n_masses=2)
    inputs = random_inputs(rng, 1200, system.n_inputs)
    outputs = with_noise(rng, simulate(system, inputs), 0.02)
    return identify(Record(inputs, outputs, system.dt), observer_order=12, ridge=0.0, order=4)
