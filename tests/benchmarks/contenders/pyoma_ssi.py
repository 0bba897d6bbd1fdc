"""pyOMA2: covariance-driven SSI of the outputs, and its input-output form. It gives A and C, no B and D."""

REQUIREMENTS = ("pyOMA-2",)
SETTINGS = {
    "defaults": "SSI of the outputs alone (cov, 20 block rows, as its parameters default), the model of the true order",
    "100 block rows": "SSI with the inputs (IOcov), block rows swept, the model of the true order",
}
SWEEP = {"{} block rows": (20, 40, 60, 100, 150)}


def identify(records, dt, *, setting, order):
    from block_rows import block_rows, only_one

    inputs, outputs = only_one(records, "pyOMA2")
    if setting == "defaults":
        result = diagram(inputs, outputs, dt, method="cov", n_rows=20, highest=order, step=order)
    else:
        n_rows = block_rows(setting, order, len(inputs), inputs.shape[1] + outputs.shape[1])
        result = diagram(inputs, outputs, dt, method="IOcov", n_rows=n_rows, highest=order, step=order)
    return {"A": result.A[-1], "C": result.C[-1], "dt": dt}


def diagram(inputs, outputs, dt, *, method, n_rows, highest, step):
    """SSI at all orders up to the highest, with its poles and its stability labels."""
    from pyoma2.algorithms import SSI
    from pyoma2.setup import SingleSetup

    known = {"U": inputs} if method == "IOcov" else {}
    setup = SingleSetup(outputs, fs=1 / dt)
    algorithm = SSI(name="ssi", method=method, br=n_rows, ordmax=highest, step=step, **known)
    setup.add_algorithms(algorithm)
    setup.run_by_name("ssi")
    return algorithm.result
