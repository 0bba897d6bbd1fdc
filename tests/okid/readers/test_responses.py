"""Frequency responses from files: what is written is read again, and damage is said."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.io

from okid.errors import InvalidDataError, UnreadableFileError
from okid.frequency_response import FrequencyResponse
from okid.readers import read_record
from okid.readers.response import holds_responses, read_response
from okid.readers.uff import write_response

pyuff = pytest.importorskip("pyuff")
RNG = np.random.default_rng(4)
LINES = np.arange(33) * 0.5


@pytest.fixture
def table():
    response = RNG.standard_normal((33, 3, 2)) + 1j * RNG.standard_normal((33, 3, 2))
    return FrequencyResponse(
        response,
        LINES,
        coherence=RNG.uniform(0.2, 1.0, (33, 3)),
        n_averages=40,
        window="hann",
        output_names=["1Z+", "22RX-", "the tip of the blade"],
        input_names=["hammer", "7Y-"],
        output_units=["m/s^2", "m", ""],
        input_units=["N", ""],
    )


def same(one, other):
    np.testing.assert_allclose(one.response, other.response, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(one.frequencies, other.frequencies, rtol=1e-5)
    for name in ("window", "n_averages", "input_names", "output_names", "input_units", "output_units"):
        assert getattr(one, name) == getattr(other, name), name


def test_a_universal_file_gives_back_what_was_written(table, tmp_path):
    path = write_response(table, tmp_path / "frf.uff")
    again = read_response(path)
    same(again, table)
    np.testing.assert_allclose(again.coherence, table.coherence, rtol=1e-11)
    assert holds_responses(path)
    with pytest.raises(InvalidDataError, match="exists already"):
        write_response(table, path)
    with pytest.raises(UnreadableFileError, match="frequency response function"):
        read_record(path)


@pytest.mark.parametrize("overlap", [None, 0.0, 0.5, 2 / 3, 0.99999999])
def test_a_universal_file_keeps_how_far_blocks_overlap(overlap, table, tmp_path):
    again = read_response(write_response(replace(table, overlap=overlap), tmp_path / "frf.uff"))
    assert again.overlap == (None if overlap is None else pytest.approx(overlap, abs=1.1e-6))
    assert (again.window, again.n_averages) == ("hann", 40)


def test_an_overlap_in_percent_is_refused_with_the_share_that_it_is(table, tmp_path):
    """In a file of another program it may be samples or percent: such a file was read before there was this name."""
    np.savez(tmp_path / "frf.npz", f=LINES, frf=table.response, overlap=50)
    with pytest.raises(InvalidDataError, match=r"0\.5 for 50 %"):
        replace(table, overlap=50)
    with pytest.raises(InvalidDataError, match=r"0\.5 for 50 %"):
        read_response(tmp_path / "frf.npz", overlap=50)
    assert read_response(tmp_path / "frf.npz").overlap is None
    np.savez(tmp_path / "frf.npz", f=LINES, frf=table.response, overlap=0.75)
    assert read_response(tmp_path / "frf.npz").overlap == 0.75


def test_uneven_lines_and_single_coherences_are_kept(table, tmp_path):
    uneven = FrequencyResponse(
        table.response,
        LINES**1.3,
        coherence=RNG.uniform(0, 1, (33, 3, 2)),
        output_units=table.output_units,
        output_names=table.output_names,
        input_names=table.input_names,
        input_units=table.input_units,
    )
    again = read_response(write_response(uneven, tmp_path / "frf.uff"))
    same(again, uneven)
    np.testing.assert_allclose(again.coherence, uneven.coherence, rtol=1e-11)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # pyuff leaves its file open
@pytest.mark.parametrize("binary", [0, 1])
def test_functions_that_another_program_wrote(binary, tmp_path):
    values = RNG.standard_normal((4, 20)) + 1j * RNG.standard_normal((4, 20))
    path = tmp_path / "others.uff"
    for index, (rsp, ref) in enumerate([(1, 3), (2, 3), (1, 4), (2, 4)]):
        function = pyuff.prepare_58(
            binary=binary,
            func_type=4,
            rsp_node=rsp,
            rsp_dir=3,
            ref_node=ref,
            ref_dir=-1,
            data=values[index],
            x=10 + 2.0 * np.arange(20),
            id1="id",
            rsp_ent_name="NONE",
            ref_ent_name="NONE",
            abscissa_spacing=1,
            abscissa_spec_data_type=18,
            ordinate_spec_data_type=12,
            orddenom_spec_data_type=13,
            ordinate_axis_units_lab="g",
            orddenom_axis_units_lab="lbf",
        )
        pyuff.UFF(str(path))._write_set(function, "add")
    found = read_response(path)
    assert found.output_names == ("1Z+", "2Z+")
    assert found.input_names == ("3X-", "4X-")
    assert (found.output_units, found.input_units) == (("m/s^2",) * 2, ("N",) * 2)
    np.testing.assert_allclose(found.frequencies, 10 + 2.0 * np.arange(20))
    factor = 9.80665 / 4.4482216152605
    np.testing.assert_allclose(found.response[:, 1, 0], factor * values[1], rtol=1e-5)
    np.testing.assert_allclose(found.response[:, 0, 1], factor * values[2], rtol=1e-5)


@pytest.mark.parametrize(("number", "window"), [(1, "hann"), (3, "flattop"), (4, "unknown"), (0, "unknown")])
def test_the_window_that_a_set_1858_states(number, window, table, tmp_path):
    plain = FrequencyResponse(table.response[:, :1, :1], LINES)
    path = write_response(plain, tmp_path / "frf.uff")
    text = path.read_text().replace("averages 0; window unknown", "NONE")
    rows = [f"{1:12d}" + f"{0:12d}" * 5, f"{0:6d}{number:6d}" + f"{0:6d}" * 10]
    rows += ["".join(f"{0.0:15.7e}" for _ in range(5))] * 3 + ["   0 1   0 1", "NONE"]
    path.write_text(text + "\n".join(["    -1", "  1858", *rows, "    -1"]) + "\n")
    assert read_response(path).window == window
    assert read_response(path, window="uniform", n_averages=7).n_averages == 7


@pytest.mark.parametrize("ending", ["npz", "mat"])
def test_named_arrays(ending, table, tmp_path):
    path = tmp_path / f"frf.{ending}"
    contents = {
        "freq": LINES,
        "FRF": table.response,
        "coherence": table.coherence,
        "window": "hann",
        "n_averages": 40,
        "output_names": np.array(table.output_names, dtype=object if ending == "mat" else None),
        "input_names": np.array(table.input_names, dtype=object if ending == "mat" else None),
        "output_units": np.array(["mm"] * 3, dtype=object if ending == "mat" else None),
    }
    if ending == "mat":
        scipy.io.savemat(path, contents)
    else:
        np.savez(path, **contents)
    found = read_response(path)
    np.testing.assert_allclose(found.response, 1e-3 * table.response, rtol=1e-14)
    assert found.output_names == table.output_names
    assert (found.window, found.n_averages, found.output_units) == ("hann", 40, ("m",) * 3)
    assert holds_responses(path)
    chosen = read_response(path, outputs=["22RX-"], inputs=["hammer"])
    np.testing.assert_array_equal(chosen.response[:, 0, 0], found.response[:, 1, 0])


def test_text_tables_in_both_forms(table, tmp_path):
    h = table.response[:, :, 0]
    head = "frequency [kHz]; tip/hammer re [g/N]; tip/hammer im [g/N]; a/hammer magnitude [m/N]; a/hammer phase [deg]"
    rows = [
        f"{f / 1000!r};{a.real!r};{a.imag!r};{abs(b)!r};{float(np.degrees(np.angle(b)))!r}"
        for f, a, b in zip(LINES.tolist(), h[:, 0].tolist(), h[:, 1].tolist(), strict=True)
    ]
    path = tmp_path / "frf.csv"
    path.write_text("\n".join([head, *rows]))
    found = read_response(path)
    np.testing.assert_allclose(found.frequencies, LINES)
    np.testing.assert_allclose(found.response[:, 0, 0], 9.80665 * h[:, 0], rtol=1e-12)
    np.testing.assert_allclose(found.response[:, 1, 0], h[:, 1], rtol=1e-12)
    assert (found.output_names, found.input_names) == (("tip", "a"), ("hammer",))
    assert (found.output_units, found.input_units) == (("m/s^2", "m"), ("N",))
    assert holds_responses(path)


@pytest.mark.parametrize(
    ("head", "words"),
    [
        ("time,tip re,tip im", "no column called frequency"),
        ("frequency [Hz],tip re,roof im", "has the columns"),
        ("frequency [Hz],tip magnitude,tip phase", r"\[deg\] or \[rad\]"),
        ("frequency [Hz],tip magnitude [dB],tip phase [deg]", "dB"),
        ("frequency [Hz],tip re [m/N],tip im [g/N]", "different units"),
        ("frequency [m],tip re,tip im", "no frequency"),
        ("frequency [Hz],tip re,tip", "which part"),
    ],
)
def test_tables_that_do_not_say_what_they_hold(head, words, tmp_path):
    path = tmp_path / "frf.csv"
    path.write_text(head + "\n" + "\n".join(f"{k},1.0,{k}" for k in range(5)))
    with pytest.raises(UnreadableFileError, match=words):
        read_response(path)


def test_columns_that_are_called_no_more_than_their_part(tmp_path):
    path = tmp_path / "one.csv"
    path.write_text("freq,Re,Im,coherence\n0,1,0,1\n1,2,-3,0.5\n")
    found = read_response(path)
    np.testing.assert_array_equal(found.response.ravel(), [1, 2 - 3j])
    np.testing.assert_array_equal(found.coherence.ravel(), [1, 0.5])
    assert holds_responses(path)
    path.write_text("time,f,magnitude\n0,1,0\n1,2,3\n")
    assert not holds_responses(path)


def test_damaged_files_are_refused_or_read_as_they_are(table, tmp_path):
    """A byte changed or the end cut off: another table of numbers that the bytes say, or one sentence."""
    whole = write_response(table, tmp_path / "whole.uff").read_bytes()
    np.savez(tmp_path / "whole.npz", frequencies=LINES, response=table.response)
    originals = {".uff": whole, ".npz": (tmp_path / "whole.npz").read_bytes()}
    rng = np.random.default_rng(11)
    n_refused = 0
    for number in range(300):
        ending = (".uff", ".npz")[number % 2]
        data = bytearray(originals[ending])
        if number % 3 == 0:
            data = data[: rng.integers(1, len(data))]
        else:
            for at in rng.integers(0, len(data), 1 + number % 4):
                data[at] = rng.integers(0, 256)
        path = tmp_path / f"damaged{ending}"
        path.write_bytes(bytes(data))
        try:
            found = read_response(path)
        except UnreadableFileError:
            n_refused += 1
            continue
        assert np.isfinite(found.response[~np.isnan(found.response)]).all()
    assert n_refused > 100


@pytest.mark.parametrize(
    ("unit", "output", "into", "factor"),
    [
        ("kN/(mm/s^2)", "N", "m/s^2", 1e6),
        ("N/m", "N", "m", 1.0),
        ("(mm/s^2)/N", "m/s^2", "N", 1e-3),
        ("mm/s^2/kN", "m/s^2", "N", 1e-6),
        ("N/g", "N", "m/s^2", 1 / 9.80665),
        ("m/(s^2)", "m/s^2", "", 1.0),
    ],
)
def test_the_unit_of_a_quotient_is_taken_apart(unit, output, into, factor, tmp_path):
    header = f"frequency [Hz],a1/f re [{unit}],a1/f im [{unit}]\n"
    (tmp_path / "frf.csv").write_text(header + "".join(f"{line},{line + 1},0\n" for line in range(8)))
    read = read_response(tmp_path / "frf.csv")
    assert (read.output_units, read.input_units) == ((output,), (into,))
    np.testing.assert_allclose(read.response[:, 0, 0], factor * np.arange(1, 9))
