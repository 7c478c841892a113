"""What turns raw numbers into a picture."""

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from .._types import (
    Colour,
    Scalar,
    as_float,
    as_optional_float,
    check_choice,
    check_count,
    check_kind,
    check_range,
    check_shape,
    check_tile,
    is_known,
)

DEMOSAICINGS = ("bilinear", "malvar", "menon", "normalised")
SUBSAMPLINGS = ("4:4:4", "4:2:0")
ROUNDINGS = ("straight_through", "cubic")
_LARGEST = float("inf")


class Demosaicing(eqx.Module):
    """How the bands that a pixel did not see are filled in.

    `pattern`: rows of band indices, the tile of the colour filter array, as `colour_filters.bayer`
    gives it. `method`: one of `DEMOSAICINGS`, which `development.demosaic` explains.
    """

    pattern: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    method: str = eqx.field(static=True, default="malvar", kw_only=True)

    def __check_init__(self) -> None:
        check_tile("Demosaicing.pattern", self.pattern)
        check_choice("Demosaicing.method", self.method, DEMOSAICINGS)


class WhiteBalance(eqx.Module):
    """Gains that are known. `gains`: (bands,) no unit."""

    gains: Colour = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_shape("WhiteBalance.gains", self.gains, ("bands",))
        check_range("WhiteBalance.gains", self.gains, 0, above=True)


class GreyWorld(eqx.Module):
    """Gains that make the picture grey on average. `norm`: () >= 1, of the mean: 1 is the grey
    world, 6 shades of grey."""

    norm: Scalar = eqx.field(converter=as_float, default=1.0)

    def __check_init__(self) -> None:
        check_shape("GreyWorld.norm", self.norm, ())
        check_range("GreyWorld.norm", self.norm, 1)


class NeutralPatch(eqx.Module):
    """Gains that make a rectangle of the picture grey. `rows`, `columns`: pixels from the first to
    before the last."""

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


class Bilateral(eqx.Module):
    """Smoothing within edges. `sigma_space`: () pixels. `sigma_range`: () in the picture's unit.
    `radius`: neighbours up to so many pixels away."""

    sigma_space: Scalar = eqx.field(converter=as_float)
    sigma_range: Scalar = eqx.field(converter=as_float)
    radius: int = eqx.field(static=True, default=3, kw_only=True)

    def __check_init__(self) -> None:
        check_shape("Bilateral.sigma_space", self.sigma_space, ())
        check_shape("Bilateral.sigma_range", self.sigma_range, ())
        check_range("Bilateral.sigma_space", self.sigma_space, 0, above=True)
        check_range("Bilateral.sigma_range", self.sigma_range, 0, above=True)
        check_count("Bilateral.radius", self.radius, 0)


class NonLocalMeans(eqx.Module):
    """Means of what looks alike. `strength`, `noise`: () in the picture's unit. `patch`: the side
    that is compared, odd pixels. `radius`: neighbours up to so many pixels away."""

    strength: Scalar = eqx.field(converter=as_float)
    noise: Scalar = eqx.field(converter=as_float, default=0.0)
    patch: int = eqx.field(static=True, default=5, kw_only=True)
    radius: int = eqx.field(static=True, default=6, kw_only=True)

    def __check_init__(self) -> None:
        check_shape("NonLocalMeans.strength", self.strength, ())
        check_shape("NonLocalMeans.noise", self.noise, ())
        check_range("NonLocalMeans.strength", self.strength, 0, above=True)
        check_range("NonLocalMeans.noise", self.noise, 0)
        check_count("NonLocalMeans.patch", self.patch, 1, odd=True)
        check_count("NonLocalMeans.radius", self.radius, 0)


Denoising = Bilateral | NonLocalMeans


class Reinhard(eqx.Module):
    """x / (1 + x). `white`: () relative, the least x that burns out to 1; None burns out none."""

    white: Scalar | None = eqx.field(converter=as_optional_float, default=None)

    def __check_init__(self) -> None:
        check_shape("Reinhard.white", self.white, ())
        check_range("Reinhard.white", self.white, 0, above=True)


class Filmic(eqx.Module):
    """The ACES film curve as `point_ops.filmic` has it."""


