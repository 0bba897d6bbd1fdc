"""One arrow okid <- era <- modal, foreign libraries behind their one package, and imports that cost little."""

import ast
import json
import subprocess
import sys

import pytest

HEAVY = (
    "rerun",
    "matplotlib",
    "control",
    "filterpy",
    "dask",
    "pint",
    "pyarrow",
    "h5py",
    "typer",
    "rich",
    "jinja2",
    "pandas",
)
BEHIND = {
    "rerun": ("modal/recording/",),
    "control": ("era/",),
    "filterpy": ("era/",),
    "matplotlib": ("modal/plots/results.py",),
    "pint": ("okid/",),
    "pyarrow": ("okid/", "modal/"),
    "h5py": ("okid/readers/",),
    "pyuff": ("okid/readers/",),
    "typer": ("modal/",),
    "rich": ("modal/",),
    "jinja2": ("modal/report/",),
    "nptdms": ("okid/readers/",),
}
SDK_FILES = {"cli", "types", "output", "exception", "app", "client", "config", "image", "object", "functions"} | {
    "schedule",
    "server",
    "runner",
}


def imported(tree):
    """(dotted name, names taken from it) of every import that runs, inside functions too; not those for types only."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        if isinstance(node, ast.Import):
            yield from ((alias.name, ()) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module or "", tuple(alias.name for alias in node.names)
        yield from imported(node)


def python(code, *, cwd):
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=cwd, check=False)
    assert result.returncode == 0, result.stderr
    return result.stdout


def test_lower_packages_never_import_higher_ones(sources):
    above = {"okid": {"era", "modal"}, "era": {"modal"}, "modal": set()}
    wrong = [
        (file, name)
        for file, tree in sources.items()
        for name, _ in imported(tree)
        if name.split(".")[0] in above[file.split("/")[0]]
    ]
    assert not wrong


def test_nothing_of_ours_takes_a_name_from_the_modal_root(sources):
    """Another distribution may own `modal/__init__.py`; only modules below it are safe."""
    modules = {file.split("/")[1].removesuffix(".py") for file in sources if file.startswith("modal/")}
    wrong = [
        (file, name)
        for file, tree in sources.items()
        for root, names in imported(tree)
        for name in names
        if root == "modal" and name not in modules
    ]
    assert not wrong


def test_file_names_avoid_those_of_the_unrelated_sdk(sources):
    top = {file.split("/")[1].removesuffix(".py") for file in sources if file.startswith("modal/")}
    assert not top & SDK_FILES


@pytest.mark.parametrize("library", sorted(BEHIND))
def test_a_foreign_library_stays_behind_its_package(library, sources):
    wrong = [
        file
        for file, tree in sources.items()
        for name, _ in imported(tree)
        if name.split(".")[0] == library and not file.startswith(BEHIND[library])
    ]
    assert not wrong


@pytest.mark.parametrize("package", ["okid", "era", "modal"])
def test_a_package_imports_alone(package, repository):
    """In a fresh interpreter, with the packages above it not to be had."""
    above = {"okid": ["era", "modal"], "era": ["modal"], "modal": []}[package]
    block = "".join(f"sys.modules[{name!r}] = None; " for name in above)
    assert python(f"import sys; {block}import {package}; print('done')", cwd=repository) == "done\n"


@pytest.mark.parametrize("package", ["okid", "era", "modal"])
def test_importing_leaves_heavy_libraries_out(package, repository):
    loaded = json.loads(python(f"import sys, json, {package}; print(json.dumps(list(sys.modules)))", cwd=repository))
    roots = {name.split(".")[0] for name in loaded}
    assert not roots & set(HEAVY)
    assert not [name for name in loaded if name.startswith(("scipy.signal", "scipy.optimize", "scipy.stats"))]


DEMO = """
import json, sys
import numpy as np
import modal
from modal.examples.demo import demo_record
modal.identify(demo_record(np.random.default_rng(7), n_samples=2000))
print(json.dumps(list(sys.modules)))
"""
MOTOR = """
import json, sys
import numpy as np
import modal
from modal.examples.motor_propeller import Motor, measured_record
rng = np.random.default_rng(1)
slow, fast, middle = (measured_record(Motor(), rng, voltages=v, name="run") for v in ((1, 4), (3, 12), (2, 8)))
model = modal.StructuralModel(
    [[8e-5]], [[9.3e-4]], [[0]], force_map=[[0.0909]], sensor_map=[[1]], sensor_kind="velocity",
    input_names=["voltage"], output_names=["speed"], input_units=["V"], length_unit="rad", force_unit="N m",
)
assert modal.discrepancy.diagnose(model, fit=[slow, fast], held_out=middle).findings
print(json.dumps(list(sys.modules)))
"""


@pytest.mark.parametrize("code", [DEMO, MOTOR], ids=["identify", "diagnose"])
def test_neither_road_loads_the_slow_parts_of_scipy(code, repository):
    """They cost more than a short identification, for one quantile, one filter or one spline."""
    loaded = json.loads(python(code, cwd=repository))
    assert "scipy.linalg" in loaded
    assert not [name for name in loaded if name.startswith(("scipy.signal", "scipy.stats", "scipy.interpolate"))]


def test_a_script_pays_for_the_parts_it_uses(repository):
    """`identify` needs none of diagnosis, report, pictures, recording."""
    loaded = json.loads(python(DEMO, cwd=repository))
    parts = ("modal.discrepancy", "modal.report", "modal.plots", "modal.recording")
    assert not [name for name in loaded if name.startswith(parts)]


def test_the_public_table_is_whole():
    import modal

    assert set(modal._PLACES) == set(modal.__all__) <= set(dir(modal))
    assert all(getattr(modal, name).__name__.split(".")[-1] == name for name in modal.__all__)
    assert not hasattr(modal, "no_such_name")


def test_okid_costs_little_more_than_numpy(repository):
    """Modules, not seconds: a clock says little on a shared machine. scipy loads its parts when they are used."""

    def loaded(names):
        modules = json.loads(python(f"import sys, json, {names}; print(json.dumps(list(sys.modules)))", cwd=repository))
        return {name for name in modules if name.split(".")[0].lstrip("_") not in known}

    known = {name.lstrip("_") for name in sys.stdlib_module_names}
    more = loaded("okid") - loaded("numpy, scipy")
    assert {name.split(".")[0] for name in more} <= {"okid", "numpy"}  # numpy.random and its kin load late
    assert len(loaded("numpy, scipy") - loaded("numpy")) < 60


def test_importing_prints_nothing_and_changes_no_setting(repository):
    code = (
        "import warnings, numpy as np; before = (list(warnings.filters), np.geterr(), np.get_printoptions());"
        "import okid, era, modal;"
        "assert before == (list(warnings.filters), np.geterr(), np.get_printoptions())"
    )
    assert python(code, cwd=repository) == ""
