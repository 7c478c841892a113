"""One sweep over the public API, discovered, not listed: documented, keyword-only, `key` first;
eager == jit, vmap == loop, gradients finite and equal to the directional finite difference.

A new public function of numbers needs one line in `examples/`; without it the sweep fails.
"""

import importlib
import inspect
import pkgutil
import re
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from examples import every_example

import fitting
import jaxvision

# The edge (files, NumPy) and the stop-watch: neither is traced nor differentiated.
EAGER = {
    "jaxvision.io",
    "jaxvision.errors",
    "jaxvision.accuracy",
    "jaxvision.effects",
    "jaxvision.camera_files",
    "jaxvision.mesh_files",
    "jaxvision.render_job",
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
# Static answers to static questions: no array goes in. And parts of the one loop of a shadow ray,
# swept with `occluded`, `visibility` and `outgoing_radiance`.
STATIC = {
    "jaxvision.geometry.nearest.blocked",
    "jaxvision.shadows.clear",
    "jaxvision.shadows.comes_through",
    "jaxvision.shadows.light_comes_through",
    "jaxvision.hemisphere.product_nodes",
    "jaxvision.rendering.bake",
    "jaxvision.transport.radiosity.patches.plan_patches",
    "jaxvision.transport.radiosity.solve.shoot",
}
STATIC |= {f"jaxvision.colour_filters.{name}" for name in ("bayer", "check_pattern", "sites")}
STATIC |= {
    f"jaxvision.padding.{name}" for name in ("as_planes", "check_border", "check_picture", "ghosts")
}
UNIT = (
    r"\b(DN|W m\^-2|W sr\^-1|sr\^-1|m|m\^2|metres|photons|electrons|e-|rad|radians|rad\^-1|"
    r"unit|pixels|relative|codes)\b"
)


def modules(package):
    """The package and its public modules, command lines apart."""
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


EXAMPLES = every_example()
ALL = functions(jaxvision)
TRACED = {
    name: f
    for name, f in ALL.items()
    if name.rpartition(".")[0] not in EAGER and name not in STATIC
}
BOTH = ALL | functions(fitting)

# ------------------------------------------------ words


def test_discovery_discovers():
    assert {"jaxvision.shot.capture", "jaxvision.brdf.phong.phong_lobe"} <= ALL.keys()
    assert "jaxvision.brdf.phong.Phong" in records(jaxvision)


@pytest.mark.parametrize("name", sorted(BOTH))
def test_documented_with_optional_arguments_by_keyword_and_key_first(name):
    function = BOTH[name]
    assert len(inspect.getdoc(function) or "") >= 10, f"{name} is not documented"
    parameters = list(inspect.signature(function).parameters.values())
    for i, parameter in enumerate(parameters):
        optional = parameter.default is not inspect.Parameter.empty
        if optional:
            assert parameter.kind is inspect.Parameter.KEYWORD_ONLY, f"{name}({parameter})"
        if parameter.name == "key":
            assert i == 0, f"{name}: key comes first"


@pytest.mark.parametrize("name", sorted(TRACED))
def test_units_are_stated_by_the_function_or_for_its_whole_module(name):
    module = importlib.import_module(TRACED[name].__module__)
    words = f"{module.__doc__}\n{inspect.getdoc(TRACED[name])}"
    assert re.search(UNIT, words), f"{name} states no unit"


@pytest.mark.parametrize("name", sorted(records(jaxvision)))
def test_records_are_documented(name):
    record = records(jaxvision)[name]
    assert record.__doc__
    assert not record.__doc__.startswith(f"{record.__name__}(")  # what dataclasses write


def test_everything_exported_exists_and_nothing_is_forgotten():
    assert all(hasattr(jaxvision, name) for name in jaxvision.__all__)
    exported = {id(getattr(jaxvision, name)) for name in jaxvision.__all__}
    kinds = records(jaxvision)
    of_scenes = (jaxvision.Light, jaxvision.Material)
    missing = [
        name
        for name, kind in kinds.items()
        if (name.startswith("jaxvision.scene.") or issubclass(kind, of_scenes))
        and id(kind) not in exported
    ]
    assert not missing


# ------------------------------------------------ numbers


def is_float(leaf):
    return jnp.issubdtype(leaf.dtype, jnp.floating)


def direction(x):
    """A fixed direction of change, in proportion to each number."""
    x = np.asarray(x)
    return x * np.cos(np.arange(x.size, dtype=x.dtype)).reshape(x.shape)


def shifted(tree, step):
    """Every number of a tree moved by `step` along `direction`."""
    return jax.tree.map(lambda x: np.asarray(x) + step * direction(x) if is_float(x) else x, tree)


def stacked(*leaves):
    """In NumPy, which compiles nothing, but for random keys."""
    return (jnp if jnp.issubdtype(leaves[0].dtype, jax.dtypes.prng_key) else np).stack(leaves)


def total(tree):
    """The sum of all numbers in a result."""
    return sum((x.sum() for x in jax.tree.leaves(tree) if is_float(x)), jnp.zeros(()))


def close(a, b, rtol):
    def compare(x, y):
        np.testing.assert_allclose(x, y, rtol=rtol, atol=rtol * (1e-30 + np.abs(y).max(initial=0)))

    jax.tree.map(compare, a, b)


def test_every_public_function_has_an_example():
    assert {f"jaxvision.{name}" for name in EXAMPLES} == TRACED.keys()


# Compositions of functions that are swept themselves, seconds to compile four times over.
LONG = {
    "brdf.albedo",
    "brdf.torrance_sparrow.albedo",
    "brdf.dichromatic_separation.body_colour",
    "brdf.rgl.evaluate",
    "brdf.rgl.sample",
    "lights.incident_samples",
    "lights.irradiance",
    "lights.light_field.light_field_sample",
    "filters.nonlocal_means.nonlocal_means_filter",
    "brdf.measured.samples_of",
    "brdf.measured.tabulate_sampler",
    "brdf.rgl.albedo",
    "rendering.render_light_field",
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
    "hemisphere_integral.hemisphere_radiance",
    "hemisphere_integral.lit_radiance",
    "hemisphere_integral.sampled_radiance",
    "transport.light_paths.light_traced",
    "transport.paths.path_radiance",
    "transport.paths.path_traced",
    "transport.paths.path_traced_pixels",
    "transport.ray_tree.ray_traced",
    "transport.ray_tree.ray_tree_radiances",
    "transport.radiosity.exchange.form_factor_table",
    "transport.radiosity.form_factors.polygon_to_polygon",
    "transport.radiosity.gather.radiosity_along",
    "transport.radiosity.gather.radiosity_image",
    "transport.radiosity.solution.direct_irradiance",
    "transport.radiosity.solution.radiosity",
}


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=pytest.mark.slow if n in LONG else ()) for n in sorted(EXAMPLES)],
)
def test_eager_jit_vmap_loop_and_gradient(name):
    """Two programs: the value with its gradient, and lanes of values, which hold the steps of the
    finite difference too."""
    arguments, options = EXAMPLES[name]
    function = partial(TRACED[f"jaxvision.{name}"], **options)
    flat, structure = jax.tree.flatten(arguments)
    numbers = [i for i, x in enumerate(flat) if is_float(x)]

    def summed(values, whole):
        whole = list(whole)
        for i, value in zip(numbers, values, strict=True):
            whole[i] = value
        result = function(*jax.tree.unflatten(structure, whole))
        return total(result), result

    one = jax.jit(jax.grad(summed, has_aux=True))

    def at(point):
        leaves = jax.tree.leaves(point)
        return one([leaves[i] for i in numbers], leaves)

    h = 1e-6
    here, aside, ahead, behind = (shifted(arguments, step) for step in (0, 1e-3, h, -h))
    batch = jax.tree.map(stacked, here, aside, ahead, behind)
    lanes = jax.tree.map(np.asarray, jax.jit(jax.vmap(function))(*batch))

    def lane(i):
        return jax.tree.map(lambda x: x[i], lanes)

    gradient, compiled = at(here)
    close(compiled, function(*arguments), 1e-12)
    close(lane(0), compiled, 1e-12)
    close(lane(1), at(aside)[1], 1e-12)
    assert all(jnp.isfinite(g).all() for g in gradient)

    above, below = float(total(lane(2))), float(total(lane(3)))
    slope = sum(
        float(np.vdot(g, direction(flat[i]))) for g, i in zip(gradient, numbers, strict=True)
    )
    # central difference: truncation h^2, rounding eps / h of the value
    tolerance = 1e-6 * abs(slope) + 1e-8 * abs(above) + 1e-12
    assert abs((above - below) / (2 * h) - slope) <= tolerance
