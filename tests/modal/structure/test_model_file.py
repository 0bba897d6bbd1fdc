"""Model files: what is written comes back bit for bit, hostile files give one sentence, nothing of them is run."""

import io
import json
import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modal.structure.given import PlantModel
from modal.structure.model_file import read_model, write_model
from modal.structure.structural_model import StructuralModel
from modal.structure.structural_plant import Element
from okid.errors import InvalidDataError, UnreadableFileError
from okid.record import Record

CHAIN_TOML = """
masses = [1.5, 0.8]
stiffnesses = [900.0, 700.0]
dampings = [0.9, 0.4]
force_dofs = [1]
sensor_dofs = [0, 1]
sensor_kind = "acceleration"
output_names = ["floor", "roof"]

[[effects]]
effect = "cubic_stiffness"
where = "element_1"
values = {k3 = 2e5}
"""


def rich_structure() -> StructuralModel:
    model = StructuralModel(
        [[2.0, 0.1], [0.1, 1.0 / 3.0]],
        [[0.3, -0.1], [-0.1, 0.1]],
        [[0.7, -0.2], [-0.2, 0.2]],
        force_map=[[0.0, 1.0], [0.0, 0.5]],
        sensor_map=[[1.0, 0.0], [-1.0, 1.0]],
        sensor_kind=("acceleration", "displacement"),
        elements=(Element(name='the "joint"', start=1, end=0, stiffness=0.2), (1, None)),
        base_motion=[[1.0, 0.0], [1.0, 0.0]],
        input_names=("ground", "ü # force"),
        output_units=("g", "mm"),
        damping_tolerance=0.7,
    )
    model = model.with_effect("coulomb_friction", 'the "joint"', Fc=0.1)
    return model.with_effect("periodic_disturbance", "ground_1", amplitude=1.0, frequency=2.0, phase=[0.1, 0.2])


def state_space_model() -> PlantModel:
    class System:
        A = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-500.0, 200, -0.3, 0.2], [100, -100, 0.1, -0.1]])
        B, C, D, dt = np.array([[0.0], [0.0], [1.0], [0.0]]), np.eye(4)[:2], np.zeros((2, 1)), 0.0

    model = PlantModel.from_state_space(System(), sensor_kind="displacement", output_names=["a", "b"])
    return model.with_effect("cubic_stiffness", "a-b", k3=3.0).with_effect("input_delay", "input_0", tau=0.01)


def same(first: object, second: object) -> bool:
    if isinstance(first, np.ndarray):
        return isinstance(second, np.ndarray) and first.dtype == second.dtype and np.array_equal(first, second)
    if hasattr(first, "__dataclass_fields__"):
        return type(first) is type(second) and all(
            same(getattr(first, name), getattr(second, name)) for name in first.__dataclass_fields__ if name != "_"
        )
    if isinstance(first, tuple):
        return isinstance(second, tuple) and len(first) == len(second) and all(map(same, first, second))
    return first == second or (first != first and second != second)  # noqa: PLR0124 - NaN


@pytest.mark.parametrize("ending", [".json", ".toml", ".npz"])
@pytest.mark.parametrize("make", [rich_structure, state_space_model])
def test_round_trip(tmp_path: Path, ending: str, make: object) -> None:
    model = make()
    path = write_model(model, tmp_path / f"model{ending}")
    found = read_model(path)
    assert same(found, model)
    assert same(type(model).load(path), model)
    assert list(tmp_path.iterdir()) == [path]


@given(size=st.floats(1e-300, 1e300), small=st.floats(5e-324, 1e-10))
@settings(max_examples=30, deadline=None)
def test_numbers_come_back_exactly(tmp_path_factory: pytest.TempPathFactory, size: float, small: float) -> None:
    model = StructuralModel.chain([size], [small], [0.0], force_dofs=0, sensor_dofs=0)
    folder = tmp_path_factory.mktemp("exact")
    for ending in (".json", ".toml", ".npz"):
        assert same(read_model(write_model(model, folder / f"m{ending}")), model)


