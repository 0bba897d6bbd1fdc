"""This repository: `modal.identify`, nothing told, through its public names alone."""

REQUIREMENTS = ()
SETTINGS = {"defaults": "modal.identify(record), no option: order, band and everything else chosen by itself"}


def identify(records, dt, *, setting, order):
    import modal
    import okid

    made = [okid.Record(inputs, outputs, dt) for inputs, outputs in records]
    found = modal.identify(made)
    model = found.realisation
    return {
        "A": model.A,
        "B": model.B,
        "C": model.C,
        "D": model.D,
        "dt": model.dt,
        "warnings": list(found.warnings),
        "own_fit": found.fit.mean,
        "modes": [
            {
                "pole": [mode.pole.real, mode.pole.imag],
                "kind": mode.kind,
                "frequency": mode.frequency,
                "damping_ratio": mode.damping_ratio,
                "frequency_std": mode.frequency_std,
                "damping_ratio_std": mode.damping_ratio_std,
                "verdict": mode.verdict,
                "probability": mode.probability,
                "damping_resolved": bool(mode.damping_resolved),
                "reason": mode.reason,
            }
            for mode in found.modes
        ],
    }
