"""The public table: names that scripts call, documented arguments, no misspelt keyword accepted, frozen types."""

import dataclasses
import importlib
import inspect
import re

import numpy as np
import pytest
from public_table import dataclasses_everywhere, module_names, public_functions, public_table, public_types

from okid.display import Displayed

EMPTY = inspect.Parameter.empty

POSITIONAL = {
    "okid.Record": ["inputs", "outputs", "dt"],
    "okid.read_record": ["path"],
    "okid.fit_observer": ["records"],
    "okid.recover_markov": ["observer"],
    "okid.MarkovParameters": [],
    "era.realise": ["markov"],
    "era.simulate": ["realisation", "record"],
    "era.predict": ["realisation", "record"],
    "modal.extract_modes": ["realisation"],
    "modal.identify": ["records"],
    "modal.frequency_response": ["result"],
    "modal.load": ["path"],
    "modal.log_identification": ["identification", "recording"],
    "modal.save_recording": ["result", "path"],
    "modal.write_report": ["result", "folder"],
    "modal.log_diagnosis": ["diagnosis", "recording"],
    "modal.StructuralModel": ["mass", "damping", "stiffness"],
    "modal.StructuralModel.chain": ["masses", "stiffnesses", "dampings"],
    "modal.simulate": ["model", "record_or_inputs"],
    "modal.read_model": ["path"],
    "modal.write_model": ["model", "path"],
    "modal.check_quality": ["records"],
    "modal.check_limits": ["result", "specification"],
    "modal.read_specification": ["path"],
    "modal.read_geometry": ["path"],
    "modal.read_result": ["path"],
    "modal.compare_results": ["before", "after"],
    "modal.discrepancy.diagnose": ["model", "fit", "held_out"],
    "modal.discrepancy.register": ["effect"],
}
"""Positional arguments as DESIGN.md writes them: scripts outside this repository call exactly these."""

POSITIONAL_OPTIONS = {("modal.frequency_response", "frequencies")}
"""What DESIGN.md writes without a name although it may be left out."""

KEYWORDS = {
    "okid.Record": {"input_names", "output_names", "input_units", "output_units", "input_hold", "name"},
    "okid.read_record": {"inputs", "outputs", "dt", "input_hold"},
    "okid.fit_observer": {"order", "ridge"},
    "okid.recover_markov": {"n_lags"},
    "okid.MarkovParameters": {"system", "dt", "gain"},
    "era.realise": {"order"},
    "era.simulate": {"initial_state"},
    "modal.identify": {"observer_order", "ridge", "order"},
    "modal.StructuralModel": {"force_map", "sensor_map", "sensor_kind", "elements", "base_motion"},
    "modal.StructuralModel.chain": {"force_dofs", "sensor_dofs", "sensor_kind"},
    "modal.discrepancy.diagnose": {"catalogue"},
}
ATTRIBUTES = {
    "okid.MarkovParameters": {"system", "gain", "dt"},
    "era.Realisation": {
        *("A", "B", "C", "D", "K", "dt", "singular_values", "order", "factors"),
        *("truncated", "to_control", "from_control"),
    },
    "modal.Identification": {
        *("records", "observer", "markov", "realisation", "modes", "choices", "fit", "warnings", "save")
    },
    "modal.ModalModel": {"modes", "system", "frequencies", "damping_ratios", "shapes", "indicator_caution"},
    "modal.Mode": {
        *("pole", "kind", "frequency", "damping_ratio", "frequency_std", "damping_ratio_std", "shape"),
        *("participation", "amplitude_coherence", "phase_collinearity", "emac_output", "emac_input", "emac"),
        *("cmi", "msv", "mpd", "repeatability", "probability", "verdict", "damping_resolved", "reason"),
    },
    "modal.StructuralModel": {"chain", "with_effect", "equations", "save", "load", "natural_frequencies"},
    "modal.PlantModel": {"with_effect", "equations", "save", "load"},
    "modal.discrepancy.Diagnosis": {
        *("status", "findings", "model", "noise_floor", "gap_before", "gap_after", "closed", "calibrated"),
        *("bounds_hit", "detection_limits", "advice"),
    },
    "modal.discrepancy.Finding": {"effect", "where", "parameters", "evidence", "runner_up", "ambiguous_with"},
}

CATALOGUE = {
    *("cubic_stiffness", "quadratic_stiffness", "bilinear_stiffness", "gap_spring", "coulomb_friction"),
    *("quadratic_drag", "bouc_wen_hysteresis", "sine_softening", "slack_in_hysteresis", "constant_force"),
    *("time_varying_stiffness", "missing_mode", "input_delay", "input_saturation", "input_gain", "sensor_bias"),
    *("sensor_gain", "periodic_disturbance", "power_law_flow", "overflow"),
    *("smooth_stiffness", "smooth_damping"),
    *("stribeck_friction", "actuator_lag", "sensor_lag", "record_offset"),
}
"""Keys of the catalogue as DESIGN.md writes them."""
FUNCTIONS, TYPES = public_functions(), public_types()


def parameters(function):
    return [p for p in inspect.signature(function).parameters.values() if p.name not in {"self", "cls"}]


def section(docstring, *titles):
    """Text of the first section of the docstring with one of these titles."""
    lines = inspect.cleandoc(docstring or "").splitlines()
    for title in titles:
        if f"{title}:" in lines:
            start = lines.index(f"{title}:") + 1
            length = next((i for i, line in enumerate(lines[start:]) if line and line[0] != " "), len(lines))
            return "\n".join(lines[start : start + length])
    return ""


@pytest.mark.parametrize("name", sorted(name for name, kind in TYPES.items() if dataclasses.is_dataclass(kind)))
def test_public_types_show_themselves_in_notebooks_too(name):
    assert issubclass(TYPES[name], Displayed)
    assert not hasattr(TYPES[name].__repr__, "__wrapped__")  # that of a dataclass, which writes out every field


