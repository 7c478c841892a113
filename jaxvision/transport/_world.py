"""A scene sorted once, for every ray that is traced through it."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .. import brdf
from .._types import common_dtype
from .._vector import Vec
from ..lights import Quadrature, incident_samples
from ..scene import Light, Scene
from ._emitters import Emitters, emitters_of
from ._vertices import Surfaces, surfaces_of


class World(eqx.Module):
    """A scene sorted for tracing."""

    surfaces: Surfaces
    emitters: Emitters
    bands: int = eqx.field(static=True)


def world_of(scene: Scene) -> World:
    """The scene as tracing needs it; lengths in m."""
    surfaces, emitters = surfaces_of(scene), emitters_of(scene)
    return World(surfaces, emitters, bands_of(scene))


def bands_of(scene: Scene) -> int:
    """How many bands a picture of the scene has, no unit: those of its spectra, of which neutral
    ones have 1."""
    spectra = []
    for material in {type(s.material): s.material for s in scene.surfaces}.values():
        number = jax.ShapeDtypeStruct((), jax.tree.leaves(material)[0].dtype)
        up = jax.tree.map(lambda _, x=number: x, Vec(*jnp.zeros(3)))
        spectra.append(jax.eval_shape(brdf.shading, material, up, up).shape)
    for light in {type(light): light for light in scene.lights}.values():
        spectra.append(jax.eval_shape(_irradiance, light).shape[-1:])
    spectra += [s.emission.shape for s in scene.surfaces if s.emission is not None]
    return np.broadcast_shapes(*spectra)[0]


def _irradiance(light: Light) -> Array:
    """The irradiance, W m^-2, of a light anywhere."""
    return incident_samples(light, jnp.zeros(3, common_dtype(light)), Quadrature(1)).irradiance
