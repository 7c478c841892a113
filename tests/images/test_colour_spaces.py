"""Tests colour conversions against colour-science, Python's standard library, published pairs and
their own inverses, with finite values at black, white and greys."""

import colorsys
import functools

import colour
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxvision import colour_spaces as cs
from jaxvision import srgb_encode
from jaxvision.colour_spaces import colour_data
from jaxvision.errors import InputError
from jaxvision.point_ops import srgb_decode

RNG = np.random.default_rng(12)
GREYS = [[v, v, v] for v in (0.0, 1e-6, 0.008, 0.2, 1.0)]
PURE = [[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0], [1.0, 1.0, 0], [0, 1.0, 1.0], [1.0, 0, 1.0]]
RGB = np.concatenate([RNG.uniform(size=(40, 3)), GREYS, PURE])
XYZ = np.concatenate([RNG.uniform(size=(40, 3)), 1e-3 * RNG.uniform(size=(20, 3))])
WHITE = np.asarray(colour_data.white_point("D65"))
XY = np.array([0.3127, 0.3290])
SPACES = [
    "sRGB",
    "Adobe RGB (1998)",
    "Display P3",
    "ITU-R BT.2020",
    "ProPhoto RGB",
    "ACES2065-1",
    "ACEScg",
]


@functools.cache
def compiled(function, **options):
    return jax.jit(lambda *x: function(*x, **options))


def run(function, *arrays, **options):
    """Return the result of one compiled call on float64 arrays."""
    return np.asarray(compiled(function, **options)(*map(jnp.asarray, arrays)))


def same(ours, theirs, digits=12):
    theirs = np.asarray(theirs)
    atol = 10.0**-digits * np.abs(theirs).max()
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=atol)


# ------------------------------------------------ matrices


@pytest.mark.sweep
@pytest.mark.parametrize("name", SPACES)
def test_working_spaces_as_colour_science_derives_them(name):
    space = colour.RGB_COLOURSPACES[name].copy()
    space.use_derived_transformation_matrices(True)
    same(run(cs.rgb_to_xyz, RGB, space=name), RGB @ space.matrix_RGB_to_XYZ.T)
    same(run(cs.xyz_to_rgb, XYZ, space=name), XYZ @ space.matrix_XYZ_to_RGB.T)
    same(run(cs.luminance, RGB, space=name), RGB @ space.matrix_RGB_to_XYZ[1])


def test_shipped_data_equal_colour_science():
    at_hand = colour_data._PRIMARIES | colour_data._WHITES | colour_data._CONES | colour_data._LUMA
    assert len(at_hand) == 21
    for name in colour_data._PRIMARIES:
        space = colour.RGB_COLOURSPACES[name]
        derived = colour.normalised_primary_matrix(space.primaries, space.whitepoint)
        np.testing.assert_allclose(colour_data.rgb_to_xyz_matrix(name), derived, atol=1e-15)
    whites = colour.CCS_ILLUMINANTS[colour_data.OBSERVER]
    for name, xy in colour_data._WHITES.items():
        np.testing.assert_array_equal(whites[name], xy)
    for name, cones in colour_data._CONES.items():
        np.testing.assert_array_equal(colour.CHROMATIC_ADAPTATION_TRANSFORMS[name], cones)
    assert colour_data._LUMA.keys() == set(colour.WEIGHTS_YCBCR)
    for name, weights in colour_data._LUMA.items():
        np.testing.assert_array_equal(colour.WEIGHTS_YCBCR[name], weights)


def test_srgb_matrix_as_printed():
    """IEC 61966-2-1 prints four decimals, for a white that it rounds differently."""
    printed = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    np.testing.assert_allclose(colour_data.rgb_to_xyz_matrix("sRGB"), printed, atol=1e-4)


@pytest.mark.parametrize("method", ["Bradford", "CAT02", "Von Kries"])
def test_adaptation_as_colour_science(method):
    warm = np.asarray(colour_data.white_point("A"))
    ours = run(cs.adapt, XYZ, WHITE, warm, method=method)
    theirs = colour.adaptation.chromatic_adaptation_VonKries(XYZ, WHITE, warm, transform=method)
    same(ours, theirs)
    same(run(cs.adapt, WHITE, WHITE, warm, method=method), warm, digits=14)


