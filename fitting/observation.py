"""Read the images of a rig as arrays, from files or from memory, and check them before any fit.

Digital numbers are float64 (h, w) or (h, w, channels), as stored in the files. The models handle
black level, gamma and saturation.
"""

from collections.abc import Callable, Mapping, Sequence, Sized
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from jaxvision import ArrayLike
from jaxvision.core.plain_arrays import plain_array
from jaxvision.errors import InputError
from jaxvision.files.image_settings import read_settings
from jaxvision.files.images import INTEGER_FORMATS, READ_ONLY_FORMATS, read_image
from jaxvision.files.toml import checked

from .inference.formatting import format_percent
from .inference.given import plain_numbers
from .rig import BY_SITE, COLOURS, Camera, Rig, SiteCamera

Load = Callable[[Path], np.ndarray]  # an image by its path

TELL_DEPTH = (*INTEGER_FORMATS, *READ_ONLY_FORMATS)  # formats whose header states the depth
ROUNDING = 1e-9  # relative difference up to which two numbers count as equal
MOST_LABELS = 16  # values of a mask of labels; masks with soft edges have more
# share of blocks of 2 x 2 pixels in which sites of a mosaic differ alike; their least difference,
# number, and level relative to the brightest
SAME_SIGN, UNEQUAL_SITES, FEWEST_BLOCKS, DIM = 0.9, 0.04, 50, 0.2
MEMORY = Path("arrays")  # folder that messages name for images in memory


def rig_in_memory(
    images: Mapping[str, ArrayLike], *, called: Mapping[str, str] | None = None, **entries: Any
) -> tuple[Rig, Load]:
    """Return a rig for images in memory, and the function that returns an image by its path."""
    rig = checked(MEMORY, {"folder": MEMORY, **entries}, Rig, "rig", first=0, called=called)
    stored = {rig.path(n): _refuse_masks(n, image) for n, image in images.items()}
    return rig, stored.__getitem__


def _refuse_masks(name: str, image: ArrayLike) -> np.ndarray:
    """Return an image as an array; refuse a mask that hides pixels."""
    if isinstance(image, np.ma.MaskedArray) and (hidden := int(np.ma.count_masked(image))):
        raise InputError(
            f"{name} is a masked array, {hidden} of its {image.size} numbers masked, and an image "
            "has no mask of its own here; give its .data, and leave the pixels out of all images "
            "by the argument mask where there is one, else by camera.region."
        )
    return np.asarray(plain_numbers(name, image))


def number_list(name: str, values: Sequence[float] | ArrayLike) -> list[float]:
    """Convert a list of numbers, such as exposures, to floats.

    Args:
        name: of the argument.
        values: (n,) in the documented unit.

    Returns:
        n numbers.

    Raises:
        InputError: for a value that is not a list of numbers, and for arrays with a unit, an index
            or coordinates, whose order or scale may differ.

    Example:
        >>> from fitting.observation import number_list
        >>> print(number_list("exposures", np.array([0.5, 1.0])))
        [0.5, 1.0]
    """
    plain = plain_array(name, values)
    try:
        if getattr(plain, "dtype", np.dtype(float)).kind in "iuf":
            return [float(x) for x in plain]
    except (TypeError, ValueError):
        pass
    raise InputError(f"{name} must be a list of numbers, got {values!r:.80}.")


def require_as_many(what: str, given: Sized, as_: str, others: Sized) -> None:
    """Refuse two lists of different lengths that belong together."""
    if len(given) != len(others):
        raise InputError(f"{len(given)} {what} for {len(others)} {as_}; give one for each.")


def require_several_images(name: str, images: Sequence[ArrayLike]) -> None:
    """Refuse a single image or an empty list where several images are needed."""
    if len(images) == 0:
        raise InputError(f"{name} is empty; give a list of images, (h, w) each.")
    if np.ndim(images[0]) < 2:
        shape = np.asarray(images).shape
        raise InputError(f"{name} is one image, {shape}; give a list of images, (h, w) each.")


def require_frames(name: str, levels: Sequence[Sequence[ArrayLike]]) -> None:
    """Refuse levels with fewer than two frames."""
    if len(levels) == 0:
        raise InputError(f"{name} is empty; give a list of levels, each a list of frames, (h, w).")
    for i, level in enumerate(levels):
        shape = getattr(level, "shape", ())
        if len(level) and (np.ndim(level[0]) < 2 or (len(shape) == 3 and shape[2] == 1)):
            raise InputError(
                f"{name}[{i}] is one frame, {np.asarray(level).shape}, but noise shows between "
                "frames; give of each level a list of two or more."
            )
        if len(level) < 2:
            raise InputError(
                f"{name}[{i}] has {len(level)} frame{'' if len(level) else 's'}, but noise shows "
                "between frames; give of each level a list of two or more."
            )


