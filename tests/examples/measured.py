"""Calls for measured BRDFs."""

import jax.numpy as jnp
import numpy as np
from oracles.measured import rgl_fields

from jaxvision import Vec
from jaxvision.brdf.half_difference import HalfDifference, HalfDifferenceTable
from jaxvision.brdf.measured import AnisotropicTable, BRDFSamples, IsotropicTable
from jaxvision.brdf.rgl import rgl_material

RNG = np.random.default_rng(12)
WI, WO = Vec(*jnp.asarray([0.36, 0.48, 0.8])), Vec(*jnp.asarray([-0.48, 0.6, 0.64]))
U = jnp.asarray([0.31, 0.72, 0.55])


def table(*shape):
    return jnp.asarray(RNG.uniform(0.2, 0.9, shape))


THETA, PHI = jnp.asarray([0.1, 0.7, 1.3]), jnp.asarray([-2.0, 0.3])
ANGLES = HalfDifference(*jnp.asarray([0.4, 0.5, 0.6, 0.7]))
BINS = HalfDifferenceTable(table(4, 3, 2, 2))
ISOTROPIC = IsotropicTable(THETA, THETA, jnp.asarray([0.2, 3.0]), table(3, 3, 2, 2))
ANISOTROPIC = AnisotropicTable(THETA, PHI, THETA, PHI, table(3, 2, 3, 2, 2), reciprocal=True)
SAMPLES = BRDFSamples(*table(4, 5), table(5, 2))

_fields = {name: jnp.asarray(x, float) for name, x in rgl_fields(RNG, thetas=2, fine=5).items()}
RGL_TABLES = (
    _fields["theta_i"],
    _fields["phi_i"],
    jnp.moveaxis(_fields["rgb"], 2, -1),
    _fields["ndf"],
    _fields["sigma"],
    _fields["vndf"],
    _fields["luminance"],
)
RGL = rgl_material(*RGL_TABLES)

EXAMPLES = {
    "brdf.half_difference.half_difference": ((WI, WO), {}),
    "brdf.half_difference.from_half_difference": ((ANGLES,), {}),
    "brdf.half_difference.bin_angles": ((BINS,), {}),
    "brdf.half_difference.evaluate": ((BINS, WI, WO), {}),
    "brdf.measured.evaluate": ((ANISOTROPIC, WI, WO), {}),
    "brdf.measured.tabulate_sampler": ((ISOTROPIC,), {"thetas": 2, "rows": 4, "columns": 4}),
    "brdf.measured.sample_directions": ((SAMPLES,), {}),
    "brdf.measured.samples_of": ((ISOTROPIC, THETA, THETA, PHI), {}),
    "brdf.rgl.rgl_material": (RGL_TABLES, {}),
    "brdf.rgl.shading": ((RGL, WI, WO), {}),
    "brdf.rgl.evaluate": ((RGL, WI, WO), {}),
    "brdf.rgl.sample": ((RGL, WO, U), {}),
    "brdf.rgl.pdf": ((RGL, WI, WO), {}),
    "brdf.rgl.albedo": ((RGL, WO), {"order": 4}),
}
