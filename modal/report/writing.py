"""The files of a report, all of them or none, with the result itself beside them to be loaded and compared again.

One of them is for other programs of the field: a universal file with one dataset 55 a mode of the system, "data at
nodes" of analysis type 3, complex eigenvalue: the pole s [1/s] and one complex vector (x, y, z) a node. With a geometry
datasets 164 (SI units), 15 (nodes) and 82 (lines) come first, so that the file shows the shapes by itself. Without one,
nodes and directions are those that the channel names state (`12X+`); a channel whose name states none has a node of its
own and is written along X.

Shapes are scaled to a largest component of 1, not to unit modal A: that would need a driving point. Modal A and B are
written as 0, not known. Numbers have six digits, as the format has it. Readers that know normal modes only are served
by `form="normal"`: analysis type 2, the shape turned to its most real phase, the imaginary rest left out.

References:
    SDRC I-DEAS Universal File Datasets 15, 55, 82, 164, as kept by the University of Cincinnati SDRL.
"""

import itertools
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args, overload

import numpy as np

from modal import recording
from modal.acceptance.test_file import Specification
from modal.comparison.shifts import PART, summary_of
from modal.discrepancy.results import Diagnosis
from modal.geometry.sensors import Geometry, Motions, Sensor, dof_of, motion_of
from modal.identification.result import Identification, write_parts
from modal.modes.mode import Mode, numbered
from modal.quality import DataQuality
from modal.report.discrepancy_writing import DiagnosisFiles, write_diagnosis
from modal.report.folder import FileSet, refuse_names, write_folder
from modal.report.machine import csv_text, json_text, schema_text
from modal.report.pages import html_text, markdown_text
from modal.report.pictures import Setting, draw_pictures, setting_of
from modal.sections.validation import Provenance
from okid.arrays import ComplexArray, require
from okid.errors import InvalidDataError
from okid.readers.guard import Existing
from okid.readers.uff import DATA_TYPES

LARGEST_KEPT = 1 << 27
"""Keep the result whole up to so many bytes of arrays: 128 MiB, a record of 8 channels and 700 000 samples with its two
simulations. Above, its file holds the summary that a comparison needs; the rest can be made again from the records."""


def keep_result(result: Identification, path: Path, *, files: Sequence[str] = ()) -> Path:
    """Write the summary for a comparison, and with it the result unless it would be larger than `LARGEST_KEPT`.

    Args:
        result: of `modal.identify`.
        path: of a file that is not there.
        files: SHA-256 of each measured file.

    Raises:
        InvalidDataError: the file exists or cannot be written.
    """
    return write_parts({PART: summary_of(result, files=files), "result": result}, path, most=LARGEST_KEPT)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ReportFiles(FileSet):
    """Where the files of a report on an identification are.

    Attributes:
        html: self-contained page.
        markdown: the same words and tables.
        json: the numbers, without time histories and the largest arrays.
        schema: JSON schema of that file.
        csv: one row a mode.
        uff55: modes of the system as universal file datasets 55, for other tools.
        result: the result itself, for `modal.load` and `modal-report diff`; where it would be very large, the summary.
        recording: Rerun recording (.rrd).
    """

    html: Path
    markdown: Path
    json: Path
    schema: Path
    csv: Path
    uff55: Path
    result: Path
    recording: Path

    @classmethod
    def in_folder(cls, folder: Path) -> "ReportFiles":
        """The names that a report has in a folder."""
        return cls(
            html=folder / "report.html",
            markdown=folder / "report.md",
            json=folder / "report.json",
            schema=folder / "report.schema.json",
            csv=folder / "modes.csv",
            uff55=folder / "modes.uff",
            result=folder / "result.npz",
            recording=folder / "recording.rrd",
        )


@overload
def write_report(
    result: Identification,
    folder: str | os.PathLike[str],
    *,
    existing: Existing = "refuse",
    provenance: Provenance | None = None,
    geometry: Geometry | None = None,
    specification: Specification | None = None,
    quality: DataQuality | None = None,
) -> ReportFiles: ...


@overload
def write_report(
    result: Diagnosis,
    folder: str | os.PathLike[str],
    *,
    existing: Existing = "refuse",
    provenance: Provenance | None = None,
) -> DiagnosisFiles: ...


