"""Direct light in NumPy float64, by rays and area-measure nodes. The library's records are only
read, and none of its code is used. `picture` is the picture that `render` should give."""

import numpy as np

OFFSET = 1e-6
SUN = 4, 12  # nodes of a disc
SKY = 10, 20  # nodes of a sky, polar and azimuthal, for lobes wider than 0.32 rad


def number(x):
    return np.asarray(x, np.float64)


def kind(x):
    return type(x).__name__


def dots(a, b):
    return (a * b).sum(-1)


def unit(v):
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-300)


# ---------------------------------------------------------------- shapes: distance, two normals


def flat(point, normal, o, d, inside):
    slope = d @ normal
    t = np.where(slope != 0, ((point - o) @ normal) / np.where(slope != 0, slope, 1), np.inf)
    at = o + np.where(np.isfinite(t), t, 0)[:, None] * d
    hit = (t > 1e-7) & np.isfinite(t) & inside(at - point)
    normals = np.broadcast_to(normal, d.shape)
    return np.where(hit, t, np.inf), normals, normals


def sphere(s, o, d):
    c, r = number(s.centre), float(s.radius)
    q = o - c
    b = dots(q, d)
    disc = b * b - dots(q, q) + r * r
    root = np.sqrt(np.maximum(disc, 0))
    t = np.where(-b - root > 1e-7, -b - root, -b + root)
    t = np.where((disc > 0) & (t > 1e-7), t, np.inf)
    n = (q + np.where(np.isfinite(t), t, 0)[:, None] * d) / r
    return t, n, n


def quad(s, o, d):
    c, u, v = number(s.corner), number(s.edge_u), number(s.edge_v)
    across = np.cross(u, v)
    toward_u, toward_v = np.cross(v, across), np.cross(across, u)

    def inside(p):
        s, t = p @ toward_u / (u @ toward_u), p @ toward_v / (v @ toward_v)
        return (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)

    return flat(c, across / np.linalg.norm(across), o, d, inside)


def disc(s, o, d):
    r = float(s.radius)
    return flat(
        number(s.centre), unit(number(s.normal)), o, d, lambda p: np.linalg.norm(p, axis=-1) <= r
    )


def plane(s, o, d):
    return flat(number(s.point), unit(number(s.normal)), o, d, lambda p: np.ones(len(p), bool))


def box(s, o, d):
    axes = np.eye(3) if s.rotation is None else number(s.rotation)
    half = number(s.half_extents)
    p, w = (o - number(s.centre)) @ axes.T, d @ axes.T
    with np.errstate(divide="ignore", invalid="ignore"):
        one, two = (-half - p) / w, (half - p) / w
    near, far = np.minimum(one, two).max(-1), np.maximum(one, two).min(-1)
    t = np.where(near > 1e-7, near, far)
    t = np.where((near < far) & (t > 1e-7), t, np.inf)
    at = (p + np.where(np.isfinite(t), t, 0)[:, None] * w) / half
    k = np.abs(at).argmax(-1)
    n = np.sign(at[np.arange(len(d)), k])[:, None] * axes[k]
    return t, n, n


def mesh(s, o, d):
    vertices, faces = number(s.vertices), np.asarray(s.faces)
    best = np.full(len(d), np.inf)
    normal, shading = np.zeros_like(d), np.zeros_like(d)
    for face in faces:
        a, b, c = vertices[face]
        across = np.cross(b - a, c - a)
        turned = np.cross(d, c - a)
        det = turned @ (b - a)
        safe = np.where(np.abs(det) > 1e-14, det, np.inf)
        u = dots(o - a, turned) / safe
        q = np.cross(o - a, b - a)
        v, t = dots(d, q) / safe, (q @ (c - a)) / safe
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-7) & (t < best)
        best = np.where(hit, t, best)
        normal[hit] = shading[hit] = unit(across)
        if s.normals is not None:
            corners = unit(number(s.normals)[face])
            smooth = (1 - u - v)[:, None] * corners[0] + u[:, None] * corners[1]
            shading[hit] = unit(smooth + v[:, None] * corners[2])[hit]
    return best, normal, shading


