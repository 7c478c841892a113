"""Public functions without a row in the table: their kind, and the tests that check them.

In `jaxvision` every function whose numbers matter is named. For files, text, figures, commands and
the modules of `fitting`, which compute in float64, patterns name all functions."""

from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache

from public_names import functions

import fitting
import jaxvision

from . import every_entry
from .composed import COMPOSED

FILES = "read, check or write files and tables: numbers are stored, not computed"
WORDS = "text, tables and pages made from results"
FIGURES = "figures made from results"
COMMANDS = "commands, and simulations that run other functions"
CLOCK = "errors and times of other functions, measured while they run"
BOUNDS = "bounds in float64, checked against pictures with and without each effect"
CHOICES = "selects, arranges or decides; its numbers are integers, or inputs unchanged"
TABLES = "tables in float64, checked against SciPy, NumPy or closed forms"
INTERPOLATED = "interpolated by JAX in the picture's dtype, checked against SciPy and Pillow"
DRAWS = "random draws, checked by their distribution; the table above has their parts"
SOLVERS = "iterates to a tolerance of its own, checked against known optima and posteriors"
STATISTICS = "statistics in float64, checked against simulations, closed forms and other packages"


@dataclass(frozen=True)
class Elsewhere:
    """Functions of one kind.

    Attributes:
        kind: why they have no row.
        tests: files in `tests/`, without suffix, that check them.
        names: one a line: `module: function function`, or a pattern.
    """

    kind: str
    tests: str
    names: str

    @property
    def rooms(self) -> str:
        """Return the modules, or the package that several share."""
        found = sorted({name.rpartition(".")[0] for name in covered_names(self)})
        depth = {name: 2 if name.startswith("fitting") else 1 for name in found}
        heads = sorted({".".join(name.split(".")[: depth[name]]) for name in found})
        return ", ".join(f"`{head}`" for head in heads)


@cache
def _public() -> dict[str, None]:
    names = [*functions(jaxvision), *functions(fitting)]
    return dict.fromkeys(sorted(name.removeprefix("jaxvision.") for name in names))


def _named(group: Elsewhere) -> list[str]:
    """Return the functions that match a group, or raise `ValueError` for a name that matches
    none."""
    found: list[str] = []
    for line in filter(None, map(str.strip, group.names.split("\n"))):
        module, colon, names = line.partition(": ")
        for pattern in [f"{module}.{name}" for name in names.split()] if colon else [line]:
            known = [pattern] if pattern in _public() else []
            fit = known or [name for name in _public() if fnmatchcase(name, pattern)]
            if not fit:
                raise ValueError(f"no public function is called {pattern}")
            found += fit
    return list(dict.fromkeys(found))


@cache
def _by_group() -> dict[Elsewhere, tuple[str, ...]]:
    """Return the functions of each group. A function belongs to the first group that names it, if
    it has no row in the table."""
    taken = {entry.name for entry in every_entry()} | set(COMPOSED)
    groups = {}
    for group in ELSEWHERE:
        groups[group] = tuple(name for name in _named(group) if name not in taken)
        taken |= set(groups[group])
    return groups


def covered_names(group: Elsewhere) -> tuple[str, ...]:
    """Return the functions of a group."""
    return _by_group()[group]


