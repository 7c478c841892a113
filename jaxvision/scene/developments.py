"""The records of the steps that convert raw data to a picture."""

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from ..core._shown import Shown
from ..core._types import (
    FINITE,
    NOT_NEGATIVE,
    POSITIVE,
    Colour,
    Range,
    Scalar,
    as_float,
    as_optional_float,
    as_tile,
    check_choice,
    check_count,
    check_fields,
    check_range,
    check_tile,
    is_known,
    print_by_name,
)

DEMOSAICINGS = ("bilinear", "malvar", "menon", "normalised")
SUBSAMPLINGS = ("4:4:4", "4:2:0")
ROUNDINGS = ("straight_through", "cubic")


class Demosaicing(Shown):
    """Demosaicing: interpolation of the bands that a pixel of a mosaic sensor does not measure.

    Attributes:
        pattern: rows of band indices, the tile of the colour filter array, or the phase of a Bayer
            mosaic, such as "RGGB"; static.
        method: one of `DEMOSAICINGS`, described in `development.demosaic`; static.

    Example:
        >>> how = jv.Development(demosaicing=jv.Demosaicing("RGGB", method="bilinear"))
        >>> print(jv.develop(jnp.full((4, 4), 5.0), how)[1, 2])
        [5. 5. 5.]
    """

    pattern: tuple[tuple[int, ...], ...] = eqx.field(static=True, converter=as_tile)
    method: str = eqx.field(static=True, default="malvar", kw_only=True)

    def __check_init__(self) -> None:
        check_tile("Demosaicing.pattern", self.pattern)
        check_choice("Demosaicing.method", self.method, DEMOSAICINGS)


class WhiteBalance(Shown):
    """White balance by gains that the user gives.

    Attributes:
        gains: (bands,) no unit, > 0.

    Example:
        >>> how = jv.Development(white_balance=jv.WhiteBalance([2.0, 1.0, 1.5]))
        >>> jv.develop(jnp.array([[[0.25, 0.5, 0.5]]]), how).ravel().tolist()
        [0.5, 0.5, 0.75]
    """

    gains: Colour = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, gains=POSITIVE)


class GreyWorld(Shown):
    """White balance whose gains make the picture grey on average.

    Attributes:
        norm: () exponent >= 1 of the mean, no unit: 1 is grey world, 6 shades of grey.

    Example:
        No band becomes darker.

        >>> how = jv.Development(white_balance=jv.GreyWorld())
        >>> [round(float(x), 4) for x in jv.develop(jnp.array([[[0.2, 0.4, 0.8]]]), how)[0, 0]]
        [0.8, 0.8, 0.8]
    """

    norm: Scalar = eqx.field(converter=as_float, default=1.0)

    def __check_init__(self) -> None:
        check_fields(self, norm=Range(1))


class NeutralPatch(Shown):
    """White balance whose gains make a rectangle of the picture grey.

    Attributes:
        rows: (first, last) pixels, the last one excluded; static.
        columns: (first, last) pixels, the last one excluded; static.

    Example:
        The first pixel shows a grey card, the second a paint.

        >>> how = jv.Development(white_balance=jv.NeutralPatch(rows=(0, 1), columns=(0, 1)))
        >>> picture = jnp.array([[[0.25, 0.5, 0.5], [0.5, 0.25, 0.25]]])
        >>> jv.develop(picture, how)[0].tolist()
        [[0.5, 0.5, 0.5], [1.0, 0.25, 0.25]]
    """

    rows: tuple[int, int] = eqx.field(static=True)
    columns: tuple[int, int] = eqx.field(static=True)

    def __check_init__(self) -> None:
        for name in ("rows", "columns"):
            span = getattr(self, name)
            if not isinstance(span, tuple) or len(span) != 2:
                raise ValueError(f"NeutralPatch.{name} must be (first, last), got {span!r}.")
            check_count(f"the first of NeutralPatch.{name}", span[0], 0)
            check_count(f"the last of NeutralPatch.{name}", span[1], span[0] + 1)


WhiteBalancing = WhiteBalance | GreyWorld | NeutralPatch
print_by_name(globals(), "WhiteBalancing")