def write_report(
    result: Identification | Diagnosis,
    folder: str | os.PathLike[str],
    *,
    existing: Existing = "refuse",
    provenance: Provenance | None = None,
    geometry: Geometry | None = None,
    specification: Specification | None = None,
    quality: DataQuality | None = None,
) -> ReportFiles | DiagnosisFiles:
    """Write HTML, Markdown, JSON, CSV, UFF 55 and the Rerun recording of a result into a folder, all of them or none.

    Of a diagnosis the updated model is written too, so that one can go on with it. Nothing in the files depends on when
    or where they were written: the same result gives the same bytes.

    Args:
        result: of `modal.identify`, or of `modal.discrepancy.diagnose`.
        folder: made if it does not exist.
        existing: "refuse" to touch a folder that holds one of the files, or "replace" those files.
        provenance: command and sources, for the part on how to make the result again.
        geometry: of the structure, for the shapes of an identification; that of the specification unless given.
        specification: what the test file says: article, sensors, limits of acceptance.
        quality: of the records as they were read (`modal.quality.check_quality`); the records as used are looked at
            unless given.

    Returns:
        The paths.

    Raises:
        InvalidDataError: a file of the report exists already, the folder cannot be written, the geometry has no place
            for any output, or a geometry, a specification or a quality was given with a diagnosis.
    """
    if isinstance(result, Diagnosis):
        if geometry is not None or specification is not None or quality is not None:
            raise InvalidDataError(
                "a report on a diagnosis has no part for a geometry, a specification or the quality of the data; leave "
                "them out."
            )
        return write_diagnosis(result, folder, existing=existing, provenance=provenance)
    require(result, Identification, where="write_report", made_by="modal.identify")
    target, source = Path(folder), provenance or Provenance()
    files = ReportFiles.in_folder(target)
    refuse_names(target, files.names, existing)
    setting = setting_of(result, geometry=geometry, specification=specification, quality=quality)
    write_folder(
        target,
        files.names,
        lambda made: _write_all(result, ReportFiles.in_folder(made), source, setting),
        existing=existing,
        gone=("report.pdf",),
    )
    return files


def _write_all(result: Identification, files: ReportFiles, provenance: Provenance, setting: Setting) -> None:
    measured = [file.sha256 for file in provenance.files if file.name in provenance.sources]
    keep_result(result, files.result, files=measured)
    beside = _beside(files)
    pages = {
        files.html: html_text(result, provenance, draw_pictures(result, setting), setting, beside=beside),
        files.markdown: markdown_text(result, provenance, setting, beside=beside),
        files.json: json_text(result, provenance, specification=setting.specification, quality=setting.quality),
        files.schema: schema_text(),
        files.csv: csv_text(result),
        files.uff55: uff55_text(result, setting.geometry),
    }
    for path, text in pages.items():
        path.write_bytes(text.encode("utf-8"))
    recording.save_recording(result, files.recording, geometry=setting.geometry, quality=setting.quality)


def _beside(files: ReportFiles) -> str:
    """The other files of the report, for the last words of the page."""
    return (
        f"{files.markdown.name} (the same words), {files.json.name} (the numbers; {files.schema.name} says how it is "
        f"laid out), {files.csv.name} (one row a pole), {files.uff55.name} (the modes for other tools), "
        f"{files.result.name} (the result itself, or its summary where it is above {LARGEST_KEPT >> 20} MiB, for "
        f"modal.load and modal-report diff), and {files.recording.name} (modal-report view with this folder opens it)"
    )


_NODES_A_LINE = 8


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class NodePlan:
    """How the outputs move the nodes of a file.

    Attributes:
        labels: number of each node in the file.
        motions: from a shape to the motion of the nodes.
        remark: what a reader of the file must know of the nodes; "" where nothing.
    """

    labels: tuple[int, ...]
    motions: Motions
    remark: str


