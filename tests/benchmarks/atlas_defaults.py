"""Check whether each default lies on the Pareto front of its knob, by the curves of the atlas."""

import dataclasses
import inspect
from collections.abc import Iterable
from typing import Any

import numpy as np

from fitting import fit
from fitting.inference.newton import minimise
from fitting.inference.nuts import Nuts
from fitting.inference.posterior import laplace
from fitting.response.curve import fit_response_curve
from jaxvision import Diffraction, PixelAperture, capture, optics, point_ops
from jaxvision.accuracy import Curve
from jaxvision.accuracy.records import Trial
from jaxvision.accuracy.tables import percent_text
from jaxvision.brdf.measured import tabulate_sampler
from jaxvision.files.scenes.schema import RenderEntry
from jaxvision.filters import gaussian
from jaxvision.lights.adaptive import adaptive_irradiance
from jaxvision.matting import estimate_foreground
from jaxvision.rendering.hemisphere_integral import hemisphere_radiance
from jaxvision.transport import Paths
from jaxvision.transport.radiosity import form_factor_table, polygon_to_polygon
from jaxvision.transport.radiosity.solve import shoot

OF_CALLS = {
    "Gaussian cut": (gaussian, "truncate"),
    "interpolation": (optics.sample_image, "interpolation"),
    "power method": (point_ops.gamma_decode, "method"),
    "foreground steps": (estimate_foreground, "fine_steps"),
    "oversampling": (PixelAperture, "oversampling"),
    "diffraction size": (Diffraction, "size"),
    "diffraction nodes": (optics.airy_kernel, "order"),
    "motion moments": (capture, "moments"),
    "strategy": (Paths, "strategy"),
    "form factor rays": (form_factor_table, "rays"),
    "radiosity solver": (shoot, "tolerance"),
    "adaptive nodes": (adaptive_irradiance, "tolerance"),
    "hemisphere": (hemisphere_radiance, "polar"),
    "polygon form factor": (polygon_to_polygon, "order"),
    "sampler table": (tabulate_sampler, "rows"),
    "posterior": (fit, "posterior"),
    "starts": (fit, "starts"),
    "Laplace draws": (laplace, "draws"),
    "NUTS draws": (Nuts, "draws"),
    "solver tolerance": (minimise, "tolerance"),
    "code bins": (fit_response_curve, "most_bins"),
    "curve rounds": (fit_response_curve, "rounds"),
}
FASTER = 0.9  # a setting beats a default if it takes at most this share of its time
OF_SCENES = ("samples", "depth", "order", "rule", "patches", "dtype")


def default_of(curve: Curve) -> Any:
    """Return the default of a function's argument or of a key of `[render]`, or None if there is
    none."""
    name = curve.knob.name
    if name in OF_CALLS:
        of, argument = OF_CALLS[name]
        if dataclasses.is_dataclass(of):
            return next(f.default for f in dataclasses.fields(of) if f.name == argument)
        return inspect.signature(of).parameters[argument].default
    if name in OF_SCENES:
        integrator = curve.problem.split(", ")[1]
        return getattr(RenderEntry.model_validate({"integrator": integrator}), name)
    return None


def verdict(curve: Curve, default: Any) -> str:
    """Return in a few words how a default compares with its curve."""
    run = {trial.setting: trial for trial in curve.trials}
    if default in run:
        return judged(curve, run[default])
    if not isinstance(default, int | float):
        return "not run"
    rising = 1 if curve.knob.settings[0] < curve.knob.settings[-1] else -1
    coarser = [setting for setting in run if rising * setting < rising * default]
    if not coarser:
        return "not run"
    near = max(coarser, key=lambda setting: rising * setting)
    finest = near == max(run, key=lambda setting: rising * setting)
    where = "finer than what was run" if finest else "between settings"
    return f"{where}; {near}: {judged(curve, run[near])}"


def judged(curve: Curve, trial: Trial) -> str:
    """Return whether a trial is on the Pareto front, equal to it within the spread, or beaten, and
    by which setting."""
    taken = f"in {1e3 * trial.seconds:.3g} ms"
    own = curve.reference.error
    if trial.setting == curve.reference.setting and curve.reference.how != "exact setting":
        known = percent_text(own) if np.isfinite(own) else "not known"
        return f"the finest that time allowed, {taken}; its own error {known}"
    said = f"{percent_text(trial.error)} {taken}"
    better = [
        other
        for other in curve.trials
        if other.error_high <= trial.error_low
        and other.seconds_high < min(trial.seconds_low, FASTER * trial.seconds)
    ]
    if better:
        one = min(better, key=lambda other: other.seconds)
        return f"**beaten** by {one.setting}: {said}, not {1e3 * one.seconds:.3g} ms"
    return f"on the front: {said}" + (", near the reference's own error" if trial.hollow else "")


def defaults(curves: Iterable[Curve]) -> list[str]:
    """Return a table of the defaults of all knobs that have one.

    Args:
        curves: the curves of the atlas, times in s.

    Returns:
        Lines of Markdown."""
    known = [(one, default_of(one)) for one in curves]
    places = [(one, at, verdict(one, at)) for one, at in known if at is not None]
    beaten = sum(place.startswith("**beaten**") for *_, place in places)
    shown = beaten + sum(place.startswith("on the front") for *_, place in places)
    head = [
        "## Defaults",
        "",
        "This table compares each default with the other settings of its curve. A default is",
        "beaten if another setting is a tenth faster and at least as accurate, by more than the",
        f"spreads of both. Of {shown} defaults, {beaten or 'none'} {'is' if beaten < 2 else 'are'}",
        f"beaten. For {len(places) - shown} more there was too little time to decide.",
        "",
        "| approximation | problem | default | result |",
        "| --- | --- | --- | --- |",
    ]
    rows = [
        f"| {c.knob.name} | {c.problem} | {default} | {place} |" for c, default, place in places
    ]
    return [*head, *rows, ""]