@pytest.mark.parametrize("adaptation", ["Bradford", None])
def test_change_of_space_as_colour_science(adaptation):
    source, target = (colour.RGB_COLOURSPACES[name].copy() for name in ("sRGB", "ProPhoto RGB"))
    for space in (source, target):
        space.use_derived_transformation_matrices(True)
    ours = run(
        cs.change_rgb_space, RGB, source="sRGB", target="ProPhoto RGB", adaptation=adaptation
    )
    theirs = colour.RGB_to_RGB(RGB, source, target, chromatic_adaptation_transform=adaptation)
    same(ours, theirs)


def test_any_matrix():
    matrix = RNG.normal(size=(3, 3))
    same(run(cs.apply_matrix, RGB.reshape(3, 17, 3), matrix), RGB.reshape(3, 17, 3) @ matrix.T)


# ------------------------------------------------ CIE


def test_chromaticity_as_colour_science():
    same(run(cs.xyz_to_xyy, XYZ), colour.XYZ_to_xyY(XYZ))
    xyy = colour.XYZ_to_xyY(XYZ)
    same(run(cs.xyy_to_xyz, xyy), colour.xyY_to_XYZ(xyy))
    np.testing.assert_array_equal(run(cs.xyz_to_xyy, np.zeros(3)), 0)
    np.testing.assert_array_equal(run(cs.xyy_to_xyz, np.array([0.3, 0.0, 0.5])), 0)


def test_lab_and_luv_as_colour_science():
    """There, as here, the white is derived from its chromaticity."""
    same(run(cs.xyz_to_lab, XYZ, WHITE), colour.XYZ_to_Lab(XYZ, XY))
    same(run(cs.xyz_to_luv, XYZ, WHITE), colour.XYZ_to_Luv(XYZ, XY))
    lab, luv = colour.XYZ_to_Lab(XYZ, XY), colour.XYZ_to_Luv(XYZ, XY)
    same(run(cs.lab_to_xyz, lab, WHITE), colour.Lab_to_XYZ(lab, XY))
    same(run(cs.luv_to_xyz, luv, WHITE), colour.Luv_to_XYZ(luv, XY), digits=10)
    np.testing.assert_array_equal(run(cs.luv_to_xyz, np.zeros(3), WHITE), 0)


def test_lch_as_colour_science():
    lab = colour.XYZ_to_Lab(XYZ, XY)
    theirs = np.asarray(colour.models.Lab_to_LCHab(lab))
    theirs[:, 2] = np.deg2rad(theirs[:, 2])
    same(run(cs.to_lch, lab), theirs)
    same(run(cs.from_lch, theirs), lab)
    np.testing.assert_array_equal(run(cs.to_lch, np.array([50.0, 0, 0])), [50, 0, 0])


# Sharma, Wu, Dalal 2005, table 1: L a b, L a b, difference
SHARMA = np.array(
    [
        [50, 2.6772, -79.7751, 50, 0, -82.7485, 2.0425],
        [50, 3.1571, -77.2803, 50, 0, -82.7485, 2.8615],
        [50, 2.8361, -74.0200, 50, 0, -82.7485, 3.4412],
        [50, -1, 2, 50, 0, 0, 2.3669],
        [50, 2.49, -0.001, 50, -2.49, 0.0009, 7.1792],
        [50, 2.49, -0.001, 50, -2.49, 0.001, 7.1792],
        [50, 2.49, -0.001, 50, -2.49, 0.0011, 7.2195],
        [50, 2.49, -0.001, 50, -2.49, 0.0012, 7.2195],
        [50, -0.001, 2.49, 50, 0.0009, -2.49, 4.8045],
        [50, -0.001, 2.49, 50, 0.001, -2.49, 4.8045],
        [50, -0.001, 2.49, 50, 0.0011, -2.49, 4.7461],
        [50, 2.5, 0, 50, 0, -2.5, 4.3065],
        [50, 2.5, 0, 73, 25, -18, 27.1492],
        [50, 2.5, 0, 58, 24, 15, 19.4535],
        [60.2574, -34.0099, 36.2677, 60.4626, -34.1751, 39.4387, 1.2644],
        [2.0776, 0.0795, -1.1350, 0.9033, -0.0636, -0.5514, 0.9082],
    ]
)


def test_delta_e_2000_as_published():
    ours = run(cs.delta_e_2000, SHARMA[:, :3], SHARMA[:, 3:6])
    np.testing.assert_allclose(ours, SHARMA[:, 6], atol=5e-5)


