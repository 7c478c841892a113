"""Tests development from raw to picture step by step, colours against colour-science, and the codes
of files."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxvision import scene as s
from jaxvision.development import (
    camera_colour,
    demosaic,
    develop,
    fit_colour_matrix,
    grey_world_gains,
    jpeg,
    neutral_gains,
    to_integers,
    tone_curve,
    white_balance,
)
from jaxvision.development.demosaicing import METHODS
from jaxvision.filters import bilateral_filter, nonlocal_means_filter, unsharp_mask
from jaxvision.point_ops import lookup, lookup_3d
from jaxvision.sensor.colour_filters import bayer, mosaic

RNG = np.random.default_rng(9)
RAW = jnp.asarray([[54.0, 64.0, 564.0, 1064.0]])
IMAGE = jnp.asarray(RNG.uniform(0.05, 0.95, size=(12, 14, 3)))
GAINS = np.array([1.9, 1.0, 1.4])
MATRIX = np.array([[1.6, -0.4, -0.2], [-0.3, 1.5, -0.2], [0.1, -0.6, 1.5]])

# ---------------------------------------------------------------- levels and curves


@pytest.mark.parametrize(
    ("steps", "expected"),
    [
        ({}, [54, 64, 564, 1064]),
        ({"black_level": 64}, [-10, 0, 500, 1000]),
        ({"white_level": 1064}, [54 / 1064, 64 / 1064, 564 / 1064, 1]),
        ({"black_level": 64, "white_level": 1064}, [-0.01, 0, 0.5, 1]),
        ({"black_level": 64, "white_level": 1064, "tone": s.Gamma(2.0)}, [0, 0, np.sqrt(0.5), 1]),
        # 0.735357 is the sRGB code value of 0.5 (code 188 of 255)
        ({"black_level": 64, "white_level": 1064, "tone": s.SRGB()}, [-0.1292, 0, 0.735357, 1]),
        # Reinhard's equation 4 at 0.5 with white at 2: 0.5 (1 + 0.125) / 1.5
        (
            {"black_level": 64, "white_level": 1064, "tone_map": s.Reinhard(2.0)},
            [-0.01, 0, 0.375, 0.625],
        ),
        # Narkowicz's fraction at 0.5 is 0.6425 / 1.0425, and at 1 it is 2.54 / 3.16
        (
            {"black_level": 64, "white_level": 1064, "tone_map": s.Filmic()},
            [0, 0, 0.6163069544, 0.8037974684],
        ),
    ],
)
def test_levels_and_curves(steps, expected):
    np.testing.assert_allclose(develop(RAW, s.Development(**steps))[0], expected, atol=5e-7)


def test_a_curve_through_points_is_scipys_pchip():
    interpolate = pytest.importorskip("scipy.interpolate")
    x = RNG.uniform(-0.2, 1.5, size=500)
    for inputs, outputs in (
        ([0, 0.1, 0.4, 0.7, 1.0], [0, 0.02, 0.5, 0.9, 1.0]),
        ([0, 0.25, 0.5, 0.75, 1.2], [0, 0.6, 0.55, 0.55, 0.9]),  # not monotone, partly flat
        ([0, 0.1, 0.2], [0.0, 0.5, 0.1]),
        ([0.1, 0.9], [0.2, 0.7]),
    ):
        inputs, outputs = np.array(inputs, float), np.array(outputs, float)
        truth = interpolate.PchipInterpolator(inputs, outputs)(np.clip(x, inputs[0], inputs[-1]))
        ours = jax.jit(tone_curve)(*map(jnp.asarray, (x, inputs, outputs)))
        np.testing.assert_allclose(ours, truth, atol=1e-14)


def test_a_curve_is_monotone_where_its_points_are():
    inputs, outputs = np.sort(RNG.uniform(size=(2, 9)), axis=1)
    x = np.linspace(-0.1, 1.1, 4001)
    curve = jax.jit(tone_curve)
    ours = np.asarray(curve(*map(jnp.asarray, (x, inputs, outputs))))
    assert (np.diff(ours) >= -1e-15).all()
    np.testing.assert_allclose([ours[0], ours[-1]], [outputs[0], outputs[-1]])
    x[5] = np.nan
    again = np.asarray(curve(*map(jnp.asarray, (x, inputs, outputs))))
    assert np.isnan(again[5])
    np.testing.assert_array_equal(np.delete(again, 5), np.delete(ours, 5))


# ---------------------------------------------------------------- white balance


def test_gains_make_a_patch_neutral():
    patch = IMAGE[2:5, 3:9]
    gains = neutral_gains(patch)
    balanced = np.asarray(white_balance(IMAGE, gains))[2:5, 3:9].mean((0, 1))
    np.testing.assert_allclose(balanced, balanced[0], rtol=1e-14)
    np.testing.assert_allclose(gains.min(), 1)
    by_record = s.Development(white_balance=s.NeutralPatch((2, 5), (3, 9)))
    np.testing.assert_allclose(develop(IMAGE, by_record), white_balance(IMAGE, gains))


@pytest.mark.parametrize("norm", [1.0, 6.0, 200.0])
def test_grey_worlds_are_means_of_powers(norm):
    batch = jnp.stack([IMAGE, 7 * IMAGE**2])
    for image, gains in zip(batch, grey_world_gains(batch, norm=norm), strict=True):
        mean = np.mean(np.asarray(image) ** norm, axis=(0, 1)) ** (1 / norm)
        np.testing.assert_allclose(gains, mean.max() / mean, rtol=1e-12)
    if norm == 200:  # nearly the maximum of each band
        largest = np.asarray(IMAGE).max((0, 1))
        np.testing.assert_allclose(gains, (largest.max() / largest) ** 2, rtol=0.05)


def test_a_patch_of_codes_in_half_precision_has_a_mean():
    patch = np.full((9, 9, 3), [30000, 15000, 60000], np.float16)  # their sums are infinite
    np.testing.assert_allclose(neutral_gains(patch), [2, 4, 1], rtol=1e-3)


def test_a_patch_must_lie_in_the_picture_and_hold_numbers():
    patch = s.NeutralPatch((10, 13), (0, 2))
    with pytest.raises(ValueError, match=r"must end by row 12 and column 14 .* got 13 and 2"):
        develop(IMAGE, s.Development(white_balance=patch))
    with pytest.raises(ValueError, match=r"patch must hold a pixel, got shape \(0, 2, 3\)"):
        neutral_gains(IMAGE[20:30, :2])
    grey = jnp.broadcast_to(jnp.asarray([0.2, 0.4, 0.1]), (2, 2, 3))
    np.testing.assert_allclose(neutral_gains(grey.at[0, 0, 0].set(jnp.nan)), [2, 1, 4])
    assert np.isnan(neutral_gains(grey.at[..., 0].set(jnp.nan))).all()


def test_saturated_pixels_are_not_used_for_white_balance():
    burnt = IMAGE.at[:3, :5, 1].set(1.0)  # saturated in one band only
    kept = np.ones((12, 14), bool)
    kept[:3, :5] = False
    mean = np.asarray(IMAGE)[kept].mean(0)
    gains = grey_world_gains(burnt, saturation=0.99)
    np.testing.assert_allclose(gains, mean.max() / mean)


def test_burnt_out_highlights_are_white_not_magenta():
    scene = np.full((4, 6, 3), 0.4) * [1 / 1.9, 1, 1 / 1.4]  # grey in this camera's raw values
    scene[:, 3:] *= 20
    raw = jnp.asarray(np.minimum(scene, 1))
    gains = s.WhiteBalance(GAINS)
    magenta = np.asarray(develop(raw, s.Development(white_balance=gains)))
    white = np.asarray(develop(raw, s.Development(white_balance=gains, saturation=1.0)))
    np.testing.assert_allclose(magenta[0, 5], GAINS)
    np.testing.assert_allclose(white[0, 5], 1)
    np.testing.assert_allclose(white[0, 0], 0.4)


def test_white_balance_refuses_other_bands():
    with pytest.raises(ValueError, match=r"got shape \(2,\)"):
        white_balance(IMAGE, jnp.ones(2))


# ---------------------------------------------------------------- colour


@pytest.fixture(scope="module")
def chart():
    """Return the 24 patches, their illuminant, the observer, and a measured camera."""
    pytest.importorskip("colour")
    from jaxvision.colour_spaces import colour_data

    wavelengths = colour_data.wavelength_grid()
    return {
        "wavelengths": wavelengths,
        "reflectances": colour_data.chart_reflectances(wavelengths),
        "illuminant": colour_data.illuminant("D65", wavelengths),
        "observer": colour_data.observer(wavelengths),
        "sensitivities": colour_data.camera_sensitivities("Nikon 5100 (NPL)", wavelengths),
        "white": colour_data.white_point("D65"),
    }


def raw_of(chart, sensitivities):
    """Return a camera's raw data of the patches, with white at 1000 DN above a black of 64."""
    light = np.asarray(chart["reflectances"]) * np.asarray(chart["illuminant"])
    responses = light @ sensitivities
    white = (np.asarray(chart["illuminant"]) @ sensitivities).max()
    return jnp.asarray(64 + 1000 * responses.reshape(4, 6, 3) / white)


