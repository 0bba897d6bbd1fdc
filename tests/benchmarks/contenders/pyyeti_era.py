"""pyYeti: ERA of pulse responses. It has no observer: they come from the spectra, as its users do (H1, inverse FFT)."""

REQUIREMENTS = ("pyyeti",)
SETTINGS = {
    "defaults": "ERA(auto=True): its own choice of modes by its indicators; H1 with 1024-sample Hann windows",
    "1024-sample windows": "number of modes told, windows swept, 100 block rows",
}
SWEEP = {"{}-sample windows": (512, 1024, 2048)}
BLOCKS = 100


def identify(records, dt, *, setting, order):
    import numpy as np
    from block_rows import only_one, stated
    from pyyeti.era import ERA

    inputs, outputs = only_one(records, "pyYeti")
    pulses = pulse_responses(inputs, outputs, 1024 if setting == "defaults" else stated(setting))
    if setting == "defaults":
        fit = ERA(pulses[:, 1:201], 1 / dt, auto=True, verbose=False, show_plot=False)
    else:
        fit = ERA(
            pulses[:, 1 : 2 * BLOCKS + 1],
            1 / dt,
            svd_tol=order,
            auto=True,  # without it the method asks a person at a terminal
            all_lower_limits=0.0,
            alpha=BLOCKS,
            beta=BLOCKS - 1,
            verbose=False,
            show_plot=False,
        )
    A, B, C = (np.asarray(part) for part in (fit.A_modal, fit.B_modal, fit.C_modal))
    return {"A": A, "B": B, "C": C, "D": pulses[:, 0], "dt": dt}


def pulse_responses(inputs, outputs, window):
    """(n_outputs, n_lags, n_inputs) inverse FFT of H1 = S_yu S_uu^-1."""
    import numpy as np
    import scipy.signal

    def spectra(one, other):
        options = {"nperseg": window, "noverlap": window * 3 // 4, "detrend": "constant"}
        rows = [[scipy.signal.csd(b, a, **options)[1] for b in other.T] for a in one.T]
        return np.moveaxis(np.array(rows), 2, 0)

    into, across = spectra(inputs, inputs), spectra(outputs, inputs)
    response = np.linalg.solve(into.transpose(0, 2, 1), across.transpose(0, 2, 1)).transpose(0, 2, 1)
    return np.fft.irfft(response, window, axis=0).transpose(1, 0, 2)
