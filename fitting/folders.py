"""Run each calibration of a folder: read its images, fit, and return the sections of a report with
figures. A calibration needs only the path, so any process can run it.

The numerical libraries are imported after the rig has been checked.
"""

import json
import os
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxvision.errors import InputError

from .report.progress import Progress

if TYPE_CHECKING:
    import numpy as np

    from .noise.across_settings.calibration import CameraCalibration
    from .noise.calibration import NoiseCalibration
    from .report.section import Section
    from .rig import Purpose, Rig
    from .rig_from_folder import FoundRig

Step = Callable[[str], AbstractContextManager[Progress]]  # shows a named step while a block runs
Draws = Callable[[str, Progress], dict[str, Any]]  # sampler settings for a kind of calibration
Found = tuple["list[Section]", "dict[str, np.ndarray]"]


def require_path(path: Path) -> Path:
    """Return the path, or raise if it does not exist."""
    if not path.exists():
        raise InputError(f"{path}: no such file or folder; check the name.")
    return path


def read_rig(path: Path, purpose: "Purpose") -> "Rig":
    """Read a rig. Raise if an entry or an image that the calibration needs is missing."""
    from .rig import load_rig, require, require_images

    rig = load_rig(path)
    require(rig, purpose)
    require_images(rig, purpose)
    return rig


def init(folder: Path) -> "tuple[Path, FoundRig]":
    """Write the rig of a folder of images into the folder. Return the rig's path, and the rig with
    a list of missing values. If the pixels of flats and darks reveal several amplifiers, the rig
    names them as taps.
    """
    from .rig_from_folder import write_rig

    path, found = write_rig(folder)
    if found.kind != "noise" or "pattern = " in found.text:
        return path, found
    from jaxvision.files.images import replaced_on_success

    from .noise.levels import linear_levels
    from .noise.periodic import periodic_structure, taps_in_words, taps_of
    from .noise.raw_frames import processing_in_words
    from .noise.read import read_photon_transfer

    try:
        measurement = read_photon_transfer(path)
    except InputError:
        return path, found  # the rig lacks values, which `found.missing` names
    usable = linear_levels(measurement)
    taps = taps_of(periodic_structure(measurement, usable))
    if taps is not None and not processing_in_words(measurement, usable):
        stated = f"taps = {taps_in_words(taps)}  # their pixels differ in the frames"
        found.text = found.text.replace("[camera]\n", f"[camera]\n{stated}\n", 1)
        with replaced_on_success(path) as partial:
            partial.write_text(found.text, encoding="utf-8")
        found.missing.append(
            f"{stated.partition('  #')[0]} was written, because the amplifiers differ in the "
            "frames; remove it to calibrate all pixels as one."
        )
    return path, found


def _attempt(
    kind: str, title: str, make: Callable[[], "Section"], *, known: Sequence[str] = ()
) -> "Section":
    """Return the report section of a calibration. If its fit fails, the section gives the reason
    and the results that are known nevertheless.
    """
    import numpy as np

    from .report.section import failed_section

    try:
        return make()
    except InputError as error:
        why = str(error)
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        why = f"The fit failed ({error}): the model does not describe these data."
    return failed_section(kind, title, why, known=known)


