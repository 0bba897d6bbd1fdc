"""A sliding window: equal to the fit of its rows, stamped in its middle, with gaps, jumps and drifts said."""

import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
import scipy

import modal
from era.balanced import realise
from modal.command.main import status
from modal.command.many import _estimate_lines
from modal.command.stopping import Requests
from modal.modes.extraction import extract_modes
from modal.modes.mode import Mode
from modal.tracking.live import growing_blocks
from okid.errors import InvalidDataError, UnreadableFileError
from okid.markov import recover_markov
from okid.observer import fit_observer
from okid.record import Record

DT, N = 0.01, 6000


def driven(frequency, *, damping=0.01, n_samples=N, noise=0.0, seed=3):
    """A mode whose frequency [Hz] may be an array over the samples: modal state, turned sample by sample."""
    rng = np.random.default_rng(seed)
    frequency = np.broadcast_to(frequency, n_samples)
    force, state, tip = rng.standard_normal(n_samples), 0j, np.empty((n_samples, 2))
    for k in range(n_samples):
        tip[k] = state.real, 0.4 * state.imag + 0.2 * state.real
        state = np.exp((-damping + 1j) * 2 * np.pi * frequency[k] * DT) * (state + force[k])
    return force, tip + noise * tip.std(axis=0) * rng.standard_normal(tip.shape)


def blocks_of(force, tip, n_rows=150, start=0.0):
    return [
        Record(force[k : k + n_rows], tip[k : k + n_rows], DT, start_time=start + k * DT)
        for k in range(0, len(force) - n_rows + 1, n_rows)
    ]


@pytest.mark.parametrize("n_rows", [150, 4])
def test_each_window_is_the_fit_of_its_own_rows(n_rows):
    force, tip = driven(4.0, noise=0.05)
    force, tip = force[: 1500 + 30 * n_rows], tip[: 1500 + 30 * n_rows]
    blocks = blocks_of(force, tip, n_rows)
    found = list(modal.follow(blocks, dt=DT, window=15.0, observer_order=10, order=2, ridge=0.0))
    assert len(found) == 31
    for estimate in found[::7]:
        middle = round(estimate.time / DT)
        rows = slice(max(0, middle - 750 - 10 * (middle > 750)), middle + 750)
        observer = fit_observer(Record(force[rows], tip[rows], DT), order=10)
        (alone,) = extract_modes(realise(recover_markov(observer), order=2)).modes
        assert estimate.modes.modes[0].frequency == pytest.approx(alone.frequency, rel=1e-5)
        assert estimate.modes.modes[0].damping_ratio == pytest.approx(alone.damping_ratio, rel=1e-3)


def test_a_drift_is_followed_at_the_middle_of_the_window():
    truth = 4.0 * (1.0 + 0.01 / 60.0 * DT * np.arange(4 * N))  # 1 % a minute
    force, tip = driven(truth, n_samples=4 * N, damping=0.005)
    for estimate in modal.follow(blocks_of(force, tip), dt=DT, window=10.0, observer_order=8, order=2):
        (mode,) = estimate.modes.modes
        assert mode.frequency == pytest.approx(truth[round(estimate.time / DT)], rel=5e-4)
        assert estimate.warnings == ()


