"""Photometric image formation as pure JAX functions: from light to digital numbers, and the image
processing that follows.

Records and the functions of the path of light are here; image processing is in modules of its own:
`point_ops`, `colour_spaces`, `compositing`, `matting`, `histogram`, `filters`.
"""

from . import (
    brdf,
    colour_data,
    colour_spaces,
    compositing,
    filters,
    histogram,
    lights,
    matting,
    point_ops,
    spectra,
)
from ._types import (
    as_dtype,
)
from ._vector import (
    Vec,
    as_array,
    as_vec,
)
from .brdf import (
    reflect,
)
from .brdf.blinn import (
    Blinn,
    BlinnBRDF,
    NormalisedBlinn,
)
from .brdf.dichromatic import (
    Dichromatic,
)
from .brdf.dichromatic_separation import (
    Separation,
    separate,
)
from .brdf.fresnel import (
    Conductor,
    Dielectric,
    Schlick,
)
from .brdf.gaussian_lobe import (
    GaussianLobe,
    GaussianLobeBRDF,
    gaussian_lobe,
    gaussian_lobe_shading,
)
from .brdf.half_difference import (
    HalfDifferenceTable,
)
from .brdf.lambert import (
    Lambert,
    lambert_shading,
)
from .brdf.measured import (
    AnisotropicTable,
    BRDFSamples,
    IsotropicTable,
    sample_directions,
    samples_of,
)
from .brdf.mirror import (
    Mirror,
)
from .brdf.oren_nayar import (
    OrenNayar,
)
from .brdf.phong import (
    NormalisedPhong,
    Phong,
    PhongBRDF,
    phong_lobe,
    phong_shading,
)
from .brdf.rgl import (
    RGL,
)
from .brdf.torrance_sparrow import (
    TorranceSparrow,
)
from .capture import (
    Capture,
    capture,
    radiance_along,
    render,
    render_light_field,
)
from .develop import (
    develop,
    to_integers,
)
from .errors import (
    InputError,
)
from .geometry import (
    Hit,
    Ray,
    hit_shape,
    intersect,
    mirror_direction,
    nearest_shape,
)
from .hemisphere import (
    Frame,
    local_frame,
    to_local,
    to_world,
)
from .lights import (
    Balanced,
    DirectionalLight,
    EnvironmentMap,
    Incident,
    LightFieldLight,
    MonteCarlo,
    PointLight,
    Quadrature,
    RectangleLight,
    Window,
    environment_map,
    incident,
    incident_samples,
    irradiance,
)
from .lights.light_field import (
    refocus,
)
from .lights.orders import (
    order_for,
)
from .lights.polygon import (
    rectangle_irradiance,
)
from .measured_files import (
    read_measured,
)
from .optics import (
    camera_ray,
    look_at,
    sensor_irradiance,
)
from .point_ops import (
    gain_bias,
    gamma_decode,
    gamma_encode,
    srgb_decode,
    srgb_encode,
)
from .scene import (
    SRGB,
    AmbientLight,
    Camera,
    Development,
    Gamma,
    GaussianShotNoise,
    Light,
    Material,
    Orthographic,
    PhotonConversion,
    Pinhole,
    Plane,
    PoissonShotNoise,
    Scene,
    Sensor,
    Sphere,
    Surface,
)
from .sensor import (
    collect,
    digitise,
    expected_signal,
    mean_photoelectrons,
    pattern_variance,
    photon_rate,
    raw_image,
    signal_variance,
)
from .shading import (
    Estimate,
    hemisphere_radiance,
    lit_radiance,
    outgoing_radiance,
    sampled_radiance,
)

__version__ = "0.1.0"

__all__ = [
    "RGL",
    "SRGB",
    "AmbientLight",
    "AnisotropicTable",
    "BRDFSamples",
    "Balanced",
    "Blinn",
    "BlinnBRDF",
    "Camera",
    "Capture",
    "Conductor",
    "Development",
    "Dichromatic",
    "Dielectric",
    "DirectionalLight",
    "EnvironmentMap",
    "Estimate",
    "Frame",
    "Gamma",
    "GaussianLobe",
    "GaussianLobeBRDF",
    "GaussianShotNoise",
    "HalfDifferenceTable",
    "Hit",
    "Incident",
    "InputError",
    "IsotropicTable",
    "Lambert",
    "Light",
    "LightFieldLight",
    "Material",
    "Mirror",
    "MonteCarlo",
    "NormalisedBlinn",
    "NormalisedPhong",
    "OrenNayar",
    "Orthographic",
    "Phong",
    "PhongBRDF",
    "PhotonConversion",
    "Pinhole",
    "Plane",
    "PointLight",
    "PoissonShotNoise",
    "Quadrature",
    "Ray",
    "RectangleLight",
    "Scene",
    "Schlick",
    "Sensor",
    "Separation",
    "Sphere",
    "Surface",
    "TorranceSparrow",
    "Vec",
    "Window",
    "as_array",
    "as_dtype",
    "as_vec",
    "brdf",
    "camera_ray",
    "capture",
    "collect",
    "colour_data",
    "colour_spaces",
    "compositing",
    "develop",
    "digitise",
    "environment_map",
    "expected_signal",
    "filters",
    "gain_bias",
    "gamma_decode",
    "gamma_encode",
    "gaussian_lobe",
    "gaussian_lobe_shading",
    "hemisphere_radiance",
    "histogram",
    "hit_shape",
    "incident",
    "incident_samples",
    "intersect",
    "irradiance",
    "lambert_shading",
    "lights",
    "lit_radiance",
    "local_frame",
    "look_at",
    "matting",
    "mean_photoelectrons",
    "mirror_direction",
    "nearest_shape",
    "order_for",
    "outgoing_radiance",
    "pattern_variance",
    "phong_lobe",
    "phong_shading",
    "photon_rate",
    "point_ops",
    "radiance_along",
    "raw_image",
    "read_measured",
    "rectangle_irradiance",
    "reflect",
    "refocus",
    "render",
    "render_light_field",
    "sample_directions",
    "sampled_radiance",
    "samples_of",
    "sensor_irradiance",
    "separate",
    "signal_variance",
    "spectra",
    "srgb_decode",
    "srgb_encode",
    "to_integers",
    "to_local",
    "to_world",
]