def noise(
    path: Path,
    step: Step,
    draws: Draws,
    *,
    bits: int | None = None,
    channel: str = "",
    release: str = "3.1",
) -> Found:
    """Calibrate the noise by photon transfer, from flats and darks or from a CSV of sums per
    exposure. Several gains or temperatures are fitted separately and together.

    Args:
        path: folder of a rig, or CSV file of sums per exposure.
        step: function that reports progress.
        draws: settings of the sampler.
        bits: ADC bits of the camera, for a CSV.
        channel: mosaic site or amplifier tap; "" for all of them, one after the other.
        release: release of EMVA 1288; "4.0" adds the sheet of that release for each site.

    Returns:
        One section, or one for each site, or one for the camera and one for each setting. Sections
        have no pictures.

    Raises:
        InputError: for data that cannot be calibrated.
    """
    rig = _flats_and_darks(path, bits, channel)
    from .noise.calibration import calibrate
    from .noise.findings import periodic_findings, unstated_taps
    from .noise.read import read_photon_transfer
    from .noise.section import KIND, TITLE, section
    from .noise.settings import split_by_setting
    from .report.inputs import add_inputs
    from .report.section import Section

    settings = 1 if rig is None else len(split_by_setting(rig))
    sites = [channel] if rig is None or channel else list(rig.camera.sites)
    if release == "4.0" and settings > 1:
        raise InputError(
            f"{path}: has {settings} settings, and the sheet of release 4.0 describes one; give "
            "the frames of one gain and temperature, or leave out --release."
        )
    added = _release_4(path, sites, step, draws, bits) if release == "4.0" else []
    if rig is not None and settings > 1:
        return _noise_of_settings(rig, step, draws, channel), {}
    if rig is not None and len(sites) > 1:
        return _with_sheets(_noise_of_sites(rig, step, draws), added), {}
    with step("reading frames"):
        measurement = read_photon_transfer(path, bits=bits, channel=channel)
    unstated: list[tuple[Rig, tuple[str, ...]]] = []

    def fit_noise() -> "Section":
        own = draws("noise", progress)
        later = rig is not None and not channel and own["sampling"] is not None
        if later:  # a chain samples one camera
            own["sampling"] = None
        calibration = calibrate(measurement, **own)
        if rig is not None and not channel and (taps := unstated_taps(calibration)) is not None:
            camera = rig.camera.model_copy(update={"taps": taps})
            if not (camera.has_tap_regions and camera.region):
                sentences = periodic_findings(calibration, apart=True)
                unstated.append((rig.model_copy(update={"camera": camera}), tuple(sentences)))
                return Section(KIND, TITLE, (), ())  # not one camera
        if later:
            calibration = calibrate(measurement, **draws("noise", progress))
        return section(calibration)

    with step("fitting photon transfer") as progress:
        known = (*measurement.bright.left_out, *measurement.dark.left_out)
        found = _attempt(KIND, TITLE, fit_noise, known=known)
    if unstated:
        apart, sentences = unstated[0]
        first, *others = _noise_of_sites(apart, step, draws)
        first = replace(first, findings=(*sentences, *first.findings))
        return _with_sheets([first, *others], added), {}
    found = found if rig is None else add_inputs(found, rig, "photon transfer")
    return _with_sheets([found], added), {}


def _with_sheets(found: "list[Section]", added: "list[Section]") -> "list[Section]":
    """Return sections followed by sheets of release 4, without findings said before."""
    said = {sentence for one in found for sentence in one.findings}
    for sheet in added:
        new = tuple(sentence for sentence in sheet.findings if sentence not in said)
        found.append(replace(sheet, findings=new))
    return found


def _release_4(
    path: Path, sites: Sequence[str], step: Step, draws: Draws, bits: int | None
) -> "list[Section]":
    """Return the sections of each site with the EMVA 1288 data sheet of release 4.0."""
    from .noise.release_4.section import sections
    from .noise.release_4.sheet import release_4_sheet
    from .noise.release_4.stacks import read_stacks
    from .report.section import section_of_part

    seed, found = draws("noise", lambda done, total: None)["seed"], []
    for site in sites:
        with step(f"averaging frames{f' of {site}' if len(sites) > 1 else ''}"):
            try:
                stacks = read_stacks(path, bits=bits, channel=site)
            except InputError:
                continue  # the section of the site says why
            own = sections(release_4_sheet(stacks, seed=seed))
        if len(sites) > 1:
            own = [section_of_part(one, site) for one in own]
        found += own
    return found


