"""Tests the simulated afternoon against its true values, by plain NumPy on the files."""

import tomllib

import numpy as np
import pytest

from fitting.demo.lab import simulate_lab
from jaxvision.files.images import read_image


class EnoughError(Exception):
    """Ends a simulation after a few images."""


def first_flat(folder, seed):
    def progress(written, total):
        if written == 1:
            raise EnoughError

    with pytest.raises(EnoughError):
        simulate_lab(folder, seed=seed, progress=progress)
    return read_image(folder / "noise" / "flat_00_00.tif")


@pytest.mark.slow
def test_the_seed_makes_the_images(tmp_path):
    """The same seed gives the same images, and another seed gives independent noise."""
    one, again, other = (
        first_flat(tmp_path / name, seed) for name, seed in (("a", 3), ("b", 3), ("c", 4))
    )
    np.testing.assert_array_equal(again, one)
    assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 5 / np.sqrt(one.size)


def test_photon_transfer_of_the_files_gives_the_simulated_gain(lab):
    folder, truth = lab
    rig = tomllib.loads((folder / "noise" / "rig.toml").read_text())
    points = []
    for flat, dark in zip(rig["flat"], rig["dark"], strict=True):
        levels = []
        for entry in (flat, dark):
            a, b = (read_image(folder / "noise" / f).astype(float) for f in entry["files"][:2])
            levels.append(((a + b).mean() / 2, ((a - b) ** 2).mean() / 2, np.var(a - b) / 2))
        points.append((levels[0][0] - levels[1][0], levels[0][2] - levels[1][2]))
    mean, variance = np.array([p for p in points if p[0] < 0.7 * 3750]).T
    gain = mean @ variance / (mean @ mean)
    # Each variance has a relative error of sqrt(2 / 76800), and the tolerance is five standard
    # errors of their mean.
    np.testing.assert_allclose(gain, truth.system_gain, rtol=5 * np.sqrt(2 / 76800))


def test_deep_stacks_show_the_fixed_pattern(lab):
    folder, truth = lab
    rig = tomllib.loads((folder / "noise" / "rig.toml").read_text())
    deep = [max(rig[kind], key=lambda e: len(e["files"])) for kind in ("flat", "dark")]
    flat, dark = (
        np.stack([read_image(folder / "noise" / f) for f in entry["files"]]).astype(float)
        for entry in deep
    )

    def pattern(stack):
        return stack.mean(0).var() - stack.var(0, ddof=1).mean() / len(stack)

    signal = flat.mean() - dark.mean()
    prnu = np.sqrt(pattern(flat) - pattern(dark)) / signal
    np.testing.assert_allclose(prnu, truth.prnu, rtol=0.03)
    np.testing.assert_allclose(np.sqrt(pattern(dark)) / truth.system_gain, truth.dsnu, rtol=0.05)


def test_the_stack_is_8_bit_colour_and_the_sphere_clips_only_in_its_highlight(lab):
    folder, truth = lab
    stack = read_image(folder / "response" / "stack_04.png")
    assert stack.dtype == np.uint8
    assert stack.shape[2] == 3
    sphere = read_image(folder / "brdf" / "light_00.tif")
    assert sphere.dtype == np.uint16
    clipped = (sphere >= truth.system_gain * truth.full_well).mean()
    assert 0 < clipped < 0.01
