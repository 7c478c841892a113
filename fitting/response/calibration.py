"""The camera response from an exposure stack: the whole curve, gamma, and the merged radiance map,
per colour channel (or Bayer site) and group of images."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxvision.errors import InputError

from ..inference.emcee_run import SamplingOptions, for_group
from .curve import ResponseCurve, fit_response_curve
from .gamma import GammaFit, fit_gamma
from .places import layout_of
from .radiance_map import RadianceMap, merge
from .read import ExposureStack, Plane


@dataclass(frozen=True)
class ChannelResponse:
    """What one plane gave.

    Attributes:
        plane: its codes and exposures.
        curve: log exposure of every code.
        gamma: the best pure gamma.
        radiance: the merged map.
    """

    plane: Plane
    curve: ResponseCurve
    gamma: GammaFit
    radiance: RadianceMap


@dataclass(frozen=True)
class ResponseCalibration:
    """A calibrated stack.

    Attributes:
        stack: what was calibrated.
        channels: the planes that could be.
        skipped: (plane, reason) of those that could not.
        sampling: how gamma was drawn; None for Laplace.
        seed: of every draw.
    """

    stack: ExposureStack
    channels: tuple[ChannelResponse, ...]
    skipped: tuple[tuple[Plane, str], ...]
    sampling: SamplingOptions | None
    seed: int


def calibrate(
    stack: ExposureStack, *, sampling: SamplingOptions | None = None, seed: int = 0
) -> ResponseCalibration:
    """The response of every plane of a stack.

    A plane that cannot be calibrated (too dark, all clipped) is set aside with its reason.

    Args:
        stack: exposures of still scenes.
        sampling: how to draw gamma by emcee; None for exact integrals and Laplace's draws.
        seed: of every draw.

    Returns:
        The calibration.

    Raises:
        InputError: when no plane can be calibrated.
    """
    channels, skipped = [], []
    for plane in stack.planes:
        try:
            channels.append(_calibrate(plane, stack, sampling, seed))
        except InputError as error:
            skipped.append((plane, str(error)))
    if not channels:
        plane, reason = skipped[0]
        raise InputError(f"{plane.files[0]} and its stack ({plane.label}): {reason}")
    return ResponseCalibration(stack, tuple(channels), tuple(skipped), sampling, seed)


def _calibrate(
    plane: Plane, stack: ExposureStack, sampling: SamplingOptions | None, seed: int
) -> ChannelResponse:
    curve = fit_response_curve(
        plane.codes[:, plane.mask],
        plane.exposures,
        bits=stack.bits,
        black=plane.black,
        clip=plane.clip,
        layout=layout_of(plane.codes, plane.mask, black=plane.black, clip=plane.clip),
    )
    own = for_group(sampling, plane.label)
    gamma = fit_gamma(curve, label=plane.label, sampling=own, seed=seed)
    return ChannelResponse(plane, curve, gamma, merge(plane.codes, plane.exposures, curve))


def radiance_images(calibration: ResponseCalibration) -> dict[str, Float[np.ndarray, "h w *rgb"]]:
    """Radiance maps by group.

    Args:
        calibration: of a stack.

    Returns:
        float32, relative: (h, w, 3) for colour, (h / 2, w / 2, 3) for a mosaic (its greens
        averaged), (h, w) for grey. A group that lacks a colour is left out.
    """
    images = {}
    for group in dict.fromkeys(channel.plane.group for channel in calibration.channels):
        maps = {
            channel.plane.channel: channel.radiance.radiance
            for channel in calibration.channels
            if channel.plane.group == group
        }
        if {"green 1", "green 2"} <= maps.keys():
            maps["green"] = (maps["green 1"] + maps["green 2"]) / 2
        if "grey" in maps:
            images[group] = maps["grey"]
        elif {"red", "green", "blue"} <= maps.keys():
            images[group] = np.stack([maps[colour] for colour in ("red", "green", "blue")], axis=-1)
    return images
