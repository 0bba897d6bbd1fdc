"""A discrete-time state-space model with the evidence it was cut from.

The states x answer to the inputs u and to the innovations e, what the outputs y hold beyond their one-step prediction:

    x(k+1) = A x(k) + B u(k) + K e(k)
    y(k)   = C x(k) + D u(k) + e(k)

Samples of an input that moves between them (a force limited to half the sampling frequency is none that is held) also
tell of the output before: the sum over its samples that gives the force at an instant runs both ways. A model with a
lead L is driven by u(k+L) in the place of u(k). It describes records; nothing that has to answer now can run it.

Passage to and from python-control.
"""

import warnings
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from okid.arrays import FloatArray, frozen, time_step, whole_number
from okid.display import Displayed
from okid.errors import IdentificationWarning, InvalidDataError
from okid.record import check_names, labels

if TYPE_CHECKING:
    from control import StateSpace


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class HankelFactors(Displayed):
    """The balanced factors H(0) = observability @ controllability that the SVD of the block Hankel matrix gave.

    They are data, not model: rebuilt from (A, B, C) they would make every accuracy indicator 1. Channels are scaled
    (output i by 1/output_scale[i], input j by 1/input_scale[j]).

    Attributes:
        observability: (n_block_rows * n_outputs, n_kept) U S^(1/2).
        controllability: (n_kept, n_block_columns * n_channels) S^(1/2) V'. The channels are the inputs; the outputs
            where the gain was realised for want of inputs; inputs, then outputs where both were.
        n_block_rows: a, number of block rows.
        n_block_columns: b, number of block columns.
        input_scale: (n_inputs,) by which inputs were scaled.
        output_scale: (n_outputs,) by which outputs were scaled.
        observer_order: p of the observer that the Markov parameters came from, None when they were measured.

    Raises:
        InvalidDataError: factors that do not fit together, or values that are not finite.
    """

    observability: FloatArray
    controllability: FloatArray
    n_block_rows: int
    n_block_columns: int
    input_scale: FloatArray
    output_scale: FloatArray
    observer_order: int | None

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_(self, "input_scale", frozen(self.input_scale, name="input_scale", shape=(None,)))
        set_(self, "output_scale", frozen(self.output_scale, name="output_scale", shape=(None,)))
        n_rows = self.n_block_rows * self.output_scale.size
        set_(self, "observability", frozen(self.observability, name="observability", shape=(n_rows, None)))
        n_kept = self.observability.shape[1]
        set_(self, "controllability", frozen(self.controllability, name="controllability", shape=(n_kept, None)))
        if self.controllability.shape[1] % self.n_block_columns:
            raise InvalidDataError(
                f"controllability must have a whole number of columns for each of its {self.n_block_columns} blocks, "
                f"but has {self.controllability.shape[1]} columns."
            )

    def truncated(self, order: int) -> "HankelFactors":
        """The factors of a lower order."""
        return HankelFactors(
            observability=self.observability[:, :order],
            controllability=self.controllability[:order],
            n_block_rows=self.n_block_rows,
            n_block_columns=self.n_block_columns,
            input_scale=self.input_scale,
            output_scale=self.output_scale,
            observer_order=self.observer_order,
        )


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Realisation(Displayed):
    """State-space model in the units of the record; see the module for its equations.

    Attributes:
        A: (order, order); order 0 is a pure feedthrough.
        B: (order, n_inputs).
        C: (n_outputs, order).
        D: (n_outputs, n_inputs).
        dt: time step [s].
        K: (order, n_outputs) gain of the one-step predictor, None when none is known.
        singular_values: of the scaled block Hankel matrix, all that were computed; empty after `from_control`.
        factors: Hankel factors of this order, None when the model did not come from data.
        lead: samples by which the model looks ahead in its inputs.
        input_names: one an input; () where they have none.
        output_names: one an output; () where they have none.

    Raises:
        InvalidDataError: matrices that do not fit together, values that are not finite, dt that is not positive, a
            negative lead.

    Example:
        >>> Realisation([[0.5]], [[1.0]], [[2.0]], [[0.0]], 0.01).order
        1
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    dt: float
    _: KW_ONLY
    K: FloatArray | None = None
    singular_values: FloatArray = ()  # type: ignore[assignment]  # an array once constructed
    factors: HankelFactors | None = None
    lead: int = 0
    input_names: tuple[str, ...] = ()
    output_names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_(self, "lead", whole_number(self.lead, name="lead, the samples that a model looks ahead,", least=0))
        set_(self, "D", frozen(self.D, name="D", shape=(None, None)))
        n_outputs, n_inputs = self.D.shape
        set_(self, "A", frozen(self.A, name="A", shape=(None, None)))
        order = self.A.shape[0]
        set_(self, "A", frozen(self.A, name="A", shape=(order, order)))
        set_(self, "B", frozen(self.B, name="B", shape=(order, n_inputs)))
        set_(self, "C", frozen(self.C, name="C", shape=(n_outputs, order)))
        if self.K is not None:
            set_(self, "K", frozen(self.K, name="K", shape=(order, n_outputs)))
        set_(self, "singular_values", frozen(self.singular_values, name="singular_values", shape=(None,)))
        set_(self, "dt", time_step(self.dt))
        for kind, count in (("input", n_inputs), ("output", n_outputs)):
            given = getattr(self, f"{kind}_names")
            given = given if given is None or isinstance(given, str) else tuple(given)
            names = labels(given, count, kind, named=True) if given else ()
            check_names(names)
            set_(self, f"{kind}_names", names)
        if self.factors is not None and self.factors.observability.shape[1] != order:
            raise InvalidDataError(
                f"the Hankel factors must be those of the model's order {order}, but hold "
                f"{self.factors.observability.shape[1]} states; use factors.truncated({order})."
            )

    def __repr__(self) -> str:
        return (
            f"Realisation(order {self.order}, {self.n_inputs} inputs, {self.n_outputs} outputs, dt {self.dt:.6g} s, "
            f"{'no gain' if self.K is None else 'with gain'}"
            f"{f', inputs {self.lead} samples ahead' if self.lead else ''})"
        )

    @property
    def order(self) -> int:
        """Number of states."""
        order: int = self.A.shape[0]
        return order

    @property
    def n_inputs(self) -> int:
        """Number of inputs."""
        n_inputs: int = self.D.shape[1]
        return n_inputs

    @property
    def n_outputs(self) -> int:
        """Number of outputs."""
        n_outputs: int = self.D.shape[0]
        return n_outputs

    def truncated(self, order: int) -> "Realisation":
        """The balanced model of a lower order: a corner of this one.

        Raises:
            InvalidDataError: an order outside 0 ... order, or a model whose states are not balanced (no Hankel
                factors).
        """
        order = whole_number(order, name="a model order", least=0)
        if order > self.order:
            raise InvalidDataError(
                f"a model of order {self.order} can be truncated to orders 0 to {self.order}, not to {order}."
            )
        if self.factors is None:
            raise InvalidDataError(
                "only a balanced model can be truncated, and this one did not come from a block Hankel matrix; use "
                "control.balred on to_control(), or realise its Markov parameters."
            )
        return Realisation(
            A=self.A[:order, :order],
            B=self.B[:order],
            C=self.C[:, :order],
            D=self.D,
            dt=self.dt,
            K=None if self.K is None else self.K[:order],
            singular_values=self.singular_values,
            factors=self.factors.truncated(order),
            lead=self.lead,
            input_names=self.input_names,
            output_names=self.output_names,
        )

    def to_control(self, *, inputs: Sequence[str] | None = None, outputs: Sequence[str] | None = None) -> "StateSpace":
        """As a discrete-time `control.StateSpace` with the same matrices and dt; the gain K is not part of it.

        Of a model that looks ahead it is that of the inputs ahead, with a warning: no causal system has the lead.

        Args:
            inputs: names that its inputs get; its own unless given.
            outputs: names that its outputs get; its own unless given.
        """
        return to_control(self, inputs=inputs, outputs=outputs)

    @classmethod
    def from_control(cls, system: object) -> "Realisation":
        """From a discrete-time `control.StateSpace` (or what `control.ss` takes) with a time step in seconds.

        Raises:
            InvalidDataError: a continuous-time system, or no time step.
        """
        return from_control(system)


def to_control(
    realisation: Realisation, *, inputs: Sequence[str] | None = None, outputs: Sequence[str] | None = None
) -> Any:
    """`control.StateSpace` with the same matrices and time step; its channels are named as given, else as the model's.

    The package takes no dot in a name: it is given "_" there, with a warning.

    Example:
        >>> system = to_control(Realisation([[0.5]], [[1.0]], [[2.0]], [[0.0]], 0.01), inputs=["force"])
        >>> system.dt, system.input_labels
        (0.01, ['force'])
    """
    import control

    model = realisation
    warn_of_lead(model)
    into, out = _without_dots(inputs or model.input_names), _without_dots(outputs or model.output_names)
    return control.StateSpace(
        model.A, model.B, model.C, model.D, model.dt, inputs=into, outputs=out, remove_useless_states=False
    )


def _without_dots(names: Sequence[str]) -> list[str] | None:
    """As python-control takes them; None, its own names, where two would become one, or there are none."""
    told = [name.replace(".", "_") for name in names]
    apart = len(set(told)) == len(told)
    if told != list(names):
        then = f"called {', '.join(told)} there" if apart else "left out, since they would not stay apart"
        warnings.warn(
            f"python-control takes no dot in the name of a channel, so of {', '.join(names)} all are {then}.",
            IdentificationWarning,
            stacklevel=4,
        )
    return told if told and apart else None


def warn_of_lead(realisation: Realisation) -> None:
    """Warn where what is made of a model knows no lead and has to be driven by inputs that are early."""
    if realisation.lead:
        warnings.warn(
            f"the model looks {realisation.lead} samples ahead in its inputs, which nothing causal can; drive what is "
            f"made of it by inputs {realisation.lead} samples early.",
            IdentificationWarning,
            stacklevel=3,
        )


def from_control(system: object) -> Realisation:
    """Realisation of a discrete-time linear system of python-control, with the names of its channels.

    Names that the package gave itself, u[0] and y[0], are none.

    Args:
        system: `control.StateSpace`, or a transfer function that `control.ss` can convert.

    Raises:
        InvalidDataError: not a linear system, continuous time, or no time step in seconds.

    Example:
        >>> import control
        >>> from_control(control.ss([[0.5]], [[1.0]], [[2.0]], [[0.0]], 0.01)).order
        1
    """
    import control

    given: Any = system
    if not isinstance(given, control.StateSpace):
        try:
            given = control.ss(given)
        except Exception as error:
            raise InvalidDataError(
                f"a realisation is made from a linear system of python-control, but {type(given).__name__} cannot be "
                f"converted ({error}); pass a control.StateSpace."
            ) from error
    dt = given.dt
    if dt is not None and not isinstance(dt, bool) and dt == 0:
        raise InvalidDataError(
            "a realisation is discrete in time, but this system is continuous; discretise it first, for example "
            "control.sample_system(system, dt, method='zoh')."
        )
    if dt is None or isinstance(dt, bool):
        raise InvalidDataError(
            f"a realisation needs a time step in seconds, but this system has dt={dt}; give it one, for example "
            "control.ss(A, B, C, D, 0.01)."
        )
    A, B, C, D = (np.asarray(part, dtype=np.float64) for part in (given.A, given.B, given.C, given.D))
    into, out = _own(given.input_labels, "u"), _own(given.output_labels, "y")
    return Realisation(A, B, C, D, float(dt), input_names=into, output_names=out)


def _own(names: Sequence[str], letter: str) -> tuple[str, ...]:
    return () if list(names) == [f"{letter}[{k}]" for k in range(len(names))] else tuple(names)
