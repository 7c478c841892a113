"""The tables `[material.NAME]` of a scene file, by their `family`."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from ..toml_files import Entry, NonNegative, Positive
from .spectrum_schema import Spectrum


class Diffuse(Entry):
    """Fields of every material with a diffuse part; either `diffuse` or `albedo`.

    Attributes:
        diffuse: k_d in sr^-1.
        albedo: pi k_d, at most 1, no unit.
        ambient: k_a, no unit.
    """

    diffuse: Spectrum | None = None
    albedo: Spectrum | None = None
    ambient: Spectrum | None = None

    @model_validator(mode="after")
    def _one_of_both(self) -> "Diffuse":
        if (self.diffuse is None) == (self.albedo is None):
            raise ValueError("give either diffuse (sr^-1) or albedo (pi times it)")
        given = self.albedo if isinstance(self.albedo, tuple) else (self.albedo,)
        if any(isinstance(value, float) and value > 1 for value in given):
            raise ValueError("an albedo is at most 1: no surface reflects more than it receives")
        return self


class LambertEntry(Diffuse):
    """A diffuse surface.

    Attributes:
        family: "lambert".
    """

    family: Literal["lambert"]


class OrenNayarEntry(Diffuse):
    """A rough diffuse surface.

    Attributes:
        family: "oren_nayar".
        sigma: degrees, standard deviation of the slopes of the facets.
        form: "qualitative" or "full".
    """

    family: Literal["oren_nayar"]
    sigma: NonNegative
    form: Literal["qualitative", "full"] = "qualitative"


class PowerLobeEntry(Diffuse):
    """A surface with a Phong or Blinn lobe.

    Attributes:
        family: "phong" and "blinn" are textbook shading; the others are BRDFs.
        specular: k_s of the family's record.
        exponent: of the lobe, >= 0, no unit.
    """

    family: Literal[
        "phong", "phong_brdf", "normalised_phong", "blinn", "blinn_brdf", "normalised_blinn"
    ]
    specular: Spectrum
    exponent: NonNegative


class GaussianLobeEntry(Diffuse):
    """A surface with a Gaussian lobe.

    Attributes:
        family: "gaussian_lobe" is textbook shading, "gaussian_lobe_brdf" a BRDF.
        specular: k_s of the family's record.
        concentration: of the lobe, >= 0, as in the family's record.
    """

    family: Literal["gaussian_lobe", "gaussian_lobe_brdf"]
    specular: Spectrum
    concentration: NonNegative


class TorranceSparrowEntry(Diffuse):
    """A surface of microfacets, which reflect everything unless `eta` or `f0` is given.

    Attributes:
        family: "torrance_sparrow".
        specular: factor on the specular part, no unit.
        roughness: alpha, or one for each of two axes, no unit.
        eta: refractive index of a dielectric or, with `k`, of a metal.
        k: extinction coefficient of a metal, no unit.
        f0: reflectance along the normal (Schlick), no unit.
        distribution: "ggx" or "beckmann".
        shadowing: "smith" or "v-cavity".
    """

    family: Literal["torrance_sparrow"]
    specular: Spectrum = 1.0
    roughness: Positive | tuple[Positive, Positive]
    eta: Spectrum | None = None
    k: Spectrum | None = None
    f0: Spectrum | None = None
    distribution: Literal["ggx", "beckmann"] = "ggx"
    shadowing: Literal["smith", "v-cavity"] = "smith"

    @model_validator(mode="after")
    def _one_interface(self) -> "TorranceSparrowEntry":
        if self.f0 is not None and self.eta is not None:
            raise ValueError("give either eta (with k for a metal) or f0")
        if self.k is not None and self.eta is None:
            raise ValueError("k belongs to a metal; give its eta too")
        return self


class MirrorEntry(Entry):
    """A smooth mirror.

    Attributes:
        family: "mirror".
        reflectance: no unit.
    """

    family: Literal["mirror"]
    reflectance: Spectrum = 1.0


class GlassEntry(Entry):
    """Smooth glass.

    Attributes:
        family: "glass".
        index: refractive index.
        absorption: m^-1; absent for perfectly clear glass.
    """

    family: Literal["glass"]
    index: Positive = 1.5
    absorption: Spectrum | None = None


class MeasuredEntry(Entry):
    """A measured BRDF.

    Attributes:
        family: "measured".
        file: `.binary` (MERL), `.brdf` (Cornell) or `.bsdf` (RGL).
    """

    family: Literal["measured"]
    file: str


Material = Annotated[
    LambertEntry
    | OrenNayarEntry
    | PowerLobeEntry
    | GaussianLobeEntry
    | TorranceSparrowEntry
    | MirrorEntry
    | GlassEntry
    | MeasuredEntry,
    Field(discriminator="family"),
]