def test_a_mode_that_moves_within_the_window_is_smeared():
    force, tip = driven(np.where(np.arange(N) < N // 2, 4.0, 4.6))
    found = list(modal.follow(blocks_of(force, tip), dt=DT, window=10.0, observer_order=8, order=2))
    said = [estimate for estimate in found if estimate.warnings]
    assert "is smeared" in said[0].warnings[0]
    assert all(abs(estimate.time - 30.0) < 16.0 for estimate in said)
    assert found[-1].warnings == ()


def test_rows_after_a_gap_do_not_look_across_it():
    force, tip = driven(4.0)
    blocks = blocks_of(force, tip)
    del blocks[20:23]
    for estimate in modal.follow(blocks, dt=DT, window=15.0, observer_order=6, order=2):
        assert estimate.modes.modes[0].frequency == pytest.approx(4.0002, rel=1e-3)
        assert estimate.modes.modes[0].damping_ratio == pytest.approx(0.01, rel=1e-3)


def test_a_clock_that_jumps_starts_a_new_window():
    force, tip = driven(4.0)
    blocks = blocks_of(force[:3000], tip[:3000]) + blocks_of(force[3000:], tip[3000:], start=0.0)
    times = [estimate.time for estimate in modal.follow(blocks, dt=DT, window=15.0, observer_order=6, order=2)]
    assert times == pytest.approx([*np.arange(7.5, 22.6, 1.5), *np.arange(7.5, 22.6, 1.5)])


def test_missing_samples_and_channels_at_rest_do_not_stop_it():
    force, tip = driven(4.0)
    tip[2000:2040, 1] = np.nan
    force[3000:] = 0.0
    found = list(modal.follow(blocks_of(force, tip), dt=DT, window=10.0, observer_order=6, order=2))
    dampings = [one.modes.modes[0].damping_ratio for one in found if one.time < 25.0]
    assert dampings == pytest.approx([0.01] * len(dampings), rel=1e-3)
    assert "does not" in found[-1].warnings[0]
    assert len(found[-1].modes) == 0


@pytest.mark.parametrize("spike", [1e9, 1e149])
def test_a_spike_leaves_nothing_behind_once_it_is_out_of_the_window(spike):
    force, tip = driven(4.0, noise=0.05)
    spiked = tip.copy()
    spiked[2000, 0] = spike
    options = {"dt": DT, "window": 10.0, "observer_order": 8, "order": 2}
    without, found = (list(modal.follow(blocks_of(force, some), **options)) for some in (tip, spiked))
    for one, other in zip(without, found, strict=True):
        if other.time > 20.0 + 10.0 / 2 + 1.5:
            for mode, like in zip(one.modes.modes, other.modes.modes, strict=True):
                assert like.frequency == pytest.approx(mode.frequency, rel=1e-6)
                assert like.damping_ratio == pytest.approx(mode.damping_ratio, rel=1e-4)


def test_values_without_a_square_are_refused_in_words():
    force, tip = driven(4.0)
    tip[2000, 0] = 1e308
    with pytest.raises(InvalidDataError, match=r"squares of all values .* those of the block at 19\.5 s do not"):
        list(modal.follow(blocks_of(force, tip), dt=DT, window=10.0, observer_order=8, order=2))


def test_a_window_without_a_complete_row_says_so():
    force, tip = driven(4.0)
    tip[3000::2, 0] = tip[3001::2, 1] = np.nan
    *_, last = modal.follow(blocks_of(force, tip), dt=DT, window=10.0, observer_order=8, order=2)
    assert (len(last.modes), last.n_rows) == (0, 0)
    assert "no row of the window" in last.warnings[0]


def test_a_window_too_short_for_the_observer_says_what_it_needs():
    force, tip = driven(4.0, n_samples=300)
    with pytest.raises(InvalidDataError, match=r"window of at least 0\.82 s"):
        next(modal.follow(blocks_of(force, tip), dt=DT, window=0.3, observer_order=20))
    with pytest.raises(InvalidDataError, match="time step"):
        next(modal.follow([Record(force, tip, 0.02)], dt=DT, window=2.0, observer_order=5))


@pytest.mark.parametrize("block", [3, None, (np.zeros(9),), (np.zeros(9), np.zeros(9), 0.1)])
def test_a_block_that_is_no_pair_is_a_sentence(block):
    with pytest.raises(InvalidDataError, match=r"a block must be a record or a pair \(inputs, outputs\); give one"):
        next(modal.follow([block], dt=DT, window=2.0, observer_order=5))


DT_GROWING, N_GROWING = 0.01, 1500
STAMPS = DT_GROWING * np.arange(N_GROWING)


def motion(frequency=5.0, damping=0.02, n=N_GROWING):
    rng = np.random.default_rng(4)
    force = rng.standard_normal(n)
    pole = np.exp((-damping + 1j * np.sqrt(1 - damping**2)) * 2 * np.pi * frequency * DT_GROWING)
    tip = scipy.signal.lfilter([0, 1.0], [1, -2 * pole.real, abs(pole) ** 2], force)
    return force, tip + 0.01 * tip.std() * rng.standard_normal(n)


def lines_of(stamps, force, tip):
    return [f"{t:.4f},{1e-3 * f:.9g},{y:.9g}\n" for t, f, y in zip(stamps, force, tip, strict=True)]


@pytest.fixture
def writer():
    """Append pieces in a thread of its own, cut anywhere."""
    threads = []

    def write(path, pieces, pause=0.005):
        def run():
            for piece in pieces:
                with path.open("ab") as file:
                    file.write(piece)
                time.sleep(pause)

        threads.append(threading.Thread(target=run))
        threads[-1].start()

    yield write
    for thread in threads:
        thread.join()


def cut(text, size=3001):
    data = text.encode()
    return [data[k : k + size] for k in range(0, len(data), size)]


def test_every_row_of_a_growing_table_comes_once_in_si(tmp_path, writer):
    force, tip = motion()
    path = tmp_path / "run.csv"
    path.write_text("Time (s),force [kN],tip [m]\n")
    writer(path, cut("".join(lines_of(STAMPS, force, tip))))
    said = []
    blocks = list(growing_blocks(path, inputs="force", block=1.0, patience=0.5, tell=said.append))
    np.testing.assert_allclose(np.vstack([one.inputs for one in blocks])[:, 0], force, rtol=1e-8)
    np.testing.assert_allclose(np.vstack([one.outputs for one in blocks])[:, 0], tip, rtol=1e-8)
    assert {one.n_samples for one in blocks} == {100}
    np.testing.assert_allclose([one.start_time for one in blocks], np.arange(15.0), atol=1e-9)
    assert blocks[0].input_units == ("N",)
    assert len(said) == 1
    assert "has not grown for 0.5 s" in said[0]


def test_gaps_and_jumps_of_the_clock_are_said_and_followed(tmp_path):
    force, tip = motion()
    stamps = (
        STAMPS + np.where(np.arange(N_GROWING) >= 430, 0.7, 0.0) - np.where(np.arange(N_GROWING) >= 1000, 50.0, 0.0)
    )
    path = tmp_path / "run.csv"
    path.write_text("time,force,tip\n" + "".join(lines_of(stamps, force, tip)))
    said = []
    blocks = list(growing_blocks(path, inputs="force", block=1.0, patience=0.0, tell=said.append))
    assert sum(one.n_samples for one in blocks) == N_GROWING
    assert "0.7 s are missing before 5 s" in said[0]
    assert "the clock jumped back by 50 s" in said[1]
    for estimate in modal.follow(blocks, dt=DT_GROWING, window=3.0, observer_order=4, order=2):
        assert estimate.modes.modes[0].frequency == pytest.approx(5.0, rel=0.01)


def test_rows_behind_an_array_header_are_followed(tmp_path, writer):
    values = np.column_stack(motion())
    path = tmp_path / "run.npy"
    np.save(path, values[:30])
    writer(path, [values[30:777].tobytes()[:-5], values[30:777].tobytes()[-5:], values[777:].tobytes()])
    blocks = list(growing_blocks(path, inputs="column_0", dt=DT_GROWING, block=2.0, patience=0.5))
    np.testing.assert_array_equal(np.vstack([np.hstack([one.inputs, one.outputs]) for one in blocks]), values)
    with pytest.raises(InvalidDataError, match="--dt"):
        next(growing_blocks(path, inputs="column_0", block=2.0, patience=0.1))


@pytest.mark.parametrize(("name", "match"), [("run.mat", "cannot be followed"), ("none.csv", "does not exist")])
def test_what_cannot_be_followed_is_one_sentence(tmp_path, name, match):
    (tmp_path / "run.mat").write_bytes(b"MATLAB 5.0 MAT-file")
    with pytest.raises(UnreadableFileError, match=match):
        next(growing_blocks(tmp_path / name, inputs="force", block=1.0, patience=0.1))


def begun(path, text, **options):
    """The blocks of a file that holds this, of which the first one came."""
    path.write_text(text)
    blocks = growing_blocks(path, inputs="force", block=1.0, patience=20.0, **options)
    next(blocks)
    return blocks


def replaced(path, text):
    other = path.with_name("other.csv")
    other.write_text(text)
    other.replace(path)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda path, _text: path.unlink(), "run.csv was removed while it was followed"),
        (replaced, "run.csv was replaced by another file"),
        (lambda path, text: path.write_text(text[:3000]), "run.csv became shorter"),
        (lambda path, text: path.write_text(text.replace("0.", "1.")), "run.csv was written anew"),
    ],
)
def test_a_file_that_is_another_one_ends_in_one_sentence(tmp_path, change, match):
    lines = ["time,force,tip\n", *lines_of(STAMPS, *motion())]
    blocks = begun(tmp_path / "run.csv", "".join(lines[:700]))
    change(tmp_path / "run.csv", "".join(lines))
    with pytest.raises(UnreadableFileError, match=match):
        list(blocks)