def read_frame(
    path: Path, camera: Camera, *, load: Load = read_image, mask: np.ndarray | None = None
) -> np.ndarray:
    """Return the digital numbers of one image, cropped to the camera's region if it has one.

    Example:
        >>> from pathlib import Path
        >>> from tempfile import TemporaryDirectory
        >>> from fitting.observation import read_frame
        >>> from fitting.rig import Camera
        >>> with TemporaryDirectory() as folder:
        ...     image = Path(folder) / "flat.tif"
        ...     jv.write_image(image, np.full((2, 3), 2048, np.uint16))
        ...     print(read_frame(image, Camera(bits=12)))
        [[2048. 2048. 2048.]
         [2048. 2048. 2048.]]
    """
    stored = load(path)
    numeric = np.issubdtype(stored.dtype, np.integer) or np.issubdtype(stored.dtype, np.floating)
    if not numeric or stored.ndim not in (2, 3) or stored.size == 0:
        raise InputError(
            f"{path}: holds {stored.dtype} of shape {stored.shape}, not an image; "
            "give (h, w) or (h, w, channels) numbers."
        )
    said = (
        read_settings(path).bits if path.suffix.lower() in TELL_DEPTH and path.is_file() else None
    )
    depth = said or (8 if stored.dtype == np.uint8 else 16)
    if depth < min(camera.bits, 16):
        raise InputError(
            f"{path}: {depth}-bit data, but the rig declares {camera.bits} bits; "
            "save the frames with 16 bits or correct camera.bits."
        )
    if stored.ndim == 3 and stored.shape[2] == 1:  # an image of one band
        stored = stored[..., 0]
    if stored.ndim == 3 and stored.shape[2] != 3:
        raise InputError(
            f"{path}: has {stored.shape[2]} channels; save it as grey (or mosaic), or as RGB "
            "without an alpha channel."
        )
    if stored.ndim == 3 and camera.pattern is not None:
        raise InputError(
            f"{path}: is a colour picture {stored.shape}, but camera.pattern says that it is a "
            "mosaic; give the raw mosaic, or remove camera.pattern."
        )
    _refuse_other_lists(path, camera, stored)
    frame = cropped_to_region(stored, camera, path).astype(np.float64)
    if not np.isfinite(frame).all():
        wrong = ~np.isfinite(frame)
        if mask is not None and mask.shape == frame.shape[:2]:
            frame = np.where(wrong & ~mask.reshape(*mask.shape, *[1] * (frame.ndim - 2)), 0, frame)
            wrong = ~np.isfinite(frame)
        if bad := int((wrong.any(axis=-1) if wrong.ndim == 3 else wrong).sum()):
            raise InputError(f"{path}: {bad} pixels are NaN or infinite; repair or mask them.")
    if frame.min() < 0:
        raise InputError(
            f"{path}: holds numbers below 0, down to {frame.min():g}, as where a black level was "
            "subtracted; give the frames as the camera wrote them, or add a constant to all and "
            "state it as camera.black_level."
        )
    if frame.max() > camera.full_scale:
        raise InputError(
            f"{path}: values from {frame.min():g} to {frame.max():g} do not fit "
            f"{camera.bits} bits (0 to {camera.full_scale}); correct camera.bits "
            "(of a command without a rig, --bits)."
        )
    return frame


def _refuse_other_lists(path: Path, camera: Camera, image: np.ndarray) -> None:
    """Refuse a list of values by site whose length does not match the kind of image."""
    sites = len(camera.sites)
    most = sites if image.ndim == 2 else sites * len(COLOURS)
    for name in BY_SITE:
        values = getattr(camera, name)
        if isinstance(values, tuple) and len(values) > most:
            wanted = "one" if sites == 1 else f"{sites}, one for each site"
            raise InputError(
                f"{path}: is grey, but camera.{name} lists {len(values)} numbers, as for RGB; give "
                f"{wanted}, or camera.pattern of a mosaic."
            )