def _flats_and_darks(path: Path, bits: int | None, channel: str) -> "Rig | None":
    """Return the rig for a photon-transfer calibration, or None if the path is a CSV table."""
    if path.suffix.lower() != ".csv":
        if bits is not None:
            raise InputError(f"{path}: the rig's camera.bits is used; leave out the bits, {bits}.")
        return read_rig(path, "photon transfer")
    if channel:
        raise InputError(f"{path}: is a table of one channel; leave out the channel {channel!r}.")
    require_path(path)
    return None


def predict(
    camera: str,
    path: Path,
    step: Step,
    *,
    bits: int | None = None,
    channel: str = "",
    light_error: float = 0.0,
) -> Found:
    """Compare flats and darks with the prediction from a camera's file.

    Args:
        camera: a file of a sensor or a camera, the folder that a noise calibration wrote, or the
            name of a shipped camera.
        path: folder of a rig, or a CSV of sums for each exposure.
        step: function that reports progress.
        bits: ADC bits of the camera, for a CSV.
        channel: mosaic site or amplifier tap; "" for all of them, one after the other.
        light_error: relative standard deviation of a level's true light from the stated one.

    Returns:
        One section, or one for each site, without pictures.

    Raises:
        InputError: for data that cannot be compared.
    """
    rig = _flats_and_darks(path, bits, channel)
    file, remarks = _camera_file(camera), ()
    from .noise.prediction.predict import predict as predicted
    from .noise.prediction.predict import read_with_draws
    from .noise.prediction.section import section
    from .noise.read import read_photon_transfer
    from .noise.settings import require_one_setting
    from .noise.sites import camera_of_taps, stated_in_words, unequal_greens
    from .report.inputs import add_inputs
    from .report.section import section_of_part

    taps = read_with_draws(file)[0].taps
    if rig is not None and taps is not None and rig.camera.layout == (1, 1):
        stated = camera_of_taps(taps)
        if stated is not None and not (stated.has_tap_regions and rig.camera.region):
            remarks = (
                f"{rig.folder} states neither camera.pattern nor camera.taps; "
                f"{stated_in_words(stated)} of {file} was taken.",
            )
            own = {"pattern": stated.pattern, "taps": stated.taps}
            rig = rig.model_copy(update={"camera": rig.camera.model_copy(update=own)})
    sites = ("",) if rig is None else (channel,) if channel else rig.camera.sites
    several = len(sites) > 1
    if several and taps is None:
        raise InputError(
            f"{camera}: is the camera of one channel, but {path} has {len(sites)}; give the camera "
            "that jaxvision-fit noise wrote for all, or choose one by --channel."
        )
    if rig is not None:
        require_one_setting(rig, "give the frames of one, and the camera at it")
    sections, measurements = [], {}
    for site in ("" if site == "grey" else site for site in sites):
        with step(f"reading frames{f' of {site}' if several else ''}"):
            measurement = measurements[site] = read_photon_transfer(
                path if rig is None else rig, bits=bits, channel=site
            )
        with step(f"predicting them{f' of {site}' if several else ''}"):
            found = section(predicted(file, measurement, light_error=light_error))
        if rig is not None and not sections:
            found = replace(found, findings=(*remarks, *found.findings))
            found = add_inputs(found, rig, "photon transfer")
        if several:
            found = section_of_part(found, site)
        sections.append(found)
    first, *others = sections
    findings = (*unequal_greens(measurements), *first.findings)
    return [replace(first, findings=findings), *others], {}


def _camera_file(camera: str) -> Path:
    """Return the path of a camera's file, or of the file in a calibration's folder."""
    folder = Path(camera)
    if not folder.is_dir():
        return folder
    own = folder / "sensor.toml"
    if own.is_file():
        return own
    there = sorted(file.name for file in folder.glob("sensor*.toml"))
    has = f"has {', '.join(there)}" if there else "no calibration wrote a camera to it"
    raise InputError(f"{folder}: holds no {own.name} ({has}); name the file, or another folder.")


