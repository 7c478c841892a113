"""Lights turned to where the images put them.

The error of a light's direction enters linearly, about where the light is thought to stand. A
highlight does not follow its light linearly: of lights off by a degree the mean over their errors
is wider and weaker than each highlight, in all images alike. So the fit is done again about the
turns that it finds (Gauss-Newton), until no light moves.
"""

import numpy as np
from jaxtyping import Float

from ..reflectance.from_images.read import Photographs
from ..reflectance.from_images.signal import Form
from ..reflectance.from_images.turns import turned
from .fit import JointFit, fit_channel, image_errors

MOST_TURNS = 8
SETTLED = 0.05  # standard deviations of a light's direction
IMPLAUSIBLE = 3.0  # times the stated size, from which it is the model that misses, not the lights

Turns = Float[np.ndarray, "2 images"]


def fit_turned(observation: Photographs, channel: int, form: Form) -> JointFit:
    """Fit one channel about the light directions that its images show, or about the rig's if these
    would be off by far more than stated."""
    sizes = observation.uncertain["direction_sd"][~observation.held_out]
    if not sizes.any():
        return fit_channel(observation, channel, form)
    turns = np.zeros((2, len(sizes)))
    nominal = fit = fit_channel(observation, channel, form, about=turns)
    for _ in range(MOST_TURNS):
        found = likeliest_turns(fit)
        if found is None or found[1].max() > IMPLAUSIBLE * sizes.max():
            return nominal
        if np.all(np.abs(found[0] - turns) <= SETTLED * found[1]):
            break
        turns = found[0]
        across = np.zeros((len(observation.held_out), 2))
        across[fit.grid.lights] = turns.T
        lights = turned(observation, across)
        fit = fit_channel(lights, channel, form, about=turns)
    return fit


def likeliest_turns(fit: JointFit) -> tuple[Turns, Float[np.ndarray, " images"]] | None:
    """Return (2, images) rad by which the images rotate the lights from the rig's directions, and
    the (images,) standard deviations that the rig states; None if directions are exact or the fit
    is no optimum."""
    if "direction_scatter" not in fit.data.relative or not fit.converged:
        return None
    found = image_errors(fit)
    assert found is not None
    first = 1 if "light_scatter" in fit.data.relative else 0
    size = np.asarray(fit.data.relative["direction_scatter"]) * float(
        fit.values["direction_scatter"]
    )
    return found[0][:, first : first + 2].T * size, size
