"""A view, a sensor and a development."""

import equinox as eqx

from .._types import check_kind
from .developments import Development
from .sensors import Sensor
from .views import View


class Camera(eqx.Module):
    """What it sees, how it measures, and how its raw data become a picture (None: they do not)."""

    view: View
    sensor: Sensor
    development: Development | None = None

    def __check_init__(self) -> None:
        check_kind("Camera.view", self.view, View)
        check_kind("Camera.sensor", self.sensor, Sensor)
        check_kind("Camera.development", self.development, Development)