def _noise_of_sites(rig: "Rig", step: Step, draws: Draws) -> "list[Section]":
    """Return a section for each site or tap, including taps that the rig does not state."""
    from .noise.findings import periodic_findings, unstated_taps
    from .noise.section import sections_of_sites
    from .report.inputs import add_inputs

    looked_for = rig.camera.pattern is not None and rig.camera.taps is None
    calibrations, failed = _calibrate_sites(rig, step, draws, chains=not looked_for)
    if looked_for:
        unstated = {site: unstated_taps(one) for site, one in calibrations.items()}
        taps = {own for own in unstated.values() if own is not None}
        camera = rig.camera.model_copy(update={"taps": taps.pop() if len(taps) == 1 else None})
        if camera.taps is not None and not (camera.has_tap_regions and camera.region):
            site = next(site for site, own in unstated.items() if own is not None)
            words = periodic_findings(calibrations[site], apart=True)
            apart = rig.model_copy(update={"camera": camera})
            first, *others = _noise_of_sites(apart, step, draws)
            sentences = tuple(f"{site}: {sentence}" for sentence in words)
            return [replace(first, findings=(*sentences, *first.findings)), *others]
        if draws("noise", lambda done, total: None)["sampling"] is not None:
            calibrations, failed = _calibrate_sites(rig, step, draws)
    first, *others = sections_of_sites(calibrations, rig.camera)
    sentences = tuple(f"{site} could not be calibrated: {error}" for site, error in failed)
    first = replace(first, findings=(*sentences, *first.findings))
    return [add_inputs(first, rig, "photon transfer"), *others]


def _calibrate_sites(
    rig: "Rig", step: Step, draws: Draws, *, chains: bool = True
) -> "tuple[dict[str, NoiseCalibration], list[tuple[str, InputError]]]":
    """Return the calibration of each site, by chains or Laplace's method, and the failed sites."""
    from .noise.calibration import calibrate
    from .noise.read import read_photon_transfer

    sites = rig.camera.sites
    calibrations, failed = {}, []
    with step("fitting photon transfer of each site") as progress:
        for i, site in enumerate(sites):
            own = draws(f"noise_{i}" if i else "noise", lambda done, total: None)
            own["sampling"] = own["sampling"] if chains else None
            try:
                measurement = read_photon_transfer(rig, channel=site)
                calibrations[site] = calibrate(measurement, **own)
            except InputError as error:
                failed.append((site, error))
            progress(i + 1, len(sites))
    if not calibrations:
        raise failed[0][1]
    return calibrations, failed


def _noise_of_settings(rig: "Rig", step: Step, draws: Draws, channel: str) -> "list[Section]":
    """Return, for each site, a section over all settings and a section for each setting."""
    from .noise.across_settings.section import records_of_sites
    from .report.inputs import add_inputs
    from .report.section import section_of_part

    sites = (channel,) if channel else rig.camera.sites
    if len(sites) == 1:
        whole, *others = _settings_of_site(rig, step, draws, channel)[0]
        return [add_inputs(whole, rig, "photon transfer"), *others]
    found, calibrations = [], {}
    for i, site in enumerate(sites):
        of_one, calibration = _settings_of_site(rig, step, draws, site, word=f"{i}_" if i else "")
        found += [section_of_part(one, site) for one in of_one]
        if calibration is not None:
            calibrations[site] = calibration
    records = records_of_sites(calibrations, rig.camera)
    first = replace(found[0], kind="noise", records=records)
    return [add_inputs(first, rig, "photon transfer"), *found[1:]]