def cropped_to_region(image: np.ndarray, camera: Camera, path: Path) -> np.ndarray:
    """Return the part of an image inside the camera's region."""
    if camera.region is None:
        return image
    top, left, height, width = camera.region
    if top + height > image.shape[0] or left + width > image.shape[1]:
        raise InputError(
            f"{path}: is {image.shape[0]} x {image.shape[1]} pixels, but camera.region ends at row "
            f"{top + height}, column {left + width}; correct top, left, height and width."
        )
    return image[top : top + height, left : left + width]


def read_stack(
    rig: Rig, files: Sequence[str], *, load: Load = read_image, mask: np.ndarray | None = None
) -> np.ndarray:
    """Read frames, which must have equal size, as one array."""
    frames = [read_frame(rig.path(name), rig.camera, load=load, mask=mask) for name in files]
    for name, frame in zip(files, frames, strict=True):
        if frame.shape != frames[0].shape:
            raise InputError(
                f"{rig.path(name)}: is {frame.shape}, but {files[0]} is {frames[0].shape}; "
                "all frames of one set need the same size."
            )
    return np.stack(frames)


def split_channels(frame: np.ndarray, camera: Camera) -> dict[str, np.ndarray]:
    """Return the planes of one frame by name: its colours, or the sites of a mosaic.

    Example:
        >>> from fitting.observation import split_channels
        >>> from fitting.rig import Camera
        >>> sites = split_channels(np.arange(16.0).reshape(4, 4), Camera(bits=12, pattern="RGGB"))
        >>> print({name: int(plane[0, 0]) for name, plane in sites.items()})
        {'red': 0, 'green 1': 1, 'green 2': 4, 'blue': 5}
    """
    names, planes = camera.channels(colour=frame.ndim == 3), {}
    for site, place in enumerate(camera.places(*frame.shape[:2])):
        own = frame[place]
        each = [own] if frame.ndim == 2 else np.moveaxis(own, -1, 0)
        planes.update(zip(names[site * len(each) : (site + 1) * len(each)], each, strict=True))
    return planes


def pixels_of_colour(camera: Camera, shape: tuple[int, int], colour: str) -> np.ndarray:
    """Return a mask (h, w) that is true for the pixels of a mosaic that see one of `COLOURS`."""
    found = np.zeros(shape, bool)
    for name, plane in split_channels(found, camera).items():
        plane[...] = name.split()[0] == colour
    return found


def equalised_camera(camera: Camera) -> SiteCamera:
    """Return a camera with one value for all sites, for images from `equalise_sites`."""
    if isinstance(camera.gain, tuple) and camera.encoding is not None:
        raise InputError(
            "camera.gain lists several numbers, but the files are gamma encoded; give linear files."
        )
    sites = [camera.at(name) for name in _channels_of_lists(camera)]
    known = sites[0].model_dump()
    for name in ("gain", "read_noise"):
        values = np.array([getattr(site, name) for site in sites], float)
        per_colour = np.sqrt(np.mean(values.reshape(len(camera.sites), -1) ** 2, axis=0))
        if np.ptp(per_colour) > ROUNDING * per_colour.max():
            raise InputError(
                f"camera.{name} lists several numbers by colour, but all colours are fitted with "
                "one; give their mean."
            )
        if isinstance(getattr(camera, name), tuple):
            known[name] = float(per_colour[0] if name == "read_noise" else values.mean())
    if any(isinstance(getattr(camera, name), tuple) for name in BY_SITE):
        blacks = [site.black_level or 0.0 for site in sites]
        scales = [1.0 if site.gain is None else known["gain"] / site.gain for site in sites]
        rooms = [site.clip_level - black for site, black in zip(sites, blacks, strict=True)]
        level = float(np.mean(blacks))
        room = min(room * scale for room, scale in zip(rooms, scales, strict=True))
        known |= {"saturation": room + level}
        known |= {} if camera.black_level is None else {"black_level": level}
    return SiteCamera(**known)


def equalise_sites(image: np.ndarray, camera: Camera) -> np.ndarray:
    """Convert an image to the mean black level and the mean gain of the sites."""
    if not isinstance(camera.black_level, tuple) and not isinstance(camera.gain, tuple):
        return image
    black, gain = np.zeros(image.shape), np.ones(image.shape)
    blacks, gains = split_channels(black, camera), split_channels(gain, camera)
    for name in blacks:
        at = camera.at(name)
        blacks[name][...], gains[name][...] = at.black_level or 0.0, at.gain or 1.0
    return (image - black) * (np.mean(camera.gain or 1.0) / gain) + np.mean(camera.black_level or 0)


