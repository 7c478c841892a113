"""The public names of both packages, discovered, not listed."""

import importlib
import inspect
import pkgutil

import jaxvision

# The edge (files, NumPy) and the stop-watch: neither is traced nor differentiated.
EAGER = {
    "jaxvision.io",
    "jaxvision.errors",
    "jaxvision.accuracy",
    "jaxvision.camera_files",
    "jaxvision.mesh_files",
    "jaxvision.render_command",
    "jaxvision.render_command.job",
    "jaxvision.render_command.integrators",
    "jaxvision.render_command.tiles",
    "jaxvision.scene_checks",
    "jaxvision.scene_files",
    "jaxvision.scene_files.bands",
    "jaxvision.scene_files.materials",
    "jaxvision.scene_files.records",
    "jaxvision.scene_files.schema",
    "jaxvision.scene_files.material_schema",
    "jaxvision.scene_files.spectrum_schema",
    "jaxvision.scene_files.folder",
    "jaxvision.geometry.checks",
    "jaxvision.colour_data",
    "jaxvision.command_line",
    "jaxvision.toml_files",
    "jaxvision.measured_files",
    "jaxvision.measured_files.by_suffix",
    "jaxvision.measured_files.cornell",
    "jaxvision.measured_files.merl",
    "jaxvision.measured_files.rgl",
    "jaxvision.measured_files.scattered",
    "jaxvision.filters.kernels",
    "jaxvision.filters.matrix",
    "jaxvision.filters.scipy_operators",
    "jaxvision.lights.orders",
    "jaxvision.lights.environment_tables",
}
# Static answers to static questions: no array goes in. And parts of functions that are swept:
# `intersect`, `occluded`, `visibility`, `outgoing_radiance`, `render` and those of `transport`.
STATIC = {
    "jaxvision.geometry.nearest.blocked",
    "jaxvision.geometry.flat.plane_hit",
    "jaxvision.geometry.flat.disc_hit",
    "jaxvision.geometry.flat.quad_hit",
    "jaxvision.geometry.box.box_hit",
    "jaxvision.shadows.clear",
    "jaxvision.shading.lighting",
    "jaxvision.shading.reflected_radiance",
    "jaxvision.rendering.direct.direct_along",
    "jaxvision.rendering.direct.sorted_scene",
    "jaxvision.rendering.pixel_loop.each",
    "jaxvision.rendering.pixel_loop.in_blocks",
    "jaxvision.rendering.pixel_loop.mean_of_samples",
    "jaxvision.rendering.pixel_loop.numbers_of",
    "jaxvision.rendering.pixel_loop.photograph",
    "jaxvision.transport.paths.path_along",
    "jaxvision.transport.ray_tree.ray_tree_along",
    "jaxvision.transport.radiosity.gather.radiosity_rays",
    "jaxvision.hemisphere.product_nodes",
    "jaxvision.transport.radiosity.patches.plan_patches",
    "jaxvision.transport.radiosity.solve.shoot",
}
STATIC |= {f"jaxvision.colour_filters.{name}" for name in ("bayer", "check_pattern", "sites")}
STATIC |= {
    f"jaxvision.padding.{name}" for name in ("as_planes", "check_border", "check_picture", "ghosts")
}


def modules(package):
    """The public modules of a package, command lines apart."""
    names = [
        name
        for _, name, _ in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
        if not any(part.startswith("_") for part in name.split("."))
        and not name.endswith((".cli", ".plots"))
    ]
    return [importlib.import_module(name) for name in names]


def functions(package):
    """Every public function where it is defined."""
    found = {}
    for module in modules(package):
        for name, value in vars(module).items():
            inner = inspect.unwrap(value) if callable(value) else value
            if (
                not name.startswith("_")
                and inspect.isfunction(inner)
                and inner.__module__ == module.__name__
            ):
                found[f"{module.__name__}.{name}"] = value
    return found


def records(package):
    return {
        f"{module.__name__}.{name}": value
        for module in modules(package)
        for name, value in vars(module).items()
        if inspect.isclass(value)
        and value.__module__ == module.__name__
        and not name.startswith("_")
    }


def traced():
    """Every public function of numbers by its name below `jaxvision`."""
    return {
        name.removeprefix("jaxvision."): function
        for name, function in functions(jaxvision).items()
        if name.rpartition(".")[0] not in EAGER and name not in STATIC
    }
