"""The composition of all stages: scene -> radiance -> irradiance -> raw -> picture.

Radiance is in W m^-2 sr^-1, irradiance in W m^-2, raw data in DN, and pictures are relative to
white.
"""

import math
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from .core._arguments import takes_numbers, warn_caller
from .core._shown import Shown
from .core._types import Image, Key, Scalar, check_given, is_known, print_by_name
from .core.in_notebooks import picture_html, preview_png
from .development import develop
from .effects import Certificate, Pruned, Tolerance, prune
from .effects.pruning import WORTH, looking_pays
from .errors import shorten
from .lights import Quadrature, Rule
from .optics import sensor_irradiance
from .programs import targets_cpu
from .rendering import Edges, PixelSamples, Traced, render
from .rendering.band_count import band_count
from .rendering.shading import DEFAULT_RULE
from .scene import Camera, PixelAperture, Scene, Sensor, View
from .sensor import exposed, pixel_means, raw_image
from .transport import Paths, path_traced

Motion = Callable[[Scene, View, Scalar], tuple[Scene, View]]
Renderer = Callable[[Scene, View], Image]
print_by_name(globals(), "Motion", "Renderer")

DARKEST = 0.01  # photons per exposure on the brightest pixel; fewer indicate a wrong unit
# Separates the random numbers of paths from those that a sensor draws with this key
_OF_PATHS = 0x70617468


class Capture(Shown):
    """All stages of one picture, from radiance to the developed picture.

    Attributes:
        radiance: (h, w, bands) W m^-2 sr^-1 seen by each pixel.
        irradiance: (h, w, bands) W m^-2 on the sensor.
        raw: (h, w, bands) DN; (h, w, 1) under a colour filter.
        picture: (h, w, colours) developed, relative to white; None for a camera without
            development.
        certificate: record of the removed effects, if a tolerance was given or effects were
            removed; otherwise None; static.
        error: (h, w, bands) W m^-2 sr^-1, the standard error of the radiance, for independent
            samples, if the integrator is `Paths` with more than one sample. None for other
            integrators, with a motion, and if the pixel aperture is oversampled.

    Example:
        >>> lamp = jv.Surface(jv.Plane([0, 0, 9], [0, 0, -1]), jv.Lambert([0.0]), [4 / np.pi])
        >>> view = jv.Pinhole([0, 0, 0], np.eye(3), 0.05, 1e-5, resolution=(1, 1), f_number=2.0)
        >>> shot = jv.capture(None, jv.Scene(lamp, []), jv.Camera(view, jv.Sensor(gain=8.0)))
        >>> [round(float(x[0, 0, 0]), 4) for x in (shot.radiance, shot.irradiance, shot.raw)]
        [1.2732, 0.25, 2.0]
    """

    radiance: Image
    irradiance: Image
    raw: Float[Array, "*batch h w channels"]
    picture: Float[Array, "*batch h w colours"] | None
    certificate: Certificate | None = eqx.field(static=True, default=None)
    error: Image | None = None

    def _repr_html_(self) -> str:
        """Return HTML for a notebook: the developed picture, or the raw values in grey, with the
        table of fields.
        """
        table = super()._repr_html_()
        if not is_known(self.raw) or not np.size(self.raw):
            return table
        return picture_html(preview_png(_preview(self)), table, meaning="preview")


