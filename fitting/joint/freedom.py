"""The precision of a fit's standard deviations, as degrees of freedom.

With few lights, the scale s of their errors is poorly known, and so are the intervals that depend
on it. If ln s has the standard error t, the variance s^2 has 1 / (2 t^2) degrees of freedom, and
its interval is Student's. If s contributes only the part

    a = d ln variance / d ln s^2

of a parameter's variance, Satterthwaite's rule gives 1 / (2 a^2 t^2). For several scales the
inverses add.

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
    """Return (P,) the difference of the log density from Laplace's Gaussian at two standard
    deviations.

    `gaussian_miss` evaluates the density along a line. The scale of a shared error has another
    density after marginalising over the other parameters, because their volume grows with it.
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
    """Information of some parameters at any point, with the others fixed."""
    there = minimise(cost, jnp.asarray(vector), fit.data, max_steps=1)
    return np.asarray(there.information, np.float64)[np.ix_(kept, kept)]


def _variances(fit: JointFit, scale: int, step: float, others: np.ndarray) -> np.ndarray:
    """Variances of the other parameters, with all scales fixed and one of them shifted."""
    vector = fit.vector.copy()
    vector[scale] += step
    return np.diagonal(np.linalg.inv(_information(fit, vector, others)))
