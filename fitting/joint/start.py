"""What a joint fit has to find: its parameters with their priors, and where they begin.

What the rig knows exactly is a number, what it knows with an `_sd` has a prior, and what it does
not name is free. The stated size of an error of lights or pixels is itself trusted to a factor of
about `TRUST`.
"""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ..inference.parameters import Parameter, ParameterSpace, names, to_natural
from ..inference.priors import LogNormal, Normal
from ..reflectance.from_images.geometry_cells import average, group
from ..reflectance.from_images.model import parameter_space
from ..reflectance.from_images.optimum import project
from ..reflectance.from_images.read import Photographs
from ..reflectance.from_images.samples import Selection, make_samples, select
from ..reflectance.from_images.signal import GAMMA, Form, decoded, surface_parameters

TRUST = 1.6  # factor, one standard deviation, by which a stated error may be off
MOST_AT_START = 100_000  # samples

GAIN = Parameter("system_gain", symbol="K", unit="DN/e-", transform="log")
READ_NOISE = Parameter("read_noise", symbol="σ", unit="e-", lower=0.0)
BLACK = Parameter("black_level", symbol="b", unit="DN")
SCATTERS = {
    "light_scatter": Parameter("light_scatter", symbol="s_l", unit="1", transform="log"),
    "direction_scatter": Parameter("direction_scatter", symbol="s_d", unit="rad", transform="log"),
    "stray_scatter": Parameter("stray_scatter", symbol="s_s", unit="1", transform="log"),
    "prnu": Parameter("prnu", symbol="s_p", unit="1", transform="log"),
}


def of_surface(space: ParameterSpace) -> Bool[np.ndarray, " parameters"]:
    """Which parameters describe surface and encoding. Only these enter the comparison of images,
    since gain and read noise follow from the scatter of pixels within cells."""
    others = {GAIN.name, READ_NOISE.name, BLACK.name, *SCATTERS, "misfit"}
    return np.array([p.name not in others for p in space])


def scatter_scales(
    observation: Photographs,
) -> dict[str, tuple[float, Float[np.ndarray, " lights"]]]:
    """Return, by name, the typical size of each error that the rig states and each light's size
    relative to it. Strength of a light and exposure of its image have the same effect, so they
    count as one."""
    known = observation.uncertain
    stated = {
        "light_scatter": np.hypot(known["intensity_sd"], known["exposure_sd"]),
        "direction_scatter": known["direction_sd"],
        "stray_scatter": known["stray_sd"],
    }
    found = {}
    for name, sizes in stated.items():
        if sizes.any():
            typical = float(np.sqrt(np.mean(sizes[sizes > 0] ** 2)))
            found[name] = (typical, sizes / typical)
    if observation.camera.prnu_sd:
        found["prnu"] = (observation.camera.prnu_sd, np.ones(0))
    return found


def parameters(
    observation: Photographs,
    channel: int,
    form: Form,
    start: dict[str, float],
) -> tuple[ParameterSpace, dict[str, float]]:
    """Return the parameters with their priors, and by name the numbers that the rig knows exactly.
    `start` holds the values from which the search begins; it has no gamma for linear files."""
    camera, known = observation.camera, {}
    space = [*surface_parameters(form)]

    def add(parameter: Parameter, value: float | None, sd: float | None) -> None:
        if value is None:
            space.append(parameter)
        elif sd is None:
            known[parameter.name] = value
        else:
            space.append(replace(parameter, prior=Normal(value, sd)))

    if "gamma" in start:
        add(GAMMA, None if form.free_gamma else camera.gamma, camera.gamma_sd)
    add(GAIN, camera.gain, camera.gain_sd)
    add(READ_NOISE, camera.read_noise, camera.read_noise_sd)
    add(BLACK, *_black(observation, channel))
    for name, (size, _) in scatter_scales(observation).items():
        space.append(replace(SCATTERS[name], prior=LogNormal(size, float(np.log(TRUST)))))
    return tuple(space), known


def _black(observation: Photographs, channel: int) -> tuple[float, float | None]:
    """The black level and its standard deviation: the rig's, or the darks', or of both the mean
    weighted by their precisions."""
    black, sd = observation.black, observation.camera.black_sd
    stated = observation.camera.black_level is not None
    levels = None if observation.levels is None else observation.levels[channel]
    if levels is None or not levels.dark.any() or (stated and sd is None):
        return black, sd
    means, errors = [levels.mean[levels.dark]], [levels.mean_error[levels.dark]]
    if stated and sd is not None:
        means, errors = [*means, [black]], [*errors, [sd]]
    weight = np.concatenate(errors) ** -2.0
    mean = float(weight @ np.concatenate(means) / weight.sum())
    return mean, float(weight.sum() ** -0.5)


def first_reflectance(
    observation: Photographs, channel: int, form: Form
) -> tuple[Form, dict[str, float]]:
    """Return the form that the images show (Lambert's without a highlight), and natural
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
    natural = np.asarray(to_natural(space, vector), np.float64)
    start = dict(zip(names(space), natural.tolist(), strict=True))
    if not form.free_gamma and observation.gamma is not None:
        start["gamma"] = observation.gamma
    return replace(form, model=found.form.model), start


def first_noise(observation: Photographs, channel: int, gamma: float | None) -> dict[str, float]:
    """Return natural start values of gain, read noise, black level and error sizes, for an encoding
    exponent that is None for linear files."""
    camera = observation.camera
    found = {name: size for name, (size, _) in scatter_scales(observation).items()}
    found["black_level"] = _black(observation, channel)[0]
    gain = camera.gain
    if gain is None:
        gain = _gain_of_neighbours(observation, channel, gamma)
    found["system_gain"] = gain
    typical = np.median(observation.dn[channel][observation.cosine > 0]) - observation.black
    typical = max(float(typical), 1.0)
    found["read_noise"] = camera.read_noise or float(np.sqrt(0.1 * typical / gain))
    return found


def _gain_of_neighbours(observation: Photographs, channel: int, gamma: float | None) -> float:
    """K from the differences of neighbours in a row: their light is nearly the same."""
    dn = np.clip(observation.dn[channel], observation.black + 1, None)
    linear = np.asarray(
        decoded(
            jnp.asarray(dn),
            jnp.asarray(observation.black),
            jnp.asarray(observation.white),
            None if gamma is None else jnp.asarray(gamma),
        )
    )
    beside = (np.diff(observation.columns) == 1) & (np.diff(observation.rows) == 0)
    lit = (observation.cosine[:, 1:] > 0.2) & (dn[:, 1:] < observation.clip) & beside
    squares = np.diff(linear, axis=1)[lit] ** 2 / 2
    if not squares.size:
        return 1.0
    mean = (linear[:, 1:] + linear[:, :-1])[lit] / 2
    return max(float(np.median(squares / mean)) / 0.455, 1e-3)  # of chi-square, one degree
