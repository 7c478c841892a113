"""The records: what emits, reflects, sees and measures light. No behaviour lives here.

Every record is a frozen pytree. Non-static leaves are arrays that keep the caller's floating
dtype; an effect that is absent is `None` and is never traced. Only shapes, kinds and algorithm
choices are static, so a sweep over exposure, gain or bit depth compiles once. SI units throughout;
world axes are right-handed. Shapes below are those of one record: a batch is a record whose leaves
were stacked along a leading axis, for `vmap`. A wrong shape raises `ValueError`.
"""

import equinox as eqx
from jaxtyping import Array, Float

from ._types import Colour, Scalar, as_float, as_optional_float, check_shape

# ---------------------------------------------------------------- light


class Light(eqx.Module):
    """What shines: the base of every kind of light, whose record and equations share a file in
    `lights/`."""


class AmbientLight(eqx.Module):
    """The same light from everywhere, the L_a of Phong shading.

    `radiance`: (bands,) W m^-2 sr^-1, a colour of its own.
    """

    radiance: Colour = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_shape("AmbientLight.radiance", self.radiance, ("bands",))


# ---------------------------------------------------------------- surface


class Sphere(eqx.Module):
    """`centre`: (3,) m. `radius`: () m, positive."""

    centre: Float[Array, "3"] = eqx.field(converter=as_float)
    radius: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_shape("Sphere.centre", self.centre, (3,))
        check_shape("Sphere.radius", self.radius, ())


class Plane(eqx.Module):
    """An unbounded plane, seen and lit on the side its normal points to.

    `point`: (3,) m, any point of it. `normal`: (3,) unit vector (its length is ignored).
    """

    point: Float[Array, "3"] = eqx.field(converter=as_float)
    normal: Float[Array, "3"] = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_shape("Plane.point", self.point, (3,))
        check_shape("Plane.normal", self.normal, (3,))


Shape = Sphere | Plane


class Material(eqx.Module):
    """What a surface is made of: the base of every family of BRDFs, whose record and equations
    share a file in `brdf/`."""


class Surface(eqx.Module):
    """A shape and what it is made of."""

    shape: Shape
    material: Material


class Scene(eqx.Module):
    """Surfaces and the lights on them. All spectra share one number of bands, which is checked
    here for the k_d of materials and for lights."""

    surfaces: tuple[Surface, ...] = eqx.field(converter=tuple)
    lights: tuple[Light, ...] = eqx.field(converter=tuple)
    ambient: AmbientLight | None = None

    def __check_init__(self) -> None:
        if not self.surfaces:
            raise ValueError("Scene.surfaces must hold at least one surface, got none.")
        spectra = {
            f"Scene.surfaces[{i}].material.diffuse": getattr(surface.material, "diffuse", None)
            for i, surface in enumerate(self.surfaces)
        }
        for i, light in enumerate(self.lights):
            for field in ("intensity", "irradiance", "radiance"):
                spectra[f"Scene.lights[{i}].{field}: its spectrum"] = getattr(light, field, None)
        spectra["Scene.ambient.radiance"] = getattr(self.ambient, "radiance", None)
        bands = {name: x.shape[-1:] for name, x in spectra.items() if x is not None}
        for name, got in bands.items():
            first = next(iter(bands.values()))
            if got != first:
                raise ValueError(f"{name} must have {first[0]} bands, got {got[0]}.")


# ---------------------------------------------------------------- camera


class Orthographic(eqx.Module):
    """Parallel (telecentric) projection.

    `position`: (3,) m, the centre of the picture. `rotation`: (3, 3), rows the unit axes right,
    down and forward of the camera in the world. `pixel_pitch`: () m between pixels, in the scene.
    `resolution`: (rows, columns), static. `f_number`: () image-side, or None: radiance is handed
    on as it is.
    """

    position: Float[Array, "3"] = eqx.field(converter=as_float)
    rotation: Float[Array, "3 3"] = eqx.field(converter=as_float)
    pixel_pitch: Scalar = eqx.field(converter=as_float)
    resolution: tuple[int, int] = eqx.field(static=True, kw_only=True)
    f_number: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)

    def __check_init__(self) -> None:
        _check_view(self)


class Pinhole(eqx.Module):
    """Central projection through a small hole.

    `position`: (3,) m, the hole. `rotation`: (3, 3), rows the unit axes right, down and forward of
    the camera in the world. `focal_length`: () m from the hole to the sensor. `pixel_pitch`: () m
    between pixels, on the sensor. `resolution`: (rows, columns), static. `f_number`: () focal
    length over hole diameter, or None: radiance is handed on as it is.
    """

    position: Float[Array, "3"] = eqx.field(converter=as_float)
    rotation: Float[Array, "3 3"] = eqx.field(converter=as_float)
    focal_length: Scalar = eqx.field(converter=as_float)
    pixel_pitch: Scalar = eqx.field(converter=as_float)
    resolution: tuple[int, int] = eqx.field(static=True, kw_only=True)
    f_number: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)

    def __check_init__(self) -> None:
        _check_view(self)
        check_shape("Pinhole.focal_length", self.focal_length, ())