def test_too_few_rows_are_one_sentence(tmp_path, capsys):
    (tmp_path / "run.csv").write_text("x" * 100)
    np.save(tmp_path / "run.npy", np.column_stack(motion())[:3])
    for name in ("run.csv", "run.npy"):
        with pytest.raises(InvalidDataError, match="holds fewer than the 20 rows"):
            list(growing_blocks(tmp_path / name, inputs="column_0", dt=DT_GROWING, block=1.0, patience=0.1))
        said = []
        stopped = growing_blocks(
            tmp_path / name, inputs="column_0", dt=DT_GROWING, block=1.0, tell=said.append, stop=lambda: True
        )
        assert not list(stopped)
        assert said == [f"stopped while {name} was growing."]
    assert status(["live", str(tmp_path / "run.csv"), "--inputs", "force", "--patience", "0.1"]) == 2
    assert "fewer than the 20 rows" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("torn", "words"),
    [
        ("4.02,rubbish,1\n", "line 404, column 'force' of run.csv holds 'rubbish' where a number is expected"),
        ("4.02,1.54.03,1,1\n", "line 404 of run.csv holds 4 cells, but the table has 3 columns"),
        ("4.0\n\n", "line 404 of run.csv holds 1 cells, but the table has 3 columns"),
        ("4.02,\0\0\0,1\n", "line 404, column 'force' of run.csv holds '\\x00\\x00\\x00' where a number is expected"),
    ],
)
def test_a_torn_line_is_missing_and_named_by_its_number_in_the_file(tmp_path, torn, words):
    """What a logger leaves that lost its power does not end the session, and every other row is there."""
    lines, said = ["time,force,tip\n", *lines_of(STAMPS, *motion())], []
    blocks = begun(tmp_path / "run.csv", "".join(lines[:401]), tell=said.append, stop=lambda: len(said) > 0)
    with (tmp_path / "run.csv").open("a") as file:
        file.write("".join(lines[401:403]) + torn + "".join(lines[404:701]))
    rest = list(blocks)
    assert said[0] == f"{words}; lines that are no row count as missing, here and later."
    assert sum(block.n_samples for block in rest) == 700 - 1 - 100
    assert any(text.startswith("0.01 s are missing before 4.03 s") for text in said)


