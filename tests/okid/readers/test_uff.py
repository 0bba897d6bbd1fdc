"""Universal files: written by pyuff, by hand after the definition of data set 58, and measured ones."""

import struct

import numpy as np
import pytest
import pyuff

from okid.errors import IdentificationWarning, InvalidDataError, UnreadableFileError
from okid.readers import describe_file, read_described, read_record, read_records
from okid.readers.response import read_response

RNG = np.random.default_rng(10)
N_SAMPLES = 64
TIPS = RNG.standard_normal((N_SAMPLES, 3))


def write(path, *, values=TIPS, dt=0.01, binary=0, func_type=1, spacing=1, **extra):
    """One data set a channel, written by pyuff."""
    file = pyuff.UFF(str(path))
    for index, channel in enumerate(values.T):
        data_set = pyuff.prepare_58(
            binary=binary,
            func_type=func_type,
            rsp_node=index + 11,
            rsp_dir=[1, -3, 2][index % 3],
            ref_node=0,
            ref_dir=0,
            data=channel.copy(),
            x=dt * np.arange(len(channel)),
            id1="a run",
            rsp_ent_name="NONE",
            ref_ent_name="NONE",
            abscissa_spacing=spacing,
            abscissa_spec_data_type=17,
            ordinate_spec_data_type=12,
            orddenom_spec_data_type=0,
        )
        data_set.update({"ordinate_axis_units_lab": "g", "ordinate_axis_lab": "Acc"} | extra)
        file.write_sets([data_set], "add")
    return path


@pytest.mark.filterwarnings("ignore::ResourceWarning")  # pyuff's writer of binary sets leaves its file open
@pytest.mark.parametrize("binary", [0, 1])
def test_channels_are_named_by_place(tmp_path, binary):
    path = write(tmp_path / "a.uff", binary=binary)
    record = read_record(path, inputs="11X+")
    assert (record.input_names, record.output_names) == (("11X+",), ("12Z-", "13Y+"))
    assert record.output_units == ("m/s^2", "m/s^2")
    assert record.dt == pytest.approx(0.01)
    np.testing.assert_allclose(record.outputs, 9.80665 * TIPS[:, 1:], rtol=1e-9)


@pytest.mark.filterwarnings("ignore::ResourceWarning")  # pyuff's writer of binary sets leaves its file open
@pytest.mark.parametrize("binary", [0, 1])
def test_uneven_abscissa_is_a_time_column(tmp_path, binary):
    record = read_record(write(tmp_path / "a.unv", binary=binary, spacing=0))
    assert record.dt == pytest.approx(0.01)
    np.testing.assert_allclose(record.outputs, 9.80665 * TIPS, rtol=1e-9)


def hand_written(
    values,
    *,
    big_endian=False,
    double=False,
    node=1,
    name="NONE",
    label="Acceleration",
    unit="m/s2",
    quantity=12,
    stated=(),
    n_stated=None,
    behind=b"",
):
    """Data set 58b after its published definition, as analysers write it: the data end in a line end of their own."""
    order = ">" if big_endian else "<"
    n_stated = len(values) if n_stated is None else n_stated
    data = struct.pack(f"{order}{len(values)}{'d' if double else 'f'}", *values)
    storage = {"order": 2 if big_endian else 1, "form": 2, "n_bytes": len(data)} | dict(stated)
    lines = [
        f"{-1:6d}",
        f"{58:6d}b{storage['order']:6d}{storage['form']:6d}{11:12d}{storage['n_bytes']:12d}{0:6d}{0:6d}{0:12d}{0:12d}",
        *("run", "NONE", "08-Oct-24 10:27:07", "NONE", "NONE"),
        f"{1:5d}{0:10d}{0:5d}{0:10d} {name:<10s}{node:10d}{3:4d} {'NONE':<10s}{0:10d}{0:4d}",
        f"{4 if double else 2:10d}{n_stated:10d}{1:10d}{2.0:13.5E}{0.125:13.5E}{0.0:13.5E}",
        f"{17:10d}{0:5d}{0:5d}{0:5d} {'Time':<20s} {'s':<20s}",
        f"{quantity:10d}{0:5d}{0:5d}{0:5d} {label:<20s} {unit:<20s}",
        *[f"{0:10d}{0:5d}{0:5d}{0:5d} {'NONE':<20s} {'NONE':<20s}"] * 2,
    ]
    return "".join(f"{line}\r\n" for line in lines).encode() + data + behind + b"\r\n    -1\r\n"


