"""Find the number of bands of a scene, from the shapes that its types of material and light
return."""

from collections.abc import Iterable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from .. import brdf
from ..core._maps import mean_of, replace_maps
from ..core._types import common_dtype
from ..lights import Quadrature, incident_samples
from ..scene import Light, Material


def band_count(
    materials: Iterable[Material], lights: Iterable[Light], *, spectra: Iterable[jax.Array] = ()
) -> int:
    """Return the number of bands of the spectra of a scene. A neutral spectrum has one value, which
    applies to all bands. Raise `ValueError` if other spectra differ in their number of bands."""
    reflected = [
        (type(own).__name__, _trace_reflection(own)) for own in _distinct_structures(materials)
    ]
    emitted = [_trace_emission(light) for light in _distinct_structures(lights)]
    emitted += [spectrum.shape[-1] for spectrum in spectra]
    counts = {*(bands for _, bands in reflected), *emitted}
    if len(counts - {1}) > 1:
        raise ValueError(
            "materials and lights must share one number of bands, got "
            f"{', '.join(f'{bands} from {name}' for name, bands in reflected)} and "
            f"{emitted} from the lights."
        )
    return max(counts)


def _distinct_structures(records: Iterable[Any]) -> Iterable[Any]:
    """Return one record for each different structure (tree and shapes) among `records`."""
    return {str(jax.tree.map(jnp.shape, record)): record for record in records}.values()


def _trace_reflection(material: Material) -> int:
    up = jnp.zeros(3, common_dtype(material))
    return jax.eval_shape(lambda: brdf.shading(replace_maps(material, mean_of), up, up)).shape[0]


def _trace_emission(light: Light) -> int:
    samples = partial(incident_samples, rule=Quadrature(1))
    return jax.eval_shape(samples, light, jnp.zeros(3, common_dtype(light))).irradiance.shape[-1]
