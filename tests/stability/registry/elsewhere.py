"""Public functions that have no row in the table: what they are, and the tests that check them.

Where the numbers matter every function is named; of files, words, figures and commands a pattern
names a module.
"""

from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache

from public_names import functions

import fitting
import jaxvision

FILES = "read, check or write files and tables: numbers are stored, not computed"
WORDS = "words, tables and pages made of results"
FIGURES = "figures made of results"
COMMANDS = "commands, and simulations that run other functions"
CLOCK = "errors and times of other functions, measured where they run"
BOUNDS = "bounds in float64, checked against pictures with and without each effect"
CHOICES = "selects, arranges or decides; its numbers are whole, or those that went in"
TABLES = "tables in float64, checked against SciPy, NumPy or closed forms"
INTERPOLATED = "interpolated by JAX in the picture's dtype, checked against SciPy and Pillow"
DRAWS = "draws, checked by their distribution; their parts stand in the table"
SOLVERS = "iterates to a tolerance of its own, checked against known optima and posteriors"
STATISTICS = "statistics in float64, checked against simulations, closed forms and other packages"


@dataclass(frozen=True)
class Elsewhere:
    """Functions of one kind.

    Attributes:
        kind: why they have no row.
        tests: files in `tests/`, without their ending, that check them.
        names: one a line: `module: function function`, or a pattern.
    """

    kind: str
    tests: str
    names: str

    @property
    def rooms(self) -> str:
        """The modules, or what several share."""
        found = sorted({name.rpartition(".")[0] for name in covered_names(self)})
        depth = {name: 2 if name.startswith("fitting") else 1 for name in found}
        heads = sorted({".".join(name.split(".")[: depth[name]]) for name in found})
        return ", ".join(f"`{head}`" for head in heads)


@cache
def _public() -> dict[str, None]:
    names = [*functions(jaxvision), *functions(fitting)]
    return dict.fromkeys(sorted(name.removeprefix("jaxvision.") for name in names))


def _named(group: Elsewhere) -> list[str]:
    """The functions that fit a group; `ValueError` for a name that fits none."""
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
    """A function belongs to the first group that names it."""
    taken: set[str] = set()
    groups = {}
    for group in ELSEWHERE:
        groups[group] = tuple(name for name in _named(group) if name not in taken)
        taken |= set(groups[group])
    return groups


def covered_names(group: Elsewhere) -> tuple[str, ...]:
    """The functions of a group."""
    return _by_group()[group]


