"""Tests mattes against scenes composed by hand, the Laplacian and the systems against NumPy loops
and SciPy's direct solver, and the results against pymatting."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import spsolve

from jaxvision import matting
from jaxvision.errors import InputError
from jaxvision.matting._laplacian import apply_stencil, matting_laplacian
from jaxvision.matting._multigrid import coarsen, interpolate, restrict, v_cycle
from jaxvision.matting.compositing import over

RNG = np.random.default_rng(13)


def picture(rows, columns, bands=3):
    """Return smooth colours with a little texture, in (0, 1)."""
    y, x = np.mgrid[:rows, :columns] / max(rows, columns)
    phase, rate = RNG.uniform(0, 6, size=bands), RNG.uniform(2, 8, size=bands)
    waves = 0.5 + 0.3 * np.sin(phase + rate * y[..., None] + rate[::-1] * x[..., None])
    return waves + RNG.uniform(-0.02, 0.02, size=(rows, columns, bands))


def disc(side):
    """Return (alpha (side, side, 1), trimap (side, side)) of a disc with a soft edge."""
    y, x = np.mgrid[:side, :side] - (side - 1) / 2
    inside = 0.3 * side - np.hypot(y, x)
    band = 0.12 * side
    trimap = np.where(inside > band, 1.0, np.where(inside < -band, 0.0, 0.5))
    return np.clip(0.5 + inside / 4, 0, 1)[..., None], trimap


ALPHA, TRIMAP = disc(24)
FRONT, BEHIND, BEHIND_2, BEHIND_3 = (picture(24, 24) for _ in range(4))
SEEN, SEEN_2, SEEN_3 = (ALPHA * FRONT + (1 - ALPHA) * k for k in (BEHIND, BEHIND_2, BEHIND_3))
LAYER = np.concatenate([ALPHA * FRONT, ALPHA], axis=-1)


def arrays(*values):
    return tuple(map(jnp.asarray, values))


# ------------------------------------------------ keying


def test_a_faint_matte_is_accurate():
    alpha = jnp.logspace(-6, 0, 7, dtype=jnp.float32)[:, None]
    colour = jnp.asarray([0.5, 0.25, 1], jnp.float32)
    got = matting.projected_matte(alpha * colour[None], colour, 0 * colour)
    np.testing.assert_allclose(got, alpha, rtol=4e-7)


@pytest.mark.slow
def test_triangulation_is_exact():
    layer = matting.triangulation_matte(*arrays(SEEN, BEHIND, SEEN_2, BEHIND_2))
    np.testing.assert_allclose(layer, LAYER, atol=1e-12)
    back = jnp.concatenate([jnp.asarray(BEHIND), jnp.ones((24, 24, 1))], axis=-1)
    np.testing.assert_allclose(over(layer, back)[..., :3], SEEN, atol=1e-12)


@pytest.mark.slow
def test_more_backgrounds_reduce_noise_and_are_least_squares():
    """The reference is NumPy's solver, pixel by pixel, for the equations C_o + (1 - alpha) K = C
    without clipping."""
    backs = np.stack([BEHIND, BEHIND_2, BEHIND_3])
    seen = np.stack([SEEN, SEEN_2, SEEN_3]) + RNG.normal(0, 0.01, size=(3, 24, 24, 3))
    found = np.asarray(matting.least_squares_matte(*arrays(seen, backs)))
    for i, j in ((12, 5), (8, 8), (12, 4), (16, 17)):
        matrix = np.zeros((9, 4))
        matrix[:, :3] = np.tile(np.eye(3), (3, 1))
        matrix[:, 3] = -backs[:, i, j].ravel()
        target = (seen[:, i, j] - backs[:, i, j]).ravel()
        solution = np.linalg.lstsq(matrix, target, rcond=None)[0]
        if 0 <= solution[3] <= 1:
            np.testing.assert_allclose(found[i, j], solution, atol=1e-12)
        else:
            assert found[i, j, 3] in (0, 1)
    two = np.asarray(matting.least_squares_matte(*arrays(seen[:2], backs[:2])))
    rms = [np.sqrt(np.mean((x[..., 3:] - ALPHA) ** 2)) for x in (found, two)]
    assert rms[0] < rms[1] < 0.1


def test_blue_screen_of_objects_that_satisfy_its_assumption():
    blue = np.array([0.05, 0.1, 0.8])
    without_blue = FRONT * [1, 1, 0]
    seen = ALPHA * without_blue + (1 - ALPHA) * blue
    np.testing.assert_allclose(
        matting.blue_screen_matte(*arrays(seen, blue), foreground="none"), ALPHA, atol=1e-13
    )
    grey = np.repeat(FRONT[..., :1], 3, axis=-1)
    seen = ALPHA * grey + (1 - ALPHA) * blue
    np.testing.assert_allclose(matting.blue_screen_matte(*arrays(seen, blue)), ALPHA, atol=1e-13)
    green = blue[[0, 2, 1]]
    seen = ALPHA * grey + (1 - ALPHA) * green
    alpha = matting.blue_screen_matte(*arrays(seen, green), channel=1)
    np.testing.assert_allclose(alpha, ALPHA, atol=1e-13)
    layer = matting.lift(*arrays(seen, alpha, green))
    np.testing.assert_allclose(layer[..., :3], ALPHA * grey, atol=1e-13)


def test_known_colours_and_difference():
    red, blue = np.array([0.8, 0.2, 0.1]), np.array([0.1, 0.2, 0.7])
    seen = ALPHA * red + (1 - ALPHA) * blue
    np.testing.assert_allclose(matting.projected_matte(*arrays(seen, red, blue)), ALPHA, atol=1e-13)
    distance = np.linalg.norm(red - blue)
    found = matting.difference_matte(*arrays(seen, blue, 0.0, distance))
    np.testing.assert_allclose(found, ALPHA, atol=1e-13)
    hard = matting.difference_matte(*arrays(seen, blue, 0.3 * distance, 0.5 * distance))
    np.testing.assert_allclose(hard, np.clip((ALPHA - 0.3) / 0.2, 0, 1), atol=1e-12)


@pytest.mark.parametrize("dtype", [jnp.float32, pytest.param(jnp.float64, marks=pytest.mark.slow)])
def test_equal_backgrounds_give_the_picture(dtype):
    seen, behind = (jnp.asarray(x, dtype) for x in (SEEN, BEHIND))
    keyed = {
        "triangulation": lambda x: matting.triangulation_matte(x, behind, x, behind)[..., 3:],
        "projected": lambda x: matting.projected_matte(x, behind, behind),
        "screen": lambda x: matting.blue_screen_matte(x, jnp.zeros(3, dtype), foreground="none"),
    }
    for name, key in keyed.items():
        alpha, slope = jax.jit(jax.value_and_grad(lambda x, k=key: k(x).sum()))(seen)
        assert alpha.dtype == dtype
        assert alpha == 24 * 24, name
        assert jnp.isfinite(slope).all(), name
    same = jax.jit(jax.grad(lambda x: matting.difference_matte(x, behind, 0.0, 1.0).sum()))(behind)
    assert (same == 0).all()


# ------------------------------------------------ the Laplacian


def dense(stencil):
    """Return the stencil as a matrix, element by element."""
    rows, columns = stencil.shape[2:]
    matrix = np.zeros((rows * columns,) * 2)
    for y, x in np.ndindex(rows, columns):
        for i, j in np.ndindex(5, 5):
            v, u = y + i - 2, x + j - 2
            if 0 <= v < rows and 0 <= u < columns:
                matrix[y * columns + x, v * columns + u] = stencil[i, j, y, x]
            else:
                assert stencil[i, j, y, x] == 0
    return matrix


def levin(image, epsilon):
    """Return the matrix of equation 5 of the paper, window by window, with NumPy's inverse."""
    rows, columns, bands = image.shape
    matrix = np.zeros((rows * columns,) * 2)
    for y in range(rows - 2):
        for x in range(columns - 2):
            members = [(y + i) * columns + x + j for i in range(3) for j in range(3)]
            colours = image[y : y + 3, x : x + 3].reshape(9, bands)
            centred = colours - colours.mean(axis=0)
            inverse = np.linalg.inv(centred.T @ centred / 9 + epsilon / 9 * np.eye(bands))
            matrix[np.ix_(members, members)] += np.eye(9) - (1 + centred @ inverse @ centred.T) / 9
    return matrix


