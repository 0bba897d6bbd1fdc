"""Names of degrees of freedom: every form that is read, and names that state nothing."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from modal.geometry.sensors import Dof, dof_of

FORMS = {
    "12X+": ("12", 0, 1),
    "12+X": ("12", 0, 1),
    "12X": ("12", 0, 1),
    "12-X": ("12", 0, -1),
    "12x-": ("12", 0, -1),
    "7 Y-": ("7", 1, -1),
    "plate:3:+Z": ("plate:3", 2, 1),
    "plate:3Z": ("plate:3", 2, 1),
    "plate:3:-Z": ("plate:3", 2, -1),
    "tip Z": ("tip", 2, 1),
    "tip_z-": ("tip", 2, -1),
    "tip.Y": ("tip", 1, 1),
    "tip-Z": ("tip", 2, -1),
    "acc1z": ("acc1", 2, 1),
    "12X+ Acceleration": ("12", 0, 1),
}


@pytest.mark.parametrize("name", FORMS)
def test_each_form_names_node_axis_and_sign(name):
    node, axis, sign = FORMS[name]
    assert dof_of(name) == Dof(node=node, axis=axis, sign=sign, motion="along")
    assert dof_of(f"  {name} ") == dof_of(name)


@pytest.mark.parametrize("name", ["3RX+", "3+RX", "3:rx", "arm_RX"])
def test_an_r_before_the_axis_is_a_rotation(name):
    assert dof_of(name).motion == "about"
    assert dof_of(name).axis == 0


@pytest.mark.parametrize(
    "name", ["max", "flux", "X", "X+", "+X", "", " ", "floor_1", "12+X+", "tip--Z", "12X Acc", "12", "12W+", "motorRX"]
)
def test_other_names_state_nothing(name):
    assert dof_of(name) is None


@given(st.text(max_size=400))
def test_any_text_is_read_or_not_without_an_error(name):
    found = dof_of(name)
    if found is not None:
        assert found.node.strip()
        assert name.strip().startswith(found.node)


@given(st.integers(1, 10**6), st.sampled_from("XYZ"), st.sampled_from("+-"))
def test_the_sign_may_stand_on_either_side(node, axis, sign):
    assert dof_of(f"{node}{axis}{sign}") == dof_of(f"{node}{sign}{axis}")
    assert dof_of(f"{node}{axis}{sign}").sign == (1 if sign == "+" else -1)