@takes_numbers
def capture(
    key: Key | None,
    scene: Scene,
    camera: Camera,
    *,
    die_key: Key | None = None,
    rule: Rule = DEFAULT_RULE,
    samples: PixelSamples | None = None,
    edges: Edges | None = None,
    motion: Motion | None = None,
    moments: int = 8,
    tolerance: Tolerance | str | None = None,
    integrator: Paths | Renderer | None = None,
    keep_all: bool = False,
) -> Capture:
    """Take one picture of the scene, and return every stage.

    Derivatives with respect to positions of a lamp, the camera or a shape neglect moving edges of
    shadows and outlines, unless `edges` are given, as in `render`.

    Args:
        key: random key for everything that differs between frames; None if the sensor needs no key.
        scene: in front of the camera.
        camera: view, sensor and development.
        die_key: random key for the fixed pattern of this camera; None if the sensor has no fixed
            pattern.
        rule: sampling rule of extended lights without their own, as in `render`.
        samples: rays of each pixel, whose mean is taken, as in `render`; a thin lens needs it for
            defocus.
        edges: moving edges in derivatives of direct light, as in `render`; None neglects them.
        motion: function of a time in s after the start of the first row's exposure, and of the
            scene and view at rest; it returns the scene and view at that time. None for no motion.
            The sensor must have an exposure time.
        moments: static, number of times during the exposure at which a motion is rendered;
            `sensor.exposure_slots` places them.
        tolerance: largest change of the raw values by removed effects, as in `effects.prune`, such
            as "0.5DN" or "0.1sigma"; outside of `jit` only. Radiance and irradiance then contain
            the kept bands only. None removes only effects that are proved to change nothing, and
            only if the search for them takes little time: on a processor, for a large picture of a
            scene at rest, under direct light by quadrature. If the scene is an argument of a jitted
            function, nothing is removed, because the numbers of the scene are then unknown.
        integrator: static; the method that computes radiance. None for direct light, by `render`.
            `Paths` for reflected light as well; its paths are drawn by `key`, the same for every
            moment of a motion. Or any function of scene and view, such as one that calls
            `ray_traced` or `radiosity_image`.
        keep_all: static; whether to remove nothing if `tolerance` is None.

    Returns:
        Radiance, irradiance, raw values and the developed picture; where effects were removed, also
        their certificate.

    Raises:
        ValueError: for a key that is missing, a motion without exposure time, and a thin lens
            without samples, unless its f_number is inf or traced; for traced records with a
            tolerance; for samples or edges together with an integrator, or a tolerance with an
            integrator that is a function. Bands of scene and sensor that differ, and a missing key
            (unless the integrator is a function), are reported before rendering.

    Example:
        A grey room that shines everywhere: its walls show themselves, and one another.

        >>> wall = jv.Lambert([0.5 / np.pi])
        >>> room = jv.Scene(jv.Surface(jv.Sphere([0, 0, 0], 1), wall, [0.5], two_sided=True), [])
        >>> view = jv.Pinhole([0, 0, 0], np.eye(3), 1.0, 0.1, resolution=(2, 2))
        >>> paths = jv.Paths(samples=4, depth=20, strategy="surfaces")
        >>> camera = jv.Camera(view, jv.Sensor(gain=100.0))
        >>> shot = jv.capture(jax.random.key(0), room, camera, integrator=paths)
        >>> print(shot.raw.round(1).ravel())
        [100. 100. 100. 100.]
    """
    check_given("capture: scene", scene, Scene)
    check_given("capture: camera", camera, Camera)
    _check_bands(_bands(scene), camera.sensor)
    finds_radiance = isinstance(integrator, Paths) or callable(integrator)
    if integrator is not None and (not finds_radiance or isinstance(integrator, type)):
        raise ValueError(
            "integrator must be Paths(samples, depth), a function of scene and view, or None, got "
            f"{shorten(integrator)}."
        )
    if integrator is not None and samples is not None:
        raise ValueError("samples are of direct light: an integrator brings its own, leave them.")
    if integrator is not None and edges is not None:
        raise ValueError("edges are of direct light: leave them out with an integrator.")
    if motion is None and moments != 8:
        warn_caller("capture: moments has no effect without a motion; leave it out.")
    certificate = threshold = None
    if tolerance is not None:
        if not (integrator is None or isinstance(integrator, Paths)):
            raise ValueError("a tolerance bounds what None or Paths render, got a function.")
        depth = None if integrator is None else integrator.depth
        asked = {"samples": samples, "motion": motion, "moments": moments, "depth": depth}
        pruned = prune(scene, camera, tolerance, **asked)
        assert isinstance(pruned.camera, Camera)
        scene, camera, samples = pruned.scene, pruned.camera, pruned.samples
        if isinstance(integrator, Paths) and pruned.depth is not None:
            integrator = replace(integrator, depth=pruned.depth)
        motion = None if pruned.moments is None else motion
        certificate, threshold = pruned.certificate, pruned.threshold
    elif not keep_all and integrator is None and motion is None:
        pruned = _prune_losslessly(scene, camera, rule, samples)
        if pruned is not None:
            assert isinstance(pruned.camera, Camera)
            scene, camera, samples = pruned.scene, pruned.camera, pruned.samples
            certificate = pruned.certificate
    if integrator is None or isinstance(integrator, Paths):
        _check_keys(key, die_key, camera, _bands(scene))
    renderer = _renderer(integrator, key, rule, samples, edges, threshold)
    radiance, irradiance, error = _light_on_sensor(renderer, scene, camera, motion, moments)
    _check_unit(camera, irradiance)
    raw = raw_image(key, camera.sensor, irradiance, die_key=die_key)
    picture = None if camera.development is None else develop(raw, camera.development)
    return Capture(radiance, irradiance, raw, picture, certificate, error)


