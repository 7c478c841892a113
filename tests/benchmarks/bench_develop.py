"""Compare demosaicing and JPEG with colour-demosaicing, OpenCV and kornia, in alternation.

    pytest tests/benchmarks/bench_develop.py -m benchmark -s

OpenCV demosaics integers only, so its 16-bit picture has half the bytes of ours. kornia's JPEG
rounds by a smooth function, as "cubic" does.

Pictures of more than 32 MB need new memory pages at every call, which the system clears one by one.
"ours, nothing but the picture" only writes such a picture, and at 2048 x 2048 pixels this takes
most of the time. It does not with large pages, as NumPy and OpenCV have them: set
GLIBC_TUNABLES=glibc.malloc.hugetlb=1.
"""

import time
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from turns import in_turns

from jaxvision.development import demosaic, jpeg
from jaxvision.sensor.colour_filters import bayer, mosaic

ROUNDS = 9
PATTERN = bayer("RGGB")
RNG = np.random.default_rng(1)
SIZES = ((512, 512), (2048, 2048), (3000, 4000))


def compiled(name: str, function: Callable, *arrays: jax.Array) -> Callable[[], jax.Array]:
    """Return the call compiled ahead, and print the time that compiling took."""
    start = time.perf_counter()
    call = jax.jit(function).lower(*arrays).compile()
    print(f"    {name}: traced and compiled in {time.perf_counter() - start:.2f} s")
    return lambda: call(*arrays)


def picture_of(size: tuple[int, int]) -> np.ndarray:
    """Return smooth colours with edges and some noise, as 8-bit codes."""
    y, x = np.mgrid[: size[0], : size[1]].astype(np.float32)
    waves = np.stack([np.sin(x / 31), np.cos(y / 23), np.sin((x + y) / 47)], -1)
    edges = ((x // 64 + y // 64) % 2)[..., None]
    noise = RNG.normal(0, 3, size=(*size, 3)).astype(np.float32)
    return np.clip(128 + 60 * waves + 40 * edges + noise, 0, 255).astype(np.uint8)


def table(
    title: str, rivals: dict[str, Callable[[], object]], *, rounds: int = ROUNDS
) -> dict[str, float]:
    _, seconds = in_turns(rivals, rounds=rounds)
    for name, taken in seconds.items():
        print(f"  {title:22s} {name:28s} {1e3 * taken:9.2f} ms")
    return seconds


@pytest.mark.benchmark
@pytest.mark.parametrize("size", SIZES)
def test_demosaicing(size):
    cv2 = pytest.importorskip("cv2")
    peers = pytest.importorskip("colour_demosaicing")
    codes = np.asarray(mosaic(picture_of(size), PATTERN))
    raw, deep = jnp.asarray(codes, jnp.float32), codes.astype(np.uint16)
    rivals: dict[str, Callable[[], object]] = {
        f"ours, {method}": compiled(method, lambda r, m=method: demosaic(r, PATTERN, method=m), raw)
        for method in ("bilinear", "malvar", "menon", "normalised")
    }
    rivals["ours, nothing but the picture"] = compiled(
        "picture", lambda r: jnp.broadcast_to(r[..., None] + 1, (*r.shape, 3)), raw
    )
    rivals["opencv, bilinear, 16 bit"] = lambda: cv2.cvtColor(deep, cv2.COLOR_BayerRGGB2RGB)
    floats = codes.astype(np.float32)
    rivals["colour-demosaicing, malvar"] = lambda: peers.demosaicing_CFA_Bayer_Malvar2004(floats)
    if size[0] <= 2048:
        rivals["colour-demosaicing, menon"] = lambda: peers.demosaicing_CFA_Bayer_Menon2007(floats)
    inside = np.s_[8:-8, 8:-8]
    np.testing.assert_allclose(  # OpenCV rounds to integers
        np.asarray(rivals["ours, bilinear"]())[inside],
        rivals["opencv, bilinear, 16 bit"]()[inside],
        atol=0.5 + 1e-3,
    )
    np.testing.assert_allclose(
        np.asarray(rivals["ours, malvar"]())[inside],
        rivals["colour-demosaicing, malvar"]()[inside],
        atol=1e-3,
    )
    rounds = ROUNDS if size[0] < 2048 else 3  # colour-demosaicing takes seconds
    seconds = table(f"{size[0]} x {size[1]}", rivals, rounds=rounds)
    bilinear = seconds["ours, bilinear"] / seconds["opencv, bilinear, 16 bit"]
    malvar = seconds["colour-demosaicing, malvar"] / seconds["ours, malvar"]
    print(f"  bilinear {bilinear:.2f} of OpenCV; Malvar {malvar:.1f} x colour-demosaicing's speed")


@pytest.mark.benchmark
def test_demosaicing_beside_kornia():
    torch = pytest.importorskip("torch")
    kornia = pytest.importorskip("kornia")
    codes = np.asarray(mosaic(picture_of((512, 512)), PATTERN)).astype(np.float32)
    tensor, raw = torch.from_numpy(codes[None, None]), jnp.asarray(codes)
    ours = compiled("bilinear", lambda r: demosaic(r, PATTERN, method="bilinear"), raw)

    def peer() -> np.ndarray:  # OpenCV's BG names the pixel at (1, 1)
        return kornia.color.raw_to_rgb(tensor, kornia.color.CFA.BG).numpy()[0].transpose(1, 2, 0)

    inside = np.s_[2:-2, 2:-2]
    np.testing.assert_allclose(np.asarray(ours())[inside], peer()[inside], atol=1e-3)
    table("512 x 512", {"ours, bilinear": ours, "kornia, bilinear": peer})


@pytest.mark.benchmark
@pytest.mark.parametrize("size", SIZES[:2])
def test_jpeg(size):
    cv2 = pytest.importorskip("cv2")
    torch = pytest.importorskip("torch")
    kornia = pytest.importorskip("kornia")
    codes = picture_of(size)
    picture, quality = jnp.asarray(codes / np.float32(255)), jnp.float32(85)
    tensor = torch.from_numpy(np.asarray(picture).transpose(2, 0, 1)[None].copy())

    def file() -> np.ndarray:
        _, buffer = cv2.imencode(".jpg", codes[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])
        return cv2.imdecode(buffer, cv2.IMREAD_COLOR)[..., ::-1]

    def gradient(x: jax.Array, q: jax.Array) -> jax.Array:
        return jax.grad(lambda a: jnp.sum(jpeg(a, q, rounding="cubic") ** 2))(x)

    rivals = {
        "ours, 4:2:0": compiled("4:2:0", jpeg, picture, quality),
        "ours, 4:4:4": compiled(
            "4:4:4", lambda x, q: jpeg(x, q, subsampling="4:4:4"), picture, quality
        ),
        "ours, cubic": compiled(
            "cubic", lambda x, q: jpeg(x, q, rounding="cubic"), picture, quality
        ),
        "ours, cubic, with gradient": compiled("gradient", gradient, picture, quality),
        "kornia, soft": lambda: kornia.enhance.jpeg_codec_differentiable(
            tensor, torch.tensor([85.0])
        ),
        "opencv, with a real file": file,
    }
    ours = np.round(255 * np.asarray(rivals["ours, 4:2:0"]())).astype(int)
    np.testing.assert_array_equal(ours, file())
    table(f"{size[0]} x {size[1]}", rivals)
