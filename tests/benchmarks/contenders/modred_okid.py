"""modred: OKID with ERA. It has no default for the number of Markov parameters and takes the start as at rest."""

REQUIREMENTS = ("setuptools<81", "cython", "numpy", "wheel", "--no-build-isolation modred")
SETTINGS = {"fair": "order told, twice as many Markov parameters (its observer order too) as block rows to suit"}


def identify(records, dt, *, setting, order):
    import modred
    import numpy as np
    from block_rows import block_rows, only_one

    inputs, outputs = only_one(records, "modred")
    n_lags = 2 * block_rows(order, len(inputs), inputs.shape[1] + outputs.shape[1])
    markov = modred.OKID(np.array(inputs.T), np.array(outputs.T), n_lags)
    _, sampled = modred.make_sampled_format(np.arange(n_lags - 1), markov[1:])
    A, B, C = modred.compute_ERA_model(sampled, order)
    return {"A": A, "B": B, "C": C, "D": markov[0], "dt": dt}
