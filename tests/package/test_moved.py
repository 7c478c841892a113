"""Tests that former names of modules give the same modules, with a warning that gives the new
name."""

import importlib
import pickle
import subprocess
import sys
import warnings
from types import SimpleNamespace

import numpy as np
import pytest

import jaxvision
from fitting.fits.budget import Budget, Share
from fitting.fits.influence import Influence, Moved
from fitting.inference import Robustness
from fitting.noise.calibration import NoiseCalibration
from fitting.noise.prediction.predict import Prediction
from fitting.reflectance.from_images.calibration import ReflectanceCalibration
from fitting.response import Layout
from fitting.rig import Camera
from jaxvision.core._moved import MOVED, RENAMED


@pytest.mark.parametrize("old", sorted(MOVED))
def test_an_old_name_gives_the_module_and_says_the_new_one(old):
    name = old.removeprefix("jaxvision.")
    sys.modules.pop(old, None)
    with pytest.warns(DeprecationWarning, match=f"{old} is now {MOVED[old]}.") as said:
        found = importlib.import_module(old)
    assert len(said) == 1
    assert found is importlib.import_module(MOVED[old]) is sys.modules[old]
    assert found.__name__ == found.__spec__.name == MOVED[old]
    with pytest.warns(DeprecationWarning, match=old) as said:
        assert jaxvision.__getattr__(name) is found
    assert said[0].filename == __file__


@pytest.mark.parametrize("old", sorted(RENAMED))
def test_an_old_name_of_a_function_gives_it_and_says_the_new_one(old):
    package, _, name = old.rpartition(".")
    holder = importlib.import_module(package)
    with pytest.warns(DeprecationWarning, match=f"{old} is now {package}.{RENAMED[old]}.") as said:
        assert getattr(holder, name) is getattr(holder, RENAMED[old])
    assert said[0].filename == __file__


@pytest.mark.parametrize(
    ("kind", "old", "new"),
    [
        (Robustness, "by_light", "light_design_effect"),
        (Robustness, "by_pixel", "pixel_design_effect"),
        (NoiseCalibration, "shown", "estimates"),
        (Camera, "in_parts", "has_tap_regions"),
        (Prediction, "judged", "main_comparison"),
        (ReflectanceCalibration, "reported", "chosen_fits"),
    ],
)
def test_an_old_name_of_an_attribute_gives_it_and_says_the_new_one(kind, old, new):
    value = object()
    with pytest.warns(DeprecationWarning, match=f"{old} is now {new}."):
        assert getattr(kind, old).fget(SimpleNamespace(**{new: value})) is value


def test_an_old_name_of_a_method_gives_its_result_and_says_the_new_one():
    layout = Layout(*np.arange(12).reshape(4, 3))
    with pytest.warns(DeprecationWarning, match=r"at is now select\."):
        assert layout.at(slice(1, 2)).rows == 7
    budget = Budget("gain", 1.0, 0.1, (Share("shot noise", 0.7, 0.08),))
    with pytest.warns(DeprecationWarning, match=r"of is now share_of\."):
        assert budget.of("shot noise") == 0.7
    moved = Moved("sensor.dark_current", 0.02, 0.021, 1.0, 0.1)
    with pytest.warns(DeprecationWarning, match=r"of is now shift_by\."):
        assert Influence("gain", 1.0, 0.1, (moved,)).of("sensor.dark_current") is moved


def test_a_submodule_of_an_old_name_is_loaded_once():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from jaxvision.measured_files import merl  # pyright: ignore
    from jaxvision.files.measured import merl as same

    assert merl is same


def test_the_warning_of_an_old_name_points_to_the_import():
    program = "from jaxvision import io\nimport jaxvision.scene_files\nassert io.read_image"
    done = subprocess.run(
        [sys.executable, "-W", "default", "-c", program], capture_output=True, text=True
    )
    assert not done.returncode
    lines = [line for line in done.stderr.splitlines() if "DeprecationWarning" in line]
    where = [line.split(": ")[0] for line in lines]  # Python 3.13 also shows the source
    assert where == ["<string>:1", "<string>:2"]


def test_records_that_were_pickled_under_old_names_are_read():
    vector = jaxvision.Vec(1.0, 2.0, 3.0)
    kept = pickle.dumps(vector, protocol=0).replace(b"jaxvision.core._vector", b"jaxvision._vector")
    assert b"jaxvision._vector" in kept
    sys.modules.pop("jaxvision._vector", None)
    with pytest.warns(DeprecationWarning, match="_vector"):
        found = pickle.loads(kept)
    assert found == vector