def _settings_of_site(
    rig: "Rig", step: Step, draws: Draws, channel: str, *, word: str = ""
) -> "tuple[list[Section], CameraCalibration | None]":
    from .noise.across_settings.calibration import calibrate_one, calibrate_settings
    from .noise.across_settings.section import sections, sections_without_joint_fit, unread
    from .noise.across_settings.setting import reduce_by_setting
    from .noise.settings import Setting

    failed: dict[Setting, InputError] = {}
    of = f" of {channel}" if channel else ""
    with step(f"reading frames{of}"):
        frames = reduce_by_setting(rig, channel=channel, failed=failed)
    own = []
    with step(f"fitting photon transfer of each setting{of}") as progress:
        for i, one in enumerate(frames):
            own.append(calibrate_one(one, **draws(f"noise_{word}{i}", lambda done, total: None)))
            progress(i + 1, len(frames))
    calibration = None
    with step(f"fitting all settings together{of}"):
        seed = draws("noise", lambda done, total: None)["seed"]
        try:
            calibration = calibrate_settings(frames, calibrations=own, seed=seed)
            whole, *others = sections(calibration)
        except InputError as error:
            whole, *others = sections_without_joint_fit(frames, own, str(error))
    sentences = tuple(f"{setting.label} was left out: {why}" for setting, why in failed.items())
    whole = replace(whole, findings=(*sentences, *whole.findings)) if sentences else whole
    return [whole, *others, *unread(failed)], calibration


def response(
    path: Path, step: Step, draws: Draws, *, skipped: Callable[[str], None] = lambda label: None
) -> Found:
    """Calibrate the response curves of an exposure stack and merge its radiance.

    Args:
        path: folder of a rig.
        step: function that reports progress.
        draws: settings of the sampler.
        skipped: called with the name of each channel that could not be calibrated.

    Returns:
        One section, and the merged relative radiance by the name of its file.

    Raises:
        InputError: for data that cannot be calibrated.
    """
    rig = read_rig(path, "a response calibration")
    from .report.inputs import add_inputs
    from .response.calibration import calibrate, radiance_images
    from .response.read import read_exposure_stack
    from .response.section import section

    with step("reading exposures"):
        stack = read_exposure_stack(rig)
    images: dict[str, np.ndarray] = {}

    def fit_response() -> "Section":
        calibration = calibrate(stack, **draws("response", progress))
        for group, radiance in radiance_images(calibration).items():
            images[f"radiance_{group}.exr" if group else "radiance.exr"] = radiance
        for plane, _ in calibration.skipped:
            skipped(plane.label)
        return section(calibration)

    with step("fitting response") as progress:
        found = _attempt("response", "Camera response", fit_response, known=stack.remarks)
    return [add_inputs(found, rig, "a response calibration")], images


def brdf(path: Path, step: Step, draws: Draws, **settings: Any) -> Found:
    """Calibrate the reflectance from images of a known shape under known lights. Return one
    section, or one for each colour of a mosaic. `settings` are arguments of
    `reflectance.calibrate`.
    """
    rig = read_rig(path, "a reflectance calibration")
    from .reflectance.from_images.calibration import calibrate
    from .reflectance.from_images.read import read_reflectance_observation

    words = "brdf", "Reflectance", "compiling and fitting models of reflectance"
    return _photographs(
        rig, step, draws, settings, words, read_reflectance_observation, calibrate
    ), {}


def joint(path: Path, step: Step, draws: Draws, **settings: Any) -> Found:
    """Calibrate surface, response and sensor in one posterior, from images of a known shape and
    from flats and darks. `settings` are arguments of `joint.calibrate`.
    """
    rig = read_rig(path, "a reflectance calibration")
    from .joint.calibration import calibrate
    from .joint.read import read_joint_measurement

    title = "Surface, response and sensor"
    words = "joint", title, "fitting surface, response and sensor"
    return _photographs(rig, step, draws, settings, words, read_joint_measurement, calibrate), {}


