"""The structures of the linear examples against another integrator; what is found of the frame against the truth."""

import json

import numpy as np
import pytest
import scipy

from modal.acceptance.check import LimitOutcome, check_limits
from modal.acceptance.test_file import read_specification
from modal.comparison.changes import compare_results
from modal.comparison.shifts import read_result
from modal.examples import many_records, six_set_ups, three_storey_frame, year_of_a_bridge
from modal.examples.demo import compare_with_truth
from modal.examples.story import print_written, random_forces
from modal.identification.pipeline import identify
from okid.readers import read_record

STRUCTURES = {"frame": three_storey_frame.frame(), "modules": many_records.modules(loss=0.3)}


@pytest.fixture(scope="module")
def frame_run(tmp_path_factory):
    """The frame's story into a folder: exit status and folder."""
    folder = tmp_path_factory.mktemp("frame") / "result"
    return three_storey_frame.main(["-o", str(folder)]), folder


# --- the structures --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", sorted(STRUCTURES))
def test_a_structure_moves_as_a_general_integrator_says(name):
    """Runge-Kutta of order 8 on M x'' + C x' + K x = F, with C from its definition, V' C V = diag(2 zeta w)."""
    structure, rng, dt = STRUCTURES[name], np.random.default_rng(4), 0.004
    n = len(structure.mass)
    forces = random_forces(rng, 12, np.full(structure.force_map.shape[1], 30.0))
    start = 1e-3 * rng.standard_normal(2 * n)
    squares, vectors = scipy.linalg.eigh(structure.stiffness, structure.mass)
    inverse = np.linalg.inv(vectors)
    damping = inverse.T @ np.diag(2 * structure.damping_ratio * np.sqrt(squares)) @ inverse

    def motion(state, force):
        load = structure.force_map @ force - damping @ state[n:] - structure.stiffness @ state[:n]
        return np.linalg.solve(structure.mass, load)

    wanted, state = [], start
    for force in forces:
        wanted.append(structure.sensor_map @ motion(state, force))
        step = scipy.integrate.solve_ivp(
            lambda _, s, force=force: np.concatenate([s[n:], motion(s, force)]),
            (0.0, dt),
            state,
            method="DOP853",
            rtol=1e-11,
            atol=1e-13,
        )
        state = step.y[:, -1]
    np.testing.assert_allclose(structure.accelerations(forces, dt, start), wanted, atol=1e-8 * np.abs(wanted).max())


def test_modes_solve_the_eigenvalue_problem_and_are_scaled():
    for structure in STRUCTURES.values():
        frequencies, shapes = structure.modes()
        assert (np.diff(frequencies) > 0).all()
        np.testing.assert_allclose(np.abs(shapes).max(axis=0), 1.0)
        positions = np.linalg.lstsq(structure.sensor_map, shapes, rcond=None)[0]
        left = structure.stiffness @ positions - structure.mass @ positions * (2 * np.pi * frequencies) ** 2
        assert np.abs(left).max() < 1e-9 * np.abs(structure.stiffness @ positions).max()


def test_random_forces_have_the_levels_that_were_asked_for():
    forces = random_forces(np.random.default_rng(1), 40_000, np.array([3.0, 50.0]))
    np.testing.assert_allclose(forces.std(axis=0), [3.0, 50.0], rtol=0.02)


# --- the three-storey frame ------------------------------------------------------------------------------------------


def test_sensors_of_the_frame_read_the_motion_that_its_geometry_draws():
    """A twist of one floor, told to the geometry by the readings alone, moves all four corners as a rigid body."""
    geometry = read_specification(three_storey_frame.TEST_FILE).geometry
    coordinates = np.zeros(9)
    coordinates[3:6] = 0.02, -0.01, 0.05  # of the second floor
    readings = three_storey_frame.frame().sensor_map @ coordinates
    moved = geometry.deflection(readings.astype(complex), three_storey_frame.SENSORS).real
    for name, position, motion in zip(geometry.node_names, geometry.positions, moved, strict=True):
        expected = [0.02 - 0.05 * position[1], -0.01 + 0.05 * position[0], 0.0] if name.startswith("2") else [0, 0, 0]
        if len(name) == 1:  # a foot
            expected = [0, 0, 0]
        np.testing.assert_allclose(motion, expected, atol=1e-12)
    assert geometry.positions[:, 2].max() == pytest.approx(3 * three_storey_frame.PARTS.height)


def test_the_frame_is_found_as_it_is(frame_run):
    """All nine modes within 4 standard deviations and 0.1 %, damping within 10 %, shapes as they are."""
    status, folder = frame_run
    assert status == 0
    document = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    assert document["test"]["article"].startswith("three-storey frame")
    from modal.identification.result import load

    result, truth = load(folder / "result.npz"), three_storey_frame.truth()
    rows = compare_with_truth(truth, result.modes)
    assert [row.verdict for row in rows] == ["system"] * 9
    for row, mode in zip(rows, result.modes.system, strict=True):
        assert abs(row.found_frequency - row.frequency) < min(4 * mode.frequency_std, 1e-3 * row.frequency)
        assert row.found_damping_ratio == pytest.approx(row.damping_ratio, rel=0.1)
        assert row.assurance > 0.999


