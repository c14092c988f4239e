"""Maps of an area, learned as people walk: where they go, what stands in their way, radio and magnetism."""

from services.learning.maps.area_maps import AreaMaps
from services.learning.maps.maps_learner import MapsLearner

__all__ = ["AreaMaps", "MapsLearner"]