def documented(text):
    """Names before the colon of each entry: "    order: ..." and "    A, B: ..."."""
    entries = re.findall(r"^ {4}([\w, ]+?)(?: \([^)]*\))?:", text, re.MULTILINE)
    return {name.strip() for entry in entries for name in entry.split(",")}


def named(name):
    """The public thing, or the attribute of one, of a dotted name."""
    table = public_table()
    owner, _, attribute = name.rpartition(".")
    return table[name] if name in table else getattr(table[owner], attribute)


@pytest.mark.parametrize("name", sorted(POSITIONAL))
def test_a_script_can_call_it_as_the_design_says(name):
    function = named(name)
    given = parameters(function)
    positional = [p.name for p in given if p.kind is not p.KEYWORD_ONLY and p.default is EMPTY]
    assert positional == POSITIONAL[name]
    assert KEYWORDS.get(name, set()) <= {p.name for p in given if p.kind is p.KEYWORD_ONLY}


@pytest.mark.parametrize("name", sorted(ATTRIBUTES))
def test_a_type_has_the_attributes_of_the_design(name):
    kind = public_table()[name]
    assert ATTRIBUTES[name] <= {field.name for field in dataclasses.fields(kind)} | set(dir(kind))


def test_the_catalogue_has_the_keys_of_the_design_and_cannot_be_changed():
    catalogue = public_table()["modal.discrepancy.CATALOGUE"]
    assert set(catalogue) == CATALOGUE
    assert all(effect.key == key for key, effect in catalogue.items())
    with pytest.raises(TypeError):
        catalogue["mine"] = catalogue["cubic_stiffness"]


def test_the_tables_hold_what_they_name():
    for module in map(importlib.import_module, module_names()):
        assert all(hasattr(module, name) for name in getattr(module, "__all__", ())), module.__name__
    assert len(FUNCTIONS) >= 10
    assert len(TYPES) >= 10


@pytest.mark.parametrize("name", sorted(FUNCTIONS))
def test_every_argument_is_documented(name):
    function = FUNCTIONS[name]
    wanted = {p.name for p in parameters(function)}
    assert wanted <= documented(section(function.__doc__, "Args"))


@pytest.mark.parametrize("name", sorted(name for name, kind in TYPES.items() if dataclasses.is_dataclass(kind)))
def test_every_field_is_documented(name):
    kind = TYPES[name]
    text = section(kind.__doc__, "Attributes", "Args")
    assert {field.name for field in dataclasses.fields(kind)} <= documented(text)


@pytest.mark.parametrize("name", sorted(TYPES))
def test_every_public_method_is_documented(name):
    kind = TYPES[name]
    own = [method for word, method in vars(kind).items() if not word.startswith("_")]
    for method in own:
        function = getattr(method, "fget", None) or getattr(method, "__func__", method)
        if not inspect.isfunction(function):
            continue
        assert function.__doc__, function.__qualname__
        for parameter in parameters(function):
            assert re.search(rf"\b{parameter.name}\b", function.__doc__), f"{function.__qualname__}: {parameter.name}"


@pytest.mark.parametrize("name", sorted(FUNCTIONS))
def test_options_are_named(name):
    """What may be left out must be named, and no option is a switch that reads `True` at the call."""
    for parameter in parameters(FUNCTIONS[name]):
        if parameter.default is not EMPTY and (name, parameter.name) not in POSITIONAL_OPTIONS:
            assert parameter.kind is parameter.KEYWORD_ONLY, parameter.name
            assert not isinstance(parameter.default, bool), parameter.name


@pytest.mark.parametrize(
    "name", sorted([*FUNCTIONS, *(name for name, k in TYPES.items() if dataclasses.is_dataclass(k))])
)
def test_a_misspelt_keyword_is_an_error(name):
    with pytest.raises(TypeError, match="unexpected keyword argument 'ordre'"):
        public_table()[name](ordre=1)


def holds_arrays(hint):
    if isinstance(hint, str):
        return "Array" in hint
    return getattr(hint, "__origin__", hint) is np.ndarray or any(map(holds_arrays, getattr(hint, "__args__", ())))


def test_types_are_frozen():
    """Frozen and slotted; one with arrays is equal only to itself, for arrays have no single truth value."""
    kinds = dataclasses_everywhere()
    wrong = [n for n, k in kinds.items() if not k.__dataclass_params__.frozen or "__slots__" not in vars(k)]
    wrong += [
        f"{name}: eq"
        for name, kind in kinds.items()
        if kind.__dataclass_params__.eq and any(holds_arrays(field.type) for field in dataclasses.fields(kind))
    ]
    assert len(kinds) > 15
    assert not wrong


def arrays(value, where):
    if dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            yield from arrays(getattr(value, field.name), f"{where}.{field.name}")
    elif isinstance(value, tuple):
        for i, item in enumerate(value):
            yield from arrays(item, f"{where}[{i}]")
    elif isinstance(value, np.ndarray):
        yield where, value


def test_every_array_of_a_result_is_read_only(small_identification):
    found = list(arrays(small_identification, "result"))
    assert len(found) > 20
    assert not [where for where, array in found if array.flags.writeable]


def test_a_record_of_a_writeable_array_does_not_change_with_it():
    import okid

    inputs, outputs = np.zeros((50, 1)), np.zeros((50, 2))
    record = okid.Record(inputs, outputs, 0.1)
    inputs[:], outputs[:] = 1.0, 1.0
    assert not record.inputs.any()
    assert not record.outputs.any()
    with pytest.raises(ValueError, match="read-only"):
        record.outputs[0, 0] = 1.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        record.dt = 1.0
