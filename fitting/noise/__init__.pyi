# What `fitting.noise` offers, each name where it is defined.

from .across_settings.calibration import calibrate_settings as calibrate_settings
from .across_settings.sensor import sensor_at as sensor_at
from .across_settings.setting import (
    FramesOfSetting as FramesOfSetting,
    read_by_setting as read_by_setting,
)
from .calibration import calibrate as calibrate
from .from_memory import (
    Camera as Camera,
    darks_from_frames as darks_from_frames,
    from_frames as from_frames,
    stacks_from_frames as stacks_from_frames,
)
from .levels import Levels as Levels, PhotonTransfer as PhotonTransfer
from .prediction.predict import Prediction as Prediction, predict as predict
from .read import read_photon_transfer as read_photon_transfer
from .release_4.sheet import Release4 as Release4, release_4_sheet as release_4_sheet
from .release_4.stacks import Stacks as Stacks, read_stacks as read_stacks
from .settings import Setting as Setting
from .sites import sensor_of_sites as sensor_of_sites
