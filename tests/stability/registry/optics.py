"""Oracles for the lens, its aperture and diffraction."""

import jax.numpy as jnp
from oracle_numbers import MP, special

from jaxvision import Pinhole, PixelAperture, optics
from jaxvision.optics import diffraction, overlap, thin_lens
from jaxvision.sensor import aperture_mtf

from .entry import Entry, Range

FAR, FOCAL = Range(0.3, 1e4), Range(0.005, 0.2)
NUMBER = Range(1.0, 64.0)
WAVE = Range(2e-7, 2e-6)


def vergence(m, first, second):
    return 1 / first - 1 / second


def image(m, z, f):
    return z * f / (z - f)


def confusion(m, z, focus, f, n):
    return f / n * image(m, focus, f) * m.abs(1 / z - 1 / focus)


def field(m, focus, f, n, blur):
    tolerance = blur * n / (f * image(m, focus, f))
    return 1 / (1 / focus + tolerance), 1 / (1 / focus - tolerance)


def power(m, a, b, n):
    return (n - 1) * (a - b)


def thick(m, a, b, n, t):
    return (n - 1) * (a - b + (n - 1) * t * a * b / n)


def lens(m, d, r1, r2):
    """Return the area of overlap of two discs, the sum of two circular segments."""
    a1 = (d * d + r1 * r1 - r2 * r2) / (2 * d * r1)
    a2 = (d * d + r2 * r2 - r1 * r1) / (2 * d * r2)
    apart, inside = d >= r1 + r2, d <= m.abs(r1 - r2)
    whole = m.pi * m.minimum(r1, r2) ** 2
    safe = apart | inside
    x1, x2 = (m.arccos(m.where(safe, m.c("0"), a)) for a in (a1, a2))
    shared = r1**2 * (x1 - m.sin(x1) * m.cos(x1)) + r2**2 * (x2 - m.sin(x2) * m.cos(x2))
    return m.where(apart, m.c("0"), m.where(inside, whole, shared))


def mtf(m, frequency, wavelength, number):
    v = frequency * wavelength * number
    beyond = v >= 1
    v = m.where(beyond, m.c("0"), v)
    contrast = 2 / m.pi * (m.arccos(v) - v * m.sqrt(1 - v * v))
    return m.where(beyond, m.c("0"), contrast)


airy = special(lambda x: (2 * MP.besselj(1, x) / x) ** 2 if x else MP.mpf(1))


def sinc(m, f):
    x = m.pi * f
    return m.where(
        f == 0, m.c("1"), m.sin(m.where(f == 0, m.c("1"), x)) / m.where(f == 0, m.c("1"), x)
    )


def of_pinhole(row):
    """Return the irradiance behind a pinhole at a pixel `row` pitches off the optical axis."""
    view = Pinhole(
        jnp.zeros(3, row.dtype),
        jnp.eye(3, dtype=row.dtype),
        jnp.asarray(1.0, row.dtype),
        jnp.asarray(1.0, row.dtype),
        resolution=(1, 1),
        f_number=jnp.asarray(8.0, row.dtype),
    )
    return optics.pixel_irradiance(view, jnp.ones(1, row.dtype), row, jnp.zeros_like(row))[0]