ELSEWHERE = (
    Elsewhere(
        CHOICES,
        "test_plain_arrays",
        "core.plain_arrays: plain_array warn_of_range widen_short within_integers",
    ),
    Elsewhere(
        FILES,
        "test_camera_files test_record_files",
        """
            files.cameras.*
            files.materials.*
            files.records.*
        """,
    ),
    Elsewhere(
        FILES,
        "test_io test_lights_environment test_lights_rectangle",
        """
            files.images.*
            lights.environment_quadrature.*
            lights.near_rectangles.*
            lights.environment_tables.*
        """,
    ),
    Elsewhere(
        FILES,
        "test_luminaires test_skies",
        """
            files.luminaires.*
            lights.skies: cie_sky daylight perez_sky
            lights.goniometric: goniometric_light
        """,
    ),
    Elsewhere(
        FILES,
        "test_raw_files test_rig_from_folder",
        """
            files.raw.*
            files.image_settings.*
            fitting.rig_from_folder.*
        """,
    ),
    Elsewhere(
        FILES,
        "test_mesh_files test_gltf_files",
        """
            files.gltf.*
            files.meshes.*
            geometry.checks.*
        """,
    ),
    Elsewhere(FILES, "test_measured_files", "files.measured.*"),
    Elsewhere(
        FILES,
        "test_scene_files",
        """
            files.scenes.*
            files.shipped.*
            files.toml.*
            rendering.scene_checks.*
            errors.*
        """,
    ),
    Elsewhere(
        FILES,
        "test_rig test_from_memory",
        """
            fitting.rig.*
            fitting.observation.*
            *.from_memory.*
            fitting.reflectance.paths.*
            fitting.reflectance.names.*
        """,
    ),
    Elsewhere(
        FILES,
        "test_photon_transfer test_joint test_response test_reflectance",
        """
            fitting.*.read.*
            fitting.noise.levels_table.*
            fitting.noise.usable.*
        """,
    ),
    Elsewhere(
        FILES,
        "test_noise_settings test_taps",
        """
            fitting.noise.across_settings.sensor.*
            fitting.noise.settings.*
            fitting.noise.sites.*
        """,
    ),
    Elsewhere(
        FILES,
        "test_fitted_material test_record_files",
        """
            fitting.reflectance.material.*
            fitting.noise.sensor.*
        """,
    ),
    Elsewhere(
        FILES,
        "test_colour_spaces test_spectra test_lifted_scene",
        """
            colour_spaces.colour_data.*
            rendering.lifted_scene.*
        """,
    ),
    Elsewhere(COMMANDS, "test_study", "fitting.study.*"),
    Elsewhere(
        COMMANDS,
        "test_cli test_tasks",
        """
            fitting.folders.*
            tasks.*
        """,
    ),
    Elsewhere(DRAWS, "test_shading", "rendering.hemisphere_integral: sampled_radiance"),
    Elsewhere(
        DRAWS,
        "test_random test_lights",
        """
            lights._nodes: shifted_lattice
            lights._samples: light_nodes
        """,
    ),
    Elsewhere(
        WORDS,
        "test_report",
        """
            fitting.*.findings.*
            fitting.*.section.*
            fitting.report.*
            fitting.inference.formatting.*
            fitting.checks.section.*
            fitting.fits.words.*
            fitting.demo.section.*
        """,
    ),
    Elsewhere(WORDS, "test_lazy_names", "core.lazy_names.*"),
    Elsewhere(WORDS, "test_in_notebooks", "core.in_notebooks.*"),
    Elsewhere(
        WORDS,
        "test_accuracy test_accuracy_several",
        """
            accuracy.pages.*
            accuracy.console.*
            accuracy.tables.*
        """,
    ),
    Elsewhere(
        FIGURES,
        "test_report test_inspect test_plots",
        """
            fitting.*.figures.*
            plots.*
            accuracy.plots.*
        """,
    ),
    Elsewhere(
        COMMANDS,
        "test_cli test_render_command",
        """
            cli.command_line.*
            core.interrupts.*
            core.progress.*
            render_command.*
            fitting.commands.*
            core.memory.*
        """,
    ),
    Elsewhere(COMMANDS, "test_programs", "programs.*"),
    Elsewhere(
        COMMANDS,
        "test_lab test_seeds",
        """
            fitting.demo.compare.*
            fitting.demo.lab.*
        """,
    ),
    Elsewhere(
        COMMANDS,
        "test_checks",
        """
            fitting.checks.command.*
            fitting.checks.counts.*
            fitting.checks.coverage.*
            fitting.checks.emva1288.*
            fitting.checks.joint.*
            fitting.checks.noise.*
            fitting.checks.problem.*
            fitting.checks.reflectance.*
            fitting.checks.response.*
            fitting.checks.simulations.*
        """,
    ),
    Elsewhere(CLOCK, "test_accuracy test_accuracy_knobs test_accuracy_several", "accuracy.*"),
    Elsewhere(CLOCK, "test_fit_accuracy", "fitting.accuracy.*"),
    Elsewhere(
        BOUNDS,
        "test_effects test_effects_sensor test_effects_optics test_effects_bodies",
        "effects.*",
    ),
    Elsewhere(CHOICES, "test_sensor_light", "sensor.shutter: exposed"),
    Elsewhere(
        CHOICES,
        "test_own_kinds test_own_kinds_in_one_file test_lights",
        """
            brdf._registry: is_body is_delta register register_delta families lambertian suprema
            brdf._specular: draw_way
            lights._registry: can_be_seen register register_extended kinds kind_of
            sensor._registry: register register_curve stage_of
            lights._samples: lights_by_rule rule_for rule_of_each rules_of split_by_rule
        """,
    ),
    Elsewhere(
        CHOICES,
        "test_colour_filters test_padding",
        """
            sensor.colour_filters: as_pattern bayer check_pattern sites
            filters.padding: as_planes check_border check_picture ghosts
        """,
    ),
    Elsewhere(
        CHOICES,
        "test_rendering test_transport_paths",
        """
            rendering.band_count: band_count
            rendering.direct: can_shade direct_along sorted_scene
            rendering.edges: moving_edges grazing_cosines damped
            rendering.maps: evaluate_maps patch_of shading_normal summed varied_surfaces
            rendering.pixel_loop: check_lens map_blocks map_rays mean_of_samples numbers_of
            rendering.pixel_loop: photograph
            rendering.shading: largest_reflected lighting reflected_bands reflected_radiance
            rendering.shadows: clear samples_that_reach visible_in_order
            transport.paths: path_along
            transport.radiosity.gather: radiosity_along radiosity_rays
            transport.ray_tree: ray_tree_along
        """,
    ),
    Elsewhere(
        CHOICES,
        "test_geometry_shapes",
        """
            geometry._bounds: ball_around
            geometry._places: has_area
            geometry._size: largest_coordinate offset_length
            geometry.box: box_hit
            geometry.flat: disc_hit plane_hit quad_hit
            geometry.nearest: blocked meets
        """,
    ),
    Elsewhere(
        CHOICES,
        "test_radiosity",
        """
            transport.radiosity._trapped: trapping_surface
            transport.radiosity.patches: plan_patches
            transport.radiosity.solve: shoot
        """,
    ),
    Elsewhere(CHOICES, "test_types", "core._types: as_dtype"),
    Elsewhere(
        TABLES,
        "test_hemisphere test_accuracy_knobs",
        """
            core._quadrature: gauss_legendre
            geometry.hemisphere: product_nodes
            lights._nodes: square_nodes
            lights.orders: order_for
        """,
    ),
    Elsewhere(INTERPOLATED, "test_resampling", "filters.resampling: resize warp"),
    Elsewhere(
        TABLES,
        "test_filters_named test_filters_varying",
        """
            filters.kernels: binomial_kernel blur_sigmas box_kernel derivative_kernels gaussian_size
            filters.kernels: laplacian_kernel
            filters.matrix: filter_matrix per_pixel_matrix
            filters.scipy_operators: scipy_matrix scipy_operator
        """,
    ),
    Elsewhere(
        DRAWS,
        "test_sensor_noise test_sensor_gradients test_random",
        """
            sensor.raw: collect
            sensor.expectation: expected_of_count expected_of_defect expected_of_reading
        """,
    ),
    Elsewhere(WORDS, "foreign/test_scenes", "transport.missing: missing_light"),
    Elsewhere(
        TABLES,
        "test_optics_distortion",
        """
            optics.views: opencv_view
            scene.folds: folded_share
        """,
    ),
    Elsewhere(
        DRAWS,
        "test_transport_light test_transport_paths test_hemisphere",
        """
            rendering.hemisphere_integral: lit_radiance
            lights.incidence: irradiance
            transport.light_paths: light_traced
            transport.paths: path_radiance path_sample path_traced path_traced_pixels
            transport.radiosity.gather: radiosity_image
            transport.radiosity.solution: radiosity
            transport.ray_tree: ray_traced ray_tree_radiances
        """,
    ),
    Elsewhere(
        SOLVERS,
        "test_matting",
        """
            matting.foreground: estimate_foreground
            matting.errors: matte_errors
        """,
    ),
    Elsewhere(
        CHOICES,
        "test_integral test_filters",
        """
            filters.convolution: summed
            filters.integral: integral_image
        """,
    ),
    Elsewhere(CHOICES, "test_parallel_loops", "core.parallel_loops.*"),
    Elsewhere(SOLVERS, "test_side_by_side", "core.side_by_side.*"),
    Elsewhere(
        STATISTICS,
        "test_likelihoods test_parameters test_problem test_clustering test_diagnostics "
        "test_joint_left_out test_joint_prior test_stated_errors test_neighbours",
        "fitting.inference.given.*",
    ),
    Elsewhere(
        STATISTICS,
        "test_noise test_emva1288 test_photon_transfer test_noise_shared "
        "test_noise_neighbours test_noise_counts test_noise_prediction test_release_4 "
        "foreign/test_noise",
        """
            fitting.noise.counted.*
            fitting.noise.release_4.*
            fitting.noise.brighter_fatter.*
            fitting.noise.neighbours.*
            fitting.noise.regressions.*
            fitting.noise.window.*
            fitting.noise.prediction.comparison.*
            fitting.noise.prediction.missing.*
            fitting.noise.prediction.moments.*
            fitting.noise.prediction.predict.*
        """,
    ),
    Elsewhere(
        STATISTICS,
        "test_photometric_stereo test_lights_calibration test_brdf_fit test_comparison "
        "test_fitted_material foreign/test_surfaces test_reflectance test_reflectance_plan "
        "test_shading_check test_spread test_stated_errors",
        "fitting.reflectance.*",
    ),
    Elsewhere(STATISTICS, "test_from_edge test_edge_aberrations", "fitting.resolution.*"),
    Elsewhere(STATISTICS, "test_sensitivities", "fitting.sensitivities.*"),
    Elsewhere(STATISTICS, "test_lights_calibration", "fitting.lights.*"),
    Elsewhere(
        STATISTICS,
        "test_report foreign/test_noise foreign/test_frames test_noise test_emva1288 "
        "test_photon_transfer test_noise_shared test_noise_neighbours test_noise_counts "
        "test_noise_prediction test_release_4 test_codes foreign/test_series_of_flats "
        "test_noise_settings",
        "fitting.noise.*",
    ),
    Elsewhere(
        SOLVERS,
        "test_report test_problem test_plan_and_budget test_called_for test_prior_check "
        "test_influence test_streams test_fit_map",
        "fitting.fits.*",
    ),
    Elsewhere(
        WORDS,
        "foreign/test_noise foreign/test_frames test_codes foreign/test_series_of_flats",
        "fitting.codes.*",
    ),
    Elsewhere(
        STATISTICS,
        "foreign/test_noise foreign/test_frames test_codes foreign/test_series_of_flats",
        "fitting.frame_checks.*",
    ),
    Elsewhere(
        STATISTICS,
        "test_programs test_from_memory foreign/test_exposure_stacks test_posterior test_nuts "
        "test_convergence test_importance test_fit test_solvers test_search test_varpro "
        "test_linear_parameters test_starts test_streams test_problem test_fit_map "
        "test_likelihoods test_parameters test_clustering test_diagnostics "
        "test_joint_left_out test_joint_prior test_stated_errors test_neighbours",
        "fitting.inference.*",
    ),
    Elsewhere(
        STATISTICS,
        "test_response_curve test_response_gamma test_response foreign/test_exposure_stacks",
        "fitting.response.*",
    ),
    Elsewhere(
        STATISTICS,
        "test_joint test_joint_nuts test_joint_left_out test_joint_turns test_stated_errors",
        "fitting.joint.*",
    ),
)
