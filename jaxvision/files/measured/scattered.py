"""Interpolate a BRDF table for rendering from samples at scattered pairs of directions."""

import jax
import jax.numpy as jnp
import numpy as np

from ...brdf.half_difference import HalfDifferenceTable, bin_angles, half_difference
from ...brdf.measured import BRDFSamples, sample_directions


def table_of_samples(
    samples: BRDFSamples, *, shape: tuple[int, int, int] = (45, 30, 24), floor: float = 1e-3
) -> HalfDifferenceTable:
    """Fit a continuous, reciprocal and mirror-symmetric BRDF to scattered isotropic samples, and
    tabulate it in bins.

    log(f_r + floor) is interpolated by radial basis functions with the kernel r. The variables of
    the interpolation are half and difference angles, in which the position of a narrow lobe does
    not depend on `wi`. In a test, one of the eight incidence angles of the Cornell paints was
    omitted. At this angle, the error was 1.5 to 10 times smaller than the error of linear
    interpolation over the angles of both directions.

    Args:
        samples: samples of f_r in sr^-1.
        shape: numbers of bins (n_h, n_d, n_p).
        floor: sr^-1, added before the logarithm.

    Returns:
        The table of f_r in sr^-1.
    """
    from scipy.interpolate import RBFInterpolator

    def features(theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray) -> np.ndarray:
        # Linear near the normal, which avoids a spike there, and logarithmic beyond a narrow lobe.
        # cos(2 phi_d) is equal for a pair of directions, the exchanged pair and both mirror images;
        # its influence falls to 0 as h approaches the normal.
        x = 0.5 * np.arcsinh(theta_h / 0.1)
        return np.stack([x, theta_d, 0.25 * x * np.cos(2 * phi_d)], axis=-1)

    angles = jax.vmap(half_difference)(*sample_directions(samples))
    known = features(*(np.asarray(a) for a in (angles.theta_h, angles.theta_d, angles.phi_d)))
    values = np.log(np.maximum(np.asarray(samples.values, np.float64), 0) + floor)
    empty = HalfDifferenceTable(jnp.zeros((*shape, 1), samples.values.dtype))
    nodes = np.meshgrid(*map(np.asarray, bin_angles(empty)), indexing="ij")
    wanted = features(*nodes).reshape(-1, 3)
    interpolant = RBFInterpolator(known, values, kernel="linear", smoothing=1e-4)
    found = np.maximum(np.exp(interpolant(wanted)) - floor, 0).reshape(*shape, -1)
    return HalfDifferenceTable(
        jnp.asarray(found, samples.values.dtype), wavelengths=samples.wavelengths
    )
