"""Vary the settings of a photon-transfer fit: the number of pixels, the likelihood, the tolerance,
and the sampling of the posterior. The quantities compared are those of the EMVA 1288 data sheet, in
units of their standard errors.
"""

from collections.abc import Mapping
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxvision.accuracy.records import Compute

from ..inference.newton import minimise
from ..inference.problem import log_density
from ..inference.search import negative_log_density
from ..noise.calibration import BY_NAME, LIKELIHOOD, NoiseCalibration, calibrate
from ..noise.emva1288 import evaluate, ranges
from ..noise.levels import PhotonTransfer, linear_levels
from ..noise.read import reduce_rig
from ..noise.statement import (
    base_space,
    fit_model,
    likelihood_sheet,
    make_problem,
    noise_data,
    posterior_problem,
    replace_parameters,
    start_vector,
)
from ..noise.usable import check
from ..noise.window import needed_window, offset_data, window_of
from ..observation import Load
from ..rig import Rig
from .chains import Density, Turn, chain_knobs

FEWEST = 16  # fewest pixels along a side of a part of an image


def noise_knobs(rig: Rig, load: Load) -> Mapping[str, Turn]:
    """Return, for each setting of a photon-transfer fit by name, a function that varies it."""
    measurement = reduce_rig(rig, load=load)
    check(Path(rig.folder), measurement)
    calibration = calibrate(measurement)
    units = {
        found.name: found.standard_error
        for found in calibration.sheet
        if found.method == LIKELIHOOD and found.standard_error and found.name in BY_NAME
    }
    names = [name for name in units if name in calibration.standard.values]
    errors = np.array([units[name] for name in names])

    def errors_of_sheet(sheet: Mapping[str, object]) -> np.ndarray:
        return np.array([float(np.asarray(sheet[name])) for name in names]) / errors

    def errors_of_linear(measured: PhotonTransfer, *, exact: bool | None = None) -> np.ndarray:
        """Fit a linear camera and return the values of its data sheet. `exact` chooses exact
        moments or approximate ones; None chooses those that the data require.
        """
        usable, within = linear_levels(measured), ranges(measured)
        window = None if exact is False else needed_window(measured, usable)[0]
        if exact and window is None:
            window = window_of(measured, usable)
        offsets = None if window is None else offset_data(measured, usable)
        inputs, rows = noise_data(measured, usable, window=window, offsets=offsets)
        standard = eqx.filter_jit(evaluate)(measured, within).values
        space = base_space(measured, within, offsets=offsets)
        fit = fit_model(make_problem(space, inputs, rows), standard)
        args = (space, inputs, jnp.zeros(len(rows), bool))
        vector = jnp.asarray(fit.optimum.vector)
        return errors_of_sheet(eqx.filter_jit(likelihood_sheet)(vector, within.saturation, args))

    def likelihood(setting: str) -> Compute:
        if setting == "moments":
            sheet = eqx.filter_jit(evaluate)
            return lambda seed: errors_of_sheet(sheet(measurement, ranges(measurement)).values)
        return lambda seed: errors_of_linear(measurement, exact=setting == "exact")

    def pixels(share: float) -> Compute:
        def compute(seed: int) -> np.ndarray:
            rng = np.random.default_rng(seed)
            places: dict[tuple[int, ...], tuple[slice, slice]] = {}

            def part(path: Path) -> np.ndarray:
                image = load(path)
                size = image.shape[:2]
                if size not in places:
                    places[size] = _window(size, share, rng)
                return image[places[size]]

            return errors_of_linear(reduce_rig(rig, load=part))

        return compute

    posterior, drawn = calibration.posterior, posterior_problem(calibration.chosen)
    mode = jnp.asarray(posterior.unconstrained_mode)
    return {
        "pixels": pixels,
        "likelihood": likelihood,
        "solver tolerance": _tolerance(calibration),
        **chain_knobs(Density(log_density, posterior.space, mode, posterior.covariance, drawn)),
    }


def _window(size: tuple[int, ...], share: float, rng: np.random.Generator) -> tuple[slice, slice]:
    """Draw a random window that keeps the image's aspect ratio. The window begins at even pixels,
    so that a mosaic keeps its pattern of colours.
    """
    found = []
    for length in size:
        wanted = max(round(length * np.sqrt(share) / 2) * 2, min(FEWEST, length))
        first = 2 * int(rng.integers((length - wanted) // 2 + 1))
        found.append(slice(first, first + wanted))
    return found[0], found[1]


def _tolerance(calibration: NoiseCalibration) -> Turn:
    """Vary the tolerance of the search for the chosen model's optimum. The search starts at the
    estimates of the EMVA standard.
    """
    fit = calibration.chosen
    problem = replace_parameters(fit.problem, fit.space)
    start = start_vector(problem, calibration.standard.values)
    errors = np.sqrt(np.diagonal(fit.covariance))

    def minimise_to(tolerance: float) -> Compute:
        def compute(seed: int) -> np.ndarray:
            found = minimise(negative_log_density, start, problem, tolerance=tolerance)
            return np.asarray(found.vector) / errors

        return compute

    return minimise_to