def test_a_chain_by_hand(tmp_path: Path) -> None:
    path = tmp_path / "chain.toml"
    path.write_text(CHAIN_TOML)
    wanted = StructuralModel.chain(
        [1.5, 0.8],
        [900.0, 700.0],
        [0.9, 0.4],
        force_dofs=[1],
        sensor_dofs=[0, 1],
        sensor_kind="acceleration",
        output_names=["floor", "roof"],
    ).with_effect("cubic_stiffness", "element_1", k3=2e5)
    assert same(read_model(path), wanted)


def test_short_names_of_matrices_and_pairs(tmp_path: Path) -> None:
    plain = {
        "M": [[1.0, 0.0], [0.0, 2.0]],
        "C": [[0.2, -0.1], [-0.1, 0.1]],
        "K": [[7.0, -3.0], [-3.0, 3.0]],
        "force_map": [[1.0], [0.0]],
        "sensor_map": [[0.0, 1.0]],
        "sensor_kind": "velocity",
    }
    path = tmp_path / "m.json"
    path.write_text(json.dumps({**plain, "elements": [[0, "ground"], [0, 1]]}))
    from_json = read_model(path)
    assert [element.name for element in from_json.elements] == ["element_0", "element_1"]
    path.write_text(json.dumps(plain).replace("{", '{"M": [[3.0]], ', 1))
    with pytest.raises(UnreadableFileError, match="'M' is given twice"):
        read_model(path)
    path.write_text(json.dumps({**plain, "elements": [[0, "ground"], [0, 1]]}), encoding="utf-8-sig")  # as Notepad does
    assert same(read_model(path), from_json)
    np.savez(tmp_path / "m.npz", **{key: np.array(value) for key, value in plain.items()}, elements=[[0, -1], [0, 1]])
    assert same(read_model(tmp_path / "m.npz"), from_json)


def test_state_spaces(tmp_path: Path) -> None:
    path = tmp_path / "system.npz"
    np.savez(path, A=[[-5.0]], B=[[4.0]], C=[[1.0]], D=[[0.0]], sensor_kind="velocity", output_names=["speed"])
    model = read_model(path)
    assert isinstance(model, PlantModel)
    np.testing.assert_allclose(np.linalg.eigvals(model.matrices.A), [-5.0])
    assert model.plant.output_names == ("speed",)
    np.savez(path, A=[[np.exp(-0.05)]], B=[[4.0]], C=[[1.0]], D=[[0.0]], dt=0.01, sensor_kind="velocity")
    np.testing.assert_allclose(np.linalg.eigvals(read_model(path).matrices.A), [-5.0])
    (tmp_path / "static.toml").write_text('D = [[3.0, 0.2]]\ninput_names = ["x", "v"]\n')
    static = read_model(tmp_path / "static.toml")
    assert (static.plant.n_states, static.plant.input_names) == (0, ("x", "v"))