class Bilateral(Shown):
    """Denoising by a bilateral filter, which preserves edges.

    Attributes:
        sigma_space: () pixels, > 0.
        sigma_range: () > 0, in the picture's unit.
        radius: of the neighbourhood in pixels, >= 0; static.

    Example:
        >>> how = jv.Development(denoising=jv.Bilateral(1.0, 0.01, radius=1))
        >>> edge = jnp.array([[[0.0], [0.0], [1.0], [1.0]]])
        >>> [round(float(x), 4) for x in jv.develop(edge, how).ravel()]
        [0.0, 0.0, 1.0, 1.0]
    """

    sigma_space: Scalar = eqx.field(converter=as_float)
    sigma_range: Scalar = eqx.field(converter=as_float)
    radius: int = eqx.field(static=True, default=3, kw_only=True)

    def __check_init__(self) -> None:
        check_fields(self, sigma_space=POSITIVE, sigma_range=POSITIVE)
        check_count("Bilateral.radius", self.radius, 0)


class NonLocalMeans(Shown):
    """Denoising by non-local means: a pixel becomes an average over pixels with similar
    surroundings.

    Attributes:
        strength: () > 0, in the picture's unit.
        noise: () standard deviation of the noise >= 0, in the picture's unit.
        patch: side of the compared patches in pixels, odd; static.
        radius: of the neighbourhood in pixels, >= 0; static.

    Example:
        >>> how = jv.Development(denoising=jv.NonLocalMeans(0.01, patch=1, radius=1))
        >>> edge = jnp.array([[[0.0], [0.0], [1.0], [1.0]]])
        >>> [round(float(x), 4) for x in jv.develop(edge, how).ravel()]
        [0.0, 0.0, 1.0, 1.0]
    """

    strength: Scalar = eqx.field(converter=as_float)
    noise: Scalar = eqx.field(converter=as_float, default=0.0)
    patch: int = eqx.field(static=True, default=5, kw_only=True)
    radius: int = eqx.field(static=True, default=6, kw_only=True)

    def __check_init__(self) -> None:
        check_fields(self, strength=POSITIVE, noise=NOT_NEGATIVE)
        check_count("NonLocalMeans.patch", self.patch, 1, odd=True)
        check_count("NonLocalMeans.radius", self.radius, 0)


Denoising = Bilateral | NonLocalMeans
print_by_name(globals(), "Denoising")


class Reinhard(Shown):
    """Reinhard's tone mapping, x / (1 + x).

    Attributes:
        white: () relative, > 0: the smallest x that maps to 1; None maps only infinity to 1.

    Example:
        >>> from jaxvision.development import map_tone
        >>> four, curves = jnp.array(4.0), (jv.Reinhard(), jv.Reinhard(white=4.0))
        >>> [round(float(map_tone(four, curve)), 4) for curve in curves]  # 4 / (1 + 4), and white
        [0.8, 1.0]
    """

    white: Scalar | None = eqx.field(converter=as_optional_float, default=None)

    def __check_init__(self) -> None:
        check_fields(self, white=POSITIVE)


class Filmic(Shown):
    """Tone mapping by the ACES film curve, `point_ops.filmic`.

    Example:
        >>> how = jv.Development(tone_map=jv.Filmic())
        >>> round(float(jv.develop(jnp.array(1.0), how)), 4)  # (2.51 + 0.03) / (2.43 + 0.59 + 0.14)
        0.8038
    """


class ToneCurve(Shown):
    """Tone mapping by a monotone spline through given points.

    Attributes:
        inputs: (points,) relative, strictly ascending, at least two.
        outputs: (points,) relative.

    Example:
        >>> how = jv.Development(tone_map=jv.ToneCurve([0.0, 0.5, 1.0], [0.0, 0.75, 1.0]))
        >>> jv.develop(jnp.array([0.5, 1.0, 2.0]), how).tolist()
        [0.75, 1.0, 1.0]
    """

    inputs: Float[Array, " points"] = eqx.field(converter=as_float)
    outputs: Float[Array, " points"] = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, inputs=FINITE, outputs=FINITE)
        check_count("the number of ToneCurve.inputs", self.inputs.size, 2)
        if is_known(self.inputs) and not (np.diff(self.inputs) > 0).all():
            raise ValueError(f"ToneCurve.inputs must ascend, got {np.asarray(self.inputs)}.")


ToneMap = Reinhard | Filmic | ToneCurve
print_by_name(globals(), "ToneMap")


class Gamma(Shown):
    """Encoding of linear values x by the power law x ** (1 / gamma).

    Attributes:
        gamma: () > 0, no unit.

    Example:
        >>> how = jv.Development(tone=jv.Gamma(2.2))
        >>> round(float(jv.develop(jnp.array(0.5), how)), 4)  # 0.5^(1 / 2.2)
        0.7297
    """

    gamma: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, gamma=POSITIVE)


class SRGB(Shown):
    """The piecewise sRGB encoding of IEC 61966-2-1.

    Example:
        >>> how = jv.Development(tone=jv.SRGB())
        >>> round(float(jv.develop(jnp.array(0.5), how)), 4)  # 1.055 x 0.5^(1 / 2.4) - 0.055
        0.7354
    """


