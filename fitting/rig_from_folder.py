"""Write a first `rig.toml` for a folder of images from their names and metadata, without asking
questions.
"""

import json
import math
import re
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from jaxvision.errors import InputError, check_utf8
from jaxvision.files.image_settings import ImageSettings, read_settings
from jaxvision.files.images import (
    FLOAT_FORMATS,
    INTEGER_FORMATS,
    JPEG_FORMATS,
    READ_ONLY_FORMATS,
    read_image,
    replaced_on_success,
)
from jaxvision.files.raw import FITS_FORMATS, RAW_FORMATS

from .codes import Codes, converter_of
from .inference.formatting import format_percent
from .rig import RIG_FILE

SUFFIXES = (
    *(*INTEGER_FORMATS, *JPEG_FORMATS, *READ_ONLY_FORMATS, *RAW_FORMATS, *FITS_FORMATS),
    *(*FLOAT_FORMATS, ".npy"),
)
BITS = (8, 10, 12, 14, 16)  # bit depths of common converters
SAME_TIME = 0.1  # relative difference of an exposure from that of a name, which is often rounded
TEMPERATURE_GAP = 2.0  # K, gap between temperatures that count as two settings
MOST_READ = 9  # images whose pixels are read, for the depth
_DARK, _FLAT, _LIGHT = (
    re.compile(rf"(?<![a-z])({words})(?![a-z])", re.IGNORECASE)
    for words in (
        "darks?|dark(?:flat|frame)s?|flatdarks?|bias|biasframes?|black",
        "flats?|flat(?:field|frame)s?|bright|ff",
        "lights?|lamps?|led",
    )
)
# Frames without an exposure.
_BIAS = re.compile(r"(?<![a-z])bias(?:frames?)?(?![a-z])|^zero$", re.IGNORECASE)
# Words in IMAGETYP of a FITS header, such as DARKFLAT and Flat Field; the first match counts.
_TYPES = {
    "dark": re.compile("dark|bias|zero", re.IGNORECASE),
    "flat": re.compile("flat", re.IGNORECASE),
    "photograph": re.compile("light|object|science", re.IGNORECASE),
}
_THUMBNAIL = re.compile(r"(?<![a-z])(thumb(nail)?s?|preview)(?![a-z])", re.IGNORECASE)
_NORMALS, _MASK = (re.compile(word, re.IGNORECASE) for word in ("normal", "mask"))
_TIME = re.compile(
    r"(?:(?<![a-z\d.,])|(?<=exp))(\d+(?:[.,]\d+)?) ?(us|\u00b5s|\u03bcs|ms|s|sec)(?![a-z])",
    re.IGNORECASE,
)
_FRACTION, _COUNTED = (
    re.compile(rf"(?<![\d.,])(?<!\d[_-]){over}[_-]([1-9]\d*) ?(?:s|sec)(?![a-z])", re.IGNORECASE)
    for over in ("1", r"(?!1[_-])\d+")
)
_WAVELENGTH = re.compile(r"(?<![a-z\d.,])(\d+(?:\.\d+)?) ?nm(?![a-z])", re.IGNORECASE)
_UNITS = {**dict.fromkeys(("us", "\u00b5s", "\u03bcs"), 1e-6), "ms": 1e-3, "s": 1.0, "sec": 1.0}

Key = tuple[str, float | None, float | None, str]  # line of the exposure, ISO, temperature, stem
UNKNOWN_EXPOSURE = "# exposure = ?  # s"


@dataclass
class FoundRig:
    """A rig as text, with sentences on missing values and on images that are in no entry.

    Attributes:
        text: the rig in TOML; missing entries are comments in it.
        missing: one sentence for each missing entry.
        left_out: one sentence for each image that is in no entry.
        kind: calibration for which the images are suited: noise, response or brdf; "" for none.
    """

    text: str = ""
    missing: list[str] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    kind: str = ""


@dataclass(frozen=True)
class _Image:
    """An image file, with what its name and metadata say about it."""

    name: str  # path relative to the folder
    settings: ImageSettings  # from its metadata
    exposure: float | None  # s, from the metadata or the name
    kind: str = ""  # dark, flat, light (of a known shape under a lamp), or "" for an exposure stack
    # sentences, or "", on a doubtful exposure time in the name, and on a kind about which name and
    # metadata disagree
    doubts: tuple[str, str] = ("", "")


def write_rig(folder: Path) -> tuple[Path, FoundRig]:
    """Write the rig of a folder into the folder."""
    path = folder / RIG_FILE
    if path.exists():
        raise InputError(f"{path}: is there already; remove it to have it written anew.")
    found = rig_of(folder)
    with replaced_on_success(path) as partial:
        partial.write_text(found.text, encoding="utf-8")
    return path, found


