"""How many bands spectra have together: asked of each kind of material and light, by the shapes of
what it computes. Nothing here has a unit."""

from collections.abc import Iterable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from . import brdf
from ._types import Colour, Scalar
from ._vector import Vec
from .lights import Quadrature, incident_samples
from .scene import Light, Material


def band_count(
    materials: Iterable[Material], lights: Iterable[Light], spectra: Iterable[jax.Array] = ()
) -> int:
    """The number of bands that all share; a neutral spectrum, of one band, goes with any.

    Raises:
        ValueError: if they differ.
    """
    reflected = [(type(own).__name__, _reflected(own)) for own in one_each(materials)]
    emitted = [_emitted(light) for light in one_each(lights)]
    emitted += [spectrum.shape[-1] for spectrum in spectra]
    counts = {*(bands for _, bands in reflected), *emitted}
    if len(counts - {1}) > 1:
        raise ValueError(
            "materials and lights must share one number of bands, got "
            f"{', '.join(f'{bands} from {name}' for name, bands in reflected)} and {emitted} from "
            "the lights."
        )
    return max(counts)


def one_each(records: Iterable[Any]) -> list[Any]:
    """One of the records of each kind and leaf shapes."""
    found: dict[Any, Any] = {}
    for record in records:
        leaves, structure = jax.tree.flatten(record)
        found.setdefault((structure, *(leaf.shape for leaf in leaves)), record)
    return list(found.values())


def _reflected(material: Material) -> int:
    number = jax.ShapeDtypeStruct((), jax.tree.leaves(material)[0].dtype)

    def shading(material: Material, x: Scalar) -> Colour:
        return brdf.shading(material, Vec(x, x, x), Vec(x, x, x))

    return jax.eval_shape(shading, material, number).shape[0]


def _emitted(light: Light) -> int:
    dtype = next(
        leaf.dtype for leaf in jax.tree.leaves(light) if jnp.issubdtype(leaf.dtype, jnp.floating)
    )
    point = jax.ShapeDtypeStruct((3,), np.dtype(dtype))
    samples = jax.eval_shape(lambda *of: incident_samples(*of, Quadrature(1)), light, point)
    return samples.irradiance.shape[-1]