@pytest.mark.parametrize("big_endian", [False, True])
@pytest.mark.parametrize("double", [False, True])
def test_binary_sets_by_their_definition(tmp_path, big_endian, double):
    path = tmp_path / "a.ufb"
    sets = [hand_written(TIPS[:, i], big_endian=big_endian, double=double, node=i + 1) for i in range(3)]
    path.write_bytes(b"".join(sets))
    record = read_record(path)
    assert record.output_names == ("1Z+", "2Z+", "3Z+")
    assert (record.dt, record.start_time) == (0.125, 2.0)
    np.testing.assert_array_equal(record.outputs, TIPS if double else TIPS.astype(np.float32))


def test_names_where_the_place_does_not_tell(tmp_path):
    path = tmp_path / "a.uff"
    path.write_bytes(hand_written(TIPS[:, 0], unit="N", label="Force") + hand_written(TIPS[:, 1]))
    assert read_record(path).output_names == ("1Z+ Force", "1Z+ Acceleration")
    path.write_bytes(hand_written(TIPS[:, 0], node=0, name="mic 1") + hand_written(TIPS[:, 1], node=0, name="mic 2"))
    assert read_record(path).output_names == ("mic 1", "mic 2")
    path.write_bytes(hand_written(TIPS[:, 0]) * 2)
    assert read_record(path).output_names == ("1Z+_0", "1Z+_1")


def test_no_unit_label(tmp_path):
    path = tmp_path / "a.uff"
    path.write_bytes(hand_written(TIPS[:, 0], unit="NONE"))
    assert read_record(path).output_units == ("",)
    units = pyuff.prepare_164(
        units_code=1, units_description="SI", temp_mode=1, length=1.0, force=1.0, temp=1.0, temp_offset=273.15
    )
    pyuff.UFF(str(path)).write_sets([units], "add")
    assert read_record(path).output_units == ("m/s^2",)


@pytest.mark.parametrize("cut", [5, 9, 40, 200, 500, 700, 1000])
@pytest.mark.parametrize("binary", [False, True])
def test_cut_off(tmp_path, binary, cut):
    path = tmp_path / "a.uff"
    if binary:
        path.write_bytes(hand_written(TIPS[:, 0], node=1) + hand_written(TIPS[:, 1], node=2))
    else:
        write(path)
    path.write_bytes(path.read_bytes()[:-cut])
    with pytest.raises(UnreadableFileError, match="cut off"):
        read_record(path)


@pytest.mark.parametrize("missing", [8, 100])
def test_data_missing_in_the_middle(tmp_path, missing):
    whole = hand_written(TIPS[:, 0])
    (tmp_path / "a.uff").write_bytes(whole[: -missing - 10] + whole[-10:])
    with pytest.raises(UnreadableFileError, match=r"announces 64 samples but holds \d+"):
        read_record(tmp_path / "a.uff")


def announcing(path, n_samples):
    """The file with another number of samples in its head."""
    path.write_bytes(path.read_bytes().replace(b"%10d" % N_SAMPLES, b"%10d" % n_samples))
    return path


@pytest.mark.parametrize("n_stated", [61, 60, 1, 0, -5])
@pytest.mark.parametrize("binary", [False, True])
def test_more_values_than_announced(tmp_path, binary, n_stated):
    path = tmp_path / "a.uff"
    if binary:
        path.write_bytes(hand_written(TIPS[:, 0], n_stated=n_stated))
    else:
        announcing(write(path, values=TIPS[:, :1]), n_stated)
    with pytest.raises(UnreadableFileError, match=rf"data set 1 of a.uff announces {n_stated} samples but holds 64: "):
        read_record(path)


