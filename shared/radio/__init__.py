"""How strong should this access point be heard there, and how likely is what was heard: path loss and shadowing."""

from shared.radio.expected_level import expected_level
from shared.radio.likelihood import RadioNoise, log_likelihood
from shared.radio.locating import Whereabouts, locate_access_point
from shared.radio.nowhere import Nowhere
from shared.radio.path_loss import PathLoss
from shared.radio.radio_fit import RadioFit, Visits, fit_radio, gather_visits
from shared.radio.radio_learning import RadioLearner, RadioPrior, device_offsets, novelty
from shared.radio.radio_model import (
    RadioModel,
    RadioModelError,
    pack_radio_model,
    read_radio_model,
    unpack_radio_model,
    write_radio_model,
)
from shared.radio.shadowing_map import ShadowingMap
from shared.radio.visits import visit_variance

__all__ = [
    "Nowhere",
    "PathLoss",
    "RadioFit",
    "RadioLearner",
    "RadioModel",
    "RadioModelError",
    "RadioNoise",
    "RadioPrior",
    "ShadowingMap",
    "Visits",
    "Whereabouts",
    "device_offsets",
    "expected_level",
    "fit_radio",
    "gather_visits",
    "locate_access_point",
    "log_likelihood",
    "novelty",
    "pack_radio_model",
    "read_radio_model",
    "unpack_radio_model",
    "visit_variance",
    "write_radio_model",
]