def developed(chart, sensitivities):
    found = jax.jit(camera_colour)(
        jnp.asarray(sensitivities),
        *(chart[k] for k in ("illuminant", "reflectances", "wavelengths", "observer", "white")),
    )
    development = s.Development(
        black_level=64,
        white_level=1064,
        white_balance=s.WhiteBalance(found.gains),
        colour_matrix=found.matrix,
        tone=s.SRGB(),
    )
    return np.asarray(jax.jit(develop)(raw_of(chart, sensitivities), development)), found


def truth_of(chart):
    """Return the 24 patches by colour-science, as (encoded sRGB, Lab)."""
    import colour

    shape = colour.SpectralShape(380, 780, 5)
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(shape)
    light = colour.SDS_ILLUMINANTS["D65"].copy().align(shape)
    patches = colour.SDS_COLOURCHECKERS["ColorChecker N Ohta"].values()
    xyz = [
        colour.sd_to_XYZ(p.copy().align(shape), observer, light, method="Integration") / 100
        for p in patches
    ]
    white = np.sum(light.values[:, None] * observer.values, 0)
    white = white / white[1]
    wanted = np.asarray(chart["white"])
    adapted = [colour.chromatic_adaptation(c, white, wanted, transform="Bradford") for c in xyz]
    return np.asarray(adapted) @ srgb().matrix_XYZ_to_RGB.T, np.asarray(adapted)


