"""Tests files of calibrated materials with their draws."""

import jax.numpy as jnp
import numpy as np
import pytest

from fitting.inference.parameters import Parameter
from fitting.inference.posterior import Posterior
from fitting.reflectance.material import material_files
from fitting.reflectance.models import REFLECTANCES, has_lobe
from jaxvision import Phong, Vec, read_material
from jaxvision.brdf import shading

RNG = np.random.default_rng(6)
COSINE, TILT = 0.8, 0.6  # of the light; the view is along the normal


def posterior(labels):
    draws = RNG.uniform(0.2, 0.4, (1, 30, len(labels)))
    mode = draws.mean(axis=(0, 1))
    space = tuple(Parameter(name) for name in labels)
    return Posterior(space, "Laplace", draws, mode, np.log(mode), np.eye(len(labels)), seed=0)


def shaded(material):
    wi, wo = (Vec(*(jnp.asarray(float(x)) for x in v)) for v in ((TILT, 0, COSINE), (0, 0, 1)))
    return np.asarray(shading(material, wi, wo))


def test_a_fitted_phong_shades_by_its_equation(tmp_path):
    found = posterior(["diffuse", "specular", "exponent", "gamma"])
    (name, write), = material_files({"grey": ("phong", 1.5, found)}).items()  # fmt: skip
    write(tmp_path / f"{name}.toml")
    assert name == "material"
    k_d, k_s, n, _ = found.mode
    np.testing.assert_allclose(
        shaded(read_material(tmp_path / "material.toml")), k_d * COSINE + k_s * COSINE**n, rtol=1e-6
    )
    many = read_material(tmp_path / "material.toml", draws=30)
    assert isinstance(many, Phong)
    np.testing.assert_allclose(many.specular[:, 0], found.samples[:, 1], rtol=1e-6)


@pytest.mark.parametrize("model", REFLECTANCES)
def test_every_model_has_its_record(tmp_path, model):
    row = REFLECTANCES[model]
    labels = ["diffuse", *(["specular"] if has_lobe(model) else [])]
    labels += [] if row.shape is None else [row.shape.name]
    files = material_files({c: (model, 1.4, posterior(labels)) for c in ("red", "blue")})
    assert list(files) == ["material_red", "material_blue"]
    files["material_red"](tmp_path / "red.toml")
    material = read_material(tmp_path / "red.toml", draws=7)
    for name in labels:
        field = "sigma" if (model, name) == ("oren-nayar", "roughness") else name
        assert getattr(material, field).shape[0] == 7
