"""The public names of both packages, which are discovered and not listed."""

import dataclasses
import importlib
import inspect
import pkgutil
from fnmatch import fnmatchcase

import jaxvision
from jaxvision import accuracy, effects

# Functions at the boundary (files, NumPy) and for timing, which are neither traced nor
# differentiated.
EAGER = {
    "jaxvision.core.interrupts",
    "jaxvision.core.progress",
    "jaxvision.core.in_notebooks",
    "jaxvision.files.images",
    "jaxvision.files.raw",
    "jaxvision.files.image_settings",
    "jaxvision.plots.estimates",
    "jaxvision.plots.images",
    "jaxvision.plots.inline",
    "jaxvision.plots.inspection",
    "jaxvision.plots.legible_axes",
    "jaxvision.plots.light",
    "jaxvision.plots.stages",
    "jaxvision.plots.summary",
    "jaxvision.errors",
    "jaxvision.core.plain_arrays",
    "jaxvision.core.parallel_loops",
    "jaxvision.core.lazy_names",
    "jaxvision.core.memory",
    "jaxvision.programs",
    "jaxvision.core.side_by_side",
    "jaxvision.tasks",
    "jaxvision.files.cameras",
    "jaxvision.files.luminaires",
    "jaxvision.files.materials",
    "jaxvision.files.records",
    "jaxvision.files.gltf",
    "jaxvision.scene.folds",
    "jaxvision.files.meshes",
    "jaxvision.render_command",
    "jaxvision.render_command.cost",
    "jaxvision.render_command.job",
    "jaxvision.render_command.integrators",
    "jaxvision.render_command.pruning",
    "jaxvision.render_command.tiles",
    "jaxvision.rendering.scene_checks",
    "jaxvision.files.shipped",
    "jaxvision.files.scenes",
    "jaxvision.files.scenes.bands",
    "jaxvision.files.scenes.spectrum_tables",
    "jaxvision.files.scenes.mitsuba",
    "jaxvision.files.scenes.mitsuba.document",
    "jaxvision.files.scenes.mitsuba.transforms",
    "jaxvision.files.scenes.mitsuba.shapes",
    "jaxvision.files.scenes.mitsuba.spectra",
    "jaxvision.files.scenes.mitsuba.materials",
    "jaxvision.files.scenes.mitsuba.camera",
    "jaxvision.files.scenes.nodes",
    "jaxvision.files.scenes.placement",
    "jaxvision.files.scenes.pbrt",
    "jaxvision.files.scenes.pbrt.statements",
    "jaxvision.files.scenes.pbrt.spectra",
    "jaxvision.files.scenes.pbrt.materials",
    "jaxvision.files.scenes.pbrt.shapes",
    "jaxvision.files.scenes.pbrt.lights",
    "jaxvision.files.scenes.pbrt.camera",
    "jaxvision.files.scenes.gltf",
    "jaxvision.files.scenes.gltf.contents",
    "jaxvision.files.scenes.gltf.materials",
    "jaxvision.files.scenes.gltf.textures",
    "jaxvision.files.scenes.maps",
    "jaxvision.files.scenes.schema",
    "jaxvision.files.scenes.tables",
    "jaxvision.files.scenes.folder",
    "jaxvision.geometry.checks",
    "jaxvision.colour_spaces.colour_data",
    "jaxvision.rendering.lifted_scene",
    "jaxvision.cli.command_line",
    "jaxvision.files.toml",
    "jaxvision.files.measured",
    "jaxvision.files.measured.by_suffix",
    "jaxvision.files.measured.cornell",
    "jaxvision.files.measured.merl",
    "jaxvision.files.measured.rgl",
    "jaxvision.files.measured.scattered",
    "jaxvision.filters.kernels",
    "jaxvision.filters.matrix",
    "jaxvision.filters.scipy_operators",
    "jaxvision.lights.orders",
    "jaxvision.lights.environment_quadrature",
    "jaxvision.lights.environment_tables",
    "jaxvision.lights.near_rectangles",
    "jaxvision.transport.radiosity._trapped",
}
EFFECTS = {  # decided and measured before tracing
    name
    for room in (effects, accuracy)
    for _, name, _ in pkgutil.walk_packages(room.__path__, f"{room.__name__}.")
}
# Functions without array arguments, whose results are static, and parts of functions that are
# tested elsewhere: `intersect`, `occluded`, `visibility`, `outgoing_radiance`, `render` and those
# of `transport`.
STATIC = {
    "jaxvision.geometry.nearest.blocked",
    "jaxvision.geometry.nearest.meets",
    "jaxvision.geometry.flat.plane_hit",
    "jaxvision.geometry.flat.disc_hit",
    "jaxvision.geometry.flat.quad_hit",
    "jaxvision.geometry.box.box_hit",
    "jaxvision.rendering.shadows.clear",
    "jaxvision.rendering.shadows.samples_that_reach",
    "jaxvision.rendering.shadows.visible_in_order",
    "jaxvision.rendering.shading.lighting",
    "jaxvision.rendering.shading.largest_reflected",
    "jaxvision.rendering.shading.reflected_bands",
    "jaxvision.rendering.shading.reflected_radiance",
    "jaxvision.rendering.direct.direct_along",
    "jaxvision.rendering.maps.evaluate_maps",
    "jaxvision.rendering.maps.patch_of",
    "jaxvision.rendering.maps.shading_normal",
    "jaxvision.rendering.maps.summed",
    "jaxvision.rendering.maps.varied_surfaces",
    "jaxvision.rendering.direct.sorted_scene",
    "jaxvision.rendering.edges.moving_edges",
    "jaxvision.rendering.edges.grazing_cosines",
    "jaxvision.rendering.edges.damped",
    "jaxvision.rendering.pixel_loop.map_rays",
    "jaxvision.rendering.pixel_loop.map_blocks",
    "jaxvision.rendering.pixel_loop.mean_of_samples",
    "jaxvision.rendering.pixel_loop.numbers_of",
    "jaxvision.rendering.pixel_loop.photograph",
    "jaxvision.transport.paths.path_along",
    "jaxvision.transport.ray_tree.ray_tree_along",
    "jaxvision.transport.radiosity.gather.radiosity_rays",
    "jaxvision.optics.views.opencv_view",
    "jaxvision.lights.goniometric.goniometric_light",
    "jaxvision.lights.skies.cie_sky",
    "jaxvision.lights.skies.perez_sky",
    "jaxvision.lights.skies.daylight",
    "jaxvision.transport.missing.missing_light",
    "jaxvision.geometry.hemisphere.product_nodes",
    "jaxvision.transport.radiosity.patches.plan_patches",
    "jaxvision.transport.radiosity.solve.shoot",
}
# Functions that are constant for gradients, and a drawn direction, whose weight is tested.
STATIC |= {"jaxvision.geometry._size.largest_coordinate", "jaxvision.geometry._bounds.ball_around"}
STATIC |= {"jaxvision.brdf._specular.draw_way"}
STATIC |= {f"jaxvision.brdf._registry.{name}" for name in ("is_body", "is_delta")}
STATIC |= {f"jaxvision.{room}._registry.register" for room in ("brdf", "lights", "sensor")}
STATIC |= {
    f"jaxvision.brdf._registry.{name}"
    for name in ("register_delta", "families", "lambertian", "suprema")
}
STATIC |= {f"jaxvision.lights._registry.{name}" for name in ("kinds", "kind_of")}
STATIC |= {f"jaxvision.sensor._registry.{name}" for name in ("register_curve", "stage_of")}
STATIC |= {"jaxvision.lights._registry.register_extended"}
STATIC |= {"jaxvision.rendering.band_count.band_count"}
STATIC |= {"jaxvision.geometry._places.has_area", "jaxvision.lights._registry.can_be_seen"}
STATIC |= {"jaxvision.core._quadrature.gauss_legendre", "jaxvision.lights._nodes.square_nodes"}
STATIC |= {"jaxvision.rendering.pixel_loop.check_lens", "jaxvision.filters.convolution.summed"}
STATIC |= {  # the rule of each light
    f"jaxvision.lights._samples.{name}"
    for name in ("lights_by_rule", "rule_for", "rule_of_each", "rules_of", "split_by_rule")
}
STATIC |= {
    f"jaxvision.sensor.colour_filters.{name}"
    for name in ("as_pattern", "bayer", "check_pattern", "sites")
}
STATIC |= {
    f"jaxvision.filters.padding.{name}"
    for name in ("as_planes", "check_border", "check_picture", "ghosts")
}


