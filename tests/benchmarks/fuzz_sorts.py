"""The sorts of files that `fuzz.py` mutates: how sound ones are made, how we read one, how the format's library does.

A new sort is one `Sort` in `SORTS`: sound files, our reader, and what another reading of the same file gives. Our own
formats stand in `fuzz_own.py`.
"""

import contextlib
import struct
import warnings
import zlib

import numpy as np
from fuzz_own import OWN, Sort, zip_inner

RNG = np.random.default_rng(21)
N = 40
FORCE, TIPS = RNG.standard_normal(N), RNG.standard_normal((N, 2))
TIME = 0.01 * np.arange(N)


# --- records ---------------------------------------------------------------------------------------------------------


def read_record_file(path):
    """The table, once it has been through everything that a record goes through."""
    from okid.errors import IdentificationWarning, InvalidDataError
    from okid.readers.dispatch import describe_table, read_table
    from okid.readers.table import to_record
    from okid.record import Record

    table = read_table(path)
    for call in (
        lambda: str(describe_table(table)),
        lambda: to_record(table, Record, inputs=None, outputs=None, dt=None, input_hold="zero_order"),
        lambda: to_record(table, Record, inputs=None, outputs=None, dt=0.5, input_hold="zero_order"),
    ):
        with warnings.catch_warnings(), contextlib.suppress(InvalidDataError):
            warnings.simplefilter("ignore", IdentificationWarning)  # a step of 0.5 s contradicts most stamps
            call()
    return table


def series_of(value):
    """Every real column of an array, and its rows where it is a row vector, as float64 bytes."""
    value = np.asarray(value)
    if value.dtype.names:
        return [each for name in value.dtype.names for each in series_of(value[name])]
    if value.dtype.kind not in "biuf" or value.size == 0:
        return []
    if value.ndim == 2 and 1 in value.shape:
        value = value.reshape(-1)
    columns = value[:, np.newaxis] if value.ndim == 1 else value
    if columns.ndim != 2:
        return []
    with np.errstate(all="ignore"):
        return [np.ascontiguousarray(column, dtype=np.float64).tobytes() for column in columns.T]


def columns_are_among(by_hand):
    """The check that each column of a table is one of those that the format's library gives."""

    def wrong(path, table, _sound):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                known = {each for value in by_hand(path, table) for each in series_of(value)}
            except Exception as error:  # noqa: BLE001 - whatever the library says, it does not read what we read
                return f"the library refuses it: {type(error).__name__}: {error}"
        for index, column in enumerate(table.columns):
            if np.ascontiguousarray(table.values[:, index], dtype=np.float64).tobytes() not in known:
                return f"column {column.name!r} is not what the library reads"
        return ""

    return wrong


def make_npy(folder):
    for number, array in enumerate((TIPS, TIPS[:, 0], np.asfortranarray(TIPS), (1000 * TIPS).astype(">i2"))):
        np.save(folder / f"{number}.npy", array)
        yield folder / f"{number}.npy"
    fields = np.zeros(N, dtype=[("time", "<f8"), ("tip", "<f4")])
    fields["time"], fields["tip"] = TIME, TIPS[:, 0]
    np.save(folder / "9.npy", fields)
    yield folder / "9.npy"


CONTENTS = {
    "roles": {"inputs": FORCE[:, None], "outputs": TIPS, "dt": 0.01, "output_names": np.array(["a", "b"])},
    "series": {"time": TIME, "force": FORCE, "tip": TIPS.astype(np.float32), "fs": 100.0},
}


def make_npz(folder):
    for name, contents in CONTENTS.items():
        np.savez(folder / f"{name}.npz", **contents)
        np.savez_compressed(folder / f"{name}_z.npz", **contents)
        yield from (folder / f"{name}.npz", folder / f"{name}_z.npz")


def npz_by_hand(path, _table):
    with np.load(path, allow_pickle=False) as archive:
        return [archive[name] for name in archive.files if isinstance(archive[name], np.ndarray)]


