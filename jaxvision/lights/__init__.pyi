# What `jaxvision.lights` offers, each name where it is defined; see `jaxvision/__init__.pyi`.

from ._emission import (
    emitted as emitted,
    emitted_from_point as emitted_from_point,
    emitted_from_surface as emitted_from_surface,
)
from ._nodes import (
    gauss_legendre as gauss_legendre,
    shifted_lattice as shifted_lattice,
    square_nodes as square_nodes,
)
from ._registry import (
    Emitted as Emitted,
    Incident as Incident,
    Seen as Seen,
    can_be_seen as can_be_seen,
    kind_of as kind_of,
    kinds as kinds,
    register as register,
    register_extended as register_extended,
)
from ._samples import (
    incident_sample as incident_sample,
    light_nodes as light_nodes,
    lights_by_rule as lights_by_rule,
    rule_for as rule_for,
    rule_of_each as rule_of_each,
    rules_of as rules_of,
    split_by_rule as split_by_rule,
)
from .directional import DirectionalLight as DirectionalLight
from .environment import EnvironmentMap as EnvironmentMap
from .environment_tables import environment_map as environment_map
from .goniometric import (
    GoniometricAreaLight as GoniometricAreaLight,
    GoniometricLight as GoniometricLight,
    Luminaire as Luminaire,
    flux as flux,
    goniometric_light as goniometric_light,
    relative_intensity as relative_intensity,
)
from .incidence import (
    direction_pdf as direction_pdf,
    direction_sample as direction_sample,
    incident as incident,
    incident_samples as incident_samples,
    irradiance as irradiance,
    nearest_seen as nearest_seen,
    radiance_from as radiance_from,
    radiance_along as radiance_along,
)
from .light_field import LightFieldLight as LightFieldLight
from .point import PointLight as PointLight
from .rectangle import RectangleLight as RectangleLight
from .rules import (
    Balanced as Balanced,
    MonteCarlo as MonteCarlo,
    Quadrature as Quadrature,
    Rule as Rule,
)
from .skies import (
    cie_sky as cie_sky,
    daylight as daylight,
    perez_sky as perez_sky,
    sky_radiance as sky_radiance,
)
from .small import SmallLight as SmallLight
from .spot import SpotLight as SpotLight
from .sun_disc import SunDisc as SunDisc
from .window import Window as Window