class ToneCurve(eqx.Module):
    """A monotone spline through points, at least two. `inputs`: (points,) ascending. `outputs`:
    (points,); both relative."""

    inputs: Float[Array, " points"] = eqx.field(converter=as_float)
    outputs: Float[Array, " points"] = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_shape("ToneCurve.inputs", self.inputs, ("points",))
        check_shape("ToneCurve.outputs", self.outputs, self.inputs.shape)
        check_count("the number of ToneCurve.inputs", self.inputs.size, 2)
        check_range("ToneCurve.inputs", self.inputs, -_LARGEST)
        check_range("ToneCurve.outputs", self.outputs, -_LARGEST)
        if is_known(self.inputs) and not (np.diff(self.inputs) > 0).all():
            raise ValueError(f"ToneCurve.inputs must ascend, got {np.asarray(self.inputs)}.")


ToneMap = Reinhard | Filmic | ToneCurve


class Gamma(eqx.Module):
    """Encoding by x ** (1 / gamma). `gamma`: () > 0, no unit."""

    gamma: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_shape("Gamma.gamma", self.gamma, ())
        check_range("Gamma.gamma", self.gamma, 0, above=True)


class SRGB(eqx.Module):
    """The piecewise sRGB encoding of IEC 61966-2-1."""


ToneEncoding = Gamma | SRGB


class UnsharpMask(eqx.Module):
    """Detail on top. `sigma`: () pixels, the scale of the detail. `amount`: () no unit. `size`: of
    the Gaussian in pixels, odd."""

    sigma: Scalar = eqx.field(converter=as_float)
    amount: Scalar = eqx.field(converter=as_float)
    size: int = eqx.field(static=True, default=9, kw_only=True)

    def __check_init__(self) -> None:
        check_shape("UnsharpMask.sigma", self.sigma, ())
        check_shape("UnsharpMask.amount", self.amount, ())
        check_range("UnsharpMask.sigma", self.sigma, 0, above=True)
        check_range("UnsharpMask.amount", self.amount, -_LARGEST)
        check_count("UnsharpMask.size", self.size, 1, odd=True)


class JPEG(eqx.Module):
    """The loss of a JPEG file. `quality`: () 1 to 100, libjpeg's. `subsampling`, `rounding`: of
    `SUBSAMPLINGS` and `ROUNDINGS`, as in `development.jpeg`."""

    quality: Scalar = eqx.field(converter=as_float)
    subsampling: str = eqx.field(static=True, default="4:2:0", kw_only=True)
    rounding: str = eqx.field(static=True, default="straight_through", kw_only=True)

    def __check_init__(self) -> None:
        check_shape("JPEG.quality", self.quality, ())
        check_range("JPEG.quality", self.quality, 1, 100)
        check_choice("JPEG.subsampling", self.subsampling, SUBSAMPLINGS)
        check_choice("JPEG.rounding", self.rounding, ROUNDINGS)


class Development(eqx.Module):
    """From raw to picture, in the order of the fields. `None` leaves a step out.

    `black_level`: () DN subtracted. `white_level`: () DN that becomes 1; None keeps DN.
    `demosaicing`: from one band a pixel to all. `white_balance`: gains, or how they are found.
    `saturation`: () where the bands end, in the unit after scaling (1 with a white level): cuts
    highlights after the gains to neutral white, so it needs a `white_balance`; None cuts nothing.
    `denoising`. `colour_matrix`:
    (3, 3) from the camera's RGB to that of the picture. `tone_map`: a curve on linear light.
    `tone`: `Gamma(2.2)` or `SRGB()`, the encoding. `sharpening` of the encoded picture.
    `compression`: what a file of it loses.
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
        for name in ("black_level", "white_level", "saturation"):
            check_shape(f"Development.{name}", getattr(self, name), ())
        check_shape("Development.colour_matrix", self.colour_matrix, (3, 3))
        for name, kinds in _RECORDS.items():
            check_kind(f"Development.{name}", getattr(self, name), kinds)
        check_range("Development.black_level", self.black_level, -_LARGEST)
        check_range("Development.saturation", self.saturation, 0, above=True)
        check_range("Development.colour_matrix", self.colour_matrix, -_LARGEST)
        black = 0.0 if self.black_level is None else self.black_level
        black = float(black) if is_known(black) else -_LARGEST
        check_range("Development.white_level", self.white_level, black, above=True)
        if self.saturation is not None and self.white_balance is None:
            raise ValueError(
                "Development.white_balance must be given where saturation is, got None."
            )


# The fields that hold records only.
_RECORDS = {
    "demosaicing": Demosaicing,
    "white_balance": WhiteBalancing,
    "denoising": Denoising,
    "tone_map": ToneMap,
    "tone": ToneEncoding,
    "sharpening": UnsharpMask,
    "compression": JPEG,
}