SHAPES = {
    "Sphere": sphere,
    "Quad": quad,
    "Disc": disc,
    "Plane": plane,
    "Box": box,
    "TriangleMesh": mesh,
}


def hit(shape, o, d):
    return SHAPES[kind(shape)](shape, np.broadcast_to(o, d.shape), d)


# ---------------------------------------------------------------- materials: f_r cos, (n, bands)


def fresnel(interface, c):
    if interface is None:
        return np.ones((len(c), 1))
    c = c[:, None]
    if kind(interface) == "Schlick":
        f0 = number(interface.f0)
        return f0 + (1 - f0) * (1 - c) ** 5
    index = number(interface.eta) + 1j * number(getattr(interface, "k", 0.0))
    root = np.sqrt(index**2 - 1 + c**2 + 0j)
    s, p = (c - root) / (c + root), (index**2 * c - root) / (index**2 * c + root)
    return (np.abs(s) ** 2 + np.abs(p) ** 2) / 2


def facets(m, n, wi, wo):
    """Return F D G / (4 cos_o) for isotropic facets."""
    h = unit(wi + wo)
    a = float(np.max(number(m.roughness)))
    c_h, c_i, c_o = (np.maximum(dots(n, w), 1e-12) for w in (h, wi, wo))
    tan = 1 / c_h**2 - 1
    if m.distribution == "ggx":
        density = 1 / (np.pi * a**2 * c_h**4 * (1 + tan / a**2) ** 2)
        hidden = [(np.sqrt(1 + a**2 * (1 / c**2 - 1)) - 1) / 2 for c in (c_i, c_o)]
    else:
        from scipy.special import erfc

        density = np.exp(-tan / a**2) / (np.pi * a**2 * c_h**4)
        steep = [c / (a * np.sqrt(np.maximum(1 - c * c, 1e-300))) for c in (c_i, c_o)]
        hidden = [np.exp(-s * s) / (2 * s * np.sqrt(np.pi)) - erfc(s) / 2 for s in steep]
    d = np.maximum(dots(wo, h), 1e-12)
    if m.shadowing == "smith":
        share = 1 / (1 + hidden[0] + hidden[1])
    else:
        share = np.minimum(1, np.minimum(2 * c_h * c_o / d, 2 * c_h * c_i / d))
    return fresnel(m.interface, d) * (density * share / (4 * c_o))[:, None]


def oren_nayar(m, n, wi, wo):
    v, c_i, c_o = float(m.sigma) ** 2, dots(n, wi), dots(n, wo)
    a, b = 1 - 0.5 * v / (v + 0.33), 0.45 * v / (v + 0.09)
    t_i, t_o = wi - c_i[:, None] * n, wo - c_o[:, None] * n
    cos_phi = dots(unit(t_i), unit(t_o))
    theta_i, theta_o = np.arccos(np.clip(c_i, 0, 1)), np.arccos(np.clip(c_o, 0, 1))
    alpha, beta = np.maximum(theta_i, theta_o), np.minimum(theta_i, theta_o)
    if m.form == "qualitative":
        return (
            number(m.diffuse)
            * (a + b * np.maximum(cos_phi, 0) * np.sin(alpha) * np.tan(beta))[:, None]
        )
    steep = 2 * beta / np.pi
    c2 = b * (np.sin(alpha) - np.where(cos_phi < 0, steep**3, 0))
    c3 = 0.125 * v / (v + 0.09) * (4 * alpha * beta / np.pi**2) ** 2
    first = a + cos_phi * c2 * np.tan(beta)
    first += (1 - np.abs(cos_phi)) * c3 * np.tan((alpha + beta) / 2)
    second = 0.17 * v / (v + 0.13) * (1 - cos_phi * steep**2)
    k = number(m.diffuse)
    return np.maximum(k * first[:, None] + np.pi * k**2 * second[:, None], 0)