def node_plan(output_names: Sequence[str], geometry: Geometry | None) -> NodePlan:
    """Nodes of the geometry, or those that the names of the outputs state."""
    nodes = geometry or _named_nodes(output_names)
    motions = motion_of(nodes, nodes.sensors if geometry is None else nodes.sensors_of(output_names))
    n_outputs, n_lost = len(output_names), len(output_names) - len(motions.used)
    n_assumed = sum(dof_of(name) is None for name in output_names) if geometry is None else 0
    remarks = [f"{n_lost} of {n_outputs} outputs move no node"] if n_lost else []
    remarks += [f"direction not known for {n_assumed} of {n_outputs} outputs: written as X"] if n_assumed else []
    return NodePlan(labels=node_labels(nodes.node_names), motions=motions, remark="; ".join(remarks))


def node_labels(names: Sequence[str]) -> tuple[int, ...]:
    """A number for each node: its own where its name is one, else the next ones above.

    Example:
        >>> node_labels(["12", "tip", "3", "012"])
        (12, 13, 3, 14)
    """
    own: dict[int, str] = {}
    for name in names:
        if name.isascii() and name.isdigit() and len(name) <= 9 and int(name) > 0:
            own.setdefault(int(name), name)
    by_name = {name: number for number, name in own.items()}
    following = itertools.count(max(own, default=0) + 1)
    return tuple(by_name[name] if name in by_name else next(following) for name in names)


def geometry_datasets(geometry: Geometry, plan: NodePlan) -> list[str]:
    """Datasets 164 (SI units), 15 (nodes) and 82 (one a line) of a geometry."""
    units = f"{1:10d}{'SI: Meter (newton)':20s}{2:10d}"
    factors = "".join(f"{value:25.17E}".replace("E", "D") for value in (1.0, 1.0, 1.0)) + f"\n{273.15:25.17E}"
    nodes = [
        f"{label:10d}{0:10d}{0:10d}{1:10d}" + "".join(f"{value:13.5E}" for value in position)
        for label, position in zip(plan.labels, geometry.positions + 0.0, strict=True)
    ]
    lines = [_line(number, [plan.labels[node] for node in line]) for number, line in enumerate(_lines(geometry), 1)]
    return [
        dataset(164, [units, factors.replace("E", "D")]),
        dataset(15, nodes),
        *(dataset(82, rows) for rows in lines),
    ]


def dataset(number: int, lines: Sequence[str]) -> str:
    """A dataset of a universal file between its delimiters.

    Example:
        >>> dataset(164, ["         1"]).splitlines()
        ['    -1', '   164', '         1', '    -1']
    """
    return "\n".join(["    -1", f"{number:6d}", *lines, "    -1"]) + "\n"


def _lines(geometry: Geometry) -> list[tuple[int, ...]]:
    """Lines, and the closed outline of each surface."""
    return [*geometry.lines, *((*surface, surface[0]) for surface in geometry.surfaces)]


def _line(number: int, labels: Sequence[int]) -> list[str]:
    rows = [f"{number:10d}{len(labels):10d}{8:10d}", f"line {number}"]
    starts = range(0, len(labels), _NODES_A_LINE)
    return rows + ["".join(f"{label:10d}" for label in labels[start : start + _NODES_A_LINE]) for start in starts]


def _named_nodes(output_names: Sequence[str]) -> Geometry:
    """Nodes as the names state them, all in one place: where they stand is not known and is not written."""
    names: list[str] = []
    sensors = []
    for number, name in enumerate(output_names, start=1):
        dof = dof_of(name)
        node = dof.node if dof is not None else f"output {number} {name}"
        if node not in names:
            names.append(node)
        direction = np.eye(3)[0] if dof is None else dof.sign * np.eye(3)[dof.axis]
        motion = "along" if dof is None else dof.motion
        sensors.append(Sensor(name=name, node=names.index(node), direction=direction, motion=motion))
    return Geometry(node_names=tuple(names), positions=np.zeros((len(names), 3)), sensors=tuple(sensors))


Form = Literal["complex", "normal"]

