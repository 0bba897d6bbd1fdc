"""SLICOT's MOESP refined by output error: what a careful user of ctrlsys and `scipy.optimize.least_squares` writes.

Parameters: poles (decay and angle, so that every step is stable), input and output participations of each, the states
at the start, D. The residuals of each output are weighted by what the start leaves of it, the Jacobian is exact.
"""

REQUIREMENTS = ("ctrlsys", "numpy", "scipy")
SETTINGS = {
    "60 block rows": "MOESP as slicot's, order told, block rows swept; then least_squares (trf) until it stands still"
}
SWEEP = {"{} block rows": (40, 60, 100)}
LARGEST_RADIUS = 0.9999
"""Of a starting pole: one on or outside the unit circle is drawn in to here."""


def identify(records, dt, *, setting, order):
    import scipy.optimize
    import slicot_subspace
    from block_rows import only_one

    start = slicot_subspace.identify(records, dt, setting=setting, order=order)
    inputs, outputs = only_one(records, "this refinement")
    free_run = FreeRun(start, inputs, outputs)
    weights = 1 / free_run.errors(free_run.start).std(axis=0)
    found = scipy.optimize.least_squares(
        lambda values: (free_run.errors(values) * weights).ravel(),
        free_run.start,
        jac=lambda values: (free_run.changes(values) * weights[:, None]).reshape(-1, len(free_run.start)),
        method="trf",
        x_scale="jac",
        ftol=1e-8,
        max_nfev=50,
    )
    A, B, C, D = free_run.matrices(found.x)
    return {"A": A, "B": B, "C": C, "D": D, "dt": dt}


