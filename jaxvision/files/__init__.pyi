# What `jaxvision.files` offers, each name where it is defined; see `jaxvision/__init__.pyi`.

from . import (
    cameras as cameras,
    gltf as gltf,
    image_settings as image_settings,
    images as images,
    luminaires as luminaires,
    materials as materials,
    measured as measured,
    meshes as meshes,
    raw as raw,
    records as records,
    scenes as scenes,
    shipped as shipped,
    toml as toml,
)
from .images import (
    read_arrays as read_arrays,
    read_channels as read_channels,
    read_environment as read_environment,
    read_image as read_image,
    write_exr as write_exr,
    write_image as write_image,
)
from .image_settings import (
    ImageSettings as ImageSettings,
    read_settings as read_settings,
)
from .raw import (
    read_fits as read_fits,
    read_raw as read_raw,
)
from .cameras import (
    read_camera as read_camera,
    read_sensor as read_sensor,
    shipped_cameras as shipped_cameras,
    write_camera as write_camera,
    write_sensor as write_sensor,
)
from .luminaires import (
    read_luminaire as read_luminaire,
)
from .materials import (
    read_material as read_material,
    write_material as write_material,
)
from .measured import (
    read_cornell as read_cornell,
    read_measured as read_measured,
    read_merl as read_merl,
    read_rgl as read_rgl,
    table_of_samples as table_of_samples,
    write_cornell as write_cornell,
    write_merl as write_merl,
    write_rgl as write_rgl,
)
from .meshes import (
    read_mesh as read_mesh,
)
from .scenes import (
    SceneFile as SceneFile,
    read_scene as read_scene,
    shipped_scenes as shipped_scenes,
)
from .records import (
    write_record as write_record,
)
