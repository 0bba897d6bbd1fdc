"""What a user's type checker says of a script that runs: nothing; and of one that cannot: something."""

import subprocess
import sys

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


@pytest.fixture(scope="module")
def said(tmp_path_factory):
    """{name of the script: the lines that mypy complains of}."""
    folder = tmp_path_factory.mktemp("scripts")
    scripts = {"runs.py": RUNS, "cannot.py": CANNOT}
    for name, text in scripts.items():
        (folder / name).write_text(text, encoding="utf-8")
    # the package's own bodies are checked elsewhere: here its signatures alone matter, so imports are followed silently
    command = [sys.executable, "-m", "mypy", "--strict", "--follow-imports=silent", "--config-file="]
    command += [f"--cache-dir={folder / 'cache'}", *(str(folder / name) for name in scripts)]
    lines = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300).stdout.splitlines()
    assert lines[-1].endswith("(checked 2 source files)"), lines
    return {name: {int(line.split(":")[1]) for line in lines if f"{name}:" in line} for name in scripts}


def test_a_script_that_runs_has_no_type_errors(said):
    exec(compile(RUNS, "script.py", "exec"), {})  # noqa: S102  # the very text that mypy reads
    assert said["runs.py"] == set()


def test_what_cannot_run_is_told_line_by_line(said):
    assert said["cannot.py"] == {4, 5, 6}
