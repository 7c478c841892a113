"""The steps that turn raw data into a picture."""

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from .._shown import Shown
from .._types import (
    FINITE,
    NOT_NEGATIVE,
    POSITIVE,
    Colour,
    Range,
    Scalar,
    as_float,
    as_optional_float,
    check_choice,
    check_count,
    check_fields,
    check_range,
    check_tile,
    is_known,
)

DEMOSAICINGS = ("bilinear", "malvar", "menon", "normalised")
SUBSAMPLINGS = ("4:4:4", "4:2:0")
ROUNDINGS = ("straight_through", "cubic")


class Demosaicing(Shown):
    """Interpolation of the bands that a pixel of a mosaic sensor does not measure.

    Attributes:
        pattern: rows of band indices, the tile of the colour filter array, as
            `colour_filters.bayer` gives it; static.
        method: one of `DEMOSAICINGS`, described in `development.demosaic`; static.
    """

    pattern: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    method: str = eqx.field(static=True, default="malvar", kw_only=True)

    def __check_init__(self) -> None:
        check_tile("Demosaicing.pattern", self.pattern)
        check_choice("Demosaicing.method", self.method, DEMOSAICINGS)


class WhiteBalance(Shown):
    """White balance by known gains.

    Attributes:
        gains: (bands,) no unit, > 0.
    """

    gains: Colour = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, gains=POSITIVE)


class GreyWorld(Shown):
    """White balance whose gains make the picture grey on average.

    Attributes:
        norm: () exponent >= 1 of the mean, no unit: 1 is the grey world, 6 shades of grey.
    """

    norm: Scalar = eqx.field(converter=as_float, default=1.0)

    def __check_init__(self) -> None:
        check_fields(self, norm=Range(1))


class NeutralPatch(Shown):
    """White balance whose gains make a rectangle of the picture grey.

    Attributes:
        rows: (first, last) pixels, the last one excluded; static.
        columns: (first, last) pixels, the last one excluded; static.
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


class Bilateral(Shown):
    """Denoising by a bilateral filter, which preserves edges.

    Attributes:
        sigma_space: () pixels, > 0.
        sigma_range: () > 0, in the picture's unit.
        radius: of the neighbourhood in pixels, >= 0; static.
    """

    sigma_space: Scalar = eqx.field(converter=as_float)
    sigma_range: Scalar = eqx.field(converter=as_float)
    radius: int = eqx.field(static=True, default=3, kw_only=True)

    def __check_init__(self) -> None:
        check_fields(self, sigma_space=POSITIVE, sigma_range=POSITIVE)
        check_count("Bilateral.radius", self.radius, 0)


class NonLocalMeans(Shown):
    """Denoising by averages over similar patches.

    Attributes:
        strength: () > 0, in the picture's unit.
        noise: () standard deviation of the noise >= 0, in the picture's unit.
        patch: side of the compared patches in pixels, odd; static.
        radius: of the neighbourhood in pixels, >= 0; static.
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


class Reinhard(Shown):
    """Tone mapping by x / (1 + x).

    Attributes:
        white: () relative, > 0: the least x that is mapped to 1; None maps only infinity to 1.
    """

    white: Scalar | None = eqx.field(converter=as_optional_float, default=None)

    def __check_init__(self) -> None:
        check_fields(self, white=POSITIVE)


class Filmic(Shown):
    """Tone mapping by the ACES film curve, `point_ops.filmic`."""


class ToneCurve(Shown):
    """Tone mapping by a monotone spline through given points.

    Attributes:
        inputs: (points,) relative, strictly ascending, at least two.
        outputs: (points,) relative.
    """

    inputs: Float[Array, " points"] = eqx.field(converter=as_float)
    outputs: Float[Array, " points"] = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, inputs=FINITE, outputs=FINITE)
        check_count("the number of ToneCurve.inputs", self.inputs.size, 2)
        if is_known(self.inputs) and not (np.diff(self.inputs) > 0).all():
            raise ValueError(f"ToneCurve.inputs must ascend, got {np.asarray(self.inputs)}.")


ToneMap = Reinhard | Filmic | ToneCurve


class Gamma(Shown):
    """Encoding by x ** (1 / gamma).

    Attributes:
        gamma: () > 0, no unit.
    """

    gamma: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, gamma=POSITIVE)


class SRGB(Shown):
    """The piecewise sRGB encoding of IEC 61966-2-1."""


ToneEncoding = Gamma | SRGB


class UnsharpMask(Shown):
    """Sharpening by an unsharp mask.

    Attributes:
        sigma: () pixels, > 0: the scale of the sharpened detail.
        amount: () no unit.
        size: side of the Gaussian in pixels, odd; static.
    """

    sigma: Scalar = eqx.field(converter=as_float)
    amount: Scalar = eqx.field(converter=as_float)
    size: int = eqx.field(static=True, default=9, kw_only=True)

    def __check_init__(self) -> None:
        check_fields(self, sigma=POSITIVE, amount=FINITE)
        check_count("UnsharpMask.size", self.size, 1, odd=True)


class JPEG(Shown):
    """The loss of JPEG compression.

    Attributes:
        quality: () 1 to 100 on libjpeg's scale, no unit.
        subsampling: one of `SUBSAMPLINGS`, as in `development.jpeg`; static.
        rounding: one of `ROUNDINGS`, as in `development.jpeg`; static.
    """

    quality: Scalar = eqx.field(converter=as_float)
    subsampling: str = eqx.field(static=True, default="4:2:0", kw_only=True)
    rounding: str = eqx.field(static=True, default="straight_through", kw_only=True)

    def __check_init__(self) -> None:
        check_fields(self, quality=Range(1, 100))
        check_choice("JPEG.subsampling", self.subsampling, SUBSAMPLINGS)
        check_choice("JPEG.rounding", self.rounding, ROUNDINGS)


class Development(Shown):
    """The steps from raw data to a picture, in the order of the fields; `None` leaves a step out.

    Attributes:
        black_level: () DN, subtracted.
        white_level: () DN that becomes 1, above the black level; None keeps DN.
        demosaicing: from one band per pixel to all.
        white_balance: gains, or how they are estimated.
        saturation: () > 0, the level at which the bands clip, in the unit after scaling (1 with a
            white level): clips highlights to neutral white after the gains, so it needs a
            `white_balance`.
        denoising: a filter on linear light.
        colour_matrix: (3, 3) no unit, from the camera's RGB to that of the picture.
        tone_map: a curve on linear light.
        tone: the encoding, `Gamma(2.2)` or `SRGB()`.
        sharpening: of the encoded picture.
        compression: the loss of its file.
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
