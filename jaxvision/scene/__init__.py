"""The records: what emits, reflects, sees and measures light. No behaviour lives here.

Every record is a frozen pytree. Non-static leaves are arrays that keep the caller's floating
dtype; an effect that is absent is `None` and is never traced. Only shapes, kinds and algorithm
choices are static, so a sweep over exposure, gain or bit depth compiles once. SI units throughout;
world axes are right-handed. Shapes below are those of one record: a batch is a record whose leaves
were stacked along a leading axis, for `vmap`. A wrong shape raises `ValueError`.
"""

from .camera import Camera
from .developments import SRGB, Development, Gamma
from .light import AmbientLight, Light
from .sensors import (
    GaussianShotNoise,
    PhotonConversion,
    PoissonShotNoise,
    Sensor,
    ShotNoise,
)
from .shapes import Plane, Shape, Sphere
from .surfaces import Material, Scene, Surface
from .views import Orthographic, Pinhole, View

__all__ = [
    "SRGB",
    "AmbientLight",
    "Camera",
    "Development",
    "Gamma",
    "GaussianShotNoise",
    "Light",
    "Material",
    "Orthographic",
    "PhotonConversion",
    "Pinhole",
    "Plane",
    "PoissonShotNoise",
    "Scene",
    "Sensor",
    "Shape",
    "ShotNoise",
    "Sphere",
    "Surface",
    "View",
]
