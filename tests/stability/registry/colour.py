"""Oracles for colour spaces. Differences of nearly equal parts (a*, b*, u*, v* near grey, hues near
a discontinuity) are measured relative to their condition number. Lightness is not, because it is
accurate down to black."""

import jax.numpy as jnp
import numpy as np

from jaxvision import colour_spaces as cs
from jaxvision.colour_spaces import colour_data

from .entry import FRACTION, RELATIVE, Columns, Entry, Range

WHITE = np.array([0.95045, 1.0, 1.08906], np.float32).astype(np.float64)
COLOURS = Columns(RELATIVE)
XYZ = Columns(Range(1e-9, 1.0))
GREYS = tuple((s * WHITE,) for s in (1e-10, 1e-7, 0.00885, 0.00886, 0.18, 1.0))
COLOURED = ((np.array([1e-7, 1e-9, 1e-8]),), (np.array([0.2, 0.1, 0.05]),))


def lightness(m, t):
    root = m.cbrt(t)
    return m.where(t > m.c("216") / m.c("24389"), root, t * m.c("841") / 108 + m.c("4") / 29)


def l_star(m, t):
    """Return 116 f - 16, which is 24389 / 27 t for a dark colour."""
    dark = t <= m.c("216") / m.c("24389")
    return m.where(dark, t * m.c("24389") / 27, 116 * m.cbrt(t) - 16)


def white(m):
    return m.array(WHITE)


def lab(m, xyz):
    x, y, z = (xyz[:, i] / white(m)[i] for i in range(3))
    fx, fy, fz = (lightness(m, v) for v in (x, y, z))
    return l_star(m, y), 500 * (fx - fy), 200 * (fy - fz)


def back(m, f):
    """Return t from f - 4/29."""
    root = f + m.c("4") / 29
    return m.where(root > m.c("6") / 29, root**3, 3 * (m.c("6") / 29) ** 2 * f)


def from_lab(m, c):
    f = c[:, 0] / 116
    parts = (f + c[:, 1] / 500, f, f - c[:, 2] / 200)
    return tuple(white(m)[i] * back(m, part) for i, part in enumerate(parts))


def luv(m, c):
    (x, y, z), (xn, yn, zn) = c.T, white(m)
    d, dn = x + 15 * y + 3 * z, xn + 15 * yn + 3 * zn
    star = l_star(m, y / yn)
    return star, 13 * star * (4 * x / d - 4 * xn / dn), 13 * star * (9 * y / d - 9 * yn / dn)


def from_luv(m, c):
    (star, u, v), (xn, yn, zn) = c.T, white(m)
    dn = xn + 15 * yn + 3 * zn
    up, vp = u / (13 * star) + 4 * xn / dn, v / (13 * star) + 9 * yn / dn
    y = yn * back(m, star / 116)
    return 9 * up * y / (4 * vp), y, (12 - 3 * up - 20 * vp) * y / (4 * vp)


def to_lch(m, c):
    hue = m.arctan2(c[:, 2], c[:, 1])
    return c[:, 0], m.hypot(c[:, 1], c[:, 2]), m.where(hue < 0, hue + 2 * m.pi, hue)


def hue_of(m, c, most, least):
    r, g, b = c.T
    span = m.where(most == least, m.c("1"), most - least)
    sextant = m.where(
        most == r,
        (g - b) / span,
        m.where(most == g, 2 + (b - r) / span, 4 + (r - g) / span),
    )
    return m.where(sextant < 0, sextant + 6, sextant) / 6


def hsv(m, c):
    most = m.maximum(m.maximum(c[:, 0], c[:, 1]), c[:, 2])
    least = m.minimum(m.minimum(c[:, 0], c[:, 1]), c[:, 2])
    return hue_of(m, c, most, least), (most - least) / most, most


def hsl(m, c):
    hue, _, most = hsv(m, c)
    least = m.minimum(m.minimum(c[:, 0], c[:, 1]), c[:, 2])
    room = m.minimum(most + least, 2 - (most + least))
    return hue, (most - least) / room, (most + least) / 2


def from_hsv(m, c):
    hue, s, v = c.T

    def channel(n):
        k = n + 6 * hue
        k = m.where(k >= 6, k - 6, k)
        part = m.maximum(m.minimum(m.minimum(k, 4 - k), m.c("1")), m.c("0"))
        return v - v * s * part

    return channel(5), channel(3), channel(1)


def from_hsl(m, c):
    hue, s, light = c.T
    reach = s * m.minimum(light, 1 - light)

    def channel(n):
        k = n + 12 * hue
        k = m.where(k >= 12, k - 12, k)
        part = m.maximum(m.minimum(m.minimum(k - 3, 9 - k), m.c("1")), -m.c("1"))
        return light - reach * part

    return channel(0), channel(8), channel(4)