def srgb():
    """Return the space with matrices in full precision instead of the standard's four digits."""
    import colour

    space = colour.RGB_COLOURSPACES["sRGB"].copy()
    space.use_derived_transformation_matrices(True)
    return space


def test_colours_of_24_patches_within_1e_4_of_colour_science(chart):
    """The camera has the observer's sensitivities, and its raw data pass through every stage."""
    import colour

    linear, _ = truth_of(chart)
    picture, _ = developed(chart, np.asarray(chart["observer"]))
    encoded = np.where(linear > 0, colour.cctf_encoding(np.maximum(linear, 0)), 12.92 * linear)
    assert np.abs(picture.reshape(24, 3) - encoded).max() < 1e-4


def test_delta_e_of_the_matrix_fitted_to_a_measured_camera(chart):
    """A real camera differs from the observer. Its matrix brings the chart to a mean CIEDE2000 of 1
    to 2, as is usual for DSLRs, far below the error of the camera's own RGB."""
    import colour

    _, adapted = truth_of(chart)
    picture, found = developed(chart, np.asarray(chart["sensitivities"]))
    white = np.asarray(chart["white"])
    linear = colour.cctf_decoding(picture.reshape(24, 3))

    def difference(rgb):
        xy = white[:2] / white.sum()
        labs = [colour.XYZ_to_Lab(c, xy) for c in (rgb @ srgb().matrix_RGB_to_XYZ.T, adapted)]
        return colour.delta_E(*labs, method="CIE 2000")

    fitted = difference(linear)
    unmatched = difference(linear @ np.linalg.inv(np.asarray(found.matrix)).T)
    print(f"Delta E 2000: mean {fitted.mean():.3f}, largest {fitted.max():.3f}", end=" ")
    print(f"(without the matrix {unmatched.mean():.2f})")
    assert fitted.mean() < 1.5
    assert unmatched.mean() > 4 * fitted.mean()
    np.testing.assert_allclose(found.matrix.sum(1), 1, atol=1e-3)  # white is preserved
    np.testing.assert_allclose(picture[3, 0], picture[3, 0].mean(), atol=0.01)  # the white patch


