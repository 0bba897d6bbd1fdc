"""mdof: OKID with ERA, and SRIM."""

REQUIREMENTS = ("setuptools<81", "mdof")
SETTINGS = {
    "defaults": "mdof.sysid(inputs, outputs): SRIM, order 20, horizon 300",
    "fair, SRIM": "SRIM, order told, horizon to suit",
    "fair, OKID": "OKID with ERA, order told, as many observer lags as block rows to suit",
}


def identify(records, dt, *, setting, order):
    import mdof
    import numpy as np
    from block_rows import block_rows, only_one

    inputs, outputs = only_one(records, "mdof")
    u, y = np.array(inputs.T), np.array(outputs.T)
    rows = block_rows(order, len(inputs), len(u) + len(y))
    if setting == "defaults":
        A, B, C, D = mdof.sysid(u, y, dt=dt)
    elif setting == "fair, SRIM":
        A, B, C, D = mdof.sysid(u, y, dt=dt, method="srim", order=order, horizon=rows, threads=1)
    else:
        A, B, C, D = mdof.sysid(u, y, dt=dt, method="okid-era", order=order, m=2 * rows, horizon=rows, nc=rows - 1)
    return {"A": A, "B": B, "C": C, "D": D, "dt": dt}
