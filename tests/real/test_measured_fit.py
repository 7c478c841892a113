"""Tests lobes fitted to the Cornell paints and the RGL materials: which is best, and whether the
amplitudes match the paints' appearance."""

import numpy as np
import pytest

from fitting.reflectance.from_files import read as measured_brdf
from fitting.reflectance.from_files.calibration import calibrate as calibrate_brdf
from fitting.reflectance.from_files.findings import findings, which_axis_wins
from fitting.reflectance.from_files.read import read_measured_brdf

FILES = {
    "garnet_red": "brdf_cornell/garnet_red.brdf",
    "acryl_blue": "brdf_cornell/acryl_blue.brdf",
    "paper_white": "brdf_rgl/paper_white_rgb.bsdf",
    "satin_rosaline": "brdf_rgl/satin_rosaline_rgb.bsdf",
    "golden_yellow": "brdf_rgl/vch_golden_yellow_rgb.bsdf",
}
MIRROR = ("phong", "normalised-phong", "gaussian-lobe")
HALF = ("blinn", "normalised-blinn", "torrance-sparrow-beckmann", "torrance-sparrow")


@pytest.fixture(scope="module")
def calibrated(data_folder):
    """Return a function that gives each calibration by name, computed once."""
    known = {}

    def of(name):
        if name not in known:
            known[name] = calibrate_brdf(read_measured_brdf(data_folder / FILES[name]))
        return known[name]

    return of


def least(calibration, models):
    return min(calibration.held_out[model].relative for model in models)


@pytest.mark.slow
def test_garnet_red_is_a_dielectric_coat(calibrated):
    garnet = calibrated("garnet_red")
    assert garnet.model == "torrance-sparrow-beckmann"
    # 17.7 % against 104 %: mirror lobes cannot increase towards grazing angles like the coat.
    assert least(garnet, HALF) < 0.25 < 0.8 < least(garnet, MIRROR)
    assert garnet.held_out["torrance-sparrow-metal"].relative > 3 * least(garnet, HALF)
    assert 0.1 < garnet.mean[2] < 0.2
    assert np.sqrt(garnet.covariance[2, 2]) < 0.2


@pytest.mark.slow
def test_the_paint_is_red_and_its_coat_has_no_colour(calibrated):
    garnet = calibrated("garnet_red")
    wavelengths = garnet.measured.wavelengths
    diffuse, specular = garnet.amplitudes.diffuse, garnet.amplitudes.specular
    assert diffuse[wavelengths > 620].min() > 5 * diffuse[wavelengths < 560].max()
    assert np.ptp(specular) < 0.25 * specular.mean()
    assert np.all(np.abs(specular - 1) < 4 * garnet.amplitudes.specular_error)


@pytest.mark.slow
def test_sharp_acryl_does_not_distinguish_the_axes(calibrated):
    acryl = calibrated("acryl_blue")
    errors = [acryl.held_out[m].relative for m in ("phong", "blinn", "gaussian-lobe")]
    np.testing.assert_allclose(errors, errors[0], rtol=1e-2)
    told = findings(acryl)[0]
    assert (
        "by leaving out each incidence in turn: Gaussian lobe (28.3 %), Blinn (28.3 %) and "
        "Torrance-Sparrow (GGX, metal) (67.2 %). Some of these have a far larger error here"
    ) in told
    # Beckmann facets fail at 80 degrees, and without it still have twice the error of Phong's lobe.
    useless = told[told.index("With errors larger than the signal") :]
    beckmann = "Torrance-Sparrow (Beckmann) (220 %: 7.76 times the error, 2.08 times without 80°"
    assert beckmann in useless
    blue = np.argmax(acryl.amplitudes.diffuse)
    assert 430 <= acryl.measured.wavelengths[blue] <= 480


@pytest.mark.slow
def test_the_best_models_of_five_materials(calibrated):
    all_five = [calibrated(name) for name in FILES]
    assert [c.model for c in all_five] == [
        "torrance-sparrow-beckmann",
        "phong",
        "phong",
        "torrance-sparrow",
        "normalised-phong",
    ]
    assert least(all_five[3], HALF) < 0.7 * least(all_five[3], MIRROR)
    assert least(all_five[4], MIRROR) < 0.97 * least(all_five[4], HALF)
    first, second, third = which_axis_wins(all_five)
    assert "is better on 2 of 5 (garnet red, satin rosaline rgb)" in first
    assert "Torrance-Sparrow (Beckmann) against normalised Phong on garnet red" in first
    assert "the half vector wins 0 of 10 comparisons" in second
    # Facets differ in more than their axis, and the axis alone brings no improvement.
    assert "neither confirm nor contradict the finding" in second
    assert "garnet red" in third


@pytest.mark.slow
@pytest.mark.parametrize("name", ["satin_rosaline", "golden_yellow"])
def test_a_finer_grid_changes_no_error(calibrated, data_folder, monkeypatch, name):
    """The errors do not depend on the grid at which the table is sampled."""
    coarse = calibrated(name)
    monkeypatch.setattr(measured_brdf, "HALF_ELEVATIONS", 44)
    monkeypatch.setattr(measured_brdf, "HALF_AZIMUTHS", 32)
    fine = calibrate_brdf(read_measured_brdf(data_folder / FILES[name]))
    assert len(fine.measured.values) > 2 * len(coarse.measured.values)
    assert fine.model == coarse.model
    for model in coarse.held_out:
        np.testing.assert_allclose(
            fine.held_out[model].relative, coarse.held_out[model].relative, rtol=0.05
        )