def test_another_table_in_the_same_file_ends_in_one_sentence(tmp_path):
    lines = ["time,force,tip\n", *lines_of(STAMPS, *motion())]
    blocks = begun(tmp_path / "run.csv", "".join(lines[:401]))
    with (tmp_path / "run.csv").open("a") as file:
        file.write("time,tip,force\n" + "".join(lines[401:]))
    with pytest.raises(UnreadableFileError, match=r"line 402, column 'time' of run\.csv holds 'time' where a number"):
        list(blocks)


@pytest.mark.parametrize(
    ("cells", "first", "n_rows", "words"),
    [
        (",inf,", 5, 1, "row 6 of run.csv holds inf in 'force'; cells that are no measurement"),
        (",0,-1e308", 700, 3, "row 701 of run.csv holds -1e+308 in 'tip'; cells that are no measurement"),
        (",nan,nan", 700, 200, "rows 701 to 800 of run.csv hold no number of force and tip; rows without a channel"),
    ],
)
def test_what_is_no_measurement_is_missing_and_said_once(tmp_path, cells, first, n_rows, words):
    lines = lines_of(STAMPS, *motion())
    lines[first : first + n_rows] = [line.partition(",")[0] + cells + "\n" for line in lines[first : first + n_rows]]
    (tmp_path / "run.csv").write_text("time,force,tip\n" + "".join(lines))
    said = []
    blocks = list(growing_blocks(tmp_path / "run.csv", inputs="force", block=1.0, patience=0.0, tell=said.append))
    assert said[0] == f"{words} count as missing, here and later."
    assert said[1] == f"missing in run.csv: {words.partition('; ')[2]} ({n_rows})."
    assert len(said) == 3
    there = np.ones(N_GROWING, dtype=bool)
    there[first : first + n_rows] = n_rows < 100
    assert sum(one.n_samples for one in blocks) == there.sum()
    np.testing.assert_allclose([one.start_time for one in blocks], STAMPS[there][::100])
    *_, last = modal.follow(blocks, dt=DT_GROWING, window=3.0, observer_order=4, order=2)
    assert last.modes.modes[0].frequency == pytest.approx(5.0, rel=0.01)