@pytest.mark.sweep
@pytest.mark.parametrize("bands", [1, 3])
def test_laplacian_is_the_paper_s(bands):
    image = picture(6, 7, bands)
    ours = dense(np.asarray(jax.jit(matting_laplacian)(jnp.asarray(image))))
    np.testing.assert_allclose(ours, levin(image, 1e-7), atol=1e-9)
    np.testing.assert_allclose(ours, ours.T, atol=1e-12)
    np.testing.assert_allclose(ours.sum(axis=1), 0, atol=1e-12)
    assert np.linalg.eigvalsh(ours).min() > -1e-12


@pytest.mark.slow
def test_functions_affine_in_the_colours_have_zero_energy():
    image = picture(8, 9)
    stencil = jax.jit(lambda x: matting_laplacian(x, epsilon=1e-12))(jnp.asarray(image))
    affine = jnp.asarray(image @ [0.3, -0.7, 0.2] + 0.4)
    assert jnp.abs(apply_stencil(stencil, affine)).max() < 1e-8
    noise = jnp.asarray(RNG.normal(size=(8, 9)))
    assert jnp.abs(apply_stencil(stencil, noise)).max() > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [jnp.float32, pytest.param(jnp.float64, marks=pytest.mark.slow)])
@pytest.mark.parametrize("bands", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_uniform_pictures_have_a_finite_laplacian(dtype, bands):
    flat = jnp.stack([jnp.zeros((3, 4, bands), dtype), jnp.full((3, 4, bands), 0.7, dtype)])
    square = jax.value_and_grad(lambda x: jnp.square(matting_laplacian(x)).sum())
    value, slope = jax.jit(jax.vmap(square))(flat)
    assert jnp.isfinite(value).all()
    assert jnp.isfinite(slope).all()


# ------------------------------------------------ the solver


@pytest.mark.slow
def test_coarse_grids_are_galerkins():
    """Coarse grids are P^T A P with P written as a matrix, and a multigrid cycle is symmetric."""
    rows, columns = 9, 12
    image = jnp.asarray(picture(rows, columns))
    stencil = jax.jit(lambda x: matting_laplacian(x).at[2, 2].add(0.5))(image)
    grids = jax.jit(coarsen)(stencil)
    assert len(grids.stencils) == 1
    units = jnp.eye(30).reshape(30, 5, 6)
    p = np.asarray(jax.jit(jax.vmap(lambda x: interpolate(x, (rows, columns))))(units))
    p = p.reshape(30, -1).T
    np.testing.assert_array_equal(p.sum(axis=1), 1)  # constants are preserved
    coarse = p.T @ dense(np.asarray(stencil)) @ p
    factor = np.tril(np.asarray(grids.coarsest))
    np.testing.assert_allclose(factor @ factor.T, coarse, atol=1e-12)
    r, s = RNG.normal(size=(2, rows, columns))
    np.testing.assert_allclose(
        np.ravel(jax.jit(restrict)(jnp.asarray(r))), p.T @ r.ravel(), atol=1e-13
    )
    cycle = jax.jit(lambda x: v_cycle(grids, x))
    of_r, of_s = (np.asarray(cycle(jnp.asarray(x))) for x in (r, s))
    np.testing.assert_allclose(np.vdot(s, of_r), np.vdot(of_s, r), rtol=1e-12)
    assert np.vdot(r, of_r) > 0


def band_of_unknown(columns, bands):
    """Return (picture, trimap) of eight rows, the middle four of them unknown."""
    rows = np.repeat([1.0, 0.5, 0.0], [2, 4, 2])
    return picture(8, columns, bands), rows[:, None] * np.ones((1, columns))


SOLVE = jax.jit(lambda image, trimap: matting.closed_form_matte(image, trimap, tolerance=1e-11))


@pytest.mark.slow
def test_closed_form_is_the_direct_solution():
    """The reference is SciPy's sparse LU of the same equations: the rows of unknown pixels, given
    the known ones."""
    matte = SOLVE(*arrays(SEEN, TRIMAP))
    laplacian, unknown = levin(SEEN, 1e-7), (TRIMAP == 0.5).ravel()
    direct = TRIMAP.copy().ravel()
    direct[unknown] = spsolve(
        sparse.csc_matrix(laplacian[np.ix_(unknown, unknown)]),
        -laplacian[np.ix_(unknown, ~unknown)] @ direct[~unknown],
    )
    assert matte.converged
    np.testing.assert_allclose(matte.alpha.ravel(), np.clip(direct, 0, 1), atol=1e-6)


@pytest.mark.slow
def test_confidence_is_the_papers():
    image, trimap = band_of_unknown(8, 3)
    soft = jax.jit(lambda i, t: matting.closed_form_matte(i, t, confidence=0.01, tolerance=1e-12))
    known = np.diag(0.01 * (trimap != 0.5).ravel())
    direct = np.linalg.solve(levin(image, 1e-7) + known, known @ trimap.ravel())
    found = soft(*arrays(image, trimap)).alpha.ravel()
    np.testing.assert_allclose(found, np.clip(direct, 0, 1), atol=1e-6)
    assert np.abs(found - trimap.ravel())[trimap.ravel() != 0.5].max() > 0.01


@pytest.mark.slow
def test_too_few_steps_are_reported():
    scene = arrays(*band_of_unknown(9, 1))
    rushed = jax.jit(lambda i, t: matting.closed_form_matte(i, t, max_steps=2))(*scene)
    assert not rushed.converged
    assert jnp.isfinite(rushed.alpha).all()


# ------------------------------------------------ foreground


def least_energy(image, alpha, regularisation=1e-5):
    """Return the minimum of the documented energy, with both unknowns of all pixels in one sparse
    system."""
    rows, columns = alpha.shape
    n = rows * columns
    index = np.arange(n).reshape(rows, columns)
    a = alpha.ravel()
    smooth = sparse.lil_matrix((n, n))
    for p, q in [
        *zip(index[1:].ravel(), index[:-1].ravel(), strict=True),
        *zip(index[:, 1:].ravel(), index[:, :-1].ravel(), strict=True),
    ]:
        w = regularisation + abs(a[p] - a[q])
        for s, t, value in ((p, p, w), (q, q, w), (p, q, -w), (q, p, -w)):
            smooth[s, t] += value
    own, cross, other = (sparse.diags(v) for v in (a * a, a * (1 - a), (1 - a) ** 2))
    system = sparse.bmat([[own + smooth, cross], [cross, other + smooth]]).tocsc()
    both = []
    for band in range(image.shape[2]):
        light = image[..., band].ravel()
        both.append(spsolve(system, np.concatenate([a * light, (1 - a) * light])))
    solution = np.stack(both, axis=-1).reshape(2, rows, columns, -1)
    return solution[0], solution[1]


@pytest.mark.slow
def test_foreground_is_the_least_energy():
    image, alpha = SEEN[6:14, 3:12], ALPHA[6:14, 3:12]
    found = jax.jit(
        lambda i, a: matting.estimate_foreground(i, a, regularisation=1e-2, coarse_steps=3000)
    )(*arrays(image, alpha))
    for ours, direct in zip(found, least_energy(image, alpha[..., 0], 1e-2), strict=True):
        np.testing.assert_allclose(ours, np.maximum(direct, 0), atol=1e-8)


def energy(foreground, background, image, alpha, regularisation=1e-5):
    """Return the documented sum, as a loop over pairs of neighbours."""
    total = np.sum((alpha * foreground + (1 - alpha) * background - image) ** 2)
    for axis in (0, 1):
        weight = 2 * (regularisation + np.abs(np.diff(alpha, axis=axis)))  # for ij and ji
        for light in (foreground, background):
            total += np.sum(weight * np.diff(light, axis=axis) ** 2)
    return total


@pytest.mark.slow
def test_foreground_in_few_steps():
    """The energy is near its minimum, and hidden colours are close to the true ones."""
    found = jax.jit(matting.estimate_foreground)(*arrays(SEEN, ALPHA))
    foreground, background = map(np.asarray, found)
    least = energy(*least_energy(SEEN, ALPHA[..., 0]), SEEN, ALPHA)
    assert least < energy(foreground, background, SEEN, ALPHA) < 1.5 * least
    soft = (ALPHA[..., 0] > 0.2) & (ALPHA[..., 0] < 1)
    assert soft.sum() > 20
    error, naive = (np.abs(x - FRONT)[soft].mean() for x in (foreground, SEEN))
    assert error < 0.6 * naive


def test_foreground_of_the_smallest_pictures():
    one = jnp.full((1, 1, 3), 0.4)
    estimate = jax.jit(matting.estimate_foreground)
    for alpha in (0.0, 0.3, 1.0):
        for found in estimate(one, jnp.full((1, 1, 1), alpha)):
            np.testing.assert_allclose(found, one, rtol=1e-12)


# ------------------------------------------------ bad input


def test_bad_trimaps_are_named():
    image, trimap = arrays(SEEN, TRIMAP)
    cases = {
        r"The trimap has no foreground \(0.9 and above\)": (image, jnp.minimum(trimap, 0.5)),
        r"The trimap has no background \(0.1 and below\)": (image, jnp.maximum(trimap, 0.5)),
        "The trimap leaves": (image, trimap * 255),
        "The trimap holds 1 numbers that are not finite": (image, trimap.at[3, 3].set(jnp.nan)),
        "The picture holds 1 numbers that are not": (image.at[3, 3, 0].set(jnp.inf), trimap),
    }
    for message, call in cases.items():
        with pytest.raises(InputError, match=message):
            matting.closed_form_matte(*call)


@pytest.mark.sweep
@pytest.mark.parametrize("scale", [255.0, 1e4])
def test_the_matte_of_a_bright_picture_equals_its_scaled_copys(scale):
    """In float32 the default epsilon would be lost in the rounding of bright pictures, and alpha be
    NaN."""
    image, trimap = (jnp.asarray(x, jnp.float32) for x in (SEEN, TRIMAP))
    found = matting.closed_form_matte(scale * image, trimap)
    right = matting.closed_form_matte(image, trimap)
    assert bool(found.converged)
    np.testing.assert_allclose(found.alpha, right.alpha, atol=3e-3)


@pytest.mark.slow
def test_a_matte_that_does_not_depend_on_the_picture_is_named():
    image, trimap = arrays(SEEN, TRIMAP)
    with pytest.warns(UserWarning, match="The trimap has no unknown pixels"):
        found = matting.closed_form_matte(image, jnp.round(trimap + 0.1))
    np.testing.assert_allclose(found.alpha[..., 0], np.round(trimap + 0.1), atol=1e-6)
    for dim in (1e-4 * image, jnp.full_like(image, 0.5)):
        with pytest.warns(UserWarning, match="so alpha hardly depends on it"):
            matting.closed_form_matte(dim, trimap)
    dim = matting.closed_form_matte(1e-4 * image, trimap, epsilon=1e-15)
    np.testing.assert_allclose(dim.alpha, matting.closed_form_matte(image, trimap).alpha, atol=5e-3)


def test_arguments_that_solve_nothing_are_named():
    image, trimap, alpha, behind = arrays(SEEN, TRIMAP, ALPHA, BEHIND)
    for options, message in (
        ({"epsilon": 0.0}, r"epsilon must be above 0, got 0\.0"),
        ({"epsilon": -1.0}, r"epsilon must be above 0, got -1\.0"),
        ({"confidence": 0.0}, r"confidence must be above 0, got 0\.0"),
    ):
        with pytest.raises(ValueError, match=message):
            matting.closed_form_matte(image, trimap, **options)
    with pytest.raises(ValueError, match=r"regularisation must be above 0, got 0\.0"):
        matting.estimate_foreground(image, alpha, regularisation=0.0)
    for wrong in (alpha.at[3, 4].set(jnp.nan), alpha.at[3, 4].set(-1.0), alpha.at[3, 4].set(2.0)):
        for call in (matting.estimate_foreground, lambda i, a: matting.lift(i, a, behind)):
            with pytest.raises(ValueError, match=r"alpha must lie in \[0, 1\]: 1 of 576 values"):
                call(image, wrong)
    for high in (0.2, 0.1):
        with pytest.raises(ValueError, match=rf"low must lie below high, got 0\.2 and {high}"):
            matting.difference_matte(image, behind, 0.2, high)
    at, beyond = jnp.zeros((1, 3)), jnp.asarray([[0.0, 0.0, 1e-6]])
    step = jax.jit(matting.difference_matte)
    for pixel, covered in ((at, 0), (beyond, 1)):
        assert step(pixel, at, *arrays(0.0, 0.0)) == covered


def test_codes_and_mismatched_ranks_are_named(as_for_users):
    image, trimap, alpha, behind = arrays(SEEN, TRIMAP, ALPHA, BEHIND)
    codes = jnp.full(image.shape, 128, jnp.uint8)
    for call in (
        lambda: matting.difference_matte(codes, codes + 1, 1.0, 20.0),
        lambda: matting.blue_screen_matte(codes, behind),
        lambda: matting.projected_matte(codes, behind, behind),
        lambda: matting.triangulation_matte(codes, codes, codes, codes),
        lambda: matting.lift(codes, alpha, codes),
        lambda: matting.closed_form_matte(codes, trimap),
        lambda: jax.jit(matting.closed_form_matte)(image, codes[..., 0]),
        lambda: matting.estimate_foreground(codes, alpha),
        lambda: matting.estimate_foreground(image, codes[..., :1]),
    ):
        with pytest.raises(ValueError, match="floating and relative, got uint8; divide by 255"):
            call()
    for grey in (image[..., 0], image[:0]):
        shape = str(grey.shape).replace("(", r"\(").replace(")", r"\)")
        with pytest.raises(ValueError, match=rf"at least 3 x 3 pixels, got shape {shape}"):
            matting.closed_form_matte(grey, trimap[: len(grey)])
        with pytest.raises(ValueError, match=rf"\(h, w, bands\) and not empty, got shape {shape}"):
            matting.estimate_foreground(grey, alpha[: len(grey)])


def test_bad_shapes_are_named():
    image, trimap, alpha = arrays(SEEN, TRIMAP, ALPHA)
    with pytest.raises(
        ValueError, match=r"same rows and columns, got \(24, 24, 3\) and \(24, 20\)"
    ):
        matting.closed_form_matte(image, trimap[:, :20])
    with pytest.raises(ValueError, match="at least 3 x 3 pixels, got 2 x 24"):
        matting_laplacian(image[:2])
    with pytest.raises(ValueError, match=r"alpha must be \(h, w, 1\)"):
        matting.estimate_foreground(image, alpha[:20])
    with pytest.raises(ValueError, match=r"one shape, at least two pictures"):
        matting.least_squares_matte(image[None], image[None])
    with pytest.raises(ValueError, match=r"foreground must be one of none, grey, got 'flesh'"):
        matting.blue_screen_matte(image, image, foreground="flesh")
    with pytest.raises(ValueError, match=r"channel 3 .* more bands than the 3"):
        matting.blue_screen_matte(image, image, channel=3)


def test_a_nan_stays_in_its_own_pixel():
    seen = jnp.asarray(SEEN).at[4, 5, 0].set(jnp.nan)
    layer = matting.triangulation_matte(seen, *arrays(BEHIND, SEEN_2, BEHIND_2))
    assert int(jnp.isnan(layer).any(axis=-1).sum()) == 1
    behind, front = arrays(BEHIND, FRONT)
    unknown = behind.at[4, 5, 0].set(jnp.nan)
    for alpha in (
        matting.difference_matte(seen, behind, 0.1, 0.5),
        matting.difference_matte(front, unknown, 0.1, 0.5),
        matting.projected_matte(seen, front, behind),
        matting.projected_matte(front, front, unknown),
        matting.blue_screen_matte(front, unknown),
    ):
        assert jnp.isnan(alpha[4, 5]).all()
        assert int(jnp.isnan(alpha).sum()) == 1


def hair(seed, *, side=24, texture=0.05, noise=0.003):
    """Return a picture of strands in front of a background, its trimap and its true coverage."""
    from scipy.ndimage import gaussian_filter

    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: 8 * side, : 8 * side] / 8
    alpha = (x < 0.3 * side).astype(float)
    for _ in range(10):
        row, slope, end = rng.uniform([0, -0.5, 0.3 * side], [side, 0.5, 0.75 * side])
        near = np.abs(y - row - slope * (x - 0.3 * side)) < rng.uniform(0.15, 0.6)
        alpha[near & (x < end)] = 1
    alpha = gaussian_filter(alpha.reshape(side, 8, side, 8).mean((1, 3)), 0.6)[..., None]
    sides = [
        np.array(colour)
        + 5 * texture * gaussian_filter(rng.normal(size=(side, side, 3)), (2, 2, 0))
        for colour in ([0.35, 0.2, 0.12], [0.3, 0.5, 0.7])
    ]
    seen = alpha * sides[0] + (1 - alpha) * sides[1] + noise * rng.normal(size=(side, side, 3))
    trimap = np.full((side, side), 0.5)
    trimap[:, : int(0.2 * side)], trimap[:, int(0.85 * side) + 1 :] = 1, 0
    return np.maximum(seen, 0), trimap, alpha, sides