def test_least_squares_are_numpys_and_colour_sciences():
    colour = pytest.importorskip("colour")
    camera, wanted = RNG.uniform(0.1, 0.9, size=(2, 24, 3))
    ours = fit_colour_matrix(jnp.asarray(camera), jnp.asarray(wanted))
    np.testing.assert_allclose(ours, np.linalg.lstsq(camera, wanted)[0].T, atol=1e-12)
    peer = colour.characterisation.matrix_colour_correction_Cheung2004(camera, wanted, terms=3)
    np.testing.assert_allclose(ours, peer, atol=1e-12)


@pytest.mark.parametrize("weighted", [False, True])
def test_the_constrained_fit_preserves_white_and_is_optimal(weighted):
    """The reference solves the equations of Lagrange as one linear system."""
    camera, wanted = RNG.uniform(0.1, 0.9, size=(2, 24, 3))
    seen, sought = np.array([0.8, 1.0, 0.7]), np.array([1.0, 1.0, 1.0])
    weights = RNG.uniform(0, 2, size=24) if weighted else np.ones(24)
    ours = fit_colour_matrix(
        jnp.asarray(camera),
        jnp.asarray(wanted),
        white=(jnp.asarray(seen), jnp.asarray(sought)),
        weights=jnp.asarray(weights) if weighted else None,
    )
    np.testing.assert_allclose(ours @ seen, sought, rtol=1e-14)
    gram = camera.T @ (weights[:, None] * camera)
    system = np.block([[gram, seen[:, None]], [seen[None], np.zeros((1, 1))]])
    sides = np.vstack([camera.T @ (weights[:, None] * wanted), sought[None]])
    np.testing.assert_allclose(ours, np.linalg.solve(system, sides)[:3].T, atol=1e-12)


def test_too_few_patches_are_refused():
    with pytest.raises(ValueError, match="at least 3 patches"):
        fit_colour_matrix(jnp.ones((2, 3)), jnp.ones((2, 3)))


GREYS = np.outer([0.1, 0.5, 0.9, 0.3], np.ones(3))
ONES = np.ones(3)


@pytest.mark.parametrize(
    ("camera", "options", "message"),
    [
        (np.eye(3), {"weights": -ONES}, "weights must be finite, at least 0, got -1"),
        (np.eye(3), {"weights": [1.0, 1.0, 0.0]}, "must span 3 dimensions.* raise weights"),
        (np.eye(3), {"white": (0 * ONES, ONES)}, "camera's white must have a direction"),
        (GREYS, {"white": (ONES, ONES)}, "must span 2 dimensions beside white"),
        (np.r_[GREYS, [[1, 0, 0]]], {"white": (ONES, ONES)}, "must span 2 dimensions beside white"),
    ],
)
def test_colours_that_do_not_determine_the_matrix_are_refused(camera, options, message):
    with pytest.raises(ValueError, match=message):
        fit_colour_matrix(camera, camera, **options)


# ---------------------------------------------------------------- all of it


