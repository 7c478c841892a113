"""Rows of docs/coverage.md for lights, lenses, sensitivities, maps, mattes and normals.

    python tests/benchmarks/interval_coverage.py TABLE [--count N]

Each table takes less than ten minutes of one core. The true values are those of the simulators in
the tests.
"""

import argparse
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import ndtri
from scipy.stats import chi2, norm

sys.path.append(str(Path(__file__).parents[1]))
sys.path.extend(str(room) for room in Path(__file__).parents[1].glob("*/"))

import test_edge_aberrations as lens
import test_from_edge as edge
import test_interreflection as hollow
import test_lights_calibration as balls
import test_matting as matte
import test_near_lights as near
import test_sensitivities as colour

import jaxvision as jv
from fitting import Gaussian, Parameter, Problem, fit, resolution, sensitivities
from fitting.checks.coverage import coverage
from fitting.reflectance import photometric_stereo
from jaxvision import colour_spaces, matting


def row(*cells) -> None:
    print("|", " | ".join(str(cell) for cell in cells), "|", flush=True)


def shares(z) -> list[str]:
    """Return the shares of intervals that contain the true value, and the mean and s.d. of z."""
    z = np.ravel(z)
    inside = [np.mean(np.abs(z) < ndtri((1 + q) / 2)) for q in (0.5, 0.68, 0.95)]
    return [*(f"{share:.3f}" for share in inside), f"{z.mean():+.2f}", f"{z.std():.2f}"]


def lamps(count: int = 200) -> None:
    """Count coverage of light directions and positions from balls, and of a reflectance fitted with
    the lights from a mirror ball."""
    for kind in ("mirror", "matte"):
        z, square, dof = balls.check_coverage(kind, range(count))
        joint = np.mean(square < chi2.ppf(0.95, dof))
        row(kind, f"{np.mean(z < 1.96):.3f}", f"{joint:.3f}", f"{np.mean(square) / dof:.2f}")
    z, square, _ = map(
        np.array, zip(*map(balls.positions_from_two_balls, range(count)), strict=True)
    )
    joint, ratio = np.mean(square < chi2.ppf(0.95, 9)), np.mean(square) / 9
    row("two balls", f"{np.mean(np.abs(z) < 1.96):.3f}", f"{joint:.3f}", f"{ratio:.2f}")
    for name, how in (
        ("as found, covariance", {}),
        ("as found, independent", {"shared": False}),
        ("drawn, covariance", {"drawn": True}),
        ("drawn, independent", {"drawn": True, "shared": False}),
    ):
        found = [balls.reflectance_through_lights(seed, **how) for seed in range(count)]
        errors, sds = np.transpose(found)
        row(name, count, *shares(errors / sds), f"{100 * np.median(np.abs(errors)):.3f} %")


