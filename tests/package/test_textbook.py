"""Tests that textbook terms lead to the names and arguments used here."""

import inspect
import re
import subprocess
import sys
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path

import pytest

import fitting
import jaxvision as jv
from jaxvision._textbook import TARGETS, folded
from jaxvision.errors import nearest
from jaxvision.files.scenes import tables

NOTIONS = Path(__file__).parents[2] / "docs" / "notions.md"


def is_public(name):
    """Return whether the site's reference has this name. It has functions and classes, not
    modules."""
    for root in ("jaxvision", "fitting"):
        module, _, last = f"{root}.{name}".rpartition(".")
        try:
            holder = import_module(module)
        except ImportError:
            continue
        if last in getattr(holder, "__all__", dir(holder)):
            return not inspect.ismodule(getattr(holder, last))
    return False


def words_of_arguments():
    """Return the fields of records, arguments of functions and keys of files that users write."""
    found = {"albedo", *inspect.signature(tables.VIEWS["pinhole"]).parameters}
    for package in (jv, jv.filters, jv.optics, jv.sensor, fitting):
        for one in (getattr(package, name) for name in package.__all__):
            if is_dataclass(one):
                found |= {field.name for field in fields(one)}
            elif inspect.isfunction(one):
                found |= set(inspect.signature(one).parameters)
    return found


def test_every_target_exists():
    known = words_of_arguments()
    lost = {
        t for targets in TARGETS.values() for t in targets if not is_public(t) and t not in known
    }
    assert not lost


def test_the_page_of_notions_has_every_word():
    text = NOTIONS.read_text().partition("## Other words")[2]
    listed = {
        folded(word): set(re.findall(r"`(?:jaxvision\.|fitting\.)?([\w.]+)`", here))
        for words, here in re.findall(r"^\| (.*?) \| (.*) \|$", text, re.MULTILINE)
        for word in words.split(",")
    }
    assert {word: set(targets) for word, targets in TARGETS.items()}.items() <= listed.items()


@pytest.mark.parametrize(
    ("word", "here"),
    [
        ("lens_law", "jaxvision.image_distance"),
        ("grayscale", "jaxvision.colour_spaces.luminance"),
        ("equalize", "jaxvision.histogram.equalise"),
        ("CCD", "jaxvision.Sensor or jaxvision.read_camera"),
        (
            "Vignetting",
            "jaxvision.sensor_irradiance, jaxvision.Rim or jaxvision.point_ops.vignette",
        ),
        ("motion_blur", "jaxvision.capture or jaxvision.RollingShutter"),
        ("k_e", "the argument 'exponent'"),
        ("demosaicing", "jaxvision.demosaic"),
        ("dof", "jaxvision.depth_of_field"),
        ("foreshortening", "jaxvision.lambert_shading or jaxvision.irradiance"),
        ("alpha_blending", "jaxvision.matting.over or jaxvision.matting.composite"),
        (
            "BRDF",
            "jaxvision.brdf.evaluate, jaxvision.brdf.families, jaxvision.Lambert, "
            "jaxvision.PhongBRDF or jaxvision.TorranceSparrow",
        ),
        ("depth_of_focus", "jaxvision.image_distance or jaxvision.circle_of_confusion"),
        ("gain_error", "the argument 'prnu'"),
        ("photon_transfer", "fitting.noise.from_frames or fitting.noise.calibrate"),
    ],
)
def test_a_name(word, here):
    with pytest.raises(AttributeError) as caught:
        getattr(jv, word)
    assert str(caught.value) == f"jaxvision has no {word!r}; here it is {here}."


@pytest.mark.parametrize(
    ("package", "word", "here"),
    [
        (jv.filters, "convolution", "jaxvision.filters.convolve"),
        (
            jv.optics,
            "vignetting",
            "jaxvision.sensor_irradiance, jaxvision.Rim or jaxvision.point_ops.vignette",
        ),
    ],
)
def test_a_word_that_is_also_a_module_leads_to_the_function_first(package, word, here):
    name = package.__name__
    code = (
        f"import {name}\n"
        "try:\n"
        f"    {name}.{word}\n"
        "except AttributeError as error:\n"
        "    print(error)\n"
    )  # other tests may have imported the module
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    said = f"here it is {here}; import {name}.{word} gives the module."
    assert done.stdout == f"{name} has no {word!r}; {said}\n"


@pytest.mark.parametrize("word", ["flare", "polarization"])
def test_an_effect_that_is_not_modelled(word):
    with pytest.raises(AttributeError, match=f"no '{word}'; the library does not model it"):
        getattr(jv, word)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: jv.Phong(k_d=[0.1], k_s=[0.1]), "Phong has no field 'k_d'; here it is 'diffuse'."),
        (
            lambda: jv.Sensor(black_level=64),
            "Sensor has no field 'black_level'; here it is 'offset'.",
        ),
        (
            lambda: jv.TorranceSparrow([0.1], [0.1], alpha=0.3),
            "TorranceSparrow has no field 'alpha'; here it is 'roughness'.",
        ),
        (
            lambda: jv.Pinhole(aperture=8),
            "Pinhole has no field 'aperture'; here it is 'f_number'.",
        ),
        (
            lambda: jv.Phong([0.1], k_s=[0.1], exponent=2),
            "Phong has no field 'k_s'; here it is 'specular'.",
        ),
        (
            lambda: jv.GaussianLobe([0.1], [0.1], c_s=2),
            "GaussianLobe has no field 'c_s'; here it is 'concentration'.",
        ),
        (
            lambda: jv.image_distance(z_o=1.0, focal_length=0.1),
            "image_distance has no argument 'z_o'; here it is 'object_distance'.",
        ),
        (
            lambda: jv.PointLight(position=[0, 0, 1], I=[1.0]),
            "PointLight has no field 'I'; here it is 'intensity'.",
        ),
        (
            lambda: jv.Lambert(albdo=[0.1]),
            "Lambert has no field 'albdo'; 'albedo' is here 'diffuse'.",
        ),
        (
            lambda: jv.Sensor(dark_noise=2),
            "Sensor has no field 'dark_noise'; here it is 'read_noise' or 'dark_current'.",
        ),
        (
            lambda: jv.Sphere(center=[0, 0, 0], radius=1),
            "Sphere has no field 'center'; the nearest is 'centre'.",
        ),
    ],
)
def test_an_argument(call, said):
    with pytest.raises(TypeError) as caught:
        call()
    assert str(caught.value) == said


def test_a_key_of_a_file():
    assert nearest("k_d", ["albedo", "specular"]) == "here it is 'albedo'"


def test_a_record_still_takes_what_its_own_initialiser_does():
    assert jv.Sphere(centre=[0, 0, 0], radius=1).radius == 1
