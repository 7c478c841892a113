"""Calls for histograms, equalisation and matching."""

import jax.numpy as jnp
import numpy as np

from jaxvision.histogram import exact_histogram, soft_histogram

RNG = np.random.default_rng(6)
X = jnp.asarray(RNG.uniform(0.05, 0.95, size=(6, 7, 2)))
Y = jnp.asarray(RNG.uniform(0.05, 0.95, size=(5, 8, 2)) ** 2)
FEW = {"bins": 12}
COUNTS = soft_histogram(X, **FEW)

EXAMPLES = {
    "histogram.counts.exact_histogram": ((X,), FEW),
    "histogram.counts.soft_histogram": ((X,), {"bins": 12, "kernel": "cubic"}),
    "histogram.counts.cumulative_distribution": ((COUNTS,), {}),
    "histogram.counts.quantile": ((COUNTS, jnp.asarray(0.3)), {}),
    "histogram.counts.otsu_threshold": ((exact_histogram(X, **FEW),), {}),
    "histogram.equalisation.equalise": ((X,), {**FEW, "amount": 0.7}),
    "histogram.local_equalisation.equalise_locally": ((X,), {**FEW, "tiles": (2, 2)}),
    "histogram.matching.match_histogram": ((X, Y), {}),
}
