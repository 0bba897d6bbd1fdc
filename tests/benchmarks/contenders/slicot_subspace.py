"""SLICOT's subspace routines IB01MD, IB01ND, IB01OD, IB01BD, IB01CD, by the distribution `ctrlsys`."""

REQUIREMENTS = ("ctrlsys", "numpy")
SETTINGS = {
    "defaults": "15 block rows and order by the largest gap, as the example of IB01AD; MOESP, B and D by IB01BD",
    "60 block rows": "MOESP, order told, block rows swept; B and D by IB01CD (from the longest record)",
    "100 block rows": "the same, nearer to the bound, with more weak modes missed",
}
SWEEP = {"{} block rows": (20, 40, 60, 100, 150, 200)}


def identify(records, dt, *, setting, order):
    import ctrlsys
    import numpy as np
    from block_rows import block_rows

    # copies: IB01CD works in the place of its data
    data = [(np.array(u, order="F"), np.array(y, order="F")) for u, y in records]
    n_inputs, n_outputs = data[0][0].shape[1], data[0][1].shape[1]
    n_samples = sum(len(u) for u, _ in data)
    n_rows = 15 if setting == "defaults" else block_rows(setting, order, n_samples, n_inputs + n_outputs)
    R = triangular_factor(data, n_rows)
    R, singular_values, *_, info = ctrlsys.ib01nd("M", "N", n_rows, n_inputs, n_outputs, R, 0.0)
    check("IB01ND", info)
    if setting == "defaults":
        order = ctrlsys.ib01od("N", n_rows, n_outputs, singular_values, -1.0)[0]
    both = setting == "defaults"
    sizes = n_rows, order, n_inputs, n_outputs, n_samples
    found = ctrlsys.ib01bd("C" if both else "M", "A" if both else "C", "N", *sizes, np.asfortranarray(R), 0.0)
    check("IB01BD", found[-1])
    A, C, B, D = (np.array(part, order="F") for part in found[:4])
    if not both:
        # IB01BD would take B and D from several records too, but ctrlsys gives it too little room from 20 block rows on
        longest = max(data, key=lambda record: len(record[0]))
        B, D = np.zeros((order, n_inputs), order="F"), np.zeros((n_outputs, n_inputs), order="F")
        _, B, D, *_, info = ctrlsys.ib01cd("X", "C", "D", order, n_inputs, n_outputs, A, B, C, D, *longest, 0.0)
        check("IB01CD", info)
    return {"A": A, "B": B, "C": C, "D": D, "dt": dt}


def check(routine, info):
    if info:
        raise RuntimeError(f"{routine} gave info {info}")


def triangular_factor(data, n_rows):
    """R of IB01MD, record by record, the records not joined: fast Cholesky, or QR where that breaks down."""
    for algorithm in ("C", "Q"):
        R, info = hankel_factor(data, n_rows, algorithm)
        if not info:
            return R
    raise RuntimeError(f"IB01MD gave info {info}")


def hankel_factor(data, n_rows, algorithm):
    import ctrlsys

    sizes = n_rows, data[0][0].shape[1], data[0][1].shape[1]
    if len(data) == 1:
        R, _, info = ctrlsys.ib01md("M", algorithm, "O", "N", *sizes, *data[0])
        return R, info
    R, work, _, info = ctrlsys.ib01md("M", algorithm, "F", "N", *sizes, *data[0])
    for u, y in data[1:-1]:
        R, work, _, info = ctrlsys.ib01md("M", algorithm, "I", "N", *sizes, u, y, R, work)
        if info:
            return R, info
    R, _, info = ctrlsys.ib01md("M", algorithm, "L", "N", *sizes, *data[-1], R, work)
    return R, info