def eon(m, n, wi, wo):
    """Return EON with the closed form of the albedo, in angles (Portsmouth, Kutz & Hill, listing
    1)."""
    r, c_i, c_o, k = float(m.roughness), dots(n, wi), dots(n, wo), number(m.diffuse)
    a = 1 / (1 + (0.5 - 2 / (3 * np.pi)) * r)
    s = dots(wi, wo) - c_i * c_o
    single = k * (a * (1 + r * np.where(s > 0, s / np.maximum(c_i, c_o), s)))[:, None]

    def missing(c):
        theta = np.arccos(np.clip(c, 1e-9, 1))
        sin = np.sin(theta)
        g = sin * (theta - sin * np.cos(theta))
        g = g + 2 / 3 * (np.tan(theta) * (1 - sin**3) - sin)
        return 1 - a * (1 + r * g / np.pi)

    mean = a * (1 + (2 / 3 - 28 / (15 * np.pi)) * r)
    rho = np.minimum(np.pi * k, 1) if m.facet_albedo is None else number(m.facet_albedo)
    further = missing(c_i) * missing(c_o) / max(1 - mean, 1e-30)
    return single + k * rho * mean / (1 - rho * (1 - mean)) * further[:, None]


def reflected(m, n, wi, wo):
    """Return the radiance toward `wo` per irradiance of a surface that faces the light."""
    c_i = dots(n, wi)
    lit = ((c_i > 0) & (dots(n, wo) > 0))[:, None]
    cosine = np.maximum(c_i, 0)[:, None]
    name = kind(m)
    if name in ("Mirror", "Glass"):
        return np.zeros((len(n), 1))
    if name == "Dichromatic":
        return number(m.body_spectrum) * reflected(m.body, n, wi, wo) + number(
            m.interface_spectrum
        ) * reflected(m.interface, n, wi, wo)
    if name == "OrenNayar":
        return np.where(lit, oren_nayar(m, n, wi, wo) * cosine, 0)
    if name == "EON":
        return np.where(lit, eon(m, n, wi, wo) * cosine, 0)
    body = number(m.diffuse) * cosine
    if name == "Lambert":
        return np.where(lit, body, 0)
    if name == "TorranceSparrow":
        return np.where(lit, body + number(m.specular) * facets(m, n, wi, wo), 0)
    if "Blinn" in name:
        base, e = np.maximum(dots(n, unit(wi + wo)), 0), float(m.exponent)
        lobe, scale = base**e, (e + 2) * (e + 4) / (8 * np.pi * (e + 2 ** (-e / 2)))
    else:
        base = np.clip(dots(2 * c_i[:, None] * n - wi, wo), -1, 1)
        if "Gaussian" in name:
            lobe, scale = np.exp(-((float(m.concentration) * np.arccos(base)) ** 2)), 1.0
        else:
            e = float(m.exponent)
            lobe, scale = np.maximum(base, 0) ** e, (e + 2) / (2 * np.pi)
    if name.startswith("Normalised"):
        lobe = lobe * scale
    if name.startswith("Normalised") or name.endswith("BRDF"):
        lobe = lobe * cosine[:, 0]
    return np.where(lit, body + number(m.specular) * lobe[:, None], 0)


# ---------------------------------------------------------------- lights: (wi, E, distance) by node


