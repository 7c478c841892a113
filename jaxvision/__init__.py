"""Photometric image formation as pure JAX functions: from light to digital numbers."""

from ._types import as_dtype
from ._vector import Vec, as_array, as_vec
from .brdf import reflect
from .brdf.gaussian_lobe import GaussianLobe, gaussian_lobe, gaussian_lobe_shading
from .brdf.lambert import Lambert, lambert_shading
from .brdf.phong import Phong, phong_lobe, phong_shading
from .capture import Capture, capture, radiance_along, render
from .develop import develop, to_integers
from .errors import InputError
from .geometry import Hit, Ray, hit_shape, intersect, mirror_direction, nearest_shape
from .lights import (
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
)
from .optics import camera_ray, look_at, sensor_irradiance
from .point_ops import gain_bias, gamma_decode, gamma_encode, srgb_decode, srgb_encode
from .scene import (
    SRGB,
    AmbientLight,
    Camera,
    Development,
    Gamma,
    GaussianShotNoise,
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
from .shading import outgoing_radiance

__version__ = "0.1.0"

__all__ = [
    "SRGB",
    "AmbientLight",
    "Camera",
    "Capture",
    "Development",
    "DirectionalLight",
    "EnvironmentMap",
    "Gamma",
    "GaussianLobe",
    "GaussianShotNoise",
    "Hit",
    "Incident",
    "InputError",
    "Lambert",
    "LightFieldLight",
    "MonteCarlo",
    "Orthographic",
    "Phong",
    "PhotonConversion",
    "Pinhole",
    "Plane",
    "PointLight",
    "PoissonShotNoise",
    "Quadrature",
    "Ray",
    "RectangleLight",
    "Scene",
    "Sensor",
    "Sphere",
    "Surface",
    "Vec",
    "Window",
    "as_array",
    "as_dtype",
    "as_vec",
    "camera_ray",
    "capture",
    "collect",
    "develop",
    "digitise",
    "environment_map",
    "expected_signal",
    "gain_bias",
    "gamma_decode",
    "gamma_encode",
    "gaussian_lobe",
    "gaussian_lobe_shading",
    "hit_shape",
    "incident",
    "incident_samples",
    "intersect",
    "lambert_shading",
    "look_at",
    "mean_photoelectrons",
    "mirror_direction",
    "nearest_shape",
    "outgoing_radiance",
    "pattern_variance",
    "phong_lobe",
    "phong_shading",
    "photon_rate",
    "radiance_along",
    "raw_image",
    "reflect",
    "render",
    "sensor_irradiance",
    "signal_variance",
    "srgb_decode",
    "srgb_encode",
    "to_integers",
]
