"""Solve the radiosity equation for patches that illuminate each other:

    B_i = M_i + rho_i (E_i + sum_j F_ij B_j)

B is the radiosity, M the emitted light and E the direct irradiance from lights, all (patches,
bands) in W m^-2. The albedo is rho, (patches, bands), and F are the form factors, (patches,
patches), both without unit. Source: Goral, Torrance, Greenberg and Battaile, "Modeling the
Interaction of Light Between Diffuse Surfaces", SIGGRAPH 1984.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ...core._arguments import takes_numbers, takes_range
from ...core._loops.fusion import one_program
from ...core._numerics import divide, or_one
from ...core._types import Range, Scalar, as_float, check_choice, check_shape, print_by_name
from ...core.parallel_loops import fori_loop, while_loop

if TYPE_CHECKING:
    import lineax

PatchSpectra = Float[Array, "patches bands"]
Table = Float[Array, "patches patches"]
Product = Callable[[PatchSpectra], PatchSpectra]
print_by_name(globals(), "PatchSpectra", "Table")
# A room counts as closed if the mean row sum of its form factors exceeds 1 minus this number. In
# the mean, the errors of single elements, from quadrature and shadow rays, mostly cancel.
CLOSED = 2e-3
# pi k_d may round to just above 1; a larger albedo has no solution
_ALBEDO = Range(0, 1 + 1e-4, nan=True)
# radiosity, unshot, shots, and whether to go on
State = tuple[PatchSpectra, PatchSpectra, Int[Array, ""], Bool[Array, ""]]


@takes_numbers
@takes_range(albedo=_ALBEDO)
def solve_radiosity(
    table: Table | Product,
    albedo: PatchSpectra,
    sent: PatchSpectra,
    *,
    method: str = "direct",
    tolerance: float = 1e-4,
    limit: int = 1_000_000,
) -> PatchSpectra:
    """Solve the radiosity equation B = M + rho E + rho F B for the radiosity B, band by band.

    High albedos amplify rounding errors: in a closed room of albedo rho the errors are multiplied
    by 1 / (1 - rho). In float32, at albedo .999, the methods "direct" and "iterative" have errors
    of at most 3e-4 of the brightest patch. The method "progressive" is not suitable for such
    albedos: with 294 patches it stops at the limit of shots, with an error of 1e-3 in float64, and
    of 4e-3 in float32, where each shot adds a rounding error. If all albedos in a closed room are
    1, the equation has no solution, and each method returns large numbers of either sign. All three
    methods have the gradients of the exact solution, by the transposed equation.

    Args:
        table: (patches, patches) form factors F, no unit; or, for "iterative", a function that
            multiplies F by (patches, bands), as `exchanged` does without storing F.
        albedo: (patches, bands) rho in [0, 1], no unit.
        sent: (patches, bands) M + rho E, W m^-2.
        method: static. "direct": LU, exact to rounding, at a cost of patches^3. "iterative": GMRES,
            until the residual is `tolerance` of the largest `sent`, or as small as rounding allows.
            "progressive": `shoot`, until the error of every patch is below `tolerance` of the
            brightest, or until `limit` shots; the remaining light is then neglected.
        tolerance: static, relative to the brightest patch.
        limit: static, largest number of shots.

    Returns:
        (patches, bands) B, W m^-2. B is infinite in a band in which a closed room with light
        absorbs nothing, so that there is no equilibrium.

    Raises:
        ValueError: for an unknown method, for a function in place of the table unless the method is
            "iterative", for a table that is not square, and for an albedo above 1. The functions
            below also refuse an albedo above 1.

    Example:
        Two patches that see only each other, albedo 1/2, one emitting 3: B = (4, 2).

        >>> table = jnp.array([[0.0, 1.0], [1.0, 0.0]])
        >>> half, sent = jnp.full((2, 1), 0.5), jnp.array([[3.0], [0.0]])
        >>> print(jv.transport.radiosity.solve_radiosity(table, half, sent).ravel().round(6))
        [4. 2.]
    """

    check_choice("method", method, ("direct", "iterative", "progressive"))
    if not callable(table):
        patches = jnp.shape(albedo)[0]
        check_shape("solve_radiosity: table", table, (patches, patches))
    if callable(table):
        if method != "iterative":
            raise ValueError(f"method {method!r} needs a table, got a function; use 'iterative'.")
        found = _solve_bands(table, albedo, sent, tolerance)
        return _mark_unbounded(found, table(jnp.ones_like(albedo)), albedo, sent)
    table = as_float(table)
    if method == "progressive":
        found = _progressive(table, albedo, sent, tolerance, limit)
    else:
        found = _solve_by_lineax(table, albedo, sent, method, tolerance)
    return _mark_unbounded(found, table.sum(axis=1, keepdims=True), albedo, sent)


@one_program
def _mark_unbounded(
    found: PatchSpectra, seen: Float[Array, "patches _"], albedo: PatchSpectra, sent: PatchSpectra
) -> PatchSpectra:
    """Return the solution `found`, but infinity in a band whose light is never absorbed, and 0 for
    NaN in a band without light. `seen` is the sum of each patch's form factors. The equations of a
    white closed room are singular, and rounding then gives numbers of either sign.
    """
    closed = jnp.mean(seen, axis=0) > 1 - CLOSED
    white = jnp.min(albedo, axis=0) >= 1 - 16 * jnp.finfo(albedo.dtype).eps
    positive = jnp.min(sent, axis=0) >= 0
    dark = (sent == 0).all(axis=0)
    negative = jnp.min(found, axis=0) < -1e-3 * jnp.max(jnp.abs(found), axis=0)
    endless = positive & ((closed & white) | negative)
    solved = jnp.where(endless[None] & ~dark[None], jnp.inf, found)
    return jnp.where(dark[None] & jnp.isnan(found), 0, solved)


@one_program
def _solve_by_lineax(
    table: Table, albedo: PatchSpectra, sent: PatchSpectra, method: str, tolerance: float
) -> PatchSpectra:
    import lineax

    solver = lineax.LU() if method == "direct" else _gmres(tolerance)

    structure = jax.ShapeDtypeStruct(table.shape[:1], table.dtype)

    def band(rho: Float[Array, " patches"], b: Float[Array, " patches"]) -> Array:
        brightest = jax.lax.stop_gradient(jnp.abs(b).max())
        scale = or_one(brightest)
        if method == "direct":
            matrix = jnp.eye(len(b), dtype=table.dtype) - rho[:, None] * table
            operator = lineax.MatrixLinearOperator(matrix)
        else:  # all bands use the same table, without a copy
            operator = lineax.FunctionLinearOperator(lambda x: x - rho * (table @ x), structure)
        # float32 may not reach the tolerance; its best result is then the answer
        return scale * lineax.linear_solve(operator, b / scale, solver, throw=False).value

    return jax.vmap(band, in_axes=1, out_axes=1)(albedo, sent)


def _gmres(tolerance: float) -> "lineax.GMRES":
    """Return a GMRES solver for radiosities that are scaled to a maximum of 1. The tolerance is
    absolute, because dark patches would never meet a relative tolerance. GMRES stops only at
    restarts. It needs 19 to 28 products with the table if it restarts every 8 steps, and 43 if it
    restarts every 20 steps."""
    import lineax

    return lineax.GMRES(rtol=0.0, atol=tolerance, restart=8, stagnation_iters=4)


def _solve_bands(
    product: Product, albedo: PatchSpectra, sent: PatchSpectra, tolerance: float
) -> PatchSpectra:
    """Solve the radiosity equation by GMRES for all bands together, so that each product computes
    the form factors only once for all bands."""
    import lineax

    structure = jax.ShapeDtypeStruct(sent.shape, sent.dtype)
    operator = lineax.FunctionLinearOperator(lambda b: b - albedo * product(b), structure)
    scale = or_one(jnp.abs(sent).max(axis=0, keepdims=True))
    return scale * lineax.linear_solve(operator, sent / scale, _gmres(tolerance), throw=False).value


@takes_numbers
@takes_range(albedo=_ALBEDO)
@one_program
def bounce(table: Table, albedo: PatchSpectra, sent: PatchSpectra, *, count: int) -> PatchSpectra:
    """Return the radiosity B after a number of reflections: the first terms of the Neumann series.
    A path tracer of that depth computes the same radiosity.

    Args:
        table, albedo, sent: as in `solve_radiosity`.
        count: static, number of reflections, >= 0.

    Returns:
        (patches, bands) W m^-2.
    """

    def reflect(_: Int[Array, ""], radiosity: PatchSpectra) -> PatchSpectra:
        return sent + albedo * (table @ radiosity)

    return fori_loop(0, count, reflect, sent)


@takes_numbers
@takes_range(albedo=_ALBEDO)
@one_program
def shoot(
    table: Table,
    albedo: PatchSpectra,
    sent: PatchSpectra,
    *,
    tolerance: float = 1e-4,
    limit: int = 10_000,
) -> tuple[PatchSpectra, PatchSpectra]:
    """Solve the radiosity equation by progressive refinement. In each step (shot), the patch with
    the brightest light that has not been distributed yet sends this light to all other patches.

    The method is Southwell relaxation, in which the area of patches is ignored. The number of shots
    depends on the values, so there is no reverse-mode gradient; `solve_radiosity` has one.

    Args:
        table, albedo, sent: as in `solve_radiosity`.
        tolerance: static; the method ends when light that has not been distributed can add at most
            this fraction of the brightest patch to any patch.
        limit: static, largest number of shots. If it is reached, the remaining light may be large:
            in a closed room of albedo rho up to the brightest unshot light times rho / (1 - rho),
            and n patches need about n / (1 - rho) shots.

    Returns:
        B, and the part of it that has not been distributed, (patches, bands) each, W m^-2;
        `ambient_estimate` estimates the effect of this part.

    Source:
        Cohen, Chen, Wallace and Greenberg, "A Progressive Refinement Approach to Fast Radiosity
        Image Generation", SIGGRAPH 1988.
    """
    most = _largest_correction(table, albedo)

    def state_of(radiosity: PatchSpectra, unshot: PatchSpectra, shots: Array) -> State:
        rest = most * jnp.abs(unshot).max()
        unfinished = (rest > tolerance * jnp.abs(radiosity).max()) & (shots < limit)
        return radiosity, unshot, shots, unfinished

    def shot(state: State) -> State:
        radiosity, unshot, shots, _ = state
        sender = jnp.argmax(jnp.abs(unshot).max(axis=1))
        arrived = albedo * (table[:, sender, None] * unshot[sender][None, :])
        return state_of(radiosity + arrived, unshot.at[sender].set(0) + arrived, shots + 1)

    begin = state_of(sent, sent, jnp.zeros((), jnp.int32))
    radiosity, unshot, *_ = while_loop(lambda state: state[-1], shot, begin)
    return radiosity, unshot


_BOUNCES = 16


def _largest_correction(table: Table, albedo: PatchSpectra) -> Scalar:
    """Return an upper bound on the light that all further reflections add to a patch, if the
    undistributed light of every patch is at most 1. The bound is infinite if the reflections do not
    decrease.

    If w - rho F w >= 1 - s > 0 everywhere, then |(I - rho F)^-1 b| <= w / (1 - s) max |b|, because
    rho F is not negative. For w, take the Neumann series 1 + rho F + ... + (rho F)^n applied to a
    vector of ones. Then s is the largest element of (rho F)^(n + 1) applied to ones. For n = 0 the
    bound is 1 / (1 - largest row sum). For large n the bound is tight, even if single rows of an
    inexact table sum to more than 1.
    """

    def add_term(_: Int[Array, ""], state: tuple[PatchSpectra, PatchSpectra]) -> tuple:
        total, term = state
        term = albedo * (table @ term)
        return total + term, term

    ones = jnp.ones_like(albedo)
    total, term = fori_loop(0, _BOUNCES, add_term, (ones, ones))
    kept = (albedo * (table @ term)).max(axis=0)
    return (divide(total.max(axis=0), 1 - kept, kept < 1, jnp.inf) - 1).max()


@takes_numbers
@takes_range(albedo=_ALBEDO)
def ambient_estimate(
    albedo: PatchSpectra, unshot: PatchSpectra, area: Float[Array, " patches"]
) -> PatchSpectra:
    """Estimate the light that is still missing in each patch of a closed scene after a few shots of
    `shoot`, for display.

    The estimate is the albedo times the area-weighted mean of the undistributed light, including
    all its reflections.

    Args:
        albedo: (patches, bands) in [0, 1], no unit.
        unshot: (patches, bands) W m^-2, from `shoot`.
        area: (patches,) m^2.

    Returns:
        (patches, bands) W m^-2.
    """
    share = (area / area.sum())[:, None]
    mean_albedo = (share * albedo).sum(axis=0)
    return albedo * ((share * unshot).sum(axis=0) / (1 - mean_albedo))[None, :]


@one_program
def _progressive(
    table: Table, albedo: PatchSpectra, sent: PatchSpectra, tolerance: float, limit: int
) -> PatchSpectra:
    """Solve the radiosity equation by `shoot`. The gradient is that of the exact solution: the
    transposed equation is solved in the same way."""

    def transport(b: PatchSpectra) -> PatchSpectra:
        return b - albedo * (table @ b)

    def forward(_: object, b: PatchSpectra) -> PatchSpectra:
        return shoot(table, albedo, b, tolerance=tolerance, limit=limit)[0]

    def backward(_: object, b: PatchSpectra) -> PatchSpectra:
        # solve x = b + F^T rho x by substituting y = rho x
        y, _ = shoot(table.T, albedo, albedo * b, tolerance=tolerance, limit=limit)
        return b + table.T @ y

    return jax.lax.custom_linear_solve(transport, sent, forward, transpose_solve=backward)
