"""Detection of image files that are copies of one exposure. Two separate exposures of one scene
differ by noise, so equal numbers in every pixel reveal a copy."""

import hashlib
from pathlib import Path

import numpy as np

from jaxvision.errors import InputError

LEAST_BETWEEN = 0.01  # share of the pixels that must be neither black nor white


class Copies:
    """Names of images, grouped by a hash of their pixels. Images that are black or white almost
    everywhere are ignored, because two exposures of such images may be equal."""

    def __init__(self) -> None:
        self._names: dict[bytes, list[str]] = {}

    def add(self, name: str, image: np.ndarray) -> None:
        """Add an image, to be compared with the others."""
        between = (image > image.min()) & (image < image.max())
        if between.mean() > LEAST_BETWEEN:
            digest = hashlib.blake2b(image.tobytes()).digest()
            self._names.setdefault(digest, []).append(name)

    @property
    def equal_groups(self) -> list[list[str]]:
        """Groups of names of images that are equal in every pixel."""
        return [names for names in self._names.values() if len(names) > 1]

    def refuse(self, folder: Path) -> None:
        """Raise InputError if any two images are equal in every pixel."""
        for first, second, *_ in self.equal_groups:
            raise InputError(
                f"{folder / second}: is {first} in every pixel, so one is a copy of the other; "
                "give each exposure its own image."
            )