_DERIVATIVES = {"m": 0, "m/s": 1, "m/s^2": 2}
"""Write these units by the data type of their motion; every other one is 0, unknown."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Quantity:
    """What the components of the shapes are.

    Attributes:
        data_type: specific data type of record 6.
        derivatives: one an output: by how many powers of the pole its component is divided.
    """

    data_type: int
    derivatives: tuple[int, ...]


def uff55_text(result: Identification, geometry: Geometry | None = None, *, form: Form = "complex") -> str:
    """The modes of the system as a universal file; nodes and lines come first where a geometry is given.

    Args:
        result: of `modal.identify`.
        geometry: nodes, lines and sensors; None: nodes and directions as the channel names state them.
        form: "complex" shapes and poles, or "normal" ones: real shapes, frequency and damping ratio.

    Returns:
        ASCII text. Without a mode of the system it holds the geometry at most.

    Raises:
        InvalidDataError: another form.
    """
    if form not in get_args(Form):
        raise InvalidDataError(f"form must be complex or normal, but is {form!r}.")
    record = result.channels
    plan = node_plan(record.output_names, geometry)
    quantity = _quantity(record.output_units)
    parts = [] if geometry is None else geometry_datasets(geometry, plan)
    for number, mode in numbered(result.modes):
        if mode.verdict == "system":
            parts.append(_mode(mode, number, plan=plan, quantity=quantity, record=record.name, form=form))
    return "".join(parts)


def real_shape(shape: ComplexArray) -> ComplexArray:
    r"""A complex shape turned so that the sum of squares of its imaginary parts is least; its real part is kept.

    The angle is half that of sum_k shape_k^2: turned by it, Im sum shape^2 = 0 and Re sum shape^2 is greatest.

    Example:
        >>> real_shape(np.array([1j, -0.5j])).real.round(12).tolist()
        [1.0, -0.5]
    """
    turned = shape * np.exp(-0.5j * np.angle(np.sum(shape**2)))
    largest = turned[int(np.argmax(np.abs(turned)))] if turned.size else 1.0
    return np.asarray(turned.real * (np.sign(largest.real) or 1.0), dtype=np.complex128)


def _quantity(units: Sequence[str]) -> _Quantity:
    """One unit stays as it is; a mixture of motions becomes displacement, any other mixture is written as it is."""
    if len(set(units)) == 1:
        known = DATA_TYPES[units[0]] if units[0] in _DERIVATIVES else 0
        return _Quantity(data_type=known, derivatives=(0,) * len(units))
    if all(unit in _DERIVATIVES for unit in units):
        return _Quantity(data_type=8, derivatives=tuple(_DERIVATIVES[unit] for unit in units))
    return _Quantity(data_type=0, derivatives=(0,) * len(units))


def _mode(mode: Mode, number: int, *, plan: NodePlan, quantity: _Quantity, record: str, form: Form) -> str:
    shape = _largest_one(mode.shape / mode.pole ** np.array(quantity.derivatives))
    shape = real_shape(shape) if form == "normal" else shape
    moved = plan.motions.deflection(shape)
    frequency = f"{mode.frequency:.6g} Hz, damping {100 * mode.damping_ratio:.4g} %"
    lines = [
        _text(f"okid-modal, record {record}" if record else "okid-modal"),
        _text(f"mode {number}: {frequency}"),
        "NONE",
        _text(plan.remark or "NONE"),
        f"Mode no. {number:10d} frequency {mode.frequency:13.5E}",
    ]
    if form == "complex":
        lines += [_integers(1, 3, 2, quantity.data_type, 5, 3), _integers(2, 6, 1, number)]
        lines.append(_reals([mode.pole.real, mode.pole.imag, 0.0, 0.0, 0.0, 0.0]))
    else:
        lines += [_integers(1, 2, 2, quantity.data_type, 2, 3), _integers(2, 4, 1, number)]
        lines.append(_reals([mode.frequency, 0.0, mode.damping_ratio, 0.0]))
    for node in plan.motions.moving:
        values = moved[node] + 0.0  # no negative zero
        both = [part for value in values for part in (value.real, value.imag)]
        lines += [_integers(plan.labels[node]), _reals(both if form == "complex" else values.real)]
    return dataset(55, lines)


def _largest_one(shape: ComplexArray) -> ComplexArray:
    largest = shape[int(np.argmax(np.abs(shape)))] if shape.size else 0.0
    return shape / largest if largest else shape


def _integers(*values: int) -> str:
    return "".join(f"{value:10d}" for value in values)


def _reals(values: Sequence[float]) -> str:
    return "".join(f"{value:13.5E}" for value in values)


def _text(words: str) -> str:
    """An ID line: at most 80 plain letters, never blank."""
    return "".join(letter if " " <= letter <= "~" else "?" for letter in words)[:80].rstrip() or "NONE"
