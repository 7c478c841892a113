"""Calls for every family of BRDFs, and their directions."""

import jax.numpy as jnp
import numpy as np

from jaxvision import as_vec
from jaxvision.brdf import fresnel as fr
from jaxvision.brdf import specular
from jaxvision.brdf.blinn import Blinn, NormalisedBlinn
from jaxvision.brdf.coated import Coated
from jaxvision.brdf.dichromatic import Dichromatic
from jaxvision.brdf.eon import EON
from jaxvision.brdf.glass import Glass
from jaxvision.brdf.lambert import Lambert
from jaxvision.brdf.mirror import Mirror
from jaxvision.brdf.oren_nayar import OrenNayar
from jaxvision.brdf.phong import Phong
from jaxvision.brdf.torrance_sparrow import TorranceSparrow
from jaxvision.geometry.hemisphere import local_frame

RNG = np.random.default_rng(5)


def unit(*v):
    v = np.asarray(v, float)
    return jnp.asarray(v / np.linalg.norm(v))


N, WI, WO = unit(0.1, -0.2, 1), unit(0.5, 0.3, 0.9), unit(-0.4, -0.5, 0.8)
KD, KS, KA = jnp.asarray([0.2, 0.1]), jnp.asarray([0.3, 0.2]), jnp.asarray([0.5, 0.6])
X = jnp.asarray(RNG.uniform(0.1, 0.9, size=(2, 3, 2)))
COS, TWO = jnp.asarray(0.7), jnp.asarray(2.3)
U = jnp.asarray([0.3, 0.6, 0.9])
PHONG = Phong(KD, KS, 9.0, ambient=KA)
FRAME = local_frame(N)


ALPHA = jnp.asarray([0.3, 0.4])
BLINN = Blinn(KD, KS, 9.0)
FACETS = TorranceSparrow(KD, KS, ALPHA, interface=fr.Conductor([0.2, 0.5], [3.0, 2.0]))
GLAZED = Coated(Lambert(KD), fr.Dielectric([1.5]), 0.3, optical_depth=KA)
SHAFER = Dichromatic(Phong([0.1], [0.0], 1.0), NormalisedBlinn([0.0], [1.0], 9.0), KD, KS)
COLOURS = jnp.asarray(RNG.uniform(0.2, 0.8, (4, 5, 3)) * [1.0, 0.5, 0.3])
LIGHT = jnp.asarray([1.0, 0.9, 0.7])
RED = jnp.asarray([0.9, 0.25, 0.1])
PLANES = jnp.stack([unit(0.3, -0.8, 0.5), unit(-0.6, 0.1, 0.7), unit(0.5, 0.2, -0.9)])
GGX = {"distribution": "ggx"}
CLEAR = Glass(1.5, absorption=[0.2, 0.1])
WAYS = specular(CLEAR, WO)


def family(name, material, *functions):
    """Return one call of each of a family's functions."""
    calls = {
        "evaluate": (WI, WO),
        "shading": (WI, WO),
        "pdf": (WI, WO),
        "sample": (WO, U),
        "albedo": (WO,),
    }
    return {f"brdf.{name}.{call}": ((material, *calls[call]), {}) for call in functions}


SAMPLED = "evaluate", "sample", "pdf", "albedo"

