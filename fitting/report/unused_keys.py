"""Findings on the keys of a rig that a calibration does not use, each with the reason. A
calibration either uses a value stated in the rig or names its key in such a finding."""

from collections.abc import Iterator

from ..inference.diagnostics import listed
from ..rig import BY_SITE, Rig

Unused = Iterator[tuple[tuple[str, ...], str]]  # keys, and why

NOISE = "gain", "gain_sd", "read_noise", "read_noise_sd", "prnu_sd"
BLACK = "black_level", "black_sd"
GAMMA = "gamma", "gamma_sd"
OF_PHOTONS = "pixel_pitch", "wavelength"


def unused_keys(rig: Rig, kind: str, *, fit_gamma: bool = False) -> tuple[str, ...]:
    """Return sentences on the stated keys of a rig that a calibration of this kind does not use."""
    found = [*REASONS[kind](rig), *_sites(rig, kind)]
    if fit_gamma:
        found.append((_camera(GAMMA), "the encoding exponent was fitted"))
    sentences = []
    for keys, why in found:
        given = []
        for key in keys:  # such as `camera.gain`, `[[dark]]`, or `flat.photons` of any flat
            section, _, name = key.strip("[]").partition(".")
            entries = getattr(rig, section)
            entries = entries if isinstance(entries, tuple) else (entries,)
            if any(not name or getattr(entry, name) is not None for entry in entries):
                given.append(key)
        if given:
            sentences.append(f"Not used of the rig: {listed(given)}; {why}.")
    return tuple(sentences)


def _sites(rig: Rig, kind: str) -> Unused:
    camera = rig.camera
    if camera.taps is None:
        return
    if camera.pattern is not None and camera.layout == (2, 2):
        yield ("camera.taps",), "camera.pattern already separates the pixels of each"
    several = any(isinstance(getattr(camera, name), tuple) for name in BY_SITE)
    if kind in ("brdf", "joint") and not several:
        yield ("camera.taps",), "black level and saturation are the same at all taps"


def _camera(names: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"camera.{name}" for name in names)


def _noise(rig: Rig) -> Unused:
    yield _camera(("black_sd", *NOISE)), "photon transfer measures them"
    yield _camera(GAMMA), "photon transfer takes digital numbers as linear in light"
    yield from _light_of_flats(rig)


def _prediction(rig: Rig) -> Unused:
    yield _camera((*BLACK, *NOISE, *GAMMA)), "the camera file alone predicts the frames"
    yield from _light_of_flats(rig)


def _light_of_flats(rig: Rig) -> Unused:
    if any(flat.photons is not None for flat in rig.flat):
        yield ("flat.irradiance",), "the photons of each flat are given"
    if not any(flat.photons is None and flat.irradiance is not None for flat in rig.flat):
        yield _camera(OF_PHOTONS), "no irradiance had to be converted to photons"


def _response(rig: Rig) -> Unused:
    yield _camera(NOISE), "the noise of pixels is estimated from the exposures"
    yield _camera(GAMMA), "the response is measured"
    yield _camera(OF_PHOTONS), "exposures are relative"
    groups = {exposure.group for exposure in rig.exposure}
    if len(groups) == 1 and groups != {""}:
        yield ("exposure.group",), "all exposures are of one group"
    if rig.camera.black_level is not None:
        yield ("[[dark]]",), "camera.black_level is given"


def _brdf(rig: Rig) -> Unused:
    if rig.camera.gain is None or rig.camera.read_noise is None:
        keys = NOISE[:-1]
        why = (
            "without both gain and read noise, the noise of pixels is estimated from the residuals"
        )
        yield _camera(keys), why
    else:
        errors = "gain_sd", "read_noise_sd"
        yield _camera(errors), "to first order they change only the weights of pixels"
    yield _camera(("prnu_sd",)), "the unequal gains of pixels are estimated from the residuals"
    yield _camera(OF_PHOTONS), "lights are stated by their irradiance"
    yield ("[[flat]]", "[[dark]]"), "jaxvision-fit joint uses them"


def _joint(rig: Rig) -> Unused:
    keys = "flat.photons", "flat.irradiance", *_camera(OF_PHOTONS)
    yield keys, "flats enter through their means and variances"
    if rig.camera.black_level is None and rig.dark and rig.camera.encoding is None:
        yield _camera(("black_sd",)), "without camera.black_level, the darks give the black level"


REASONS = {
    "noise": _noise,
    "prediction": _prediction,
    "response": _response,
    "brdf": _brdf,
    "joint": _joint,
}
