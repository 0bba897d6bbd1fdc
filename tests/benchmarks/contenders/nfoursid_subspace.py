"""nfoursid: the PO-MOESP of Verhaegen and Verdult."""

REQUIREMENTS = ("nfoursid",)
SETTINGS = {
    "defaults": "2 block rows and every state that they give, as its constructor and method default",
    "60 block rows": "order told, block rows swept",
}
SWEEP = {"{} block rows": (20, 40, 60)}


def identify(records, dt, *, setting, order):
    import pandas as pd
    from block_rows import block_rows, only_one
    from nfoursid.nfoursid import NFourSID

    inputs, outputs = only_one(records, "nfoursid")
    into, out = ([f"{kind}{i}" for i in range(part.shape[1])] for kind, part in (("u", inputs), ("y", outputs)))
    frame = pd.DataFrame(dict(zip([*into, *out], [*inputs.T, *outputs.T], strict=True)))
    if setting == "defaults":
        method = NFourSID(frame, output_columns=out, input_columns=into)
        method.subspace_identification()
        model, _ = method.system_identification()
    else:
        rows = block_rows(setting, order, len(inputs), len(into) + len(out))
        method = NFourSID(frame, output_columns=out, input_columns=into, num_block_rows=rows)
        method.subspace_identification()
        model, _ = method.system_identification(rank=order)
    return {"A": model.a, "B": model.b, "C": model.c, "D": model.d, "dt": dt}
