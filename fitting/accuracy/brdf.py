"""Vary the settings of a reflectance fit to images: the number of pixels, cells in place of pixels,
the tolerance, and the sampling of the posterior. The quantities compared are parameters in units of
their standard errors, for the first channel in which all parameters of Phong's model are
identifiable.
"""

from collections.abc import Mapping
from dataclasses import replace

import jax
import numpy as np
from jaxtyping import Array

from jaxvision.accuracy.records import Compute
from jaxvision.errors import InputError

from ..observation import Load
from ..reflectance.from_images.fit import adjusted_log_density, composite, fit_channel
from ..reflectance.from_images.optimum import TOLERANCE, minimise_samples
from ..reflectance.from_images.read import read_reflectance_observation
from ..reflectance.from_images.samples import (
    Samples,
    View,
    average,
    cells_of,
    predict,
    saturated_only,
    select,
)
from ..reflectance.from_images.signal import Form
from ..rig import Rig
from .chains import Density, Turn, chain_knobs

AWAY = 0.3  # distance from the mode at which a search begins, in logarithms


def brdf_knobs(rig: Rig, load: Load) -> Mapping[str, Turn]:
    """Return, for each setting of a reflectance fit by name, a function that varies it."""
    colour = "green" if rig.camera.pattern else ""
    observation = read_reflectance_observation(rig, load=load, channel=colour)
    form = Form("phong")
    chosen = select(observation, held_out=False, form=form, minimum_cosine=0.0)
    usual = cells_of(observation, chosen)
    every = (View(observation, channel, chosen) for channel in range(len(observation.channels)))
    fits = (fit_channel(view, form, usual) for view in every)
    fit = next((one for one in fits if one.robustness is not None), None)
    if fit is None or fit.robustness is None:
        raise InputError(
            f"{rig.folder}: the images do not determine all parameters in any channel; see the "
            "findings of jaxvision-fit brdf."
        )
    errors = np.sqrt(np.diagonal(fit.robustness.covariance))
    start = fit.vector - AWAY

    def search(samples: Samples, tolerance: float = TOLERANCE) -> np.ndarray:
        return minimise_samples(start, [samples], tolerance=tolerance).vector / errors

    def pixels(share: float) -> Compute:
        count = fit.samples.dn.size
        wanted = max(int(share * count), 1)

        def compute(seed: int) -> np.ndarray:
            rng = np.random.default_rng(seed)
            return search(_part(fit.samples, rng.permutation(count)[:wanted]))

        return compute

    def cells(width: float | str) -> Compute:
        if isinstance(width, str):
            return lambda seed: search(fit.samples)
        grouping = cells_of(observation, chosen, width=width)
        saturated = saturated_only(fit.samples)
        apart = [] if saturated is None else [saturated]

        def compute(seed: int) -> np.ndarray:
            near = minimise_samples(start, [average(fit.samples, grouping), *apart]).vector
            there = predict(near, fit.samples)
            exact = average(fit.samples, grouping, exact_at=there)
            return minimise_samples(near, [exact, *apart]).vector / errors

        return compute

    turns = {
        "pixels": pixels,
        "cells": cells,
        "solver tolerance": lambda tolerance: lambda seed: search(fit.samples, tolerance),
    }
    data, covariance = composite(fit, usual), fit.robustness.gaussian_covariance
    density = Density(adjusted_log_density, fit.space, data.mode, covariance, data)
    return {**turns, **chain_knobs(density)}


def _part(samples: Samples, chosen: np.ndarray) -> Samples:
    size = samples.dn.size

    def select(leaf: Array) -> Array:
        return leaf[chosen] if leaf.shape[:1] == (size,) else leaf

    return replace(
        samples,
        **{
            name: jax.tree.map(select, getattr(samples, name))
            for name in ("geometry", "dn", "deviation", "saturated")
        },
        offset=None if samples.offset is None else samples.offset[:, chosen],
    )
