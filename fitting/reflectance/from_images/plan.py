"""Choice of the next light to photograph, so that the error of a reflectance parameter decreases
most.

Candidates are the rig's own lights, including those held out, and distant lights of the same
strength over the hemisphere in front of the object. Each candidate adds the Fisher information of
its pixels, divided by the design effect if residuals are correlated within lights or pixels.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from jaxvision.errors import InputError, nearest

from ...inference.design import Plan, rank
from ...inference.formatting import format_with_error
from ...inference.parameters import names
from ...report.section import Section, Table
from ..models import LABELS
from .calibration import ReflectanceCalibration
from .fit import ChannelFit
from .optimum import weighted
from .read import Photographs, angles
from .samples import image_view, predict, scores_and_slopes
from .signal import Form, parameter_space

FROM_VIEW = (0, 20, 40, 60, 80)  # degrees
AROUND = (0, 45, 90, 135, 180, 225, 270, 315)  # degrees, from the right counter-clockwise
SHOWN = 12  # candidates in the table


def plan(calibration: ReflectanceCalibration, target: str) -> dict[str, Plan]:
    """Rank lights by the reduction of the error of a parameter of the reported model, in each
    channel whose parameters are all determined. Raises `InputError` if the model has no such
    parameter, and if no channel has all its parameters determined."""
    check_target(target, calibration.chosen_fits[0].requested)
    rigs = calibration.observation
    new, described = _candidate_lights(rigs)
    lights = [(f"{file} again", rigs, i) for i, file in enumerate(rigs.files)]
    lights += [(name, new, i) for i, name in enumerate(described)]
    plans = {}
    for fit in calibration.chosen_fits:
        known = names(fit.space)
        if fit.channel not in calibration.posteriors or fit.robustness is None:
            continue
        covariance = fit.robustness.gaussian_covariance
        place = known.index(target)
        value = float(fit.natural[place])
        slope = np.zeros(len(known))
        slope[place] = value  # all parameters are logarithms
        added = {
            name: added_information(observation, fit, light) / fit.design_effect
            for name, observation, light in lights
        }
        plans[fit.channel] = rank(target, value, slope, covariance, added)
    if not plans:
        raise InputError("The images do not determine the model: see the findings of `brdf`.")
    return plans


def check_target(target: str, form: Form) -> None:
    """Raise `InputError` if the model has no parameter of this name."""
    known = names(parameter_space(form))
    if target not in known:
        raise InputError(f"target = {target!r} is no parameter; {nearest(target, known)}.")


def added_information(
    observation: Photographs, fit: ChannelFit, light: int
) -> Float[np.ndarray, "parameters parameters"]:
    """Return the information (P, P) that one more image of independent pixels adds."""
    lit = observation.cosine[light] > 0
    samples = image_view(observation, fit.view.channel, light).samples(fit.form)
    prediction = predict(fit.vector, samples)
    samples = replace(
        weighted(prediction, samples, fit.spread),
        dn=prediction.dn,
        saturated=prediction.dn >= samples.clip,
    )
    slopes = scores_and_slopes(prediction, samples)[1][:, lit]
    return slopes @ slopes.T


def _candidate_lights(rigs: Photographs) -> tuple[Photographs, list[str]]:
    """Return the object under distant lights of a hemisphere, and these in words."""
    described, directions = [], []
    for tilt in FROM_VIEW:
        for turn in AROUND if tilt else (0,):
            there = f"light {tilt}° from the view" + (f", turned by {turn}°" if tilt else "")
            described.append(there)
            away = np.sin(np.radians(tilt))
            across = np.cos(np.radians(turn)), np.sin(np.radians(turn))
            directions.append((away * across[0], away * across[1], np.cos(np.radians(tilt))))
    count, pixels = len(described), len(rigs.normals)
    wi = np.broadcast_to(np.array(directions)[:, None], (count, pixels, 3))
    cosine, mirror_angle = angles(rigs.normals, wi)
    strength = np.median(rigs.intensity * np.median(rigs.falloff, axis=1), axis=1)
    new = replace(
        rigs,
        files=tuple(described),
        dn=np.zeros((len(rigs.channels), count, pixels)),
        intensity=np.broadcast_to(strength[:, None], (len(rigs.channels), count)),
        falloff=np.ones((count, pixels)),
        wi=wi,
        cosine=cosine,
        mirror_angle=mirror_angle,
        held_out=np.zeros(count, bool),
        reach=np.zeros(count),
    )
    return new, described


def plan_section(calibration: ReflectanceCalibration, target: str) -> Section:
    """Report the best light in words, and a table for each channel."""
    plans = plan(calibration, target)
    findings, tables = [], []
    for channel, found in plans.items():
        first, of = found.candidates[0], f" of {channel}" if len(plans) > 1 else ""
        findings.append(
            f"{target}{of} is {format_with_error(found.value, found.sd)}; {first.name} would bring "
            f"its standard deviation from {found.sd:.3g} to {first.sd:.3g}, its variance down by "
            f"{100 * first.fall:.2g} %."
        )
        rows = tuple((c.name, c.sd, 100 * c.fall, c.gain) for c in found.candidates[:SHOWN])
        heads = ("image", f"expected s.d. of {target}", "variance less [%]", "all parameters [nat]")
        tables.append(Table(f"What to photograph next{': ' + channel if of else ''}", heads, rows))
    return Section(
        kind="plan",
        title=f"What to photograph next: {LABELS[calibration.model]}, {target}",
        estimates=(),
        findings=tuple(findings),
        tables=tuple(tables),
        settings={"model": calibration.model, "target": target},
    )
