"""Tests that every approximation of the library has a `Knob`, and that every `Knob` changes some
setting."""

import pytest
from public_names import arguments_and_fields, ghosts, unknown, words

import jaxvision
from jaxvision.accuracy import KNOBS, curve
from jaxvision.accuracy.examples import example, examples
from jaxvision.errors import InputError
from jaxvision.files.scenes.schema import RenderEntry

# A public argument or field with one of these names trades error for time and needs a `Knob` ...
WORDS = words("""
order samples depth count rays paths patches gather moments slots oversampling sigmas members rank
layers truncate tolerance rtol atol limit max_steps coarse_steps fine_steps roulette strategy rule
shot_noise thetas phis azimuths polar split steps method dtype interpolation iterations
max_iterations terms nodes knots panels subdivisions degree refine cutoff precision
""")
# (these have one meaning everywhere) ...
ANYWHERE = set(words("rule dtype split slots gather truncate shot_noise interpolation"))
# ... except these, where the word means something else: a derivative's order, a depth map, a count
# of things, data, a choice between definitions, the dtype of a result, a setting that does not save
# time when reduced, or one that changes derivatives only.
OTHER = words("""
*.gaussians.*.order *.gaussian_kernel.order *.defocus.*.depth *.defocus.*.members *.Sorted.members
*.split_by_rule.members *.files.scenes.* *.files.records.* *.bounce.count *.rules_of.*
*.colour_data.*
*.adapt.method *.demosaic.method *.Demosaicing.method *.interpolate_spectrum.method *.resize.method
*.mean_of_samples.* *.IsotropicTable.azimuths *.measured.sample_directions.samples
*.write_cornell.samples *.table_of_samples.samples *.path*.method *.shifted_lattice.*
*.gauss_legendre.* *.read_mesh.dtype *.scipy_operator.dtype *.fixed_pattern.* *.read_out.*
*.aperture_corners.dtype *.light_nodes.dtype *.prune_scene.tolerance *.capture.tolerance *.moments.*
*.shot_noise.count.shot_noise *.compositing.flatten.layers *.tasks.workers.count
*.register_extended.nodes *.register.moments *.demosaic_menon.refine *.nonlocal_means_filter.cutoff
*.missing_light.depth *.missing_light.samples *.convolution.summed.method *.new_axes.polar
*.ray_options.paths *.matte_errors.* *.MatteErrors.* *.maps.Patch.steps
*.zernike.count *.wavefront_kernel.samples *.wavefront_otf.samples *.Wavefront.samples *.Edges.nodes
*.moving_edges.samples
""")


def approximations():
    """Return the public arguments and fields whose names contain one of `WORDS`."""
    apart = ("jaxvision.effects.", "jaxvision.accuracy.")
    found = arguments_and_fields(jaxvision)
    return [n for n in found if n.rpartition(".")[2] in WORDS and not n.startswith(apart)]


def test_every_approximation_has_a_knob():
    """A new argument or field with such a name fails here until a `Knob` includes it."""
    known = [pattern for knob in KNOBS.values() for pattern in knob.sets]
    found = approximations()
    assert len(found) > 60
    assert not unknown(found, known + OTHER)


@pytest.mark.parametrize("word", sorted(set(WORDS) - ANYWHERE))
def test_an_approximation_that_no_knob_names_is_found(word):
    """The planted name belongs to a function that does not exist."""
    known = [pattern for knob in KNOBS.values() for pattern in knob.sets]
    assert unknown([f"jaxvision.filters.planted.planted.{word}"], known + OTHER)


def test_every_pattern_names_something_that_is_there():
    patterns = [pattern for knob in KNOBS.values() for pattern in knob.sets] + OTHER
    assert not ghosts(patterns, arguments_and_fields(jaxvision))


def test_every_knob_changes_some_setting():
    """Each knob is a key of `[render]` or has an example of its own."""
    of_scene = {"light samples", *RenderEntry.model_fields}  # samples occur as an order, too
    assert set(KNOBS) - set(examples()) == set(KNOBS) & of_scene
    assert set(examples()) <= set(KNOBS)
    with pytest.raises(InputError, match="has no example of its own"):
        example("samples")


def test_settings_are_listed_cheapest_first_and_references_are_finer():
    for knob in KNOBS.values():
        steps = [s for s in (*knob.settings, *knob.reference) if isinstance(s, int | float)]
        assert steps == sorted(steps) or steps == sorted(steps, reverse=True), knob.name
        assert len(set(knob.settings)) == len(knob.settings) >= 2, knob.name
        known = knob.random or knob.reference or knob.name in ("adaptive nodes", "interpolation")
        assert known, knob.name


@pytest.mark.sweep("Gaussian cut", "curve table")
@pytest.mark.parametrize("name", sorted(examples()))
def test_the_error_of_an_example_is_known_and_falls(name):
    """The error falls from the cheapest to the finest setting. Without a declared order it may stay
    equal."""
    problem, knob = example(name), KNOBS[name]
    found = curve(problem, knob, settings=(knob.settings[0], knob.settings[-1]), seconds=1e5)
    assert not found.stopped
    first, last = (trial.error for trial in found.trials)
    if knob.order is not None or knob.law == "geometric":
        assert last < first / 1.5
    assert first < 1.5