def make_mat_5(folder):
    import scipy.io

    cells = np.array(["shaker", "tip"], dtype=object)
    more = {
        **CONTENTS["series"],
        "run": {"gain": 2.0, "tip2": TIPS[:, 0], "note": "a text", "deep": {"x": FORCE}},
        "names": cells,
        "whole": (100 * TIPS).astype(np.int16),
        "z": TIPS + 1j,
        "flag": FORCE > 0,
        "few": scipy.sparse.csc_matrix(np.eye(5)),
    }
    for name, contents in {"plain": CONTENTS["roles"], "more": more}.items():
        for suffix, options in {
            "": {},
            "_z": {"do_compression": True},
            "_row": {"oned_as": "column", "long_field_names": True},
        }.items():
            scipy.io.savemat(folder / f"{name}{suffix}.mat", contents, **options)
            yield folder / f"{name}{suffix}.mat"
    scipy.io.savemat(folder / "four.mat", {"time": TIME, "tip": TIPS}, format="4")
    yield folder / "four.mat"


def mat_inner(data, change):
    """A compressed MAT file with one of its variables changed and compressed again."""
    start, parts = 128, []
    while start + 8 <= len(data):
        kind, size = struct.unpack("<II", data[start : start + 8])
        if kind != 15:
            return change(data)
        parts.append(zlib.decompress(data[start + 8 : start + 8 + size]))
        start += 8 + size
    chosen = len(data) % len(parts) if parts else 0
    packed = [zlib.compress(change(part) if number == chosen else part) for number, part in enumerate(parts)]
    return data[:128] + b"".join(struct.pack("<II", 15, len(part)) + part for part in packed)


def mat_by_hand(path, table):
    if table.format == "MAT 7.3":
        return hdf5_by_hand(path, table)
    import scipy.io

    found = []
    for name, _, kind in scipy.io.whosmat(path):
        if kind != "sparse":  # a damaged one kills scipy's process, and we pass over them
            with contextlib.suppress(Exception):
                found += _mat_arrays(scipy.io.loadmat(path, variable_names=[name]))
    return found


def _mat_arrays(value):
    if isinstance(value, dict):
        for each in value.values():
            yield from _mat_arrays(each)
    elif isinstance(value, np.ndarray) and value.dtype.names:
        for name in value.dtype.names:
            for each in value[name].ravel():
                yield from _mat_arrays(each)
    elif isinstance(value, np.ndarray):
        yield value


def make_mat_73(folder):
    import h5py

    def text(group, name, words):
        codes = group.create_dataset(name, data=np.array([[ord(letter)] for letter in words], dtype=np.uint16))
        codes.attrs["MATLAB_class"] = np.bytes_("char")

    for number, options in enumerate(({}, {"compression": "gzip", "chunks": (1, N)}, {"libver": "latest"})):
        path = folder / f"{number}.mat"
        how = {"libver": options.pop("libver")} if "libver" in options else {}
        with h5py.File(path, "w", userblock_size=512, **how) as file:
            for name, value in CONTENTS["series"].items():
                array = np.atleast_2d(np.asarray(value).T)
                kept = options if array.shape[-1] == N else {}
                data = file.create_dataset(name, data=array, **kept)
                data.attrs["MATLAB_class"] = np.bytes_("double")
            group = file.create_group("run")
            group.attrs["MATLAB_class"] = np.bytes_("struct")
            group.create_dataset("tip2", data=TIPS[:, :1].T).attrs["MATLAB_class"] = np.bytes_("double")
            text(group, "note", "a text")
            store = file.create_group("#refs#")
            text(store, "a", "tip_x")
            text(store, "b", "tip_y")
            cells = file.create_dataset("tip_names", (2, 1), dtype=h5py.ref_dtype)
            cells[:, 0] = [store["a"].ref, store["b"].ref]
            cells.attrs["MATLAB_class"] = np.bytes_("cell")
        with path.open("r+b") as file:
            file.write(b"MATLAB 7.3 MAT-file, written for a test".ljust(116) + bytes(8) + b"\x00\x02IM")
        yield path
    with h5py.File(folder / "committed.mat", "w") as file:
        file["number"] = np.dtype("<f8")
        file.create_dataset("tip", data=TIPS, dtype=file["number"])
        file["time"] = TIME
    yield folder / "committed.mat"


def hdf5_by_hand(path, _table):
    import h5py

    with h5py.File(path, "r") as file:
        return list(_hdf5_arrays(h5py, file, 0))


def _hdf5_arrays(h5py, group, depth):
    for name in group:
        with contextlib.suppress(Exception):  # damage in one object that we pass over harms no other
            item = group[name]
            if isinstance(item, h5py.Group) and depth < 5:
                yield from _hdf5_arrays(h5py, item, depth + 1)
            elif isinstance(item, h5py.Dataset) and item.dtype.kind in "biuf" and item.size < 10**8:
                value = np.asarray(item[()])
                yield from (value, value.T)


