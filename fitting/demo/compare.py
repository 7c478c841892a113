"""`jaxvision-fit demo`: simulate measurements in a lab as image files, calibrate from the files
alone, and compare the estimates with the true values.
"""

import math
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from jaxvision.core.side_by_side import side_by_side

from ..inference.emcee_run import Progress
from ..inference.estimates import Estimate, find
from ..noise.calibration import LIKELIHOOD, STANDARD
from ..noise.calibration import calibrate as calibrate_noise
from ..noise.read import reduce_rig
from ..noise.section import section as noise_section
from ..reflectance.from_images.calibration import calibrate as calibrate_reflectance
from ..reflectance.from_images.read import read_reflectance_observation
from ..reflectance.from_images.section import section as reflectance_section
from ..report.inputs import add_inputs
from ..report.section import Section
from ..response.calibration import calibrate as calibrate_response
from ..response.read import read_exposure_stack
from ..response.section import section as response_section
from ..rig import load_rig
from .lab import Truth, rgb

Key = tuple[str, str, str]  # section kind, estimate name, group


@dataclass(frozen=True)
class Comparison:
    """An estimate and its true value.

    Attributes:
        kind: kind of the report section that contains the estimate.
        estimate: estimate from the files.
        truth: true value, in the unit of the estimate.
    """

    kind: str
    estimate: Estimate
    truth: float

    @property
    def deviations(self) -> tuple[float, ...]:
        """Return, in ascending order, the lower ends of the 95 and 68 % intervals, the estimate,
        and the upper ends of the 68 and 95 % intervals, each minus the true value and in standard
        errors.
        """
        unknown = (math.nan, math.nan)
        low95, high95 = self.estimate.interval_95 or unknown
        low68, high68 = self.estimate.interval_68 or unknown
        value = math.nan if self.estimate.value is None else self.estimate.value
        error = self.estimate.standard_error or math.nan
        ends = (low95, low68, value, high68, high95)
        return tuple((end - self.truth) / error for end in ends)

    @property
    def inside_68(self) -> bool:
        low, high = self.estimate.interval_68 or (math.nan, math.nan)
        return low <= self.truth <= high

    @property
    def inside_95(self) -> bool:
        low, high = self.estimate.interval_95 or (math.nan, math.nan)
        return low <= self.truth <= high


def calibrate_lab(
    folder: Path,
    step: Callable[[str], AbstractContextManager[Progress]],
    draws: Callable[[str, Progress], dict[str, Any]],
) -> list[Section]:
    """Calibrate noise, response and reflectance from the files that `simulate_lab` wrote.

    The reflectance fit weights its pixels with the gain and read noise from photon transfer.
    """

    def noise() -> Section:
        with step("photon transfer") as progress:
            rig = load_rig(folder / "noise")
            found = noise_section(calibrate_noise(reduce_rig(rig), **draws("noise", progress)))
            return add_inputs(found, rig, "photon transfer")

    def response() -> Section:
        with step("response curve") as progress:
            rig = load_rig(folder / "response")
            stack = read_exposure_stack(rig)
            found = response_section(calibrate_response(stack, **draws("response", progress)))
            return add_inputs(found, rig, "a response calibration")

    first = side_by_side([noise, response])
    with step("reflectance") as progress:
        rig = load_rig(folder / "brdf")
        measured = {
            field: find(first[0].estimates, name, method=LIKELIHOOD).value
            for field, name in (("gain", "system_gain"), ("read_noise", "read_noise"))
        }
        rig = rig.model_copy(update={"camera": rig.camera.model_copy(update=measured)})
        observation = read_reflectance_observation(rig)
        drawn = draws("brdf", progress)
        by_fit = progress if drawn["sampling"] is None else None  # a chain shows its own
        found = reflectance_section(
            calibrate_reflectance(observation, model="phong", progress=by_fit, **drawn)
        )
        reflectance = add_inputs(found, rig, "a reflectance calibration")
    return [*first, reflectance]


def truths(truth: Truth) -> dict[Key, float]:
    """Return the true values of the simulated lab, under the names of the estimates."""
    values: dict[Key, float] = {
        ("noise", "system_gain", ""): truth.system_gain,
        ("noise", "quantum_efficiency", ""): 100 * truth.quantum_efficiency,
        ("noise", "read_noise", ""): truth.read_noise,
        ("noise", "dark_current", ""): truth.dark_current,
        ("noise", "dsnu", ""): truth.dsnu,
        ("noise", "prnu", ""): 100 * truth.prnu,
    }
    for channel in rgb(truth.diffuse):
        values["response", "gamma", channel] = truth.gamma
        values["brdf", "exponent", channel] = truth.exponent
        values["brdf", "diffuse", channel] = rgb(truth.diffuse)[channel]
        values["brdf", "specular", channel] = rgb(truth.specular)[channel]
    return values


def compare(sections: Iterable[Section], truth: Truth) -> list[Comparison]:
    """Pair every estimate whose true value is known with this value.

    Of two estimates from the same frames, by the EMVA standard and by maximum likelihood, only the
    second is used.
    """
    known = truths(truth)
    return [
        Comparison(section.kind, estimate, known[section.kind, estimate.name, estimate.group])
        for section in sections
        for estimate in section.estimates
        if (section.kind, estimate.name, estimate.group) in known
        and estimate.value is not None
        and estimate.method != STANDARD
    ]


def mark_truth(section: Section, truth: Truth) -> Section:
    """Return the section with true values that its figures mark."""
    known = truths(truth).items()
    own = {(name, group): value for (kind, name, group), value in known if kind == section.kind}
    return replace(section, truth=own)
