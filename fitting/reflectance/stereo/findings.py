"""Sentences on what the images show in addition to normals and albedo."""

import numpy as np
from jaxtyping import Bool, Int

from jaxvision import ArrayLike

from ...copies import Copies
from ...inference.diagnostics import listed
from ...inference.formatting import format_percent, format_with_error
from ...observation import unequal_sites
from ..models import has_lobe, shape_of
from ..names import Model
from .lights import Common, Counted, Images, OfPixels, Readings, Rows, Vectors, predicted
from .misfit import shared_squares
from .model import Surface
from .readings import FEWEST, SHARED, Limits, least_squares, used_readings
from .rough import Rough

SMALL = 0.02  # of the albedo, or of the pixels: smaller departures are not reported
SHOWN_BY = 32  # lights from which residuals reveal the effect of roughness on normals
DARK = 3.0  # standard errors from 0 within which the mean of images shows no light


def materials_finding(model: Model, surface: Surface) -> tuple[str, ...]:
    """Return the fitted numbers of each material, as sentences."""
    names = ["specular"] * has_lobe(model) + [shape_of(model).name]
    return tuple(
        f"Material {label} ({model}) has "
        + listed(
            [
                f"{name} = {format_with_error(*numbers)}"
                for name, *numbers in zip(names, *found, strict=True)
            ]
        )
        + "."
        for label, found in surface.numbers.items()
    )


def exact_finding(share: float) -> str:
    """Say that most pixels use three lights, whose fit leaves no residual."""
    return (
        f"At {format_percent(share)} of the pixels only three lights are used. They leave no "
        "residuals, so normal and albedo have no standard deviation there, and errors of the "
        "lights or of the model do not show. Use four lights or more."
    )


def repeated_finding(share: float) -> str:
    """Say that most pixels use three directions of light only."""
    return (
        f"At {format_percent(share)} of the pixels the lights that are used have three distinct "
        "directions, some of them repeated. Their residuals show noise alone, so the standard "
        "deviations of normal and albedo do not include errors of the lights or of the model. Use "
        "four directions or more."
    )


def infinite_finding(count: int) -> tuple[str, ...]:
    """Say how many readings are infinite and were left out."""
    return (
        f"{count} readings are infinite, as where a number is too large for its type (float16 ends "
        "at 65504), and were left out.",
    )