ENTRIES = [
    Entry(
        "optics.thin_lens.image_distance",
        thin_lens.image_distance,
        image,
        (FAR, FOCAL),
        ((0.1000001, 0.1), (1.0, 0.05), (1e30, 0.05), (0.05, 0.1)),
        note="exact near the focus, because the difference of two near numbers is exact",
        gradient=1e-4,
    ),
    Entry(
        "optics.thin_lens.image_vergence",
        thin_lens.image_vergence,
        lambda m, z, f: 1 / f - 1 / z,
        (FAR, FOCAL),
        ((0.1000001, 0.1), (1.0, 0.05)),
        gradient=1e-4,
    ),
    Entry(
        "optics.thin_lens.vergence_difference",
        thin_lens.vergence_difference,
        vergence,
        (FAR, FAR),
        ((1.0, 1.000001), (1e5, 1e5 + 1)),
    ),
    Entry(
        "optics.thin_lens.magnification",
        thin_lens.magnification,
        lambda m, z, f: f / (f - z),
        (FAR, FOCAL),
        ((0.1000001, 0.1),),
    ),
    Entry(
        "optics.thin_lens.working_f_number",
        thin_lens.working_f_number,
        lambda m, n, z, f: n * image(m, z, f) / f,
        (NUMBER, FAR, FOCAL),
        ((8.0, 0.1, 0.05),),
        gradient=1e-4,
    ),
    Entry(
        "optics.thin_lens.lens_power",
        thin_lens.lens_power,
        power,
        (Range(0.1, 100), Range(0.1, 100), Range(1.3, 2.0)),
        ((10.0, -10.0, 1.5), (10.0, 10.000001, 1.5)),
    ),
    Entry(
        "optics.thin_lens.lens_power",
        lambda a, b, n, t: thin_lens.lens_power(a, -b, n, thickness=t),
        lambda m, a, b, n, t: thick(m, a, -b, n, t),
        (Range(0.1, 100), Range(0.1, 100), Range(1.3, 2.0), Range(1e-4, 1e-3)),
        form="thick",
    ),
    Entry(
        "optics.thin_lens.lens_focal_length",
        lambda a, b, n: thin_lens.lens_focal_length(a, -b, n),
        lambda m, a, b, n: 1 / power(m, a, -b, n),
        (Range(0.1, 100), Range(0.1, 100), Range(1.3, 2.0)),
    ),
    Entry(
        "optics.thin_lens.circle_of_confusion",
        thin_lens.circle_of_confusion,
        confusion,
        (FAR, FAR, FOCAL, NUMBER),
        ((1.000001, 1.0, 0.05, 2.0), (1e30, 1.0, 0.05, 2.0)),
        bound=6,
        note="seven roundings",
    ),
    Entry(
        "optics.thin_lens.depth_of_field",
        lambda *a: thin_lens.depth_of_field(*a)[0],
        lambda m, *a: field(m, *a)[0],
        (Range(0.3, 10), FOCAL, NUMBER, Range(1e-6, 1e-4)),
        form="near",
        bound=6.0,
        note="seven roundings",
    ),
    Entry(
        "optics.thin_lens.depth_of_field",
        lambda *a: thin_lens.depth_of_field(*a)[1],
        lambda m, *a: field(m, *a)[1],
        (Range(0.3, 1.0), Range(0.05, 0.2), Range(1.0, 8.0), Range(1e-6, 2e-5)),
        conditioned=True,
        form="far",
        gradient=1e-4,
        note="towards the hyperfocal distance",
    ),
    Entry(
        "optics.thin_lens.hyperfocal_distance",
        thin_lens.hyperfocal_distance,
        lambda m, f, n, c: f + f * f / (c * n),
        (FOCAL, NUMBER, Range(1e-6, 1e-4)),
    ),
    Entry(
        "optics.diffraction.airy_radius",
        diffraction.airy_radius,
        lambda m, w, n: m.c("1.2196698912665044896") * w * n,
        (WAVE, NUMBER),
    ),
    Entry(
        "optics.diffraction.airy_pattern",
        diffraction.airy_pattern,
        lambda m, r, w, n: airy(m.pi * r / (w * n)),
        (Range(1e-8, 5e-6), WAVE, Range(4.0, 64.0)),
        ((0.0, 5e-7, 8.0), (1e-9, 5e-7, 8.0)),
        bound=9,
        conditioned=True,
        of_digits=True,
        gradient=None,
        note="near the dark rings; a square",
    ),
    Entry(
        "optics.diffraction.diffraction_mtf",
        diffraction.diffraction_mtf,
        mtf,
        (Range(1e2, 2e6), WAVE, NUMBER),
        ((0.0, 5e-7, 4.0), (4.9e5, 5e-7, 4.0)),
        conditioned=True,
        bound=8,
        gradient=1e-3,
        note="near the cut-off",
    ),
    Entry(
        "optics.overlap.overlap_of_discs",
        overlap.overlap_of_discs,
        lens,
        (Range(0.01, 3.0), Range(0.3, 2.0), Range(0.3, 2.0)),
        ((1.9999, 1.0, 1.0), (0.5, 1.0, 0.5), (0.0001, 1.0, 1.0), (3.0, 1.0, 1.0)),
        conditioned=True,
        bound=8,
        gradient=1e-3,
        note="where the regions just touch, or one nearly contains the other",
    ),
    Entry(
        "optics.irradiance.pixel_irradiance",
        of_pinhole,
        lambda m, row: m.pi / 256 / (1 + row * row) ** 2,
        (Range(1e-4, 30.0),),
        ((0.0,), (1.0,)),
        bound=6,
        form="pinhole, cos^4",
        note="the fourth power of a rounded cosine",
    ),
    Entry(
        "sensor.sampling.aperture_mtf",
        lambda f: aperture_mtf(PixelAperture(jnp.ones((), f.dtype)), f),
        sinc,
        (Range(1e-6, 20.0),),
        ((0.0,), (1e-20,), (0.9999995,), (1.0000001,), (0.5,)),
        conditioned=True,
        note="near the zeros",
    ),
]