def test_delta_e_2000_of_exactly_opposite_hues_averages_them():
    """The published formula does so for any hues that differ by exactly 180 degrees."""
    first = np.column_stack([np.full(200, 50.0), RNG.uniform(-60, 60, (200, 2))])
    second = first * [1, -0.5, -0.5]  # the factors are exact
    same(run(cs.delta_e_2000, first, second), [opposite_by_degrees(*one) for one in first])


def opposite_by_degrees(lightness, a, b):
    """Return CIEDE2000 of (L, a, b) and (L, -a / 2, -b / 2) for L = 50, by the paper's
    equations."""
    chroma = 0.75 * np.hypot(a, b)
    g = 0.5 * (1 - np.sqrt(chroma**7 / (chroma**7 + 25.0**7)))
    whole = np.hypot((1 + g) * a, b)
    hue = np.degrees(np.arctan2(b, (1 + g) * a)) % 360
    mean_hue, mean_chroma = hue + (90 if hue < 180 else -90), 0.75 * whole
    cos = {n: np.cos(np.radians(n * mean_hue + off)) for n, off in ((2, 0), (3, 6), (4, -63))}
    t = 1 - 0.17 * np.cos(np.radians(mean_hue - 30)) + 0.24 * cos[2] + 0.32 * cos[3] - 0.2 * cos[4]
    s_c, s_h = 1 + 0.045 * mean_chroma, 1 + 0.015 * mean_chroma * t
    turned = 2 * 30 * np.exp(-(((mean_hue - 275) / 25) ** 2))
    r_t = -2 * np.sqrt(mean_chroma**7 / (mean_chroma**7 + 25.0**7)) * np.sin(np.radians(turned))
    c, h = -0.5 * whole / s_c, 2 * np.sqrt(0.5) * whole * (1 if hue < 180 else -1) / s_h
    return np.sqrt(c * c + h * h + r_t * c * h)


def test_delta_e_as_colour_science():
    first, second = (
        np.concatenate([RNG.uniform([0, -80, -80], [100, 80, 80], size=(200, 3)), [[50, 0, 0]] * 2])
        for _ in range(2)
    )
    second[-1] = [60, 3, -4]
    same(run(cs.delta_e_2000, first, second), colour.delta_E(first, second, method="CIE 2000"))
    same(run(cs.delta_e_76, first, second), colour.delta_E(first, second, method="CIE 1976"))
    same(run(cs.delta_e_2000, second, first), run(cs.delta_e_2000, first, second))


# ------------------------------------------------ hexagons and video


def test_hsv_and_hsl_as_the_standard_library():
    hsv = [colorsys.rgb_to_hsv(*rgb) for rgb in RGB]
    same(run(cs.rgb_to_hsv, RGB), hsv)
    same(run(cs.hsv_to_rgb, np.array(hsv)), RGB)
    hls = np.array([colorsys.rgb_to_hls(*rgb) for rgb in RGB])
    hsl = hls[:, [0, 2, 1]]
    same(run(cs.rgb_to_hsl, RGB), hsl, digits=9)  # near black and white the saturation is 0 / 0
    same(run(cs.hsl_to_rgb, hsl), RGB)
    turned = np.add(hsv, [1.0, 0, 0])
    same(run(cs.hsv_to_rgb, turned), RGB)


@pytest.mark.parametrize("standard", ["ITU-R BT.601", "ITU-R BT.709", "ITU-R BT.2020"])
def test_ycbcr_as_colour_science(standard):
    weights = colour.WEIGHTS_YCBCR[standard]
    for levels, bits in (("full", 8), ("legal", 8), ("legal", 10)):
        legal = levels == "legal"
        options = {"standard": standard, "levels": levels, "bits": bits}
        theirs = colour.RGB_to_YCbCr(RGB, K=weights, out_legal=legal, out_bits=bits)
        same(run(cs.rgb_to_ycbcr, RGB, **options), theirs)
        same(run(cs.ycbcr_to_rgb, np.asarray(theirs), **options), RGB)
    with pytest.raises(ValueError, match=r"levels must be one of full, legal.*'studio'"):
        cs.rgb_to_ycbcr(jnp.asarray(RGB), levels="studio")


# ------------------------------------------------ edges