def wrapped_finding(images: ArrayLike) -> tuple[str, ...]:
    """Return a sentence if some unsigned integers lie near the largest number of their type, far
    above all others, as after a subtraction that passed below 0."""
    codes = np.asarray(images)
    if codes.dtype.kind != "u":
        return ()
    top = int(np.iinfo(codes.dtype).max)
    upper = codes > top - top // 16
    between = (codes > top - top // 4) & ~upper
    if upper.sum() < FEWEST or between.any() or np.unique(codes[upper]).size < 2:
        return ()
    return (
        f"{upper.sum()} readings are from {codes[upper].min()} to {codes[upper].max()}, far above "
        f"all others, as where a subtraction of unsigned integers ({codes.dtype}) passes below 0 "
        "and wraps; convert the images to floating numbers before black is subtracted.",
    )


def clipped_finding(readings: Readings, top: float) -> str:
    """Say that readings at the top suggest a limit."""
    lit, at = np.sum(readings > 0), np.sum(readings >= top)
    return (
        f"{at} readings ({format_percent(at / lit)} of those above 0) are equal to the largest, "
        f"{top:.6g}, as in clipped images, and were left out; give highest to choose another "
        "limit."
    )


def unlit_finding(readings: Readings, between: Counted, limits: Limits) -> tuple[str, ...]:
    """Return a sentence on why no pixel has a normal: too few readings lie between the limits, or
    they scatter about 0 as noise does."""
    known = readings[~np.isnan(readings)]
    if (between.sum(axis=0) >= 3).any():
        mean, error = known.mean(), known.std() / np.sqrt(known.size)
        low, middle, high = np.quantile(known, [0.001, 0.5, 0.999])
        if mean > DARK * error or high - middle > 2 * (middle - low):
            return ()
        reason = (
            f"the readings scatter evenly about {format_with_error(mean, error)}, as noise does"
        )
    else:
        dark, bright = (known <= limits[0]).sum(), (known >= limits[1]).sum()
        reason = (
            f"{dark} of {readings.size} readings are at or below lowest = {limits[0]:g}, {bright} "
            f"are at or above highest = {limits[1]:g}, and {readings.size - known.size} are missing"
        )
    return (
        f"No pixel has a normal, because {reason}; check the files, the black level, and lowest "
        "and highest.",
    )


def deviating_factors_finding(
    common: Common, alone: Bool[np.ndarray, " lights"]
) -> tuple[str, ...]:
    """Name the images left out because one factor applies to all their pixels."""
    return tuple(
        f"images[{i}] is {format_with_error(common.factors[i], common.factor_sds[i])} times as "
        "bright as the other images predict, by the same factor in all pixels, and was left out: "
        "its intensity or exposure time is not as stated."
        for i in np.flatnonzero(alone)
    )


def common_factor_finding(common: Common, moved: Vectors) -> str:
    """State the factors of the lights, or the offset, that are common to all pixels."""
    share = format_percent(typical_albedo(moved), decimals=1)
    allowed = (
        f"would change g = rho n by {share} of the albedo "
        "(median over pixels), which the standard deviations include."
    )
    if common.offset:
        offset = format_with_error(common.offset, common.offset_sd)
        seen = f"All readings have a common offset of {offset}."
        if not common.explained:
            seen = f"Pixels that face away from a light read {offset} in place of 0."
        return (
            f"{seen} Causes are room light or a black level that was not subtracted, one "
            "subtracted twice (a negative offset), or a surface that is not Lambertian. Removing "
            f"it {allowed} Subtract it from the images if you know its cause."
        )
    shown = listed([f"{value:.3f}" for value in common.factors])
    return (
        "The images contradict the intensities of the lights. They agree with the intensities "
        f"multiplied by the factors {shown} (standard errors up to {common.factor_sds.max():.2g}; "
        "the common scale is arbitrary). Causes are wrong intensities or exposure times, or a lamp "
        "that drifts. "
        f"They explain {format_percent(common.explained)} of the residuals' sum of squares. "
        f"Applying them {allowed} If so, multiply the intensities by these factors."
    )


def contradiction_finding(
    rows: Rows, stack: Images, between: Counted, limits: Limits
) -> tuple[str, ...]:
    """Return a sentence if the readings of most pixels differ from Lambert's law, and neighbouring
    pixels do so in the same way.
    """
    readings = stack.reshape(len(rows), -1)
    counts = used_readings(rows, readings, between, limits, robust=False)
    g, _, scatter, _ = least_squares(rows, readings, counts)
    counts &= np.isfinite(g[:, 0])
    residuals = np.where(counts, readings - predicted(rows, g), 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        size = np.sqrt(scatter) / np.linalg.norm(g, axis=1)
    lit = size[np.isfinite(size)]
    shared = shared_squares(residuals.reshape(stack.shape), counts.reshape(stack.shape))
    if shared < SHARED or not lit.size or np.median(lit) < SMALL:
        return ()
    return (
        f"The images contradict m = E rho n.l by {format_percent(np.median(lit))} of the albedo "
        "(median over pixels), and neighbouring pixels in the same way: they share "
        f"{format_percent(shared)} of the residuals' sum of squares. Causes are wrong directions, "
        "order or intensities of the lights, a black level, a gamma, highlights, shadows or a "
        "surface that is not Lambertian; the images alone do not show which. The errors of "
        "normals may be larger than their standard deviations.",
    )


def misfit_finding(
    model: Model,
    misfit: OfPixels,
    wider: OfPixels,
    used: Int[np.ndarray, " pixels"],
    rough: Rough | None,
) -> str:
    """State departures from the model that neighbouring lights share."""
    few = (
        f" With only {np.median(used):.0f} lights they are lower bounds: a rough surface may bias "
        f"normals by twice as much; {SHOWN_BY} lights would show it."
        if np.median(used) < SHOWN_BY
        else ""
    )
    if rough is not None:
        sigma, sd, turned = np.degrees([rough.sigma, rough.sigma_sd, rough.turned])
        few = (
            f" A rough body (Oren-Nayar, sigma = {format_with_error(sigma, sd)} degrees) explains "
            f"{format_percent(rough.explained)} of the residuals' squares. It would rotate normals "
            f"by {turned:.2g} degrees (median), which the standard deviations include. If the "
            'surface is rough, give model = "oren-nayar".'
        )
    surface, law, near = "is not Lambertian", "m = E rho n.l", ""
    if model != "lambert":
        surface, law = f"does not follow {model}", "the model"
        near = ", or the camera is not far away (viewer is the same in all pixels)"
    return (
        f"The surface {surface}, or the readings are not linear (room light, a black level, "
        f"a gamma, clipped pixels), or the lights are not as stated{near}: under neighbouring "
        f"lights, the readings depart from {law} in the same way, by "
        f"{format_percent(np.nanmedian(misfit), decimals=1)} of the albedo (median over pixels). "
        "The standard deviations of normals include this and are "
        f"{np.nanmedian(wider):.1f} times those of noise alone.{few}"
    )


def equal_images_finding(stack: Images) -> tuple[str, ...]:
    """Name images that are copies of each other."""
    copies = Copies()
    for i, image in enumerate(stack):
        copies.add(f"images[{i}]", image)
    return tuple(
        f"{listed(list(files))} hold equal numbers: they are copies of one exposure, under "
        "lights of which all but one are wrong or counted twice; keep one of them."
        for files in copies.equal_groups
    )


def mosaic_finding(stack: Images) -> tuple[str, ...]:
    """Say that the images are a raw colour mosaic, or of two amplifiers."""
    clause, key = unequal_sites(stack.mean(axis=0))
    remedy = "correct the images with jaxvision.correct" if "taps" in key else "give one colour"
    return (f"{clause}. The albedo includes this pattern; {remedy}.",) * bool(clause)


def typical_albedo(g: Vectors) -> float:
    """Return the median albedo."""
    return float(np.nanmedian(np.linalg.norm(g, axis=1)))
