# SPDX-License-Identifier: Apache-2.0
"""Whether an effect is more than noise as slow as the log's makes by chance.

Fits weigh samples one by one. Slow noise drifts, and a constant, a spring or a slope then takes
away much of its square without being there.
"""

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.gap.case import Joint
from ros2_ident.identify.hidden import residual_of, rows_of, slopes_of
from ros2_ident.search.noise import fit_noise, Whitening

# Samples times parameters, at most.
_MOST = 4_000_000


def standing(before: Joint, after: Joint, first: Array, second: Array) -> float:
    """Return how many standard errors what an effect changes stands out of the log's noise.

    Generalised least squares along the change, the noise of the colour of what the effect leaves;
    all other parameters may follow.

    Args:
        before: Models without the effect.
        after: Models with it; its parameters are the last.
        first: (N,) fitted parameters of `before`.
        second: (N',) of `after`.

    Reference:
        Generalised least squares: Seber and Wild (2003), Nonlinear Regression, chapter 6.
    """
    rows = rows_of(after.models, _MOST // len(second))
    left, jacobian = slopes_of(after, second, rows)
    change = residual_of(before, first, rows) - left
    series: list[list[Array]] = [[] for _ in after.models[0].places]
    for run in rows.runs:
        series[run.place].append(left[run.start : run.stop])
    whiten = Whitening(rows.runs, [fit_noise(*s) for s in series])
    basis = np.linalg.qr(whiten(jacobian[:, : len(first)].T).T)[0]
    along, whole = whiten(change), whiten(change + left)
    along = along - basis @ (basis.T @ along)
    return float(along @ whole) / max(float(np.linalg.norm(along)), 1e-300)
