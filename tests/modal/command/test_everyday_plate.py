"""One command for each of the eight everyday data sets of one plate: six of six modes, none false, told alike."""

import numpy as np
import pytest
from everyday_plate import KINDS, commanded, errors_of

EACH = [pytest.param(k, id=kind.__name__) for k, kind in enumerate(KINDS)]


@pytest.mark.slow
@pytest.mark.parametrize("k", EACH)
def test_six_of_six_modes_and_none_false(tmp_path, k):
    """Of 96 errors of a seed one in four plates has one beyond 3 deviations, and one in 160 one beyond 4."""
    plate, done = commanded(k, 2035, tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("Six modes of the system were found, between ")
    errors, false = errors_of(plate, tmp_path / "result")
    assert false == []
    assert len(errors) == 6
    assert np.abs(errors).max() < 4.0
