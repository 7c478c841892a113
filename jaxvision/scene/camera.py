"""A camera: view, sensor and development."""

from .._shown import Shown
from .._types import check_fields
from .developments import Development
from .sensors import Sensor
from .views import View


class Camera(Shown):
    """Where each pixel looks, how light is measured, and how raw data become a picture.

    Attributes:
        view: the projection.
        sensor: from light to raw data.
        development: from raw data to a picture, or None: raw data only.
    """

    view: View
    sensor: Sensor
    development: Development | None = None

    def __check_init__(self) -> None:
        check_fields(self)
