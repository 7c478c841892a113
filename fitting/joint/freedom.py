"""How well the widths of a fit are known, as degrees of freedom.

The errors of a few lights tell their own scale s only roughly, and with it the width of what they
blur. If ln s is known to t, a variance that is s^2 and nothing else has 1 / (2 t^2) degrees of
freedom, and its interval is Student's. Where only the part

    a = d ln variance / d ln s^2

of a parameter's variance comes from s, Satterthwaite's rule gives 1 / (2 a^2 t^2), and parts of
several scales add in the inverse.

Source:
    Satterthwaite, "An Approximate Distribution of Estimates of Variance Components", Biometrics
    Bulletin 2, 1946.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ..inference.importance import FAR, gaussian_miss
from ..inference.newton import minimise
from ..inference.parameters import names
from .fit import JointFit
from .model import SCATTERS, cost, log_posterior

STEP = 0.1  # of ln s, over which the variances' slopes are taken


def degrees_of_freedom(
    fit: JointFit, covariance: Float[np.ndarray, "parameters parameters"]
) -> Float[np.ndarray, " parameters"] | None:
    """Return (P,) degrees of freedom of the variances in a (P, P) unconstrained covariance,
    infinite for the scales themselves; None if no scale is fitted."""
    labels = names(fit.space)
    scales = [i for i, name in enumerate(labels) if name in SCATTERS]
    if not scales:
        return None
    others = np.array([i for i in range(len(labels)) if i not in scales])
    inverse = np.zeros(len(labels))
    for i in scales:
        ends = [_variances(fit, i, step, others) for step in (-STEP, STEP)]
        part = np.log(ends[1] / ends[0]) / (4 * STEP)
        inverse[others] += 2 * part**2 * covariance[i, i]
    return 1 / np.maximum(inverse, 1e-12)


def laplace_miss(
    fit: JointFit, covariance: Float[np.ndarray, "parameters parameters"]
) -> Float[np.ndarray, " parameters"]:
    """Return (P,) by how much the log density differs from Laplace's Gaussian at two standard
    deviations.

    `gaussian_miss` sees the density along a line. The scale of an error that images share has
    another density once the other parameters are marginalised, because their volume grows with it.
    """
    mode = jnp.asarray(fit.vector)
    missed = gaussian_miss(log_posterior, mode, covariance, fit.data)
    labels = names(fit.space)
    for i in (labels.index(name) for name in labels if name in SCATTERS):
        others = np.delete(np.arange(len(labels)), i)
        step = FAR * covariance[i] / np.sqrt(covariance[i, i])
        volumes = [
            np.linalg.slogdet(_information(fit, fit.vector + side * step, others))[1] / 2
            for side in (-1, 0, 1)
        ]
        missed[i] += np.max(np.abs(np.array(volumes) - volumes[1]))
    return missed


def _information(
    fit: JointFit, vector: Float[np.ndarray, " parameters"], kept: Int[np.ndarray, " kept"]
) -> Float[np.ndarray, "kept kept"]:
    """Information of some parameters, the others held, anywhere."""
    there = minimise(cost, jnp.asarray(vector), fit.data, max_steps=1)
    return np.asarray(there.information, np.float64)[np.ix_(kept, kept)]


def _variances(fit: JointFit, scale: int, step: float, others: np.ndarray) -> np.ndarray:
    """Of the other parameters, with all scales held and one of them moved."""
    vector = fit.vector.copy()
    vector[scale] += step
    return np.diagonal(np.linalg.inv(_information(fit, vector, others)))