def _prune_losslessly(
    scene: Scene, camera: Camera, rule: Rule, samples: PixelSamples | None
) -> Pruned | None:
    """Return the scene and camera without the parts that are proved not to change the picture.
    Return None if the search would take more than a twentieth of the picture's time, or if it saves
    little.
    """
    if not isinstance(rule, Quadrature) or scene.rules is not None or not targets_cpu():
        return None
    if not all(map(is_known, jax.tree.leaves((scene, camera)))):
        return None
    aperture = camera.sensor.pixel_aperture
    finer = 1 if aperture is None else aperture.oversampling**2
    rays = math.prod(camera.view.resolution) * finer * (1 if samples is None else samples.count)
    if not looking_pays(scene, rays=rays, nodes=rule.order**2):
        return None
    pruned = prune(scene, camera, Tolerance(0.0, "DN"), samples=samples)
    whole = _bands(pruned.scene) == _bands(scene)  # the radiance keeps its shape
    return pruned if whole and pruned.certificate.saves > WORTH else None


def _preview(shot: Capture) -> np.ndarray:
    """Return a preview (h, w, 1 or 3) of the first picture of a batch: the developed picture if it
    is RGB, else the mean of the bands, scaled from its minimum to its maximum.
    """
    seen = np.asarray(shot.raw if shot.picture is None else shot.picture, float)
    seen = np.nan_to_num(seen.reshape(-1, *seen.shape[-3:])[0], posinf=0, neginf=0)
    if shot.picture is None or seen.shape[2] != 3:
        seen = seen.mean(axis=2, keepdims=True)
        seen = (seen - seen.min()) / (np.ptp(seen) or 1)
    return seen


def _bands(scene: Scene) -> int:
    materials = [surface.material for surface in scene.surfaces]
    shining = [s.emission for s in scene.surfaces if s.emission is not None]
    if scene.ambient is not None:
        shining.append(scene.ambient.radiance)
    return band_count(materials, scene.lights, spectra=shining)


def _check_keys(key: Key | None, die_key: Key | None, camera: Camera, bands: int) -> None:
    """Raise `ValueError` if a key is missing that the sensor needs for its draws. The check traces
    the sensor without running it.
    """
    if key is None or die_key is None:
        view = camera.view
        seen = jax.ShapeDtypeStruct((*view.resolution, bands), view.pixel_pitch.dtype)
        jax.eval_shape(raw_image, key, camera.sensor, seen, die_key=die_key)


def _check_bands(bands: int, sensor: Sensor) -> None:
    """Raise `ValueError` if scene and sensor have unequal numbers of bands, neither of which is
    one.
    """
    conversion, mosaic = sensor.photon_conversion, sensor.colour_filter
    spectra = {
        "photon_conversion.wavelength": None if conversion is None else conversion.wavelength,
        "infrared_cut": sensor.infrared_cut,
        "quantum_efficiency": sensor.quantum_efficiency,
        "colour_filter.transmission": None if mosaic is None else mosaic.transmission,
    }
    for name, spectrum in spectra.items():
        measured = spectrum.shape[-1] if spectrum is not None and spectrum.ndim else 1
        if measured != bands and 1 not in (measured, bands):
            raise ValueError(
                f"the scene has {bands} bands and Sensor.{name} {measured}: describe materials and "
                "lights in the sensor's bands, as lift_scene(scene, wavelengths) does for RGB, or "
                "read the camera in those of the scene, as by "
                "read_camera(name, wavelengths=[610e-9, 550e-9, 465e-9])."
            )


