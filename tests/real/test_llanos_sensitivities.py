"""Tests Llanos' camera with seven narrow bands and 24 patches of known reflectance: sensitivities
fitted to half of the patches predict the readings of the other half.

The lamp's spectrum and its shading in each band are unknown. Both cancel in the share of each
channel in the sum of all channels, for a patch and a band. Shares are readings of light with the
spectrum filter times reflectance, for sensitivities whose sum over the channels is 1."""

import re

import numpy as np
import pytest
from PIL import Image

from fitting import sensitivities

NM = np.arange(380, 721, 5)
CORNERS = np.array([[57, 61], [57, 350], [218, 74], [217, 334]])  # centres: row, column
HALF = 11  # pixels, half of the side that is read
SITES = {"green": [(0, 0), (1, 1)], "blue": [(0, 1)], "red": [(1, 0)]}
HIGHEST = 250  # DN, for unclipped pixels
CODE_ERROR = 0.3  # DN, of a mean of undithered codes
FLOOR = 0.03  # spectrometer noise relative to a filter's peak, which would change shares
STRAY = 0.004  # of the light of all channels
LINEARITY = 0.02  # published: .1 to 4 %


def shares(folder):
    """Return the shares of red, green and blue (bands, 24, 3), their standard deviations, and the
    light (bands, 24, wavelengths)."""
    table = np.genfromtxt(folder / "spectra_averaged.csv", delimiter=",", skip_header=1)
    at = table[:, 0]
    spectra = np.array([np.interp(NM, at, column) for column in np.maximum(table[:, 1:].T, 0)])
    filters, patches = spectra[:7], spectra[11:35]
    filters = np.where(filters > FLOOR * filters.max(axis=1, keepdims=True), filters, 0)
    row, column = np.divmod(np.arange(24), 6)
    u, v = column[:, None] / 5, row[:, None] / 3
    places = (1 - v) * ((1 - u) * CORNERS[0] + u * CORNERS[1])
    places = np.round(places + v * ((1 - u) * CORNERS[2] + u * CORNERS[3])).astype(int)
    rates, sds = np.zeros((2, 7, 24, 3))
    bands = ("400nm", "450nm", "500nm", "550nm", "600nm", "650nm", "700nm")
    for b, band in enumerate(bands):
        files = (folder / "color_checker").glob(f"*_{band}_*.tif")
        seconds = {int(re.search(r"_(\d+)ms_", file.name)[1]) / 1e3: file for file in files}
        images = {s: np.array(Image.open(file), float) for s, file in seconds.items()}
        for p, (y, x) in enumerate(places):
            box = slice(y - HALF, y + HALF), slice(x - HALF, x + HALF)
            for c, name in enumerate(("red", "green", "blue")):
                for s in sorted(images, reverse=True):
                    cut = images[s][box]
                    cells = [
                        cut[(i - box[0].start) % 2 :: 2, (j - box[1].start) % 2 :: 2]
                        for i, j in SITES[name]
                    ]
                    if max(cell.max() for cell in cells) < HIGHEST:
                        rates[b, p, c] = np.mean(cells) / s
                        sds[b, p, c] = np.hypot(CODE_ERROR / s, LINEARITY * rates[b, p, c])
                        break
                else:
                    raise AssertionError(f"{band}, patch {p}, {name} is clipped")
    whole = rates.sum(axis=-1, keepdims=True)
    light = filters[:, None] * patches
    sds = np.hypot(sds, STRAY * whole)
    return rates / whole, sds / whole, light / light.sum(axis=-1, keepdims=True)


@pytest.mark.slow
def test_readings_of_other_patches_are_predicted(data_folder):
    """The test starts at 450 nm, because at 400 nm the brightest patch reads 19 DN, mostly stray
    light."""
    share, sd, light = (x[1:] for x in shares(data_folder / "llanos_bandpass"))
    fitted = np.arange(24) % 2 == np.arange(24) // 6 % 2
    one = [x[:, fitted].reshape(-1, x.shape[-1]) for x in (share, light, sd)]
    found = sensitivities.from_patches(one[0], one[1], 1e-9 * NM, sd=one[2])
    assert found.findings == ()
    other = found.readings(light[:, ~fitted])
    off = share[:, ~fitted] - other.mean
    assert np.sqrt(np.mean(off**2, axis=1)).max() < 0.017  # shares are from .002 to .95
    assert np.mean(np.abs(off) < 1.96 * np.hypot(other.sd, sd[:, ~fitted])) > 0.94
    whole = found.readings(light[:, ~fitted]).draws.sum(axis=-1)
    np.testing.assert_allclose(whole.mean(axis=0), 1, atol=0.02)