def test_a_python_file_is_run_because_it_was_named(tmp_path: Path) -> None:
    path = tmp_path / "frame.py"
    path.write_text(
        "from modal.structure.structural_model import StructuralModel\n"
        "model = StructuralModel.chain([1.0], [9.0], [0.1], force_dofs=0, sensor_dofs=0)\n"
    )
    assert read_model(path).stiffness.tolist() == [[9.0]]
    path.write_text("other = 1\n")
    with pytest.raises(UnreadableFileError, match="must define `model`, but does not"):
        read_model(path)
    path.write_text("raise SystemExit(3)\n")
    with pytest.raises(UnreadableFileError, match=r"stopped with SystemExit \(3\)"):
        read_model(path)
    path.write_text("def broken(:\n")
    with pytest.raises(UnreadableFileError, match="stopped with SyntaxError"):
        read_model(path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("masses = [1.0]\nspring = 3\n", "a chain has no key spring; the keys are masses, stiffnesses, dampings"),
        ("masses = [1.0]\n", "a chain needs .* but stiffnesses, dampings, force_dofs, sensor_dofs is missing"),
        ("title = 'x'\n", "a model file holds masses .* but this one holds title"),
        ("", "this one holds nothing"),
        ("masses = [1.0\n", "is damaged, cut off or no model file"),
        ("A = [[-1.0]]\nB = [[1.0]]\nC = [[1.0]]\nD = [[0.0]]\n", "a state space needs sensor_kind"),
        (CHAIN_TOML.replace("k3 = 2e5", "k4 = 1.0"), "cubic_stiffness lacks k3"),
        (CHAIN_TOML.replace('where = "element_1"', 'place = "element_1"'), "an effect is a table of effect, where"),
        (CHAIN_TOML.replace("cubic_stiffness", "magic"), "there is no effect 'magic' in the catalogue"),
        (CHAIN_TOML.replace("[0, 1]", "[0, 5]"), "sensor_dofs must be DOF numbers from 0 to 1, but holds 5"),
        (CHAIN_TOML.replace("900.0", '"stiff"'), "stiffnesses must be real numbers"),
        (
            CHAIN_TOML.replace("900.0", "-900.0"),
            "stiffness must be positive semidefinite|must be finite and not negative",
        ),
        (CHAIN_TOML.replace("force_dofs = [1]", "force_dofs = 1.5"), "force_dofs must be DOF numbers|damaged"),
        (
            "effects = 3\n" + CHAIN_TOML.split("[[effects]]", maxsplit=1)[0],
            "effects must be a list of tables, but is 3",
        ),
    ],
)
def test_refuses_in_one_sentence(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "model.toml"
    path.write_text(text)
    with pytest.raises(UnreadableFileError, match=words) as caught:
        read_model(path)
    assert "\n" not in str(caught.value)


def test_refuses_what_is_no_model_file(tmp_path: Path) -> None:
    with pytest.raises(UnreadableFileError, match="there is no file"):
        read_model(tmp_path / "none.json")
    with pytest.raises(UnreadableFileError, match=r"ends in \.toml, \.json, \.npz or \.py, but model\.m does not"):
        read_model(tmp_path / "model.m")
    (tmp_path / "list.json").write_text("[1, 2]")
    with pytest.raises(UnreadableFileError, match="a table of keys and values, but this is a list"):
        read_model(tmp_path / "list.json")
    (tmp_path / "deep.json").write_text("[" * 100_000)
    with pytest.raises(UnreadableFileError, match="damaged, cut off or no model file"):
        read_model(tmp_path / "deep.json")
    (tmp_path / "not.npz").write_bytes(b"PK\x03\x04 no archive")
    with pytest.raises(UnreadableFileError, match="damaged, cut off or no model file"):
        read_model(tmp_path / "not.npz")


def test_nothing_of_a_file_is_run(tmp_path: Path) -> None:
    marker = tmp_path / "was_run"

    class Evil:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return (Path.touch, (str(marker),))

    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.array([Evil()], dtype=object), allow_pickle=True)
    path = tmp_path / "evil.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("M.npy", stream.getvalue())
        archive.writestr("K.npy", pickle.dumps(Evil()))
    with pytest.raises(UnreadableFileError, match="holds pickled Python objects, which are never loaded"):
        read_model(path)
    assert not marker.exists()


def test_a_file_cannot_ask_for_more_memory_than_it_has(tmp_path: Path) -> None:
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (10**7, 10**6)})
    with zipfile.ZipFile(tmp_path / "huge.npz", "w") as archive:
        archive.writestr("mass.npy", header.getvalue())
    with pytest.raises(UnreadableFileError, match=r"pickled Python objects|announces 80000000000000 bytes"):
        read_model(tmp_path / "huge.npz")
    with zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        for number in range(5):
            archive.writestr(f"mass_{number}.npy", bytes(1 << 26))
    with pytest.raises(UnreadableFileError, match="unpacks to 335544320 bytes, and may to 268435456"):
        read_model(tmp_path / "bomb.npz")
    with (tmp_path / "long.json").open("wb") as stream:
        stream.truncate((1 << 25) + 1)
    with pytest.raises(UnreadableFileError, match="use NPZ"):
        read_model(tmp_path / "long.json")


