"""Tests that conversions keep dtypes, checks name the value, and grouping keeps the order."""

import inspect
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from beartype import beartype
from jaxtyping import TypeCheckError, jaxtyped

import fitting
import jaxvision as jv
from jaxvision.brdf.lambert import Lambert
from jaxvision.brdf.phong import Phong
from jaxvision.core._loops.groups import group_by_structure, take
from jaxvision.core._types import (
    Colour,
    Key,
    as_dtype,
    as_float,
    as_optional_float,
    check_choice,
    check_count,
    check_kind,
    check_shape,
    members_of,
)
from jaxvision.lights.rules import Rule
from jaxvision.scene import Sphere
from jaxvision.scene.shapes import Shape
from jaxvision.scene.views import View


def test_aliases_print_as_their_names_and_still_check():
    """This holds in signatures and type errors. Axes of one name still have one length."""

    @jaxtyped(typechecker=beartype)
    def mixed(a: Colour, b: Colour, key: Key) -> Colour:
        return a + b

    assert str(inspect.signature(mixed)).count("jaxvision.Colour") == 3
    assert str(inspect.signature(mixed)).count("jaxvision.Key") == 1
    for key in (jax.random.key(1), jax.random.PRNGKey(1)):
        assert mixed(jnp.ones(3), jnp.ones(3), key).shape == (3,)
    for wrong in ((jnp.ones(4), jax.random.key(1)), (jnp.ones(3), jnp.ones(3))):
        with pytest.raises(TypeCheckError, match=r"jaxvision\.(Colour|Key)"):
            mixed(jnp.ones(3), *wrong)


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_floating_dtypes_are_kept(dtype):
    assert as_float(np.ones(2, dtype)).dtype == jnp.ones(2, dtype).dtype


@pytest.mark.parametrize("x", [1, 1.0, True, np.int32(3), jnp.asarray(1.0)])
def test_other_dtypes_become_the_default_and_strong(x):
    array = as_float(x)
    assert array.dtype == jnp.result_type(float)
    assert not array.weak_type
    assert float(array) == float(x)


def test_none_stays_none():
    assert as_optional_float(None) is None
    assert as_optional_float(2) == 2


def test_as_dtype_changes_floating_leaves_only():
    tree = as_dtype({"a": jnp.ones(2), "b": jnp.arange(2)}, jnp.float32)
    assert tree["a"].dtype == jnp.float32
    assert tree["b"].dtype == jnp.arange(2).dtype


def test_a_record_in_float32_stays_in_float32():
    sphere = Sphere(np.zeros(3, np.float32), np.float32(1))
    assert {leaf.dtype for leaf in jax.tree.leaves(sphere)} == {jnp.dtype("float32")}


def test_shape_checks_name_got_and_expected():
    check_shape("x", jnp.zeros((2, 5)), (), (2, "bands"))
    check_shape("x", None, (3,))
    with pytest.raises(ValueError, match=r"x must have shape \(\) or \(bands,\), got \(2, 3\)"):
        check_shape("x", jnp.zeros((2, 3)), (), ("bands",))


@pytest.mark.parametrize("root", [jv, fitting])
def test_signatures_name_unions(root):
    """No signature spells out the members of a union, so that `help` is readable."""
    for name in dir(root):
        offered = getattr(root, name)
        is_error = isinstance(offered, type) and issubclass(offered, Exception)
        if name.startswith("_") or not callable(offered) or is_error:
            continue
        parameters = inspect.signature(offered).parameters.values()
        assert all(len(str(one)) <= 170 for one in parameters), name
        if not isinstance(offered, type):  # a record has as many fields as effects
            assert len(str(inspect.signature(offered))) <= 700, name


@pytest.mark.parametrize("root", [jv, fitting])
def test_signatures_in_modules_name_unions(root):
    """This holds for arguments that NumPy converts to arrays, and for numbers with a range."""
    rooms = [thing for name in root.__all__ if inspect.ismodule(thing := getattr(root, name))]
    offered = [getattr(room, name) for room in rooms for name in getattr(room, "__all__", ())]
    said = [str(inspect.signature(one)) for one in offered if inspect.isfunction(one)]
    assert len(said) > 20
    assert max(map(len, said)) <= 880
    assert not [one for one in said if "_SupportsArray" in one or "FieldInfo" in one]
    assert "bits: int, gamma: Optional[float]" in str(inspect.signature(fitting.joint.Camera))


def test_the_type_of_arguments_that_numpy_converts_has_a_name():
    for given in (jnp.ones(2), np.ones(2), np.float32(1), 1, 1.5, True, [[1, 2], [3, 4]], (1.0,)):
        assert isinstance(given, jv.ArrayLike), given
    for wrong in (None, object(), {1.0}):
        assert not isinstance(wrong, jv.ArrayLike), wrong


def test_a_union_of_records_with_a_name_is_still_a_union():
    assert isinstance(Sphere([0, 0, 0], 1.0), Shape)
    assert not isinstance(Lambert([0.3]), Shape)
    assert "jaxvision.View" in str(inspect.signature(jv.render))
    assert members_of(Rule | None) == (jv.Quadrature, jv.MonteCarlo, jv.Balanced, type(None))
    with pytest.raises(ValueError, match="x must be a record, Orthographic or Pinhole or Thin"):
        check_kind("x", 1.0, View)