def test_the_measured_file_and_the_test_file_say_what_the_script_knows(frame_run):
    """A user goes on from here with `modal-report run frame.csv --test three_storey_frame.toml`."""
    _, folder = frame_run
    record = three_storey_frame.storeys_record(np.random.default_rng(1))
    read = read_record(folder / "frame.csv", inputs=["force 32X+", "force 23Y+"], input_hold="zero_order")
    assert (read.output_names, read.output_units) == (record.output_names, record.output_units)
    assert read.dt == pytest.approx(record.dt, rel=1e-6)
    np.testing.assert_allclose(read.outputs, record.outputs, rtol=1e-5, atol=1e-9)
    specification = read_specification(folder / "three_storey_frame.toml")
    assert len(specification.limits) == 5


def test_a_fan_in_the_way_of_a_mode_is_refused(frame_run, tmp_path):
    """The other side of the answer: the band moved to where a mode is."""
    from modal.identification.result import load

    text = three_storey_frame.TEST_FILE.read_text(encoding="utf-8").replace("[11.5, 12.5]", "[13.5, 14.5]")
    (tmp_path / "test.toml").write_text(text, encoding="utf-8")
    result = load(frame_run[1] / "result.npz")
    outcomes = check_limits(result, read_specification(tmp_path / "test.toml"))
    assert [outcome.state for outcome in outcomes] == ["not met", *["met"] * 4]
    words = three_storey_frame.summary((), outcomes)
    assert "4 of 5 limits are surely met: no, not as it stands" in words
    met = tuple(LimitOutcome(what=o.what, required="", found="", state="met", sentence="") for o in outcomes)
    assert "5 of 5 limits are surely met: yes, the fan may run" in three_storey_frame.summary((), met)


@pytest.fixture(scope="module")
def states():
    """Identifications before and after, of fresh records."""
    rng = np.random.default_rng(11)
    losses = (0.0, many_records.ROW.loss)
    orders = {"observer_order": 90, "ridge": 0.0, "order": 8}  # what a search takes
    return [identify(many_records.records_of(many_records.modules(loss=loss), rng), **orders) for loss in losses]


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
    assert many_records.main(["-o", str(tmp_path / "out")]) == 0
    before, after = (read_result(tmp_path / "out" / f"{name}.npz") for name in ("before", "after"))
    assert len(compare_results(before, after).pairs) == many_records.ROW.n_modules
    assert "2 of 4 matched modes" in (tmp_path / "out" / "comparison.html").read_text(encoding="utf-8")
    told = capsys.readouterr().out
    assert "2 of 4 matched modes changed beyond chance" in told
    assert "hidden: joint 3, 1.00 %" in told
    ready = iter(states)
    many_records.main(["-o", str(tmp_path / "out")])
    assert "not written: " in capsys.readouterr().out  # what is there is not touched


def test_a_folder_that_cannot_be_made_is_said(tmp_path, capsys):
    (tmp_path / "a").write_text("")
    print_written(lambda: [(tmp_path / "a" / "b").mkdir(parents=True)])
    assert "not written: " in capsys.readouterr().out


# --- a year of a bridge, six set-ups ---------------------------------------------------------------------------------


def test_a_year_of_a_bridge_finds_its_damage_within_days(tmp_path, capsys, monkeypatch):
    """The larger the damage the later it was seen: causes chosen without it were fitted to its step (day 256)."""
    told, study = [], year_of_a_bridge.study
    monkeypatch.setattr(year_of_a_bridge, "study", lambda rng: told.append(study(rng)) or told[-1])
    assert year_of_a_bridge.main(["-o", str(tmp_path / "out")]) == 0
    (tmp_path / "out" / "tracks.html").stat()
    assert f"since day {year_of_a_bridge.DAMAGE_DAY}" in capsys.readouterr().out
    (alarm,) = told[0].alarms
    start = year_of_a_bridge.DAMAGE_DAY * year_of_a_bridge.DAY
    assert 0 <= alarm.since - start <= alarm.time - start <= 4 * year_of_a_bridge.DAY


@pytest.mark.slow
def test_six_set_ups_give_one_mast(capsys):
    assert six_set_ups.main([]) == 0
    said = capsys.readouterr().out
    assert f"{six_set_ups.N_FLOORS} of {six_set_ups.N_FLOORS} modes found" in said
    assurances = [float(line.split()[-1]) for line in said.splitlines()[2:]]
    assert len(assurances) == six_set_ups.N_FLOORS
    assert min(assurances) > 0.999
