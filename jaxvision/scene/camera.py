"""The record of a camera, which consists of a view, a sensor and a development."""

from ..core._shown import Shown
from ..core._types import check_fields
from .developments import Development
from .sensors import Sensor
from .views import View


class Camera(Shown):
    """A camera: the view gives the direction of each pixel, the sensor measures light, and the
    development converts raw data to a picture.

    Attributes:
        view: the projection.
        sensor: model from light to raw data.
        development: steps from raw data to a picture; None for raw data only.

    Example:
        >>> view = jv.Pinhole([0, 0, 0], np.eye(3), 0.05, 1e-5, resolution=(1, 1), f_number=2.0)
        >>> camera = jv.Camera(view, jv.Sensor(gain=8.0))
        >>> light = jv.sensor_irradiance(camera.view, jnp.full((1, 1, 1), 4 / np.pi))
        >>> round(float(jv.raw_image(None, camera.sensor, light)[0, 0, 0]), 4)  # 8 pi L / (4 2^2)
        2.0
    """

    view: View
    sensor: Sensor
    development: Development | None = None

    def __check_init__(self) -> None:
        check_fields(self)
