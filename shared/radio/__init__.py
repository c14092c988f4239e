"""How strong should this access point be heard there, and how likely is what was heard: path loss and shadowing."""

from shared.radio.likelihood import RadioNoise, log_likelihood
from shared.radio.path_loss import PathLoss
from shared.radio.shadowing_map import ShadowingMap

__all__ = ["PathLoss", "RadioNoise", "ShadowingMap", "log_likelihood"]
