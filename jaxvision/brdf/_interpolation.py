"""Linear interpolation of tables: locate a number between the nodes of each axis, and weight the
entries there.

A `Place` is a list of (index, weight), one for each node next to the number. Nodes increase. On an
axis with a single node, every number is assigned to that node.
"""

from itertools import product
from math import prod
from typing import Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..core._types import Scalar

Place = list[tuple[Int[Array, ""], Scalar]]


def _single_node(x: Scalar) -> Place:
    return [(jnp.zeros((), jnp.int32), jnp.ones_like(x))]


def interpolation_weights(
    nodes: Float[Array, " n"], x: Scalar, *, outside: Literal["clamp", "extrapolate"] = "clamp"
) -> Place:
    """Return the nodes next to `x` with their weights for linear interpolation. Outside the nodes,
    "clamp" takes the outermost node and "extrapolate" continues the line through the last two."""
    if nodes.shape[0] == 1:
        return _single_node(x)
    i = jnp.clip(jnp.sum(nodes <= x, dtype=jnp.int32) - 1, 0, nodes.shape[0] - 2)
    low, high = nodes[i], nodes[i + 1]
    w = (x - low) / (high - low)
    w = w if outside == "extrapolate" else jnp.clip(w, 0, 1)
    return [(i, 1 - w), (i + 1, w)]


def around_circle(nodes: Float[Array, " n"], angle: Scalar) -> Place:
    """Return the nodes next to an angle (rad), with their weights, for nodes that span less than a
    full circle. Between the last node and the first one, interpolation closes the circle."""
    if nodes.shape[0] == 1:
        return _single_node(angle)
    turned = nodes[0] + jnp.mod(angle - nodes[0], 2 * jnp.pi)
    closed = jnp.concatenate([nodes, nodes[:1] + 2 * jnp.pi])
    (i, wi), (j, wj) = interpolation_weights(closed, turned)
    return [(i, wi), (j % nodes.shape[0], wj)]


def place_in_unit(position: Scalar, count: int) -> Place:
    """Return the nodes next to a number in [0, 1], with their weights, for `count` equally spaced
    nodes from 0 to 1."""
    if count == 1:
        return _single_node(position)
    scaled = jnp.clip(position, 0, 1) * (count - 1)
    i = jnp.clip(jnp.floor(scaled).astype(jnp.int32), 0, count - 2)
    w = scaled - i.astype(scaled.dtype)
    return [(i, 1 - w), (i + 1, w)]


def bin_centre_position(position: Scalar, count: int, *, periodic: bool = False) -> Place:
    """Return the bins whose centres are next to a number in [0, 1], with their weights, for `count`
    bins of equal width."""
    scaled = position * count - np.asarray(0.5, position.dtype)
    low = jnp.floor(scaled)
    w, i = scaled - low, low.astype(jnp.int32)
    if periodic:
        return [(i % count, 1 - w), ((i + 1) % count, w)]
    return [(jnp.clip(i, 0, count - 1), 1 - w), (jnp.clip(i + 1, 0, count - 1), w)]


def containing_bin(position: Scalar, count: int) -> Place:
    """Return the bin that contains a number in [0, 1], with weight 1, for `count` bins of equal
    width."""
    i = jnp.clip(jnp.floor(position * count).astype(jnp.int32), 0, count - 1)
    return [(i, jnp.ones_like(position))]


def multilinear(table: Float[Array, "..."], *places: Place) -> Float[Array, "..."]:
    """Interpolate a table along its leading axes, one for each of `places`; the other axes
    remain."""
    value = jnp.zeros(table.shape[len(places) :], table.dtype)
    for corner in product(*places):
        entry = table.at[tuple(index for index, _ in corner)].get(mode="promise_in_bounds")
        value = value + prod(weight for _, weight in corner) * entry
    return value
