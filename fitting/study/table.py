"""Collect all folders of a study in one data set with the dimensions camera, channel and quantity,
and values with intervals.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import xarray as xr

from jaxvision.files.images import replaced_on_success

from ..inference.estimates import Estimate
from .outcomes import Outcome

COLUMNS = ("value", "standard_error", "low_95", "high_95")


def label(estimate: Estimate) -> str:
    """Return the name of a quantity with its method of estimation."""
    name = estimate.name.replace("_", " ")
    return f"{name} ({estimate.method})" if estimate.method else name


def table(outcomes: Sequence[Outcome]) -> xr.Dataset:
    """Return the results of all folders as one data set."""
    found = {
        (outcome.camera, one.group, label(one)): one
        for outcome in outcomes
        for one in outcome.estimates
    }
    cameras = [outcome.camera for outcome in outcomes]
    channels = list(dict.fromkeys(channel for _, channel, _ in found))
    units = {name: one.unit for (*_, name), one in found.items()}
    shape = (len(cameras), len(channels), len(units))
    arrays = {name: np.full(shape, np.nan) for name in COLUMNS}
    places = [{name: i for i, name in enumerate(axis)} for axis in (cameras, channels, list(units))]
    for key, one in found.items():
        at = tuple(axis[name] for axis, name in zip(places, key, strict=True))
        low, high = one.interval_95 or (None, None)
        for name, value in zip(COLUMNS, (one.value, one.standard_error, low, high), strict=True):
            arrays[name][at] = np.nan if value is None else value
    every = ("camera", "channel", "quantity")
    return xr.Dataset(
        {
            **{name: (every, array) for name, array in arrays.items()},
            "findings": ("camera", [" ".join(outcome.findings) for outcome in outcomes]),
            "failed": ("camera", [outcome.failed for outcome in outcomes]),
            "temperature": (
                "camera",
                [np.nan if o.temperature is None else o.temperature for o in outcomes],
            ),
        },
        coords={
            "camera": cameras,
            "channel": channels,
            "quantity": list(units),
            "unit": ("quantity", list(units.values())),
            "date": ("camera", [outcome.date for outcome in outcomes]),
        },
    )


def write_table(path: Path, found: xr.Dataset) -> None:
    """Write the table as NetCDF, which `xarray.open_dataset` reads."""
    with replaced_on_success(path) as whole:
        found.to_netcdf(whole, engine="h5netcdf")