def _check_unit(camera: Camera, light: Array) -> None:
    """Warn about a wrong unit: radiance that no lens has converted to irradiance, or watts in place
    of photons, which give the sensor hardly any photons.
    """
    sensor, view = camera.sensor, camera.view
    if sensor.photon_conversion is not None and view.f_number is None:
        warnings.warn(
            "capture: the view has no f_number, so that radiance in W m^-2 sr^-1 counts as so many "
            "W m^-2 on the sensor, 20 times what a lens at f/4 lets in; give it one, as by "
            "dataclasses.replace(view, f_number=4.0).",
            stacklevel=3,
        )
    counts = sensor.photon_conversion is None and sensor.shot_noise is not None
    if not (counts and is_known(light) and is_known(sensor.exposure_time)):
        return
    exposure = 1.0 if sensor.exposure_time is None else np.asarray(sensor.exposure_time).max()
    most = float(np.nanmax(np.asarray(light), initial=0) * exposure)
    if 0 < most < DARKEST:
        warnings.warn(
            f"capture: the brightest pixel gets {most:.2g} photons an exposure: without a "
            "photon_conversion the light on a sensor counts as photons per pixel and second; give "
            "it one (jaxvision.PhotonConversion) for a scene in W m^-2.",
            stacklevel=3,
        )


def _renderer(
    integrator: Paths | Renderer | None,
    key: Key | None,
    rule: Rule,
    samples: PixelSamples | None,
    edges: Edges | None,
    threshold: float | None,
) -> Renderer | Callable[[Scene, View], Traced]:
    if integrator is None:
        asked = {"rule": rule, "samples": samples, "edges": edges, "threshold": threshold}
        return partial(render, **asked)
    if not isinstance(integrator, Paths):
        return integrator
    if key is None:
        raise ValueError("Paths are drawn at random: give a key.")
    paths = jax.random.fold_in(key, _OF_PATHS)
    return lambda scene, view: path_traced(paths, scene, view, method=integrator)


def _light_on_sensor(
    renderer: Any, scene: Scene, camera: Camera, motion: Motion | None, moments: int
) -> tuple[Image, Image, Image | None]:
    """Return radiance and irradiance of each pixel, averaged over its aperture and its exposure,
    and the standard error of the radiance where it is known.
    """
    sensor = camera.sensor
    if motion is None:
        return _sample_static(renderer, scene, camera.view, sensor.pixel_aperture)
    if sensor.exposure_time is None:
        raise ValueError("Sensor.exposure_time must be given in seconds for a motion, got None.")

    def render_at(time: Scalar) -> tuple[Image, Image]:
        return _sample_static(renderer, *motion(scene, camera.view, time), sensor.pixel_aperture)[
            :2
        ]

    rows, _ = camera.view.resolution
    light = exposed(sensor.shutter, sensor.exposure_time, render_at, rows=rows, slots=moments)
    return *light, None


def _sample_static(
    renderer: Any, scene: Scene, view: View, aperture: PixelAperture | None
) -> tuple[Image, Image, Image | None]:
    """Return radiance, irradiance and standard error of a static scene, sampled as finely as the
    aperture needs."""
    if aperture is None or aperture.oversampling == 1:
        found = renderer(scene, view)
        radiance, error = (
            (found.radiance, found.error) if isinstance(found, Traced) else (found, None)
        )
        return radiance, sensor_irradiance(view, radiance), error
    n = aperture.oversampling
    rows, columns = view.resolution
    fine = replace(view, resolution=(n * rows, n * columns), pixel_pitch=view.pixel_pitch / n)
    found = renderer(scene, fine)
    radiance = found.radiance if isinstance(found, Traced) else found
    irradiance = sensor_irradiance(fine, radiance)
    return pixel_means(radiance, aperture), pixel_means(irradiance, aperture), None
