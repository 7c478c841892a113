"""Vectors in the numbers of `oracle_numbers`, as columns of (points, 3)."""


def inner(u, v):
    return u[:, 0] * v[:, 0] + u[:, 1] * v[:, 1] + u[:, 2] * v[:, 2]


def length(m, v):
    return m.sqrt(inner(v, v))


def crossed(u, v):
    return tuple(u[:, i] * v[:, j] - u[:, j] * v[:, i] for i, j in ((1, 2), (2, 0), (0, 1)))


def angle(m, u, v):
    """Return 2 atan2(|u - v|, |u + v|) for vectors taken as unit vectors."""
    return 2 * m.arctan2(length(m, u - v), length(m, u + v))


def log_cos(m, u, v):
    """Return the log cosine of vectors taken as unit vectors: by 1 - |u - v|^2 / 2 below 60
    degrees, and by the product otherwise."""
    lost = inner(u - v, u - v) / 2
    near = lost < m.c("0.5")
    straight = m.log1p(-m.where(near, lost, m.c("0")))
    return m.where(near, straight, m.log(m.where(near, m.c("1"), inner(u, v))))