def _photographs(
    rig: "Rig",
    step: Step,
    draws: Draws,
    settings: dict[str, Any],
    words: tuple[str, str, str],
    read: Callable[..., Any],
    calibrate: Callable[..., Any],
) -> "list[Section]":
    """Calibrate from photographs of a known shape. Return one section, or one for each colour of a
    mosaic; `words` are a section's kind, title and progress text.
    """
    from .report.inputs import add_inputs
    from .rig import COLOURS

    kind, title, doing = words

    def calibrate_colour(colour: str) -> "Section":
        of = f" of {colour}" if colour else ""
        with step(f"reading images{of}"):
            observation = read(rig, channel=colour)
        with step(f"{doing}{of}") as progress:
            drawn = draws(f"{kind}_{colour}" if colour else kind, progress)
            by_fit = progress if drawn["sampling"] is None else None  # a chain shows its own
            return _attempt(
                kind,
                title,
                lambda: calibrate(observation, **settings, **drawn, progress=by_fit).section,
                known=observation.findings,
            )

    colours = COLOURS if rig.camera.pattern is not None else ("",)
    first, *others = map(calibrate_colour, colours)
    free = settings.get("fit_gamma", False)
    first = add_inputs(first, rig, "a reflectance calibration", fit_gamma=free)
    if not others:
        return [first]
    rest = zip(others, colours[1:], strict=True)
    return [
        replace(first, title=f"{first.title}: {colours[0]}"),
        *(replace(one, kind=f"{one.kind}_{c}", title=f"{one.title}: {c}") for one, c in rest),
    ]


def lights(
    images: Sequence[Path],
    masks: Sequence[Path],
    step: Step,
    known: dict[str, Any],
    *,
    rig: Path | None = None,
    out: Path | None = None,
    **settings: Any,
) -> Found:
    """Estimate directions or positions of lights from photographs of a ball.

    Args:
        images: files, one per light; masks among them are left out.
        masks: files, one per ball.
        step: function that reports progress.
        known: `bits` and `black_level` of the camera, without a rig.
        rig: rig whose camera is used, with its taps or mosaic.
        out: folder to which the rig is written.
        settings: arguments of `lights.calibrate`: kind, focal_length, radius, outline_sd.

    Returns:
        One section, without pictures.

    Raises:
        InputError: for photographs that cannot be calibrated.
    """
    of_balls = {require_path(mask).resolve() for mask in masks}
    images = [image for image in images if require_path(image).resolve() not in of_balls]
    folder = images[0].parent if images else Path()
    if not images or any(image.parent != folder for image in images):
        raise InputError("give the photographs of a ball, all in one folder, besides the mask.")
    from .frame_checks.heads import different_settings
    from .lights import calibrate
    from .lights.section import section
    from .observation import equalised_camera, read_grey_frame, read_mask
    from .rig import Camera, load_rig, require_one_file_each

    require_one_file_each("the photographs", [image.name for image in images])

    camera = Camera(**known) if rig is None else load_rig(rig).camera
    if camera.encoding is not None:
        raise InputError(
            f"{rig}: states a camera.gamma of {camera.gamma:g}, but lights are found from linear "
            "images; give such images, and a rig without camera.gamma."
        )
    with step("reading images"):
        frames = [read_grey_frame(image, camera) for image in images]
        balls = [read_mask(mask, camera) for mask in masks]
    with step("finding the lights"):
        found = calibrate(
            frames,
            balls,
            camera=equalised_camera(camera),
            files=[image.name for image in images],
            **settings,
        )
    root = os.path.relpath(folder, out or Path()).replace(os.sep, "/")
    stated = camera.model_dump(mode="json", exclude_none=True, exclude={"sensor"})
    lines = "\n".join(f"{name} = {json.dumps(value)}" for name, value in stated.items())
    said = section(found, root=root, camera=lines)
    if differing := different_settings(images):
        sentence = (
            f"By their metadata, the images differ in settings ({differing}); the intensities of "
            "lights include this."
        )
        said = replace(said, findings=(*said.findings, sentence))
    return [said], {}
