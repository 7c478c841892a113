"""Tests balls of Phong's model in pictures that are means over pixels: sharp, blurred or
sharpened."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from fitting import reflectance
from fitting.reflectance.from_images.findings import view_findings
from fitting.reflectance.from_images.fit import fit_channel
from fitting.reflectance.from_images.perspective import AtOptimum
from fitting.reflectance.from_images.pixel_area import area_share
from fitting.reflectance.from_images.samples import View, cells_of, select
from fitting.reflectance.from_images.shading_check import contradictions
from fitting.reflectance.from_images.signal import Form
from fitting.rig import Camera, SphereGeometry

SIDE, PARTS, RADIUS, BLACK = 48, 4, 21.0, 64.0
TILT, TURN = np.radians(np.repeat([15, 35, 55], [3, 3, 4])), 2.4 * np.arange(10)
LIGHTS = np.stack([np.sin(TILT) * np.cos(TURN), np.sin(TILT) * np.sin(TURN), np.cos(TILT)], axis=1)


def linear():
    """Return the linear pictures, (lights, h, w) DN, each pixel a mean over its area."""
    row, column = (np.indices((SIDE * PARTS,) * 2) + 0.5) / PARTS - SIDE / 2
    x, y = column / RADIUS, -row / RADIUS
    z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    normals = np.where((z > 0)[..., None], np.stack([x, y, z], axis=-1), 0)
    cosine = np.einsum("hwc,lc->lhw", normals, LIGHTS)
    lobe = np.maximum(2 * cosine * normals[..., 2] - LIGHTS[:, 2, None, None], 0) ** 60
    light = 900 * np.where(cosine > 0, 0.3 * cosine + 0.4 * lobe, 0)
    return light.reshape(-1, SIDE, PARTS, SIDE, PARTS).mean(axis=(2, 4))


def fitted(light):
    rng = np.random.default_rng(0)
    dn = BLACK + rng.poisson(4 * light) / 4 + rng.normal(0, 1.5, light.shape)
    seen = reflectance.from_photographs(
        list(np.clip(np.round(dn), 0, 4095)),
        LIGHTS,
        camera=Camera(bits=12, black_level=BLACK),
        sphere=SphereGeometry(centre=((SIDE - 1) / 2,) * 2, radius=RADIUS),
        intensities=np.full(len(LIGHTS), 900.0),
    )
    form = Form("phong")
    chosen = select(seen, held_out=False, form=form)
    fit = fit_channel(View(seen, 0, chosen), form, cells_of(seen, chosen))
    assert fit.converged
    return AtOptimum(seen, fit.vector, fit.samples, chosen)


SITES = {"R": 0.5, "G": 1.0, "B": 0.3}


@pytest.mark.parametrize(
    ("pattern", "stated", "named"),
    [
        ("RGGB", None, "give camera.pattern"),
        ("RGGB", "RGGB", ""),
        ("GRBG", "RGGB", "has another phase than camera.pattern says"),
    ],
)
def test_mosaics_without_a_pattern_or_of_another_phase_are_named(pattern, stated, named):
    """The pictures look as if they were cropped by one column."""
    factors = np.array([SITES[colour] for colour in pattern]).reshape(2, 2)
    images = BLACK + linear() * np.tile(factors, (SIDE // 2, SIDE // 2))
    seen = reflectance.from_photographs(
        list(np.round(images)),
        LIGHTS,
        camera=Camera(bits=12, black_level=BLACK, pattern=stated),
        sphere=SphereGeometry(centre=((SIDE - 1) / 2,) * 2, radius=RADIUS),
        channel="green" if stated else "",
    )
    told = [one for one in contradictions(seen) if "2 x 2 pixels" in one]
    assert len(told) == bool(named)
    assert all(named in one for one in told)


def said(fit):
    return [one for one in view_findings([fit]) if "images look as after" in one]


def test_sharp_pictures_are_not_called_blurred():
    fit = fitted(linear())
    found = area_share(fit.vector, fit.samples, fit.selection.light)
    assert abs(found.share - 1) < 4 * found.error < 2
    assert not said(fit)


@pytest.mark.parametrize("size", [0.8, 1.5])
def test_the_size_of_a_blur_is_estimated_and_named(size):
    """The exponent of 60 is fitted as 47 and 27."""
    fit = fitted(gaussian_filter(linear(), (0, size, size)))
    found = area_share(fit.vector, fit.samples, fit.selection.light)
    assert found.blur == pytest.approx(size, rel=0.15)
    assert np.exp(fit.vector[2]) < 50
    (sentence,) = said(fit)
    assert "a blur of" in sentence
    assert "too wide and low" in sentence


def test_sharpened_pictures_are_named():
    light = linear()
    fit = fitted(np.maximum(2 * light - gaussian_filter(light, (0, 1, 1)), 0))
    assert np.exp(fit.vector[2]) > 63
    assert "sharpening" in said(fit)[0]
