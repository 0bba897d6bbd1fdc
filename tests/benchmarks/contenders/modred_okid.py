"""modred: OKID with ERA. It has no default for the number of Markov parameters and takes the start as at rest."""

REQUIREMENTS = ("setuptools<81", "cython", "numpy", "wheel", "--no-build-isolation modred")
SETTINGS = {"200 lags": "order told, Markov parameters (its observer order too) swept"}
SWEEP = {"{} lags": (40, 80, 120, 200, 300)}


def identify(records, dt, *, setting, order):
    import modred
    import numpy as np
    from block_rows import only_one, stated

    inputs, outputs = only_one(records, "modred")
    n_lags = stated(setting)
    markov = modred.OKID(np.array(inputs.T), np.array(outputs.T), n_lags)
    _, sampled = modred.make_sampled_format(np.arange(n_lags - 1), markov[1:])
    A, B, C = modred.compute_ERA_model(sampled, order)
    return {"A": A, "B": B, "C": C, "D": markov[0], "dt": dt}
