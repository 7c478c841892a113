"""Tests that a name that a package lacks is answered by its location, or by the nearest name."""

import pytest

import fitting
import jaxvision


@pytest.mark.parametrize(
    ("package", "name", "said"),
    [
        (jaxvision, "equalise", "jaxvision has no 'equalise'; it is jaxvision.histogram.equalise."),
        (
            jaxvision,
            "read_settings",
            "jaxvision has no 'read_settings'; it is jaxvision.files.read_settings.",
        ),
        (
            jaxvision,
            "scene_problems",
            "jaxvision has no 'scene_problems'; from jaxvision.rendering.scene_checks import "
            "scene_problems gives it.",
        ),
        (
            jaxvision,
            "render_command",
            "jaxvision has no 'render_command'; import jaxvision.render_command gives it.",
        ),
        (jaxvision, "over", "jaxvision has no 'over'; it is jaxvision.matting.over."),
        (
            jaxvision,  # `effects` has an internal function of this name
            "dark_current",
            "jaxvision has no 'dark_current'; it is a field of jaxvision.Sensor.",
        ),
        (
            jaxvision,
            "focal_length",
            "jaxvision has no 'focal_length'; it is a field of jaxvision.Pinhole, "
            "jaxvision.ThinLens.",
        ),
        (jaxvision, "Sensr", "jaxvision has no 'Sensr'; the nearest is 'Sensor'."),
        (
            jaxvision.filters,
            "gausian",
            "jaxvision.filters has no 'gausian'; the nearest is 'gaussian'.",
        ),
        (fitting, "from_frames", "fitting has no 'from_frames'; it is fitting.noise.from_frames."),
        (fitting, "zzz", "fitting has no 'zzz'; dir(fitting) lists what it has."),
    ],
)
def test_a_missing_name_is_answered_by_the_nearest(package, name, said):
    with pytest.raises(AttributeError) as caught:
        package.__getattr__(name)  # in case a module was imported before
    assert str(caught.value) == said
    assert not hasattr(package, f"_{name}")


def test_an_import_of_a_missing_name_is_answered():
    with pytest.raises(ImportError, match="cannot import name 'Sensr'"):
        from jaxvision import Sensr  # pyright: ignore # noqa: F401