ELSEWHERE = (
    Elsewhere(
        CHOICES,
        "test_plain_arrays",
        "core.plain_arrays: plain_array warn_of_range with_room within_integers",
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
        "test_io test_lights_environment",
        """
            files.images.*
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
    Elsewhere(
        FILES,
        "test_measured_files",
        """
            files.measured.*
        """,
    ),
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
    Elsewhere(
        COMMANDS,
        "test_study",
        """
            fitting.study.*
        """,
    ),
    Elsewhere(
        COMMANDS,
        "test_cli test_tasks",
        """
            fitting.folders.*
            tasks.*
        """,
    ),
    Elsewhere(
        DRAWS,
        "test_shading",
        """
            rendering.hemisphere_integral: sampled_radiance
        """,
    ),
    Elsewhere(
        DRAWS,
        "test_random test_lights",
        """
            lights._nodes: shifted_lattice
            lights._samples: light_nodes
        """,
    ),
    Elsewhere(
        STATISTICS,
        "test_photometric_stereo",
        """
            fitting.reflectance.stereo: photometric_stereo
            fitting.reflectance.stereo_lights: by_lights common_departure solved
            fitting.reflectance.stereo_misfit: departures shared_squares
        """,
    ),
    Elsewhere(STATISTICS, "test_from_edge", "fitting.resolution: from_edge"),
    Elsewhere(STATISTICS, "test_sensitivities", "fitting.sensitivities: from_patches"),
    Elsewhere(
        STATISTICS,
        "test_lights_calibration",
        """
            fitting.lights.calibration: calibrate
            fitting.lights.file: read_lights write_lights
            fitting.lights.highlight: highlight_of reflected
            fitting.lights.matte: shading_of
            fitting.lights.outline: centre_of outline_of surface
            fitting.reflectance.from_images.read: across turn_prior_of with_covariance
        """,
    ),
    Elsewhere(
        WORDS,
        "test_report",
        """
            fitting.*.findings.*
            fitting.*.section.*
            fitting.noise.prediction.section: levels_table picture residual_figure section table
            fitting.noise.prediction.section: explanations findings
            fitting.noise.across_settings.prediction: findings table
            fitting.report.*
            fitting.inference.formatting.*
            fitting.checks.section.*
            fitting.fits.moving_edges: warn_of_moving_edges
            fitting.fits.words.*
            fitting.demo.section.*
            fitting.fits.result: left_out_table residual_figure section
        """,
    ),
    Elsewhere(
        WORDS,
        "foreign/test_noise foreign/test_frames",
        """
            fitting.codes: converter_in_words
            fitting.frame_checks.frame: frame_sample listed refuse_half
            fitting.frame_checks.dialled: worst_in_words
            fitting.noise.raw_frames: processing_in_words
            fitting.noise.doubts: printed_times
            fitting.noise.periodic: periodic_in_words
        """,
    ),
    Elsewhere(
        WORDS,
        "test_lazy_names",
        """
            core.lazy_names.*
        """,
    ),
    Elsewhere(
        WORDS,
        "test_in_notebooks",
        """
            core.in_notebooks.*
        """,
    ),
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
    Elsewhere(
        COMMANDS,
        "test_programs",
        """
            programs.*
        """,
    ),
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
    Elsewhere(
        CLOCK,
        "test_accuracy test_accuracy_knobs test_accuracy_several",
        """
            accuracy.*
        """,
    ),
    Elsewhere(
        CLOCK,
        "test_fit_accuracy",
        """
            fitting.accuracy.*
        """,
    ),
    Elsewhere(
        BOUNDS,
        "test_effects test_effects_sensor test_effects_optics test_effects_bodies",
        """
            effects.*
        """,
    ),
    Elsewhere(
        CHOICES,
        "test_programs",
        """
            fitting.inference.compiled: compiled_briefly
        """,
    ),
    Elsewhere(
        CHOICES,
        "test_from_memory foreign/test_exposure_stacks",
        """
            fitting.inference.precision: double_precision refuse_word_of_command
        """,
    ),
    Elsewhere(
        CHOICES,
        "test_sensor_light",
        """
            sensor.shutter: exposed
        """,
    ),
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
            rendering.edges: moving_edges
            rendering.maps: at_patch patch_of shading_normal summed varied_surfaces
            rendering.pixel_loop: check_lens each in_blocks mean_of_samples numbers_of photograph
            rendering.shading: lighting reflected_radiance
            rendering.shadows: clear
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
    Elsewhere(
        CHOICES,
        "test_types",
        """
            core._types: as_dtype
        """,
    ),
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
    Elsewhere(
        INTERPOLATED,
        "test_resampling",
        """
            filters.resampling: resize warp
        """,
    ),
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
    Elsewhere(
        WORDS,
        "foreign/test_scenes",
        """
            transport.missing: missing_light
        """,
    ),
    Elsewhere(
        TABLES,
        "test_optics_distortion",
        """
            optics.views: opencv_view
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
    Elsewhere(
        SOLVERS,
        "test_posterior test_nuts test_convergence test_importance test_fit",
        """
            fitting.inference.differences: seen_by_differences
            fitting.inference.blocks: begun length next_length stacked store
            fitting.inference.convergence: autocorrelation_times effective_draws split_r_hat
            fitting.inference.convergence: without_bias
            fitting.inference.emcee_run: enough_walkers for_group run_ensemble
            fitting.inference.blocks: fingerprint
            fitting.inference.importance: miss_about gaussian_miss laplace_where_it_holds
            fitting.inference.nuts: nuts require_blackjax
            fitting.inference.on_host: on_host require_here
            fitting.inference.posterior: estimates evaluate_density laplace laplace_or_emcee sample
            fitting.inference.posterior: walkers_at_a_time
            fitting.inference.trust: convergence_in_words cost_in_words is_trusted
        """,
    ),
    Elsewhere(
        SOLVERS,
        "test_solvers test_search test_varpro test_linear_parameters test_starts test_fit",
        """
            fitting.inference.newton: minimise
            fitting.inference.search: at_a_time given_start joined negative_log_density search
            fitting.inference.search: present_numbers spread_starts start_at starts_about unstarted
            fitting.inference.separable: amplitudes completed eliminated first_knots fit_amplitudes
            fitting.inference.separable: fit_separable closed_form_indices non_negative_amplitudes
            fitting.inference.separable: require_linear
        """,
    ),
    Elsewhere(
        SOLVERS,
        "test_problem test_plan_and_budget test_called_for test_prior_check test_influence",
        """
            fitting.fits.bands: bands pushed simulated thinned_draws
            fitting.fits.budget: budget
            fitting.fits.called_for: called_for
            fitting.fits.depicted: box_of named_record records_of without_effects
            fitting.fits.influence: influence measured
            fitting.fits.data_checks: data_check data_check_of_map
            fitting.fits.prior_check: blamed conflicts loosened
            fitting.fits.information: expected_information slope_of with_inputs
            fitting.fits.information: in_words plan
            fitting.fits.solve: fit method_of
            fitting.fits.widening: predicted_at residuals_at widening without_shared
        """,
    ),
    Elsewhere(
        SOLVERS,
        "test_side_by_side",
        """
            core.side_by_side.*
        """,
    ),
    Elsewhere(
        SOLVERS,
        "test_streams test_problem",
        """
            fitting.fits.widening: residual_sums
            fitting.inference.misfit: judge_sums sums
            fitting.inference.newton: minimise_many minimise_read twice
            fitting.inference.search: prior_derivatives squares with_prior
            fitting.inference.search: derivatives search_read
            fitting.inference.streams: chunks opened
        """,
    ),
    Elsewhere(
        SOLVERS,
        "test_fit_map test_problem",
        """
            fitting.fits.map: found_in_words
            fitting.fits.pixels: fit_map
            fitting.inference.pixelwise: fit_side_by_side
            fitting.inference.search: gauss_newton
        """,
    ),
    Elsewhere(
        STATISTICS,
        "test_likelihoods test_parameters test_problem test_clustering test_diagnostics "
        "test_joint_left_out test_joint_prior test_stated_errors test_neighbours",
        """
            fitting.inference.clustering: cluster_robust curvature_stretch like_gaussian
            fitting.inference.neighbours: regions
            fitting.inference.design: ranked
            fitting.inference.left_out: distance negligible
            fitting.inference.diagnostics: identifiability listed
            fitting.inference.estimates: find gaussian_estimate not_determined quantile_estimate
            fitting.inference.estimates: from_the_end sampled_estimate
            fitting.inference.given.*
            fitting.inference.likelihoods: check_data for_data named_width names_within numerics
            fitting.inference.likelihoods: with_noise_scaled with_values
            fitting.inference.misfit: judge
            fitting.inference.channels: by_channel
            fitting.inference.candidates: numbers_of price squared_ratios weakest whole_name
            fitting.inference.posterior: piled_at
            fitting.inference.parameters: ends log_prior names prior_gaussian prior_values scalars
            fitting.inference.parameters: from_scaled scaled_ends to_natural to_scaled
            fitting.inference.parameters: share_below to_unconstrained
            fitting.inference.parameters: log_flat_slopes natural_slopes numpy_or_jax
            fitting.inference.parameters: natural_numbers unconstrained_numbers
            fitting.inference.priors: support
            fitting.inference.joint_prior: as_prior log_dependence places_of posterior_prior
            fitting.inference.joint_prior: restricted scores selected with_joint_prior
            fitting.inference.problem: give least_squares_residuals likelihood_at log_density
            fitting.inference.problem: log_likelihood log_likelihood_terms log_prior_at prediction
            fitting.inference.problem: records_at
            fitting.inference.problem: residuals_from start_of_data values_at values_from
            fitting.inference.records: head is_path reach read replaced
            fitting.inference.problem: argument_names arguments as_arrays check_names finite_data
            fitting.inference.problem: missing_in_words
            fitting.inference.problem: named_and_rest
            fitting.inference.problem: placed placed_like
            fitting.inference.tails: log_student student_log_density
        """,
    ),
    Elsewhere(
        STATISTICS,
        "test_noise test_emva1288 test_photon_transfer test_noise_shared test_noise_neighbours "
        "test_noise_counts test_noise_prediction test_release_4 foreign/test_noise",
        """
            fitting.noise.counted.*
            fitting.noise.release_4.*
            fitting.noise.brighter_fatter.*
            fitting.noise.calibration: calibrate finest_read_noise sheet_estimate widened
            fitting.noise.emva1288: derived_figures evaluate is_floored least_dark_variance
            fitting.noise.emva1288: linearity_deviation linearity_errors ranges sheet statistics
            fitting.noise.statement: base_space candidates_for choose_model dark_scatter fitted
            fitting.noise.statement: fitted_without gain_drop likelihood_sheet named noise_data
            fitting.noise.statement: observations posterior_problem restated start_vector stated
            fitting.noise.levels: finer linear_levels rounding_step saturated_level
            fitting.noise.levels: saturation_index shot_of signal_of
            fitting.noise.levels: knee_of
            fitting.noise.model: compressed expected_electrons level_moments predict
            fitting.noise.model: predicted_moments expected_neighbours scatter_prior
            fitting.noise.neighbours.*
            fitting.noise.pattern: fitted_pattern pattern_variance standard_pattern unequal_gains
            fitting.noise.pattern: unequal_offsets
            fitting.noise.quantised: quantised_moments window_for
            fitting.noise.periodic: periodic_structure quarters residues taps_in_words taps_of
            fitting.noise.periodic: unequal_gains_of
            fitting.noise.regressions.*
            fitting.noise.window.*
            fitting.noise.shared: believed_lines drift extra_lines fixed_lines one_pattern
            fitting.noise.shared: shared_noise shared_variance temporal_lines
            fitting.noise.calibration: extra_in_flats without_flicker
            fitting.noise.doubts: drifting
            fitting.noise.live_pixels: hits
            fitting.noise.calibration: refitted
            fitting.noise.prediction.comparison.*
            fitting.noise.prediction.missing.*
            fitting.noise.prediction.moments.*
            fitting.noise.prediction.predict.*
        """,
    ),
    Elsewhere(
        STATISTICS,
        "test_codes foreign/test_frames foreign/test_series_of_flats",
        """
            fitting.codes: converter_of
            fitting.frame_checks.dialled: exact_times
            fitting.frame_checks.exposures: blank_images odd_exposures refuse_toned
            fitting.frame_checks.levels: odd_frames
            fitting.frame_checks.heads: odd_heads
            fitting.frame_checks.between_levels: distribution_of_levels light_of_levels
            fitting.frame_checks.between_levels: noise_of_levels
            fitting.frame_checks.compared: scaled_to_one_mean rms trimmed_variance without_lines
            fitting.frame_checks.deviates: beyond_chance usual_size
            fitting.frame_checks.moved: moved_frames
            fitting.noise.doubts: doubts
            fitting.noise.live_pixels: dead_pixels
            fitting.noise.doubts: multiplied
            fitting.noise.raw_frames: block_products combs is_compressed local_variance
            fitting.noise.raw_frames: tone_curve
            fitting.noise.live_pixels: stuck_bits
        """,
    ),
    Elsewhere(
        STATISTICS,
        "test_noise_settings",
        """
            fitting.noise.across_settings.calibration: calibrate_one calibrate_settings
            fitting.noise.across_settings.calibration: full_well pattern
            fitting.noise.across_settings.statement: figures fitted predict proportional_gain
            fitting.noise.across_settings.setting: estimates_from_calibration estimates_from_darks
            fitting.noise.across_settings.setting: read_by_setting reduce_by_setting
            fitting.noise.across_settings.prediction: predict_settings
        """,
    ),
    Elsewhere(
        STATISTICS,
        "test_response_curve test_response_gamma test_response foreign/test_exposure_stacks",
        """
            fitting.response.beyond: extrapolated
            fitting.response.shutter: mixed over_tau prior_of
            fitting.response.calibration: alike calibrate radiance_images
            fitting.response.code_bins: code_bins interval_variance
            fitting.response.code_pairs: pair_statistics statistics_of_parts total
            fitting.response.curve: fit_response_curve ripple slope_error
            fitting.response.gamma: fit_gamma given_shutter log_code_means log_density space_of
            fitting.response.moved: moved_exposures
            fitting.response.pilot: degrees_of_freedom fit_noise fit_pilot rebinned rising
            fitting.response.clipping: clear_of_clipping
            fitting.response.colour_rounding: shared_rounding with_shared_rounding
            fitting.response.flat_places: well_registered to_flat_places
            fitting.response.places: equal_classes layout_of tiles_of
            fitting.response.radiance_map: exposure_of_codes merge
            fitting.response.repeats: exposure_jackknife tile_jackknife widened
            fitting.response.shape: error_of_departure judged_codes largest largest_departure shapes
            fitting.response.solve: bin_centre_curve equations_of inverse roughness shutter_basis
            fitting.response.solve: solve spread_of_times
            fitting.response.weights: cells_of coarsest hat_rule noise_rule noise_variance observe
            fitting.response.weights: undithered
            fitting.response.weights: weighted_mean
        """,
    ),
    Elsewhere(
        STATISTICS,
        "test_joint test_joint_nuts test_joint_left_out test_joint_turns test_stated_errors",
        """
            fitting.joint.calibration: calibrate is_determined
            fitting.joint.cells: cell_width image_geometry make_grid pixels_at reduce_images
            fitting.joint.fit: first_noise first_reflectance fit_channel fit_turned image_errors
            fitting.joint.fit: is_searched_shape likeliest_turns with_misfit without_small_errors
            fitting.joint.misfit: fit_halves degrees_of_freedom laplace_miss image_sandwich
            fitting.joint.misfit: unequal_pixels widened
            fitting.joint.marginal: chi_square image_error_means log_density scatter_log_density
            fitting.joint.model: black_level cost log_likelihood log_likelihood_by_image
            fitting.joint.model: log_posterior of_surface parameters predicted predicted_parts
            fitting.joint.model: residuals scatter_scales values_at weights
            fitting.joint.prediction: predict score
        """,
    ),
    Elsewhere(
        STATISTICS,
        "test_brdf_fit test_comparison test_fitted_material foreign/test_surfaces",
        """
            fitting.reflectance.from_files.calibration: albedo amplitudes calibrate
            fitting.reflectance.from_files.errors: best describes errors exceeds_signal in_words
            fitting.reflectance.from_files.errors: best_about_axis metric ratio
            fitting.reflectance.from_files.errors: prediction_of_held_out
            fitting.reflectance.from_files.errors: weight_by_incidence winner_of
            fitting.reflectance.from_files.fit: brdf compressed darkness fit_model fit_models
            fitting.reflectance.from_files.fit: compared_quantity problem_of reflected
            fitting.reflectance.models: amplitude check_index facet_sentence has_lobe log_range
            fitting.reflectance.models: is_searched
            fitting.reflectance.models: shape_of shape_range surface_space unit_brdf unit_shading
        """,
    ),
    Elsewhere(
        STATISTICS,
        "test_reflectance test_reflectance_plan test_shading_check test_spread test_stated_errors "
        "test_comparison",
        """
            fitting.reflectance.from_images.calibration: calibrate mean_residual open_parameters
            fitting.reflectance.from_images.calibration: residual_of_images
            fitting.reflectance.from_images.comparison: compare comparison_table difference
            fitting.reflectance.from_images.comparison: equally_good only_if_described relative_rms
            fitting.reflectance.from_images.comparison: squares_by_light
            fitting.reflectance.from_images.comparison: surpassed_by verdict
            fitting.reflectance.from_images.fit: adjusted_log_density adjusted_posterior
            fitting.reflectance.from_images.fit: channel_posterior composite fit_channel
            fitting.reflectance.from_images.fit: lights_as_fitted predicted_image robust
            fitting.reflectance.from_images.fit: robust_covariance squared_errors
            fitting.reflectance.from_images.lights: among_turns beyond_turns information_on_turns
            fitting.reflectance.from_images.lights: likeliest_turns no_more_than shifts_of_turns
            fitting.reflectance.from_images.lights: stated_errors turned with_stated_errors
            fitting.reflectance.from_images.lights: with_wider_directions
            fitting.reflectance.from_images.optimum: best fit_spread flat_spread minimise_samples
            fitting.reflectance.from_images.optimum: optimum project residual_signal_slope
            fitting.reflectance.from_images.optimum: sensor_spread variance weighed
            fitting.reflectance.from_images.optimum: weighed_and_fitted weighted
            fitting.reflectance.from_images.plan: added_information check_target plan plan_section
            fitting.reflectance.from_images.samples: average cells_of cost_and_information group
            fitting.reflectance.from_images.samples: image_view inverse_deviation
            fitting.reflectance.from_images.samples: log_likelihood_of_dn log_likelihoods predict
            fitting.reflectance.from_images.samples: saturated_only scores_and_slopes select
            fitting.reflectance.from_images.samples: total_log_likelihood
            fitting.reflectance.from_images.shading_check: contradictions directions_by_shading
            fitting.reflectance.from_images.shading_check: without_strangers
            fitting.reflectance.from_images.signal: decoded encoded encoding_slope in_plane
            fitting.reflectance.from_images.signal: lobe_with_slopes local_geometry parameter_space
            fitting.reflectance.from_images.signal: signal stored surface_parameters unit_lobe
            fitting.reflectance.from_images.read: lightless_images
        """,
    ),
)