class FreeRun:
    """Outputs of a sum of first-order filters, one a pole of the upper half plane, and their derivatives."""

    def __init__(self, model, inputs, outputs):
        import numpy as np

        A, B, C, D = (model[name] for name in "ABCD")
        self.inputs, self.outputs = inputs, outputs
        poles, vectors = np.linalg.eig(A)
        kept = poles.imag >= 0
        radius = np.abs(poles)
        poles = np.where(radius >= LARGEST_RADIUS, poles * LARGEST_RADIUS / radius, poles)
        self.real = (poles.imag == 0)[kept]
        self.factor = np.where(self.real, 1.0, 2.0)  # a pair gives twice the real part of one
        b, c = np.linalg.solve(vectors, B.astype(complex))[kept], (C @ vectors)[:, kept]
        shares = np.abs(c).max(axis=0)
        shares[shares == 0] = 1.0
        self.shapes = [(len(b),), b.shape, c.T.shape, (len(b),), D.shape]
        self.signs = np.where(self.real & (poles[kept].real < 0), -1.0, 1.0)
        exponents = np.log(np.abs(poles[kept]).clip(1e-6)) + 1j * np.where(self.real, 0.0, np.angle(poles[kept]))
        decay = np.log(-exponents.real) + 1j * exponents.imag
        states = np.zeros(len(b), dtype=complex)
        self.start = self._packed(decay, b * shares[:, None], c.T / shares[:, None], states, D)
        self.start = self._with_states(self.start)

    def _packed(self, decay, b, c, states, D):
        import numpy as np

        # the imaginary parts of a real pole's numbers stay zero: their columns of the Jacobian are zero
        return np.concatenate([part.ravel().view(float) for part in (decay, b, c, states)] + [D.ravel()])

    def _parts(self, values):
        import numpy as np

        parts, at = [], 0
        for shape in self.shapes[:4]:
            size = 2 * int(np.prod(shape))
            parts.append(values[at : at + size].view(complex).reshape(shape))
            at += size
        return (*parts, values[at:].reshape(self.shapes[4]))

    def _with_states(self, values):
        """Initial states by least squares, all else as it is."""
        import numpy as np

        jacobian, errors = self.changes(values), self.errors(values)
        at = sum(2 * int(np.prod(shape)) for shape in self.shapes[:3])
        columns = slice(at, at + 2 * self.shapes[3][0])
        values = values.copy()
        J = jacobian[..., columns].reshape(errors.size, -1)
        values[columns] -= np.linalg.lstsq(J, errors.ravel(), rcond=1e-8)[0]
        return values

    def _poles(self, decay):
        import numpy as np

        return self.signs * np.exp(-np.exp(decay.real) + 1j * np.where(self.real, 0.0, decay.imag))

    def _filtered(self, values):
        """(n_poles, n_samples, n_inputs) answers to each input, (n_poles, n_samples) free decays; poles, and parts."""
        import numpy as np
        from scipy.signal import lfilter

        decay, b, c, states, D = self._parts(values)
        poles = self._poles(decay)
        forced = np.array([lfilter([0, 1.0], [1.0, -p], self.inputs, axis=0) for p in poles])
        free = poles[:, None] ** np.arange(len(self.inputs))
        return forced, free, poles, (b, c, states, D)

    def errors(self, values):
        forced, free, _, (b, c, states, D) = self._filtered(values)
        motion = (forced * b[:, None]).sum(axis=2) + states[:, None] * free
        return (self.factor * (motion.T)).dot(c).real + self.inputs @ D.T - self.outputs

    def changes(self, values):
        """(n_samples, n_outputs, n_values) derivatives of the errors."""
        import numpy as np
        from scipy.signal import lfilter

        forced, free, poles, (b, c, states, _) = self._filtered(values)
        n_samples, n_outputs = self.outputs.shape
        n_poles, n_inputs = b.shape
        samples = np.arange(n_samples)
        motion = (forced * b[:, None]).sum(axis=2) + states[:, None] * free
        by_pole = np.array(
            [
                lfilter([0, 1.0], [1.0, -p], forced[i] @ b[i]) + states[i] * samples * p ** np.maximum(samples - 1, 0)
                for i, p in enumerate(poles)
            ]
        )
        log_decay = np.log(np.abs(poles))  # = -exp(decay.real)
        scaled_c = self.factor[:, None] * c

        def real(columns, *, imaginary=True):
            """Of a complex parameter: by its real and by its imaginary part."""
            both = np.stack([columns.real, -columns.imag], axis=-1)
            if not imaginary:
                both[..., 1] = 0.0
            return both

        J = np.zeros((n_samples, n_outputs, len(values)))
        at = 0
        for i in range(n_poles):
            move = np.outer(by_pole[i] * poles[i], scaled_c[i])
            J[..., at + 2 * i] = (move * log_decay[i]).real
            J[..., at + 2 * i + 1] = 0.0 if self.real[i] else (1j * move).real
        at += 2 * n_poles
        for i in range(n_poles):
            for k in range(n_inputs):
                pair = real(np.outer(forced[i, :, k], scaled_c[i]), imaginary=not self.real[i])
                J[..., at : at + 2] = pair
                at += 2
        for i in range(n_poles):
            for j in range(n_outputs):
                pair = real(self.factor[i] * motion[i], imaginary=not self.real[i])
                J[:, j, at : at + 2] = pair
                at += 2
        for i in range(n_poles):
            J[..., at : at + 2] = real(np.outer(free[i], scaled_c[i]), imaginary=not self.real[i])
            at += 2
        for j in range(n_outputs):
            J[:, j, at : at + n_inputs] = self.inputs
            at += n_inputs
        return J

    def matrices(self, values):
        """A, B, C, D in real form: a block of two a pair, of one a real pole."""
        import numpy as np

        decay, b, c, _, D = self._parts(values)
        blocks, rows, columns = [], [], []
        for pole, into, out, real in zip(self._poles(decay), b, c, self.real, strict=True):
            if real:
                blocks.append(np.array([[pole.real]]))
                rows.append(into.real[None])
                columns.append(out.real[:, None])
            else:
                blocks.append(np.array([[pole.real, -pole.imag], [pole.imag, pole.real]]))
                rows.append(np.array([into.real, into.imag]))
                columns.append(2 * np.array([out.real, -out.imag]).T)
        n_states = sum(len(block) for block in blocks)
        A, at = np.zeros((n_states, n_states)), 0
        for block in blocks:
            A[at : at + len(block), at : at + len(block)] = block
            at += len(block)
        return A, np.vstack(rows), np.hstack(columns), D