def test_kinds_counts_and_choices_are_named():
    check_kind("x", None, Lambert)
    check_kind("x", Lambert([0.3]), Lambert | Phong, Sphere)
    for value, got in ((2.0, "got 2.0"), ("a", "got 'a'"), (Lambert, "got the class Lambert")):
        with pytest.raises(ValueError, match=f"x must be a record, Phong or Sphere, {got}"):
            check_kind("x", value, Phong | Sphere)
    for value, got in ((jnp.zeros(3), "an array"), (Sphere([0, 0, 0], 1.0), "a Sphere")):
        with pytest.raises(ValueError, match=f"Phong or Lambert, got {got}"):
            check_kind("x", value, Phong | Lambert)
    check_count("n", np.int32(3), 3, odd=True)
    for value in (3.0, True, "3", None, 2, jnp.asarray(3)):
        with pytest.raises(ValueError, match="n must be a whole number of at least 3, got"):
            check_count("n", value, 3)
    with pytest.raises(ValueError, match="n must be an odd number of at least 1, got 4"):
        check_count("n", 4, 1, odd=True)
    with pytest.raises(ValueError, match="word must be one of a, b, got 'c'"):
        check_choice("word", "c", ("a", "b"))


def test_groups_keep_order_and_take_finds_each_member():
    materials = [
        Phong([0.1], [0.2], 1.0),
        Lambert([0.3]),
        Phong([0.4], [0.5], 2.0),
        Lambert([0.6], ambient=[1.0]),
    ]
    groups = group_by_structure(materials)
    assert [members for members, _ in groups] == [(0, 2), (1,), (3,)]
    for members, group in groups:
        for index, material in enumerate(materials):
            found, among = take(members, group, jnp.asarray(index))
            assert bool(among) == (index in members)
            if among:
                assert jax.tree.all(jax.tree.map(lambda a, b: (a == b).all(), found, material))
        assert not take(members, group, jnp.asarray(-1))[1]


def test_records_print_their_numbers():
    ball = jv.Surface(jv.Sphere([0, 0.5, 0], 1 / 3), jv.Lambert([0.25]))
    assert repr(ball) == (
        "Surface(\n"
        "  shape=Sphere(centre=[0, 0.5, 0], radius=0.333333),\n"
        "  material=Lambert(diffuse=[0.25]),\n"
        "  two_sided=False,\n"
        ")"
    )
    assert repr(jv.Sensor(gain=2.0)) == "Sensor(gain=2)"  # absent effects are not printed
    wide = jv.PointLight([0, 0, 1], np.linspace(2, 5, 31).astype(np.float32))
    assert repr(wide) == "PointLight(position=[0, 0, 1], intensity=float32[31] from 2 to 5)"
    assert (
        str(wide) == "PointLight(position=[0, 0, 1] m, intensity=float32[31] from 2 to 5 W sr^-1)"
    )
    assert str(jv.PhotonConversion([550e-9], 1e-12)) == (
        "PhotonConversion(wavelength=[5.5e-07] m, pixel_area=1e-12 m^2)"
    )
    assert str(
        jv.Sensor(dark_current=3.0, gain=2.0, prnu=0.1, shot_noise=jv.PoissonShotNoise())
    ) == (
        "Sensor(\n"
        "  prnu=0.1,\n"
        "  dark_current=3 e- s^-1 per pixel,\n"
        "  shot_noise=PoissonShotNoise(),\n"
        "  gain=2 DN per e-,\n"
        ")"
    )
    assert "Dielectric(eta=[1.5])" in repr(
        jv.TorranceSparrow([0.1], [0.2], 0.3, interface=jv.Dielectric([1.5]))
    )
    ones = jnp.ones((8, 8, 1), jnp.float32)
    mean = jv.transport.Traced(ones, 0 * ones)
    assert repr(mean) == (
        "Traced(radiance=float32[8, 8, 1] from 1 to 1, error=float32[8, 8, 1] from 0 to 0)"
    )
    html = ball._repr_html_()
    rows = re.findall(r"<tr>(.*?)</tr>", html)
    cells = [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in rows[1:]]
    assert [row[:2] for row in cells] == [
        ["shape", "Sphere"],
        ["centre", "[0, 0.5, 0]"],
        ["radius", "0.333333"],
        ["material", "Lambert"],
        ["diffuse", "[0.25]"],
        ["two_sided", "False"],
    ]
    assert cells[2][2] == "() m, &gt; 0."  # from the docstring
    crowd = jv.Scene([ball] * 20, [])._repr_html_()
    assert "surfaces[11]" in crowd
    assert "surfaces[12]" not in crowd
    assert "and 8 more" in crowd
    said = []
    jax.eval_shape(lambda sphere: said.append(repr(sphere)), ball.shape)
    assert said[0].startswith("Sphere(centre=f")  # no numbers while traced
