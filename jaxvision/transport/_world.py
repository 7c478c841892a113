"""A scene sorted once, for every ray that is traced through it."""

import equinox as eqx

from ..rendering.band_count import band_count
from ..scene import Scene
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
    emissions = [surface.emission for surface in scene.surfaces if surface.emission is not None]
    materials = [surface.material for surface in scene.surfaces]
    return World(surfaces, emitters, band_count(materials, scene.lights, spectra=emissions))
