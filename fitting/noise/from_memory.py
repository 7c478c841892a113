"""Photon transfer from frames in memory, with the same result as from a rig with these frames."""

from collections.abc import Sequence
from typing import Any

from jaxvision import ArrayLike
from jaxvision.errors import InputError

from ..inference.precision import double_precision
from ..observation import MEMORY, Load, number_list, require_as_many, require_frames, rig_in_memory
from ..rig import Camera, Rig
from .levels import Levels, PhotonTransfer
from .read import reduce_darks, reduce_rig
from .release_4.stacks import Stacks, reduce_stacks
from .usable import check


@double_precision
def from_frames(
    flats: Sequence[Sequence[ArrayLike]],
    darks: Sequence[Sequence[ArrayLike]],
    exposures: Sequence[float],
    photons: Sequence[float] | None = None,
    *,
    camera: Camera,
    dark_exposures: Sequence[float] | None = None,
    channel: str = "",
) -> PhotonTransfer:
    """Make a photon transfer measurement from frames in memory, as the input of `noise.calibrate`.

    Args:
        flats: for each level of light two or more frames, (h, w) DN.
        darks: for each exposure two or more frames, (h, w) DN.
        exposures: of the levels of light, s.
        photons: mean photons per pixel and exposure of each level. None where unknown; then there
            is no quantum efficiency.
        camera: its bits, and other known properties.
        dark_exposures: of the darks, s; None where each level has darks of its own exposure.
        channel: site of a Bayer mosaic; empty for the first green site.

    Returns:
        The measurement, after the same checks as one from a folder.

    Raises:
        InputError: for lists of unequal length, and for frames that cannot be used.

    Example:
        >>> from fitting.noise import Camera, from_frames
        >>> rng = np.random.default_rng(0)
        >>> levels = [rng.poisson(100 * i, (2, 20, 20)) for i in range(1, 5)]  # DN
        >>> darks = [rng.poisson(1, (2, 20, 20))]
        >>> at = {"camera": Camera(bits=12), "dark_exposures": [0.01]}
        >>> measured = from_frames(levels, darks, [0.01] * 4, [200, 400, 600, 800], **at)
        >>> gain = measured.bright.variance / measured.bright.mean
        >>> print(gain.round(1))  # DN an electron
        [1.  1.  1.1 1.1]
    """
    rig, load = _rig_of(flats, darks, exposures, photons, camera, dark_exposures)
    measurement = reduce_rig(rig, channel=channel, load=load)
    check(MEMORY, measurement)
    return measurement


@double_precision
def stacks_from_frames(
    flats: Sequence[Sequence[ArrayLike]],
    darks: Sequence[Sequence[ArrayLike]],
    exposures: Sequence[float],
    *,
    camera: Camera,
    photons: Sequence[float] | None = None,
    dark_exposures: Sequence[float] | None = None,
    channel: str = "",
) -> Stacks:
    """Compute average frames and spatial variances from frames in memory, as the input of
    `release_4_sheet`.

    Args:
        flats: for each level of light two or more frames, (h, w) DN.
        darks: for each exposure two or more frames, (h, w) DN.
        exposures: of the levels of light, s.
        camera: its bits, and other known properties.
        photons: mean photons per pixel and exposure of each level; None where unknown.
        dark_exposures: of the darks, s; None where each level has darks of its own exposure.
        channel: site of a Bayer mosaic; empty for the first green site.

    Returns:
        Statistics in DN, of all pixels.

    Raises:
        InputError: for lists of unequal length, and for frames that cannot be used.
    """
    rig, load = _rig_of(flats, darks, exposures, photons, camera, dark_exposures)
    return reduce_stacks(rig, channel=channel, load=load)


def _rig_of(
    flats: Sequence[Sequence[ArrayLike]],
    darks: Sequence[Sequence[ArrayLike]],
    exposures: Sequence[float],
    photons: Sequence[float] | None,
    camera: Camera,
    dark_exposures: Sequence[float] | None,
) -> tuple[Rig, Load]:
    """Return a rig that describes frames in memory, and a function that loads them."""
    require_frames("flats", flats)
    require_frames("darks", darks)
    exposures = number_list("exposures", exposures)
    require_as_many("exposures", exposures, "levels of flats", flats)
    if photons is not None:
        photons = number_list("photons", photons)
        require_as_many("photon counts", photons, "levels of flats", flats)
    if dark_exposures is None and len(darks) != len(flats):
        raise InputError(
            f"len(darks) is {len(darks)} and len(flats) {len(flats)}, so darks need exposures of "
            "their own; give dark_exposures."
        )
    times = exposures if dark_exposures is None else number_list("dark_exposures", dark_exposures)
    require_as_many("dark_exposures", times, "sets of darks", darks)
    flat, images = _entries("flats", flats, exposures)
    if photons is not None:
        flat = [entry | {"photons": x} for entry, x in zip(flat, photons, strict=True)]
    dark, unlit = _entries("darks", darks, times)
    called = {
        "flat.exposure": "exposures",
        "flat.photons": "photons",
        "dark.exposure": "exposures" if dark_exposures is None else "dark_exposures",
    }
    return rig_in_memory(images | unlit, called=called, camera=camera, flat=flat, dark=dark)


def _entries(
    kind: str, levels: Sequence[Sequence[ArrayLike]], exposures: Sequence[float]
) -> tuple[list[dict[str, Any]], dict[str, ArrayLike]]:
    """Return the rig's entries of one kind ("flats" or "darks"), and their frames by name."""
    named = [
        {f"{kind}[{i}][{j}]": frame for j, frame in enumerate(level)}
        for i, level in enumerate(levels)
    ]
    entries = [{"files": [*own], "exposure": t} for own, t in zip(named, exposures, strict=True)]
    return entries, {name: frame for own in named for name, frame in own.items()}


@double_precision
def darks_from_frames(
    darks: Sequence[Sequence[ArrayLike]],
    exposures: Sequence[float],
    *,
    camera: Camera,
    channel: str = "",
) -> Levels:
    """Compute the statistics of darks in memory, for a gain and temperature at which there are no
    flats.

    Args:
        darks: for each exposure two or more frames, (h, w) DN.
        exposures: of the darks, s.
        camera: its bits, and other known properties.
        channel: site of a Bayer mosaic; empty for the first green site.

    Returns:
        The statistics of the darks, for `FramesOfSetting`.

    Raises:
        InputError: for lists of unequal length, and for frames that do not belong together.

    Example:
        >>> from fitting.noise import Camera, darks_from_frames
        >>> frames = np.random.default_rng(0).normal(64, 5, (2, 2, 40, 40)).round()  # DN
        >>> darks = darks_from_frames(list(frames), [0.1, 1.0], camera=Camera(bits=12))
        >>> print(darks.mean.round(), np.sqrt(darks.variance).round())
        [64. 64.] [5. 5.]
    """
    require_frames("darks", darks)
    exposures = number_list("exposures", exposures)
    require_as_many("exposures", exposures, "sets of darks", darks)
    dark, images = _entries("darks", darks, exposures)
    rig, load = rig_in_memory(
        images, called={"dark.exposure": "exposures"}, camera=camera, dark=dark
    )
    return reduce_darks(rig, channel=channel, load=load)