@pytest.mark.slow
@pytest.mark.parametrize(
    ("texture", "seeds"),
    [(0.0, 2), *(pytest.param(x, 12, marks=pytest.mark.slow) for x in (0.0, 0.05, 0.1))],
)
def test_errors_of_mattes_are_those_of_simulated_hair(texture, seeds):
    """The stated errors hold for the matte and for the subject composed over a new background."""
    z, share, of_over, new = [], [], [], np.broadcast_to([0.9, 0.8, 0.2, 1.0], (24, 24, 4))
    for seed in range(seeds):
        image, trimap, alpha, (front, _) = hair(seed, texture=texture)
        found = matting.matte_errors(jax.random.key(seed), image, trimap)
        unknown = (trimap > 0.1) & (trimap < 0.9)
        sd = np.maximum(np.asarray(found.alpha_sd), 1e-3)[unknown]
        off = np.asarray(found.alpha - alpha)[unknown]
        z.append(np.mean((off / sd) ** 2))
        share.append(np.mean(np.abs(off) < 1.96 * sd))
        layer = matting.premultiply(front, jnp.maximum(found.alpha, 1e-6))
        made, wide = over(layer, new, alpha_sd=found.alpha_sd)
        true = (alpha * front + (1 - alpha) * new[..., :3])[unknown]
        off = np.abs(np.asarray(made[..., :3])[unknown] - true)
        of_over.append(np.mean(off < 1.96 * np.maximum(wide[..., :3], 1e-3)[unknown]))
    assert 0.7 < np.sqrt(np.mean(z)) < 1.5
    assert np.mean(share) > 0.85
    assert np.mean(of_over) > 0.85


