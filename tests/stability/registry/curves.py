"""Oracles for curves of encoding and tone, point operators and compositing."""

import jax.numpy as jnp
import numpy as np

from jaxvision import point_ops
from jaxvision.matting import compositing

from .entry import FRACTION, RELATIVE, Columns, Entry, Range

DARK = Range(1e-37, 1.0)  # every decade of float32
TONES = Range(1e-30, 1e30)
TABLE = np.array([0.0, 0.1, 0.15, 0.4, 1.0])


def srgb_encode(m, x):
    curved = x > m.c("0.0031308")
    base = m.where(curved, x, m.c("1"))
    root = m.power(base, m.c("5") / m.c("12"))
    return m.where(curved, m.c("1.055") * root - m.c("0.055"), m.c("12.92") * x)


def srgb_decode(m, x):
    curved = x > m.c("0.04045")
    base = m.where(curved, (x + m.c("0.055")) / m.c("1.055"), m.c("1"))
    return m.where(curved, m.power(base, m.c("2.4")), x / m.c("12.92"))


def raised(exponent):
    def oracle(m, x, *gamma):
        p = gamma[0] if gamma else exponent(m)
        return m.where(x <= 0, m.c("0"), m.power(m.where(x <= 0, m.c("1"), x), p))

    return oracle


def inverse_gamma(m, x, gamma):
    return raised(None)(m, x, 1 / gamma)


def reinhard(m, x, *white):
    mapped = x / (1 + x)
    return mapped * (1 + x / white[0] ** 2) if white else mapped


def filmic(m, x):
    x = m.maximum(x, m.c("0"))
    ratio = x * (m.c("2.51") * x + m.c("0.03"))
    return m.minimum(ratio / (x * (m.c("2.43") * x + m.c("0.59")) + m.c("0.14")), m.c("1"))


def lookup(m, x):
    at = m.minimum(m.maximum(x, m.c("0")), m.c("1")) * 4
    value = m.c("0") * x
    table = m.array(TABLE_32)
    for k in range(4):
        inside = (at >= k) & ((at < k + 1) | (k == 3))
        value = m.where(inside, table[k] + (at - k) * (table[k + 1] - table[k]), value)
    return value


TABLE_32 = TABLE.astype(np.float32)  # exact in float32, too


def over(m, f, a, g, b):
    return f + (1 - a) * g, a + (1 - a) * b


def as_layer(colour, alpha):
    return jnp.concatenate([colour[None], alpha[None]])


EXP2 = "quick: the error is that of |log2 x| exponent in units of the last place"
AT_BREAKS = (0.0031308, 0.00313081, 0.0, 1e-37, 1.0, 0.5)

