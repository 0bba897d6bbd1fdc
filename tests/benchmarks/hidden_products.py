"""A hidden case as the product's user would hold it: a model and records, through public names only."""

import inspect

import control

import modal
import okid

__all__ = ["model_of", "options_of", "record_of", "records_of"]


def model_of(case):
    """The wrong linear model: a structure, a shaft, a tank or a state space."""
    nominal = case.nominal
    kind = type(nominal).__name__
    if kind == "NominalChain":
        return modal.StructuralModel.chain(
            nominal.masses,
            nominal.stiffnesses,
            nominal.dampings,
            force_dofs=nominal.force_dofs,
            sensor_dofs=nominal.sensor_dofs,
            sensor_kind=nominal.sensor_kind,
        )
    if kind == "NominalStateSpace":
        return control.StateSpace(nominal.A, nominal.B, nominal.C, nominal.D)
    if nominal.is_flow:
        return control.StateSpace([[-nominal.b / nominal.J]], [[nominal.kt / nominal.J]], [[1.0]], [[0.0]])
    return modal.StructuralModel(
        [[nominal.J]],
        [[nominal.b]],
        [[0.0]],
        force_map=[[nominal.kt]],
        sensor_map=[[1.0]],
        sensor_kind="velocity",
        length_unit="rad",
        force_unit="N m",
    )


def options_of(case, diagnose):
    """What a state space does not say of itself and the user must."""
    sensor_kind = getattr(case.nominal, "sensor_kind", "displacement")
    if type(case.nominal).__name__ == "NominalChain" or "sensor_kind" not in inspect.signature(diagnose).parameters:
        return {}
    is_state_space = type(case.nominal).__name__ == "NominalStateSpace" or case.nominal.is_flow
    return {"sensor_kind": sensor_kind} if is_state_space else {}


def record_of(hidden):
    """One record; the noise is not told."""
    return okid.Record(hidden.inputs, hidden.outputs, hidden.dt, input_hold=hidden.hold, name=hidden.name)


def records_of(case):
    """Records to fit and records held out."""
    return [record_of(hidden) for hidden in case.fit], [record_of(hidden) for hidden in case.held_out]