@pytest.mark.slow
def test_the_stages_come_in_the_order_that_is_stated():
    """The reference applies the function of each stage in the stated order. No two of them
    commute."""
    raw = 64 + 1000 * mosaic(IMAGE, bayer("GRBG"))
    development = s.Development(
        black_level=64,
        white_level=1064,
        demosaicing=s.Demosaicing(bayer("GRBG"), method="bilinear"),
        white_balance=s.WhiteBalance(GAINS),
        saturation=1.0,
        denoising=s.Bilateral(1.0, 0.2, radius=2),
        colour_matrix=MATRIX,
        tone_map=s.ToneCurve([0.0, 0.5, 1.0], [0.0, 0.6, 0.95]),
        tone=s.Gamma(2.2),
        sharpening=s.UnsharpMask(1.0, 0.7, size=5),
        compression=s.JPEG(85.0, subsampling="4:4:4"),
    )
    picture = demosaic((raw - 64) / 1000, bayer("GRBG"), method="bilinear")
    picture = jnp.minimum(picture * GAINS.reshape(1, 1, 3), 1.0)
    picture = bilateral_filter(picture, 1.0, 0.2, radius=2)
    picture = jnp.einsum("ij,yxj->yxi", MATRIX, picture)
    picture = tone_curve(picture, jnp.asarray([0.0, 0.5, 1.0]), jnp.asarray([0.0, 0.6, 0.95]))
    picture = jnp.maximum(picture, 0) ** (1 / 2.2)
    picture = unsharp_mask(picture, 1.0, 0.7, size=5)
    picture = jpeg(picture, 85.0, subsampling="4:4:4")
    np.testing.assert_allclose(jax.jit(develop)(raw, development), picture, atol=1e-12)


def test_a_mosaic_as_a_sensor_gives_it_has_one_band():
    development = s.Development(demosaicing=s.Demosaicing(bayer("GRBG")))
    raw = mosaic(IMAGE, bayer("GRBG"))
    expected = demosaic(raw, bayer("GRBG"))
    np.testing.assert_array_equal(develop(raw[..., None], development), expected)
    batch = develop(jnp.stack([raw, raw])[..., None], development)
    np.testing.assert_array_equal(batch, jnp.stack([expected, expected]))


def test_other_denoising():
    development = s.Development(denoising=s.NonLocalMeans(0.2, 0.05, patch=3, radius=2))
    direct = nonlocal_means_filter(IMAGE, 0.2, noise=0.05, patch=3, radius=2)
    np.testing.assert_allclose(develop(IMAGE, development), direct)


def test_an_absent_stage_changes_nothing():
    def operations(**stages):
        jaxpr = jax.make_jaxpr(partial(develop, development=s.Development(**stages)))(IMAGE)
        return [equation.primitive.name for equation in jaxpr.eqns]

    assert operations() == []
    assert operations(black_level=1.0) == ["sub"]
    assert "pow" not in str(operations(white_balance=s.WhiteBalance(GAINS)))


def test_one_compilation_serves_every_number():
    traced = []

    @jax.jit
    def compiled(development):
        traced.append(1)
        return develop(IMAGE, development)

    for black in (60.0, 70.0):
        development = s.Development(
            black_level=black, white_balance=s.WhiteBalance(GAINS + black), tone=s.Gamma(black)
        )
        compiled(development)
    assert len(traced) == 1


# ---------------------------------------------------------------- integers


def test_integers():
    x = jnp.asarray([-0.5, 0.0, 0.5 / 255, 1.2 / 255, 1.0, 7.0, np.nan])
    codes = to_integers(x)
    assert codes.dtype == jnp.uint8
    np.testing.assert_array_equal(codes, [0, 0, 0, 1, 255, 255, 0])
    deep = to_integers(jnp.asarray([0.5, 1.0], jnp.float32), bits=16)
    assert deep.dtype == jnp.uint16
    np.testing.assert_array_equal(deep, [32768, 65535])


def test_every_code_survives_a_round_trip():
    for bits in (8, 16):
        codes = np.arange(2**bits)
        back = to_integers(jnp.asarray(codes / (2**bits - 1), jnp.float32), bits=bits)
        np.testing.assert_array_equal(back, codes)


def test_a_record_names_the_methods_there_are():
    assert tuple(METHODS) == s.developments.DEMOSAICINGS


def test_codes_are_refused_where_relative_numbers_are_expected():
    """If they were clipped at 1, all of them would be white."""
    with pytest.raises(ValueError, match="whole numbers up to 240: divide the codes"):
        to_integers(np.arange(0.0, 255, 15))
    codes = np.arange(0.0, 256, 15).reshape(6, 3)
    for table in (jnp.linspace(0, 1, 4), jnp.zeros((2, 2, 2, 3))):
        call = lookup if table.ndim == 1 else lookup_3d
        with pytest.raises(ValueError, match="whole numbers up to 255: divide the codes"):
            call(codes, table)