ENTRIES = [
    Entry(
        "point_ops.curves.srgb_encode",
        point_ops.srgb_encode,
        srgb_encode,
        (DARK,),
        tuple((x,) for x in AT_BREAKS),
        bound=2,
    ),
    Entry(
        "point_ops.curves.srgb_encode",
        point_ops.srgb_encode,
        srgb_encode,
        (TONES,),
        ((1.0,), (1e30,)),
        bound=2,
        form="up to 1e30",
    ),
    Entry(
        "point_ops.curves.srgb_encode",
        lambda x: point_ops.srgb_encode(x, method="exp2"),
        srgb_encode,
        (Range(1e-5, 1.0),),
        bound=10,
        form="method exp2",
        note=EXP2,
    ),
    Entry(
        "point_ops.curves.srgb_decode",
        point_ops.srgb_decode,
        srgb_decode,
        (DARK,),
        tuple((x,) for x in (0.04045, 0.0404501, 0.0, 1.0, 0.084, 0.5)),
        bound=2,
    ),
    Entry(
        "point_ops.curves.srgb_decode",
        point_ops.srgb_decode,
        srgb_decode,
        (Range(1e-30, 1e15),),
        bound=2,
        form="up to 1e15",
    ),
    Entry(
        "point_ops.curves.srgb_decode",
        lambda x: point_ops.srgb_decode(x, method="exp2"),
        srgb_decode,
        (Range(1e-5, 1.0),),
        bound=20,
        form="method exp2",
        note=EXP2,
    ),
    Entry(
        "point_ops.curves.gamma_encode",
        lambda x: point_ops.gamma_encode(x, 2.2),
        raised(lambda m: 1 / m.c("2.20000000000000017763568394002504646778106689453125")),
        (TONES,),
        ((1e-37,), (1.0,), (1e30,)),
        bound=2,
        form="gamma 2.2",
    ),
    Entry(
        "point_ops.curves.gamma_encode",
        point_ops.gamma_encode,
        inverse_gamma,
        (TONES, Range(1.0, 5.0)),
        ((1e-37, 2.2), (1.0, 5.0)),
        bound=2,
        form="gamma an array",
    ),
    Entry(
        "point_ops.curves.gamma_decode",
        lambda x: point_ops.gamma_decode(x, 2.2),
        raised(lambda m: m.c("2.20000000000000017763568394002504646778106689453125")),
        (Range(1e-15, 1e15),),
        ((1e-16,), (1.0,)),
        bound=2,
        form="gamma 2.2",
    ),
    Entry(
        "point_ops.curves.gamma_decode",
        point_ops.gamma_decode,
        raised(None),
        (Range(1e-6, 1e6), Range(1.0, 5.0)),
        bound=2,
        form="gamma an array",
    ),
    Entry(
        "point_ops.curves.gamma_decode",
        lambda x: point_ops.gamma_decode(x, 2.2, method="exp2"),
        raised(lambda m: m.c("2.20000000000000017763568394002504646778106689453125")),
        (Range(1e-5, 1.0),),
        bound=20 * 2.2,
        form="gamma 2.2, method exp2",
        note=EXP2,
    ),
    Entry(
        "point_ops.curves.clip",
        lambda x, low: point_ops.clip(x, low, low + 1),
        lambda m, x, low: m.minimum(m.maximum(x, low), low + 1),
        (Range(0, 3, log=False), Range(0.25, 0.5, log=False)),
        bound=1,
        note="the upper end is low + 1, rounded",
    ),
    Entry(
        "point_ops.linear.exposure",
        lambda stops: point_ops.exposure(jnp.ones_like(stops), stops),
        lambda m, s: m.power(m.c("2"), s),
        (Range(-120, 120, log=False),),
        tuple((x,) for x in (0.0, 0.5, 99.99, -125.5, 1e-30, 1.0)),
        bound=2,
        form="of 1",
    ),
    Entry(
        "point_ops.linear.exposure",
        point_ops.exposure,
        lambda m, x, s: x * m.power(m.c("2"), s),
        (Range(1e-10, 1e10), Range(-80, 80, log=False)),
        bound=2.5,
        note="XLA's exponential has an error of 1.7 ULP in float64; in float32 2 are enough",
    ),
    Entry(
        "point_ops.linear.exposure",
        point_ops.exposure,
        lambda m, x, s: x * m.power(m.c("2"), s),
        (Range(1e-37, 1e-33), Range(0, 236, log=False)),
        ((0.0, 128.0), (0.0, 250.0), (1e-30, 150.0), (1e-37, 250.0), (0.0, 1e4)),
        bound=2.5,
        gradient=None,
        form="faint",
        note="2^stops, a slope, may be out of range",
    ),
    Entry(
        "point_ops.linear.exposure",
        point_ops.exposure,
        lambda m, x, s: x * m.power(m.c("2"), s),
        (Range(1e33, 1e37), Range(-250, 0, log=False)),
        ((1e30, -160.0), (1e37, -248.0), (1e38, -250.0), (0.0, -250.0)),
        bound=2.5,
        gradient=None,
        form="bright",
        note="2^stops, a slope, may be out of range",
    ),
    Entry(
        "point_ops.linear.gain_bias",
        point_ops.gain_bias,
        lambda m, x, g, b: g * x + b,
        (RELATIVE, RELATIVE, Range(1e-3, 1.0, signed=True)),
        ((1.0, 1.0, -1.0), (0.5, 0.5, -0.25)),
        bound=2,
        conditioned=True,
        note="a bias of opposite sign cancels the signal",
    ),
    Entry(
        "point_ops.linear.contrast_brightness",
        point_ops.contrast_brightness,
        lambda m, x, c, b: c * (x - m.c("0.5")) + m.c("0.5") + b,
        (RELATIVE, Range(0.1, 10), Range(1e-3, 1.0, signed=True)),
        ((0.5, 2.0, 0.0), (0.0, 1.0, 0.0), (0.0, 2.0, 0.5)),
        bound=2,
        conditioned=True,
        note="near the grey that gives 0; the condition number counts the pivot 0.5 as rounded",
    ),
    Entry(
        "point_ops.linear.blend",
        point_ops.blend,
        lambda m, a, b, t: (1 - t) * a + t * b,
        (RELATIVE, RELATIVE, FRACTION),
        ((1.0, 1.0, 0.3), (0.0, 1.0, 1e-30)),
    ),
    Entry(
        "point_ops.tables.lookup",
        lambda x: point_ops.lookup(x, jnp.asarray(TABLE_32, x.dtype)),
        lookup,
        (Range(1e-6, 1.0),),
        ((0.0,), (1.0,), (0.25,), (0.5,)),
    ),
    Entry(
        "point_ops.tone_mapping.reinhard",
        point_ops.reinhard,
        reinhard,
        (TONES,),
        ((0.0,), (1e37,), (1.0,)),
        bound=2,
    ),
    Entry(
        "point_ops.tone_mapping.reinhard",
        lambda x, w: point_ops.reinhard(x, white=w),
        reinhard,
        (Range(1e-30, 1e25), Range(1e-2, 1e5)),
        ((1e20, 2.0), (1e30, 2.0), (4e19, 3.0), (1.0, 1e-3), (1e28, 1e13)),
        form="white",
        bound=5.0,
    ),
    Entry(
        "point_ops.tone_mapping.filmic",
        point_ops.filmic,
        filmic,
        (Range(1e-34, 1e34),),
        ((0.0,), (1e-36,), (1.0,), (0.9999,), (1e37,)),
    ),
    Entry(
        "point_ops.tone_mapping.log_curve",
        point_ops.log_curve,
        lambda m, x, s: m.log1p(s * m.maximum(x, m.c("0"))) / m.log1p(s),
        (Range(1e-25, 1e10), Range(1e-30, 1e5)),
        (
            (0.0, 10.0),
            (1.0, 1e-6),
            (1e-30, 1e-6),
            (1e-20, 1e4),
            (0.5, 1e-10),
            (2.0, 1e-35),
            (1e30, 1e30),
        ),
        bound=6.0,
        note="a quotient of logarithms; XLA has an error of 2.5 ULP where 1 + x is rounded",
    ),
    Entry(
        "point_ops.tone_mapping.set_luminance",
        lambda c, a, b: point_ops.set_luminance(c[None], a, b)[0],
        lambda m, c, a, b: c * b / a,
        (RELATIVE, Range(1e-6, 1e6), Range(1e-6, 1e6)),
        bound=2,
    ),
    Entry(
        "point_ops.tone_mapping.scaled_to_key",
        lambda x: point_ops.scaled_to_key(x[None])[0, 0],
        lambda m, x: (
            x[:, 0] * m.c("0.18") / m.exp((m.log(x[:, 0]) + m.log(x[:, 1]) + m.log(x[:, 2])) / 3)
        ),
        (Columns(Range(1e-2, 1e2)),),
        ((np.array([1.0, 1.0, 1.0]),), (np.array([1e-3, 1.0, 1e2]),)),
        bound=15.0,
        gradient=1e-4,
        note="the exponential of a mean logarithm",
    ),
    Entry(
        "matting.compositing.over",
        lambda f, a, g, b: compositing.over(as_layer(f * a, a), as_layer(g * b, b)),
        lambda m, f, a, g, b: over(m, f * a, a, g * b, b),
        (FRACTION, FRACTION, FRACTION, FRACTION),
        ((1.0, 1.0, 1.0, 1.0), (0.0, 0.0, 1.0, 1.0), (1.0, 1e-30, 1.0, 1.0)),
        parts=("colour", "alpha"),
        note="includes the products that premultiply the layers",
    ),
    Entry(
        "matting.compositing.premultiply",
        lambda c, a: compositing.premultiply(c[None], a[None]),
        lambda m, c, a: (c * a, a),
        (FRACTION, FRACTION),
        bound=1,
        parts=("colour", "alpha"),
    ),
    Entry(
        "matting.compositing.unpremultiply",
        lambda c, a: compositing.unpremultiply(as_layer(c, a)),
        lambda m, c, a: c / a,
        (RELATIVE, RELATIVE),
        ((1e-6, 1e-6),),
        bound=1,
    ),
]