NEAR = [
    [v * scale for v in colour]
    for scale in (1e-9, 1e-20, 1e-25, 1e-38)
    for colour in ([1, 1, 1], [1, 0, 0], [0, 1, 0], [0.2, 0.5, 1], [0, -1, 1])
]


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [jnp.float16, jnp.bfloat16])
def test_half_precision_is_kept_and_rounds_as_it_can(dtype):
    colour = jnp.asarray([0.1, 0.2, 0.3], dtype)
    for function in (cs.rgb_to_hsv, cs.rgb_to_hsl, cs.xyz_to_xyy, srgb_encode, srgb_decode):
        found, wanted = function(colour), function(colour.astype(jnp.float32))
        assert found.dtype == dtype
        units = 4 * float(jnp.finfo(dtype).eps)
        np.testing.assert_allclose(found.astype(jnp.float32), wanted, rtol=units)


@pytest.mark.parametrize("size", [1e-37, 1e-20, 1.0, 1e38])
def test_hue_and_chromaticity_do_not_depend_on_lightness(size):
    colour = jnp.asarray(size * np.asarray([1.0, 2.0, 3.0]), jnp.float32)
    lightness = float(cs.rgb_to_hsl(colour)[2])
    found = [*cs.rgb_to_hsv(colour)[:2], cs.rgb_to_hsl(colour)[0], *cs.xyz_to_xyy(colour)[:2]]
    np.testing.assert_allclose(found, [7 / 12, 2 / 3, 7 / 12, 1 / 6, 1 / 3], rtol=2e-6)
    np.testing.assert_allclose(lightness, 2 * size, rtol=1e-6)
    white = jnp.asarray([0.9, 1.0, 1.1], jnp.float32)
    luv = cs.xyz_to_luv(colour, white)
    chroma = luv[1:] / (13 * luv[0])  # u' - u'_n and v' - v'_n
    total, total_n = 1 + 15 * 2 + 3 * 3, 0.9 + 15 + 3 * 1.1
    wanted = [4 / total - 4 * 0.9 / total_n, 18 / total - 9 / total_n]
    np.testing.assert_allclose(chroma, wanted, rtol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [jnp.float32, pytest.param(jnp.float64, marks=pytest.mark.slow)])
def test_finite_and_of_one_dtype_at_black_white_and_greys(dtype):
    white = jnp.asarray(WHITE, dtype)
    chain = {
        "lab": lambda x: cs.xyz_to_lab(cs.rgb_to_xyz(x), white),
        "luv": lambda x: cs.xyz_to_luv(cs.rgb_to_xyz(x), white),
        "luv back": lambda x: cs.luv_to_xyz(x * 100, white),
        "lch": lambda x: cs.to_lch(cs.xyz_to_lab(x, jnp.ones_like(white))),
        "exact grey lch": lambda x: cs.to_lch(
            jnp.stack([x[..., 0], 0 * x[..., 1], 0 * x[..., 2]], axis=-1)
        ),
        "xyy": cs.xyz_to_xyy,
        "xyz": cs.xyy_to_xyz,
        "hsv": cs.rgb_to_hsv,
        "hsl": cs.rgb_to_hsl,
        "hsv back": cs.hsv_to_rgb,
        "hsl back": cs.hsl_to_rgb,
        "ycbcr": cs.rgb_to_ycbcr,
        "2000": lambda x: cs.delta_e_2000(x * 100, x[..., ::-1] * 100),
        "2000, equal": lambda x: cs.delta_e_2000(x * 100, x * 100),
        "76, equal": lambda x: cs.delta_e_76(x, x),
        "adapted": lambda x: cs.adapt(x, white, white[::-1]),
    }
    for name, function in chain.items():
        both = jax.jit(lambda x, f=function: (f(x), jax.vmap(jax.grad(lambda c: f(c).sum()))(x)))
        colours = [*GREYS, [2.0, 2.0, 2.0], [-0.1, 0.0, 0.1], *NEAR]
        value, slope = both(jnp.asarray(colours, dtype))
        assert value.dtype == dtype, name
        assert jnp.isfinite(value).all(), name
        assert jnp.isfinite(slope).all(), name


@pytest.mark.slow
def test_hue_stays_below_a_full_turn():
    """A hue just below a full turn must not round to a full turn."""
    rgb, lab = np.float32([[1, 0.5, 0.50000006]]), np.float32([[50, 1, -1e-20]])
    for to, pixel in ((cs.rgb_to_hsv, rgb), (cs.rgb_to_hsl, rgb), (cs.to_lch, lab)):
        hue = compiled(to)(jnp.asarray(pixel))[0, 2 if to is cs.to_lch else 0]
        assert hue == 0
    _, slope = jax.jvp(cs.to_lch, (jnp.asarray(lab),), (jnp.asarray(np.float32([[0, 0, 1]])),))
    np.testing.assert_array_equal(slope[0, 2], 1)