EXAMPLES = {
    "brdf._registry.absorption": ((CLEAR,), {}),
    "brdf._registry.seen_in_mirror": ((Mirror(KD), WO), {}),
    "brdf._registry.specular": ((CLEAR, WO), {}),
    "brdf._specular.transmitted": ((WAYS,), {"carries": "radiance"}),
    "brdf.evaluation.reflect": ((PHONG, N, WI, WO), {"tangent": WI}),
    "brdf.evaluation.shading": ((PHONG, WI, WO), {}),
    "brdf.evaluation.evaluate": ((PHONG, WI, WO), {}),
    "brdf.evaluation.at_angles": ((PHONG, COS, TWO, COS, -COS), {}),
    "brdf.evaluation.sample": ((PHONG, WO, U), {}),
    "brdf.evaluation.pdf": ((PHONG, WI, as_vec(WO)), {}),
    "brdf.evaluation.albedo": ((PHONG, WO), {}),
    "brdf.lambert.lambert_shading": ((N, WI, KD), {}),
    **family("lambert", Lambert(KD), "evaluate", "albedo"),
    "brdf.mirror.specular": ((Mirror(KD), as_vec(WO)), {}),
    "brdf.phong.phong_lobe": ((-X, TWO), {}),
    "brdf.phong.phong_shading": ((N, WI, WO, KD, KS, TWO), {}),
    "brdf.phong.power_direction": ((N, TWO, U[:2]), {}),
    "brdf.phong.power_pdf": ((N, WI, TWO), {}),
    "brdf.phong.power_integrals": ((COS, TWO), {}),
    "brdf.gaussian_lobe.gaussian_lobe": ((X, TWO), {}),
    "brdf.gaussian_lobe.gaussian_lobe_shading": ((N, WI, WO, KD, KS, TWO), {}),
    "brdf.gaussian_lobe.squared_angle_between": ((WI, WO), {}),
    "brdf.gaussian_lobe.gaussian_integrals": ((COS, TWO), {}),
    "brdf.blinn.log_cos_half": ((WI, WO), {}),
    "brdf.blinn.normalisation": ((TWO,), {}),
    "brdf.blinn.half_vector_integrals": ((COS, TWO), {}),
    "brdf.fresnel.fresnel": ((fr.Schlick(KD), COS), {}),
    "brdf.fresnel.fresnel_dielectric": ((COS, 1 + KD), {}),
    "brdf.fresnel.fresnel_conductor": ((COS, KD, 10 * KS), {}),
    "brdf.fresnel.fresnel_schlick": ((COS, KD), {}),
    "brdf.microfacet.clamped_roughness": ((ALPHA,), {}),
    "brdf.microfacet.half_vector": ((WI, WO), {}),
    "brdf.microfacet.normal_distribution": ((N, ALPHA), GGX),
    "brdf.microfacet.hidden_cosine": ((WO, ALPHA), {"distribution": "beckmann"}),
    "brdf.microfacet.visibility": ((WI, WO, N, ALPHA), {**GGX, "shadowing": "smith"}),
    "brdf.microfacet.sample_facet": ((WO, ALPHA, U[:2]), {}),
    "brdf.microfacet.facet_pdf": ((WI, WO, ALPHA), {}),
    "brdf.torrance_sparrow.microfacet_lobe": ((FACETS, WI, WO), {}),
    **family("torrance_sparrow", FACETS, *SAMPLED),
    **family("oren_nayar", OrenNayar(KD, 0.4, form="full"), "evaluate"),
    **family("eon", EON(KD, 0.7), "evaluate", "albedo"),
    **family("coated", GLAZED, *SAMPLED),
    "brdf.fresnel.mean_reflectance": ((fr.Conductor([0.2, 0.5], [3.0, 2.0]),), {}),
    **family("dichromatic", SHAFER, "shading", *SAMPLED),
    "brdf.dichromatic_separation.usable_pixels": ((COLOURS,), {"dark": 0.1, "saturated": 0.7}),
    "brdf.dichromatic_separation.separate": (
        (COLOURS, LIGHT),
        {"body": jnp.asarray([0.9, 0.25, 0.1])},
    ),
    "brdf.dichromatic_separation.body_colour": ((COLOURS, LIGHT), {}),
    "brdf.dichromatic_separation.plane_normal": ((COLOURS,), {}),
    "brdf.dichromatic_separation.illuminant_from_planes": ((PLANES,), {}),
    "geometry.hemisphere.cross": ((WI, WO), {}),
    "geometry.hemisphere.local_frame": ((N,), {"tangent": WI}),
    "geometry.hemisphere.to_local": ((FRAME, WI), {}),
    "geometry.hemisphere.to_world": ((FRAME, WI), {}),
    "geometry.hemisphere.direction_at": ((COS, TWO), {}),
    "geometry.hemisphere.cosine_direction": ((U[:2],), {}),
    "geometry.hemisphere.cosine_pdf": ((WI,), {}),
    "geometry.hemisphere.uniform_direction": ((U[:2],), {}),
    "geometry.hemisphere.uniform_pdf": ((WI,), {}),
}