@pytest.mark.parametrize("n_samples", [64, 62])
def test_a_line_that_stands_twice(tmp_path, n_samples):
    lines = write(tmp_path / "a.uff", values=TIPS[:n_samples, :1]).read_bytes().splitlines(keepends=True)
    (tmp_path / "a.uff").write_bytes(b"".join([*lines[:20], lines[19], *lines[20:]]))
    with pytest.raises(UnreadableFileError, match=rf"announces {n_samples} samples but holds {n_samples + 4}: "):
        read_record(tmp_path / "a.uff")


def test_what_fills_up_the_end_is_no_value(tmp_path):
    """Zeros in the last line: https://github.com/ladisk/pyuff/issues/22."""
    path = write(tmp_path / "a.uff", values=np.vstack([TIPS[:62, :1], np.zeros((2, 1))]))
    np.testing.assert_allclose(read_record(announcing(path, 62)).outputs, 9.80665 * TIPS[:62, :1], rtol=1e-9)
    with pytest.raises(UnreadableFileError, match="announces 60 samples but holds 64"):
        read_record(announcing(write(tmp_path / "b.uff", values=np.vstack([TIPS[:60], np.zeros((4, 3))])), 60))
    path.write_bytes(hand_written(TIPS[:, 0], double=True, behind=b"\r\n" + b" " * 14))
    np.testing.assert_array_equal(read_record(path).outputs, TIPS[:, :1])


@pytest.mark.parametrize(
    ("stated", "words"),
    [
        ({"n_bytes": 0}, "announces 0 bytes, but its 64 samples are 256"),
        ({"n_bytes": -8}, "announces -8 bytes"),
        ({"n_bytes": 10**11}, "announces 100000000000 bytes"),
        ({"order": 9}, "byte order 9"),
        ({"form": 1}, "number format 1"),
    ],
)
def test_binary_values_that_are_stored_otherwise_than_stated(tmp_path, stated, words):
    (tmp_path / "a.uff").write_bytes(hand_written(TIPS[:, 0], stated=stated))
    with pytest.raises(UnreadableFileError, match=words):
        read_record(tmp_path / "a.uff")


@pytest.mark.filterwarnings("ignore::ResourceWarning")  # pyuff's writer of binary sets leaves its file open
@pytest.mark.parametrize("spacing", [0, 1])
def test_binary_responses_count_their_bytes_as_pyuff_does(tmp_path, spacing):
    values = TIPS[:, :1] + 1j * TIPS[:, 1:2]
    path = write(tmp_path / "a.uff", values=values, func_type=4, binary=1, spacing=spacing)
    np.testing.assert_allclose(read_response(path).response[:, 0], 9.80665 * values, rtol=1e-9)
    with pytest.raises(UnreadableFileError, match="announces 60 samples but holds 64"):
        read_response(announcing(path, 60))
    path.write_bytes(path.read_bytes().replace(b"%10d%10d" % (6, 60), b"%10d%10d" % (3, 60)))
    with pytest.raises(UnreadableFileError, match="ordinates of type 3"):
        read_response(path)


@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_doubles_that_are_said_to_be_singles(tmp_path):
    """So pyuff writes binary sets when it is asked for singles."""
    file = pyuff.UFF(str(tmp_path / "a.uff"))
    data_set = pyuff.UFF(str(write(tmp_path / "b.uff", values=TIPS[:, :1]))).read_sets(0)
    file.write_sets([data_set | {"binary": 1, "ord_data_type": 2}], "add", force_double=False)
    with pytest.raises(UnreadableFileError, match="announces 64 samples but holds 128"):
        read_record(tmp_path / "a.uff")


def test_a_step_that_is_no_number(tmp_path):
    path = write(tmp_path / "a.uff")
    path.write_bytes(path.read_bytes().replace(b"1.00000e-02", b"        nan"))
    with pytest.raises(UnreadableFileError, match="0 as the start of its axis and nan as its step"):
        read_record(path)


