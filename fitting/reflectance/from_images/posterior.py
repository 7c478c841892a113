"""The posterior of one channel's reflectance: Laplace, or draws from a calibrated likelihood.

Where residuals are shared by the pixels of an image, their product of densities is a composite
likelihood: its mode is right, its curvature is not. Its argument is therefore stretched about the
mode until its curvature is the inverse of the sandwich covariance (the curvature adjustment of
Ribatet, Cooley & Davison, Statistica Sinica 22, 2012; per direction what the magnitude adjustment
of Pauli, Racugno & Ventura, 2011, does on average). Priors are flat in the logarithms.

A step of the chain evaluates cells instead of pixels. At the mode both predict the same mean of
each cell, but not how it changes with the parameters: that differs inside a cell, and with it the
slope. The slope of the cells is therefore taken off, so that their density has its mode where that
of all pixels has.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...inference.clustering import curvature_stretch
from ...inference.emcee_run import Emcee, for_group
from ...inference.importance import laplace_where_it_holds
from ...inference.posterior import Posterior, sample
from .fit import ChannelFit
from .geometry_cells import Grouping, average, saturated_only
from .model import Samples, total_log_likelihood


class Composite(eqx.Module):
    """Data of `composite_log_density`.

    Attributes:
        cells: of the unsaturated samples.
        saturated: the others; None if there are none.
        mode: (P,) unconstrained.
        stretch: (P, P), the matrix C of mode + C (vector - mode).
        slope: (P,) of the cells and saturated samples at the mode, where that of all pixels is 0.
    """

    cells: Samples
    saturated: Samples | None
    mode: Float[Array, " parameters"]
    stretch: Float[Array, "parameters parameters"]
    slope: Float[Array, " parameters"]


def composite_log_density(vector: Float[Array, " parameters"], data: Composite) -> Array:
    """Log density of all pixels with its curvature adjusted, up to a constant.

    Source:
        Ribatet, Cooley & Davison, Statistica Sinica 22, 2012.
    """
    away = data.stretch @ (vector - data.mode)
    own = total_log_likelihood(data.mode + away, data.cells, data.saturated)
    return own - data.slope @ away


_slope = eqx.filter_jit(jax.grad(total_log_likelihood))


def composite(fit: ChannelFit, grouping: Grouping) -> Composite:
    """Return the adjusted likelihood of a fit whose covariance is known."""
    assert fit.robustness is not None
    mode = jnp.asarray(fit.vector, fit.samples.dn.dtype)
    cells = average(fit.samples, grouping, exact_at=mode)
    saturated = saturated_only(fit.samples)
    return Composite(
        cells=cells,
        saturated=saturated,
        mode=mode,
        slope=_slope(mode, cells, saturated),
        stretch=jnp.asarray(
            curvature_stretch(fit.information, fit.robustness.gaussian_covariance), mode.dtype
        ),
    )


def channel_posterior(
    fit: ChannelFit, grouping: Grouping, *, sampling: Emcee | None, seed: int
) -> Posterior:
    """Return the posterior of one channel by Laplace's approximation with the robust covariance and
    Student's t. If the likelihood is not Gaussian, return draws whose 95 % intervals are as wide as
    those of t."""
    assert fit.robustness is not None
    robust, data = fit.robustness, composite(fit, grouping)
    density, wider = composite_log_density, robust.gaussian_covariance
    if sampling is not None:
        own = for_group(sampling, fit.channel)
        return sample(density, fit.space, data.mode, wider, data, options=own, seed=seed)
    return laplace_where_it_holds(
        *(density, fit.space, data.mode, robust.covariance, data),
        seed=seed,
        freedom=robust.freedom,
        wider=wider,
    )
