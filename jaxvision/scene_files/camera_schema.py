"""`[camera]` of a scene file. Lengths in m, angles in degrees."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from ..toml_files import Count, Entry, Positive, Vector


class _Camera(Entry):
    """Fields of every camera.

    Attributes:
        position: m.
        target: m, the point at which the camera looks.
        up: direction of the top of the picture.
        resolution: (rows, columns) pixels.
    """

    position: Vector
    target: Vector
    up: Vector = (0.0, 0.0, 1.0)
    resolution: tuple[Count, Count]


class OrthographicEntry(_Camera):
    """Parallel projection.

    Attributes:
        kind: "orthographic".
        width: m of the scene across the picture.
    """

    kind: Literal["orthographic"]
    width: Positive


class PinholeEntry(_Camera):
    """Central projection; either `field_of_view`, or `focal_length` and `pixel_pitch`, or the
    `matrix` of a calibration by OpenCV.

    Attributes:
        kind: "pinhole".
        field_of_view: degrees across the width of the picture.
        focal_length: m.
        pixel_pitch: m.
        matrix: [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] in pixels.
        distortion: k1, k2, p1, p2, k3 as OpenCV orders them, with a matrix.
    """

    kind: Literal["pinhole"]
    field_of_view: Annotated[Positive, Field(lt=180)] | None = None
    focal_length: Positive | None = None
    pixel_pitch: Positive | None = None
    matrix: tuple[Vector, Vector, Vector] | None = None
    distortion: tuple[float, ...] | None = None

    @model_validator(mode="after")
    def _one_way(self) -> "PinholeEntry":
        by_size = (self.focal_length is not None, self.pixel_pitch is not None)
        if self.matrix is not None:
            if any(by_size) or self.field_of_view is not None:
                raise ValueError("give a matrix, or field_of_view, or focal_length; one of them")
            return self
        if self.distortion is not None:
            raise ValueError("distortion is that of a calibration: give its matrix, too")
        if any(by_size) == (self.field_of_view is not None) or (any(by_size) and not all(by_size)):
            raise ValueError("give either field_of_view, or focal_length and pixel_pitch")
        return self


class ThinLensEntry(_Camera):
    """Central projection through a lens.

    Attributes:
        kind: "thin_lens".
        focal_length: m.
        pixel_pitch: m.
        f_number: no unit.
        focus_distance: m; absent for focus at infinity.
        blades: of the iris; absent for a round aperture.
    """

    kind: Literal["thin_lens"]
    focal_length: Positive
    pixel_pitch: Positive
    f_number: Positive
    focus_distance: Positive | None = None
    blades: Annotated[Count, Field(ge=3)] | None = None


Camera = Annotated[OrthographicEntry | PinholeEntry | ThinLensEntry, Field(discriminator="kind")]
