# What `jaxvision.brdf` offers, each name where it is defined; see `jaxvision/__init__.pyi`.

from . import (
    blinn as blinn,
    coated as coated,
    dichromatic as dichromatic,
    eon as eon,
    gaussian_lobe as gaussian_lobe,
    glass as glass,
    half_difference as half_difference,
    lambert as lambert,
    measured as measured,
    mirror as mirror,
    oren_nayar as oren_nayar,
    phong as phong,
    rgl as rgl,
    torrance_sparrow as torrance_sparrow,
)
from ._registry import (
    absorption as absorption,
    families as families,
    is_body as is_body,
    is_delta as is_delta,
    lambertian as lambertian,
    register as register,
    register_delta as register_delta,
    seen_in_mirror as seen_in_mirror,
    specular as specular,
    suprema as suprema,
)
from ._specular import (
    Carries as Carries,
    Specular as Specular,
    draw_way as draw_way,
    transmitted as transmitted,
)
from .evaluation import (
    albedo as albedo,
    at_angles as at_angles,
    evaluate as evaluate,
    pdf as pdf,
    reflect as reflect,
    sample as sample,
    shading as shading,
)
