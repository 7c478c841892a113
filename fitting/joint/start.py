"""The start of a joint fit."""

from dataclasses import replace

import numpy as np

from ..inference.parameters import names, natural_numbers
from ..reflectance.from_images.geometry_cells import average, group
from ..reflectance.from_images.model import parameter_space
from ..reflectance.from_images.optimum import project
from ..reflectance.from_images.read import Photographs
from ..reflectance.from_images.samples import Selection, make_samples, select
from ..reflectance.from_images.signal import Form, decoded
from .model import black_level, scatter_scales

MOST_AT_START = 100_000  # samples


def first_reflectance(
    observation: Photographs, channel: int, form: Form
) -> tuple[Form, dict[str, float]]:
    """Return the form that the images support (Lambert's without a highlight), and natural
    least-squares values of reflectance and gamma."""
    chosen = select(observation, held_out=False, form=form)
    every = -(-len(chosen.light) // MOST_AT_START)
    chosen = Selection(chosen.light[::every], chosen.pixel[::every])
    samples = make_samples(observation, channel, form, chosen)
    cells = group(
        chosen.light,
        observation.cosine[chosen.light, chosen.pixel],
        observation.mirror_angle[chosen.light, chosen.pixel],
    )
    found, vector = project(average(samples, cells))
    space = parameter_space(found.form)
    start = dict(zip(names(space), natural_numbers(space, vector).tolist(), strict=True))
    if not form.free_gamma and observation.gamma is not None:
        start["gamma"] = observation.gamma
    return replace(form, model=found.form.model), start


def first_noise(observation: Photographs, channel: int, gamma: float | None) -> dict[str, float]:
    """Return natural start values of gain, read noise, black level and error sizes, for an encoding
    exponent that is None for linear files."""
    camera = observation.camera
    found = {name: size for name, (size, _) in scatter_scales(observation).items()}
    found["black_level"] = black_level(observation, channel)[0]
    gain = camera.gain
    if gain is None:
        gain = _gain_of_neighbours(observation, channel, gamma)
    found["system_gain"] = gain
    typical = np.median(observation.dn[channel][observation.cosine > 0]) - observation.black
    typical = max(float(typical), 1.0)
    found["read_noise"] = camera.read_noise or float(np.sqrt(0.1 * typical / gain))
    return found


def _gain_of_neighbours(observation: Photographs, channel: int, gamma: float | None) -> float:
    """K from the differences of neighbours in a row, whose light is nearly equal."""
    dn = np.clip(observation.dn[channel], observation.black + 1, None)
    linear = decoded(dn, observation.black, observation.white, gamma)
    beside = (np.diff(observation.columns) == 1) & (np.diff(observation.rows) == 0)
    lit = (observation.cosine[:, 1:] > 0.2) & (dn[:, 1:] < observation.clip) & beside
    squares = np.diff(linear, axis=1)[lit] ** 2 / 2
    if not squares.size:
        return 1.0
    mean = (linear[:, 1:] + linear[:, :-1])[lit] / 2
    return max(float(np.median(squares / mean)) / 0.455, 1e-3)  # of chi-square, one degree