def test_never_overwrites_unless_told(tmp_path: Path) -> None:
    model = rich_structure()
    path = model.save(tmp_path / "m.json")
    before = path.read_bytes()
    with pytest.raises(InvalidDataError, match="exists already; choose another name"):
        state_space_model().save(path)
    assert path.read_bytes() == before
    state_space_model().save(path, existing="replace")
    with pytest.raises(UnreadableFileError, match="holds a PlantModel, not a StructuralModel"):
        StructuralModel.load(path)
    model.save(path, existing="replace")
    with pytest.raises(UnreadableFileError, match="holds a StructuralModel, not a PlantModel"):
        PlantModel.load(path)
    with pytest.raises(InvalidDataError, match=r"the folder .* does not exist"):
        model.save(tmp_path / "no" / "m.json")
    with pytest.raises(InvalidDataError, match=r"ends in \.toml, \.json or \.npz, but not m\.txt"):
        model.save(tmp_path / "m.txt")
    with pytest.raises(InvalidDataError, match="existing must be refuse or replace"):
        model.save(path, existing="maybe")


def test_a_plant_whose_parts_do_not_fit(tmp_path: Path) -> None:
    path = state_space_model().save(tmp_path / "m.json")
    whole = json.loads(path.read_text())
    for change, words in (
        ({"n_inputs": 7}, "must fit together, but .*input_names.*port a"),
        ({"n_states": -1}, "must fit together, but n_states"),
        ({"parameters": []}, "must fit together, but system"),
        ({"ports": [{**whole["ports"][0], "columns": [99]}]}, "must fit together, but port a"),
        ({"ports": [{"name": "a", "spring": 1}]}, "a port is a table of name, displacement"),
        ({"linear": [1.0]}, "linear parameters must have shape"),
    ):
        path.write_text(json.dumps({**whole, **change, "effects": []}))
        with pytest.raises(UnreadableFileError, match=words):
            read_model(path)


class Found:
    """Something that has a model."""

    def __init__(self, model: object) -> None:
        self.model = model


@pytest.mark.parametrize(
    ("wrong", "remedy"),
    [
        (Record([1.0, 2.0], [1.0, 2.0], 0.1), "a Record was given; make one of them first"),
        (None, "a NoneType was given; make one"),
        ({"masses": [1.0]}, "a dict was given; make one"),
        (
            Found(StructuralModel.chain(1.0, 1.0, 0.1, force_dofs=0, sensor_dofs=0)),
            "a Found was given; pass its .model",
        ),
        (Found(3.0), "a Found was given; make one"),
    ],
)
def test_only_a_model_is_written(tmp_path: Path, wrong: object, remedy: str) -> None:
    with pytest.raises(InvalidDataError, match=remedy) as caught:
        write_model(wrong, tmp_path / "model.toml")  # type: ignore[arg-type]  # that is what is tested
    assert "StructuralModel or a PlantModel" in str(caught.value)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("wrong", [3, None, 1.5, ["model.toml"]])
def test_a_path_is_text(wrong: object) -> None:
    model = StructuralModel.chain(1.0, 1.0, 0.1, force_dofs=0, sensor_dofs=0)
    with pytest.raises(InvalidDataError, match="text or a Path"):
        write_model(model, wrong)  # type: ignore[arg-type]  # that is what is tested
    with pytest.raises(UnreadableFileError, match="text or a Path"):
        read_model(wrong)  # type: ignore[arg-type]  # that is what is tested
