"""mdof: OKID with ERA, and SRIM."""

REQUIREMENTS = ("setuptools<81", "mdof")
SETTINGS = {
    "defaults": "mdof.sysid(inputs, outputs): SRIM, order 20, horizon 300",
    "SRIM, 150 block rows": "SRIM, order told, horizon swept",
    "OKID, 300 lags": "OKID with ERA, order told, observer lags swept, half as many block rows",
}
SWEEP = {"SRIM, {} block rows": (20, 40, 60, 100, 150), "OKID, {} lags": (40, 80, 120, 200, 300)}


def identify(records, dt, *, setting, order):
    import mdof
    import numpy as np
    from block_rows import block_rows, only_one, stated

    inputs, outputs = only_one(records, "mdof")
    u, y = np.array(inputs.T), np.array(outputs.T)
    if setting == "defaults":
        A, B, C, D = mdof.sysid(u, y, dt=dt)
    elif setting.startswith("SRIM"):
        rows = block_rows(setting, order, len(inputs), len(u) + len(y))
        A, B, C, D = mdof.sysid(u, y, dt=dt, method="srim", order=order, horizon=rows, threads=1)
    else:
        lags = stated(setting)
        A, B, C, D = mdof.sysid(
            u, y, dt=dt, method="okid-era", order=order, m=lags, horizon=lags // 2, nc=lags // 2 - 1
        )
    return {"A": A, "B": B, "C": C, "D": D, "dt": dt}
