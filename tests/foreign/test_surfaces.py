"""Tests surfaces of other sources: a retro-reflector, published files with few angles, rigs of grey
images, images that do not belong. Files are written in the Cornell text format, and reference
values are closed forms."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import joint, reflectance
from fitting.checks.joint import Lab, photographed
from fitting.checks.reflectance import Sphere
from fitting.inference.estimates import find
from fitting.joint.findings import GIVEN, darker_than_darks, findings, gains_disagree
from fitting.reflectance import from_files
from fitting.reflectance.from_files.calibration import albedo
from fitting.reflectance.from_files.fit import LobeFit, ModelFit
from fitting.reflectance.from_files.read import from_samples, read_measured_brdf
from fitting.reflectance.from_files.section import section
from fitting.reflectance.from_images import findings as of_images
from fitting.reflectance.from_images.section import section as images_section
from fitting.reflectance.from_images.shading_check import drop_strangers
from fitting.report.sentences import evaluate_findings
from fitting.rig import Camera, Light, SphereGeometry
from jaxvision.brdf.measured import BRDFSamples
from jaxvision.errors import InputError

VIEWERS = np.radians(np.arange(2.0, 85, 4))
AZIMUTHS = np.radians(np.arange(0.0, 181, 30))


def direction(theta, phi):
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)


def sections(path, incidences, reflectance, noise=0.0):
    """Write samples around each incidence, and one towards the light, as grey values in a text
    file."""
    rows = [(i, o, p) for i in np.radians(incidences) for o in VIEWERS for p in AZIMUTHS]
    rows += [(i, i, 0.0) for i in np.radians(incidences)]
    theta_i, theta_o, phi = np.array(rows).T
    wi, wo = direction(theta_i, 0 * phi), direction(theta_o, phi)
    values = reflectance(wi, wo) * (1 + noise * np.random.default_rng(0).normal(size=len(rows)))
    lines = ["1", "550"] + [
        f"{a:.8f} 0 {b:.8f} {c:.8f} {v:.8g}"
        for a, b, c, v in zip(theta_i, theta_o, phi, values, strict=True)
    ]
    path.write_text("\n".join(lines) + "\n")
    return section(from_files.calibrate(read_measured_brdf(path)))


def retro(wi, wo):
    """Return .3, and 50 within a degree of the light."""
    between = 2 * np.arcsin(np.linalg.norm(wi - wo, axis=-1) / 2)
    return 0.3 + 50 * np.exp(-((between / np.radians(1)) ** 2))


@pytest.mark.slow
def test_a_retro_reflector_is_identified_and_no_model_describes_it(tmp_path):
    told = sections(tmp_path / "retro.brdf", [5, 15, 25, 35, 45, 55, 65], retro).findings
    assert told[0].startswith("No model here describes this file")
    assert any("impossible" in s and "no albedo exceeds 1" in s for s in told)
    assert any("toward the light at 6 of 6 oblique incidences" in s for s in told)


@pytest.mark.slow
def test_three_incidences_are_fitted_with_wide_intervals(tmp_path):
    found = sections(tmp_path / "matt.brdf", [10, 40, 70], lambda wi, wo: 0.2 + 0 * wi[:, 0], 0.05)
    assert not any("No model here" in s or "impossible" in s for s in found.findings)
    diffuse = find(found.estimates, "diffuse")
    low, high = diffuse.interval_95
    assert low < 0.2 < high
    alone = 0.05 * 0.2 / np.sqrt(3 * (len(VIEWERS) * len(AZIMUTHS) + 1))
    assert high - low > 2 * 1.96 * alone  # wider than intervals from independent noise


def glossy(wi, wo):
    """Return a normalised Phong BRDF with .1, .5 and exponent 40."""
    cosine = np.maximum(np.sum(wi * [-1, -1, 1] * wo, axis=-1), 0)
    return 0.1 + 0.5 * 42 / (2 * np.pi) * cosine**40


@pytest.mark.slow
def test_three_incidences_fit_as_many_parameters(tmp_path):
    found = sections(tmp_path / "gloss.brdf", [10, 40, 70], glossy, 0.01).estimates
    for name, truth in (("diffuse", 0.1), ("specular", 0.5), ("exponent", 40)):
        low, high = find(found, name).interval_95
        assert low - 0.5 * (high - low) < truth < high + 0.5 * (high - low)
        assert high - low < 0.05 * truth


@pytest.mark.parametrize(
    ("spoil", "gone"),
    [
        (lambda values: np.minimum(values, 1.5), lambda exact: exact >= 1.5),
        (lambda values: np.round(values, 1), None),
        (lambda values: np.where(values > 0.11, 0.11, 0.10), None),
        (lambda values: values, None),
    ],
    ids=["clipped", "rounded", "flat", "exact"],
)
def test_samples_that_share_the_largest_value_are_clipped(spoil, gone):
    theta_i, theta_o, phi = (
        axis.ravel() for axis in np.meshgrid(np.radians([10, 25, 40, 55]), VIEWERS, AZIMUTHS)
    )
    exact = glossy(direction(theta_i, 0 * phi), direction(theta_o, phi + np.pi))
    samples = BRDFSamples(theta_i, 0 * phi, theta_o, phi + np.pi, spoil(exact)[:, None], None)
    read = from_samples("gloss", samples, weights=np.ones(len(phi)))
    left_out = np.count_nonzero(gone(exact)) if gone else 0
    assert len(read.values) == len(exact) - left_out
    assert (left_out > 0) == any("clipped, and were left out" in s for s in read.findings)


@pytest.mark.parametrize(
    ("model", "diffuse", "specular", "shape", "expected"),
    [
        ("lambert", 0.9, 0.0, None, 0.9 * np.pi),
        # The lobe (n + 2) / (2 pi) cos^n about the normal integrates with the cosine to 1.
        ("normalised-phong", 0.1, 0.5, 200.0, 0.1 * np.pi + 0.5),
        ("torrance-sparrow-metal", 0.0, 1.0, 0.02, 1.0),
    ],
)
def test_the_albedo_of_a_fit_is_the_integral_over_the_hemisphere(
    model, diffuse, specular, shape, expected
):
    one = np.ones(1)
    whole = LobeFit(model, diffuse * one, specular * one, shape, one[:, None], 0.0, True)
    found = albedo(ModelFit(model, "cosine", whole, ()), 1.5)
    np.testing.assert_allclose(found, expected, rtol=5e-3)


def test_the_intensity_of_a_grey_light_is_one_number():
    """This is how files of grey photographs state it."""
    light = Light(file="a.png", direction=(0.0, 0.0, 1.0), intensity=1.5776)
    assert light.intensity == (1.5776,)


ROWS, COLUMNS = np.mgrid[:24, :24]
X, Y = (COLUMNS - 11.5) / 12, (11.5 - ROWS) / 12
INSIDE = np.hypot(X, Y) < 0.95
BALL = np.stack([X, Y, np.sqrt(np.maximum(1 - X**2 - Y**2, 0))], axis=-1) * INSIDE[..., None]
TURNS = 2 * np.pi * np.arange(6) / 6
AROUND = np.stack([0.5 * np.cos(TURNS), 0.5 * np.sin(TURNS), np.full(6, np.sqrt(0.75))], axis=1)


def matt_ball(**options):
    """Return photographs of a matte ball of 500 DN, in linear DN."""
    shading = np.maximum(np.einsum("hwc,lc->lhw", BALL, AROUND), 0)
    images = np.round(60 + 500 * shading + np.random.default_rng(0).normal(0, 1, shading.shape))
    settings = {"camera": Camera(bits=12, black_level=60.0), "normals": BALL} | options
    return reflectance.from_photographs(list(images), AROUND, **settings)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"intensity_sd": 5.0}, r"intensity_sd = 5 is relative: give 0\.05 for 5 %"),
        ({"exposure_sd": 2.0}, r"exposure_sd = 2 is relative: give 0\.02 for 2 %"),
        ({"normals": BALL * [1, 1, -1]}, "normals point away from the camera"),
    ],
)
def test_impossible_rigs_are_refused_in_one_sentence(options, said):
    with pytest.raises(InputError, match=said):
        matt_ball(**options)


def test_a_mask_that_excludes_nothing_is_named():
    assert not any("no effect" in sentence for sentence in matt_ball(mask=INSIDE).findings)
    sphere = SphereGeometry(centre=(11.5, 11.5), radius=12.0)
    seen = matt_ball(mask=np.ones((24, 24), bool), sphere=sphere, normals=None)
    assert any("leaves out no pixel; it has no effect" in sentence for sentence in seen.findings)


def with_darks(black):
    """Return a matte ball of 500 DN over a black level of 60, its flats, and darks of another black
    level."""
    rng = np.random.default_rng(2)

    def camera(electrons, black=60.0):
        counts = rng.poisson(electrons) + 3 * rng.normal(size=electrons.shape)
        return np.round(black + 0.5 * counts)

    around = 2 * np.pi * np.arange(8) / 8
    lights = np.stack([0.8 * np.cos(around), 0.8 * np.sin(around), np.full(8, 0.6)], axis=1)
    shading = np.maximum(np.einsum("hwc,lc->lhw", BALL, lights), 0)
    flats = [[camera(np.full((24, 24), level)) for _ in range(3)] for level in (200.0, 1000.0)]
    darks = [[camera(np.zeros((24, 24)), black) for _ in range(4)]]
    return joint.from_photographs(
        [camera(1000 * image) for image in shading],
        lights,
        camera=Camera(bits=12),
        normals=BALL,
        flats=flats,
        darks=darks,
    )


def test_darks_brighter_than_the_shadows_are_named():
    row = [finding for finding in GIVEN if finding.key == "darker than darks"]
    (told,) = evaluate_findings(row, SimpleNamespace(observation=with_darks(70.0)))
    assert "10.0 DN less than the darks (70.0 DN)" in told
    assert not darker_than_darks(with_darks(60.0))
    assert not darker_than_darks(with_darks(50.0))  # stray light is possible


@pytest.mark.slow
def test_values_from_darks_are_not_called_assumed_or_stated():
    told = " ".join(findings(joint.calibrate(with_darks(60.0), model="lambert")))
    assert "was assumed" not in told
    assert "those that the rig states;" not in told
    assert "or flats and darks" not in told  # which are given


@pytest.mark.parametrize(("gain", "named"), [(0.5, False), (1.0, True)])
def test_flats_of_another_gain_than_the_images_are_named(gain, named):
    rng, freedom = np.random.default_rng(3), np.full(40, 29.0)
    mean = np.linspace(70.0, 1000.0, 40)
    variance = (2 + 0.5 * (mean - 60)) * rng.chisquare(freedom) / freedom
    cells = SimpleNamespace(count=freedom + 1, mean=mean, scatter=variance * freedom)
    level = np.array([60.0, 200.0, 800.0])
    frames = SimpleNamespace(
        mean=level, variance=2 + gain * (level - 60), freedom=np.full(3, 1000.0)
    )
    fit = SimpleNamespace(data=SimpleNamespace(cells=cells, levels=frames))
    assert bool(gains_disagree(fit, None)) == named
    fit.data.levels = None
    assert bool(gains_disagree(fit, gain)) == named
    assert not gains_disagree(fit, None)


def black(dn):
    dn[:, 4] = 64


def unlit(dn):
    dn[:, 4] = 64 + np.random.default_rng(5).normal(0, 1.25, dn[:, 4].shape)


def saturated(dn):
    dn[:, 4] = 2**14


def copied(dn):
    dn[:, 4] = dn[:, 9]


def swapped(dn):
    dn[:, [4, 9]] = dn[:, [9, 4]]


def brighter(dn):
    dn[:, 6] = 64 + 1.3 * (dn[:, 6] - 64)


def of_fewer_bits(dn):
    dn[:, 3] = np.round(dn[:, 3] / 4)  # also in a held-out light


STRANGERS = [
    (brighter, {6: "it is 1.3 times as bright as the other images"}),
    (of_fewer_bits, {3: "times as bright as the other images"}),
    (black, {4: "is dark"}),
    (unlit, {4: "is dark"}),
    (saturated, {4: "is saturated"}),
    (copied, {4: "is a copy"}),
    (swapped, {4: "its shading shows", 9: "its shading shows"}),
    (lambda dn: None, {}),
]


@pytest.mark.parametrize(("spoil", "reasons"), STRANGERS)
def test_images_that_do_not_belong_are_named_and_left_out(spoil, reasons):
    exact = photographed(Lab(Sphere(), gamma=1.0), 3)
    dn = exact.dn.copy()
    spoil(dn)
    left = drop_strangers(replace(exact, dn=dn))
    gone = [name for name in exact.files if name not in left.files]
    assert gone == [exact.files[i] for i in reasons]
    for sentence, (i, why) in zip(left.findings, reasons.items(), strict=False):
        assert sentence.startswith(f"{exact.files[i]} was left out")
        assert why in sentence
    kept = [i for i in range(len(exact.files)) if i not in reasons]
    np.testing.assert_array_equal(left.dn, dn[:, kept])
    np.testing.assert_array_equal(left.wi, exact.wi[kept])


@pytest.mark.parametrize("level", [64, 2**14 - 1])
def test_dead_and_hot_pixels_are_named_and_left_out(level):
    """With hot pixels in 1 % of the image, the diffuse term was .423 (.407 to .439) instead of
    .4."""
    exact = photographed(Lab(Sphere(), gamma=1.0), 3)
    facing = np.flatnonzero(exact.cosine.max(axis=0) > 0.9)[::20]
    assert drop_strangers(exact).dn.shape == exact.dn.shape
    dn = exact.dn.copy()
    dn[..., facing] = level
    left = drop_strangers(replace(exact, dn=dn))
    assert left.findings[0].startswith(f"{len(facing)} pixels of the object read the same under")
    np.testing.assert_array_equal(left.dn, np.delete(exact.dn, facing, axis=2))
    np.testing.assert_array_equal(left.normals, np.delete(exact.normals, facing, axis=0))


def test_no_image_is_left_out_if_most_do_not_belong():
    exact = photographed(Lab(Sphere(), gamma=1.0), 3)
    dn = exact.dn.copy()
    dn[:, :8] = 64
    assert drop_strangers(replace(exact, dn=dn)).files == exact.files


@pytest.mark.slow
def test_two_exchanged_images_hardly_change_the_result():
    exact = photographed(Lab(Sphere(), gamma=1.0), 3)
    dn = exact.dn.copy()
    swapped(dn)
    found = reflectance.calibrate(replace(exact, dn=dn), model="phong")
    told = images_section(found)
    assert sum("was left out" in sentence for sentence in told.findings) == 2
    for name, value in zip(("diffuse", "specular", "exponent"), Sphere().truth, strict=True):
        low, high = find(told.estimates, name).interval_95
        assert low - 0.5 * (high - low) < value < high + 0.5 * (high - low)


def cornell_samples(change):
    """Return samples of a Phong lobe over a matte body at six incidences and six view angles, after
    a change by a function of (values, zenith angles of light and viewer)."""
    light, viewer, turn = (
        x.ravel()
        for x in np.meshgrid(
            np.radians([5, 20, 35, 50, 65, 80]),
            np.radians([5, 20, 35, 50, 65, 80]),
            np.radians(np.arange(0, 181, 20)),
            indexing="ij",
        )
    )
    cosine = np.cos(light) * np.cos(viewer) - np.sin(light) * np.sin(viewer) * np.cos(turn)
    lobe = 0.1 + 0.3 * np.clip(cosine, 0, 1) ** 20
    values = lobe[:, None] * np.array([1.0, 0.9, 0.8])
    rng = np.random.default_rng(1)
    values = change(values * rng.normal(1, 0.02, values.shape), light, viewer)
    return from_samples(
        "changed",
        BRDFSamples(light, np.zeros_like(light), viewer, turn, values, None),
        weights=np.ones(len(light)),
    )


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda f, i, o: f * np.cos(o)[:, None], "as the viewer's cosine does"),
        (lambda f, i, o: f * np.cos(i)[:, None], "as the light's cosine does"),
        (lambda f, i, o: f * np.where(i[:, None] > 0.7, [1, 1, 0], 1), "is not: blue, in 50 %"),
        (lambda f, i, o: f, None),
    ],
)
def test_values_that_are_not_a_brdf_are_named(change, said):
    found = cornell_samples(change).findings
    assert len(found) == (said is not None)
    assert said is None or said in found[0]


def test_elevations_and_wavelengths_in_micrometres_are_named(tmp_path):
    rows = [
        f"{i:.6f} 0 {o:.6f} {p:.6f} 0.1"
        for i in np.radians([10, 30, 50, 90])
        for o in VIEWERS
        for p in AZIMUTHS
    ]
    file = tmp_path / "elevation.brdf"
    file.write_text("\n".join(["1", "550", *rows]))
    assert any("1 of 4 angles of incidence" in one for one in read_measured_brdf(file).findings)
    file.write_text("\n".join(["1", "0.55", *rows]))
    with pytest.raises(InputError, match=r"up to 0\.55 nm are X-rays"):
        read_measured_brdf(file)


@pytest.mark.slow
def test_a_surface_darker_than_velvet_is_named():
    found = cornell_samples(lambda f, i, o: f / 1500)
    calibration = from_files.calibrate(found, model="lambert")
    assert any("less than that of black velvet" in one for one in section(calibration).findings)


@pytest.mark.parametrize(("factors", "told"), [(0.12, True), (0.01, False)])
def test_images_of_different_brightness_are_named(monkeypatch, factors, told):
    """One factor for each image explains a misfit of a tenth, or hardly any of it."""
    each = factors * np.array([1.0, -1.0, 0.9, -1.1, 1.2, -1.0])
    monkeypatch.setattr(of_images, "residual_of_images", lambda calibration: each)
    misfit = SimpleNamespace(spread=SimpleNamespace(relative=0.12))
    found = of_images._brightness(SimpleNamespace(chosen_fits=[misfit]))
    assert (found is not None) == told
    if told:
        assert found["share"].startswith("12")


@pytest.mark.parametrize(
    ("level", "noise", "said"),
    [
        (0.0, 0.0, "5400 of 5400 readings are at or below lowest = 0"),
        (0.0, 2.0, "scatter evenly about"),
        (100.0, 0.0, None),
    ],
)
def test_identical_images_give_no_normals(level, noise, said):
    turns = np.radians(np.arange(6) * 60)
    lights = direction(np.full(6, np.radians(30)), turns)
    images = level + np.random.default_rng(0).normal(0, noise, (6, 30, 30))
    found = reflectance.photometric_stereo(images, lights)
    assert any("No pixel has a normal" in sentence for sentence in found.findings) == bool(said)
    assert said is None or (said in str(found) and np.isnan(found.albedo).all())