@pytest.mark.slow
def test_the_inverse_laplacian_is_not_the_covariance_of_a_matte():
    """If the energy were minus a log-probability, the ratio of the true variance to the Laplacian's
    inverse would be 1. Between two dense scenes (24 x 24) it differs twentyfold."""
    needed = []
    for seed, texture in ((0, 0.0), (3, 0.05)):
        image, trimap, alpha, _ = hair(seed, texture=texture)
        laplacian = matting_laplacian(jnp.asarray(image), epsilon=1e-5)
        units = jnp.eye(576).reshape(-1, 24, 24)
        dense = np.asarray(jax.vmap(lambda x, s=laplacian: apply_stencil(s, x))(units))
        dense = dense.reshape(576, 576)
        unknown = ((trimap > 0.1) & (trimap < 0.9)).ravel()
        matte = (trimap >= 0.9).astype(float).ravel()
        inner = dense[np.ix_(unknown, unknown)]
        matte[unknown] = -np.linalg.solve(inner, dense[np.ix_(unknown, ~unknown)] @ matte[~unknown])
        variance = np.diag(np.linalg.inv(inner))
        energy = matte @ dense @ matte / unknown.sum()
        off = (matte - alpha.ravel())[unknown]
        needed.append(np.mean(off**2 / variance) / energy)
    assert needed[1] > 10 * needed[0]
