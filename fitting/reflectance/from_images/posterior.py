"""The posterior of a channel: Laplace's approximation, or draws from an adjusted likelihood.

Pixels of one image share errors, so the product of their densities is a composite likelihood. Its
mode is right, but its curvature is not. Its argument is therefore stretched about the mode until
its curvature is the inverse of the covariance over images (Ribatet, Cooley & Davison, "Bayesian
Inference from Composite Likelihoods", Statistica Sinica 22, 2012). Priors of a surface are flat in
the logarithms.

A step of the chain evaluates cells instead of pixels. At the mode both predict the same mean of
each cell, but derivatives vary inside a cell, so the gradients differ. The gradient of the cells at
the mode is therefore subtracted, so that their density has the mode of all pixels.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from ...inference.clustering import Robustness, curvature_stretch
from ...inference.emcee_run import Emcee, for_group
from ...inference.importance import laplace_where_it_holds
from ...inference.parameters import ParameterSpace
from ...inference.posterior import Posterior, sample
from .derivatives import cost_and_information, predict
from .fit import ChannelFit
from .geometry_cells import Grouping, average, saturated_only
from .model import total_log_likelihood


class Adjusted(eqx.Module):
    """A log density with another curvature at its mode."""

    density: Callable[[Array, Any], Array] = eqx.field(static=True)  # function of (vector, data)
    data: Any  # of the density
    mode: Float[Any, " parameters"]  # unconstrained
    stretch: Float[Any, "parameters parameters"]  # the matrix C of mode + C (vector - mode)
    # of the density at the mode, to be subtracted; None for 0
    slope: Float[Any, " parameters"] | None = None


def adjusted_log_density(vector: Float[Array, " parameters"], data: Adjusted) -> Array:
    """Log density with its argument stretched about the mode, up to a constant."""
    away = data.stretch @ (vector - data.mode)
    own = data.density(data.mode + away, data.data)
    return own if data.slope is None else own - data.slope @ away


def composite(fit: ChannelFit, grouping: Grouping) -> Adjusted:
    """Return the adjusted likelihood of cells and saturated samples, where the covariance of a fit
    is known."""
    assert fit.robustness is not None
    cells = average(fit.samples, grouping, exact_at=predict(fit.vector, fit.samples))
    data = cells, saturated_only(fit.samples)
    stretch = curvature_stretch(fit.information, fit.robustness.gaussian_covariance)
    slope = np.zeros(len(fit.vector))
    for own in data:
        if own is not None:
            slope -= cost_and_information(predict(fit.vector, own), own)[1]
    return Adjusted(total_log_likelihood, data, fit.vector, stretch, slope)


def channel_posterior(
    fit: ChannelFit, grouping: Grouping, *, sampling: Emcee | None, seed: int
) -> Posterior:
    """Return the posterior of one channel whose covariance is known."""
    assert fit.robustness is not None
    data, options = composite(fit, grouping), {"sampling": sampling, "seed": seed}
    return adjusted_posterior(data, fit.space, fit.channel, **robust(fit.robustness), **options)


def robust(covariance: Robustness) -> dict[str, Any]:
    """The input of `adjusted_posterior` from a covariance over images. An interval of Student's t
    is wider than its standard deviation, and a non-Gaussian density is stretched to it."""
    return {
        "covariance": covariance.covariance,
        "wider": covariance.gaussian_covariance,
        "freedom": covariance.freedom,
    }


def adjusted_posterior(
    data: Adjusted,
    space: ParameterSpace,
    channel: str,
    *,
    covariance: Float[np.ndarray, "parameters parameters"],
    wider: Float[np.ndarray, "parameters parameters"] | None = None,
    sampling: Emcee | None,
    seed: int,
    **judged: Any,
) -> Posterior:
    """Return draws by emcee if `sampling` is given, else Laplace's approximation, where it is
    accurate."""
    if sampling is None:
        of = adjusted_log_density, space, data.mode, covariance, data
        return laplace_where_it_holds(*of, seed=seed, wider=wider, **judged)
    of = adjusted_log_density, space, data.mode, covariance if wider is None else wider, data
    return sample(*of, options=for_group(sampling, channel), seed=seed)
