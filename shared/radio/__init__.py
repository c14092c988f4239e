"""How strong should this access point be heard there, and how likely is what was heard: path loss and shadowing."""

from shared.radio.likelihood import RadioNoise, log_likelihood
from shared.radio.path_loss import PathLoss

__all__ = ["PathLoss", "RadioNoise", "log_likelihood"]