def test_hexagons_are_inverted():
    """This also holds outside [0, 1]. Colours are lost only in the two documented planes."""
    inside, outside = RNG.uniform(size=(51, 3)), RNG.uniform(-1, 2, size=(51, 3))
    dark = 1e-8 * inside[np.ptp(inside, axis=1) > 0.1]  # others count as grey
    for to, back in ((cs.rgb_to_hsv, cs.hsv_to_rgb), (cs.rgb_to_hsl, cs.hsl_to_rgb)):
        there_and_back = compiled(lambda x, to=to, back=back: back(to(x)))
        for colours in (inside, outside):
            same(there_and_back(jnp.asarray(colours)), colours)
        again = there_and_back(jnp.asarray(dark, jnp.float32))
        np.testing.assert_allclose(again, dark, rtol=1e-6, atol=1e-15)
    lost = {cs.rgb_to_hsv: [-0.5, -0.2, 0.0], cs.rgb_to_hsl: [-0.1, 0.0, 0.1]}
    for to, pixel in lost.items():
        assert to(jnp.asarray(pixel))[1] == 0


def test_arrays_without_three_floating_bands_are_refused(as_for_users):
    white = jnp.asarray(WHITE)
    calls = [
        cs.rgb_to_xyz,
        cs.xyz_to_rgb,
        cs.luminance,
        cs.xyz_to_xyy,
        cs.xyy_to_xyz,
        cs.to_lch,
        cs.from_lch,
        cs.rgb_to_hsv,
        cs.hsv_to_rgb,
        cs.rgb_to_hsl,
        cs.hsl_to_rgb,
        cs.rgb_to_ycbcr,
        cs.ycbcr_to_rgb,
        lambda x: cs.apply_matrix(x, jnp.eye(3)),
        lambda x: cs.adapt(x, white, white),
        lambda x: cs.change_rgb_space(x, source="sRGB", target="ACEScg"),
        *(lambda x, f=f: f(x, white) for f in (cs.xyz_to_lab, cs.xyz_to_luv)),
        *(lambda x, f=f: f(x, white) for f in (cs.lab_to_xyz, cs.luv_to_xyz)),
        *(lambda x, f=f: f(x, x) for f in (cs.delta_e_76, cs.delta_e_2000)),
    ]
    for call in calls:
        with pytest.raises(ValueError, match="floating and relative, got uint8; divide by 255"):
            call(jnp.full((2, 3), 200, jnp.uint8))
        for bands in (2, 4):
            with pytest.raises(ValueError, match=rf"a last axis of 3, got shape \(2, {bands}\)"):
                call(jnp.ones((2, bands)))


def test_unknown_names_list_the_known():
    with pytest.raises(InputError, match=r"No RGB space 'scrgb'; the nearest is 'sRGB'\."):
        cs.rgb_to_xyz(jnp.asarray(RGB), space="scrgb")
    with pytest.raises(InputError, match=r"No chromatic adaptation 'x'.*Bradford"):
        cs.adapt(*map(jnp.asarray, (XYZ, WHITE, WHITE)), method="x")
    with pytest.raises(InputError, match=r"No luma standard 'x'.*BT.709"):
        cs.rgb_to_ycbcr(jnp.asarray(RGB), standard="x")


@pytest.mark.sweep
@pytest.mark.parametrize("convert", [cs.xyz_to_lab, cs.xyz_to_luv])
def test_xyz_on_another_scale_than_the_white_is_named(convert):
    """L* is 522 for a white of Y = 1, and at most 9 for one of Y = 100. There is no warning for
    equal scales, for one dark colour, and for a lamp in the picture."""
    with pytest.warns(UserWarning, match=r"Y goes up to 100 beside a white of Y = 1,"):
        convert(100 * jnp.asarray(WHITE), WHITE)
    with pytest.warns(UserWarning, match=r"beside a white of Y = 100,"):
        convert(XYZ, 100 * WHITE)
    for colours, white in ((XYZ, WHITE), (100 * XYZ, 100 * WHITE), (XYZ[:1], 100 * WHITE)):
        convert(colours, white)
    convert(np.concatenate([XYZ, 1000 * XYZ[:1]]), WHITE)