def by_matrix(matrix):
    rounded = {4: np.asarray(matrix, np.float32), 8: np.asarray(matrix, np.float64)}

    def oracle(m, c):
        table = m.array(rounded[8])
        return tuple(sum(table[i, j] * c[:, j] for j in range(3)) for i in range(3))

    return oracle


def ycbcr(m, c):
    kr, kb = m.c("0.2126"), m.c("0.0722")
    y = kr * c[:, 0] + (1 - kr - kb) * c[:, 1] + kb * c[:, 2]
    return y, (c[:, 2] - y) / (2 - 2 * kb), (c[:, 0] - y) / (2 - 2 * kr)


def from_ycbcr(m, c):
    kr, kb = m.c("0.2126"), m.c("0.0722")
    y, cb, cr = c.T
    r, b = y + (2 - 2 * kr) * cr, y + (2 - 2 * kb) * cb
    return r, (y - kr * r - kb * b) / (1 - kr - kb), b


def delta_76(m, a, b):
    d = a - b
    return m.sqrt(d[:, 0] ** 2 + d[:, 1] ** 2 + d[:, 2] ** 2)


def ciede2000(m, first, second):
    """Return Sharma's equations in the order of the paper, with angles in degrees."""
    degree = m.pi / 180

    def weight(c):
        return m.sqrt(c**7 / (c**7 + m.c("25") ** 7))

    def hue(a, b):
        h = m.arctan2(b, a) / degree
        return m.where(h < 0, h + 360, h)

    (l1, a1, b1), (l2, a2, b2) = first.T, second.T
    g = (1 - weight((m.hypot(a1, b1) + m.hypot(a2, b2)) / 2)) / 2
    a1, a2 = (1 + g) * a1, (1 + g) * a2
    c1, c2, h1, h2 = m.hypot(a1, b1), m.hypot(a2, b2), hue(a1, b1), hue(a2, b2)
    dh = h2 - h1
    dh = m.where(dh > 180, dh - 360, m.where(dh < -180, dh + 360, dh))
    d_hue = 2 * m.sqrt(c1 * c2) * m.sin(dh / 2 * degree)
    mean_l, mean_c, mean_h = (l1 + l2) / 2, (c1 + c2) / 2, (h1 + h2) / 2
    far = m.abs(h1 - h2) > 180
    mean_h = m.where(far, m.where(h1 + h2 < 360, mean_h + 180, mean_h - 180), mean_h)

    def cos(angle):
        return m.cos(angle * degree)

    t = 1 - m.c("0.17") * cos(mean_h - 30) + m.c("0.24") * cos(2 * mean_h)
    t = t + m.c("0.32") * cos(3 * mean_h + 6) - m.c("0.2") * cos(4 * mean_h - 63)
    theta = 30 * m.exp(-(((mean_h - 275) / 25) ** 2))
    turn = -2 * weight(mean_c) * m.sin(2 * theta * degree)
    s_l = 1 + m.c("0.015") * (mean_l - 50) ** 2 / m.sqrt(20 + (mean_l - 50) ** 2)
    light, c = (l2 - l1) / s_l, (c2 - c1) / (1 + m.c("0.045") * mean_c)
    h = d_hue / (1 + m.c("0.015") * mean_c * t)
    return m.sqrt(light * light + c * c + h * h + turn * c * h)


def with_white(function):
    return lambda c: function(c, jnp.asarray(WHITE, c.dtype))


def to_xyy(m, c):
    total = c[:, 0] + c[:, 1] + c[:, 2]
    return c[:, 0] / total, c[:, 1] / total, c[:, 1]


def from_xyy(m, c):
    return c[:, 0] * c[:, 2] / c[:, 1], c[:, 2], (1 - c[:, 0] - c[:, 1]) * c[:, 2] / c[:, 1]


class Sized:
    """Colours times a common factor, small or large."""

    def __str__(self):
        return f"{COLOURS} times {SIZES}"

    def draw(self, rng, n):
        return COLOURS.draw(rng, n) * SIZES.draw(rng, n)[:, None]


SIZES = Range(1e-30, 1e30)
DARKEST = np.array([1e-37, 3e-37, 2e-37])
OF_ANY_SIZE = ((DARKEST,), (DARKEST * 1e70,), (DARKEST * 1e7,), (np.array([0.2, 0.1, 0.05]),))


class Lab:
    """Colours of any lightness, with chroma above 1: near grey the hue is undetermined."""

    def __str__(self):
        return "L* 1…100, chroma 1…120"

    def draw(self, rng, n):
        chroma, hue = Range(1.0, 120).draw(rng, n), rng.uniform(0, 2 * np.pi, size=n)
        light = rng.uniform(1, 100, size=n)
        return np.stack([light, chroma * np.cos(hue), chroma * np.sin(hue)], axis=-1)