def test_different_time_axes(tmp_path):
    path = tmp_path / "a.uff"
    path.write_bytes(hand_written(TIPS[:, 0], node=1) + hand_written(TIPS[:50, 1], node=2))
    with pytest.raises(UnreadableFileError, match=r"'1Z\+' and '2Z\+' of .* different time axes: 64 and 50 samples"):
        read_record(path)


@pytest.mark.parametrize(("func_type", "words"), [(4, "frequency response function"), (9, "power spectral density")])
def test_other_functions_are_refused_by_name(tmp_path, func_type, words):
    path = write(tmp_path / "a.uff", func_type=func_type)
    with pytest.raises(UnreadableFileError, match=f"no time history, but 3 of the kind {words}"):
        read_record(path)


def test_other_functions_beside_time_histories_are_left_out(tmp_path):
    write(tmp_path / "b.uff", func_type=4, values=TIPS[:, :1])
    path = write(tmp_path / "a.uff")
    path.write_bytes((tmp_path / "b.uff").read_bytes() + path.read_bytes())
    assert read_record(path).n_outputs == 3
    assert "data set 1 left out: it is a frequency response function" in str(describe_file(path))


@pytest.mark.parametrize(
    "content", [b"    -1\n   151\nhi\n    -1\n", b"hi\n    -1\n", b"hi", b"    -1\n    58\n\n    -1\n"]
)
def test_no_measurement(tmp_path, content):
    (tmp_path / "a.uff").write_bytes(content)
    with pytest.raises(UnreadableFileError, match=r"holds no data set 58|does not end with|damaged"):
        read_record(tmp_path / "a.uff")


def test_given_step_must_agree(tmp_path):
    with pytest.warns(IdentificationWarning, match=r"dt = 0\.02 s was given"):
        assert read_record(write(tmp_path / "a.uff"), dt=0.02).dt == 0.02


def test_the_file_says_which_channel_is_the_force(tmp_path):
    """A hammer at the sensors' own places: each force is an input, each sensor has one name in all files."""
    files = []
    for node in (11, 12):
        path = write(tmp_path / f"at_{node}.uff", values=TIPS[:, :2])
        force = pyuff.prepare_58(
            binary=0, func_type=1, rsp_node=node, rsp_dir=1 if node == 11 else -3, ref_node=0, ref_dir=0,
            data=TIPS[:, 2].copy(), x=0.01 * np.arange(N_SAMPLES), id1="hammer", rsp_ent_name="NONE",
            ref_ent_name="NONE", abscissa_spacing=1, abscissa_spec_data_type=17, ordinate_spec_data_type=13,
            orddenom_spec_data_type=0,
        )  # fmt: skip
        force.update({"ordinate_axis_units_lab": "N", "ordinate_axis_lab": "Force"})
        pyuff.UFF(str(path)).write_sets([force], "add")
        files.append(path)
    records = read_records(files)
    assert [record.input_names for record in records] == [("force 11X+", "force 12Z-")] * 2
    assert [record.output_names for record in records] == [("11X+", "12Z-")] * 2
    assert [record.inputs.any(axis=0).tolist() for record in records] == [[True, False], [False, True]]
    assert read_record(files[0], outputs=["11X+", "force 11X+"]).output_names == ("11X+", "force 11X+")


def test_a_file_of_the_force_and_a_file_of_the_answers_are_one_record(tmp_path):
    answers = write(tmp_path / "answers.uff", values=TIPS[:, :2])
    force = write(tmp_path / "force.uff", values=TIPS[:, 2:], ordinate_spec_data_type=13, ordinate_axis_units_lab="N")
    (record,) = read_records([answers, force])
    assert (record.input_names, record.output_names) == (("force 11X+",), ("11X+", "12Z-"))


def force(values, **options):
    return hand_written(values, **{"unit": "N", "label": "Force", "quantity": 13} | options)


