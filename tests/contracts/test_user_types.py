"""What a user's type checker says of a script that runs: nothing; and of one that cannot: something."""

import subprocess
import sys
import textwrap

import pytest

pytest.importorskip("mypy")

RUNS = """
import numpy as np
import modal

model = modal.StructuralModel(
    [[1.0, 0.0], [0.0, 1.0]],
    [[0.8, -0.4], [-0.4, 0.4]],
    [[800, -400], [-400, 400]],
    force_map=[[0.0], [1.0]],
    sensor_map=np.eye(2, dtype=int),
    sensor_kind="acceleration",
    elements=[(0, None), (1, 0)],
    base_motion=None,
    input_names=["shaker"],
    output_names=["lower", "upper"],
)
stiffness: np.ndarray[tuple[int, ...], np.dtype[np.float64]] = model.stiffness
chain = modal.StructuralModel.chain([1.0, 1.0], (400, 400), np.ones(2), force_dofs=1, sensor_dofs=[0, 1])
path: str = model.input_names[0]
"""
CANNOT = """
import modal

modal.StructuralModel([[1.0]], [[1.0]], [[1.0]], force_map=[[1.0]], sensor_map=[[1.0]], sensor_kind="sound")
modal.StructuralModel([[1.0]], [[1.0]], force_map=[[1.0]], sensor_map=[[1.0]], sensor_kind="velocity")
modal.StructuralModel({}, [[1.0]], [[1.0]], force_map=object(), sensor_map=[[1.0]], sensor_kind="velocity")
"""


def checked(tmp_path, script):
    file = tmp_path / "script.py"
    file.write_text(textwrap.dedent(script), encoding="utf-8")
    # the package's own bodies are checked elsewhere: here its signatures alone matter, so imports are followed silently
    command = [sys.executable, "-m", "mypy", "--strict", "--follow-imports=silent", "--config-file=", str(file)]
    run = subprocess.run(
        [*command, f"--cache-dir={tmp_path / 'cache'}"], capture_output=True, text=True, check=False, timeout=300
    )
    return [line for line in run.stdout.splitlines() if "script.py" in line]


def test_a_script_that_runs_has_no_type_errors(tmp_path):
    exec(compile(RUNS, "script.py", "exec"), {})  # noqa: S102  # the very text that mypy reads
    assert checked(tmp_path, RUNS) == []


def test_what_cannot_run_is_told_line_by_line(tmp_path):
    lines = {int(line.split(":")[1]) for line in checked(tmp_path, CANNOT)}
    assert lines == {4, 5, 6}