def edges(count: int = 500) -> None:
    """Count coverage for edges. Half of them have a twentieth of the contrast at the same noise."""
    for name, high in (("levels 100 and 1000", 1000.0), ("levels 100 and 145", 145.0)):
        rng, found = np.random.default_rng(7), []
        for _ in range(count // 2):
            angle, blur, place = rng.uniform(0, 360), rng.uniform(0.4, 1.2), rng.uniform(-1, 1)
            mean = edge.expected((48, 48), angle, place, blur, high=high)
            one = resolution.from_edge(edge.noisy(mean, rng))
            at = {e.name: (e.value, e.standard_error) for e in one.estimates}
            turn = np.radians(angle)

            def mtf(f, turn=turn, blur=blur):
                aperture = np.sinc(f * np.cos(turn)) * np.sinc(f * np.sin(turn))
                return aperture * np.exp(-2 * (np.pi * blur * f) ** 2)

            fine = np.linspace(0, 2, 20_001)
            half = fine[np.argmax(mtf(fine) < 0.5)]
            band, width = one.mtf50, one.fwhm
            x = np.linspace(0, 6, 2001)
            line = np.trapezoid(mtf(fine) * np.cos(2 * np.pi * x[:, None] * fine), fine, axis=1)
            wide = 2 * np.interp(-0.5, -line / line[0], x)
            missed = one.otf - mtf(one.frequency)
            square = missed @ np.linalg.pinv(one.otf_covariance) @ missed
            found.append(
                [
                    norm.cdf((blur - at["blur"][0]) / at["blur"][1]),
                    norm.cdf((half - band.mean) / band.sd),
                    norm.cdf((wide - width.mean) / width.sd),
                    chi2.cdf(square, np.linalg.matrix_rank(one.otf_covariance)),
                ]
            )
        u = np.array(found)
        joint = np.mean(u[:, 3] < 0.95)
        for one in coverage(u[:, :3], ("blur", "MTF50", "FWHM")):
            low, high_end = one.band[-1]
            row(
                *(name, one.name, one.simulations, *(f"{share:.3f}" for share in one.covered)),
                *(f"{low:.3f} to {high_end:.3f}", f"{one.z_mean:+.2f}", f"{one.z_sd:.2f}"),
            )
        row(name, "OTF, joint", len(u), "", "", f"{joint:.3f}", "", "", "")


def placed(draws, truth):
    """Return z of the true value among draws of a posterior."""
    draws = np.asarray(draws)
    below = np.sum(draws < truth, axis=0) + np.sum(draws == truth, axis=0) / 2  # both may be 0
    return ndtri((below + 0.5) / (len(draws) + 1))


def charts(count: int = 40) -> None:
    light = colour.CHART * colour.DAY
    for name in (*colour.NAMES, "random cameras"):
        rng = np.random.default_rng(99)
        middle = rng.uniform(400, 700, (20, 1))
        others = rng.uniform(0, 1, (20, 1)) * np.exp(-(((colour.NM - middle) / 80) ** 2))
        others = (0.05 + others) * colour.DAY
        found = {"curve": [], "readings": [], "white balance": [], "matrix": [], "Delta E": []}
        for seed in range(count):
            true = colour.camera(name) if name in colour.NAMES else colour.random_camera(seed)
            raw = colour.NIGHT @ true
            readings, sd = colour.chart(true, seed)
            one = sensitivities.from_patches(readings, light, 1e-9 * colour.NM, sd=sd, seed=seed)
            found["curve"].append(placed(one.draws, true))
            found["readings"].append(placed(one.readings(others).draws, others @ true))
            balance = one.white_balance(colour.NIGHT)
            off = (raw[1] / raw - balance.mean)[[0, 2]]  # for red and blue
            found["white balance"].append(off / balance.sd[[0, 2]])
            own = sensitivities.Sensitivities(**vars(one) | {"draws": true[None]})
            matrix, seen = one.matrix(colour.NIGHT), (colour.NIGHT * colour.CHART) @ true
            xyz = np.asarray(colour_spaces.observer(colour.AT), float)
            white = colour.NIGHT @ xyz
            wanted = (colour.NIGHT * colour.CHART) @ xyz / white[1]
            labs = [
                colour_spaces.xyz_to_lab(jnp.asarray(a), jnp.asarray(white / white[1]))
                for a in (np.maximum(seen @ matrix.mean.T, 0), wanted)
            ]
            found["matrix"].append(placed(matrix.draws, own.matrix(colour.NIGHT).mean))
            off = np.asarray(colour_spaces.delta_e_2000(*labs))
            found["Delta E"].append(placed(one.delta_e(colour.NIGHT).draws, off))
        for what, z in found.items():
            row(name, what, count, *shares(z))


def mattes(count: int = 40) -> None:
    """Write the rows of mattes and of composites over yellow, of true and of estimated colours."""
    new = np.broadcast_to([0.9, 0.8, 0.2, 1.0], (24, 24, 4))
    colours = jax.jit(jax.vmap(matting.estimate_foreground, (None, 0)))
    names = "alpha", "over yellow", "over yellow, estimated colours"
    for texture in (0.0, 0.05, 0.1):
        found = {name: [] for name in names}
        for seed in range(count):
            image, trimap, alpha, (front, _) = matte.hair(100 + seed, texture=texture)
            one = matting.matte_errors(jax.random.key(seed), image, trimap)
            unknown = (trimap > 0.1) & (trimap < 0.9)
            every = jnp.maximum(jnp.concatenate([one.alpha[None], one.draws]), 1e-6)
            made, sd = matting.over(
                matting.premultiply(jnp.asarray(front), every[0]), new, alpha_sd=one.alpha_sd
            )
            own = matting.premultiply(colours(jnp.asarray(image), every)[0], every)
            drawn = matting.over(own, jnp.broadcast_to(new, own.shape))
            spread = jnp.sqrt(jnp.mean((drawn[1:] - drawn[0]) ** 2, axis=0))
            true = alpha * front + (1 - alpha) * new[..., :3]
            pairs = (one.alpha - alpha, one.alpha_sd), (made[..., :3] - true, sd[..., :3])
            pairs = *pairs, (drawn[0, ..., :3] - true, spread[..., :3])
            for name, (off, size) in zip(names, pairs, strict=True):
                found[name].append(np.asarray(off / jnp.maximum(size, 1e-3))[unknown])
        for name, z in found.items():
            row(texture, name, count, *shares(np.concatenate(z)))


def close(count: int = 10) -> None:
    """Count coverage under near lights, with positions wrong by 3 mm and powers by 1 % as stated,
    or exact."""
    sds = np.array([0.003, 0.003, 0.003, 0.01])
    for kind in ("plane", "ball"):
        points, normals = near.surface(kind)
        known = np.isfinite(points).all(axis=-1)
        albedo = np.where(known, 100 + 50 * np.sin(40 * points[..., 0]), 0)
        images = near.read(points, normals, albedo)
        stated = np.einsum("ij,ab->iajb", np.eye(8), np.diag(sds**2))
        for name, size, covariance in (("exact", 0.0, None), ("off, as stated", 1.0, stated)):
            inside, missed, z = [], [], []
            for seed in range(count):
                rng = np.random.default_rng(seed)
                move = size * sds * rng.normal(size=(8, 4))
                found = photometric_stereo(
                    images + rng.normal(0, 1, images.shape),
                    near.LIGHTS + move[:, :3],
                    intensities=near.POWERS * np.exp(move[:, 3]),
                    points=points,
                    covariance=covariance,
                )
                off = near.off(found, normals)[known]
                inside.append(np.mean(off < 2.448 * found.normal_sd[known]))
                missed.append(np.median(off))
                z.append(((found.albedo - albedo) / found.albedo_sd)[known])
            degrees = f"{np.degrees(np.mean(missed)):.2f}°"
            row(kind, name, count, f"{np.mean(inside):.3f}", shares(z)[2], degrees)


def hollows(count: int = 1) -> None:
    """Count coverage for hollows, with and without correction for interreflection, over `count`
    seeds."""
    for scene, lowest in ((hollow.bowl, 0.5), (hollow.bowl, 0.1), (hollow.groove, 0.8)):
        for albedo in (0.3, 0.6):
            for white in (None, 1000 / albedo):
                of_lights = [
                    np.mean(
                        [
                            hollow.covered(scene, albedo, lights, lowest, white, seed)[:2]
                            for seed in range(3, 3 + count)
                        ],
                        axis=0,
                    )
                    for lights in (8, 16, 24, 64)
                ]
                degrees = f"{np.degrees(np.arccos(lowest)):.0f}°"
                kind = f"{scene.__name__} of albedo {albedo}"
                shares_inside = [f"{inside:.3f}" for inside, _ in of_lights]
                off = f"{of_lights[-1][1]:.2f}°"
                row(kind, degrees, "as read" if white is None else "white", *shares_inside, off)


def wavefronts(count: int = 100) -> None:
    """Aberrations of 30, -45 and 60 nm: of two pictures of a star, and of six of edges."""
    terms, focus = jnp.array([3, 5, 7, 10]), jnp.array([-80.0, 80.0])
    true, free = np.array([30.0, -45.0, 60.0]), Parameter(lower=-200.0, upper=200.0, shape=(3,))

    def stars(aberrations):
        def star(defocus):
            error = 1e-9 * jnp.zeros(11).at[terms].set(jnp.append(defocus, aberrations))
            return jv.optics.wavefront_kernel(error, 550e-9, 8.0, 2e-6, size=15, samples=48)

        return 2e4 * jax.vmap(star)(focus) + 20

    mean, z = np.asarray(stars(jnp.asarray(true))), []
    for seed in range(count):
        data = np.random.default_rng(seed).poisson(mean)
        found = fit(Problem({"aberrations": free}, stars, Gaussian(sd=np.sqrt(mean)), data))
        of = [(one.value, one.standard_error) for one in found.estimates]
        z.append([(value - at) / sd for (value, sd), at in zip(of, true, strict=True)])
    for name, own in zip(("astigmatism", "coma", "spherical"), np.transpose(z), strict=True):
        row("two stars", name, count, *shares(own))
    known: dict = {"wavelength": lens.WAVE, "f_number": lens.F_NUMBER, "pixel_pitch": lens.PITCH}
    by_name: dict = {}
    for seed in range(100, 100 + count // 2):
        images, defocus = lens.pictures(seed)
        found = resolution.wavefront_from_edges(images, **known, defocus=defocus)
        for one in found.estimates:
            if one.name[0] == "z":
                off = one.value - lens.TRUTH.get(int(one.name[1:]), 0.0)
                by_name.setdefault(one.name, []).append(off / one.standard_error)
    for name, own in by_name.items():
        row("edges", name, len(own), *shares(own))


def texels(count: int = 200) -> None:
    """The reflectances of 4 x 4 texels of a card, from one picture of 24 x 24 pixels."""
    view = jv.Pinhole([0, 0, 0], np.eye(3), 1.0, 0.03, resolution=(24, 24))

    def picture(texels):
        paint = jv.Lambert(jv.Map(texels[..., None], wrap="clamp"))
        card = jv.Surface(jv.Quad([-1, -1, 2.5], [0, 2, 0], [2, 0, 0]), paint)
        return jv.render(jv.Scene(card, jv.PointLight([1, 0, 0], [5.0])), view)[..., 0]

    free, z, shown = Parameter(lower=0, shape=(4, 4), linear=True), [], jax.jit(picture)
    for seed in range(count):
        rng = np.random.default_rng(seed)
        true = rng.uniform(0.05, 0.25, (4, 4))
        data = np.asarray(shown(jnp.asarray(true))) + 0.002 * rng.normal(size=(24, 24))
        found = fit(Problem({"texels": free}, picture, Gaussian(0.002), data))
        of = [(one.value, one.standard_error) for one in found.estimates]
        z.append([(value - at) / sd for (value, sd), at in zip(of, true.ravel(), strict=True)])
    row("4 x 4 texels", "reflectance", count, *shares(z))


TABLES = {
    "wavefronts": wavefronts,
    "texels": texels,
    "lights": lamps,
    "edges": edges,
    "sensitivities": charts,
    "mattes": mattes,
    "near": close,
    "hollows": hollows,
}

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("table", choices=TABLES)
    parser.add_argument("--count", type=int)
    asked = parser.parse_args()
    TABLES[asked.table](**({} if asked.count is None else {"count": asked.count}))