HEAD = "time [s],force [N],tip [m/s^2],quiet\n"


def make_csv(folder):
    rows = [
        f"{0.01 * row:.2f},{FORCE[row]:.6g},{TIPS[row, 0]:.9f},{'' if row == 7 else TIPS[row, 1]}" for row in range(N)
    ]
    text = HEAD + "".join(f"{row}\n" for row in rows)
    for number, words in enumerate(
        (
            text,
            text.replace(".", "§").replace(",", ";").replace("§", ","),
            "# a remark\n# another\n" + text.replace(",", "\t"),
            "".join(f"{row}\n" for row in rows if not row.endswith(",")).replace(",", " "),
        )
    ):
        (folder / f"{number}.csv").write_text(words)
        yield folder / f"{number}.csv"
    (folder / "8.csv").write_bytes(text.encode("utf-16"))
    yield folder / "8.csv"


def csv_by_hand(path, table):
    """Python's own float of every cell: the last lines that are not empty, as many as the table has rows."""
    data = path.read_bytes()
    text = data.decode("utf-16") if data[:2] in (b"\xff\xfe", b"\xfe\xff") else data.decode("latin-1")
    lines = [line for line in text.replace("\r\n", "\n").replace("\r", "\n").split("\n") if line.strip(" \t")]
    lines = lines[len(lines) - table.n_samples :]
    width = len(table.columns)
    for delimiter in (",", ";", "\t", "|", None):
        for decimal in (".", ","):
            rows = [_numbers(line, delimiter, decimal, width) for line in lines]
            if all(row is not None for row in rows):
                yield from np.array(rows).T


def _numbers(line, delimiter, decimal, width):
    cells = [cell.strip().strip('"') for cell in line.strip("\ufeff").split(delimiter)]
    if len(cells) == width + 1 and not cells[-1]:
        cells.pop()
    if len(cells) != width or (decimal == "," and delimiter == ","):
        return None
    try:
        return [_float(cell, decimal) for cell in cells]
    except ValueError:
        return None


def _float(cell, decimal):
    if "_" in cell:  # Python's own
        raise ValueError(cell)
    known = {"", "NA", "N/A", "n/a", "#N/A", "null", "NULL", "None", "nan(ind)", "-nan(ind)", "1.#QNAN", "-1.#IND"}
    return float("nan") if cell in known else abs_nan(float(cell.replace(decimal, ".")))


def abs_nan(value):
    return float("nan") if value != value else value  # noqa: PLR0124 - a nan has a sign


def make_uff(folder):
    import pyuff

    for number, (binary, spacing) in enumerate(((0, 1), (1, 1), (0, 0))):
        path = folder / f"{number}.uff"
        file = pyuff.UFF(str(path))
        for index, channel in enumerate((FORCE, *TIPS.T)):
            data_set = pyuff.prepare_58(
                binary=binary,
                func_type=1,
                rsp_node=index + 11,
                rsp_dir=1,
                ref_node=0,
                ref_dir=0,
                data=channel.copy(),
                x=TIME,
                id1="a run",
                rsp_ent_name="NONE",
                ref_ent_name="NONE",
                abscissa_spacing=spacing,
                abscissa_spec_data_type=17,
                ordinate_spec_data_type=12,
                orddenom_spec_data_type=0,
            )
            data_set.update({"ordinate_axis_units_lab": "g", "ordinate_axis_lab": "Acc"})
            file.write_sets([data_set], "add")
        del file
        yield path


def uff_sets(path):
    """The functions that pyuff reads, each by itself: one that it refuses costs no other, as with our reader."""
    import pyuff

    file = pyuff.UFF(str(path))
    for number in range(file.get_n_sets()):
        with contextlib.suppress(Exception):
            each = file.read_sets(number)
            if each.get("type") == 58 and "data" in each:
                yield each


def uff_by_hand(path, _table):
    for each in uff_sets(path):
        points = int(each["num_pts"])
        data = np.asarray(each["data"])
        yield from (np.asarray(each["x"])[:points], data[:points]) if data.dtype.kind != "c" else ()


