"""The sorts of files that are ours: models, geometries, test files, shapes, results; see `fuzz_sorts.py`."""

import csv
import io
import json
import shutil
import tomllib
import zipfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

RNG = np.random.default_rng(22)
LONGEST = 900
"""Letters of a sentence."""


@dataclass(frozen=True, kw_only=True)
class Sort:
    """One sort of file.

    Attributes:
        suffix: of its files.
        make: writes sound files into a folder and returns their paths.
        read: ours; returns what it read, or raises one of our errors.
        wrong: (path, what we read, sound file it was made of): why the numbers are wrong, "" where they are right.
        inner: (bytes, change) where the file is a container: the container anew, with `change` applied to its content
            and its own checksums right again.
    """

    suffix: str
    make: Callable[[Path], Iterable[Path]]
    read: Callable[[Path], object]
    wrong: Callable[[Path, object, Path], str]
    inner: Callable[[bytes, Callable[[bytes], bytes]], bytes] | None = None


def zip_inner(data, change):
    """The archive anew, one of its members changed."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(out, "w") as new:
        members = old.infolist()
        chosen = len(data) % len(members)
        for number, member in enumerate(members):
            content = old.read(member)
            new.writestr(zipfile.ZipInfo(member.filename), change(content) if number == chosen else content)
    return out.getvalue()


CHAIN = {
    "masses": [1.0, 1.5],
    "stiffnesses": [400.0, 300.0],
    "dampings": [0.4, 0.3],
    "force_dofs": [1],
    "sensor_dofs": [0, 1],
    "sensor_kind": "acceleration",
    "output_names": ["tip", "root"],
}
MATRICES = {
    "mass": [[1.0, 0.0], [0.0, 1.5]],
    "damping": [[0.7, -0.3], [-0.3, 0.3]],
    "stiffness": [[700.0, -300.0], [-300.0, 300.0]],
    "force_map": [[0.0], [1.0]],
    "sensor_map": [[1.0, 0.0], [0.0, 1.0]],
    "sensor_kind": "acceleration",
}
SPACE = {
    "A": [[0.9, 0.1], [-0.1, 0.9]],
    "B": [[0.0], [1.0]],
    "C": [[1.0, 0.0]],
    "D": [[0.25]],
    "dt": 0.01,
    "sensor_kind": "displacement",
}
MODELS = {"chain": CHAIN, "matrices": MATRICES, "space": SPACE}


def read_model_file(path):
    from modal.structure.model_file import read_model

    return read_model(path)


def toml_words(document):
    return "".join(f"{key} = {json.dumps(value)}\n" for key, value in document.items())


def make_model_toml(folder):
    for name, document in MODELS.items():
        (folder / f"{name}.toml").write_text(toml_words(document))
        yield folder / f"{name}.toml"


def make_model_json(folder):
    for name, document in MODELS.items():
        (folder / f"{name}.json").write_text(json.dumps(document, indent=1))
        yield folder / f"{name}.json"


def make_model_npz(folder):
    for name, document in MODELS.items():
        arrays = {key: np.array(value) for key, value in document.items() if isinstance(value, list | float)}
        words = {key: value for key, value in document.items() if key not in arrays}
        np.savez(folder / f"{name}.npz", **arrays, options=np.array(json.dumps(words)))
        yield folder / f"{name}.npz"


def model_is_wrong(by_hand):
    """The check that every matrix of a model is what its file says."""

    def wrong(path, model, _sound):
        try:
            document = by_hand(path)
        except Exception as error:  # noqa: BLE001
            return f"the parser refuses it: {type(error).__name__}: {error}"
        for name in ("mass", "damping", "stiffness", "force_map", "sensor_map"):
            if name in document and hasattr(model, name):
                given = np.asarray(document[name], dtype=float)
                if not np.array_equal(given.reshape(getattr(model, name).shape), getattr(model, name), equal_nan=True):
                    return f"{name} is not what the file says"
        if "masses" in document and not np.array_equal(np.diag(np.asarray(document["masses"], float)), model.mass):
            return "masses are not what the file says"
        return ""

    return wrong


def model_npz_by_hand(path):
    with np.load(path, allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}


def make_geometry(folder):
    import modal.examples

    words = (Path(modal.examples.__file__).parent / "three_storey_frame.toml").read_text()
    document = tomllib.loads(words)["geometry"]
    nodes = "".join(f"{name} = {place}\n" for name, place in document["nodes"].items())
    lines = f'unit = "mm"\nlines = {document["lines"]}\nfixed = [1, 2]\n'
    (folder / "a.toml").write_text(
        f'{lines}[nodes]\n{nodes}[sensors]\ntop = "31X+"\nskew = {{ node = 32, direction = [1, 1, 0] }}\n'
    )
    yield folder / "a.toml"
    places = [(name, *(0.001 * value for value in place)) for name, place in document["nodes"].items()]
    set_15 = "".join(f"{int(n):10d}{0:10d}{0:10d}{8:10d}{x:13.5e}{y:13.5e}{z:13.5e}\n" for n, x, y, z in places)
    set_82 = f"{1:10d}{4:10d}{8:10d}\n{'a line':80}\n{1:10d}{11:10d}{21:10d}{31:10d}\n"
    (folder / "b.unv").write_text(f"    -1\n    15\n{set_15}    -1\n    -1\n    82\n{set_82}    -1\n")
    yield folder / "b.unv"


def read_geometry_file(path):
    from modal.geometry.file import read_geometry

    return read_geometry(path)


def geometry_is_wrong(path, geometry, _sound):
    from modal.geometry.file import UNITS

    if path.suffix == ".unv":
        text = path.read_bytes().decode("latin-1")
        for name, place in zip(geometry.node_names, geometry.positions, strict=True):
            if not np.isfinite(place).all() or str(int(name)) not in text:
                return f"node {name} stands nowhere in the file"
        return ""
    document = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    document = document.get("geometry", document)
    given = np.array(list(document["nodes"].values()), dtype=float) * UNITS[document.get("unit", "m")]
    return "" if np.allclose(given, geometry.positions, rtol=1e-15, atol=0) else "positions are not those of the file"


def make_test_file(folder):
    import modal.examples

    words = (Path(modal.examples.__file__).parent / "three_storey_frame.toml").read_text()
    sensors = '\n[[sensors]]\nchannel = "13Y-"\nkind = "accelerometer"\ncalibrated = 2026-01-02\n'
    (folder / "a.toml").write_text(words.partition("[geometry]")[0] + sensors)
    (folder / "b.toml").write_text(words)
    return (folder / "a.toml", folder / "b.toml")


def read_test_file(path):
    from modal.acceptance.test_file import read_specification

    return read_specification(path)


def wrong_test_file(path, specification, _sound):
    document = tomllib.loads(path.read_text(encoding="utf-8"))
    if (
        specification.article != document.get("article", "").strip()
        and specification.article not in document["article"]
    ):
        return "the article is another"
    return "" if len(specification.limits) == len(document.get("limits", [])) else "limits are lost"


def make_result(folder):
    from modal.comparison.shifts import PART, summary_of
    from modal.examples.demo import demo_record
    from modal.identification.pipeline import identify
    from modal.identification.result import write_parts

    record = demo_record(np.random.default_rng(2))
    result = identify(record, observer_order=20, ridge=0.0, order=8)
    write_parts({"result": result, PART: summary_of(result)}, folder / "a.npz")
    write_parts({PART: summary_of(result)}, folder / "b.npz")
    return (folder / "a.npz", folder / "b.npz")


def read_result_file(path):
    """Both readings: what `diff` looks at, and the whole where it is there."""
    from modal.comparison.shifts import read_result
    from modal.identification.result import load
    from okid.errors import UnreadableFileError

    read = [read_result(path), None]
    try:
        read[1] = load(path)
    except UnreadableFileError:
        read[1] = None
    return read


def result_is_wrong(_path, read, sound):
    from modal.identification.result import _encode

    for ours, theirs in zip(read, read_result_file(sound), strict=True):
        if ours is None:
            continue
        first, second = {}, {}
        one, other = _encode(ours, first), _encode(theirs, second)
        one.pop("name", None), other.pop("name", None)
        same = one == other and len(first) == len(second)
        for (_, a), (_, b) in zip(first.values(), second.values(), strict=False):
            same = same and a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
        if not same:
            return "a damaged result was read as another one"
    return ""


def make_shapes(folder):
    import pyuff

    names, frequencies = ("1X+", "2X+", "3Y+"), np.array([3.0, 7.5])
    shapes = RNG.standard_normal((3, 2)).round(6) + 1j * RNG.standard_normal((3, 2)).round(6)
    rows = [
        f"{name},{','.join(str(value).strip('()') for value in row)}\n" for name, row in zip(names, shapes, strict=True)
    ]
    (folder / "a.csv").write_text(f"channel,{frequencies[0]} Hz,{frequencies[1]} Hz\n{''.join(rows)}")
    np.savez(folder / "b.npz", shapes=shapes, names=np.array(names), frequencies=frequencies)
    file = pyuff.UFF(str(folder / "c.uff"))
    for mode, (frequency, shape) in enumerate(zip(frequencies, shapes.T, strict=True), 1):
        x, y = np.where([True, True, False], shape, 0), np.where([False, False, True], shape, 0)
        pole = -0.1 + 2j * np.pi * frequency
        kinds = {"model_type": 1, "analysis_type": 3, "data_ch": 2, "spec_data_type": 8, "data_type": 5}
        ids = {f"id{number}": "a mode" for number in range(1, 6)}
        modal_scale = {"modal_a": 0j, "modal_b": 0j, "modal_damp_vis": 0.0, "modal_damp_his": 0.0, "modal_m": 0.0}
        values = {"node_nums": np.array([1, 2, 3]), "r1": x, "r2": y, "r3": 0 * x, "eig": pole, "mode_n": mode}
        file.write_sets([pyuff.prepare_55(**kinds, **ids, **modal_scale, **values, load_case=1)], "add")
    return (folder / "a.csv", folder / "b.npz", folder / "c.uff")


def read_shape_file(path):
    from modal.modes.shape_comparison import read_shapes

    return read_shapes(path)


def shapes_are_wrong(path, ours, _sound):
    if path.suffix == ".csv":
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = [row for row in csv.reader(file) if "".join(row).strip()]
        known = np.array([[complex(cell.replace(" ", "").replace("i", "j")) for cell in row[1:]] for row in rows[1:]])
        same = known.shape == ours.shapes.shape and np.array_equal(known, ours.shapes)
        return "" if same else "shapes are not those of the table"
    if path.suffix == ".npz":
        with np.load(path, allow_pickle=False) as archive:
            return "" if np.array_equal(archive["shapes"], ours.shapes) else "shapes are not those of the archive"
    import pyuff

    sets = pyuff.UFF(str(path)).read_sets()
    sets = [each for each in (sets if isinstance(sets, list) else [sets]) if each["type"] == 55]
    for column, each in zip(ours.shapes.T, sets, strict=True):
        known = [value for axis in range(1, 7) for value in np.ravel(each.get(f"r{axis}", ()))]
        if not {value for value in column if value} <= set(known):
            return "a shape is not what pyuff reads"
    return ""


def make_report(folder):
    """Reports for programs; `whole` beside the sound files gets a damaged one beside a result that is sound."""
    from modal.comparison.shifts import PART, read_result, summary_of
    from modal.examples.demo import demo_record
    from modal.identification.pipeline import identify
    from modal.identification.result import write_parts
    from modal.report.machine import json_text
    from modal.sections.validation import Provenance

    result = identify(demo_record(np.random.default_rng(2)), observer_order=20, ridge=0.0, order=8)
    whole = folder.parents[1] / "whole"
    whole.mkdir()
    write_parts({PART: summary_of(result)}, whole / "result.npz")
    (folder / "a.json").write_text(json_text(result, Provenance()))
    read_result(whole)
    return (folder / "a.json",)


def read_report_file(path):
    """No program of ours reads a report back: each refuses it, and what stands beside it is read as if it were not."""
    from modal.command.results import recording_of
    from modal.comparison.shifts import read_result
    from okid.errors import IdentificationError
    from okid.readers.dispatch import read_table

    taken = []
    for reader in (read_result, recording_of, read_model_file, read_table):
        try:
            taken.append(f"read by {reader.__name__}: {reader(path)}")
        except IdentificationError as error:
            taken += [f"no sentence: {error!r}"] if len(str(error)) > LONGEST or not str(error).isprintable() else []
    whole = next(folder for folder in path.parents if (folder / "whole").is_dir()) / "whole"
    shutil.copyfile(path, whole / "report.json")
    return [read_result(whole), taken]


def report_is_wrong(path, read, sound):
    return read[1][0] if read[1] else result_is_wrong(path, [read[0], None], sound.parents[2] / "whole" / "result.npz")


OWN = {
    "model_toml": Sort(
        suffix=".toml",
        make=make_model_toml,
        read=read_model_file,
        wrong=model_is_wrong(lambda path: tomllib.loads(path.read_text(encoding="utf-8"))),
    ),
    "model_json": Sort(
        suffix=".json",
        make=make_model_json,
        read=read_model_file,
        wrong=model_is_wrong(lambda path: json.loads(path.read_text(encoding="utf-8"))),
    ),
    "model_npz": Sort(
        suffix=".npz",
        make=make_model_npz,
        read=read_model_file,
        wrong=model_is_wrong(model_npz_by_hand),
        inner=zip_inner,
    ),
    "geometry": Sort(suffix="", make=make_geometry, read=read_geometry_file, wrong=geometry_is_wrong),
    "test_file": Sort(suffix=".toml", make=make_test_file, read=read_test_file, wrong=wrong_test_file),
    "shapes": Sort(suffix="", make=make_shapes, read=read_shape_file, wrong=shapes_are_wrong),
    "report": Sort(suffix=".json", make=make_report, read=read_report_file, wrong=report_is_wrong),
    "result": Sort(suffix=".npz", make=make_result, read=read_result_file, wrong=result_is_wrong),
}
