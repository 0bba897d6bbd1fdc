"""slycot, the other wrapper of SLICOT: asked whether it offers the subspace routines."""

REQUIREMENTS = ("slycot", "numpy")
SETTINGS = {"defaults": "IB01AD and IB01BD, if it has them"}


def identify(records, dt, *, setting, order):
    import slycot

    if not hasattr(slycot, "ib01ad"):
        raise NotImplementedError(
            f"slycot {slycot.__version__} wraps no subspace identification (IB01AD, IB01BD); see SLICOT by ctrlsys"
        )
    raise NotImplementedError("slycot has IB01AD now: write this contender")