def test_a_file_of_several_hits_states_no_inputs(tmp_path):
    """Force and answer of two hits: each answer is none to the other force."""
    path = tmp_path / "a.uff"
    path.write_bytes((force(TIPS[:, 0]) + hand_written(TIPS[:, 1], node=2)) * 2)
    with pytest.warns(IdentificationWarning, match="several hits.* one file for each hit, or name the inputs"):
        assert read_record(path).input_names == ()
    assert "holds force at 1Z+ 2 times" in str(describe_file(path))
    assert read_record(path, inputs=["1Z+_0"], outputs=["2Z+_1"]).input_names == ("1Z+_0",)
    nowhere = {"node": 0, "name": "NONE"}
    path.write_bytes((force(TIPS[:, 0], **nowhere) + hand_written(TIPS[:, 1], **nowhere)) * 2)
    with pytest.warns(IdentificationWarning, match="several hits"):
        assert read_record(path).input_names == ()


def test_sensors_that_nobody_named_are_not_several_hits(tmp_path):
    path = tmp_path / "a.uff"
    path.write_bytes(force(TIPS[:, 0], node=0) + hand_written(TIPS[:, 1], node=0) + hand_written(TIPS[:, 2], node=0))
    assert read_record(path).input_names == ("channel_0",)
    path.write_bytes(force(TIPS[:, 0]) + hand_written(TIPS[:, 1]) + hand_written(TIPS[:, 2], quantity=11, label="Vel"))
    assert read_record(path).input_names == ("1Z+ Force",)


def test_a_force_in_a_unit_of_motion_is_no_input(tmp_path):
    path = tmp_path / "a.uff"
    path.write_bytes(force(TIPS[:, 0]) + hand_written(TIPS[:, 1], node=2, quantity=13, unit="m/s^2"))
    with pytest.warns(
        IdentificationWarning, match=r"2Z\+ is stated as a force but in m/s\^2, .* not taken as an input"
    ):
        record = read_record(path)
    assert (record.input_names, record.output_names) == (("force 1Z+",), ("2Z+",))
    path.write_bytes(force(TIPS[:, 0], unit="lbf") + force(TIPS[:, 1], node=2, unit="mV") + hand_written(TIPS[:, 2]))
    assert read_record(path).input_names == ("force 1Z+", "force 2Z+")


def test_blows_whose_files_call_one_sensor_differently_are_not_joined(tmp_path):
    """Two quantities at the place of the first blow: its file names the quantity, the other need not."""
    first, second = tmp_path / "a.uff", tmp_path / "b.uff"
    first.write_bytes(force(TIPS[:, 0]) + hand_written(TIPS[:, 1]) + hand_written(TIPS[:, 2], quantity=11, label="Vel"))
    second.write_bytes(force(TIPS[:, 0], node=2) + hand_written(TIPS[:, 1]))
    words = r"both hold acceleration at 1Z\+, under the names '1Z\+ Acceleration' and '1Z\+'.* same quantities"
    with pytest.raises(InvalidDataError, match=words):
        read_records([first, second])
    second.write_bytes(hand_written(TIPS[:, 1], node=2))
    (record,) = read_records([first, second])  # nothing was measured twice
    assert record.n_outputs == 3


def test_stated_forces_that_naming_the_outputs_drops_are_remarked(tmp_path):
    path = tmp_path / "a.uff"
    path.write_bytes(force(TIPS[:, 0]) + hand_written(TIPS[:, 1], node=2))
    (record,), (described,) = read_described(path, outputs="2Z+")
    assert record.n_inputs == 0
    assert "states force 1Z+ as inputs, and only outputs were named" in str(described)
    for names in ({}, {"outputs": "*"}, {"inputs": "force*", "outputs": "2Z+"}):
        assert not read_described(path, **names)[1][0].remarks
    assert read_record(path, outputs="*").output_names == ("force 1Z+", "2Z+")


def test_a_file_of_forces_alone_says_the_way_out(tmp_path):
    path = tmp_path / "a.uff"
    path.write_bytes(force(TIPS[:, 0]))
    with pytest.raises(InvalidDataError, match=r'outputs="\*", --outputs "\*"'):
        read_record(path)
    assert read_record(path, outputs="*").output_names == ("force 1Z+",)