def make_frf(folder):
    from okid.frequency_response import FrequencyResponse
    from okid.readers.uff import write_response

    values = RNG.standard_normal((33, 2, 1)) + 1j * RNG.standard_normal((33, 2, 1))
    frequencies, coherence = np.linspace(0.0, 64.0, 33), np.full((33, 2), 0.9)
    units = {"input_units": ("N",), "output_units": ("m/s^2", "m/s^2")}
    names = {"input_names": ("1X+",), "output_names": ("2X+", "3Y-")}
    response = FrequencyResponse(
        values, frequencies, coherence=coherence, n_averages=7, window="hann", **names, **units
    )
    write_response(response, folder / "a.uff")
    np.savez(folder / "b.npz", frequencies=frequencies, response=values, coherence=coherence, n_averages=7)
    return (folder / "a.uff", folder / "b.npz")


def read_frf_file(path):
    from okid.readers.response import read_response

    return read_response(path)


def frf_is_wrong(path, response, _sound):
    if path.suffix == ".npz":
        with np.load(path, allow_pickle=False) as archive:
            same = np.array_equal(
                archive["response"].astype(complex).reshape(response.response.shape), response.response
            )
        return "" if same else "the response is not that of the file"
    known = [np.asarray(each["data"], complex) for each in uff_sets(path)]
    for column in response.response.reshape(response.n_lines, -1).T:
        if not np.isnan(column).all() and not any(_same_but_for_unit(other, column) for other in known):
            return "a response is not what pyuff reads"
    return ""


def _same_but_for_unit(other, column):
    """Equal up to one real factor: that of the unit, or of a direction."""
    if len(other) < len(column):
        return False
    other = other[: len(column)]
    largest = int(np.abs(other).argmax())
    factor = (column[largest] / other[largest]).real if other[largest] else 1.0
    return np.allclose(factor * other, column, rtol=1e-6, atol=1e-300)


def make_parquet(folder):
    import pyarrow as pa
    from pyarrow import parquet

    table = pa.table(
        {
            "time": TIME,
            "force": FORCE,
            "tip": pa.array([*TIPS[:-1, 0].tolist(), None]),
            "whole": (100 * TIPS[:, 1]).astype(np.int16),
            "note": ["a"] * N,
        }
    )
    for number, options in enumerate(
        (
            {},
            {"compression": "none", "use_dictionary": False, "write_page_checksum": True},
            {"compression": "gzip", "data_page_version": "2.0"},
        )
    ):
        parquet.write_table(table, folder / f"{number}.parquet", **options)
        yield folder / f"{number}.parquet"


def parquet_by_hand(path, _table):
    from pyarrow import parquet

    for column in parquet.ParquetFile(path).read().itercolumns():
        yield column.to_numpy()
        if "timestamp" in str(column.type) or "duration" in str(column.type):
            ticks = column.to_numpy().astype(np.int64)
            yield from (ticks.astype(float), (ticks - ticks[0]).astype(float))


def make_tdms(folder):
    import nptdms

    with nptdms.TdmsWriter(str(folder / "a.tdms")) as writer:
        channels = {"shaker": FORCE, "tip": TIPS[:, 0], "whole": (99 * TIPS[:, 1]).astype(np.int16)}
        given = {"wf_increment": 0.01, "unit_string": "N"}
        for part in (slice(0, 30), slice(30, N)):
            writer.write_segment(
                [nptdms.ChannelObject("run", name, values[part], properties=given) for name, values in channels.items()]
            )
    yield folder / "a.tdms"


def tdms_by_hand(path, _table):
    import nptdms

    for group in nptdms.TdmsFile.read(path).groups():
        yield from (channel[:] for channel in group.channels())


def record_sort(suffix, make, by_hand, **more):
    return Sort(suffix=suffix, make=make, read=read_record_file, wrong=columns_are_among(by_hand), **more)


def npy_by_hand(path, _table):
    return [np.load(path, allow_pickle=False)]


SORTS = {
    "npy": record_sort(".npy", make_npy, npy_by_hand),
    "npz": record_sort(".npz", make_npz, npz_by_hand, inner=zip_inner),
    "mat5": record_sort(".mat", make_mat_5, mat_by_hand, inner=mat_inner),
    "mat73": record_sort(".mat", make_mat_73, mat_by_hand),
    "csv": record_sort(".csv", make_csv, csv_by_hand),
    "uff": record_sort(".uff", make_uff, uff_by_hand),
    "frf": Sort(suffix="", make=make_frf, read=read_frf_file, wrong=frf_is_wrong),
    "parquet": record_sort(".parquet", make_parquet, parquet_by_hand),
    "tdms": record_sort(".tdms", make_tdms, tdms_by_hand),
    **OWN,
}