ToneEncoding = Gamma | SRGB
print_by_name(globals(), "ToneEncoding")


class UnsharpMask(Shown):
    """Sharpening by an unsharp mask.

    Attributes:
        sigma: () pixels, > 0: scale of the sharpened detail.
        amount: () no unit.
        size: side of the Gaussian in pixels, odd; static.

    Example:
        An edge overshoots by the same amount on either side.

        >>> how = jv.Development(sharpening=jv.UnsharpMask(1.0, 0.5, size=3))
        >>> edge = jv.develop(jnp.array([[[0.0], [0.0], [1.0], [1.0]]]), how).ravel()
        >>> [round(float(x), 3) for x in edge]
        [0.0, -0.137, 1.137, 1.0]
    """

    sigma: Scalar = eqx.field(converter=as_float)
    amount: Scalar = eqx.field(converter=as_float)
    size: int = eqx.field(static=True, default=9, kw_only=True)

    def __check_init__(self) -> None:
        check_fields(self, sigma=POSITIVE, amount=FINITE)
        check_count("UnsharpMask.size", self.size, 1, odd=True)


class JPEG(Shown):
    """The errors that JPEG compression causes, without the file itself.

    Attributes:
        quality: () 1 to 100 on libjpeg's scale, no unit.
        subsampling: one of `SUBSAMPLINGS`, as in `development.jpeg`; static.
        rounding: one of `ROUNDINGS`, as in `development.jpeg`; static.

    Example:
        >>> how = jv.Development(compression=jv.JPEG(90.0))
        >>> grey = jnp.full((8, 8, 1), 128 / 255)  # the middle of the code, which loses nothing
        >>> round(float(jv.develop(grey, how)[3, 4, 0]) * 255, 3)
        128.0
    """

    quality: Scalar = eqx.field(converter=as_float)
    subsampling: str = eqx.field(static=True, default="4:2:0", kw_only=True)
    rounding: str = eqx.field(static=True, default="straight_through", kw_only=True)

    def __check_init__(self) -> None:
        check_fields(self, quality=Range(1, 100))
        check_choice("JPEG.subsampling", self.subsampling, SUBSAMPLINGS)
        check_choice("JPEG.rounding", self.rounding, ROUNDINGS)


class Development(Shown):
    """The steps from raw data to a picture, applied in the order of the fields. A step that is
    `None` is omitted.

    Attributes:
        black_level: () DN, subtracted first.
        white_level: () DN that becomes 1, above the black level; None leaves the picture in DN.
        demosaicing: interpolation from one band per pixel to all.
        white_balance: gains, or a method to estimate them.
        saturation: () > 0, the value at which the bands clip, in the unit after scaling (1 with a
            white level). After the gains are applied, highlights are clipped to neutral white, so a
            `white_balance` is needed.
        denoising: a filter of linear light.
        colour_matrix: (3, 3) no unit, from the camera's RGB to that of the picture.
        tone_map: a curve for linear light.
        tone: the encoding, `Gamma(2.2)` or `SRGB()`.
        sharpening: of the encoded picture.
        compression: loss of the file format.

    Example:
        >>> how = jv.Development(black_level=64.0, white_level=1088.0, tone=jv.SRGB())
        >>> round(float(jv.develop(jnp.array(576.0), how)), 4)  # of 512 / 1024
        0.7354
    """

    black_level: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    white_level: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    demosaicing: Demosaicing | None = eqx.field(default=None, kw_only=True)
    white_balance: WhiteBalancing | None = eqx.field(default=None, kw_only=True)
    saturation: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    denoising: Denoising | None = eqx.field(default=None, kw_only=True)
    colour_matrix: Float[Array, "3 3"] | None = eqx.field(
        converter=as_optional_float, default=None, kw_only=True
    )
    tone_map: ToneMap | None = eqx.field(default=None, kw_only=True)
    tone: ToneEncoding | None = eqx.field(default=None, kw_only=True)
    sharpening: UnsharpMask | None = eqx.field(default=None, kw_only=True)
    compression: JPEG | None = eqx.field(default=None, kw_only=True)

    def __check_init__(self) -> None:
        check_fields(self, black_level=FINITE, saturation=POSITIVE, colour_matrix=FINITE)
        black = 0.0 if self.black_level is None else self.black_level
        black = float(black) if is_known(black) else -np.inf
        check_range("Development.white_level", self.white_level, black, above=True)
        if self.saturation is not None and self.white_balance is None:
            raise ValueError("Development.white_balance must be given with saturation, got None.")