def sky_radiance(light, w):
    """Interpolate bilinearly between pixel centres and across the seam. Outside the first and last
    rows their values are used."""
    table = number(light.radiance)
    rows, columns, _ = table.shape
    local = w @ number(light.rotation).T
    row = np.arccos(np.clip(local[:, 2], -1, 1)) / np.pi * rows - 0.5
    column = (0.5 - np.arctan2(local[:, 1], local[:, 0]) / (2 * np.pi)) * columns - 0.5
    r0, c0 = np.floor(row).astype(int), np.floor(column).astype(int)
    total = 0
    for dr in (0, 1):
        for dc in (0, 1):
            share = np.abs(1 - dr - (row - r0)) * np.abs(1 - dc - (column - c0))
            r, c = r0 + dr, c0 + dc
            over = (r < 0) | (r >= rows)  # across a pole
            c = np.where(over, c + columns // 2, c) % columns
            total = total + share[:, None] * table[np.clip(r, 0, rows - 1), c]
    return total


def arriving(light, p, nodes):
    """Yield each node's unit direction, irradiance of a facing surface, (n, bands), and
    distance."""
    name, n = kind(light), len(p)
    if name == "DirectionalLight":
        w = unit(number(light.direction))
        yield (
            np.broadcast_to(w, p.shape),
            np.broadcast_to(number(light.irradiance), (n, len(light.irradiance))),
            np.full(n, np.inf),
        )
    elif name == "EnvironmentMap":
        polar, around = SKY
        z, weight = np.polynomial.legendre.leggauss(polar)
        for cos, w in zip(z, weight, strict=True):
            for phi in 2 * np.pi * (np.arange(around) + 0.5) / around:
                sine = np.sqrt(1 - cos * cos)
                wi = np.array([[sine * np.cos(phi), sine * np.sin(phi), cos]])
                e = sky_radiance(light, wi) * w * 2 * np.pi / around
                yield np.broadcast_to(wi, p.shape), np.repeat(e, n, 0), np.full(n, np.inf)
    elif name == "SunDisc":
        polar, around = SUN
        w, (z, weight) = unit(number(light.direction)), np.polynomial.legendre.leggauss(polar)
        across = unit(np.cross(w, np.eye(3)[np.abs(w).argmin()]))
        height = 2 * np.sin(float(light.radius) / 2) ** 2
        e = sun_radiance(light) * 2 * np.pi * height / around
        for down, share in zip(height * (1 + z) / 2, weight / 2, strict=True):
            for phi in 2 * np.pi * (np.arange(around) + 0.5) / around:
                aside = np.cos(phi) * across + np.sin(phi) * np.cross(w, across)
                wi = (1 - down) * w + np.sqrt(down * (2 - down)) * aside
                yield np.broadcast_to(wi, p.shape), np.repeat([e * share], n, 0), np.full(n, np.inf)
    elif name == "GoniometricAreaLight":
        c, u, v = number(light.corner), number(light.edge_u), number(light.edge_v)
        x, weight = np.polynomial.legendre.leggauss(nodes)
        for s, ws in zip((x + 1) / 2, weight / 2, strict=True):
            for t, wt in zip((x + 1) / 2, weight / 2, strict=True):
                place = c + s * u + t * v
                wi, e, distance = at_place(place, number(light.intensity) * ws * wt, None, p)
                yield wi, e * photometric(light, -wi)[:, None], distance
    elif name in ("SpotLight", "GoniometricLight"):
        wi, e, distance = at_place(number(light.position), number(light.intensity), None, p)
        share = cone if name == "SpotLight" else photometric
        yield wi, e * share(light, -wi)[:, None], distance
    elif name in ("PointLight", "SmallLight"):
        normal = unit(number(light.normal)) if name == "SmallLight" else None
        yield at_place(number(light.position), number(light.intensity), normal, p)
    else:
        c, u, v = number(light.corner), number(light.edge_u), number(light.edge_v)
        across = np.cross(u, v)
        area = np.linalg.norm(across)
        x, w = np.polynomial.legendre.leggauss(nodes)
        for s, ws in zip((x + 1) / 2, w / 2, strict=True):
            for t, wt in zip((x + 1) / 2, w / 2, strict=True):
                power = number(light.radiance) * area * ws * wt
                yield at_place(c + s * u + t * v, power, across / area, p)


def cone(light, away):
    """Return the relative intensity of a spot light, as in glTF ("smooth"), pbrt ("smoothstep") or
    Mitsuba ("linear")."""
    inner, outer = float(light.inner), float(light.outer)
    cosine = away @ unit(number(light.direction))
    if light.falloff != "linear":
        part = np.clip((cosine - np.cos(outer)) / (np.cos(inner) - np.cos(outer)), 0, 1)
        return part**2 * (1 if light.falloff == "smooth" else 3 - 2 * part)
    return np.clip((outer - np.arccos(np.clip(cosine, -1, 1))) / (outer - inner), 0, 1)


def sun_radiance(light):
    return number(light.irradiance) / (np.pi * np.sin(float(light.radius)) ** 2)


def photometric(light, away):
    """Return the relative intensity of a lamp of system C, bilinear in gamma (from -z) and C (from
    x)."""
    if hasattr(light, "rotation"):
        frame = number(light.rotation)
    else:
        u, v = unit(number(light.edge_u)), unit(number(light.edge_v))
        frame = np.stack([u, -v, -np.cross(u, v)])
    x, y, z = (away @ frame.T).T
    gamma, c = np.arccos(np.clip(-z, -1, 1)), np.mod(np.arctan2(y, x), 2 * np.pi)
    planes = np.array([np.interp(c, number(light.horizontal), row) for row in light.distribution])
    vertical = number(light.vertical)
    row = np.clip(np.searchsorted(vertical, gamma) - 1, 0, len(vertical) - 2)
    t = (gamma - vertical[row]) / (vertical[row + 1] - vertical[row])
    each = np.arange(len(gamma))
    between = (1 - t) * planes[row, each] + t * planes[row + 1, each]
    return np.where((gamma >= vertical[0]) & (gamma <= vertical[-1]), between, 0)


def at_place(place, intensity, normal, p):
    toward = place - p
    distance = np.linalg.norm(toward, axis=-1)
    wi = toward / distance[:, None]
    leaning = 1.0 if normal is None else np.maximum(-(wi @ normal), 0)
    return wi, intensity * (leaning / distance**2 * np.ones(len(p)))[:, None], distance


# ---------------------------------------------------------------- the picture


def bands_of(scene):
    counts = [1]
    for surface in scene.surfaces:
        counts += [] if surface.emission is None else [surface.emission.shape[-1]]
        for name in ("diffuse", "reflectance", "body_spectrum"):
            if hasattr(surface.material, name):
                counts.append(getattr(surface.material, name).shape[-1])
    for light in scene.lights:
        for name in ("intensity", "irradiance", "radiance"):
            if hasattr(light, name):
                counts.append(getattr(light, name).shape[-1])
    return max(counts)


def blocked(scene, p, normal, wi, distance):
    found = np.zeros(len(p), bool)
    start = p + OFFSET * normal
    for i in range(len(scene.surfaces)) if scene.occluders is None else scene.occluders:
        t, _, _ = hit(scene.surfaces[i].shape, start, wi)
        found |= t < distance - 2 * OFFSET
    return found


def shaded(scene, surface, p, normal, smooth, wo, nodes):
    """Return the radiance, (n, bands), from points of a surface toward `wo`."""
    total = np.zeros((len(p), bands_of(scene)))
    m = surface.material
    for light in scene.lights:
        for wi, e, distance in arriving(light, p, nodes):
            here = reflected(m, smooth, wi, wo) * e
            lit = np.flatnonzero(here.max(-1) > 0)
            if len(lit):
                dark = blocked(scene, p[lit], normal[lit], wi[lit], distance[lit])
                here[lit[dark]] = 0
            total += here
    if kind(m) == "Mirror":
        toward = 2 * dots(smooth, wo)[:, None] * smooth - wo
        radiance, far = lamps(scene, p, toward)
        radiance[blocked(scene, p, normal, toward, far)] = 0
        total += number(m.reflectance) * radiance
    if scene.ambient is not None and getattr(m, "ambient", None) is not None:
        total += number(m.ambient) * number(scene.ambient.radiance)
    total[dots(smooth, wo) <= 0] = 0
    return total


def lamps(scene, o, d):
    """Return the radiance, (n, bands), that rays see of extended lights, and its distance."""
    radiance, far = np.zeros((len(d), bands_of(scene))), np.full(len(d), np.inf)
    for light in scene.lights:
        if kind(light) == "EnvironmentMap":
            radiance += np.where(np.isinf(far)[:, None], sky_radiance(light, d), 0)
        if kind(light) == "SunDisc":
            within = d @ unit(number(light.direction)) >= np.cos(float(light.radius))
            radiance += within[:, None] * sun_radiance(light)
    for light in scene.lights:
        if kind(light) == "RectangleLight":
            t, n, _ = quad(light, np.broadcast_to(o, d.shape), d)
            seen = (t < far) & (dots(n, d) < 0)
            radiance[seen], far[seen] = number(light.radiance), t[seen]
        if kind(light) == "GoniometricAreaLight":
            t, n, _ = quad(light, np.broadcast_to(o, d.shape), d)
            area = np.linalg.norm(np.cross(number(light.edge_u), number(light.edge_v)))
            seen = (t < far) & (dots(n, d) < 0)
            cosine = np.maximum(-dots(n, d), 1e-9)[:, None]
            emitted = number(light.intensity) * photometric(light, -d)[:, None] / (area * cosine)
            radiance[seen], far[seen] = emitted[seen], t[seen]
    return radiance, far


def rays(view):
    """Return origins and unit directions of the pixels' centres."""
    rows, columns = view.resolution
    pitch = float(view.pixel_pitch)
    y, x = np.meshgrid(
        (np.arange(rows) + (1 - rows) / 2) * pitch,
        (np.arange(columns) + (1 - columns) / 2) * pitch,
        indexing="ij",
    )
    right, down, forward = number(view.rotation)
    aside = x.reshape(-1, 1) * right + y.reshape(-1, 1) * down
    place = number(view.position)
    if kind(view) == "Orthographic":
        return place + aside, np.broadcast_to(forward, aside.shape)
    f = float(view.focal_length)
    distance = getattr(view, "focus_distance", None)
    if distance is not None:
        f = 1 / (1 / f - 1 / float(distance))
    return np.broadcast_to(place, aside.shape), unit(aside / f + forward)


def picture(scene, view, *, nodes=8):
    """Return the picture, (h, w, bands) in W m^-2 sr^-1, with `nodes` along each side of a
    rectangle."""
    o, d = rays(view)
    found = [hit(surface.shape, o, d) for surface in scene.surfaces]
    distances = np.stack([t for t, _, _ in found])
    nearest, who = distances.min(0), distances.argmin(0)
    out = np.zeros((len(d), bands_of(scene)))
    for k, surface in enumerate(scene.surfaces):
        here = np.flatnonzero((who == k) & np.isfinite(nearest))
        if not len(here):
            continue
        wo = -d[here]
        normal, smooth = found[k][1][here], found[k][2][here]
        if surface.two_sided:
            turned = np.where(dots(normal, wo) < 0, -1.0, 1.0)[:, None]
            normal, smooth = normal * turned, smooth * turned
        p = o[here] + nearest[here, None] * d[here]
        out[here] = shaded(scene, surface, p, normal, smooth, wo, nodes)
        if surface.emission is not None:
            out[here] += np.where(dots(normal, wo) > 0, 1.0, 0)[:, None] * number(surface.emission)
    radiance, far = lamps(scene, o, d)
    ahead = (far < nearest) | np.isinf(nearest)
    out[ahead] = radiance[ahead]
    return out.reshape(*view.resolution, -1)