def test_rows_without_a_time_leave_a_gap(tmp_path):
    lines = lines_of(STAMPS, 1e3 * motion()[0], motion()[1])
    for row in (0, 7, 700, 701, 900):
        lines[row] = "nan" + lines[row][lines[row].index(",") :]
    (tmp_path / "run.csv").write_text("time,force,tip\n" + "".join(lines))
    said = []
    blocks = list(growing_blocks(tmp_path / "run.csv", inputs="force", block=1.0, patience=0.0, tell=said.append))
    assert said[0].startswith("row 1 of run.csv has no time; rows")
    assert sum("no time" in text for text in said) == 1
    assert sum("are missing before" in text for text in said) == 3
    assert "rows without a time (5)." in said[-2]
    force = np.full(N_GROWING, np.nan)
    for one in blocks:
        at = round(one.start_time / DT_GROWING)
        force[at : at + one.n_samples] = one.inputs[:, 0]
    np.testing.assert_allclose(np.delete(force, [0, 7, 700, 701, 900]), np.delete(motion()[0], [0, 7, 700, 701, 900]))


def test_a_block_without_a_channel_keeps_the_time_of_rows_that_have_none(tmp_path):
    values = np.column_stack(motion())
    values[400:600, 1] = np.nan
    np.save(tmp_path / "run.npy", values)
    blocks = list(growing_blocks(tmp_path / "run.npy", inputs="column_0", dt=DT_GROWING, block=1.0, patience=0.0))
    np.testing.assert_allclose([one.start_time for one in blocks], [0, 1, 2, 3, *range(6, 15)], atol=1e-9)


def test_a_column_that_counts_the_rows_never_becomes_a_channel(tmp_path):
    lines = [f"{k},{line}" for k, line in enumerate(lines_of(STAMPS, *motion()))]
    (tmp_path / "run.csv").write_text(",time,force,tip\n" + "".join(lines))
    blocks = list(growing_blocks(tmp_path / "run.csv", inputs="force", block=1.0, patience=0.0))
    assert {one.output_names for one in blocks} == {("tip",)}


def test_lines_longer_than_the_head(tmp_path):
    names = [f"channel {'x' * 60} {k}" for k in range(1200)]
    row = ",".join(["1"] * 1201) + "\n"
    (tmp_path / "run.csv").write_text(",".join(["force", *names]) + "\n" + 30 * row)
    source = growing_blocks(
        tmp_path / "run.csv", inputs="force", outputs=names[0], dt=DT_GROWING, block=0.1, patience=0.3
    )
    assert sum(one.n_samples for one in source) == 30


def test_lines_end_between_modes_and_times_keep_their_digits():
    mode = Mode(
        pole=-1 + 9j, kind="oscillatory", frequency=1.44, damping_ratio=0.11, shape=np.ones(1), participation=np.ones(1)
    )
    estimate = SimpleNamespace(time=123456.25, modes=[mode] * 4)
    lines = _estimate_lines(estimate, width=50)
    assert [line[:14] for line in lines] == [" 123456.25 s: ", " " * 14]
    assert [line[14:] for line in lines] == ["1.44 Hz 11 %, 1.44 Hz 11 %,", "1.44 Hz 11 %, 1.44 Hz 11 %"]


def test_the_command_writes_modes_against_time_into_a_recording(tmp_path, writer, capsys):
    force, tip = motion()
    path = tmp_path / "run.csv"
    path.write_text("time,force,tip\n")
    writer(path, cut("".join(lines_of(STAMPS, 1e3 * force, tip))))
    options = ["--inputs", "force", "--window", "5", "--patience", "0.5", "--observer-order", "4", "--order", "2"]
    assert status(["live", str(path), *options, "--recording", str(tmp_path / "live.rrd")]) == 0
    shown = capsys.readouterr().out
    found = [float(line.split()[2]) for line in shown.splitlines() if " Hz " in line]
    assert len(found) >= 10
    np.testing.assert_allclose(found, 5.0, rtol=0.01)
    assert "middle of the window: frequency and damping ratio" in shown
    assert "has not grown" in shown
    assert (tmp_path / "live.rrd").stat().st_size > 1000
    assert status(["live", str(path), *options[:2], "--window", "100", "--patience", "0.2", *options[6:]]) == 1


def test_a_session_stopped_before_its_first_rows_is_no_fault(tmp_path, monkeypatch):
    (tmp_path / "run.csv").write_text("time,force,tip\n")
    monkeypatch.setattr(Requests, "asked", 0)
    monkeypatch.setattr("modal.tracking.live.time.sleep", lambda _seconds: Requests.note(2, None))
    assert status(["live", str(tmp_path / "run.csv"), "--inputs", "force"]) == 130