LAB = Lab()
NEAR_GREY = "a difference of near numbers, near grey"
RGB_TO_XYZ = np.asarray(colour_data.rgb_to_xyz_matrix("sRGB"))
ENTRIES = [
    Entry(
        "colour_spaces.cie_1976.xyz_to_lab",
        with_white(lambda c, w: cs.xyz_to_lab(c, w)[0]),
        lambda m, c: lab(m, c)[0],
        (XYZ,),
        (*GREYS, *COLOURED),
        bound=10,
        form="L*",
        note="cancellation just above the break, where 16 is subtracted from the root",
    ),
    Entry(
        "colour_spaces.cie_1976.xyz_to_lab",
        with_white(lambda c, w: cs.xyz_to_lab(c, w)[1:]),
        lambda m, c: lab(m, c)[1:],
        (XYZ,),
        COLOURED,
        parts=("a*", "b*"),
        conditioned=True,
        gradient=1e-4,
        note=NEAR_GREY,
    ),
    Entry(
        "colour_spaces.cie_1976.lab_to_xyz",
        with_white(cs.lab_to_xyz),
        from_lab,
        (LAB,),
        ((np.array([1e-9, 0, 0]),), (np.array([8.0, 0, 0]),), (np.array([100.0, 0, 0]),)),
        parts=("X", "Y", "Z"),
        conditioned=True,
        note="X and Z where a* or b* cancels the lightness",
    ),
    Entry(
        "colour_spaces.cie_1976.xyz_to_luv",
        with_white(cs.xyz_to_luv),
        luv,
        (XYZ,),
        COLOURED,
        parts=("L*", "u*", "v*"),
        bound=8,
        conditioned=True,
        gradient=1e-4,
        note=NEAR_GREY,
    ),
    Entry(
        "colour_spaces.cie_1976.xyz_to_luv",
        with_white(cs.xyz_to_luv),
        luv,
        (Sized(),),
        OF_ANY_SIZE,
        parts=("L*", "u*", "v*"),
        form="of any size",
        bound=8,
        conditioned=True,
        gradient=0.0001,
        note=NEAR_GREY,
    ),
    Entry(
        "colour_spaces.cie_1976.luv_to_xyz",
        with_white(cs.luv_to_xyz),
        from_luv,
        (LAB,),
        ((np.array([50.0, 0, 0]),), (np.array([100.0, 0, 0]),)),
        bound=8,
        parts=("X", "Y", "Z"),
        conditioned=True,
        gradient=None,
        note="where u' or v' vanishes, also for colours outside the chromaticity diagram",
    ),
    Entry(
        "colour_spaces.cie_1976.to_lch",
        cs.to_lch,
        to_lch,
        (LAB,),
        (
            (np.array([50.0, 1e-20, 1e-25]),),
            (np.array([50.0, 3.0, -1e-12]),),
            (np.array([1.0, -4.0, 1e-20]),),
        ),
        parts=("L", "chroma", "hue"),
        turn=lambda m: 2 * m.pi,
    ),
    Entry(
        "colour_spaces.cie_1976.from_lch",
        cs.from_lch,
        lambda m, c: (c[:, 0], c[:, 1] * m.cos(c[:, 2]), c[:, 1] * m.sin(c[:, 2])),
        (Columns(Range(0.01, 6.28, log=False)),),
        parts=("L", "a", "b"),
        conditioned=True,
        note="near the zeros of sine and cosine",
    ),
    Entry(
        "colour_spaces.differences.delta_e_76",
        cs.delta_e_76,
        delta_76,
        (LAB, LAB),
        ((np.array([50.0, 10, 10]), np.array([50.0, 10, 10 + 1e-5])),),
    ),
    Entry(
        "colour_spaces.differences.delta_e_2000",
        cs.delta_e_2000,
        ciede2000,
        (LAB, LAB),
        (
            (np.array([50.0, 2.6772, -79.7751]), np.array([50.0, 0.0, -82.7485])),
            (np.array([50.0, 1e4, 3.0]), np.array([50.0, 1e4, 4.0])),
            (np.array([50.0, -60.0, 1e-6]), np.array([50.0, -60.0, -1e-6])),
            (np.array([50.0, 60.0, 1e-4]), np.array([50.0, 60.0, -1e-4])),
            (np.array([65.8, 14.84, -73.67]), np.array([65.8, 14.840001, -73.67001])),
            (np.array([30.0, 40.0, 20.0]), np.array([30.0, 40.0, 20.001])),
            (np.array([50.0, 0.0, 0.0]), np.array([50.0, 1e-20, 1e-21])),
        ),
        bound=10,
        conditioned=True,
        gradient=1e-3,
        note="a branch changes at opposite hues; two differences cancel for blues",
    ),
    Entry(
        "colour_spaces.hexagon.rgb_to_hsv",
        cs.rgb_to_hsv,
        hsv,
        (COLOURS,),
        ((np.array([1.0, 1e-6, 0.5]),), (np.array([0.3, 0.2, 0.1]),)),
        parts=("hue", "saturation", "value"),
        turn=lambda m: 1,
        conditioned=True,
        gradient=1e-4,
        note=NEAR_GREY,
    ),
    Entry(
        "colour_spaces.hexagon.rgb_to_hsv",
        cs.rgb_to_hsv,
        hsv,
        (Sized(),),
        OF_ANY_SIZE,
        parts=("hue", "saturation", "value"),
        form="of any size",
        turn=lambda m: 1,
        conditioned=True,
        gradient=0.0001,
        note=NEAR_GREY,
    ),
    Entry(
        "colour_spaces.hexagon.hsv_to_rgb",
        cs.hsv_to_rgb,
        from_hsv,
        (Columns(FRACTION),),
        ((np.array([0.0, 1.0, 1.0]),), (np.array([0.5, 0.0, 1e-30]),)),
        parts=("R", "G", "B"),
        conditioned=True,
        note="where saturation cancels the value",
    ),
    Entry(
        "colour_spaces.hexagon.rgb_to_hsl",
        cs.rgb_to_hsl,
        hsl,
        (COLOURS,),
        parts=("hue", "saturation", "lightness"),
        turn=lambda m: 1,
        conditioned=True,
        gradient=1e-4,
        note=NEAR_GREY + "; the saturation, near white",
    ),
    Entry(
        "colour_spaces.hexagon.rgb_to_hsl",
        cs.rgb_to_hsl,
        hsl,
        (Sized(),),
        OF_ANY_SIZE,
        parts=("hue", "saturation", "lightness"),
        form="of any size",
        turn=lambda m: 1,
        conditioned=True,
        gradient=0.0001,
        note=NEAR_GREY + "; the saturation, near white",
    ),
    Entry(
        "colour_spaces.hexagon.hsl_to_rgb",
        cs.hsl_to_rgb,
        from_hsl,
        (Columns(FRACTION),),
        bound=9.0,
        parts=("R", "G", "B"),
        conditioned=True,
        note="where saturation cancels the lightness",
    ),
    Entry(
        "colour_spaces.ycbcr.rgb_to_ycbcr",
        cs.rgb_to_ycbcr,
        ycbcr,
        (Columns(FRACTION),),
        parts=("Y'", "Cb", "Cr"),
        conditioned=True,
        note=NEAR_GREY,
    ),
    Entry(
        "colour_spaces.ycbcr.ycbcr_to_rgb",
        cs.ycbcr_to_rgb,
        from_ycbcr,
        (Columns(FRACTION),),
        parts=("R", "G", "B"),
        conditioned=True,
        note="where the differences cancel the luma",
    ),
    Entry(
        "colour_spaces.chromaticity.xyz_to_xyy",
        cs.xyz_to_xyy,
        to_xyy,
        (XYZ,),
        parts=("x", "y", "Y"),
    ),
    Entry(
        "colour_spaces.chromaticity.xyz_to_xyy",
        cs.xyz_to_xyy,
        to_xyy,
        (Sized(),),
        OF_ANY_SIZE,
        parts=("x", "y", "Y"),
        form="of any size",
    ),
    Entry(
        "colour_spaces.chromaticity.xyy_to_xyz",
        cs.xyy_to_xyz,
        from_xyy,
        (Columns(Range(0.01, 0.49)),),
        parts=("X", "Y", "Z"),
        conditioned=True,
        note="Z on the line of purples",
    ),
    Entry(
        "colour_spaces.matrices.rgb_to_xyz",
        cs.rgb_to_xyz,
        by_matrix(RGB_TO_XYZ),
        (COLOURS,),
        parts=("X", "Y", "Z"),
    ),
    Entry(
        "colour_spaces.matrices.xyz_to_rgb",
        cs.xyz_to_rgb,
        by_matrix(np.linalg.inv(RGB_TO_XYZ)),
        (COLOURS,),
        parts=("R", "G", "B"),
        conditioned=True,
        note="where a primary vanishes",
    ),
    Entry(
        "colour_spaces.matrices.luminance",
        cs.luminance,
        lambda m, c: by_matrix(RGB_TO_XYZ)(m, c)[1],
        (COLOURS,),
    ),
    Entry(
        "colour_spaces.matrices.apply_matrix",
        lambda c: cs.apply_matrix(c, jnp.asarray(np.full((3, 3), 0.5) + np.eye(3), c.dtype)),
        by_matrix(np.full((3, 3), 0.5) + np.eye(3)),
        (COLOURS,),
        parts=("1", "2", "3"),
    ),
]
