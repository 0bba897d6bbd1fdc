"""The row of modules: six records, one identification a state, and the joint that lost a little of its stiffness."""

import numpy as np
import pytest
import scipy

from modal.comparison.changes import compare_results
from modal.comparison.shifts import read_result
from modal.examples import many_records
from modal.identification.pipeline import identify


@pytest.fixture(scope="module")
def states():
    """Identifications before and after, of fresh records."""
    rng = np.random.default_rng(11)
    losses = (0.0, many_records.ROW.loss)
    return [identify(many_records.records_of(many_records.modules(loss=loss), rng)) for loss in losses]


def test_no_two_records_are_alike():
    records = many_records.records_of(many_records.modules(), np.random.default_rng(3))
    levels = [record.inputs.std() for record in records]
    np.testing.assert_allclose(levels, many_records.ROW.levels, rtol=0.1)
    lost = [np.isnan(record.outputs) for record in records]
    assert all(0 < where.sum() < 0.01 * where.size for where in lost)
    assert not np.array_equal(lost[0], lost[1])


def test_the_modes_that_strain_the_joint_shift_and_no_others(states):
    before, after = states
    comparison = many_records.compared(before, after)
    true = many_records.modules(loss=many_records.ROW.loss).modes()[0] / many_records.modules().modes()[0] - 1
    assert [pair.frequency.verdict == "beyond chance" for pair in comparison.pairs] == list(true < -1e-3)
    assert (comparison.lost, comparison.new) == ((), ())
    for pair, shift in zip(comparison.pairs, true, strict=True):
        assert abs(pair.frequency.change - shift) < 2 * pair.frequency.half_width
    best, second, *_ = many_records.suspects(comparison)
    assert best.joint == many_records.ROW.loosened
    assert abs(best.loss - many_records.ROW.loss) < 4 * best.loss_std < 0.2 * many_records.ROW.loss
    assert best.misfit < 3 < second.misfit
    assert "joint 3 lost" in many_records.summary(comparison)


def test_another_joint_leaves_another_pattern():
    """The rule of the strain energies against the eigenvalue problem, to first order in the loss."""
    structure = many_records.modules()
    frequencies, shapes = structure.modes()
    strains = (many_records.ACROSS @ shapes) ** 2
    for joint in range(many_records.ROW.n_modules + 1):
        joints = np.full(many_records.ROW.n_modules + 1, many_records.ROW.stiffness)
        joints[joint] *= 1 - 1e-6
        stiffness = many_records.ACROSS.T @ np.diag(joints) @ many_records.ACROSS
        squares = scipy.linalg.eigh(stiffness, structure.mass, eigvals_only=True)
        shift = np.sqrt(squares) / (2 * np.pi * frequencies) - 1
        np.testing.assert_allclose(shift, -0.5e-6 * strains[joint] / strains.sum(axis=0), atol=1e-11)


def test_many_records_writes_the_comparison_and_both_results(tmp_path, capsys, states, monkeypatch):
    """With results that are there already: what is under test is the folder and the words."""
    ready = iter(states)
    monkeypatch.setattr(many_records, "identify", lambda _records: next(ready))
    assert many_records.main([str(tmp_path / "out")]) == 0
    before, after = (read_result(tmp_path / "out" / f"{name}.npz") for name in ("before", "after"))
    assert len(compare_results(before, after).pairs) == many_records.ROW.n_modules
    assert "2 of 4 matched modes" in (tmp_path / "out" / "comparison.html").read_text(encoding="utf-8")
    told = capsys.readouterr().out
    assert "2 of 4 matched modes changed beyond chance" in told
    assert "hidden: joint 3, 1.00 %" in told
    ready = iter(states)
    many_records.main([str(tmp_path / "out")])
    assert "not written: " in capsys.readouterr().out  # what is there is not touched
