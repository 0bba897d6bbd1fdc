"""SIPPY's subspace methods (distribution `sippy-unipi`; `sippy` on the index is a telephony package)."""

REQUIREMENTS = ("sippy-unipi",)
SETTINGS = {
    "defaults": "N4SID, horizon 20, order by its singular value threshold 0.1, D not estimated",
    "fair": "N4SID, order told, horizon to suit, D estimated",
    "fair, PARSIM-K": "PARSIM-K, order told, horizons 20 (it is slow), D estimated",
}


def identify(records, dt, *, setting, order):
    import numpy as np
    from block_rows import block_rows, only_one
    from sippy_unipi import system_identification

    inputs, outputs = only_one(records, "SIPPY")
    u, y = np.array(inputs.T), np.array(outputs.T)
    horizon = block_rows(order, len(inputs), len(u) + len(y))
    if setting == "defaults":
        model = system_identification(y, u, "N4SID", tsample=dt)
    elif setting == "fair, PARSIM-K":
        model = system_identification(
            y, u, "PARSIM-K", tsample=dt, SS_f=20, SS_p=20, SS_fixed_order=order, SS_D_required=True
        )
    else:
        model = system_identification(y, u, "N4SID", tsample=dt, SS_f=horizon, SS_fixed_order=order, SS_D_required=True)
    return {"A": model.A, "B": model.B, "C": model.C, "D": model.D, "dt": dt}