def rig_of(folder: Path) -> FoundRig:
    """Infer the text of a rig file from the names and metadata of the images in a folder.

    The kind of an image follows from a word in its path: dark or bias; flat or bright; light or
    lamp (an image named `normals` or `mask` then gives the shape). The other images are an exposure
    stack. IMAGETYP of a FITS header also distinguishes flats, darks and photographs. Times come
    from the metadata, or from names such as `flat_8ms` and `scene_1-8s`. Wavelengths in names, as
    in `chart_450nm`, separate stacks. An EXR or HDR file next to images of integers is left out,
    and so are hidden files, thumbnails, and JPEG files beside files of the same name.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; name the one that holds the images.")
    files = [
        path
        for path in (*folder.iterdir(), *folder.glob("*/*"))
        if path.suffix.lower() in SUFFIXES
        and path.is_file()  # hidden: macOS writes `._a.tif` next to `a.tif` on USB drives
        and not any(part.startswith(".") for part in path.relative_to(folder).parts)
    ]
    if not files:
        raise InputError(f"{folder}: holds no images; known are {', '.join(SUFFIXES)}.")
    for file in files:
        check_utf8(file)
    own: dict[Path, str] = {}
    for path in files:
        name, real = path.relative_to(folder), path.resolve()
        if real not in own or real == folder.resolve() / name:  # the file itself, not a link to it
            own[real] = name.as_posix()
    links = len(files) - len(own)
    names = sorted(own.values(), key=_natural)
    shape = [name for name in names if _NORMALS.search(name) or _MASK.search(name)]
    counted = any(_COUNTED.search(Path(name).stem) for name in names)
    pictures, copies = _drop_copies([name for name in names if name not in shape])
    floating = [name for name in pictures if Path(name).suffix.lower() in FLOAT_FORMATS]
    merged = floating if len(floating) < len(pictures) else []
    images = [_image(folder, name, counted=counted) for name in pictures if name not in merged]
    dark, flat, light, stack = (
        [image for image in images if image.kind == kind] for kind in ("dark", "flat", "light", "")
    )
    found = FoundRig(
        kind="noise" if flat else "brdf" if light else "response" if stack else "",
        left_out=[
            f"{name}: holds floating numbers, and the other images hold whole ones."
            for name in merged
        ]
        + copies
        + ([f"{links} names of images that other names lead to as links."] if links else []),
    )
    lines = _camera(folder, images, found)
    warmth = _warmth(flat + dark)
    isos = {image.settings.iso for image in flat + dark if image.settings.iso}
    for kind, levels in (("flat", flat), ("dark", dark)):
        lines += _levels(kind, levels, found, warmth, several_gains=len(isos) > 1)
    sensitivities = sorted({one.settings.iso for one in stack + light if one.settings.iso})
    if len(sensitivities) > 1:
        listed = ", ".join(f"{iso:g}" for iso in sensitivities)
        found.missing.append(f"The images differ in ISO ({listed}); keep those of one gain.")
    _refuse_apertures(stack + light, flat, found)
    lines += _exposures(stack, found) + _lights(light, found)
    if light or shape:
        lines += _geometry(shape, found)
    for i in (0, 1):
        if doubts := [image.doubts[i] for image in images if image.doubts[i]]:
            others = f" {len(doubts) - 1} more names are like this." if len(doubts) > 1 else ""
            found.missing.append(doubts[0] + others)
    if not found.kind:
        found.missing.append(
            "Nothing can be calibrated yet: add flats for the noise, a still scene at several "
            "exposure times for the response, or images under known lights for the reflectance."
        )
    if flat and not dark:
        found.missing.append("No name or header marks darks, which photon transfer needs.")
    found.text = "\n".join(lines) + "\n"
    return found


def _drop_copies(names: list[str]) -> tuple[list[str], list[str]]:
    """Leave out thumbnails, and JPEG files beside a file of the same name in another format. Return
    the names that are kept, and sentences on the others."""
    lossy = {name for name in names if Path(name).suffix.lower() in JPEG_FORMATS}
    others = {name for name in names if Path(name).suffix.lower() not in FLOAT_FORMATS} - lossy
    stems = {Path(name).with_suffix("") for name in others}
    kept, left_out = [], []
    for name in names:
        if _THUMBNAIL.search(Path(name).stem):
            left_out.append(f"{name}: is a thumbnail, by its name.")
        elif name in lossy and Path(name).with_suffix("") in stems:
            left_out.append(f"{name}: another file of this name is no JPEG.")
        else:
            kept.append(name)
    return kept, left_out


def _natural(name: str) -> list[tuple[int, float | str]]:
    """Return a sort key that orders numbers in names by value."""
    parts = re.split(r"(\d+)", name.lower())
    return [(0, float(part)) if part.isdigit() else (1, part) for part in parts]


def _kind(name: str, said: str) -> tuple[str, str]:
    """Return the kind of an image by its name and the IMAGETYP of its header. Also return a
    sentence if the two disagree, otherwise "".
    """
    words = {"dark": _DARK, "flat": _FLAT, "light": _LIGHT}
    named = next((kind for kind, word in words.items() if word.search(name)), "")
    kind = typed = next((kind for kind, word in _TYPES.items() if word.search(said)), "")
    if typed not in ("dark", "flat"):
        kind = "" if typed and named != "light" else named
    if not typed or named in ("", kind):
        return kind, ""
    return kind, (
        f"{name}: taken by its IMAGETYP, {said}; correct that if it is a {named}, as its name says."
    )


def _image(folder: Path, name: str, *, counted: bool) -> _Image:
    settings = read_settings(folder / name)
    kind, doubt_of_kind = _kind(name, settings.kind or "")
    seconds, doubt = settings.exposure or None, ""
    named, doubt = _time_in(name, counted=counted)
    if seconds is None:
        seconds = named
    else:
        doubt = ""
        if named is not None and not math.isclose(seconds, named, rel_tol=SAME_TIME):
            doubt = (
                f"{name}: its header says {seconds:.4g} s, which was taken; its name {named:.4g} s."
            )
    if seconds is None and _BIAS.search(settings.kind or Path(name).stem):
        seconds = 0.0
    return _Image(name, settings, seconds, kind, (doubt, doubt_of_kind))


def _time_in(name: str, *, counted: bool) -> tuple[float | None, str]:
    """Return the exposure in seconds that a name states, as in flat_8ms, and a sentence on a
    doubtful reading. The name scene_1-8s means 1/8 s, or 8 s if `counted` states that the first
    number counts the images."""
    stem = Path(name).stem
    fraction = _FRACTION.search(stem)
    if fraction and fraction[1] != "1" and not counted:
        under = float(fraction[1])
        return 1 / under, f"{name}: read as 1/{under:g} s; correct it if that is {under:g} s."
    found = _TIME.search(stem)
    if found is None:
        return None, ""
    number, unit = found.groups()
    return float(number.replace(",", ".")) * _UNITS[unit.lower()] or None, ""


def _quote(name: str) -> str:
    return json.dumps(name, ensure_ascii=False).replace("\x7f", "\\u007f")


def _camera(folder: Path, images: Sequence[_Image], found: FoundRig) -> list[str]:
    said = [image.settings for image in images]
    cameras = sorted({one.camera for one in said if one.camera})
    lines = [f"# {' '.join(', '.join(cameras).split())}"] if cameras else []
    lines += ["[camera]", _depth(folder, images, found)]
    patterns = {one.pattern for one in said if one.pattern}
    lines += _levels_of_sites(said, one_pattern=len(patterns) == 1)
    if len(patterns) == 1:
        lines.append(f'pattern = "{patterns.pop()}"')
    elif patterns:
        listed = ", ".join(sorted(patterns))
        found.missing.append(f"The files differ in the phase of their mosaic ({listed}).")
    dates = [one.taken for one in said if one.taken]
    if dates:
        lines.append(f"date = {min(dates).date().isoformat()}")
    warmth = [one.temperature for one in said if one.temperature]
    if warmth:
        lines.append(f"temperature = {np.mean(warmth):.5g}")
    return lines


def _levels_of_sites(said: Sequence[ImageSettings], *, one_pattern: bool) -> list[str]:
    """Return the lines for black level and saturation: one number, or one for each site."""
    lines = []
    for name in ("black_level", "saturation"):
        values = [np.atleast_1d(v) for one in said if (v := getattr(one, name)) is not None]
        if not values:
            continue
        if not one_pattern or len({len(value) for value in values}) > 1:
            values = [np.atleast_1d(value.mean()) for value in values]
        numbers = [f"{number:.6g}" for number in np.median(values, axis=0)]
        several = len(set(numbers)) > 1
        lines.append(f"{name} = [{', '.join(numbers)}]" if several else f"{name} = {numbers[0]}")
    return lines


def _refuse_apertures(
    photographs: Sequence[_Image], flats: Sequence[_Image], found: FoundRig
) -> None:
    """Refuse several apertures, at which seconds do not describe the light."""
    for kind, images in (("images", photographs), ("flats", flats)):
        numbers = sorted(
            {f"{one.settings.f_number:.3g}" for one in images if one.settings.f_number}, key=float
        )
        if len(numbers) > 1:
            listed = ", ".join(f"f/{number}" for number in numbers)
            found.missing.append(
                f"The {kind} differ in aperture ({listed}); keep those of one aperture."
            )


def _warmth(images: Sequence[_Image]) -> dict[str, float]:
    """Return the temperature in K of each image by its name: the mean of a cluster, in which
    neighbours differ by at most `TEMPERATURE_GAP`. The result is empty if there is one cluster."""
    known = sorted((i.settings.temperature, i.name) for i in images if i.settings.temperature)
    groups: list[list[tuple[float, str]]] = []
    for kelvin, name in known:
        if groups and kelvin - groups[-1][-1][0] <= TEMPERATURE_GAP:
            groups[-1].append((kelvin, name))
        else:
            groups.append([(kelvin, name)])
    if len(groups) < 2:
        return {}
    means = [round(float(np.mean([kelvin for kelvin, _ in group])), 1) for group in groups]
    return {name: mean for mean, group in zip(means, groups, strict=True) for _, name in group}


def _depth(folder: Path, images: Sequence[_Image], found: FoundRig) -> str:
    """Return the line of the rig that states `bits`, from the metadata of the files, or from the
    largest number in some of the images."""
    picks = np.unique(np.linspace(0, len(images) - 1, min(MOST_READ, len(images))).astype(int))
    read = [read_image(folder / images[i].name) for i in picks]
    found.missing += _processing_in_words([images[i] for i in picks], read)
    saturations = [image.settings.saturation for image in images if image.settings.saturation]
    depths = sorted({image.settings.bits for image in images if image.settings.bits})
    if len(depths) > 1:
        listed = " and ".join(map(str, depths))
        found.missing.append(f"The files differ in depth ({listed} bits); export them alike.")
    elif depths and depths[0] < 16:
        return f"bits = {depths[0]}"
    if all(one.dtype == np.uint8 for one in read):
        return "bits = 8"
    top = max([float(np.nanmax(one)) for one in read] + saturations)
    bits = next((bits for bits in BITS if top < 2**bits), None)
    step = converter_of(read).step
    if bits is not None and step > 1:
        found.missing.append(
            f"All numbers are multiples of {step:.6g}, or a constant away from that, as of fewer "
            f"bits at the upper end of {bits}; bits = {bits} holds them as they are stored."
        )
        return f"bits = {bits}  # the numbers are {step:.6g} DN from each other"
    if bits is None:
        found.missing.append("The numbers exceed 16 bits: give images of digital numbers.")
        return "# bits = ?"
    found.missing.append(f"bits = {bits} is the least that holds {top:g} DN; correct it.")
    return f"bits = {bits}  # at least: the largest number read is {top:g}"


def _processing_in_words(images: Sequence[_Image], read: Sequence[np.ndarray]) -> list[str]:
    """Return sentences on numbers that no converter gives, and on black that was clipped."""
    least, top = (float(end([end(one) for one in read])) for end in (np.nanmin, np.nanmax))
    step, sentences, advice = converter_of(read).step, [], "give frames as the camera wrote them."
    if step < 1 and least >= 0 and top <= 1:
        sentences.append(f"All numbers lie between 0 and 1, as after a division; {advice}")
    elif step < 1:
        grid = f"multiples of 1/{1 / step:.4g}" if step else "not whole"
        sentences.append(f"The numbers are {grid}, as in means or after a correction; {advice}")
    if least < 0:
        sentences.append(f"The least number is {least:g}, as after a subtraction; {advice}")
    codes = Codes()
    darks = [own for image, own in zip(images, read, strict=True) if image.kind == "dark"]
    for own in darks:
        codes.add(own)
    lowest = codes.clips_below()
    if lowest is not None:
        share = format_percent(float(np.mean([np.mean(own == lowest) for own in darks])))
        sentences.append(
            f"{share} of the darks' pixels are {lowest:g} DN and none are below, as black that was "
            "clipped; raise the camera's black level, or give frames before its subtraction."
        )
    return sentences


def _levels(
    kind: str,
    images: Sequence[_Image],
    found: FoundRig,
    warmth: dict[str, float],
    *,
    several_gains: bool,
) -> list[str]:
    """Return the entries for flats or darks. An entry has images of one exposure, gain and
    temperature, whose names differ only in the last number.
    """
    stems = {image.name: re.sub(r"[_-]?\d+$", "", Path(image.name).stem) for image in images}
    several = len(set(stems.values())) > 1

    def group_files(stem_counts: bool) -> dict[Key, list[str]]:
        groups: dict[Key, list[str]] = defaultdict(list)
        for image in images:
            iso = image.settings.iso if several_gains else None
            stem = stems[image.name] if stem_counts else ""
            groups[_seconds(image), iso, warmth.get(image.name), stem].append(image.name)
        return groups

    groups = group_files(several)
    if any(len(names) < 2 for names in groups.values()):  # numbers identify levels, not frames
        groups = group_files(False)
    lines = []
    for (seconds, iso, kelvin, _), names in groups.items():
        listed = "".join(f"\n    {_quote(name)}," for name in names)
        lines += ["", f"[[{kind}]]", f"files = [{listed}\n]", seconds]
        lines += [f"iso = {iso:g}"] if iso else []
        lines += [f"temperature = {kelvin:g}"] if kelvin else []
        if kind == "flat":
            lines.append("# photons = ?  # a pixel and exposure, for the quantum efficiency")
        if len(names) < 2:
            found.missing.append(f"{names[0]}: a {kind} level needs two images or more.")
    if UNKNOWN_EXPOSURE in {seconds for seconds, *_ in groups}:
        found.missing.append(f"Exposures of {kind}s are in neither files nor names; give them.")
    if kind == "flat" and groups:
        found.missing.append("photons of the flats: give them for the quantum efficiency.")
    return lines


def _exposures(images: Sequence[_Image], found: FoundRig) -> list[str]:
    said = {image.name: _WAVELENGTH.search(Path(image.name).stem) for image in images}
    bands = {name: f"{band[1]}nm" if band else "" for name, band in said.items()}
    if len(set(bands.values())) < 2:
        bands = dict.fromkeys(bands, "")
    lines = []
    for image in images:
        lines += ["", "[[exposure]]", f"file = {_quote(image.name)}", _seconds(image)]
        lines += [f'group = "{bands[image.name]}"'] if bands[image.name] else []
    untimed = [image.name for image in images if image.exposure is None]
    if untimed:
        of = "" if len(untimed) == len(images) else f" of {', '.join(untimed[:3])}"
        of += f" and {len(untimed) - 3} more" if of and len(untimed) > 3 else ""
        found.missing.append(f"Exposures{of} are in neither files nor names; give them in seconds.")
    for band in dict.fromkeys(bands.values()):
        alone = [name for name, own in bands.items() if own == band]
        if len(alone) < 2 and found.kind == "response":
            of = f" of {band}" if band else ""
            found.missing.append(
                f"{alone[0]} is the only exposure{of}; a response needs two or more."
            )
    return lines


def _seconds(image: _Image) -> str:
    """Return the line for the exposure, a fraction if EXIF's or if decimals are rounded."""
    if image.exposure is None:
        return UNKNOWN_EXPOSURE
    if image.exposure == 0:
        return "exposure = 0  # a bias frame"
    decimals, under = f"{image.exposure:.6g}", round(1 / image.exposure)
    is_fraction = under > 1 and math.isclose(under * image.exposure, 1, rel_tol=1e-7)
    by_exif = image.settings.exposure and Path(image.name).suffix.lower() not in FITS_FORMATS
    is_exact = math.isclose(float(decimals), image.exposure, rel_tol=1e-9)
    if is_fraction and (by_exif or not is_exact):
        return f'exposure = "1/{under}"'
    return f"exposure = {decimals}"


def _lights(images: Sequence[_Image], found: FoundRig) -> list[str]:
    lines = []
    for image in images:
        lines += ["", "[[light]]", f"file = {_quote(image.name)}", "# direction = [?, ?, ?]"]
    if images:
        found.missing.append("Directions toward lights are in no file; give a unit vector each.")
    return lines


def _geometry(shape: Iterable[str], found: FoundRig) -> list[str]:
    normals = [name for name in shape if _NORMALS.search(name)]
    masks = [name for name in shape if _MASK.search(name)]
    lines = ["", "[geometry]"]
    if normals:
        lines.append(f"normals = {_quote(normals[0])}")
    else:
        lines.append("# sphere = { centre = [?, ?], radius = ? }  # column, row, pixels")
        found.missing.append("The shape: give the sphere's centre and radius, or normals.")
    return lines + [f"mask = {_quote(name)}" for name in masks[:1]]
