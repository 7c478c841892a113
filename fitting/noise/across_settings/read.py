"""Flats and darks of a rig reduced setting by setting."""

import os
from pathlib import Path

from jaxvision.errors import InputError
from jaxvision.files.images import read_image

from ...inference.precision import in_double
from ...observation import Load
from ...rig import Rig, load_rig
from ..read import reduce_darks, reduce_rig
from ..settings import Setting, by_setting
from ..usable import check
from .setting import FramesOfSetting


@in_double
def read_by_setting(
    path: str | os.PathLike[str], *, channel: str = ""
) -> tuple[FramesOfSetting, ...]:
    """Photon transfer of a rig at several gains and temperatures.

    A setting may have darks alone, for the dark current of its temperature.

    Args:
        path: a rig folder or file.
        channel: site of a Bayer mosaic; empty for the first green.

    Returns:
        The frames of each gain and temperature, in their order.

    Raises:
        InputError: for files that cannot be used.
    """
    return reduce_by_setting(load_rig(path), channel=channel)


@in_double
def reduce_by_setting(
    rig: Rig,
    *,
    channel: str = "",
    load: Load = read_image,
    failed: dict[Setting, InputError] | None = None,
) -> tuple[FramesOfSetting, ...]:
    """As `read_by_setting`, for a rig in memory. `failed` collects unusable settings with the
    reason, and they are left out; with None, the rig is refused."""
    rigs = by_setting(rig)
    found: dict[Setting, FramesOfSetting] = {}
    lit = {setting.gain for setting, own in rigs.items() if own.flat}
    for setting in sorted(rigs, key=lambda one: not rigs[one].flat):  # flats first
        place = Path(rig.folder) / f"({setting.label})" if len(rigs) > 1 else rig.folder
        try:
            found[setting] = _reduced(place, setting, rigs[setting], lit, channel, load)
        except InputError as error:
            if failed is None:
                raise
            failed[setting] = error
            lit = {one.gain for one in rigs if rigs[one].flat and one not in failed}
    if not found and failed:
        raise next(iter(failed.values()))
    return tuple(found[setting] for setting in rigs if setting in found)


def _reduced(
    place: Path, setting: Setting, own: Rig, lit: set[float | None], channel: str, load: Load
) -> FramesOfSetting:
    """One setting; `lit` has the gains for which there are flats."""
    if not own.dark:
        raise InputError(f"{place}: its flats have no darks of their gain and temperature.")
    if own.flat:
        frames = reduce_rig(own, channel=channel, load=load)
        check(place, frames)
    elif setting.gain in lit:
        frames = reduce_darks(own, channel=channel, load=load)
    else:
        raise InputError(f"{place}: its darks have no flats of their gain at any temperature.")
    return FramesOfSetting(setting, frames)