def modules(package):
    """Return the public modules of a package, except command lines."""
    names = [
        name
        for _, name, _ in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
        if not any(part.startswith("_") for part in name.split(".")) and not name.endswith(".cli")
    ]
    return [importlib.import_module(name) for name in names]


def defined(package):
    """Yield (name, value) for objects that public modules define, and for those that packages
    export from private ones, each named after the module that defines it."""
    for module in modules(package):
        for name, value in vars(module).items():
            if not name.startswith("_") and home(value) == module.__name__:
                yield f"{home(value)}.{name}", value
    for module in (package, *modules(package)):
        for name in getattr(module, "__all__", ()):
            value = getattr(module, name)
            if (home(value) or "").partition(".")[0] == package.__name__:
                yield f"{home(value)}.{name}", value


def home(value):
    """Return the module that defines a function or a class, and None for other objects."""
    inner = inspect.unwrap(value) if callable(value) else value
    return inner.__module__ if inspect.isfunction(inner) or inspect.isclass(inner) else None


def functions(package):
    """Return every public function where it is defined."""
    return {name: value for name, value in defined(package) if not inspect.isclass(value)}


def records(package):
    """Return every public class where it is defined."""
    return {name: value for name, value in defined(package) if inspect.isclass(value)}


def words(text):
    return text.split()