View = Orthographic | Pinhole


def _check_view(view: View) -> None:
    name = type(view).__name__
    check_shape(f"{name}.position", view.position, (3,))
    check_shape(f"{name}.rotation", view.rotation, (3, 3))
    check_shape(f"{name}.pixel_pitch", view.pixel_pitch, ())
    check_shape(f"{name}.f_number", view.f_number, ())
    if len(view.resolution) != 2 or min(view.resolution) < 1:
        raise ValueError(f"{name}.resolution must be (rows, columns) >= 1, got {view.resolution}.")


class PhotonConversion(eqx.Module):
    """What turns irradiance into photons: mu_p = lambda E A t / (h c), EMVA 1288.

    `wavelength`: () or (bands,) m. `pixel_area`: () m^2.
    """

    wavelength: Scalar | Colour = eqx.field(converter=as_float)
    pixel_area: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_shape("PhotonConversion.wavelength", self.wavelength, (), ("bands",))
        check_shape("PhotonConversion.pixel_area", self.pixel_area, ())


class PoissonShotNoise(eqx.Module):
    """Electrons are counted: a Poisson draw replaces the mean."""


class GaussianShotNoise(eqx.Module):
    """A Gaussian of variance equal to the mean, many times faster to draw than a Poisson; good
    from about 20 electrons up, and below that it can go negative."""


ShotNoise = PoissonShotNoise | GaussianShotNoise


class Sensor(eqx.Module):
    """A linear image sensor after EMVA 1288. Every effect is optional; `None` leaves it out.

    `photon_conversion`: None takes the input as photons per pixel and second already.
    `exposure_time`: () s; None takes rates as counts per exposure.
    `quantum_efficiency`: () or (bands,) electrons per photon.
    `prnu`: () relative rms of the pixels' sensitivities.
    `dark_current`: () e- s^-1 per pixel; its electrons are counted with those of the light, so
    they have shot noise if any have.
    `shot_noise`: how counting is drawn.
    `full_well`: () e- a pixel holds.
    `dsnu`: () e- rms of the pixels' offsets.
    `read_noise`: () e- rms per read-out.
    `gain`: () DN per e-. `offset`: () DN added before conversion (the black level).
    `bits`: () of the ADC, up to 16: rounds to whole DN and clips to [0, 2^bits - 1].
    """

    photon_conversion: PhotonConversion | None = eqx.field(default=None, kw_only=True)
    exposure_time: Scalar | None = eqx.field(
        converter=as_optional_float, default=None, kw_only=True
    )
    quantum_efficiency: Scalar | Colour | None = eqx.field(
        converter=as_optional_float, default=None, kw_only=True
    )
    prnu: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    dark_current: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    shot_noise: ShotNoise | None = eqx.field(default=None, kw_only=True)
    full_well: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    dsnu: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    read_noise: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    gain: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    offset: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    bits: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)

    def __check_init__(self) -> None:
        check_shape("Sensor.quantum_efficiency", self.quantum_efficiency, (), ("bands",))
        for name in ("exposure_time", "prnu", "dark_current", "full_well", "dsnu", "read_noise"):
            check_shape(f"Sensor.{name}", getattr(self, name), ())
        for name in ("gain", "offset", "bits"):
            check_shape(f"Sensor.{name}", getattr(self, name), ())


class Gamma(eqx.Module):
    """Encoding by x ** (1 / gamma). `gamma`: () > 0, no unit."""

    gamma: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_shape("Gamma.gamma", self.gamma, ())


class SRGB(eqx.Module):
    """The piecewise sRGB encoding of IEC 61966-2-1."""


class Development(eqx.Module):
    """From raw to picture. `None` leaves a step out.

    `black_level`: () DN subtracted. `white_level`: () DN that becomes 1; None keeps DN.
    `tone`: `Gamma(2.2)` or `SRGB()`, applied to the scaled values.
    """

    black_level: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    white_level: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    tone: Gamma | SRGB | None = eqx.field(default=None, kw_only=True)

    def __check_init__(self) -> None:
        check_shape("Development.black_level", self.black_level, ())
        check_shape("Development.white_level", self.white_level, ())


class Camera(eqx.Module):
    """What it sees, how it measures, and how its raw data become a picture (None: they do not)."""

    view: View
    sensor: Sensor
    development: Development | None = None