def read_grey_frame(path: Path, camera: Camera) -> np.ndarray:
    """Return the digital numbers of one image at one black level and gain, the mean of the colours
    of a mosaic. A pixel that a saturated one contributes to is saturated."""
    frame = equalise_sites(read_frame(path, camera), camera)
    if camera.pattern is None:
        return frame
    from scipy.ndimage import maximum_filter

    from jaxvision import demosaic

    top, left = (camera.region or (0, 0))[:2]
    rows = [camera.pattern[2 * (i % 2) :][:2] for i in (top, top + 1)]
    phase = "".join(row[j % 2] for row in rows for j in (left, left + 1))
    clip = equalised_camera(camera).clip_level
    grey = np.asarray(demosaic(frame, phase, method="bilinear")).mean(axis=-1)
    return np.where(maximum_filter(frame >= clip, 3), np.maximum(grey, clip), grey)


def _channels_of_lists(camera: Camera) -> tuple[str, ...]:
    """Return the names of all sites, and their channels if a list has them."""
    lengths = [len(v) for name in BY_SITE if isinstance(v := getattr(camera, name), tuple)]
    return camera.channels(colour=any(length > len(camera.sites) for length in lengths))


def pixels_of_mask(stored: np.ndarray) -> Bool[np.ndarray, "h w"]:
    """Return a mask (h, w) or (h, w, channels) as booleans: true where it is not 0 or, if it has
    many values, as with soft edges or JPEG, where it exceeds half of its largest value."""
    values = np.nan_to_num(np.asarray(stored, float))
    values = values.max(axis=-1) if values.ndim == 3 else values
    soft = np.unique(values).size > MOST_LABELS
    return values > values.max() / 2 if soft else values != 0


def unequal_sites(picture: Float[np.ndarray, "h w"]) -> tuple[str, str]:
    """Return a clause on sites of a 2 x 2 mosaic, rows or columns that differ in a picture in DN
    above black, and the `[camera]` key that states them. Both are empty unless a relative
    difference has one sign in most of the picture. Pixels that do not count are NaN.
    """
    height, width = (2 * (length // 2) for length in picture.shape)
    whole = picture[:height, :width]
    a, b, c, d = (whole[i::2, j::2] for i in (0, 1) for j in (0, 1))
    found = []
    for one, other in (  # along diagonals, each site between two of the other, as light may rise
        (a + d, b + c),
        ((a[:-1, :-1] + a[1:, 1:]) / 2, d[:-1, :-1]),
        ((b[:-1, 1:] + b[1:, :-1]) / 2, c[:-1, 1:]),
    ):
        found.append(0.0)
        total = (one + other)[np.isfinite(one + other)]
        if total.size < FEWEST_BLOCKS:
            continue
        lit = total > DIM * np.quantile(total, 0.95)
        if not lit.any():
            continue
        contrast = (one - other)[np.isfinite(one + other)][lit] / total[lit]
        if max(np.mean(contrast > 0), np.mean(contrast < 0)) > SAME_SIGN:
            found[-1] = 2 * float(np.median(contrast))
    checks, down, up = np.abs(found)
    largest = max(checks, down, up)
    if largest <= UNEQUAL_SITES:
        return "", ""
    by = f"by {format_percent(largest)}"
    if min(down, up) > max(down, up) / 2 > checks:  # the diagonals of a cell cross equal lines
        lines, taps = ("columns", [1, 2]) if found[1] * found[2] < 0 else ("rows", [2, 1])
        return f"Even and odd {lines} differ {by}, as with two amplifiers", f"camera.taps = {taps}"
    differ = f"Neighbouring pixels differ {by} in a pattern of 2 x 2 pixels"
    return f"{differ}, as in a raw colour mosaic", "camera.pattern"


def read_mask(
    path: Path,
    camera: Camera,
    *,
    shape: tuple[int, int] | None = None,
    load: Load = read_image,
) -> np.ndarray:
    """Read a mask of pixels, cropped to the camera's region if it has one."""
    stored = cropped_to_region(load(path), camera, path)
    if stored.ndim == 3 and stored.shape[2] in (2, 4):  # the last channel is alpha
        if (stored[..., -1] != stored[0, 0, -1]).any():
            raise InputError(f"{path}: has an alpha channel that varies; save the mask as grey.")
        stored = stored[..., :-1]
    mask = pixels_of_mask(stored)
    if shape is not None and mask.shape != shape:
        raise InputError(f"{path}: the mask is {mask.shape}, the images are {shape}; resize it.")
    return mask