def arguments_and_fields(package):
    """Return the dotted names, below a package, of public arguments and fields."""
    found = []
    for name, function in functions(package).items():
        found += [f"{name}.{argument}" for argument in inspect.signature(function).parameters]
    for name, record in records(package).items():
        if dataclasses.is_dataclass(record):
            found += [f"{name}.{field.name}" for field in dataclasses.fields(record)]
    return found


def unknown(names, patterns):
    """Return the names that match no pattern."""
    return [name for name in names if not any(fnmatchcase(name, one) for one in patterns)]


def ghosts(patterns, names):
    """Return the patterns that match no name."""
    return [one for one in patterns if not any(fnmatchcase(name, one) for name in names)]


def traced():
    """Return every public function of numbers by its name below `jaxvision`."""
    return {
        name.removeprefix("jaxvision."): function
        for name, function in functions(jaxvision).items()
        if name.rpartition(".")[0] not in EAGER | EFFECTS and name not in STATIC
    }


def doors():
    """Return the functions of `traced` that convert and check users' arguments."""
    listed = {
        id(getattr(module, name))
        for module in (jaxvision, *modules(jaxvision))
        for name in getattr(module, "__all__", ())
    }
    return {
        name: function
        for name, function in traced().items()
        if id(function) in listed or hasattr(function, "__wrapped__")
    }


# Compositions of tested functions, which would take seconds to compile four times.
LONG = {
    "geometry._mesh.intersect_mesh",
    "lights._samples.incident_sample",
    "brdf.evaluation.albedo",
    "brdf.torrance_sparrow.albedo",
    "brdf.dichromatic_separation.body_colour",
    "brdf.rgl.evaluate",
    "brdf.rgl.sample",
    "lights.incidence.incident_samples",
    "lights.incidence.irradiance",
    "lights.light_field.light_field_sample",
    "filters.nonlocal_means.nonlocal_means_filter",
    "sensor.raw.collect",
    "shot.capture",
    "brdf.measured.samples_of",
    "brdf.measured.tabulate_sampler",
    "brdf.rgl.albedo",
    "rendering.light_field.render_light_field",
    "development.demosaicing.demosaic_menon",
    "development.jpeg_loss.jpeg",
    "development.pipeline.develop",
    "optics.irradiance.sensor_irradiance",
    "optics.resampling.distort_image",
    "optics.resampling.lateral_aberration",
    "lights.adaptive.adaptive_irradiance",
    "lights.light_field.refocus",
    "lights.polygon.nodes_integral",
    "lights.polygon.rectangle_irradiance",
    "matting.closed_form.closed_form_matte",
    "matting.foreground.estimate_foreground",
    "rendering.hemisphere_integral.hemisphere_radiance",
    "rendering.hemisphere_integral.lit_radiance",
    "rendering.hemisphere_integral.sampled_radiance",
    "transport.light_paths.light_traced",
    "transport.paths.path_radiance",
    "transport.paths.path_traced",
    "transport.paths.path_traced_pixels",
    "transport.ray_tree.ray_traced",
    "transport.ray_tree.ray_tree_radiances",
    "transport.radiosity.exchange.exchanged",
    "transport.radiosity.exchange.form_factor_table",
    "transport.radiosity.form_factors.polygon_to_polygon",
    "transport.radiosity.gather.radiosity_along",
    "transport.radiosity.gather.radiosity_image",
    "transport.radiosity.solution.direct_irradiance",
    "transport.radiosity.solution.radiosity",
}