def test_other_depths_are_refused():
    with pytest.raises(ValueError, match="bits must be 8 or 16, got 12"):
        to_integers(RAW, bits=12)


@pytest.mark.parametrize(
    ("record", "message"),
    [
        (lambda: s.Gamma(0.0), r"Gamma\.gamma must be .*above 0.* got 0"),
        (lambda: s.JPEG(0.0), r"JPEG\.quality .* got 0"),
        (lambda: s.JPEG(101.0), r"JPEG\.quality .* at most 100, got 101"),
        (lambda: s.WhiteBalance([1.0, -2.0, 1.0]), r"WhiteBalance\.gains .* got -2"),
        (lambda: s.GreyWorld(0.5), r"GreyWorld\.norm .* at least 1, got 0\.5"),
        (lambda: s.NeutralPatch((4, 4), (0, 5)), r"NeutralPatch\.rows"),
        (lambda: s.ToneCurve([0.0, 0.5, 0.5], [0.0, 0.5, 1.0]), r"ToneCurve\.inputs .* ascend"),
        (lambda: s.ToneCurve([0.0, 1.0], [0.0, 0.5, 1.0]), r"ToneCurve\.outputs must have shape"),
        (
            lambda: s.Development(black_level=70, white_level=64),
            r"white_level must be .* above 70, got 64",
        ),
        (lambda: s.Development(colour_matrix=np.eye(4)), r"colour_matrix must have shape \(3, 3\)"),
        (lambda: s.Development(colour_matrix=np.full((3, 3), np.inf)), r"colour_matrix .*finite"),
        (lambda: s.Development(white_level=0.0), r"white_level must be .* above 0, got 0"),
        (lambda: s.Development(white_level=np.nan), r"white_level must be finite, .* got nan"),
        (lambda: s.Development(black_level=np.nan), r"black_level must be finite, got nan"),
        (
            lambda: s.Development(saturation=0.0, white_balance=s.GreyWorld()),
            r"saturation must be finite, above 0, got 0",
        ),
        (lambda: s.Development(saturation=1.0), r"white_balance must be given with saturation"),
        (lambda: s.Demosaicing(((0, 1), (1,))), r"Demosaicing\.pattern must be rows of one"),
        (lambda: s.Demosaicing(bayer("RGGB"), method="malver"), r"method must be one of .*malvar"),
        (lambda: s.JPEG(50, subsampling="4:2:1"), r"subsampling must be one of .* got '4:2:1'"),
        (lambda: s.JPEG(50, rounding="down"), r"rounding must be one of .* got 'down'"),
        (lambda: s.UnsharpMask(-1.0, 1.0), r"UnsharpMask\.sigma must be .*above 0, got -1"),
        (lambda: s.UnsharpMask(1.0, 1.0, size=8), r"size must be an odd number .* got 8"),
        (lambda: s.Bilateral(0.0, 0.1), r"Bilateral\.sigma_space must be .*above 0, got 0"),
        (lambda: s.NonLocalMeans(0.1, patch=4), r"patch must be an odd number .* got 4"),
        (lambda: s.NonLocalMeans(0.1, -0.1), r"NonLocalMeans\.noise must be .* got -0\.1"),
        (lambda: s.ToneCurve([0.0], [0.0]), r"number of ToneCurve\.inputs .* at least 2, got 1"),
        (lambda: s.ToneCurve([0.0, 1.0], [0.0, np.nan]), r"ToneCurve\.outputs .* got nan"),
    ],
)
def test_records_refuse_invalid_values(record, message):
    with pytest.raises(ValueError, match=message):
        record()


@pytest.mark.parametrize("inputs", [[0.0, 1.0, 0.5], [0.0, 0.5, 0.5], [0.0, np.nan, 1.0]])
def test_a_curve_through_points_in_no_order_is_refused(inputs):
    with pytest.raises(ValueError, match="inputs must ascend"):
        tone_curve(np.float32(0.3), inputs, [0.0, 0.5, 1.0])
